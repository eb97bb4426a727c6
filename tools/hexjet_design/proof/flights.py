"""The flights of a proof: hover, roll doublets and gust, at the corners of the tolerances and with one engine off.

The doublet goes to 10 deg, as the scenario states it, and to the lean that the vehicle's pilot may ask for: an engine
that surges on a fast throttle is not asked for one before.  The larger one is flown once more with one engine weaker
and slower than the others, and with one stronger and slower, because engines of a kind are not all the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import ceil, degrees, floor, pi
from typing import Any, NamedTuple

import numpy as np

from cosim.base.errors import InputError
from cosim.base.storage.toml import merge, read_toml
from cosim.flight import fly_watched as fly
from cosim.results.run import Run
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.scenario import Scenario, find_scenario
from cosim.spec.vehicle import Vehicle
from hexjet_design.controller_table import make_controller_table
from hexjet_design.design import Design
from hexjet_design.limits import Say
from hexjet_design.loop.criteria import CORNER_FACTOR, OVERSHOOT_ROOM
from hexjet_design.proof.comparison import FlownMeasures, FlownPair, measure_flight
from hexjet_design.proof.result import ProofFlight


class FlightBounds(NamedTuple):
    """Settings and limits of the proof's flights."""

    still_deg: float = 1.0  # largest swing in hover, after a doublet
    gust_deg: float = 25.0  # largest roll and pitch in a gust
    height_m: float = 2.0  # largest height error
    large_kg: float = 20.0  # heavier vehicles get a full-scale gust
    hover_s: float = 20.0
    # Relative error of gain and lag of one engine; smaller if the gain tolerance is.
    engine_spread: float = 0.3
    onset_steps: int = 6
    allowed_step: float = 0.05  # step of requirements after a failure
    stations_with_factor: int = 6  # stations with an own thrust factor


BOUNDS = FlightBounds()  # limits of the proof's flights


HOVER, DOUBLET, GUST = "hover", "doublet", "gust"  # kinds of proof flights


def fly_all(design: Design, say: Say) -> list[ProofFlight]:
    """Fly a design as designed, at tolerance corners and with one odd engine, until a corner fails.

    Raises InputError if a flight cannot be set up at all.
    """
    need, roll = design.need, design.axes["roll"]
    later = floor(need.delay_samples(roll.channel.transport_samples))
    low, high = 1.0 - need.gain_tolerance, 1.0 + need.gain_tolerance
    corners = dict.fromkeys([(1.0, 0), (low, 0), (high, 0), (low, later), (high, later)])
    tables = flight_tables(design)
    flights: list[ProofFlight] = []
    for gain, steps in corners:
        for name, table in tables.items():
            say(f"flight: {name}, gain {gain:.2f}, {steps} steps later")
            flights.append(fly_corner(design, name, table, gain, steps))
        if any(flight.fault for flight in flights[-len(tables) :]):
            return flights  # one failed corner is enough
    spread = spread_of(need)
    for factor in (1.0 - spread, 1.0 + spread) if spread else ():
        say(f"flight: one engine with {factor:.2f} of its thrust")
        flights.append(fly_with_odd_engine(design, tables, factor))
    return flights


def spread_of(need: Requirements) -> float:
    """Return the relative deviation of gain and lag of one engine in a proof."""
    return min(BOUNDS.engine_spread, need.gain_tolerance) if need.engine_spread is None else need.engine_spread


def find_allowing(design: Design, flights: Sequence[ProofFlight], say: Say) -> dict[str, float]:
    """Return the requirement that failed flights would need relaxed, and the largest value that passes.

    The values are whole twentieths below the one that was flown, found by bisection; the gains stay.  Empty where a
    flight as designed failed: no tolerance is in its way.
    """
    bad = [flight for flight in flights if flight.fault]
    if not bad or bad[0].is_as_designed:
        return {}
    need, tables, first = design.need, flight_tables(design), bad[0]
    name, most = "engine_spread", spread_of(need)
    if not first.engine:
        name = "delay_tolerance" if first.later else "gain_tolerance"
        most = getattr(need, name)

    def fly_with_value(value: float) -> Iterator[ProofFlight]:
        if first.engine:
            yield from (fly_with_odd_engine(design, tables, factor) for factor in (1.0 - value, 1.0 + value))
            return
        gain, later = first.gain, need.model_copy(update={name: value}).delay_samples(transport)
        if not first.later:
            gain, later = (1.0 + value if gain > 1.0 else 1.0 - value), 0.0
        for flight in bad:
            yield fly_corner(design, flight.scenario, tables[flight.scenario], gain, floor(later))

    transport = design.axes["roll"].channel.transport_samples
    kept, lost = 0, ceil(most / BOUNDS.allowed_step - 1e-9)
    while lost - kept > 1:
        middle = (kept + lost) // 2
        say(f"flight: {name.replace('_', ' ')} {middle * BOUNDS.allowed_step:.2f}")
        if any(flight.fault for flight in fly_with_value(middle * BOUNDS.allowed_step)):
            lost = middle
        else:
            kept = middle
    return {name: round(kept * BOUNDS.allowed_step, 2)}


def compare_with_shipped(design: Design, flights: Sequence[ProofFlight], say: Say) -> list[FlownPair]:
    """Fly hover and doublets with shipped gains, to compare them with the designed flights."""
    tables = flight_tables(design)
    pairs = []
    for flight in flights:
        if flight.is_as_designed and flight.scenario != GUST and flight.flown is not None:
            say(f"flight: {flight.scenario}, as shipped")
            shipped = _fly_with_shipped_gains(design, flight.scenario, tables[flight.scenario])
            pairs.append(FlownPair(flight.scenario, shipped, flight.flown))
    return pairs


def lean_of(vehicle: Vehicle) -> float:
    """Return the largest lean, deg, that the pilot of the vehicle may command; at least the doublet's amplitude.

    A pilot's sticks ask for ``[control.pilot] stick_lean_rad``, the place for ``[control.position] lean_rad``.
    """
    control = vehicle.control
    leans = [control.pilot.stick_lean_rad] if control.pilot else []
    leans += [control.position.lean_rad] if control.position else []
    amplitude = float(read_toml(find_scenario("roll-doublet"))["command"][0]["amplitude"])
    return max(amplitude, round(degrees(max(leans, default=0.0)), 6))


def flight_tables(design: Design) -> dict[str, dict[str, Any]]:
    """Return the scenarios of a proof by name: hover, doublet, the doublet at full lean where that is more, gust."""
    roll = design.axes["roll"].after
    assert roll is not None
    assert roll.bandwidth_hz is not None
    width = side_s(roll.bandwidth_hz)
    doublet = read_toml(find_scenario("roll-doublet"))
    doublet = merge(doublet, {"duration_s": 1.0 + 4.0 * width})
    doublet_command = {**doublet["command"][0], "width_s": width}
    doublet["command"] = [doublet_command]
    hover = merge(read_toml(find_scenario("hover")), {"duration_s": max(BOUNDS.hover_s, 2.0 * width)})
    gust = read_toml(find_scenario("gust" if design.vehicle.mass_kg < BOUNDS.large_kg else "full-scale-gust"))
    lean = lean_of(design.vehicle)
    wide = {f"{DOUBLET} to {lean:.3g} deg": merge(doublet, {"command": [{**doublet_command, "amplitude": lean}]})}
    return {HOVER: hover, DOUBLET: doublet, **(wide if lean > doublet_command["amplitude"] else {}), GUST: gust}


def side_s(bandwidth_hz: float) -> float:
    """Return how long a side of the doublet lasts, s: twenty time constants of the loop, 3 s at least, to arrive."""
    return max(3.0, ceil(20.0 / (2.0 * pi * bandwidth_hz)))


def fly_corner(design: Design, name: str, table: Mapping[str, Any], gain: float, later: int) -> ProofFlight:
    """Fly one scenario with designed gains, plant gains times ``gain`` and ``later`` steps of delay."""
    inertia = [moment / gain for moment in design.vehicle.inertia_kg_m2]
    changes = {"vehicle": {"inertia_kg_m2": inertia} if gain != 1.0 else {}, "mismatch": {"delay_samples": later}}
    run = _fly_with_design(design, name, table, changes)
    wider = 1.0 if (gain, later) == (1.0, 0) else CORNER_FACTOR
    fault = describe_fault(name, run, _promised_overshoot(design), wider)
    return ProofFlight(name, gain, later, fault, "", measure_flight(run))


def fly_with_odd_engine(design: Design, tables: Mapping[str, dict[str, Any]], factor: float) -> ProofFlight:
    """Fly the largest doublet with ``factor`` on one engine's thrust, and likewise on its lag.

    The thrust comes to that in steps over one side of the doublet, and one more side lets the controller trim it.
    The lag is a further one before the engine, which any engine can be given.
    """
    name = [key for key in tables if key.startswith(DOUBLET)][-1]
    table = tables[name]
    command = table["command"][0]
    step, width = design.scenario.step_s, command["width_s"]
    jet, spread = _strongest_lever(design.vehicle), abs(factor - 1.0)
    onset = 1.0 - min(factor, 1.0 / factor) ** (1.0 / BOUNDS.onset_steps)
    times = [round(k * width / BOUNDS.onset_steps / step) * step for k in range(BOUNDS.onset_steps + 1)]
    loss = {"kind": "thrust_loss", "jet": jet, "share": onset}
    faults = [
        {**loss, "start_s": times[k]} if factor < 1.0 else {**loss, "start_s": 0.0, "duration_s": times[k + 1]}
        for k in range(BOUNDS.onset_steps)
    ]
    faults.append({"kind": "slow_spool", "jet": jet, "start_s": 0.0, "lag_s": spread * _engine_lag(design)})
    changes = {
        "duration_s": table["duration_s"] + 2.0 * width,
        "command": [{**command, "start_s": command["start_s"] + 2.0 * width}],
        "fault": faults,
        "monitor": False,  # no engine has failed
        "mismatch": {f"thrust_factor_{jet}": factor} if factor > 1.0 else {},
    }
    run = _fly_with_design(design, "odd-engine", table, changes)
    engine = f"engine {jet} with {factor:.2f} of its thrust and {1.0 + spread:.2f} times its lag"
    fault = describe_fault(name, run, _promised_overshoot(design), CORNER_FACTOR)
    return ProofFlight(name, 1.0, 0, fault, engine, measure_flight(run))


def _promised_overshoot(design: Design) -> float:
    after = design.axes["roll"].after
    return after.overshoot or 0.0 if after is not None else 0.0


def _strongest_lever(vehicle: Vehicle) -> int:
    """Return the jet, from 1, with a factor of its own and the largest roll lever."""
    levers = [abs(jet.position_m[1]) for jet in vehicle.jets[: BOUNDS.stations_with_factor]]
    return levers.index(max(levers)) + 1


def _engine_lag(design: Design) -> float:
    """Return the engine's lag where a loop is closed, s; with a slow zero at most the loop's time scale."""
    channel = design.axes["altitude" if design.axes["roll"].channel.is_by_servo else "roll"].channel
    lag = design.engine_dynamics.lag_s
    return lag if 0.0 < lag <= channel.time_scale_s else channel.time_scale_s


def _fly_with_design(design: Design, name: str, table: Mapping[str, Any], changes: Mapping[str, Any]) -> Run:
    controller = make_controller_table(design)
    vehicle = merge(merge(table.get("vehicle", {}), design.scenario.vehicle), controller["vehicle"])
    changes = {**changes, "vehicle": merge(vehicle, changes.get("vehicle", {}))}
    changes["controller_parameters"] = controller.get("controller_parameters", {})
    return fly(_make_scenario(design, name, table, controller["controller"], changes), report=False)


def _fly_with_shipped_gains(design: Design, name: str, table: Mapping[str, Any]) -> FlownMeasures:
    """Fly with the vehicle's own gains, and the predictor it has a model for, if any."""
    controller = design.axes["roll"].before.controller
    vehicle = merge(table.get("vehicle", {}), design.scenario.vehicle)
    scenario = _make_scenario(design, f"{name}-as-shipped", table, controller, {"vehicle": vehicle})
    try:
        return measure_flight(fly(scenario, report=False))
    except InputError as error:
        # Gains or models do not fit this engine.
        return FlownMeasures(f"cannot fly: {error}", False, {})


def _make_scenario(
    design: Design, name: str, table: Mapping[str, Any], controller: str, changes: Mapping[str, Any]
) -> Scenario:
    scenario = design.scenario
    flown = {
        "name": f"proof-{name.replace(' ', '-')}",
        "aircraft": scenario.aircraft,
        "engine": scenario.engine,
        "engine_parameters": dict(scenario.engine_parameters),
        "engine_unchecked": True,  # its response was measured before
        "step_s": scenario.step_s,
        "substeps": scenario.substeps,
        "added_delay_samples": scenario.added_delay_samples,
        "controller": controller,
        "expect": [],
        "limits": {},
        **changes,
    }
    return Scenario.from_table({**table, **flown}, scenario.folder, f"proof: {name}")


def describe_fault(name: str, run: Run, promised: float, wider: float) -> str:
    """Return in which way a flight exceeds its bounds, or an empty text; ``wider`` scales the bounds."""
    if run.outcome != "completed":
        return f"{run.outcome}, {run.reason}"
    log = run.log
    half = len(log["time_s"]) // 2
    height = float(np.abs(log["altitude_m"] - log["altitude_setpoint_m"]).max())
    for axis in ("roll", "pitch"):
        angle = np.degrees(np.abs(log[f"{axis}_rad"] - log[f"{axis}_setpoint_rad"]))
        if name == HOVER and angle[half:].max() > wider * BOUNDS.still_deg:
            return f"{axis} swings by {angle[half:].max():.1f} deg, {wider * BOUNDS.still_deg:g} at most"
        if name == GUST and angle.max() > wider * BOUNDS.gust_deg:
            return f"{axis} goes {angle.max():.0f} deg off, {wider * BOUNDS.gust_deg:g} at most"
    if name.startswith(DOUBLET) and (fault := _describe_doublet_fault(run, promised, wider)):
        return fault
    if height > wider * BOUNDS.height_m:
        return f"{height:.1f} m off its height, {wider * BOUNDS.height_m:g} at most"
    return ""


def _describe_doublet_fault(run: Run, promised: float, wider: float) -> str:
    roll = run.metrics["roll"]
    overshoot, most = (roll.overshoot_percent or 0.0) / 100.0, wider * (promised + OVERSHOOT_ROOM)
    if overshoot > most:
        return f"overshoot of {100.0 * overshoot:.0f} %, {100.0 * promised:.0f} % promised"
    swing = degrees(roll.oscillation_rad or 0.0)
    if swing > wider * BOUNDS.still_deg:
        return f"roll still swings by {swing:.1f} deg at its end, {wider * BOUNDS.still_deg:g} at most"
    return ""
