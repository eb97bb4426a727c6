"""Which single faults a vehicle survives, with which controller, and what decides it.

Every fault is flown at every place where it can happen, from hover and from a commanded roll, with every controller
that the vehicle has a model for.  A flight is judged by where it ends: *held* (level to a few degrees), *airborne*
(neither crashed nor diverged, and no more than that) or *lost*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.outcomes import Verdict
from cosim.base.storage.toml import merge
from cosim.control.allocation.reallocation import Attainable, attainable_sets
from cosim.control.predictors.registry import BASELINE
from cosim.flight import fly_watched as fly
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import list_differences, read_controller
from cosim.spec.controller_name import is_design, label
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from cosim.studies import EngineDraw, default_draw
from hexjet_prove.surveys.survey import (
    Progress,
    Subject,
    draw_engine,
    fly_all,
    judge_outcome,
    load_subject,
    measure_flight,
    select_cases,
)

if TYPE_CHECKING:
    from cosim.simulation.controllers.source import Source

WHOLE_CONTROLLER = "controller"  # a level: all of the cascade, the engine monitor with it
STARTS = ("hover", "roll")
ROLL_DEG = 10.0
HEIGHT_M = 30.0
SETTLED_S = {"hover": 1.0, "roll": 3.0}  # before the fault: in the roll, a step at 0.5 s has settled by then
DROPOUTS = ("gyro", "attitude", "barometer", "gnss")
AFTER_S = 6.0  # flown with the fault
LOSS, CONFIRMATION = "thrust loss, share", "confirmation of a flame-out, s"
SCANS: dict[str, list[float]] = {
    LOSS: [k / 10 for k in range(1, 11)],
    CONFIRMATION: [0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.16, 0.2, 0.3],
}


class Case(NamedTuple):
    """One fault at one place, as a scenario states it without its start; None is a flight without a fault."""

    kind: str
    place: str
    fault: dict[str, Any] | None


@dataclass(frozen=True)
class Row:
    """The outcome of one flight."""

    kind: str
    place: str
    start: str
    controller: str
    verdict: Verdict
    lean_deg: float  # largest, from upright, from the fault on
    lost_m: float  # height lost from the fault on
    detected_s: float | None  # from the fault to the monitor's first verdict
    reason: str
    controller_sha256: str | None = None  # of one from outside
    margin_deg: float | None = None  # by which it is held; below 0: it is not, and the less, the earlier it was lost
    case: str = ""  # its scenario, as seen from the folder of the result


@dataclass(frozen=True)
class Moments:
    """The effect of one lost engine about roll before anything can be done about it."""

    thrust: float  # N, of one jet in hover
    moment: float  # N m
    acceleration: float  # rad/s^2
    late: float  # s, until the counter-moment acts: confirmation and the engines' delay
    rate: float  # rad/s, by then, had the engine gone out at once
    angle: float  # rad, by then


@dataclass(frozen=True)
class Limit:
    """The largest value of a quantity, on a grid, before the vehicle is lost."""

    quantity: str
    start: str
    controller: str
    held: list[float]  # held level there
    airborne: list[float]  # airborne there, whether held level or not
    lost_at: float | None  # the first point where it is lost; None: nowhere on the grid


@dataclass(frozen=True)
class Survival:
    """The whole table, and what explains it."""

    aircraft: str
    engine: str
    rows: list[Row]
    attainable: list[Attainable]
    moments: Moments | None  # of a vehicle whose engines have a known delay
    limits: list[Limit]  # empty if they were not asked for
    custom_controllers: tuple[Source, ...] = ()  # the controllers from outside
    warnings: tuple[str, ...] = ()  # where a design is not flown as what it was made for
    scenarios: tuple[Scenario, ...] = ()  # of the rows
    engine_note: str = ""  # whether an uncertain engine is drawn

    @property
    def unmonitored_controllers(self) -> list[str]:
        """The controllers with which no monitor watches the engines: they have to see to it themselves."""
        return [source.label for source in self.custom_controllers if source.level == WHOLE_CONTROLLER]

    def to_dict(self) -> dict[str, Any]:
        """Return the table for JSON."""
        return {
            "aircraft": self.aircraft,
            "engine": self.engine,
            **({"engine_note": self.engine_note} if self.engine_note else {}),
            "warnings": list(self.warnings),
            "own_controllers": [
                {"name": source.name, "level": source.level, "sha256": source.sha256}
                | {"engine_monitor": source.level != WHOLE_CONTROLLER}
                for source in self.custom_controllers
            ],
            "rows": [asdict(row) for row in self.rows],
            "attainable": [attainable._asdict() for attainable in self.attainable],
            "moments": None if self.moments is None else asdict(self.moments),
            "limits": [asdict(limit) for limit in self.limits],
        }


def cases(vehicle: Vehicle) -> list[Case]:
    """Return every single fault at every place; its size is chosen by us: large enough to matter, not hopeless."""
    jets = [f"jet {jet}" for jet in range(1, len(vehicle.jets) + 1)]
    bank_servos = vehicle.actuators[: len(vehicle.actuators) - len(vehicle.surfaces)]
    servos = (vehicle.actuators, bank_servos) if vehicle.ranges else ((), ())
    kinds: list[tuple[str, Sequence[str], dict[str, Any]]] = [
        ("flame-out", jets, {"kind": "flame_out"}),
        ("stuck where it is", jets, {"kind": "stuck_throttle"}),
        ("stuck at 70 %", jets, {"kind": "stuck_throttle", "throttle": 0.7}),
        ("thrust loss 50 %", jets, {"kind": "thrust_loss", "share": 0.5}),
        ("slow spool, +0.3 s", jets, {"kind": "slow_spool", "lag_s": 0.3}),
        ("delay, +0.1 s", jets, {"kind": "delay_growth", "delay_s": 0.1}),
        ("servo jam where it is", servos[0], {"kind": "servo_jam"}),
        ("servo jam at 5 deg", servos[1], {"kind": "servo_jam", "angle_deg": 5.0}),
        ("gyro bias 3 deg/s", ("gyro",), {"kind": "sensor_bias", "bias": [0.0524, 0.0, 0.0]}),
        ("attitude bias 3 deg", ("attitude",), {"kind": "sensor_bias", "bias": [0.0524, 0.0, 0.0]}),
        ("barometer bias 1 m", ("barometer",), {"kind": "sensor_bias", "bias": [1.0]}),
        ("gnss bias 0.5 m/s down", ("gnss",), {"kind": "sensor_bias", "velocity_bias": [0.0, 0.0, 0.5]}),
        *((f"dropout, {name}", (name,), {"kind": "sensor_dropout"}) for name in DROPOUTS),
    ]
    return [Case("none", "", None)] + [
        Case(title, place, fault | _location(fault["kind"], place))
        for title, places, fault in kinds
        for place in places
    ]


def _location(kind: str, place: str) -> dict[str, Any]:
    """Return where a fault is, as a scenario has it."""
    if place.startswith("jet "):
        return {"jet": int(place.removeprefix("jet "))}
    return {"servo" if kind == "servo_jam" else "sensor": place}


class _Flight(NamedTuple):
    case: Case
    start: str
    controller: str
    scenario: Scenario


def survival(
    aircraft: str,
    engine: str | None = None,
    controllers: Sequence[str] = (),
    kinds: Sequence[str] = (),
    workers: int = 2,
    progress: Progress = lambda part, finished, total: None,
    limits: bool = False,
    nominal_engine: bool = False,
) -> Survival:
    """Fly every case; ``kinds`` are the beginnings of those to be flown, all if there are none.

    ``limits`` asks for more: how large a loss of thrust, and how long a confirmation of a flame-out, may be.
    ``engine`` None is the one that the aircraft is made for.  ``progress`` is told what was flown, how many flights
    are, and of how many.
    An engine that states its uncertainty is drawn by it for each case and start, the same for every controller, unless
    ``nominal_engine``.
    Raises InputError for an unknown kind, aircraft, engine or controller.
    """
    subject = load_subject(aircraft, engine)
    vehicle = subject.vehicle
    chosen = select_cases(cases(vehicle), kinds, "fault", lambda case: case.kind)
    controllers = controllers or subject.controllers()
    flights = [
        _Flight(case, start, controller, scenario_of(subject, case, start, controller))
        for case in chosen
        for start in STARTS
        for controller in controllers
    ]
    first_flights = flights[: len(controllers)]
    custom = _custom_controllers(first_flights)
    warnings = tuple(
        f"{label(flight.controller)}: {text}"
        for flight in first_flights
        if is_design(flight.controller)
        for text in list_differences(flight.scenario, Path(flight.controller))
    )
    draw, note = default_draw(flights[0].scenario, nominal_engine)
    with build(flights[0].scenario.replace(controller=BASELINE.name)) as simulation:
        hover, idle = simulation.cascade.allocator.hover, simulation.cascade.thrust_map.idle
        moments = _moments(vehicle, simulation.stations[0].transport_delay)
    flights = [flight._replace(scenario=_finish(flight, custom, draw)) for flight in flights]
    rows = list(fly_all(_fly, flights, workers, progress, lambda row: f"{row.kind}, {row.place}"))
    scans = [
        (subject, name, start, controller, draw) for name in SCANS for start in STARTS for controller in controllers
    ]
    reached = list(fly_all(_scan, scans, workers, progress, lambda limit: limit.quantity)) if limits else []
    sets = attainable_sets(vehicle.jets, vehicle.control.allocation, hover, idle)
    scenarios = tuple(flight.scenario for flight in flights)
    return Survival(
        vehicle.name, subject.engine, rows, sets, moments, reached, tuple(custom.values()), warnings, scenarios, note
    )


def _custom_controllers(flights: Sequence[_Flight]) -> dict[str, Source]:
    """Return the controllers from outside, by name; wrong input is found here, before anything is spent on it."""
    sources: dict[str, Source] = {}
    for flight in flights:
        with build(flight.scenario) as simulation:
            if simulation.controller_source is not None:
                sources[flight.controller] = simulation.controller_source
    return sources


def _finish(flight: _Flight, sources: dict[str, Source], draw: EngineDraw | None) -> Scenario:
    """Return the scenario with its engine drawn and its controller's hash: another file is refused by who flies it."""
    case, start, controller, scenario = flight
    scenario = draw_engine(scenario, draw, f"{case.kind} {case.place} {start}")
    source = sources.get(controller)
    return scenario if source is None else scenario.replace(controller_sha256=source.sha256)


def scenario_of(subject: Subject, case: Case, start: str, controller: str, step: float | None = None) -> Scenario:
    """Return the flight of one cell of the table.  Raises InputError for a design of another control step."""
    step, begin = step or subject.vehicle.control_step, SETTLED_S[start]
    gains: dict[str, Any] = {}
    parameters: dict[str, float] = {}
    if is_design(controller):
        path = Path(controller)
        file = read_controller(path, subject.aircraft)
        file.check_step(path, step)
        controller, parameters, gains = file.controller, file.controller_parameters, file.vehicle
    roll = {"kind": "step", "signal": "roll_deg", "start_s": 0.5, "amplitude": ROLL_DEG}
    return subject.scenario(
        "survival",
        controller,
        HEIGHT_M,
        begin + AFTER_S,
        vehicle=gains,
        controller_parameters=parameters,
        step_s=step,
        command=[roll] if start == "roll" else [],
        fault=[] if case.fault is None else [case.fault | {"start_s": begin}],
    )


def _fly(flight: _Flight) -> Row:
    case, start, controller, scenario = flight
    run = fly(scenario)
    begin = scenario.count(SETTLED_S[start], "start_s")
    lean, lost, detected = measure_flight(run.log, begin)
    verdict, margin = judge_outcome(run)
    return Row(
        case.kind,
        case.place,
        start,
        controller,
        verdict,
        lean,
        lost,
        None if detected is None or case.fault is None else (detected - begin + 1) * scenario.step_s,
        run.reason,
        scenario.controller_sha256,
        margin_deg=margin,
    )


def _scan(task: tuple[Subject, str, str, str, EngineDraw | None]) -> Limit:
    """Fly along a grid until the vehicle is lost; the fault is jet 1's, the engine the same all along."""
    subject, quantity, start, controller, draw = task
    passed: dict[Verdict, list[float]] = {Verdict.HELD: [], Verdict.AIRBORNE: []}
    lost_at = None
    for value in SCANS[quantity]:
        kind = {"kind": "thrust_loss", "share": value} if quantity == LOSS else {"kind": "flame_out"}
        scenario = scenario_of(subject, Case("", "", kind | {"jet": 1}), start, controller)
        if quantity != LOSS:
            scenario = scenario.replace(vehicle=merge(scenario.vehicle, {"control": {"monitor": {"confirm_s": value}}}))
        run = fly(draw_engine(scenario, draw, f"{quantity} {start}"))
        verdict, _ = judge_outcome(run)
        if verdict is Verdict.LOST:
            lost_at = value
            break
        passed[verdict].append(value)
    return Limit(quantity, start, controller, passed[Verdict.HELD], passed[Verdict.AIRBORNE], lost_at)


def _moments(vehicle: Vehicle, delay: float | None) -> Moments | None:
    monitor = vehicle.control.monitor
    if delay is None or monitor is None:
        return None
    thrust = vehicle.mass_kg * GRAVITY / len(vehicle.jets)
    moment = thrust * max(abs(jet.position_m[1]) for jet in vehicle.jets)
    acceleration = moment / vehicle.inertia_kg_m2[0]
    reaction_s = monitor.confirm_s + delay
    return Moments(
        thrust, moment, acceleration, reaction_s, acceleration * reaction_s, 0.5 * acceleration * reaction_s**2
    )


@dataclass(frozen=True)
class Cell:
    """All places of one kind of fault from one start with one controller."""

    held: int
    airborne: int
    flights: int
    lean_deg: float  # the largest
    lost_m: float
    detected_s: tuple[float, float] | None  # first and last


def summary(result: Survival) -> tuple[list[str], list[tuple[str, str, list[Cell]]]]:
    """Return the controllers, and for each kind and start the outcomes over all jets with each of them."""
    controllers = list(dict.fromkeys(row.controller for row in result.rows))
    lines = []
    for kind, start in dict.fromkeys((row.kind, row.start) for row in result.rows):
        rows = [row for row in result.rows if (row.kind, row.start) == (kind, start)]
        lines.append((kind, start, [_cell([row for row in rows if row.controller == name]) for name in controllers]))
    return controllers, lines


def _cell(rows: Sequence[Row]) -> Cell:
    times = [row.detected_s for row in rows if row.detected_s is not None]
    return Cell(
        held=sum(row.verdict == "held" for row in rows),
        airborne=sum(row.verdict == "airborne" for row in rows),
        flights=len(rows),
        lean_deg=max(row.lean_deg for row in rows),
        lost_m=max(row.lost_m for row in rows),
        detected_s=(min(times), max(times)) if times else None,
    )
