"""``hexjet margins``: gain, phase and delay margins and peak sensitivity of any controller, measured in flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError, InputError, nearest
from cosim.base.signals import AXES
from cosim.engine.fmu.uncertainty import ParameterRange
from cosim.simulation.build import build
from cosim.simulation.controllers.external_controller import find_controller
from cosim.simulation.controllers.source import Source, make_object_source
from cosim.simulation.delay_ledger import sum_transport_samples
from cosim.spec.controller_name import label, resolve_controller
from cosim.spec.scenario import Scenario, controller_shown, flown_parameters
from hexjet_design.loop.engine_uncertainty import EngineSensitivity
from hexjet_design.loop.limit import AxisLimit
from hexjet_design.loop.programme import need_solver
from hexjet_design.measured.axis_margins import NYQUIST_CYCLES, AxisMargins
from hexjet_design.measured.computed import Computed, compute_margins
from hexjet_design.measured.engine_range import EngineRange, range_over_engines
from hexjet_design.measured.estimate import QUANTITIES, Response, measured, relative_differences
from hexjet_design.measured.excitation import Multisine, Record, Tap, fly_excitation, multisine, still
from hexjet_design.measured.judgement import JudgedMargin, find_worst, judge_axis

# Periods of the multisine [s]: the longer one if fewer cycles of the crossover than this fit into the shorter one.
PERIOD_S, LONG_PERIOD_S = 20.0, 60.0
MIN_CYCLES = 10.0  # fewer in a period: the longer period
MIN_PERIODS = 3  # fewest for an estimate of the scatter
AMPLITUDE_FACTOR, MAX_TRIES = 0.4, 5  # factor on an amplitude that failed
JUDGED = ("gain_db", "gain_down_db", "phase_deg", "delay_s", "peak_sensitivity")

Say = Callable[[str], None]


@dataclass(frozen=True)
class MeasuredMargins:
    """Measured margins of one controller on one vehicle."""

    scenario: Scenario
    source: Source | None
    axes: Mapping[str, AxisMargins]
    uncomputed: str  # why nothing was computed; or empty
    uncertainty_source: str | None = None  # engine's file; None: states none
    engine_ranges: tuple[ParameterRange, ...] = ()  # of the engine's uncertain parameters

    @property
    def judged(self) -> list[JudgedMargin]:
        """Margins of all axes compared with the limits of ``docs/judging.md``."""
        return [row for measured in self.axes.values() for row in judge_axis(measured)]

    @property
    def controller(self) -> str:
        """The controller's name without a folder."""
        return label(self.scenario.controller)

    @property
    def controller_shown(self) -> str:
        """Name of the controller for display: a design by file and first letters of its hash.  Raises InputError."""
        return controller_shown(self.scenario)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the curves, for JSON."""
        scenario, own = self.scenario, self.source
        return {
            "aircraft": scenario.aircraft,
            "engine": scenario.engine,
            "controller": self.controller,
            "controller_level": own.level if own else "built-in",
            "controller_sha256": own.sha256 if own else None,
            "controller_parameters": dict(scenario.controller_parameters),
            "parameter_files": [
                {"kind": p.kind, "file": Path(p.file).name, "sha256": p.sha256, "changed": p.changed}
                for p in flown_parameters(scenario)
            ],
            "seed": scenario.seed,
            "step_s": scenario.step_s,
            "sensor_noise": scenario.sensor_noise,
            "not_computed": self.uncomputed or None,
            "engine_uncertainty_source": self.uncertainty_source,
            "engine_parameters": [row._asdict() for row in self.engine_ranges],
            "worst_margin": find_worst(self.judged)._asdict() if self.judged else None,
            "axes": {axis: _axis_to_dict(measured) for axis, measured in self.axes.items()},
        }


def _axis_to_dict(measured: AxisMargins) -> dict[str, Any]:
    def to_json(value: float | None) -> float | None:
        return None if value is None or not isfinite(value) else float(value)

    return {
        "unit": measured.unit,
        "amplitude": measured.amplitude,
        "from_hz": float(measured.sine.hertz[0]),
        "to_hz": float(measured.sine.hertz[-1]),
        "period_s": measured.sine.period * measured.sine.step,
        "periods": measured.periods,
        "least_coherence": float(measured.response.coherence.min()),
        "whole_band": measured.is_complete,
        "measured": {
            name: {"value": bounded.value, "low": to_json(bounded.low), "high": to_json(bounded.high)}
            if bounded
            else None
            for name, bounded in ((name, measured.response.margins.get(name)) for name in QUANTITIES)
        },
        "computed": None
        if measured.computed is None
        else {n: to_json(getattr(measured.computed.margins, n)) for n in QUANTITIES},
        "off": {name: to_json(measured.off(name)) for name in QUANTITIES},
        "at_half_the_amplitude": {
            name: measured.half.margins[name].value if name in measured.half.margins else None for name in QUANTITIES
        },
        "limit": measured.limit.to_dict() if isinstance(measured.limit, AxisLimit) else None,
        "judged": [row.to_dict() for row in judge_axis(measured)],
        "notes": list(measured.notes),
        "engine_uncertainty": None
        if measured.uncertainty is None
        else {
            **measured.uncertainty._asdict(),
            **dict(zip(("gain_margin_deviations", "delay_margin_deviations"), measured.in_deviations(), strict=True)),
            **({} if measured.over_engine is None else measured.over_engine.to_dict()),
        },
    }


def measure_margins(
    scenario: Scenario,
    axes: Sequence[str] = AXES,
    *,
    controller: Any = None,
    amplitude: float | None = None,
    from_hz: float | None = None,
    to_hz: float | None = None,
    period_s: float | None = None,
    periods: int = 5,
    limit: bool = False,
    say: Say = lambda text: None,
) -> MeasuredMargins:
    """Break each axis's loop at the plant's input while the vehicle hovers, and measure it.

    Arguments and errors are those of :func:`hexjet_design.measured.api.margins`.  ``amplitude`` None: 0.03 of thrust or
    0.06 rad, less where that does not fit; with allocation by effectiveness what moves a thrust or a hinge by that.
    ``to_hz`` None: a tenth of the control rate, or half of it where the loop's gain does not fall towards the tenth.
    """
    if limit:
        need_solver()
    if periods < MIN_PERIODS:
        raise InputError(f"periods = {periods}: must be at least {MIN_PERIODS}, for their spread to be seen")
    if amplitude is not None and not amplitude > 0.0:
        raise InputError(f"amplitude = {amplitude:g}: must be above 0")
    for axis in axes:
        if axis not in AXES:
            raise InputError(f"axis {axis!r}: {nearest(axis, AXES)}")
    own: Source | None = None
    if isinstance(controller, str):
        scenario = scenario.replace(controller=resolve_controller(controller, scenario.folder))
    elif controller is not None:
        own = make_object_source(controller)
        scenario = scenario.replace(controller=own.name)
    scenario = still(scenario)
    own = own or find_controller(scenario)
    with build(scenario, own) as simulation:
        vehicle, spec = simulation.vehicle, simulation.engine
        taps = {axis: Tap(axis, scenario, vehicle, simulation.stations) for axis in axes}
        ledger = simulation.ledger
    known = None if spec.uncertainty is None else EngineSensitivity(scenario, vehicle, spec)
    say("computing")
    computed_margins = compute_margins(scenario, vehicle, spec, list(axes), limit)
    by_axis = {}
    for axis in axes:
        late = sum_transport_samples(ledger, axis)
        transport_s = None if late is None else late * scenario.step_s
        request = _MarginRequest(
            scenario, own, axis, taps[axis], amplitude, from_hz, to_hz, period_s, periods, transport_s,
            known if taps[axis].by_thrust else None, say,
        )  # fmt: skip
        by_axis[axis] = request.measure(None if isinstance(computed_margins, str) else computed_margins[axis])
    source = None if known is None else known.table.source
    uncomputed = computed_margins if isinstance(computed_margins, str) else ""
    return MeasuredMargins(scenario, own, by_axis, uncomputed, source, spec.uncertain_ranges)


@dataclass(frozen=True)
class _MarginRequest:
    """A requested measurement on one axis."""

    scenario: Scenario
    source: Source | None
    axis: str
    tap: Tap
    amplitude: float | None
    from_hz: float | None
    to_hz: float | None
    period_s: float | None
    periods: int
    transport_s: float | None  # s, command to rate; None: unknown
    sensitivity: EngineSensitivity | None  # to the axis's engine, if stated
    say: Say

    def measure(self, computed: Computed | None) -> AxisMargins:
        """Fly the excitation, again with longer periods, more band and half amplitude; return the axis's margins."""
        period, to_hz = self.period_s or PERIOD_S, self.to_hz or 0.1 / self.scenario.step_s
        sine, size, response = self._measure_loop(period, to_hz, self.amplitude or self.tap.usual)
        if self.period_s is None and _is_slow(response):
            period = LONG_PERIOD_S
            sine, size, response = self._measure_loop(period, to_hz, size)
        if self.to_hz is None and _stays_up(response):
            sine, size, response = self._measure_loop(period, NYQUIST_CYCLES / self.scenario.step_s, size)
        self.say(f"{self.axis}: half the amplitude")
        half = fly_excitation(self.scenario, self.axis, sine, 0.5 * size, MIN_PERIODS, self.source)
        other = self._estimate_response(half, sine)
        crossing = response.margins.get("crossover_hz")
        known = None if self.sensitivity is None or crossing is None else self.sensitivity.at(crossing.value)
        return AxisMargins(
            self.axis, self.tap.unit, sine, size, self.periods, response, other, computed, _list_notes(response, other),
            known, self._range_over_engines(response), self.transport_s,
        )  # fmt: skip

    def _range_over_engines(self, response: Response) -> EngineRange | None:
        if self.sensitivity is None:
            return None
        ratios = self.sensitivity.draw_ratios(response.hertz[response.used])
        return range_over_engines(response, ratios, self.scenario.step_s, self.transport_s)

    def _measure_loop(self, period_s: float, to_hz: float, size: float) -> tuple[Multisine, float, Response]:
        step = self.scenario.step_s
        count = self.scenario.count(period_s, "period_s")
        low = 2.0 / period_s if self.from_hz is None else self.from_hz
        sine = multisine(count * step, step, low, to_hz)
        size, record = self._fly_within_range(sine, size)
        return sine, size, self._estimate_response(record, sine)

    def _estimate_response(self, record: Record, sine: Multisine) -> Response:
        return measured(record.sensitivity(), sine.hertz, sine.step, self.transport_s)

    def _fly_within_range(self, sine: Multisine, size: float) -> tuple[float, Record]:
        """Fly with this amplitude, or a smaller one that fits.  Raises InputError if a requested one does not fit."""
        why = ""
        for _ in range(MAX_TRIES):
            self.say(f"{self.axis}: amplitude {size:.2g}")
            try:
                record = fly_excitation(self.scenario, self.axis, sine, size, self.periods, self.source)
                if not record.clipped:
                    return size, record
                why = "an actuator comes to an end of its range"
            except FlightError as error:
                why = str(error)
                if "controller " in why:
                    raise
            if self.amplitude is not None:
                raise InputError(f"{self.axis}: amplitude {size:g} is too much: {why}")
            size = float(f"{AMPLITUDE_FACTOR * size:.2g}")
        raise FlightError(
            f"{self.axis}: {why}, with as little as {size / AMPLITUDE_FACTOR:.2g} added: the loop is not stable"
        )


def _is_slow(response: Response) -> bool:
    """Return whether the crossover is near or below the lower end of the band."""
    crossing = response.margins.get("crossover_hz")
    within = MIN_CYCLES if "gain_down_db" in response.margins else 2.0 * MIN_CYCLES
    return crossing is None or crossing.value * PERIOD_S < within


def _stays_up(response: Response) -> bool:
    """Return whether the loop's gain stays up towards the band's end, so that a margin may lie above it."""
    hertz, size = response.hertz[response.used], abs(response.loop[response.used])
    octave = float(size[abs(hertz - 0.5 * hertz[-1]).argmin()])
    # If |L| falls to no less than this in the band's last octave, measure up to half the control rate.
    min_fall = 0.7
    min_gain = 0.01  # |L| at the band's end, 40 dB below 1
    return bool(size[-1] > min_gain and size[-1] > min_fall * octave)


def _list_notes(response: Response, half: Response) -> tuple[str, ...]:
    notes = []
    hidden = int((~response.used).sum())
    if hidden:
        lines = f"{hidden} of {len(response.used)} lines"
        notes.append(f"{lines} are hidden in noise and left out; settings sensor_noise=false flies without it")
    # Relative change between full and half amplitude that is accepted besides the intervals.
    max_change = 0.05
    for name, difference in relative_differences(half.margins, response.margins).items():
        if name not in JUDGED:
            continue
        one, two = response.margins[name], half.margins[name]
        wide = sum(0.5 * (bounded.high - bounded.low) for bounded in (one, two) if isfinite(bounded.high))
        if abs(difference) > max_change and abs(one.value - two.value) > wide:
            notes.append(
                f"{name} is {100.0 * difference:+.0f} % off at half the amplitude: the loop is not linear at this one"
            )
    crossing = response.margins.get("crossover_hz")
    if crossing is None:
        notes.append("the loop's gain does not pass 1 in the band: widen it")
    else:
        there = float(response.coherence[abs(response.hertz - crossing.value).argmin()])
        if there < 0.9:
            notes.append(f"coherence {there:.2f} at the crossover: more amplitude or more periods")
    return tuple(notes)
