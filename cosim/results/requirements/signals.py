"""What a formula may speak of: columns of the log, quantities derived from them, metrics and events."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import ceil
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.protocols import Columns
from cosim.base.signals import AXES
from cosim.results.contacts import CONTACTS, find_contact_changes, find_contact_rows, height_error
from cosim.results.log.columns import RATES
from cosim.results.metrics import POSITION_SETPOINT, wrap
from cosim.results.requirements.units import in_si

if TYPE_CHECKING:
    from cosim.results.log.recorder import Log
    from cosim.results.requirements.formula import Formula
    from cosim.spec.scenario import Scenario


class DerivedSignal(NamedTuple):
    """Quantity that is computed from columns of the log."""

    columns: tuple[str, ...]
    meaning: str
    compute: Callable[[Columns], Array]


def _angle_error(axis: str) -> DerivedSignal:
    setpoint, angle = f"{axis}_setpoint_rad", f"{axis}_rad"
    return DerivedSignal(
        (setpoint, angle), f"{axis} set-point minus {axis}", lambda log: wrap(log[setpoint] - log[angle])
    )


def _rate_error(rate: str) -> DerivedSignal:
    setpoint, true = f"rate_{rate}_setpoint_rad_s", f"rate_{rate}_rad_s"
    return DerivedSignal(
        (setpoint, true), f"set-point of the rate {rate} minus that rate", lambda log: log[setpoint] - log[true]
    )


def _drift_from_start(log: Columns) -> Array:
    return np.hypot(_subtract_start(log["north_m"]), _subtract_start(log["east_m"]))


def _subtract_start(values: Array) -> Array:
    return values - values[:1]


DERIVED: dict[str, DerivedSignal] = {  # signals computed from columns
    **{f"{axis}_error_rad": _angle_error(axis) for axis in AXES},
    **{f"rate_{rate}_error_rad_s": _rate_error(rate) for rate in RATES},
    "altitude_error_m": DerivedSignal(
        ("altitude_setpoint_m", "altitude_m", "on_ground", "hull_contact"),
        "commanded height minus height; 0 where the vehicle stands and a lower one is commanded",
        # The rows of contact are computed first, as they take one byte per row.
        lambda log: height_error(
            contact=find_contact_rows(log), setpoint=log["altitude_setpoint_m"], altitude=log["altitude_m"]
        ),
    ),
    "place_error_m": DerivedSignal(
        (*POSITION_SETPOINT, "north_m", "east_m"),
        "horizontal distance from the commanded place",
        lambda log: np.hypot(log[POSITION_SETPOINT[0]] - log["north_m"], log[POSITION_SETPOINT[1]] - log["east_m"]),
    ),
    "drift_m": DerivedSignal(("north_m", "east_m"), "distance from the start, level", _drift_from_start),
    "speed_m_s": DerivedSignal(
        ("velocity_north_m_s", "velocity_east_m_s"),
        "speed over the ground",
        lambda log: np.hypot(log["velocity_north_m_s"], log["velocity_east_m_s"]),
    ),
    "climb_m_s": DerivedSignal(("velocity_down_m_s",), "climb rate", lambda log: -log["velocity_down_m_s"]),
    "lean_rad": DerivedSignal(
        ("roll_rad", "pitch_rad"),
        "angle between the body's z axis and the vertical",
        lambda log: np.arccos(np.clip(np.cos(log["roll_rad"]) * np.cos(log["pitch_rad"]), -1.0, 1.0)),
    ),
}


class FlightSignals:
    """A finished flight as signals for formulas.

    ``metrics``: of the whole flight, by name; ``times_s``: when each event happens that its scenario states; ``rows``:
    the first ones that are looked at, all where it is None.
    """

    def __init__(
        self,
        log: Log,
        step_s: float,
        metrics: Mapping[str, float | None],
        times_s: Mapping[str, Sequence[float]],
        rows: int | None = None,
    ) -> None:
        self.step_s, self.rows = step_s, len(log) if rows is None else rows
        self.margins: dict[Formula, Array] = {}
        self.metrics = metrics
        self.times_s = {name: list(times) for name, times in times_s.items()}
        self._log = log
        self._signals: dict[str, Array] = {}

    def one_row(self) -> FlightSignals:
        """Return a flight of one row with its metrics, which are equal in all rows."""
        return FlightSignals(self._log, self.step_s, self.metrics, self.times_s, min(self.rows, 1))

    def forget(self) -> None:
        """Release cached columns and margins: an hour of one column takes 7 MB."""
        self.margins.clear()
        self._signals.clear()

    def signal(self, name: str) -> Array:
        """Return a column, a derived quantity, or a metric as the same number in every row; NaN if undefined."""
        if name not in self._signals:
            self._signals[name] = self._compute_signal(name)
        return self._signals[name]

    def _compute_signal(self, name: str) -> Array:
        if name in self.metrics:
            value = self.metrics[name]
            return np.full(self.rows, np.nan if value is None else value)
        derived = DERIVED.get(name)
        needed = (name,) if derived is None else derived.columns
        if not set(needed) <= set(self._log.columns):
            return np.full(self.rows, np.nan)
        values = self._log[name] if derived is None else derived.compute(self._log)
        finite = np.isfinite(values)
        return values if np.all(finite) else np.where(finite, values, np.nan)

    def event_rows(self, name: str) -> Sequence[int]:
        """Return the log rows at which an event happens: for each of its times the first that is not earlier."""
        if name in CONTACTS:
            changes = find_contact_changes(find_contact_rows(self._log), self.step_s) if self.rows else ()
            return [row for row, stands in changes if name == CONTACTS[stands]]
        rows = [ceil(time / self.step_s - 1e-6) for time in self.times_s.get(name, ())]
        return [row for row in rows if row < self.rows]


def needed_columns(names: Iterable[str], events: Iterable[str]) -> list[str]:
    """Return the columns of the log that signals and events are read from; a metric has none."""
    columns: list[str] = []
    for name in names:
        logged = in_si(name)
        columns += DERIVED[logged].columns if logged in DERIVED else (logged,)
    if any(event in CONTACTS for event in events):
        columns += ["on_ground", "hull_contact"]
    return list(dict.fromkeys(columns))


def event_times(scenario: Scenario) -> dict[str, list[float]]:
    """Return when each event happens that a scenario states: ``doublet begins``, ``gust ends``, ``flame out begins``.

    Of commands, disturbances and faults by their kind, each of that kind.
    """
    times: dict[str, list[float]] = {}
    for entry in (*scenario.command, *scenario.disturbance, *scenario.fault):
        kind = entry.kind.replace("_", " ")
        times.setdefault(f"{kind} begins", []).append(entry.start_s)
        length: float | None = getattr(entry, "duration_s", None)  # None: to the end, or stated in its file
        if length is not None:
            times.setdefault(f"{kind} ends", []).append(entry.start_s + length)
    return {name: sorted(values) for name, values in times.items()}
