"""One engine out in hover: what becomes of every vehicle that an engine lifts, and what any throttle could do about it.

The flights use the gains that ``hexjet design`` finds for each engine.  Beside each of them stands a bound: the lean
that no throttles keep the vehicle from, however they are chosen, and no tilts either while it does not spin
(:meth:`cosim.campaign.surveys.lean_bound.RollAxis.least_lean`).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import hypot, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.outcomes import Verdict
from cosim.base.storage.files import map_os_errors, to_json_record, write_files, write_records
from cosim.base.storage.toml import toml_text
from cosim.campaign.study.engine_draw import default_draw
from cosim.campaign.surveys.faults import HEIGHT_M, SETTLED_S
from cosim.campaign.surveys.lean_bound import STEP_S, Bound, RollAxis, make_roll_axis, measure_courses
from cosim.campaign.surveys.survey import Progress, Subject, draw_engine, fly_all, judge_outcome, measure_flight
from cosim.design.controller_table import make_controller_table
from cosim.design.design import design
from cosim.engine import list_engine_names, load_engine
from cosim.flight import fly_watched as fly
from cosim.results.report.marks import check_marks, table, write_marks
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import ControllerFile, Requirements, read_controller, read_purpose
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import aircraft_name, load_vehicle

if TYPE_CHECKING:
    from cosim.simulation.step import Simulation

AIRCRAFT = ("hexjet", "hexjet-100", "hexjet-p220")
# the quadrotor's; a form without numbers of its own, fitted to a bench log; one whose thrust is not known
NOT_A_JET = ("motor", "fitted", "jetcat-p300")
AFTER_S = 10.0  # flown with the engine out: long enough for the slowest engines to have brought the height back or not
MIN_HOVER = 0.2  # least hover thrust over the range, chosen by us: below it an engine is slow near its idle
SINK_M_S = 0.5  # at the end: who sinks faster than an autopilot lands has not held; chosen by us
LATE_S = 0.1  # about what a monitor that reads the spool needs
Means = Literal["planned around", "opposite shut off", "opposite, found sooner"]
PLANNED: Means = "planned around"
OPPOSITE: Means = "opposite shut off"
SOONER: Means = "opposite, found sooner"
MEANS = (PLANNED, OPPOSITE, SOONER)
# of hover thrust, for the monitor: the prototype's; and the two full-scale vehicles', 3 to 4 % of the spool's speed
THRESHOLD, SOONER_THRESHOLD = 0.2, 0.1


@dataclass(frozen=True)
class Flight:
    """The outcome of one engine out at one station of one vehicle."""

    aircraft: str
    engine: str
    controller: str
    jet: int
    means: Means
    verdict: Verdict
    lean_deg: float  # largest, from upright, from the fault on
    lost_m: float  # height lost from the fault on
    drift_m: float  # furthest over the ground from where it went out
    sink_m_s: float  # at the end
    detected_s: float | None  # from the fault to the monitor's first verdict
    reason: str
    throttles_deg: (
        float  # bound of the lean with throttles alone; with the opposite engine shut off when this flight did it
    )
    bound_deg: float  # bound of the lean with throttles and tilts
    limit_deg: float  # the lean at which a flight counts as lost
    # by which every axis is level over the last second; below 0: it is not, and the less, the earlier it was lost
    margin_deg: float | None = None


@dataclass(frozen=True)
class SkippedFlight:
    """A combination that is not flown, and why."""

    aircraft: str
    engine: str
    why: str


@dataclass(frozen=True)
class EngineOut:
    """The whole table."""

    flights: list[Flight]
    left: list[SkippedFlight]
    levers: list[Lever]
    engine_notes: tuple[str, ...] = ()  # whether uncertain engines are drawn

    def to_dict(self) -> dict[str, Any]:
        """Return the table for JSON; a bound beyond the furthest that is followed is null."""
        return {
            "flights": [to_json_record(flight) for flight in self.flights],
            "left": [asdict(skipped) for skipped in self.left],
            "levers": [to_json_record(lever) for lever in self.levers],
            **({"engine_notes": list(self.engine_notes)} if self.engine_notes else {}),
        }


@dataclass(frozen=True)
class Lever:
    """A change after which an engine out need not lose the vehicle; leans are bounds for throttles alone."""

    aircraft: str
    engine: str
    limit_deg: float
    at_once_deg: float  # every throttle moves at the instant of the flame-out
    tilts_deg: float  # bound for throttles and tilts, the opposite bank tilting at once too
    late_deg: float  # bound if nothing moves for LATE_S
    half_thrust_deg: float  # bound with the same engines on half the mass and inertia
    inertia: float  # by how much J_xx would have to grow, at the same lever, for a bound at the limit
    opposite_at_once_deg: float  # the opposite engine is shut off at the same instant
    opposite_s: float  # the latest moment for that, for a bound at the limit; nan where none is early enough


# ---- the flights


def engine_out(
    aircraft: Sequence[str] = (),
    engines: Sequence[str] = (),
    designs: Path = Path("runs/engine-out-designs"),
    workers: int = 2,
    progress: Progress = lambda part, finished, total: None,
    nominal_engine: bool = False,
) -> EngineOut:
    """Fly every engine on every aircraft that it lifts, out at every station, with both means, and bound each.

    ``designs``: where the controllers are, ``ENGINE.toml`` as ``hexjet design`` writes it; one that is missing, or made
    for another aircraft, is designed and written to ``ENGINE-AIRCRAFT.toml`` there.
    An engine that states its uncertainty is drawn by it for each station, the same for all means, unless
    ``nominal_engine``.
    Raises InputError for an unknown name or a file that cannot be read.
    """
    tasks: list[tuple[Scenario, int, Means]] = []
    skipped, levers, notes = [], [], []
    for name in aircraft or AIRCRAFT:
        vehicle, _ = load_vehicle(name)
        if vehicle.servo is None:
            raise InputError(f"aircraft {name}: it has no tilting banks, and no plan for an engine that is lost")
        for engine in engines or [engine for engine in list_engine_names() if engine not in NOT_A_JET]:
            subject = Subject(name, vehicle, engine)
            controller = find_obstacle(subject) or _controller(subject, designs, progress)
            if isinstance(controller, str):
                skipped.append(SkippedFlight(name, engine, controller))
                continue
            jets = range(1, len(vehicle.jets) + 1)
            flights = [(_scenario(subject, controller, jet, means), jet, means) for jet in jets for means in MEANS]
            levers.append(_compute_lever(flights[0][0]))
            draw, note = default_draw(flights[0][0], nominal_engine)
            notes += [f"{name}, {engine}: {note}"] if note else []
            tasks += [(draw_engine(scenario, draw, f"jet {jet}"), jet, means) for scenario, jet, means in flights]
    results = fly_all(
        _fly, tasks, workers, progress, lambda flight: f"{flight.aircraft}, {flight.engine}, jet {flight.jet}"
    )
    return EngineOut(list(results), skipped, levers, tuple(notes))


def find_obstacle(subject: Subject) -> str:
    """Return why an engine cannot carry an aircraft, empty if it can.  Raises InputError for an unknown engine."""
    vehicle = subject.vehicle
    curve = load_engine(subject.engine, {}, STEP_S).curve
    weight, count = vehicle.mass_kg * GRAVITY, len(vehicle.jets)
    low, high = curve.thrust[0], curve.thrust[-1]
    largest = low + vehicle.control.allocation.throttle_max * (high - low)
    if count * largest <= weight:
        return f"cannot lift it: {count * largest:.0f} N at most for {weight:.0f} N of weight"
    if count * low >= weight:
        return f"cannot stay down: {count * low:.0f} N at idle for {weight:.0f} N of weight"
    fraction = (weight / count - low) / (high - low)
    return f"too strong: it would hover at {100.0 * fraction:.0f} % of its range" if fraction < MIN_HOVER else ""


def _controller(subject: Subject, designs: Path, progress: Progress) -> ControllerFile | str:
    """Return the engine's design for the aircraft, or why there is none."""
    aircraft, _, engine = subject
    purpose = (aircraft_name(aircraft), Path(engine).name)
    path = designs / f"{purpose[1]}-{purpose[0]}.toml"
    for candidate in (designs / f"{purpose[1]}.toml", path):
        if candidate.is_file():
            recorded = read_purpose(candidate)
            if (recorded.aircraft, Path(recorded.engine).name) == purpose:
                return read_controller(candidate, aircraft)
    progress(f"designing {aircraft} with {engine}", 0, 1)
    designed = design(engine, aircraft, need=Requirements())
    if not designed.ok:
        return f"no controller keeps the requirements of hexjet design: {designed.reason}"
    with map_os_errors(InputError, path):
        designs.mkdir(parents=True, exist_ok=True)
    write_files({path: toml_text(make_controller_table(designed, designs))})
    return read_controller(path, aircraft)


def _scenario(subject: Subject, file: ControllerFile, jet: int, means: Means) -> Scenario:
    """Return the flight of one row."""
    begin = SETTLED_S["hover"]
    threshold = SOONER_THRESHOLD if means == SOONER else THRESHOLD
    monitor = {"shut_opposite": means != PLANNED, "threshold": threshold, "catch": means == SOONER}
    return subject.scenario(
        "engine-out",
        file.controller,
        HEIGHT_M,
        begin + AFTER_S,
        vehicle=file.vehicle,
        controller_parameters=file.controller_parameters,
        step_s=STEP_S,
        fault=[{"kind": "flame_out", "start_s": begin, "jet": jet}],
    ).replace(vehicle={"control": {"monitor": monitor}})


def _fly(task: tuple[Scenario, int, Means]) -> Flight:
    scenario, jet, means = task
    run = fly(scenario)
    begin = scenario.count(SETTLED_S["hover"], "start_s")
    lean, lost, detected = measure_flight(run.log, begin)
    north, east = (run.log[name][begin:] for name in ("north_m", "east_m"))
    drift = max((hypot(n - north[0], e - east[0]) for n, e in zip(north, east, strict=True)), default=nan)
    sink = float(run.log["velocity_down_m_s"][-1])
    verdict, margin = judge_outcome(run)
    if verdict is Verdict.HELD and sink > SINK_M_S:
        verdict = Verdict.AIRBORNE
    detection = None if detected is None else detected - begin + 1
    with build(scenario) as simulation:
        shut_at = detection if means != PLANNED else None
        roll_axis = make_roll_axis(simulation)
        throttles = roll_axis.least_lean(jet, shut_at=shut_at)
        bound = roll_axis.least_lean(jet, shut_at=shut_at, tilting=True)
        limit = simulation.vehicle.limits.tilt_deg
    return Flight(
        aircraft=scenario.aircraft,
        engine=scenario.engine,
        controller=scenario.controller,
        jet=jet,
        means=means,
        verdict=verdict,
        lean_deg=lean,
        lost_m=lost,
        drift_m=float(drift),
        sink_m_s=sink,
        detected_s=None if detection is None else detection * STEP_S,
        reason=run.reason,
        throttles_deg=throttles.lean_deg,
        bound_deg=bound.lean_deg,
        limit_deg=limit,
        margin_deg=margin,
    )


def _compute_lever(scenario: Scenario) -> Lever:
    """Return what a middle engine out demands, from the bound alone."""
    with build(scenario) as simulation:
        whole = make_roll_axis(simulation)
        vehicle = simulation.vehicle
        limit = vehicle.limits.tilt_deg
        jet = max(range(1, len(vehicle.jets) + 1), key=lambda n: (vehicle.jets[n - 1].position_m[0] == 0.0, -n))
        light = _halve_mass(simulation, whole)
    late = round(LATE_S / STEP_S)

    # the later, the more it leans
    at = bisect_right(range(round(1.0 / STEP_S) + 1), limit, key=lambda at: whole.least_lean(jet, shut_at=at).lean_deg)
    return Lever(
        aircraft=scenario.aircraft,
        engine=scenario.engine,
        limit_deg=limit,
        at_once_deg=whole.least_lean(jet).lean_deg,
        tilts_deg=whole.least_lean(jet, tilting=True).lean_deg,
        late_deg=whole.least_lean(jet, after=late).lean_deg,
        half_thrust_deg=light.least_lean(jet).lean_deg if light else nan,
        inertia=_inertia_for(whole, jet, limit),
        opposite_at_once_deg=whole.least_lean(jet, shut_at=0).lean_deg,
        opposite_s=(at - 1) * STEP_S if at else nan,
    )


def _halve_mass(simulation: Simulation, whole: RollAxis) -> RollAxis | None:
    """Return the roll axis with half the mass and inertia on the same engines; None where these cannot go so low."""
    fraction = simulation.cascade.thrust_map.fraction(0.5 * whole.hover)
    if fraction <= simulation.vehicle.control.allocation.throttle_min:
        return None
    return RollAxis(simulation.vehicle, measure_courses(simulation, fraction), 0.5 * whole.hover, 0.5)


def _inertia_for(whole: RollAxis, jet: int, limit: float) -> float:
    """Return the factor of J_xx, from 1, at which the bound is ``limit`` [deg], to 1 %."""
    low, high = 1.0, 32.0
    if whole.least_lean(jet).lean_deg <= limit:
        return 1.0
    while high / low > 1.01:
        middle = (low * high) ** 0.5
        low, high = (
            (low, middle) if replace(whole, inertia=middle).least_lean(jet).lean_deg <= limit else (middle, high)
        )
    return high


# ---- what it says


HEAD = (
    "aircraft", "engine", "means", "jet 1", "jet 2", "jet 3", "jet 4", "jet 5", "jet 6", "found after",
    "bound: throttles", "and tilts",
)  # fmt: skip
LEVERS = (
    "aircraft", "engine", "at once", "and tilts", f"after {LATE_S:g} s", "half the mass", "J_xx times",
    "opposite, at once", "opposite, at the latest",
)  # fmt: skip
SKIPPED = ("aircraft", "engine", "not flown")
TABLES = {"engine-out": HEAD, "engine-out-levers": LEVERS, "engine-out-left": SKIPPED}
PAGES = {"faults.md": ("hexjet",), "full-scale.md": ("hexjet-100", "hexjet-p220")}  # aircraft described on each page


def rows(result: EngineOut, aircraft: Sequence[str]) -> dict[str, list[tuple[str, ...]]]:
    """Return the outcomes of these aircraft, the bounds for changed ones, and what was not flown, by TABLES' names."""
    return {
        "engine-out": [_row(flights) for flights in _group_flights(result, aircraft)],
        "engine-out-levers": [_lever_row(lever) for lever in result.levers if lever.aircraft in aircraft],
        "engine-out-left": [
            (skipped.aircraft, skipped.engine, skipped.why) for skipped in result.left if skipped.aircraft in aircraft
        ],
    }


def _group_flights(result: EngineOut, aircraft: Sequence[str]) -> list[list[Flight]]:
    """Return the flights grouped by vehicle, engine and means, each group in the order of the jets."""
    groups: dict[tuple[str, str, str], list[Flight]] = {}
    for flight in result.flights:
        if flight.aircraft in aircraft:
            groups.setdefault((flight.aircraft, flight.engine, flight.means), []).append(flight)
    return list(groups.values())


def _row(flights: Sequence[Flight]) -> tuple[str, ...]:
    first = flights[0]
    times = [1e3 * flight.detected_s for flight in flights if flight.detected_s is not None]
    after = "not" if not times else f"{min(times):.0f} to {max(times):.0f} ms"
    cells = [
        f"{flight.verdict}: {flight.lean_deg:.0f}°"
        + ("" if flight.verdict is Verdict.LOST else f", {flight.lost_m:.1f} m, {flight.drift_m:.1f} m")
        + (f", sinks at {flight.sink_m_s:.1f} m/s" if flight.verdict is Verdict.AIRBORNE else "")
        for flight in flights
    ]
    bounds = (_lean([flight.throttles_deg for flight in flights]), _lean([flight.bound_deg for flight in flights]))
    return (first.aircraft, first.engine, first.means, *cells, *[""] * (6 - len(cells)), after, *bounds)


def _lever_row(lever: Lever) -> tuple[str, ...]:
    return (
        lever.aircraft,
        lever.engine,
        *(_lean([x]) for x in (lever.at_once_deg, lever.tilts_deg, lever.late_deg, lever.half_thrust_deg)),
        f"{lever.inertia:.1f}",
        _lean([lever.opposite_at_once_deg]),
        "-" if lever.at_once_deg <= lever.limit_deg else f"{1e3 * lever.opposite_s:.0f} ms",
    )


def _lean(values: Sequence[float]) -> str:
    """Format the smallest and the largest of some bounds."""
    if any(value != value for value in values):
        return "-"
    least, most = (Bound(value, 0.0).words for value in (min(values), max(values)))
    return least if least == most else f"{least} to {most}"


def write_pages(result: EngineOut, folder: Path) -> list[Path]:
    """Write the tables between the marks of the pages of ``folder``.  Raises InputError if one cannot be written."""
    for page, aircraft in PAGES.items():
        tables = rows(result, aircraft)
        write_marks(folder / page, {name: table(TABLES[name], tables[name], left=3) for name in TABLES})
    return [folder / page for page in PAGES]


def check_pages(folder: Path) -> None:
    """Raise InputError if a page cannot be written or lacks a mark; called before the flights."""
    for page in PAGES:
        check_marks(folder / page, TABLES)


def write(result: EngineOut, folder: Path) -> Path:
    """Write ``engine-out.csv`` in ``folder``.  Raises InputError if it cannot be written."""
    path = folder / "engine-out.csv"
    with map_os_errors(InputError, path):
        write_records(path, Flight, result.flights)
    return path
