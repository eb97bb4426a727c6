"""The rows of a campaign as arrays, and what its keys and metrics are called on a page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.campaign.analysis.statistics import Counts, Interval
from cosim.campaign.study.keys import FLOWN_PARAMETERS, FLOWN_STATIONS
from cosim.campaign.study.plan import controllers as controllers_of
from cosim.campaign.workers.flight_row import MARGIN_OF
from cosim.results.metrics import metric_names
from cosim.results.wording import Metric, metric
from cosim.simulation.plugins import METRIC_PREFIX
from cosim.spec.controller_name import short_name

if TYPE_CHECKING:
    from cosim.campaign.store import Campaign
    from cosim.spec.scenario import Range

Mask = NDArray[np.bool_]
T = TypeVar("T")  # type of a column's values

# Outcomes, best first. "missed": flew to its end, but outside its own limits or what the study requires.
KINDS = ("success", "missed", "crashed", "diverged", "failed")
AXIS_METRICS = (  # metrics shown for axes with set-points
    "overshoot_percent",
    "rmse_rad",
    "final_error_rad",
    "oscillation_rad",
    "settling_time_s",
    "max_abs_error_rad",
)
FLIGHT_METRICS = (  # metrics shown for every study
    "altitude.max_abs_error_m", "position.max_abs_error_m", "position.drift_m", "speed.max_m_s",
    "effort.saturated_percent", "effort.throttle_1_s", "fuel_burnt_kg",
)  # fmt: skip


class KeyColumn(NamedTuple):
    """One varied key with its value in each row: a number, or an index into ``levels``."""

    path: str
    label: str  # unique, and short enough for an axis
    unit: str
    numbers: Array
    levels: list[str]  # names of choices; empty for a number
    log: bool = False

    @property
    def title(self) -> str:
        """Title of an axis of the key: its label, and its unit in brackets."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


class FlightTable(NamedTuple):
    """All finished flights, one element each, in the order of their numbers."""

    flight: Counts
    draw: Counts
    controller: Counts  # index into ``controllers``
    kind: Counts  # index into KINDS
    reason: list[str]
    beyond: list[list[str]]  # metrics above the flight's own limits
    duration: Array  # flown time, s
    keys: list[KeyColumn]
    metrics: list[Metric]  # those shown, the study's own first
    values: dict[str, Array]  # SI values by name; NaN where none
    controllers: list[str]
    grid: bool  # True: every combination of a grid
    # By how much the referee's comparison widens the interval of each controller's success rate.
    rates: Mapping[str, Interval] | None = None
    broken: Sequence[Sequence[str]] = ()  # requirements that each flight misses

    @property
    def success(self) -> Mask:
        return np.equal(self.kind, KINDS.index("success"))

    @property
    def completed(self) -> Mask:
        """Whether each flight came to its planned end."""
        return self.kind <= KINDS.index("missed")

    @property
    def not_flown(self) -> list[str]:
        """Reasons of the flights without a verdict, one each."""
        return [reason for kind, reason in zip(self.kind, self.reason, strict=True) if KINDS[kind] == "failed"]

    def rows_of(self, controller: int) -> Mask:
        """Return the mask of the rows of one controller."""
        return np.equal(self.controller, controller)


def read_flight_table(campaign: Campaign) -> FlightTable:
    """Read the rows of a campaign that is finished or still being flown."""
    columns, study = campaign.columns, campaign.study
    outcomes = np.array(columns.get("outcome", []), dtype=str)
    success = np.array(columns.get("success", []), dtype=bool)
    kind = np.full(outcomes.size, KINDS.index("failed"), dtype=np.intp)
    for code, name in enumerate(KINDS):
        kind[outcomes == name] = code
    kind[outcomes == "completed"] = KINDS.index("missed")
    kind[success] = KINDS.index("success")
    row_controllers = [str(name) for name in columns.get("controller", [])]
    # A study that lists no controllers flies its scenario's own.
    named = controllers_of(study) if study.controllers else []
    controllers = list(named or dict.fromkeys(row_controllers) or study.controller_names)
    code_of = {name: code for code, name in enumerate(controllers)}
    completed = kind <= KINDS.index("missed")
    names = [*metric_names(), *(name for name in columns if name.startswith(METRIC_PREFIX))]
    required = ["margin"] if study.base().require else []
    names += required
    values = {name: np.where(completed, numbers(columns[name]), np.nan) for name in names if name in columns}
    return FlightTable(
        flight=np.array(columns.get("flight", []), dtype=np.intp),
        draw=np.array(columns.get("draw", []), dtype=np.intp),
        controller=np.array([code_of[name] for name in row_controllers], dtype=np.intp),
        kind=kind,
        reason=[str(reason or "") for reason in columns.get("reason", [])],
        beyond=[str(names or "").split() for names in columns.get("beyond", outcomes.size * [""])],
        duration=numbers(columns.get("duration_s", [])),
        keys=key_columns(campaign),
        metrics=[metric(name) for name in choose_metrics(values, [*required, *study.success])],
        values=values,
        controllers=[short_name(name) for name in controllers],
        grid=study.design == "grid",
        rates=campaign.referee.get("rates"),
        broken=broken_requirements(campaign),
    )


def broken_requirements(campaign: Campaign) -> list[list[str]]:
    """Return the names of the requirements that each flight does not keep; an empty list where the study has none."""
    names = [entry.name for entry in campaign.study.base().require]
    columns = [campaign.columns.get(MARGIN_OF + name, [None] * len(campaign)) for name in names]
    return [
        [name for name, margin in zip(names, row, strict=True) if not isinstance(margin, float) or not margin >= 0.0]
        for row in zip(*columns, strict=True)
    ]


def numbers(values: Sequence[Any]) -> Array:
    """Return a column as floats; NaN for None."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def key_columns(campaign: Campaign) -> list[KeyColumn]:
    """Return the columns of the varied keys in the study's order.

    Those of single stations are left out where one of all engines says nearly the same.
    """
    common = {name.removeprefix(FLOWN_PARAMETERS) for name in campaign.study.drawn if name.startswith(FLOWN_PARAMETERS)}
    varied = [name for name in campaign.study.drawn if name in campaign.columns]
    varied = [name for name in varied if not (name.startswith(FLOWN_STATIONS) and name.endswith(tuple(common)))]
    by_key = {vary.key: vary for vary in campaign.study.vary}
    if campaign.study.design == "grid":
        # A key that is drawn anew for each point of a grid is not one of the grid's axes.
        varied = [name for name in varied if name in by_key]
    columns = []
    for name, label in zip(varied, short_names(varied), strict=True):
        column, vary = campaign.columns[name], by_key.get(name)
        if any(isinstance(value, (str, bool)) for value in column):
            listed = [choice_text(value) for value in (vary and vary.values) or []]
            texts = [choice_text(value) for value in column]
            levels = list(dict.fromkeys([*listed, *sorted(set(texts))]))
            code_of = {level: number for number, level in enumerate(levels)}
            coded = np.array([code_of[text] for text in texts], dtype=np.float64)
            columns.append(KeyColumn(name, label, "", coded, levels))
        else:
            values = numbers(column)
            log = vary is not None and (vary.scale == "log" or vary.lognormal is not None)
            log = log and bool(np.all(values > 0.0))
            key = if_here(campaign.study.key, name)
            columns.append(KeyColumn(name, label, key.unit if key else "", values, [], log))
    return columns


def choice_text(value: Any) -> str:
    """Format a choice as in TOML, without quotes."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def if_here(read: Callable[..., T], *arguments: object) -> T | None:
    """Return the result of reading a study; None if its files are missing here because it was flown elsewhere."""
    try:
        return read(*arguments)
    except InputError:
        return None


def short_names(paths: Sequence[str]) -> list[str]:
    """Return the last two parts of each key, or as many as make it unique; list indices do not count."""
    names = []
    for path in paths:
        parts = path.split(".")
        short = path
        for first in range(len(parts) - 1, -1, -1):
            short = ".".join(parts[first:])
            named = sum(not part.isdigit() for part in parts[first:])
            if named >= 2 and sum(f".{other}".endswith(f".{short}") for other in paths) == 1:
                break
        names.append(short)
    return names


def choose_metrics(values: Mapping[str, Array], required: Sequence[str]) -> list[str]:
    """Return the names of the metrics to show: at most eight, and those of ``FLIGHT_METRICS``.

    First those of the study's success, then the custom ones, then those of axes that were commanded in steps, then the
    errors of the other axes and of height.  ``FLIGHT_METRICS`` say where the vehicles went and how.  A metric
    without values, or with the same value in all flights, is left out.
    """
    stepped = [axis for axis in AXES if np.isfinite(values.get(f"{axis}.overshoot_percent", np.empty(0))).any()]
    order = [
        *required,
        *(name for name in values if name.startswith(METRIC_PREFIX)),
        *(f"{axis}.{last}" for axis in stepped for last in AXIS_METRICS),
        *(f"{axis}.max_abs_error_rad" for axis in AXES),
        "altitude.max_abs_error_m",
        "touchdown_m_s",
        *(f"{axis}.{last}" for axis in AXES for last in ("rmse_rad", "rate_rmse_rad_s")),
        "altitude.rmse_m",
        *FLIGHT_METRICS,
    ]
    finite = {name: column[np.isfinite(column)] for name, column in values.items()}
    moving = [
        name for name in dict.fromkeys(order) if name in finite and finite[name].size and np.ptp(finite[name]) > 0.0
    ]
    max_metrics = 8  # metrics on the page; the table has all
    return list(dict.fromkeys([*moving[:max_metrics], *(name for name in moving if name in FLIGHT_METRICS)]))


def describe_criterion(success: Mapping[str, Range]) -> str:
    """Describe a study's criterion of success: own limits and ranges of metrics."""
    parts = [f"{metric(name).label} {describe_range(name, allowed)}" for name, allowed in success.items()]
    return (
        f"flies to its end within its limits{', with ' if parts else '; nothing else is checked'}{' and '.join(parts)}"
    )


def describe_range(name: str, allowed: Range) -> str:
    """Describe the range of a metric, in the unit of the report."""
    of = metric(name)
    low, high = (
        None if end is None else f"{of.factor * end:.4g} {of.unit}".strip() for end in (allowed.min, allowed.max)
    )
    if low is None:
        return f"at most {high}"
    return f"at least {low}" if high is None else f"{low} to {high}"
