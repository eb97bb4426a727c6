"""Which single faults a vehicle survives, with which controller.

Every fault is flown at every place where it can happen, from hover and from a commanded roll, with every controller
that the vehicle has a model for: a study with a case for each fault, place and start.  A flight is judged by where it
ends: *held* (level to a few degrees), *airborne* (neither crashed nor diverged, and no more than that) or *lost*.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from cosim.base.outcomes import Verdict
from cosim.base.storage.files import to_json_record
from cosim.control.predictors.registry import BASELINE
from cosim.simulation.build import build
from cosim.spec.controller_name import label
from cosim.spec.vehicle import Vehicle
from cosim.studies import MARGIN_OF, Campaign, Study, default_draw, design_warnings, with_values
from hexjet_prove.surveys.survey import Subject, held_formula, load_subject, make_study, measure_flight, select_cases

if TYPE_CHECKING:
    from cosim.results.log.recorder import Log
    from cosim.simulation.controllers.source import Source

# Level of users' controllers that replace the whole controller, engine monitor included.
WHOLE_CONTROLLER = "controller"
START_STATES = ("hover", "roll")  # flights at the time of the fault
SETTLED_S = {"hover": 1.0, "roll": 3.0}  # s before the fault; the roll has settled
DROPOUTS = ("gyro", "attitude", "barometer", "gnss")  # sensors that fail
AFTER_S = 6.0  # s flown after the fault
LIMIT_KIND = "limit"  # kind of cases that find the limits
LOSSES = tuple(k / 10 for k in range(1, 11))  # fractions of thrust lost
CONFIRMATIONS_S = (0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.16, 0.2, 0.3)  # detection times tried


class Case(NamedTuple):
    """One fault at one place, as in a scenario but without its start; None: no fault."""

    kind: str
    place: str
    fault: dict[str, Any] | None
    settings: Mapping[str, Any] = {}

    def name(self, start: str) -> str:
        """Return the case's name in a study: fault, place and how the flight starts."""
        return "-".join(re.findall(r"\w+", f"{self.kind} {self.place} {start}"))

    def settings_from(self, start: str) -> dict[str, Any]:
        """Return the scenario's settings for the case, in hover or in a roll."""
        begin = SETTLED_S[start]
        roll = {"kind": "step", "signal": "roll_deg", "start_s": 0.5, "amplitude": 10.0}
        return {
            "duration_s": begin + AFTER_S,
            "command": [roll] if start == "roll" else [],
            "fault": [] if self.fault is None else [self.fault | {"start_s": begin}],
            "metrics": METRICS[start],
            "require": [{"name": "held", "formula": held_formula(begin + AFTER_S)}],
            **self.settings,
        }


@dataclass(frozen=True)
class Row:
    """Result of one flight."""

    kind: str
    place: str
    start: str
    controller: str
    verdict: Verdict
    lean_deg: float  # largest lean after the fault
    lost_m: float  # height lost after the fault
    detected_s: float | None  # s from the fault to its detection
    reason: str
    controller_sha256: str | None = None  # of a user's controller
    margin_deg: float | None = None  # of lean, to "held"; below 0: beyond
    flight: int = 0  # number of the flight in the campaign


class FaultMetrics:
    """Metrics of a flight after the fault: largest lean, height lost, time to detection."""

    names = ("lean_deg", "lost_m", "detected_s")
    start: ClassVar[str]

    def __call__(self, log: Log, step_s: float) -> dict[str, float | None]:
        """Return them, None for what there is not."""
        begin = round(SETTLED_S[self.start] / step_s)
        lean, lost, detected = measure_flight(log, begin)
        seconds = None if detected is None else (detected - begin + 1) * step_s
        return {"lean_deg": lean, "lost_m": lost, "detected_s": seconds}


class FromHover(FaultMetrics):
    """Metrics of a fault in hover."""

    start = "hover"


class FromRoll(FaultMetrics):
    """Metrics of a fault during a roll."""

    start = "roll"


METRICS = {each.start: [f"{__name__}:{each.__name__}"] for each in (FromHover, FromRoll)}  # plug-ins by start


def cases(vehicle: Vehicle, limits: bool = False) -> list[Case]:
    """Return every single fault at every place; its size is chosen by us: large enough to matter, not hopeless.

    ``limits``: also a loss of thrust, and a late confirmation of a flame-out, that grow along a grid, with jet 1.
    """
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
    found = [
        Case(title, place, fault | _location(fault["kind"], place))
        for title, places, fault in kinds
        for place in places
    ]
    for share in LOSSES if limits else ():
        found.append(
            Case(f"{LIMIT_KIND}, {share:.0%} thrust lost", "jet 1", {"kind": "thrust_loss", "share": share, "jet": 1})
        )
    for seconds in CONFIRMATIONS_S if limits else ():
        settings = {"vehicle.control.monitor.confirm_s": seconds}
        found.append(Case(f"{LIMIT_KIND}, found in {seconds:g} s", "jet 1", {"kind": "flame_out", "jet": 1}, settings))
    return [Case("none", "", None), *found]


def _location(kind: str, place: str) -> dict[str, Any]:
    """Return the place of a fault as scenarios state it."""
    if place.startswith("jet "):
        return {"jet": int(place.removeprefix("jet "))}
    return {"servo" if kind == "servo_jam" else "sensor": place}


class FaultPlan(NamedTuple):
    """Study of a survey, and its cases."""

    subject: Subject
    study: Study
    cases: dict[str, tuple[Case, str]]  # case and start by name in the study
    engine_note: str  # whether an uncertain engine is drawn


def plan_faults(
    aircraft: str,
    engine: str | None = None,
    controllers: Sequence[str] = (),
    kinds: Sequence[str] = (),
    limits: bool = False,
    nominal_engine: bool = False,
) -> FaultPlan:
    """Return the study of all cases; ``kinds`` select cases by their beginnings.

    ``engine`` None is the one that the aircraft is made for.  An engine that states its uncertainty is drawn by it for
    each case and start, the same for every controller, unless ``nominal_engine``.
    Raises InputError for an unknown kind, aircraft, engine or controller.
    """
    subject = load_subject(aircraft, engine)
    kinds = [*kinds, LIMIT_KIND] if limits and kinds else kinds
    chosen = select_cases(cases(subject.vehicle, limits), kinds, "fault", lambda case: case.kind)
    height_m = 30.0
    scenario = subject.scenario("survival", BASELINE.name, height_m, AFTER_S)
    draw, note = default_draw(scenario, nominal_engine)
    planned = {case.name(start): (case, start) for case in chosen for start in START_STATES}

    def case_settings(case: Case, start: str) -> dict[str, Any]:
        drawn = {} if draw is None else draw.draw_by_name(f"{case.kind} {case.place} {start}")
        return {"seed": scenario.seed, **case.settings_from(start), **drawn}

    study = make_study(
        f"faults-{subject.vehicle.name}",
        f"Every single fault of {subject.vehicle.name}, engine {subject.engine}",
        subject.settings(height_m, AFTER_S) | Case("none", "", None).settings_from("roll"),
        [{"name": name, "settings": case_settings(*each)} for name, each in planned.items()],
        controllers=list(controllers or subject.controllers()),
    )
    return FaultPlan(subject, study, planned, note)


class FaultSurvey:
    """Outcome of each fault with each controller: ``rows`` has a flight each."""

    caption = "held at so many of the places where it can happen; the largest lean and the most height lost there"

    def __init__(self, plan: FaultPlan, campaign: Campaign) -> None:
        self.aircraft, self.engine, self.engine_note = plan.subject.vehicle.name, plan.subject.engine, plan.engine_note
        self.rows = [_make_row(*plan.cases[str(row["case"])], row) for row in map(campaign.row, range(len(campaign)))]
        self.custom_controllers = list(_list_custom_controllers(plan.study))
        # If a design flies with other inputs than it was made for.
        self.warnings = design_warnings(plan.study)

    @property
    def unmonitored_controllers(self) -> list[str]:
        """Controllers flown without an engine monitor."""
        return [source.label for source in self.custom_controllers if source.level == WHOLE_CONTROLLER]

    def to_dict(self) -> dict[str, Any]:
        """Return the table for JSON."""
        return {
            "aircraft": self.aircraft,
            "engine": self.engine,
            **({"engine_note": self.engine_note} if self.engine_note else {}),
            "warnings": self.warnings,
            "own_controllers": [
                {"name": source.name, "level": source.level, "sha256": source.sha256}
                | {"engine_monitor": source.level != WHOLE_CONTROLLER}
                for source in self.custom_controllers
            ],
            "rows": [to_json_record(row) for row in self.rows],
        }

    def table(self) -> list[list[str]]:
        """Return at how many of its places each fault is held: the head and the lines of a table."""
        controllers = list(dict.fromkeys(row.controller for row in self.rows))
        table = [["fault", "from", *map(label, controllers), "detected, s"]]
        for kind, start in dict.fromkeys((row.kind, row.start) for row in self.rows):
            rows = [row for row in self.rows if (row.kind, row.start) == (kind, start)]
            times = [row.detected_s for row in rows if row.detected_s is not None]
            found = f"{min(times):.3f} to {max(times):.3f}" if times else "-"
            cells = (_format_cell([row for row in rows if row.controller == name]) for name in controllers)
            table.append([kind, start, *cells, found])
        return table

    def lines(self) -> list[str]:
        """Return how many flights each controller held, with notes, one line each."""
        lines = []
        for name in dict.fromkeys(row.controller for row in self.rows):
            held = [row.verdict is Verdict.HELD for row in self.rows if row.controller == name]
            lines.append(f"{self.aircraft}: {label(name)} holds {sum(held)} of {len(held)} flights")
        lines += [
            f"no engine monitor with {name}: a whole controller sees to lost engines itself"
            for name in self.unmonitored_controllers
        ]
        return lines + ([self.engine_note] if self.engine_note else [])


def _make_row(case: Case, start: str, row: Mapping[str, Any]) -> Row:
    """Return the outcome that a row of the campaign states."""
    margin, detected = row[f"{MARGIN_OF}held"], row["own.detected_s"]
    lean, lost = (nan if row[name] is None else row[name] for name in ("own.lean_deg", "own.lost_m"))
    return Row(
        case.kind, case.place, start, row["controller"], judge(row["outcome"], margin), lean, lost,
        None if case.fault is None else detected, row["reason"], row["controller_sha256"], margin, row["flight"],
    )  # fmt: skip


def judge(outcome: str, margin: float | None) -> Verdict:
    """Return whether a vehicle was held, only airborne, or lost; ``margin`` is that of being held."""
    if outcome != "completed":
        return Verdict.LOST
    return Verdict.HELD if margin is not None and margin >= 0.0 else Verdict.AIRBORNE


def _format_cell(rows: Sequence[Row]) -> str:
    held, airborne = (sum(row.verdict is verdict for row in rows) for verdict in (Verdict.HELD, Verdict.AIRBORNE))
    more = f", {airborne} airborne" if airborne else ""
    lean, lost = max(row.lean_deg for row in rows), max(row.lost_m for row in rows)
    return f"{held}/{len(rows)}{more}  {lean:3.0f} deg {lost:4.1f} m"


def _list_custom_controllers(study: Study) -> Iterator[Source]:
    """Yield the user-supplied controllers of a study."""
    for name in study.controllers:
        with build(with_values(study.base(), {"controller": name})) as simulation:
            if simulation.controller_source is not None:
                yield simulation.controller_source
