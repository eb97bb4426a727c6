"""Is a ``vehicle.toml`` what its author meant: frames, signs, units, inertia, hover, authority, and a flight.

Force and moment of every jet are read back from JSBSim and compared with ``r x F`` by hand.  Authority is the largest
moment about one axis while the weight is held and the other two moments are zero, over all throttles within their
limits and over the hinges: what is attained, and what nothing exceeds (:mod:`cosim.control.allocation.authority`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.aircraft_check.authority_drawing import draw_attainable_moments
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import AXES, ZERO3, Disturbance, Vector3
from cosim.base.storage.files import write_files
from cosim.control.allocation.authority import Authority, Range, Reach, compute_reach
from cosim.control.predictors.registry import BASELINE
from cosim.engine import list_engine_names
from cosim.flight import fly_watched as fly
from cosim.results.report.three_views import points_of, three_views
from cosim.simulation.build import build
from cosim.simulation.engines import load_engines
from cosim.simulation.model_agreement import MIN_REPORTED, ModelAgreement, compare_models
from cosim.simulation.notes import note_missing_fuel_flow
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_seen_from, engine_of, file_seen_from, load_vehicle

HEIGHT_M, FLIGHT_S = 10.0, 5.0  # start and length of the hover test
HEIGHT_ERROR_M, LEAN_DEG = 1.0, 10.0  # limits in a calm hover
# Plausible radius of gyration about an axis over the distance of the farthest part: 1 for a thin ring, small for a
# dense core.
GYRATION_RATIO_RANGE = (0.05, 1.0)
Array = NDArray[np.float64]


@dataclass(frozen=True)
class CheckLine:
    """Result of one check: name, value in words, and the fault if there is one."""

    name: str
    text: str
    fault: str = ""  # why the check failed; empty: it passed


@dataclass(frozen=True)
class AircraftCheck:
    """The results of checking an aircraft with its engine."""

    aircraft: str
    title: str
    engine: str
    lines: list[CheckLine]
    authority: list[Authority]
    inertia: Vector3
    drawing: Path | None = None

    @property
    def is_exact(self) -> bool:
        """Whether upper and lower bound of the authority agree to three digits; else it is a lower bound."""
        return all(
            authority.cannot_hover or all(authority.moment_range(axis).is_exact for axis in range(3))
            for authority in self.authority
        )

    @property
    def is_fit(self) -> bool:
        return not any(line.fault for line in self.lines)

    def to_dict(self) -> dict[str, Any]:
        return {
            "aircraft": self.aircraft,
            "engine": self.engine,
            "fit": self.is_fit,
            "checks": [{"name": line.name, "said": line.text, "fault": line.fault} for line in self.lines],
            "authority": [_authority_json(authority) for authority in self.authority],
            "authority_exact": self.is_exact,
            "inertia_kg_m2": self.inertia,
            "drawing": None if self.drawing is None else str(self.drawing),
        }


def check_aircraft(aircraft: str, engine: str | None = None, out: Path | None = None) -> AircraftCheck:
    """Check an aircraft by its name or path, and draw it into the folder ``out`` if given.

    Raises InputError if the vehicle or the engine cannot be read, FlightError if the drawing cannot be written.
    """
    aircraft = aircraft_seen_from(aircraft, Path())
    engine = file_seen_from(engine, Path()) if engine else engine_of(aircraft)
    if engine is None:
        raise InputError(f"{aircraft}: vehicle.toml names no engine: name one as engine")
    vehicle, _ = load_vehicle(aircraft)
    flown = {"aircraft": aircraft, "engine": engine, "controller": BASELINE.name, "step_s": vehicle.control_step}
    flown |= {"name": "aircraft-check", "duration_s": FLIGHT_S, "initial": {"altitude_m": HEIGHT_M}}
    scenario = Scenario.from_table(flown, Path(), "aircraft-check")
    with build(scenario) as simulation:
        lines = [_check_jet_forces(simulation), _check_mass(simulation), *_check_gyration_radii(vehicle)]
        least, most = _compute_thrust_range(simulation)
        count = len(vehicle.jets)
        losses: list[tuple[int, ...]] = [(), *((jet,) for jet in range(1, count + 1))]
        reach = compute_reach(vehicle, least.tolist(), most.tolist())
        authority = [reach.authority(lost) for lost in losses]
        engine_name = simulation.engine.name
        models = [
            *_check_models(simulation),
            *(CheckLine("fuel", text) for text in note_missing_fuel_flow(vehicle, simulation.stations)),
        ]
    lines += [_check_lift(authority[0]), *_check_axes(authority, vehicle.inertia_kg_m2), *models, _fly_hover(scenario)]
    return AircraftCheck(
        vehicle.name,
        vehicle.title,
        engine_name,
        lines,
        authority,
        vehicle.inertia_kg_m2,
        None if out is None else _write_authority_drawing(vehicle, out, reach),
    )


def _authority_json(authority: Authority) -> dict[str, Any]:
    """Return the authority for JSON, with null for unknown or missing values."""
    upper_bound = authority.moment_bound
    return {
        "lost": authority.lost,
        "lift": authority.lift,
        "moment": authority.moment,
        "lift_at_most": authority.lift_bound if isfinite(authority.lift_bound) else None,
        "moment_at_most": upper_bound if upper_bound is not None and isfinite(max(upper_bound)) else None,
        "falls": authority.cannot_hover,
    }


def _check_jet_forces(simulation: Simulation, tolerance: float = 1e-9) -> CheckLine:
    """Compare each jet's force and moment in JSBSim with ``r x F``, hinges at zero and at the ends of their ranges."""
    vehicle, frame = simulation.vehicle, simulation.airframe
    layout, propulsion = vehicle.layout(), simulation.propulsion
    stances = [(0.0,) * len(vehicle.turns), *zip(*vehicle.turns, strict=True)]
    thrust = vehicle.mass_kg * GRAVITY / len(vehicle.jets)
    worst = 0.0
    for number in range(len(vehicle.jets)):
        for angles in stances:
            thrusts = tuple(thrust * (jet == number) for jet in range(len(vehicle.jets)))
            forces, applied = propulsion.forces_at_rest(thrusts, angles)
            frame.reset(simulation.scenario.initial, forces, ZERO3)
            frame.step(forces, Disturbance(), applied)
            force, moment = frame.external_wrench()
            expected = np.concatenate(layout.wrench(thrusts, angles))
            worst = max(worst, float(np.max(np.abs(np.concatenate([force, moment]) - expected))) / thrust)
    text = f"JSBSim and r x F differ by {worst:.1e} of a jet's thrust, hinges at zero and at the ends of their ranges"
    return CheckLine("forces", text, "" if worst <= tolerance else f"more than {tolerance:g}")


def _check_mass(simulation: Simulation) -> CheckLine:
    """Compare mass, centre of gravity and inertia in JSBSim with those of the vehicle."""
    vehicle, frame = simulation.vehicle, simulation.airframe
    frame.reset(simulation.scenario.initial, [ZERO3] * len(vehicle.jets), ZERO3)
    mass, cg, inertia = frame.mass_properties()
    products = frame.products_of_inertia()
    size = sqrt(max(vehicle.inertia_kg_m2) / vehicle.mass_kg)
    worst = max(
        abs(mass / vehicle.mass_kg - 1.0),
        *(abs(value) / size for value in cg),
        *(abs(value / nominal - 1.0) for value, nominal in zip(inertia, vehicle.inertia_kg_m2, strict=True)),
        *(
            abs(value - nominal) / max(vehicle.inertia_kg_m2)
            for value, nominal in zip(products, vehicle.products_kg_m2, strict=True)
        ),
    )
    text = f"{mass:.4g} kg, inertia {', '.join(f'{value:.4g}' for value in inertia)} kg m^2"
    return CheckLine("mass and inertia", text, "" if worst <= 1e-6 else f"JSBSim has others by {worst:.1e}")


def _check_gyration_radii(vehicle: Vehicle) -> list[CheckLine]:
    """Compare radii of gyration with the farthest part's distance from each axis, to detect wrong units."""
    stations, lines = np.array(points_of(vehicle)), []
    for number, (axis, moment) in enumerate(zip("xyz", vehicle.inertia_kg_m2, strict=True)):
        radius = sqrt(moment / vehicle.mass_kg)
        across = np.delete(stations, number, axis=1)
        farthest = float(np.max(np.linalg.norm(across, axis=1)))
        low, high = GYRATION_RATIO_RANGE
        fraction = radius / farthest if farthest else inf
        fault = (
            ""
            if low <= fraction <= high
            else f"is {fraction:.2g} of it, and bodies have {low:g} to {high:g}: which unit?"
        )
        text = f"radius of gyration {radius:.3g} m, the farthest part {farthest:.3g} m from the axis"
        lines.append(CheckLine(f"inertia about {axis}", text, fault))
    return lines


def _compute_thrust_range(simulation: Simulation) -> tuple[Array, Array]:
    """Return the thrust of each engine at the allocation's lower and upper limits, N."""
    limits, count = simulation.vehicle.control.allocation, len(simulation.vehicle.jets)
    ends = []
    for level in (limits.throttle_min, limits.throttle_max):
        throttle = simulation.cascade.thrust_map.throttle((level,) * count)
        curves = [spec.curve for spec in simulation.stations]
        ends.append(
            np.array([np.interp(u, curve.throttle, curve.thrust) for u, curve in zip(throttle, curves, strict=True)])
        )
    return ends[0], ends[1]


def _check_lift(whole: Authority, min_lift: float = 1.15) -> CheckLine:
    text = f"thrust in balance {whole.lift:.2f} times the weight"
    if whole.lift < 1.0:
        return CheckLine(
            "hover", text, "it does not lift off" if whole.lift_bound < 1.0 else "no balance was found that lifts it"
        )
    fault = "" if whole.lift >= min_lift else f"less than {min_lift:g}: height and attitude fight for it"
    return CheckLine("hover", text, fault)


def _check_axes(authority: Sequence[Authority], inertia: Vector3) -> list[CheckLine]:
    lines = []
    for number, axis in enumerate(AXES):
        moment = authority[0].moment_range(number)
        turn = Range(moment.lower / inertia[number], moment.upper / inertia[number])
        fault = "" if moment.lower > 0.0 else "nothing turns it while the weight is held"
        if fault and moment.upper > 0.0:
            fault = "nothing was found that turns it while the weight is held"
        text = f"{moment.describe()} N m either way in hover, {turn.describe()} rad/s^2"
        lines.append(CheckLine(f"{axis} authority", text, fault))
    balanced = [
        without.lost[0] for without in authority[1:] if min(without.moment_range(axis).lower for axis in range(3)) > 0.0
    ]
    unproven = [
        without.lost[0]
        for without in authority[1:]
        if without.lost[0] not in balanced and min(without.moment_range(axis).upper for axis in range(3)) > 0.0
    ]
    text = f"balanced, with authority about every axis, without any one of: {', '.join(map(str, balanced)) or 'none'}"
    if unproven:
        text += (
            f"; without {', '.join(map(str, unproven))} nothing was found, which does not prove that there is nothing"
        )
    return [*lines, CheckLine("one engine out", text)]


def _check_models(simulation: Simulation) -> list[CheckLine]:
    """Compare each identified model with vehicle and engine, with full and with empty tank; one line per model."""
    vehicle, lines = simulation.vehicle, []
    for family, models in vehicle.identified.items():
        scenario, engine = simulation.scenario, simulation.engine
        if family not in engine.families:
            if family not in list_engine_names():
                text = f"not compared: state as engine the file of engine {family}"
                lines += [CheckLine(f"{axis} model, {family}", text) for axis in models]
                continue
            scenario = scenario.replace(engine=family)
            engine = load_engines(scenario, vehicle)[0]
        full = compare_models(scenario, vehicle, engine)
        empty = compare_models(scenario, vehicle.with_fuel(0.0), engine, "without fuel") if vehicle.fuel else []
        compared = {axis: [agreement for agreement in (*full, *empty) if agreement.axis == axis] for axis in models}
        lines += [_summarise_agreements(axis, family, agreements) for axis, agreements in compared.items()]
    return lines


def _summarise_agreements(axis: str, family: str, agreements: Sequence[ModelAgreement]) -> CheckLine:
    """Return the line on the worst comparison with a model: a note above ``MIN_REPORTED``, a fault if it is unfit."""
    name = f"{axis} model, {family}"
    if not agreements:
        return CheckLine(name, "not compared: its sample time is not the vehicle's control step")
    worst = max(agreements, key=lambda agreement: agreement.distance)
    text = f"{worst.numbers}{f', {worst.state}' if worst.state else ''}"
    if worst.is_unfit:
        return CheckLine(name, text, f"not of this vehicle: make one with hexjet identify {axis}, or take it out")
    return CheckLine(
        name,
        f"{text}: more than {100.0 * MIN_REPORTED:.0f} % off, which predictors feel" if worst.is_noteworthy else text,
    )


def _fly_hover(scenario: Scenario) -> CheckLine:
    """Fly a calm hover with the vehicle's own gains and sensor noise, and return the result."""
    run = fly(scenario)
    if run.outcome != "completed":
        return CheckLine("a calm hover", f"{run.outcome}: {run.reason}", "does not hover with its own gains")
    log = run.log
    height = float(np.max(np.abs(log["altitude_m"] - HEIGHT_M)))
    lean = float(np.degrees(np.max(np.hypot(log["roll_rad"], log["pitch_rad"]))))
    fault = (
        "" if height <= HEIGHT_ERROR_M and lean <= LEAN_DEG else f"more than {HEIGHT_ERROR_M:g} m or {LEAN_DEG:g} deg"
    )
    text = f"{FLIGHT_S:g} s with sensor noise, controller baseline: {height:.2g} m off, leans {lean:.2g} deg"
    return CheckLine("a calm hover", text, fault)


def _write_authority_drawing(vehicle: Vehicle, out: Path, reach: Reach) -> Path:
    path = out / "aircraft.svg"
    write_files({path: three_views(vehicle), out / "authority.svg": draw_attainable_moments(vehicle, reach)})
    return path
