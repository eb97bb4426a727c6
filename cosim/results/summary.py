"""What ``summary.json`` says of a run: what flew, how it ended, what was measured, and what it is compared with."""

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from html import escape
from importlib.metadata import PackageNotFoundError, version
from platform import python_version
from typing import Self

from pydantic import BaseModel, ConfigDict, Field

from cosim.base.errors import FlightError, InputError
from cosim.base.outcomes import Outcome, RunVerdict
from cosim.base.storage.toml import Vector
from cosim.results.limits import LimitInputs, describe_exceedance, find_exceeded, flight_limits
from cosim.results.log.recorder import Log
from cosim.results.metrics import (
    AltitudeMetrics,
    AxisMetrics,
    EffortMetrics,
    Metrics,
    PositionMetrics,
    Reach,
    Record,
    SpeedMetrics,
    check_expectations,
    flatten,
    flight_metrics,
)
from cosim.results.requirements import (
    FailedFlight,
    FlightSignals,
    Requirement,
    RequirementResult,
    flight_requirements,
    smallest_margin,
)
from cosim.results.verdict import describe_end, judge
from cosim.simulation.pacing import PaceReport
from cosim.simulation.plugins import CustomMetric
from cosim.spec.controller_name import HASH_DIGITS, describe_controller
from cosim.spec.scenario import Expectation

_TITLE_KEYS = ("aircraft", "engine", "controller", "design", "models")  # keys shown in the title already
_FILE_TEXT_NOTE = "Of the scenario as its file states it, not of this flight:"  # note on the scenario's own text
PACKAGES = ("hexjet-cosim", "jsbsim", "fmpy", "numpy", "scipy", "pyarrow")  # packages whose versions are recorded


class DelayRow(Record):
    """One element between the command of an axis and its measured rate, with its delay in samples."""

    element: str
    owner: str
    kind: str
    samples: float | None  # delay in samples; None: unknown
    axis: str = "roll"  # older runs had only roll


class StationEngine(Record):
    """Engine of one station, with its static ``curve``, empty if equal to ``Setup.engine_curve``."""

    engine: str
    sha256: str  # SHA-256 of the archive
    curve: tuple[tuple[float, float], ...] = ()
    file: str = ""  # archive or mapping; empty: shipped
    isolated: bool = False  # True: ran in a process of its own


class UncertainParameter(Record):
    """Uncertain parameter of an engine; all numbers are in its unit."""

    name: str
    nominal: float  # value in the mapping file
    low: float  # 95 % range of one engine around nominal
    high: float
    spread: float  # standard deviation between engines
    flown: float


class EngineUncertainty(Record):
    """Uncertainty of the flight's engine, as its ``[uncertainty]`` states it."""

    source: str  # origin of the numbers, if stated
    parameters: list[UncertainParameter]


class Integration(Record):
    """Integration of the airframe: JSBSim's runs per step, and its methods by name."""

    runs: int  # JSBSim runs per control step
    run_s: float  # s covered by each run
    rates: str  # method for rates
    velocities: str
    attitude: str
    position: str
    on_ground: str  # method for rates and velocities there

    @property
    def methods(self) -> str:
        air = [f"rates {self.rates}", f"velocities {self.velocities}"]
        if self.rates == self.velocities:
            air = [f"rates and velocities {self.rates}"]
        if self.on_ground != self.rates or self.on_ground != self.velocities:
            air[-1] += f" ({self.on_ground} while anything touches the ground)"
        return ", ".join([*air, f"attitude {self.attitude}", f"position {self.position}"])


class OwnController(Record):
    """A user's controller as flown."""

    name: str
    level: str  # predictor, rate, attitude or controller
    # Hash of its files or of its text, as controller_sha256 of the scenario; empty: not available.
    sha256: str
    files: dict[str, str]  # SHA-256 by file name
    version: str = ""  # version of its package
    parameters: dict[str, float]
    again: bool = True  # False: an object in memory, gone later
    repeatable: bool | None = None  # same answers again; None: not checked


class ParametersRecord(Record):
    """A file whose numbers flew: a designed controller, or identified models."""

    kind: str  # "design" or "models"
    file: str  # file name in the run's folder
    sha256: str
    controller: str = ""  # controller that the design is for
    changed: tuple[str, ...] = ()  # keys with another value in the flight


class PluginRecord(Record):
    """A user's metric, observer, sensors or wind as flown."""

    key: str  # key of the scenario
    name: str
    sha256: str
    files: dict[str, str]  # SHA-256 by file name
    version: str = ""  # version of its package


class Setup(BaseModel):
    """What is known of a run before its first step."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, defer_build=True)

    scenario: str
    title: str = ""
    description: str = ""
    aircraft: str
    engine: str
    controller: str
    own_controller: OwnController | None = None  # None: a built-in controller
    parameter_files: list[ParametersRecord] = []
    changed: list[str] = []  # values overriding the file, key = value
    brought: list[PluginRecord] = []  # other code of the user
    seed: int
    sensors: str = ""  # profile and hash; empty: none
    step_s: float
    integration: Integration | None = None  # None: older runs
    planned_s: float  # planned length of the flight
    started: str = ""  # UTC, ISO 8601
    engine_curve: list[tuple[float, float]] = []  # throttle and steady thrust [N]
    engine_uncertainty: EngineUncertainty | None = None  # None: not stated, or an older run
    stations: list[StationEngine] = []  # engine of each jet, jet 1 first
    jets_m: list[Vector] = []  # station of each jet, body
    delay_ledger: list[DelayRow] = []
    reach: Reach | None = None  # ranges of throttles and tilts
    yardstick: LimitInputs | None = None  # inputs of the default limits, or None
    expectation: Expectation | None = None  # for this controller and engine
    requires: list[Requirement] = []  # requirements of [[require]]
    event_times_s: dict[str, list[float]] = {}  # by event name, if stated
    notes: list[str] = []  # model deviations, inert settings
    by_hand: int = 0  # steps that a program commanded
    versions: dict[str, str] = {}
    blas_kernels: dict[str, str] = {}  # OpenBLAS kernels by package, if known
    sha256: dict[str, str] = {}  # hashes of aircraft model and FMUs

    @property
    def controller_shown(self) -> str:
        """Name of the controller for display: if not built in, with file and the first letters of its hash."""
        sha256 = "" if self.own_controller is None else self.own_controller.sha256
        return describe_controller(self.controller, sha256, self.parameter_files)

    @property
    def engine_shown(self) -> str:
        """Name of the engine for display; a foreign one with file and the first letters of its hash."""
        files = {station.file: station.sha256 for station in self.stations if station.engine == self.engine}
        return self.engine + "".join(f" ({name} {value[:HASH_DIGITS]})" for name, value in files.items() if name)

    def retitled(self) -> Self:
        """Return the setup with a title of what flies, if that differs from the scenario's file.

        The description is kept, marked as the scenario's.
        """
        if not self.changed:
            return self
        texts = [text for text in self.changed if text.partition(" = ")[0] not in _TITLE_KEYS]
        listed = [*texts[:3], *([f"{len(texts) - 3} more changes"] if len(texts) > 3 else [])]
        title = f"{self.scenario}: {self.aircraft}, {self.engine_shown}, {self.controller_shown}"
        title += f", with {', '.join(listed)}" if listed else ""
        story = f"{_FILE_TEXT_NOTE} {self.description.strip()}" if self.description.strip() else ""
        return self.model_copy(update={"title": title, "description": story})


class Pacing(Record):
    """How well a paced flight kept in step with the clock."""

    factor: float | None  # of real time; None: unlimited
    missed_deadlines: int  # steps not done when the next was due
    worst_s: float  # s, largest delay of a step
    stalls: int  # how often the schedule was moved
    lost_s: float  # s by which it was moved, in total


class Summary(Setup):
    """Contents of ``summary.json``."""

    outcome: Outcome
    reason: str
    verdict: RunVerdict | None = None  # None: older runs
    steps: int
    duration_s: float  # s flown
    wall_s: float | None = None  # s, of the steps; None: was killed
    realtime_factor: float | None = None
    step_us: float | None = None
    pacing: Pacing | None = None  # None: not paced
    metrics: dict[str, AxisMetrics]
    altitude: AltitudeMetrics
    touchdown_m_s: float | None = None
    position: PositionMetrics = Field(default_factory=PositionMetrics)
    speed: SpeedMetrics = Field(default_factory=SpeedMetrics)
    effort: EffortMetrics = Field(default_factory=EffortMetrics)
    fuel_burnt_kg: float | None = None
    own_metrics: dict[str, float | None] = {}  # user's metrics, as own.NAME
    own_metrics_failed: list[str] = []  # one line for each that failed
    limits: dict[str, float] = {}  # upper limits by metric
    beyond: list[str] = []  # metrics above their limits
    expectations_met: bool | None = None  # None: nothing was expected
    complaints: list[str] = []  # one line for each failed expectation
    requirements: list[RequirementResult] = []  # requirements, expectations and limits
    requirements_kept: bool | None = None  # those of [[require]]; None: none stated
    margin: float | None = None  # smallest, scaled; below 0: failed
    decided_by: str = ""  # requirement with the smallest margin

    def __repr__(self) -> str:
        flown = f"{self.aircraft}, engine {self.engine}, controller {self.controller}, seed {self.seed}"
        return f"<Summary {self.scenario}: {self.ending}; {flown}>"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        """Return a table for notebooks: how the flight ended, and the metrics."""
        return f"<p><b>{escape(f'{self.scenario}: {self.ending}')}</b></p>{self.metric_table()}"

    def metric_table(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{value:.6g}</td></tr>"
            for name, value in self.flat_metrics.items()
            if value is not None
        )
        return f"<table>{rows}</table>"

    @property
    def flat_metrics(self) -> dict[str, float | None]:
        """Every metric under the name that an expectation uses, such as ``roll.rmse_rad``."""
        whole = {name: getattr(self, name) for name in Metrics.model_fields if name != "axes"}
        return flatten(Metrics(axes=self.metrics, **whole)) | self.own_metrics

    @property
    def succeeded(self) -> bool:
        """Whether the flight completed and no check failed: exit status 0."""
        is_kept = self.expectations_met is not False and self.requirements_kept is not False
        return self.outcome == "completed" and not self.beyond and is_kept

    @property
    def ending(self) -> str:
        """Outcome and verdict in words."""
        return describe_end(self.outcome, self.reason, self.verdict)

    @property
    def exceeded(self) -> list[str]:
        """Metrics above their limits, in words with both numbers."""
        return [describe_exceedance(name, self.limits, self.flat_metrics) for name in self.beyond]

    @property
    def broken(self) -> list[str]:
        """Missed requirements of ``[[require]]``, in words."""
        return [result.describe() for result in self.requirements if result.source == "require" and not result.kept]


def summarize(
    setup: Setup,
    log: Log,
    outcome: Outcome,
    reason: str,
    wall_s: float | None,
    pace: PaceReport | None = None,
    custom: Sequence[CustomMetric] = (),
) -> Summary:
    """Return the summary of a flight from its log; ``custom`` are the user's metrics."""
    metrics = flight_metrics(log, setup.step_s, setup.reach)
    values, failed = _evaluate(custom, log, setup.step_s)
    flat = flatten(metrics) | values
    steps = len(log)
    duration = steps * setup.step_s
    limits = flight_limits(setup.yardstick, log, setup.step_s) if setup.yardstick is not None and steps else {}
    above = find_exceeded(limits, flat)
    complaints = _list_unmet_expectations(setup.expectation, outcome, flat)
    met = None if setup.expectation is None else not complaints
    lost = None if outcome == "completed" else FailedFlight(duration, setup.planned_s)
    results = assess_flight(setup, limits, FlightSignals(log, setup.step_s, flat, setup.event_times_s), lost)
    margin, decided_by = smallest_margin(results, lost)
    kept = all(result.kept for result in results if result.source == "require") if setup.requires else None
    return Summary(
        **dict(setup),
        outcome=outcome,
        reason=reason,
        verdict=judge(outcome, above, met, kept),
        steps=steps,
        duration_s=duration,
        wall_s=wall_s,
        realtime_factor=duration / wall_s if wall_s else None,
        step_us=1e6 * wall_s / steps if wall_s is not None and steps else None,
        pacing=None
        if pace is None
        else Pacing(
            factor=pace.factor,
            missed_deadlines=pace.missed,
            worst_s=pace.longest_delay,
            stalls=pace.stalls,
            lost_s=pace.postponed,
        ),
        metrics=metrics.axes,
        **{name: part for name, part in metrics if name != "axes"},
        own_metrics=values,
        own_metrics_failed=failed,
        limits=limits,
        beyond=above,
        expectations_met=met,
        complaints=complaints,
        requirements=results,
        requirements_kept=kept,
        margin=margin,
        decided_by=decided_by,
    )


def assess_flight(
    setup: Setup, limits: Mapping[str, float], flight: FlightSignals, lost: FailedFlight | None
) -> list[RequirementResult]:
    """Return the results of the limits, of what the scenario expects of the controller, and of its ``[[require]]``."""
    expected = {} if setup.expectation is None else setup.expectation.metrics
    requirements = flight_requirements(limits, expected, setup.requires)
    return [RequirementResult.of(requirement.assess(flight, lost)) for requirement in requirements]


def _evaluate(metrics: Sequence[CustomMetric], log: Log, step_s: float) -> tuple[dict[str, float | None], list[str]]:
    """Return the values of the user's metrics, and a line for each that failed; without a step all are None."""
    values: dict[str, float | None] = {name: None for metric in metrics for name in metric.names}
    failed = []
    for custom_metric in metrics if len(log) else ():
        try:
            values |= custom_metric.compute(log, step_s)
        except (FlightError, InputError) as error:
            failed.append(str(error))
    return values, failed


def versions() -> dict[str, str]:
    """Return the versions that a run depends on, by name: Python and the packages that make its numbers.

    >>> sorted(versions())
    ['fmpy', 'hexjet-cosim', 'jsbsim', 'numpy', 'pyarrow', 'python', 'scipy']
    """
    return dict(_read_versions())


@cache
def _read_versions() -> dict[str, str]:
    versions = {"python": python_version()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:  # a checkout that is not installed
            continue
    return versions


def now() -> str:
    """Return the present time as UTC text, for :attr:`Setup.started`."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _list_unmet_expectations(
    expectation: Expectation | None, outcome: Outcome, flat: Mapping[str, float | None]
) -> list[str]:
    if expectation is None:
        return []
    wrong = (
        [] if outcome in expectation.outcome else [f"outcome = {outcome}, expected {' or '.join(expectation.outcome)}"]
    )
    return wrong + check_expectations(flat, expectation.metrics)


def summary_json(summary: Summary, width: int = 120) -> str:
    """Return the summary as JSON, main entries first, long tables and lists with a line per entry.

    ``width``: characters of a table or list on one line of the summary.
    """
    data = summary.model_dump(mode="json")
    first: tuple[str, ...] = (
        "outcome",
        "reason",
        "verdict",
        "beyond",
        "limits",
        "complaints",
        "metrics",
        "altitude",
        "touchdown_m_s",
    )
    first += ("position", "speed", "effort", "fuel_burnt_kg")
    lines = []
    for key, value in ({name: data[name] for name in first} | data).items():
        text = json.dumps(value, allow_nan=False)
        if isinstance(value, dict) and len(text) > width:
            inner = (f"    {json.dumps(name)}: {json.dumps(part, allow_nan=False)}" for name, part in value.items())
            text = "{\n" + ",\n".join(inner) + "\n  }"
        elif isinstance(value, list) and len(text) > width:
            text = "[\n" + ",\n".join(f"    {json.dumps(part, allow_nan=False)}" for part in value) + "\n  ]"
        lines.append(f"  {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"
