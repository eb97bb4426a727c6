"""A recorded flight flown again: the model with its uncertainty, what it explains, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import ZERO3, Vector3
from cosim.engine import EngineSpec
from cosim.engine.fmu.uncertainty import CUT, cut_normal
from cosim.engine.fmu.variables import INTEGERS
from cosim.identify.verdict import EXPLAINED, NOT_EXPLAINED, NOT_TOLD, Judgement, shared_record
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from hexjet_identify.replay.candidates import INERTIA, MASS, THRUST
from hexjet_identify.replay.causes import Causes, find_causes, without_windows
from hexjet_identify.replay.closed_loop import cut_whole, fly_setpoints
from hexjet_identify.replay.flown import Change, Flown, Model, Starts
from hexjet_identify.replay.gyro import without_gyro_offset
from hexjet_identify.replay.measures import (
    LEVEL,
    Band,
    ChannelMeasures,
    Envelope,
    Ratio,
    measure_channels,
    measure_ratio,
)
from hexjet_identify.replay.misfit import Part
from hexjet_identify.replay.reach import Reach, find_reach
from hexjet_identify.replay.recorded import RecordedFlight
from hexjet_identify.replay.wind import Wind, estimate_wind
from hexjet_identify.replay.windows import CHANNELS, Flying, accelerometer_zero, cut, slopes

NEEDED: Final = 0.9  # share of the time within the envelope with which a channel is explained
FORCES: Final = slice(3, 6)  # where the specific force stands among the channels
SPAN_M: Final = 0.4  # of the Hex-Jet, whose windows are a second
ALIKE: Final = (1.0, 10.0)  # dB and deg of measured over modelled that are not worth a word
USELESS: Final = 0.5  # Theil's U from where on a model that is coherent in no band does not do what was measured
FAR_DB: Final = 10.0  # beyond which the one is no answer to the other
CORRECTIONS: Final = 2  # of the starts

CLOSED: Final = (
    "the loop is closed: the controller hides what is wrong with a vehicle, and may be another than the one that flew; "
    "log the engines' commands"
)


@dataclass(frozen=True)
class Choices:
    """How a flight is replayed; tolerances are standard deviations, as shares of the value."""

    window_s: float | None = None  # None: a second for the Hex-Jet, other sizes by the root of theirs
    draws: int = 20
    inertia: float = 0.05
    mass: float = 0.02
    thrust: float = 0.03  # of engines that state no uncertainty
    seed: int = 1


@dataclass(frozen=True)
class Replay:
    """What a replay says."""

    log: str
    vehicle: Vehicle
    engine: str
    choices: Choices
    flying: Flying
    modelled: Array  # (w, n, 9), by CHANNELS
    low: Array  # the envelope
    high: Array
    flown: Flown
    channels: tuple[ChannelMeasures, ...]
    ratios: dict[str, Ratio]
    wind: Wind
    causes: Causes
    draws_engine: bool  # by an [uncertainty] of the engine
    tolerances: tuple[str, ...]
    notes: tuple[str, ...]
    reach: Reach | None = None  # of a log that finds nothing wrong, in open loop
    log_sha256: str = ""
    simulated: bool = False  # the log is of this program, so that no flight was recorded

    @property
    def window_s(self) -> float:
        """The length of a window, s."""
        return float(self.flying.rows.shape[1] * self.flying.flight.step)

    @property
    def moment_rms(self) -> tuple[float, float, float]:
        """The constant moments of the windows, which no engine makes: N m, rms about x, y, z."""
        x, y, z = np.sqrt(np.mean(self.flying.starts.moment**2, axis=0)).tolist()
        return (x, y, z)

    @property
    def aircraft(self) -> str:
        """The vehicle's name."""
        return self.vehicle.name

    @property
    def way(self) -> str:
        """What drives the model."""
        return "engines' commands, open loop in windows" if self.flying.flight.setpoints is None else "set-points"

    @property
    def verdict(self) -> str:
        """Whether the model explains what the log excites: every such channel is inside the envelope.

        Not, where a cause is named that is beyond the tolerances.  Where no moment of inertia would show it is not
        told, unless thrust over mass is off; nor where all that is off was moved by something else than the commands.
        """
        moved = [channel for channel in self.channels if channel.excited]
        if are_beyond(self.causes, self.choices, self.draws_engine):
            return NOT_EXPLAINED
        if not are_explained(moved, self.causes):
            return NOT_TOLD if all(is_foreign(c) for c in self._off) else NOT_EXPLAINED
        told = any(channel.name != LEVEL for channel in moved) and (self.reach is None or self.reach.tells_inertia)
        return EXPLAINED if told else NOT_TOLD

    @property
    def _off(self) -> list[ChannelMeasures]:
        """The channels that move and are outside the envelope, but for an attitude's own error."""
        return [c for c in self.channels if c.excited and c.within < NEEDED and not is_estimate(c, self.causes)]

    @property
    def evidence(self) -> tuple[str, ...]:
        """What the verdict rests on, and what the log does not tell, one line each."""
        flying = self.flying
        count, window = len(flying.windows), self.window_s
        how = "each started from the recorded state"
        if flying.flight.setpoints is not None:
            how = "flown as one, by the set-points, with the controller here"
        lines = [f"{flying.seconds:.1f} s in {count} windows of {window:g} s, {how}"]
        outside = [c for c in self.channels if c.excited and c.within < NEEDED]
        lines += [f"{c.name}: {100.0 * c.within:.0f} % of the time within, Theil's U {c.theil.u:.2f}" for c in outside]
        moved = [c for c in self.channels if c.excited]
        estimates = ", ".join(c.name for c in outside if is_estimate(c, self.causes))
        if estimates:
            lines.append(f"{estimates}: no rate is off, so the attitude of the log is late or drifts, not the vehicle")
        if foreign := ", ".join(c.name for c in self._off if is_foreign(c)):
            lines.append(f"{foreign}: moved by what no command makes, the air or another cause, so not told")
        coherent = [
            f"{c.name} {b.low_hz:.2g} to {b.high_hz:.2g} Hz" for c in moved for b in c.bands if b.gain_db is not None
        ]
        lines.append(f"coherent: {', '.join(coherent)}" if coherent else "no band in which both are coherent")
        lines += [text for c in moved for b in c.bands if (text := _describe_band(c.name, b))]
        if self.causes.named and self.verdict != NOT_EXPLAINED:
            lines.append(f"nearer still, within the tolerances: {' or '.join(one.text for one in self.causes.named)}")
        lines += self.reach.lines if self.reach else ()
        still = [c.name for c in self.channels if not c.excited]
        if still:
            lines.append(f"not told, for it moves no more than its noise: {', '.join(still)}")
        missing = [name for name, _ in CHANNELS if name not in {c.name for c in self.channels}]
        if missing:
            lines.append(f"not in the log: {', '.join(missing)}")
        return tuple(lines)

    @property
    def judgement(self) -> Judgement:
        """The verdict with what it rests on."""
        return Judgement(self.verdict, self.evidence)

    @property
    def fault(self) -> str:
        """What is at fault, in a line."""
        if self.verdict != NOT_EXPLAINED:
            return ""
        causes = self.causes
        if not causes.named:
            return f"no fault is named: {causes.reason}"
        texts, share = " or ".join(one.text for one in causes.named), 100.0 * causes.named[0].removed
        if causes.named[1:]:
            return f"{texts}: one of these removes up to {share:.0f} % of the misfit; the log does not tell which"
        return f"{texts}: alone it removes {share:.0f} % of the misfit"

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the signals, for JSON."""
        command = "throttle" if self.flying.flight.setpoints is None else "attitude set-point"
        channels = (command, ", ".join(channel.name for channel in self.channels))
        units = ("1" if self.flying.flight.setpoints is None else "rad", ", ".join(c.unit for c in self.channels))
        refused = [self.fault] if self.fault else []
        return {
            **shared_record(self.aircraft, channels, units, self.judgement, refused, self.notes),
            "estimates": [fitted.to_dict() for fitted in self.causes.named],
            "log": self.log,
            "log_sha256": self.log_sha256,
            "simulated": self.simulated,
            "aircraft": self.aircraft,
            "engine": self.engine,
            "way": self.way,
            "fault": self.fault,
            "seconds": self.flying.seconds,
            "windows": len(self.flying.windows),
            "window_s": self.window_s,
            "step_s": self.flying.flight.step,
            "draws": self.choices.draws,
            "seed": self.choices.seed,
            "tolerances": list(self.tolerances),
            "channels": [channel.to_dict() for channel in self.channels],
            "moment_rms_n_m": list(self.moment_rms),
            "wind": self.wind.to_dict(),
            "causes": self.causes.to_dict(),
            "reach": self.reach.to_dict() if self.reach else None,
        }


def _describe_band(name: str, band: Band) -> str:
    """Return how measured differs from modelled in a band where both are coherent; empty where they are alike."""
    gain, phase = band.gain_db, band.phase_deg
    if gain is None or phase is None or (abs(gain) < ALIKE[0] and abs(phase) < ALIKE[1]):
        return ""
    if abs(gain) > FAR_DB:
        return (
            f"{name}, {band.low_hz:.2g} to {band.high_hz:.2g} Hz: coherent, but measured is {gain:+.0f} dB beside the "
            "model: noise that the controller fed back, or what the model lacks"
        )
    late = f"{abs(phase):.0f} deg {'later' if phase < 0.0 else 'earlier'}"
    return f"{name}, {band.low_hz:.2g} to {band.high_hz:.2g} Hz: measured {gain:+.1f} dB beside the model, {late}"


def replay(
    log: str,
    scenario: Scenario,
    flight: RecordedFlight,
    choices: Choices,
    tell: Callable[[str, int, int], None] = lambda part, done, of: None,
) -> Replay:
    """Fly a recorded flight again with its engines' commands, or by its set-points where it has none.

    Each window is flown several times: what the rates and angles are off by in their mean corrects its start, what the
    rates are off by in their slope is a constant moment, of the air or of a centre of gravity that stands elsewhere.
    Then the vehicle is drawn, and what may be wrong with it is tried.  Raises InputError and FlightError.
    """
    model, count = Model(scenario), choices.draws + 2
    length = choices.window_s or usual_window(model.vehicle)
    tell("start", 0, count)
    if flight.setpoints is None:
        as_recorded = flying = without_gyro_offset(cut(model, flight, length), log)
        wind = estimate_wind(model, flying)
        for _ in range(CORRECTIONS):
            flying = _correct(model, flying, wind.velocity)
    else:
        as_recorded = flying = cut_whole(model, flight, length)
        wind = Wind(ZERO3, None, "not looked for where the loop is closed: taken for still air")
    flight = flying.flight

    def fly(change: Change) -> Flown:
        if flight.setpoints is not None:
            return fly_setpoints(model, flight, change)
        return model.fly(flight, flying.windows, flying.starts, change, wind.velocity)

    flown = fly(Change())
    modelled = flying.modelled(flown)
    zero = np.zeros(len(CHANNELS))
    zero[FORCES] = accelerometer_zero((flying.measured() - modelled)[:, :, FORCES], model.vehicle)
    modelled = modelled + zero
    lags = np.repeat([model.vehicle.sensors.gyro.filter_s, 0.0], [FORCES.start, len(CHANNELS) - FORCES.start])
    envelope = Envelope(modelled, flight.step, flying.scale, lags)
    for number, change in enumerate(draw(model, choices)):
        tell("draws", number + 1, count)
        envelope.include(flying.modelled(fly(change)) + zero)
    channels = measure_channels(flying, modelled, envelope)
    tell("causes", count - 1, count)
    causes = Causes(float("nan"), (), (), CLOSED)
    if flight.setpoints is None:
        causes = without_windows(find_causes(model, as_recorded, wind.velocity))
    engine = model.engine
    assert engine is not None
    uncertain, reach = engine.uncertainty is not None, None
    if flight.setpoints is None and are_explained(channels, causes) and not are_beyond(causes, choices, uncertain):
        reach = find_reach(model, as_recorded, wind.velocity)
    return Replay(
        log, model.vehicle, engine.name, choices, flying, modelled, *envelope.ends, flown, channels,
        _ratios(flying, modelled, channels), wind, causes, uncertain, _tolerances(engine, choices), _notes(flight),
        reach,
    )  # fmt: skip


def are_explained(channels: Sequence[ChannelMeasures], causes: Causes) -> bool:
    """Return whether every channel that moves is inside the envelope; an angle whose rates are as modelled need not."""
    return all(c.within >= NEEDED or is_estimate(c, causes) for c in channels if c.excited)


def is_estimate(channel: ChannelMeasures, causes: Causes) -> bool:
    """Return whether a channel that is off is the attitude's own error: an angle, where no rate or force is off."""
    return channel.unit == "rad" and causes.finds_nothing


def is_foreign(channel: ChannelMeasures) -> bool:
    """Return whether a channel moves, and the commands neither make the model do so nor anything alike."""
    alike = any(band.gain_db is not None and abs(band.gain_db) <= FAR_DB for band in channel.bands)
    is_level = channel.name == LEVEL and channel.theil.bias > 0.5  # thrust over mass
    return channel.theil.u > USELESS and not is_level and not alike


def are_beyond(causes: Causes, choices: Choices, draws_engine: bool) -> bool:
    """Return whether causes are named, and each of them is further off than the draws are: two standard deviations."""
    return bool(causes.named) and not any(
        all(_is_drawn(part, choices, draws_engine) for part in one.parts) for one in causes.named
    )


def _is_drawn(part: Part, choices: Choices, draws_engine: bool) -> bool:
    if part.value is None or part.begin is None:
        return False
    if draws_engine and (part.unit == "s" or part.name == THRUST):
        return True
    deviations = {MASS: choices.mass, THRUST: choices.thrust}
    deviation = deviations.get(part.name, choices.inertia if INERTIA in part.name else 0.0)
    return abs(part.value - part.begin) <= 2.0 * deviation


def _ratios(flying: Flying, modelled: Array, channels: tuple[ChannelMeasures, ...]) -> dict[str, Ratio]:
    """Return measured over modelled by frequency of each channel."""
    measured, step, shown = flying.measured(), flying.flight.step, {channel.name for channel in channels}
    return {
        name: measure_ratio(measured[:, :, c], modelled[:, :, c], step, float(flying.scale[c]))
        for c, (name, _) in enumerate(CHANNELS)
        if name in shown
    }


def usual_window(vehicle: Vehicle) -> float:
    """Return the length of a window, s: times of vehicles that are alike go with the root of their size (Froude)."""
    return float(round(min(max((vehicle.aero.span_m / SPAN_M) ** 0.5, 0.3), 3.0), 1))


def _correct(model: Model, flying: Flying, wind: Vector3) -> Flying:
    """Return the flight with better starts, and with the constant moment of each window that the model lacks."""
    flight, starts = flying.flight, flying.starts
    flown = model.fly(flight, flying.windows, starts, None, wind)
    error = np.nan_to_num(flying.measured() - flying.modelled(flown))
    slope = slopes(error[:, :, :3], flight.step)
    half = 0.5 * flight.step * error.shape[1]
    rate = error[:, :, :3].mean(axis=1) - half * slope  # at the start, with the moment in place
    # what a wrong rate and the moment have made of the angles, about level, is not their own error
    own = error[:, :, 6:].mean(axis=1) - half * rate - slope * (2.0 * half) ** 2 / 6.0
    angles = starts.angles + (own if flight.has_angles else 0.0)
    moment = starts.moment + slope * np.array(model.vehicle.inertia_kg_m2)
    return Flying(flight, flying.windows, Starts(starts.rate + rate, angles, moment), flying.noise)


def draw(model: Model, choices: Choices) -> Iterator[Change]:
    """Return the vehicles that are drawn: inertia and mass by their tolerances, engines by their ``[uncertainty]``."""
    rng = np.random.default_rng(choices.seed)
    engine = model.engine
    for _ in range(choices.draws):
        x, y, z, mass, thrust = np.clip(rng.standard_normal(5), -CUT, CUT).tolist()
        parameters = _drawn_parameters(engine, rng) if engine is not None and engine.uncertainty else {}
        yield Change(
            inertia=(1.0 + choices.inertia * x, 1.0 + choices.inertia * y, 1.0 + choices.inertia * z),
            mass=1.0 + choices.mass * mass,
            thrust=1.0 if parameters else 1.0 + choices.thrust * thrust,
            parameters=parameters,
        )


def _drawn_parameters(engine: EngineSpec, rng: np.random.Generator) -> dict[str, float]:
    """Return the parameters of the engines, drawn by their uncertainty; what each has by itself is left out."""
    table = engine.uncertainty
    assert table is not None
    known = {variable.name: variable for variable in engine.archive.parameters}
    quantiles = table.quantiles(rng.standard_normal((1, len(table.parameters))))
    values = {}
    for name, quantile, deviation in zip(table.parameters, quantiles, table.deviation, strict=True):
        variable, nominal = known[name], np.array([engine.parameters[name]])
        low = -np.inf if variable.min is None else variable.min
        high = np.inf if variable.max is None else variable.max
        value = float(cut_normal(quantile, nominal, deviation, low, high)[0])
        values[name] = float(round(value)) if variable.type in INTEGERS else value
    return values


def _tolerances(engine: EngineSpec, choices: Choices) -> tuple[str, ...]:
    """Return what was drawn, in words."""
    lines = [
        f"each moment of inertia: standard deviation {100.0 * choices.inertia:g} %",
        f"mass: {100.0 * choices.mass:g} %",
    ]
    table = engine.uncertainty
    if table is not None:
        lines.append(
            f"engines: {', '.join(table.parameters)} by the engine's [uncertainty] ({table.source or 'no source'})"
        )
    else:
        lines.append(f"thrust of all engines: {100.0 * choices.thrust:g} %; {engine.name} states no [uncertainty]")
    return tuple(lines)


def _notes(flight: RecordedFlight) -> tuple[str, ...]:
    notes = list(flight.notes)
    if not flight.has_angles:
        notes.append(
            "no attitude in the log: windows start level, which only drag and a measured velocity could notice"
        )
    if not flight.has_force:
        notes.append("no accelerometer in the log: thrust and mass are not told from inertia")
    return tuple(notes)
