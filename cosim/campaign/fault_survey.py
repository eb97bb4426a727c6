"""Which single faults a vehicle survives, with which controller, and what decides it.

Every fault is flown at every place where it can happen, from hover and from a commanded roll, with every controller
that the vehicle has a model for.  A flight is judged by where it ends: *held* (level to a few degrees), *airborne*
(neither crashed nor diverged, and no more than that) or *lost*.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from math import degrees, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.base.constants import GRAVITY
from cosim.base.errors import FlightError, InputError
from cosim.base.signals import AXES
from cosim.base.storage.files import write_records
from cosim.base.storage.toml import merge
from cosim.campaign.workers.tasks import in_order
from cosim.control.allocation.reallocation import Attainable, attainable_sets
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.engine import load_engine
from cosim.flight import copied_controller, fly
from cosim.results.columns import jets_in
from cosim.results.metrics import wrap
from cosim.results.report.marks import table, write_marks
from cosim.results.report.page import render
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import differences, read_controller
from cosim.spec.controller_name import is_design, label
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_seen_from, engine_of, load_vehicle

if TYPE_CHECKING:
    from cosim.results.recorder import Log
    from cosim.simulation.controllers.source import Source

Verdict = Literal["held", "airborne", "lost"]
Say = Callable[[str, int, int], None]

WHOLE_CONTROLLER = "controller"  # a level: all of the cascade, the engine monitor with it
STARTS = ("hover", "roll")
TEMPLATE = Path(__file__).parent / "templates" / "survival.html"
ROLL_DEG = 10.0
HEIGHT_M = 30.0
SETTLED_S = {"hover": 1.0, "roll": 3.0}  # before the fault: in the roll, a step at 0.5 s has settled by then
AFTER_S = 6.0  # flown with the fault
LOSS, CONFIRMATION = "thrust loss, share", "confirmation of a flame-out, s"
SCANS: dict[str, list[float]] = {
    LOSS: [k / 10 for k in range(1, 11)],
    CONFIRMATION: [0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.16, 0.2, 0.3],
}
LEVEL_DEG = 5.0  # chosen by us: within this of what is asked, on every axis over the last second, the vehicle is held


@dataclass(frozen=True)
class Case:
    """One fault at one place, as a scenario states it without its start; None is a flight without a fault."""

    kind: str
    place: str
    fault: dict[str, Any] | None


@dataclass(frozen=True)
class Row:
    """What became of one flight."""

    kind: str
    place: str
    start: str
    controller: str
    verdict: Verdict
    lean_deg: float  # largest, from upright, from the fault on
    lost_m: float  # of height, from the fault on
    detected_s: float | None  # from the fault to the monitor's first verdict
    reason: str
    controller_sha256: str | None = None  # of one from outside
    case: str = ""  # its scenario, as seen from the folder of the result


@dataclass(frozen=True)
class Moments:
    """What one lost engine does before anything can be done about it, about roll."""

    thrust: float  # N, of one jet in hover
    moment: float  # N m
    acceleration: float  # rad/s^2
    late: float  # s, until the counter-moment acts: confirmation and the engines' delay
    rate: float  # rad/s, by then, had the engine gone out at once
    angle: float  # rad, by then


@dataclass(frozen=True)
class Limit:
    """How far a quantity may grow, on a grid, before the vehicle is lost."""

    quantity: str
    start: str
    controller: str
    held: list[float]  # held level there
    airborne: list[float]  # not lost there, and no more
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
    own: tuple[Source, ...] = ()  # the controllers from outside
    warnings: tuple[str, ...] = ()  # where a design is not flown as what it was made for
    scenarios: tuple[Scenario, ...] = ()  # of the rows

    @property
    def unwatched(self) -> list[str]:
        """The controllers with which no monitor watches the engines: they have to see to it themselves."""
        return [own.label for own in self.own if own.level == WHOLE_CONTROLLER]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "aircraft": self.aircraft,
            "engine": self.engine,
            "warnings": list(self.warnings),
            "own_controllers": [
                {
                    "name": own.name,
                    "level": own.level,
                    "sha256": own.sha256,
                    "engine_monitor": own.level != "controller",
                }
                for own in self.own
            ],
            "rows": [asdict(row) for row in self.rows],
            "attainable": [attainable._asdict() for attainable in self.attainable],
            "moments": None if self.moments is None else asdict(self.moments),
            "limits": [asdict(limit) for limit in self.limits],
        }


def cases(vehicle: Vehicle) -> list[Case]:
    """Every single fault at every place, its size chosen by us: large enough to matter, not hopeless."""
    kinds = [Case("none", "", None)]
    per_jet: list[tuple[str, dict[str, Any]]] = [
        ("flame-out", {"kind": "flame_out"}),
        ("stuck where it is", {"kind": "stuck_throttle"}),
        ("stuck at 70 %", {"kind": "stuck_throttle", "throttle": 0.7}),
        ("thrust loss 50 %", {"kind": "thrust_loss", "share": 0.5}),
        ("slow spool, +0.3 s", {"kind": "slow_spool", "lag_s": 0.3}),
        ("delay, +0.1 s", {"kind": "delay_growth", "delay_s": 0.1}),
    ]
    for title, fault in per_jet:
        kinds += [Case(title, f"jet {jet}", fault | {"jet": jet}) for jet in range(1, len(vehicle.jets) + 1)]
    if vehicle.ranges:
        turning = len(vehicle.actuators) - len(vehicle.surfaces)
        for title, angle, servos in (
            ("servo jam where it is", {}, vehicle.actuators),
            ("servo jam at 5 deg", {"angle_deg": 5.0}, vehicle.actuators[:turning]),
        ):
            kinds += [Case(title, name, {"kind": "servo_jam", "servo": name} | angle) for name in servos]
    biases: list[tuple[str, str, dict[str, Any]]] = [
        ("gyro bias 3 deg/s", "gyro", {"bias": [0.0524, 0.0, 0.0]}),
        ("attitude bias 3 deg", "attitude", {"bias": [0.0524, 0.0, 0.0]}),
        ("barometer bias 1 m", "barometer", {"bias": [1.0]}),
        ("gnss bias 0.5 m/s down", "gnss", {"velocity_bias": [0.0, 0.0, 0.5]}),
    ]
    kinds += [Case(title, sensor, {"kind": "sensor_bias", "sensor": sensor} | bias) for title, sensor, bias in biases]
    sensors = [sensor for _, sensor, _ in biases]
    return kinds + [
        Case(f"dropout, {sensor}", sensor, {"kind": "sensor_dropout", "sensor": sensor}) for sensor in sensors
    ]


def controllers_for(aircraft: str, engine: str, step: float) -> list[str]:
    """Of those that are compared, the ones whose model the vehicle has with this engine."""

    vehicle, _ = load_vehicle(aircraft)
    family = load_engine(engine, {}, step).family
    modelled = bool(vehicle.identified.get(family))
    return [name for name, spec in PREDICTORS.items() if spec.compared and (modelled or not spec.needs_model)]


def survival(
    aircraft: str,
    engine: str | None = None,
    controllers: Sequence[str] = (),
    kinds: Sequence[str] = (),
    workers: int = 2,
    say: Say = lambda what, done, of: None,
    limits: bool = False,
) -> Survival:
    """Fly every case; ``kinds`` are the beginnings of those to be flown, all if there are none.

    ``limits`` asks for more: how large a loss of thrust, and how long a confirmation of a flame-out, may be.
    ``engine`` None is the one that the aircraft is made for; ``say`` is told what was flown, how many are, of how many.
    Raises InputError for an unknown kind, aircraft, engine or controller.
    """

    aircraft = aircraft_seen_from(aircraft, Path())
    vehicle, _ = load_vehicle(aircraft)
    engine = engine or engine_of(aircraft) or Scenario.model_fields["engine"].default
    step = step_of(aircraft)
    chosen = [case for case in cases(vehicle) if not kinds or case.kind.startswith(tuple(kinds))]
    if not chosen:
        names = ", ".join(dict.fromkeys(case.kind for case in cases(vehicle)))
        raise InputError(f"no fault begins with {' or '.join(map(repr, kinds))}; there are: {names}")
    controllers = controllers or controllers_for(aircraft, engine, step)
    flights = [
        (case, start, controller, scenario_of(case, start, controller, aircraft, engine, step))
        for case in chosen
        for start in STARTS
        for controller in controllers
    ]
    own: dict[str, Source] = {}
    for _, _, controller, scenario in flights[: len(controllers)]:
        with build(scenario) as simulation:  # wrong input is found here, before anything is spent on it
            if simulation.own is not None:
                own[controller] = simulation.own
    warnings = tuple(
        f"{label(name)}: {text}"
        for _, _, name, scenario in flights[: len(controllers)]
        if is_design(name)
        for text in differences(scenario, Path(name))
    )
    # another file than the one that was looked at is refused by whoever flies it
    flights = [
        (case, start, name, scenario.replace(controller_sha256=own[name].sha256) if name in own else scenario)
        for case, start, name, scenario in flights
    ]
    with build(flights[0][3].replace(controller=BASELINE.name)) as simulation:
        hover, idle = simulation.cascade.allocator.hover, simulation.cascade.thrust_map.idle
        moments = _moments(vehicle, simulation.stations[0].delay)
    rows: list[Row] = []
    for row in in_order(_fly, flights, workers):
        rows.append(row)
        say(f"{row.kind}, {row.place}", len(rows), len(flights))
    scans = [
        (name, start, controller, aircraft, engine, step)
        for name in SCANS
        for start in STARTS
        for controller in controllers
    ]
    survived: list[Limit] = []
    for limit in in_order(_scan, scans, workers) if limits else ():
        survived.append(limit)
        say(limit.quantity, len(survived), len(scans))
    sets = attainable_sets(vehicle.jets, vehicle.control.allocation, hover, idle)
    scenarios = tuple(scenario for *_, scenario in flights)
    return Survival(vehicle.name, engine, rows, sets, moments, survived, tuple(own.values()), warnings, scenarios)


def step_of(aircraft: str) -> float:
    """The control step of the aircraft, s."""
    return load_vehicle(aircraft)[0].control_step


def scenario_of(case: Case, start: str, controller: str, aircraft: str, engine: str, step: float) -> Scenario:
    """The flight of one cell of the table."""
    begin = SETTLED_S[start]
    fault = [] if case.fault is None else [case.fault | {"start_s": begin}]
    gains: dict[str, Any] = {}
    if is_design(controller):
        controller, gains = _designed(Path(controller), aircraft, step)
    roll = {"kind": "step", "signal": "roll_deg", "start_s": 0.5, "amplitude": ROLL_DEG}
    return Scenario.from_table(
        {
            "name": "survival",
            "aircraft": aircraft,
            "engine": engine,
            "controller": controller,
            "vehicle": gains,
            "step_s": step,
            "duration_s": begin + AFTER_S,
            "initial": {"altitude_m": HEIGHT_M},
            "command": [roll] if start == "roll" else [],
            "fault": fault,
        },
        Path(),
        "survival",
    )


def _designed(path: Path, aircraft: str, step: float) -> tuple[str, dict[str, Any]]:
    """The built-in controller and the gains of a file of hexjet design."""

    file = read_controller(path, aircraft)
    file.check_step(path, step)
    return file.controller, file.vehicle


def _fly(flight: tuple[Case, str, str, Scenario]) -> Row:

    case, start, controller, scenario = flight
    run = fly(scenario)
    begin = scenario.count(SETTLED_S[start], "start_s")
    lean, lost, detected = judge(run.log, begin)
    return Row(
        case.kind,
        case.place,
        start,
        controller,
        verdict_of(run.outcome, run.log, scenario.step_s),
        lean,
        lost,
        None if detected is None or case.fault is None else (detected - begin + 1) * scenario.step_s,
        run.reason,
        scenario.controller_sha256,
    )


def _scan(task: tuple[str, str, str, str, str, float]) -> Limit:
    """Fly along a grid until the vehicle is lost; the fault is jet 1's."""

    quantity, start, controller, aircraft, engine, step = task
    reached: dict[Verdict, list[float]] = {"held": [], "airborne": []}
    for value in SCANS[quantity]:
        kind = {"kind": "thrust_loss", "share": value} if quantity == LOSS else {"kind": "flame_out"}
        scenario = scenario_of(Case("", "", kind | {"jet": 1}), start, controller, aircraft, engine, step)
        if quantity != LOSS:
            scenario = scenario.replace(vehicle=merge(scenario.vehicle, {"control": {"monitor": {"confirm_s": value}}}))
        run = fly(scenario)
        verdict = verdict_of(run.outcome, run.log, step)
        if verdict == "lost":
            return Limit(quantity, start, controller, reached["held"], reached["airborne"], value)
        reached[verdict].append(value)
    return Limit(quantity, start, controller, reached["held"], reached["airborne"], None)


def judge(log: Log, begin: int) -> tuple[float, float, int | None]:
    """Largest lean [deg] and height lost [m] from row ``begin`` on, and the row of the monitor's first verdict."""
    import numpy as np

    roll, pitch, height = (log[name][begin:] for name in ("roll_rad", "pitch_rad", "altitude_m"))
    if not roll.size:
        return nan, nan, None
    upright = np.cos(roll) * np.cos(pitch)
    # a column is NaN where a vehicle has no such jet
    health = np.nanmin([log[f"health_{jet}"] for jet in range(1, jets_in(log.columns) + 1)], 0)
    ill = np.flatnonzero(health < 1.0)
    lean = degrees(float(np.arccos(np.clip(upright.min(), -1.0, 1.0))))
    return lean, max(0.0, float(height[0] - height.min())), int(ill[0]) if ill.size else None


def verdict_of(outcome: str, log: Log, step: float) -> Verdict:
    import numpy as np

    if outcome != "completed":
        return "lost"
    rows = round(1.0 / step)
    worst = max(
        float(np.max(np.abs(wrap(log[f"{axis}_setpoint_rad"][-rows:] - log[f"{axis}_rad"][-rows:])))) for axis in AXES
    )
    return "held" if degrees(worst) <= LEVEL_DEG else "airborne"


def _moments(vehicle: Vehicle, delay: float | None) -> Moments | None:
    settings = vehicle.control.monitor
    if delay is None or settings is None:
        return None
    thrust = vehicle.mass_kg * GRAVITY / len(vehicle.jets)
    moment = thrust * max(abs(jet.position_m[1]) for jet in vehicle.jets)
    acceleration = moment / vehicle.inertia_kg_m2[0]
    late = settings.confirm_s + delay
    return Moments(thrust, moment, acceleration, late, acceleration * late, 0.5 * acceleration * late**2)


def write(result: Survival, folder: Path) -> dict[str, Path]:
    """``survival.csv`` and ``survival.html`` in ``folder``, the files of controllers, and in ``cases/`` every flight.

    Raises InputError if they cannot be written.
    """
    from cosim.campaign.analysis.worst_cases import write_flight

    paths = {"table": folder / "survival.csv", "report": folder / "survival.html"}
    try:
        digits = len(str(len(result.rows)))
        names = [
            "-".join([f"{n:0{digits}d}", *re.findall(r"\w+", f"{row.kind} {row.place} {row.start}")])
            for n, row in enumerate(result.rows, 1)
        ]
        cases = [write_flight(scenario, folder, name) for scenario, name in zip(result.scenarios, names, strict=False)]
        cases += [""] * (len(result.rows) - len(cases))
        result = replace(result, rows=[replace(row, case=case) for row, case in zip(result.rows, cases, strict=True)])
        write_records(paths["table"], Row, result.rows)
        controllers, table = summary(result)
        named = [label(name) for name in controllers]
        render(
            TEMPLATE,
            paths["report"],
            {},
            result=result,
            controllers=named,
            table=table,
            starts=STARTS,
            where=folder.name,
        )
        files: dict[str, Path | bytes] = {}
        for own in result.own:
            copied_controller(own, files)
        files |= {Path(name).name: Path(name) for name in controllers if is_design(name)}
        for name, source in files.items():
            assert isinstance(source, Path)
            shutil.copyfile(source, folder / name)
    except FlightError as error:
        raise InputError(str(error)) from error
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from error
    return paths


PARTS = ("faults", "faults-attainable", "faults-moments", "faults-limits")  # the marks of docs/faults.md


def write_page(result: Survival, path: Path) -> None:
    """The tables, and what explains them, between the marks of a page; see :mod:`cosim.results.report.marks`."""
    write_marks(path, page_parts(result))


def page_parts(result: Survival) -> dict[str, str]:
    """What :func:`write_page` writes, by mark."""
    controllers, lines = summary(result)
    return {
        "faults": table(
            ("fault", "from", *controllers, "detected after"),
            (
                (kind, start, *map(_cell_text, cells), _times(_predicting(controllers, cells)))
                for kind, start, cells in lines
            ),
            left=2,
        ),
        "faults-attainable": table(("lost jets", "thrust over weight", "roll moment left in hover"), _left(result)),
        "faults-moments": "" if result.moments is None else f"{_moments_in_words(result.moments)}\n",
        "faults-limits": table(
            ("what grows", "controller", *(f"from {start}" for start in STARTS)), _scanned(result), 4
        ),
    }


def _moments_in_words(moments: Moments) -> str:
    thrust, moment, acceleration = moments.thrust, moments.moment, moments.acceleration
    return (
        f"One jet in hover is {thrust:.2f} N, {moment / thrust:.2f} m off the centre: {moment:.2f} N m on "
        f"{moment / acceleration:.4f} kg m², {acceleration:.1f} rad/s². What the other five are told acts after "
        f"{moments.late:.2f} s (confirmation and delay): {moments.rate:.1f} rad/s and {moments.angle:.2f} rad by then, "
        "had it gone out at once."
    )


def _scanned(result: Survival) -> Iterator[tuple[str, ...]]:
    """Every scan of :data:`SCANS`, a row a controller."""
    known = {(limit.quantity, limit.controller, limit.start): limit for limit in result.limits}
    for quantity, controller in dict.fromkeys((limit.quantity, limit.controller) for limit in result.limits):
        cells = [known.get((quantity, controller, start)) for start in STARTS]
        yield quantity, controller, *("-" if cell is None else _reached(cell) for cell in cells)


def _reached(limit: Limit) -> str:
    """Where it is held, where no more than airborne, and the first point where it is lost."""
    grid = SCANS[limit.quantity]
    spans = [
        f"{what} {_spans(values, grid)}"
        for what, values in (("held", limit.held), ("airborne", limit.airborne))
        if values
    ]
    return ", ".join([*spans, "lost nowhere" if limit.lost_at is None else f"lost at {limit.lost_at:g}"])


def _spans(values: Sequence[float], grid: Sequence[float]) -> str:
    """Points of a grid, those beside each other as first and last."""
    spans: list[list[int]] = []
    for place in (grid.index(value) for value in values):
        if spans and spans[-1][-1] == place - 1:
            spans[-1].append(place)
        else:
            spans.append([place])
    return " and ".join(f"{grid[s[0]]:g}" + (f" to {grid[s[-1]]:g}" if len(s) > 1 else "") for s in spans)


def _cell_text(cell: Cell) -> str:
    airborne = f", {cell.airborne} airborne" if cell.airborne else ""
    return f"{cell.held} of {cell.flights}{airborne}; {cell.lean_deg:.0f}°, {cell.lost_m:.1f} m"


def _predicts(controller: str) -> bool:
    """Whether it knows of the engines' delay; of one from outside that is taken for granted."""
    return controller not in PREDICTORS or PREDICTORS[controller].needs_model


def _predicting(controllers: Sequence[str], cells: Sequence[Cell]) -> Sequence[Cell]:
    """The cells of the controllers that predict; all where none does."""
    return [cell for name, cell in zip(controllers, cells, strict=True) if _predicts(name)] or cells


def _times(cells: Sequence[Cell]) -> str:
    """First to last."""
    times = [1e3 * time for cell in cells if cell.detected_s for time in cell.detected_s]
    if not times:
        return "-"
    return f"{min(times):.0f} ms" if max(times) - min(times) < 0.5 else f"{min(times):.0f} to {max(times):.0f} ms"


def _left(result: Survival) -> Iterator[tuple[str, ...]]:
    """The attainable sets, those that come to the same on one line."""
    alike: dict[tuple[str, str], list[str]] = {}
    for attainable in result.attainable:
        roll = "cannot hover" if attainable.roll is None else f"{100.0 * attainable.roll:.0f} %"
        alike.setdefault((f"{attainable.thrust:.2f}", roll), []).append(
            " and ".join(map(str, attainable.lost)) or "none"
        )
    for (thrust, roll), lost in alike.items():
        yield "; ".join(lost), thrust, roll


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
    """The controllers, and for each kind and start what became of all its places with each of them."""
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
