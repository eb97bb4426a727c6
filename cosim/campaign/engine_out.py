"""One engine out in hover: what becomes of every vehicle that an engine lifts, and what any throttle could do about it.

The flights use the gains that ``hexjet design`` finds for each engine.  Beside each of them stands a bound: the lean
that no throttles keep the vehicle from, however they are chosen, and no tilts either while it does not spin
(:meth:`Roller.least_lean`).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from math import cos, degrees, exp, hypot, inf, isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.storage.files import finite, write_files, write_records
from cosim.base.storage.toml import toml_text
from cosim.campaign.fault_survey import (
    HEIGHT_M,
    SETTLED_S,
    Say,
    judge,
    verdict_of,
)
from cosim.campaign.workers.tasks import in_order
from cosim.design.controller_table import controller_table
from cosim.design.design import design
from cosim.engine import engine_names, load_engine, make_bank
from cosim.engine.wrappers import EngineChain
from cosim.flight import fly
from cosim.results.report.marks import check_marks, table, write_marks
from cosim.simulation.build import build, opposites
from cosim.simulation.controllers.controller_file import ControllerFile, Requirements, purpose_of, read_controller
from cosim.simulation.engine_reference import engine_reference
from cosim.spec.scenario import FlameOut, Scenario
from cosim.spec.vehicle import Vehicle, aircraft_name, load_vehicle
from cosim.vehicle.parts.servo import TiltServo

if TYPE_CHECKING:
    from cosim.engine import EngineSpec
    from cosim.simulation.step import Simulation

AIRCRAFT = ("hexjet", "hexjet-100", "hexjet-p220")
NOT_A_JET = ("motor",)  # the quadrotor's
AFTER_S = 10.0  # flown with the engine out: long enough for the slowest engines to have brought the height back or not
LEAST_HOVER = 0.2  # of the range of thrust, chosen by us: below it an engine is the wrong one, slow near its idle
FURTHEST_DEG = 180.0  # beyond it the bound is not followed: it has gone over
STEP_S = 0.004
FOLLOWED_S = 2.0  # the slowest engine of the library needs less than 1.5 s to 180 deg, or to come back
SINK_M_S = 0.5  # at the end: who sinks faster than an autopilot lands has not held; chosen by us
Means = Literal["planned around", "opposite shut off", "opposite, found sooner"]
PLANNED: Means = "planned around"
OPPOSITE: Means = "opposite shut off"
SOONER: Means = "opposite, found sooner"
MEANS = (PLANNED, OPPOSITE, SOONER)
# of hover thrust, for the monitor: the prototype's; and the two full-scale vehicles', 3 to 4 % of the spool's speed
THRESHOLD, SOONER_THRESHOLD = 0.2, 0.1


@dataclass(frozen=True)
class Bound:
    """The least lean that was within reach, and when."""

    lean_deg: float  # inf: beyond FURTHEST_DEG
    time_s: float  # from the flame-out to the moment at which it is reached

    @property
    def words(self) -> str:
        return f"{self.lean_deg:.0f}°" if isfinite(self.lean_deg) else f"over {FURTHEST_DEG:.0f}°"


@dataclass(frozen=True)
class HeightLoss:
    """The least height that was to be lost [m], the fastest sinking on the way, and that with which a given height [m]
    was fallen, 0 where it was not [m/s]."""

    lost_m: float
    sink_m_s: float
    touch_m_s: float


@dataclass(frozen=True)
class Flight:
    """One engine out at one station of one vehicle, and what became of it."""

    aircraft: str
    engine: str
    controller: str
    jet: int
    means: Means
    verdict: str
    lean_deg: float  # largest, from upright, from the fault on
    lost_m: float  # of height, from the fault on
    drift_m: float  # furthest over the ground from where it went out
    sink_m_s: float  # at the end
    detected_s: float | None  # from the fault to the monitor's first verdict
    reason: str
    throttles_deg: float  # no throttles lean less; with the opposite engine shut off when this flight did it
    bound_deg: float  # no throttles and tilts do
    limit_deg: float  # the lean at which a flight counts as lost


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

    def to_dict(self) -> dict[str, Any]:
        """For JSON; a bound beyond the furthest that is followed is null."""
        return {
            "flights": [finite(flight) for flight in self.flights],
            "left": [asdict(left) for left in self.left],
            "levers": [finite(lever) for lever in self.levers],
        }


@dataclass(frozen=True)
class Lever:
    """What could be changed so that an engine out need not lose the vehicle; leans are bounds for throttles alone."""

    aircraft: str
    engine: str
    limit_deg: float
    at_once_deg: float  # every throttle moves at the instant of the flame-out
    tilts_deg: float  # so does the bank across from it: bound for throttles and tilts
    late_deg: float  # nothing moves for LATE_S
    half_thrust_deg: float  # the same engines on half the mass and inertia
    inertia: float  # by how much J_xx would have to grow, at the same lever, for a bound at the limit
    opposite_at_once_deg: float  # the opposite engine is shut off at the same instant
    opposite_s: float  # the latest moment for that, for a bound at the limit; nan where none is early enough


LATE_S = 0.1  # about what a monitor that reads the spool needs


# ---- the bound


class ThrustCourses:
    """The fastest that an engine's thrust can rise, fall and vanish from hover, by stepping the engine itself [N].

    An engine whose thrust at every later time grows with every throttle before cannot leave the strip between what
    full and least throttle give; a test throws random throttles at each of the library's.
    """

    def __init__(self, spec: EngineSpec, hover: float, least: float, most: float, steps: int) -> None:
        """``hover``, ``least``, ``most``: throttles."""
        self._spec, self._hover, self._least = spec, hover, least
        self._steps = steps
        self.up = self._run(lambda k: most)
        self.down = self._run(lambda k: least)
        self.out = self._run(lambda k: hover, out_at=0)
        self._shut: dict[int, list[float]] = {}

    def shut(self, at: int) -> list[float]:
        """Least throttle from the start and shut off from step ``at`` on."""
        if at not in self._shut:
            self._shut[at] = self._run(lambda k: self._least, shut_at=at)
        return self._shut[at]

    def _run(self, throttle: Callable[[int], float], out_at: int = -1, shut_at: int = -1) -> list[float]:

        spec = self._spec
        courses = []
        with make_bank([spec], STEP_S) as bank:
            engines = EngineChain(bank, [spec.flame_out], lambda _: engine_reference(spec, STEP_S).lag, STEP_S)
            engines.reset(self._hover)
            for k in range(self._steps):
                if k == out_at:
                    engines.begin(FlameOut(kind="flame_out", start_s=0.0, jet=[1]))
                if k == shut_at:
                    engines.switch(0, False)
                courses.append(engines.step(k, (throttle(k),)).thrust[0])
        return courses


@dataclass(frozen=True)
class RollAxis:
    """What turns a vehicle about its rolling axis, and how it may be changed."""

    vehicle: Vehicle
    courses: ThrustCourses
    hover: float  # N, of a jet
    inertia: float = 1.0  # over that of the vehicle

    def least_lean(self, jet: int, after: int = 0, shut_at: int | None = None, tilting: bool = False) -> Bound:
        """The lean that no throttles avoid with jet ``jet`` (from 1) out, knowing it from step ``after`` on.

        Roll obeys ``J p' = M - c p``, ``phi' = p``, with ``M = -sum y_i T_i cos(tilt_i)`` and damping c.  Full throttle
        beside the engine that is out and least throttle across from it, with ``tilting`` also the largest tilt there,
        make M the least that it can be at every instant at once, so that p and phi are the least at every instant
        until p comes back to 0.  A vehicle that is to be held has to come back to p = 0, and no control does so earlier
        or at a smaller phi.

        Optimistic: whatever else throttles and tilts do (pitch, yaw, height, the way back) costs nothing.  Left out: a
        vehicle that spins about its vertical axis meanwhile, by banks tilted apart.  It carries its lean round with
        it, and can lean less than either bound; throttles alone cannot make it spin.
        ``shut_at``: the opposite engine is shut off from that step on.
        """
        vehicle, courses = self.vehicle, self.courses
        side = 1.0 if vehicle.jets[jet - 1].position_m[1] > 0.0 else -1.0
        other = opposite_of(vehicle, jet) if shut_at is not None else 0
        held = [self.hover] * after
        falling = courses.shut(shut_at) if shut_at is not None else []
        inertia = self.inertia * vehicle.inertia_kg_m2[0]
        kept = exp(-_damping(vehicle) * STEP_S / inertia)
        p = phi = 0.0
        upright = _upright(vehicle, after) if tilting else [1.0]
        for k in range(len(courses.up)):
            moment = 0.0
            for number, station in enumerate(vehicle.jets, 1):
                lever = station.position_m[1]
                if number == jet:
                    thrust = courses.out[k]
                elif number == other:
                    thrust = falling[k] * next_or(upright, k)
                elif lever * side > 0.0:
                    thrust = held[k] if k < after else courses.up[k - after]
                else:
                    thrust = (held[k] if k < after else courses.down[k - after]) * next_or(upright, k)
                moment -= side * lever * thrust
            before = p
            p = kept * p + STEP_S * moment / inertia
            if p <= 0.0:
                return Bound(degrees(phi), (k + 1) * STEP_S)
            phi += 0.5 * STEP_S * (before + p)
            if degrees(phi) > FURTHEST_DEG:
                break
        return Bound(float("inf"), (k + 1) * STEP_S)

    def least_fall(self, after: int = 0, height: float = inf) -> HeightLoss:
        """What no throttles avoid of a fall with one jet out and another, the opposite one, shut off with it.

        ``m v' = m g - sum T_i`` with the four others at full throttle from that instant on, or from step ``after``,
        before which no throttle moves, and nothing of their thrust lost to lean or to holding the attitude.  ``height``
        [m]: below the legs.  Raises ValueError where the fall does not end within the courses.
        """
        courses = self.courses
        up = [self.hover] * after + courses.up
        falling = [self.hover] * after + courses.shut(0)
        sink = lost = fastest = touch = 0.0
        for k in range(len(courses.up)):
            thrust = courses.out[k] + falling[k] + (len(self.vehicle.jets) - 2) * up[k]
            before = sink
            sink += STEP_S * (GRAVITY - thrust / self.vehicle.mass_kg)
            if sink < 0.0:
                return HeightLoss(lost, fastest, touch)
            above = lost < height
            lost += 0.5 * STEP_S * (before + sink)
            fastest = max(fastest, sink)
            touch = sink if above and lost >= height else touch
        raise ValueError("the engines were not followed for long enough to stop the fall")


def next_or(values: Sequence[float], k: int) -> float:
    """The value of step ``k``, the last where there are no more."""
    return values[k] if k < len(values) else values[-1]


def _upright(vehicle: Vehicle, after: int) -> list[float]:
    """The share of its thrust that a bank keeps upright, tilted as far and as fast as its servo goes."""

    if vehicle.servo is None:
        return [1.0]
    servo = TiltServo(vehicle.servo, STEP_S)
    steps = round(20.0 * vehicle.servo.lag_s / STEP_S) + round(2.0 / STEP_S)
    return [1.0] * after + [cos(servo.update(vehicle.servo.range_rad)) for _ in range(steps)]


def _damping(vehicle: Vehicle) -> float:
    """N m s: the airframe's, and that of six streams at full flow, which is more than they have."""
    damping = vehicle.aero.damping_n_m_s[0]
    flow = vehicle.airflow
    if flow is not None:
        damping += sum(flow.kg_s * (jet.position_m[2] - flow.exhaust_m) ** 2 for jet in vehicle.jets)
    return damping


def opposite_of(vehicle: Vehicle, jet: int) -> int:
    """The jet, from 1, across the centre of gravity."""

    return opposites(vehicle)[jet - 1] + 1


def courses_of(simulation: Simulation, share: float, seconds: float = FOLLOWED_S) -> ThrustCourses:
    """Of the engines of a built flight, all alike, from a ``share`` of their range of thrust on."""
    limits = simulation.vehicle.control.allocation
    count = len(simulation.vehicle.jets)
    hover, least, most = (
        simulation.cascade.thrust_map.throttle((level,) * count)[0]
        for level in (share, limits.throttle_min, limits.throttle_max)
    )
    return ThrustCourses(simulation.engine, hover, least, most, round(seconds / STEP_S))


def roller(simulation: Simulation, seconds: float = FOLLOWED_S) -> RollAxis:
    """For the vehicle of a built flight, all of whose engines are alike; ``seconds``: how long they are followed."""
    vehicle = simulation.vehicle
    courses = courses_of(simulation, simulation.cascade.allocator.hover, seconds)
    return RollAxis(vehicle, courses, vehicle.mass_kg * GRAVITY / len(vehicle.jets))


# ---- the flights


def engine_out(
    aircraft: Sequence[str] = (),
    engines: Sequence[str] = (),
    designs: Path = Path("runs/engine-out-designs"),
    workers: int = 2,
    say: Say = lambda what, done, of: None,
) -> EngineOut:
    """Fly every engine on every aircraft that it lifts, out at every station, with both means, and bound each.

    ``designs``: where the controllers are, ``ENGINE.toml`` as ``hexjet design`` writes it; one that is missing, or made
    for another aircraft, is designed and written to ``ENGINE-AIRCRAFT.toml`` there.
    Raises InputError for an unknown name or a file that cannot be read.
    """

    aircraft = aircraft or AIRCRAFT
    engines = engines or [name for name in engine_names() if name not in NOT_A_JET]
    tasks: list[tuple[Scenario, int, Means]] = []
    left, levers = [], []
    for vehicle in aircraft:
        if load_vehicle(vehicle)[0].servo is None:
            raise InputError(f"aircraft {vehicle}: it has no tilting banks, and no plan for an engine that is lost")
        for engine in engines:
            chosen = unfit(vehicle, engine) or _controller(vehicle, engine, designs, say)
            if isinstance(chosen, str):
                left.append(SkippedFlight(vehicle, engine, chosen))
                continue
            flights = [
                (_scenario(vehicle, engine, chosen, jet, means), jet, means)
                for jet in range(1, len(load_vehicle(vehicle)[0].jets) + 1)
                for means in MEANS
            ]
            tasks += flights
            levers.append(_levers(flights[0][0]))
    results: list[Flight] = []
    for flight in in_order(_fly, tasks, workers):
        results.append(flight)
        say(f"{flight.aircraft}, {flight.engine}, jet {flight.jet}", len(results), len(tasks))
    return EngineOut(results, left, levers)


def unfit(aircraft: str, engine: str) -> str:
    """Why an engine cannot carry an aircraft, empty if it can.  Raises InputError for an unknown name."""

    vehicle, _ = load_vehicle(aircraft)
    spec = load_engine(engine, {}, STEP_S)
    weight, count = vehicle.mass_kg * GRAVITY, len(vehicle.jets)
    low, high = spec.curve.thrust[0], spec.curve.thrust[-1]
    most = low + vehicle.control.allocation.throttle_max * (high - low)
    if count * most <= weight:
        return f"cannot lift it: {count * most:.0f} N at most for {weight:.0f} N of weight"
    if count * low >= weight:
        return f"cannot stay down: {count * low:.0f} N at idle for {weight:.0f} N of weight"
    share = (weight / count - low) / (high - low)
    if share < LEAST_HOVER:
        return f"too strong: it would hover at {100.0 * share:.0f} % of its range"
    return ""


def _controller(aircraft: str, engine: str, designs: Path, say: Say) -> ControllerFile | str:
    """The engine's design for the aircraft, or why there is none."""
    name = Path(engine).name
    for path in (designs / f"{name}.toml", designs / f"{name}-{aircraft_name(aircraft)}.toml"):
        if path.is_file():
            made = purpose_of(path)
            if (made.aircraft, Path(made.engine).name) == (aircraft_name(aircraft), name):
                return read_controller(path, aircraft)
    say(f"designing {aircraft} with {engine}", 0, 1)
    designed = design(engine, aircraft, need=Requirements())
    if not designed.ok:
        return f"no controller keeps the requirements of hexjet design: {designed.reason}"
    path = designs / f"{name}-{aircraft_name(aircraft)}.toml"
    try:
        designs.mkdir(parents=True, exist_ok=True)
        write_files({path: toml_text(controller_table(designed))})
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    return read_controller(path, aircraft)


def _scenario(aircraft: str, engine: str, file: ControllerFile, jet: int, means: Means) -> Scenario:
    """The flight of one row."""
    begin = SETTLED_S["hover"]
    threshold = SOONER_THRESHOLD if means == SOONER else THRESHOLD
    monitor = {"shut_opposite": means != PLANNED, "threshold": threshold, "catch": means == SOONER}
    return Scenario.from_table(
        {
            "name": "engine-out",
            "aircraft": aircraft,
            "engine": engine,
            "controller": file.controller,
            "vehicle": file.vehicle,
            "step_s": STEP_S,
            "duration_s": begin + AFTER_S,
            "initial": {"altitude_m": HEIGHT_M},
            "fault": [{"kind": "flame_out", "start_s": begin, "jet": jet}],
        },
        Path(),
        "engine-out",
    ).replace(vehicle={"control": {"monitor": monitor}})


def _fly(task: tuple[Scenario, int, Means]) -> Flight:

    scenario, jet, means = task
    run = fly(scenario)
    begin = scenario.count(SETTLED_S["hover"], "start_s")
    lean, lost, detected = judge(run.log, begin)
    north, east = (run.log[name][begin:] for name in ("north_m", "east_m"))
    drift = max((hypot(n - north[0], e - east[0]) for n, e in zip(north, east, strict=True)), default=nan)
    sink = float(run.log["velocity_down_m_s"][-1])
    verdict = verdict_of(run.outcome, run.log, STEP_S)
    if verdict == "held" and sink > SINK_M_S:
        verdict = "airborne"
    detection = None if detected is None else detected - begin + 1
    with build(scenario) as simulation:
        shut_at = detection if means != PLANNED else None
        turned = roller(simulation)
        throttles = turned.least_lean(jet, shut_at=shut_at)
        bound = turned.least_lean(jet, shut_at=shut_at, tilting=True)
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
    )


def _levers(scenario: Scenario) -> Lever:
    """What a middle engine out asks for, from the bound alone."""

    with build(scenario) as simulation:
        whole = roller(simulation)
        vehicle = simulation.vehicle
        limit = vehicle.limits.tilt_deg
        jet = max(range(1, len(vehicle.jets) + 1), key=lambda n: (vehicle.jets[n - 1].position_m[0] == 0.0, -n))
        light = _half(simulation, whole)
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


def _half(simulation: Simulation, whole: RollAxis) -> RollAxis | None:
    """Half the mass and inertia on the same engines; None where these cannot go so low."""
    share = simulation.cascade.thrust_map.share(0.5 * whole.hover)
    if share <= simulation.vehicle.control.allocation.throttle_min:
        return None
    return RollAxis(simulation.vehicle, courses_of(simulation, share), 0.5 * whole.hover, 0.5)


def _inertia_for(whole: RollAxis, jet: int, limit: float) -> float:
    """The factor of J_xx, from 1, at which the bound is ``limit`` [deg], to 1 %."""
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
PAGES = {"faults.md": ("hexjet",), "full-scale.md": ("hexjet-100", "hexjet-p220")}  # which aircraft are on which


def rows(result: EngineOut, aircraft: Sequence[str]) -> dict[str, list[tuple[str, ...]]]:
    """What became of these aircraft, the bounds for changed ones, and what was not flown: by the names of TABLES."""
    return {
        "engine-out": [_row(flights) for flights in _together(result, aircraft)],
        "engine-out-levers": [_lever_row(lever) for lever in result.levers if lever.aircraft in aircraft],
        "engine-out-left": [
            (skipped.aircraft, skipped.engine, skipped.why) for skipped in result.left if skipped.aircraft in aircraft
        ],
    }


def _together(result: EngineOut, aircraft: Sequence[str]) -> list[list[Flight]]:
    """The flights of one vehicle and one means, in the order of the jets."""
    known: dict[tuple[str, str, str], list[Flight]] = {}
    for flight in result.flights:
        if flight.aircraft in aircraft:
            known.setdefault((flight.aircraft, flight.engine, flight.means), []).append(flight)
    return list(known.values())


def _row(flights: Sequence[Flight]) -> tuple[str, ...]:
    first = flights[0]
    times = [1e3 * flight.detected_s for flight in flights if flight.detected_s is not None]
    after = "not" if not times else f"{min(times):.0f} to {max(times):.0f} ms"
    cells = [
        f"{flight.verdict}: {flight.lean_deg:.0f}°"
        + ("" if flight.verdict == "lost" else f", {flight.lost_m:.1f} m, {flight.drift_m:.1f} m")
        + (f", sinks at {flight.sink_m_s:.1f} m/s" if flight.verdict == "airborne" else "")
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
    """The smallest and the largest of some bounds."""
    if any(value != value for value in values):
        return "-"
    least, most = (Bound(value, 0.0).words for value in (min(values), max(values)))
    return least if least == most else f"{least} to {most}"


def write_pages(result: EngineOut, folder: Path) -> list[Path]:
    """The tables between the marks of the pages of ``folder``.  Raises InputError if one cannot be written."""
    for page, aircraft in PAGES.items():
        made = rows(result, aircraft)
        write_marks(folder / page, {name: table(TABLES[name], made[name], left=3) for name in TABLES})
    return [folder / page for page in PAGES]


def check_pages(folder: Path) -> None:
    """Before the flights: raises InputError if a page cannot be written or lacks a mark."""
    for page in PAGES:
        check_marks(folder / page, TABLES)


def write(result: EngineOut, folder: Path) -> Path:
    """``engine-out.csv`` in ``folder``.  Raises InputError if it cannot be written."""
    path = folder / "engine-out.csv"
    try:
        write_records(path, Flight, result.flights)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    return path
