"""A tuning on a channel and the numbers of its closed loop: of what flies today, and of what a design chooses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from cosim.base.signals import AXES
from cosim.control.predictors.registry import BASELINE, SMITH
from cosim.engine import EngineSpec
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.vehicle import RateGains, RateModel, Vehicle
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop
from hexjet_design.loop.criteria import fine_loop
from hexjet_design.loop.tuning import Tuning


@dataclass(frozen=True)
class LeastMargins:
    """Smaller one of each pair of margins in :class:`cosim.loops.LoopMargins`.

    Of the loop broken at the plant's input, attitude and rate loop closed; None where nothing is crossed."""

    gain_db: float | None  # smallest raise that destabilises
    gain_down_db: float | None  # smallest reduction that destabilises
    phase_deg: float | None
    delay_s: float | None


@dataclass(frozen=True)
class Assessment:
    """A tuning on a channel with the numbers of its closed loop."""

    controller: str
    tuning: Tuning
    stable: bool
    margins: LeastMargins | None
    peak_sensitivity: float | None
    bandwidth_hz: float | None
    tolerated: float | None  # stable up to this times the tolerances
    noise: float | None  # standard deviation of the command
    step_error: float | None  # |error| integral: rad s/rad (m s/m)
    load_error: float | None  # integrated |error| per unit of load
    overshoot: float | None  # of a step response, as a fraction
    settling_s: float | None  # to 5 %; None: not within the window
    step_peak: float | None  # command per unit of the set-point


@dataclass(frozen=True)
class AxisDesign:
    """Design of one channel: the shipped loop, the candidates' objectives, and the chosen loop."""

    channel: Channel
    before: Assessment
    candidates: Mapping[str, float]  # by objective; infinite: not feasible
    after: Assessment | None
    limits: Mapping[str, float]  # Hz, limits by delay, lag and noise bound
    checks: Mapping[str, bool]
    why_not: str = ""  # why the requirements cannot be met
    nearest: str = ""  # closest candidate, if none is feasible


def shipped_tuning(channel: Channel, vehicle: Vehicle, spec: EngineSpec) -> Tuning:
    """Return the aircraft's own gains, with Smith's predictor if it has a model of the engine."""
    control = vehicle.control
    lead = getattr(control.lead, channel.name, None) or None
    if channel.name == "altitude":
        height = control.altitude
        limit = height.integral_limit_m_s2
        gains = RateGains(p=height.velocity_1_s, i=height.integral_1_s2, d=0.0, d_filter_s=1.0, integral_limit=limit)
        return Tuning(BASELINE.name, height.position_1_s, gains, control.predictor, channel.model("none"), lead)
    gains = getattr(control.rate, channel.name)
    angle = control.attitude.gain_1_s[AXES.index(channel.name)]
    model = spec.models_in(vehicle.identified).get(channel.name)  # type: ignore[call-overload]
    if model is None or not spec.matches_model(model.engine_sha256) or abs(model.sample_time_s - channel.step) > 1e-9:
        return Tuning(BASELINE.name, angle, gains, control.predictor, channel.model("none"), lead)
    model = model.model_copy(update={"delay_samples": model.delay_samples + channel.added_delay})
    return Tuning(SMITH.name, angle, gains, control.predictor, model, lead)


def predictor_model(channel: Channel, source: str) -> RateModel:
    """Return the model in a channel's predictor in flight, with the controller's added delay."""
    model = channel.model(source)
    return model.model_copy(update={"delay_samples": model.delay_samples + channel.added_delay})


def assess(channel: Channel, tuning: Tuning, need: Requirements) -> Assessment:
    """Compute all reported quantities of a tuning, at more frequencies than the search uses."""
    closed = fine_loop(channel, tuning)
    if closed.unstable_poles:
        return Assessment(tuning.controller, tuning, False, *[None] * 10)
    settled = bool(tuning.law is not None or tuning.gains.i) and not closed.load_left
    return Assessment(
        tuning.controller,
        tuning,
        True,
        margins(closed),
        closed.peak_sensitivity,
        closed.bandwidth,
        closed.compute_tolerance(need.delay_samples(channel.transport_samples), need.gain_tolerance),
        closed.noise,
        closed.step_error,
        closed.load_error if settled else None,
        closed.overshoot,
        closed.settling_s if isfinite(closed.settling_s) else None,
        closed.step_peak,
    )


def margins(closed: ClosedLoop) -> LeastMargins:
    """Return a loop's smallest margins; that of phase is the lag, or the lead as a negative number if it is smaller."""
    loop = closed.margins
    lag, lead = loop.phase_deg, loop.phase_lead_deg
    turns = [turn for turn in (lag, None if lead is None else -lead) if turn is not None]
    return LeastMargins(loop.gain_db, loop.gain_down_db, min(turns, key=abs, default=None), loop.delay_s)
