"""The events of a flight with their times, for reports and exports.

Faults, the engine monitor's verdicts and contacts are read from the log, so that they are there also of a flight that
was killed; what disturbed it is in the scenario, and what an autopilot said in its record beside the log.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.constants import GRAVITY, SENSORS
from cosim.base.errors import FlightError, InputError
from cosim.results.autopilot.autopilot_record import read_pilot_record
from cosim.results.contacts import CONTACTS, find_contact_changes, find_contact_rows
from cosim.results.log.columns import jets_in, logged_vehicle_of
from cosim.results.metrics import Record

if TYPE_CHECKING:
    from cosim.results.log.recorder import Log
    from cosim.results.run import Run
    from cosim.spec.scenario import DisturbanceEntry, Fault, Scenario

Kind = Literal["fault", "monitor", "disturbance", "contact", "pilot", "requirement"]
MAX_EVENTS = 500  # events of one kind; the log has all
PHASES = ("on the ground", "in the air", "on its jets", "transition", "on the wing")  # by what carries the vehicle
ON_JETS, ON_WING = 0.05, 0.5  # fractions of weight on the wing


class Event(Record):
    """Event of a flight; ``end_s`` None: an instant, or for faults and disturbances to the end."""

    time_s: float
    kind: Kind
    text: str
    end_s: float | None = None
    severity: int = 6  # syslog: 2 critical, 3 error, 6 info
    banded: bool = False  # True: drawn as a band in figures

    @property
    def lasts(self) -> bool:
        """Whether the event has a duration."""
        return self.kind in ("fault", "disturbance")


class Phase(NamedTuple):
    """Interval of a flight [s] with one name: on the ground, in the air, on the wing, or an autopilot mode."""

    start_s: float
    end_s: float
    name: str


def list_phases(run: Run) -> list[Phase]:
    """Return the phases of a run: see :func:`find_phases`."""
    return find_phases(run.log, run.summary.step_s, read_pilot_record(run.folder) if run.folder is not None else ())


def find_phases(
    log: Log, step: float, record: Iterable[dict[str, Any]] = (), max_phases: int = 200, short_s: float = 0.1
) -> list[Phase]:
    """Return the phases of a flight in order; none if there is only one.

    Where an autopilot flies, a phase is its mode while it is armed.  Without one it is what carries the vehicle: the
    ground, its jets or, in a log with ``wing_lift_N``, the wing: more than 5 % of the weight (a transition), or half.
    ``max_phases``: of a flight: more are no ground to read lines on.  ``short_s``: a phase that is shorter, belongs to
    the one before it.
    """
    phases: list[Phase] = []
    for row, name in _phase_names(log, step, record) if len(log) else ():
        if phases and row * step - phases[-1].start_s < short_s:
            phases.pop()
        if not phases or phases[-1].name != name:
            phases.append(Phase(row * step if phases else 0.0, len(log) * step, name))
    ended = [phase._replace(end_s=after.start_s) for phase, after in pairwise(phases)]
    return [*ended, *phases[-1:]] if 1 < len(phases) <= max_phases else []


def _phase_names(log: Log, step: float, record: Iterable[dict[str, Any]]) -> list[tuple[int, str]]:
    """Return the rows at which phases begin, and the name of each phase."""
    states = [line for line in record if line["kind"] == "state"]
    if states:
        return [(max(line["k"], 0), line["mode"] if line["armed"] else "disarmed") for line in states]
    if not {"on_ground", "hull_contact"}.issubset(log.columns):  # a log of another tool
        return []
    contact = find_contact_rows(log)
    stands = np.full(contact.size, contact[0], dtype=np.int8)
    for row, now in find_contact_changes(contact, step):
        stands[row:] = now
    carried = 1 - stands
    if {"wing_lift_N", "mass_kg"}.issubset(log.columns):
        part = log["wing_lift_N"] / (GRAVITY * log["mass_kg"])
        carried += carried * (np.int8(1) + (part > ON_JETS) + (part > ON_WING))
    rows = [0, *(np.flatnonzero(np.diff(carried)) + 1).tolist()]
    return [(row, PHASES[carried[row]]) for row in rows]


def list_events(run: Run) -> list[Event]:
    """Return all events of a run, in the order of time."""
    log, step = run.log, run.summary.step_s
    if not len(log):
        return []
    scenario: Scenario | None
    try:
        scenario = run.scenario
    except (InputError, FlightError):  # the log can still be read
        scenario = None
    end = len(log) * step
    events = [
        *find_faults(log, step, scenario.fault if scenario else ()),
        *find_verdicts(log, step),
        *find_contacts(log, step),
        *(find_disturbances(scenario, end) if scenario else ()),
        *read_pilot_messages(run.folder, step),
    ]
    return sorted(events, key=lambda event: event.time_s)


def spans(mask: NDArray[np.bool_], step: float) -> list[tuple[float, float | None]]:
    """Return the times [s] between which a mask is true; None for an end that lies beyond the log."""
    starts, ends = row_spans(mask)
    return time_spans(starts, ends, mask.size, step)[:MAX_EVENTS]


def row_spans(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first row of each stretch in which a mask is true, and the row after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return edges[::2], edges[1::2]


def time_spans(
    starts: NDArray[np.intp], ends: NDArray[np.intp], rows: int, step: float
) -> list[tuple[float, float | None]]:
    """Return stretches of rows as times [s]; None for an end that lies beyond the log's ``rows``."""
    return [
        (float(start * step), None if end == rows else float(end * step))
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True)
    ]


def find_faults(log: Log, step: float, scheduled: Sequence[Fault] = ()) -> Iterator[Event]:
    """Yield each interval of a fault by jet, servo and sensor, described as in the scenario if stated there."""
    logged = logged_vehicle_of(log.columns)
    subjects = [("jet", str(jet)) for jet in range(1, logged.jets + 1)]
    subjects += [("servo", name) for name in (*logged.servos, *logged.surfaces)]
    subjects += [("sensor", name) for name in SENSORS]
    for kind, name in subjects:
        column = f"fault_{name}" if kind == "sensor" else f"fault_{kind}_{name}"
        if column not in log.columns:
            continue
        for start, end in spans(log[column] > 0.0, step):
            lines = [
                fault.describe()
                for fault in scheduled
                if _fault_acts_on(fault, kind, name) and _acts(fault, start, end, step)
            ]
            where = f"jet {name}" if kind == "jet" else f"{name} {'servo' if kind == 'servo' else ''}".strip()
            yield Event(
                time_s=start,
                kind="fault",
                text=f"{where}: {' and '.join(lines) or 'a fault acts'}",
                end_s=end,
                severity=4,
                banded=True,
            )


def _fault_acts_on(fault: Fault, kind: str, name: str) -> bool:
    if kind == "jet":
        return int(name) in getattr(fault, "jet", ())
    return getattr(fault, kind, None) == name


def _acts(fault: Fault, start: float, end: float | None, step: float) -> bool:
    end_s = None if fault.duration_s is None else fault.start_s + fault.duration_s
    half = 0.5 * step
    return (end is None or fault.start_s < end - half) and (end_s is None or end_s > start + half)


def find_verdicts(log: Log, step: float) -> Iterator[Event]:
    """Yield every change of the engine monitor's estimate of a jet."""
    for jet in range(1, jets_in(log.columns) + 1):
        name = f"health_{jet}"
        if name not in log.columns:
            continue
        health = log[name]
        if not np.all(np.isfinite(health)):
            continue
        believed = np.concatenate(([1.0], health))
        for row in np.flatnonzero(np.diff(believed) != 0.0)[:MAX_EVENTS].tolist():
            yield Event(
                time_s=row * step, kind="monitor", text=f"jet {jet} {_describe_health(believed[row + 1])}", severity=4
            )


def _describe_health(health: float) -> str:
    if health >= 1.0:
        return "reported healthy again"
    return "reported failed" if health <= 0.0 else f"reported weak: {100.0 * health:.0f} % of its command"


def find_contacts(log: Log, step: float) -> Iterator[Event]:
    """Yield an event whenever the vehicle leaves the ground or stands on it again, without bounces."""
    for row, stands in find_contact_changes(find_contact_rows(log), step):
        yield Event(time_s=row * step, kind="contact", text=CONTACTS[stands])


def find_disturbances(scenario: Scenario, end: float) -> Iterator[Event]:
    """Yield the scenario's disturbances within the flight."""
    if any(scenario.environment.wind_ned_m_s):
        yield Event(time_s=0.0, kind="disturbance", text=f"wind of {_format_speed(scenario.environment.wind_ned_m_s)}")
    for entry in scenario.disturbance:
        if entry.start_s < end:
            length = entry.duration_s
            end_s = None if length is None or entry.start_s + length > end else entry.start_s + length
            yield Event(time_s=entry.start_s, kind="disturbance", text=_describe_entry(entry), end_s=end_s, banded=True)


def _describe_entry(entry: DisturbanceEntry) -> str:
    match entry.kind:
        case "force":
            return f"force of {_format_norm(entry.force_n)} N"
        case "moment":
            return f"moment of {_format_norm(entry.moment_n_m)} N m"
        case "torque_command":
            return f"{entry.shape} on the {entry.axis} command"
        case "payload":
            return f"load of {entry.mass_kg:g} kg"
        case "wind":
            return f"wind changes by {_format_speed(entry.velocity_ned_m_s)}"
        case "gust":
            return f"gust of {_format_speed(entry.velocity_ned_m_s)}"


def _format_norm(vector: Iterable[float]) -> str:
    return f"{float(np.linalg.norm(list(vector))):.3g}"


def _format_speed(velocity: Iterable[float]) -> str:
    return f"{_format_norm(velocity)} m/s"


def read_pilot_messages(folder: Path | None, step: float) -> Iterator[Event]:
    """Yield the messages of a run's autopilot, its modes among them."""
    for line in read_pilot_record(folder) if folder is not None else ():
        if line["kind"] == "message":
            yield Event(
                time_s=max(line["k"], 0) * step, kind="pilot", text=str(line["text"]), severity=int(line["severity"])
            )
