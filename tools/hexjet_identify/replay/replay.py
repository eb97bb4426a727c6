"""A recorded flight flown again: the model with its uncertainty, what it explains, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cosim.base.arrays import Array
from cosim.engine import EngineSpec
from cosim.engine.fmu.uncertainty import MAX_SIGMA, cut_normal
from cosim.engine.fmu.variables import INTEGERS
from cosim.identify.verdict import EXPLAINED, NOT_EXPLAINED, NOT_TOLD, Judgement, shared_record
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from hexjet_identify.replay.candidates import CENTRE, INERTIA, MASS, SENSORS, THRUST
from hexjet_identify.replay.causes import Causes, FittedNumber, find_causes
from hexjet_identify.replay.flown import Change, Model, ModelOutput
from hexjet_identify.replay.measures import LEVEL_CHANNEL, MIN_TIME_WITHIN, Band, ChannelMeasures, measure_channels
from hexjet_identify.replay.misfit import settle_starts
from hexjet_identify.replay.recorded import RecordedFlight
from hexjet_identify.replay.wind import Wind, estimate_wind
from hexjet_identify.replay.windows import CHANNELS, CutFlight, accelerometer_zero, cut_windows, without_gyro_offset

# Largest gain of measured over modelled that still counts as an answer to the command.
MAX_GAIN_DB: Final = 10.0


@dataclass(frozen=True)
class Choices:
    """Options of a replay; ``inertia``, ``mass`` and ``thrust`` are relative standard deviations.

    ``window_s`` None: by the vehicle's size.  ``thrust`` is of engines that state no uncertainty.
    """

    window_s: float | None = None
    draws: int = 20
    inertia: float = 0.05
    mass: float = 0.02
    thrust: float = 0.03
    seed: int = 1


@dataclass(frozen=True)
class Replay:
    """Result of a replay.

    ``modelled``, ``low`` and ``high``, the envelope, are (w, n, 9), by CHANNELS.  ``draws_engine``: by an
    [uncertainty] of the engine.  ``simulated``: the log is of this program, so that no flight was recorded.
    """

    log: str
    vehicle: Vehicle
    engine: str
    choices: Choices
    flying: CutFlight
    modelled: Array
    low: Array
    high: Array
    channels: tuple[ChannelMeasures, ...]
    wind: Wind
    causes: Causes
    draws_engine: bool
    tolerances: tuple[str, ...]
    notes: tuple[str, ...]
    log_sha256: str = ""
    simulated: bool = False

    @property
    def window_s(self) -> float:
        """Duration of a window, s."""
        return float(self.flying.rows.shape[1] * self.flying.flight.step)

    @property
    def moment_rms(self) -> tuple[float, float, float]:
        """Rms of the windows' constant moments beside the engines', about x, y, z [N m]."""
        x, y, z = np.sqrt(np.mean(self.flying.starts.moment**2, axis=0)).tolist()
        return (x, y, z)

    @property
    def aircraft(self) -> str:
        """The vehicle's name."""
        return self.vehicle.name

    @property
    def verdict(self) -> str:
        """Whether the model explains the log: every channel that moves is inside the envelope.

        Not, where a cause is named that is beyond the tolerances.  Where no moment of inertia would show it is not
        told, unless thrust over mass is off; nor where all that is off was moved by something else than the commands.
        """
        moved = [channel for channel in self.channels if channel.excited]
        if are_beyond_tolerances(self.causes, self.choices, self.draws_engine, self.vehicle.aero.span_m):
            return NOT_EXPLAINED
        if not are_explained(moved, self.causes):
            return NOT_TOLD if all(is_uncommanded(c) for c in self._off_channels) else NOT_EXPLAINED
        told = any(channel.name != LEVEL_CHANNEL for channel in moved) and self.causes.tells_inertia
        return EXPLAINED if told else NOT_TOLD

    @property
    def _off_channels(self) -> list[ChannelMeasures]:
        """Channels that move and are outside the envelope, but for errors of the attitude itself."""
        return [
            c
            for c in self.channels
            if c.excited and c.within < MIN_TIME_WITHIN and not is_attitude_error(c, self.causes)
        ]

    @property
    def evidence(self) -> tuple[str, ...]:
        """Evidence of the verdict, and what the log does not tell, one line each."""
        flying = self.flying
        count, window = len(flying.windows), self.window_s
        lines = [f"{flying.seconds:.1f} s in {count} windows of {window:g} s, each started from the recorded state"]
        outside = [c for c in self.channels if c.excited and c.within < MIN_TIME_WITHIN]
        lines += [f"{c.name}: {100.0 * c.within:.0f} % of the time within, Theil's U {c.theil.u:.2f}" for c in outside]
        moved = [c for c in self.channels if c.excited]
        estimates = ", ".join(c.name for c in outside if is_attitude_error(c, self.causes))
        if estimates:
            lines.append(f"{estimates}: no rate is off, so the attitude of the log is late or drifts, not the vehicle")
        if foreign := ", ".join(c.name for c in self._off_channels if is_uncommanded(c)):
            lines.append(f"{foreign}: moved by what no command makes, the air or another cause, so not told")
        coherent = [
            f"{c.name} {b.low_hz:.2g} to {b.high_hz:.2g} Hz" for c in moved for b in c.bands if b.gain_db is not None
        ]
        lines.append(f"coherent: {', '.join(coherent)}" if coherent else "no band in which both are coherent")
        lines += [text for c in moved for b in c.bands if (text := _describe_band(c.name, b))]
        if self.causes.named and self.verdict != NOT_EXPLAINED:
            lines.append(f"nearer still, within the tolerances: {' or '.join(one.text for one in self.causes.named)}")
        if self.verdict != NOT_EXPLAINED:
            lines += describe_reach(self.causes)
        still = [c.name for c in self.channels if not c.excited]
        if still:
            lines.append(f"not told, for it moves no more than its noise: {', '.join(still)}")
        missing = [name for name, _ in CHANNELS if name not in {c.name for c in self.channels}]
        if missing:
            lines.append(f"not in the log: {', '.join(missing)}")
        return tuple(lines)

    @property
    def judgement(self) -> Judgement:
        """The verdict with its evidence."""
        return Judgement(self.verdict, self.evidence)

    @property
    def fault(self) -> str:
        """The named cause, or why none is named, in a line; empty if the flight is explained."""
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
        channels = ("throttle", ", ".join(channel.name for channel in self.channels))
        units = ("1", ", ".join(c.unit for c in self.channels))
        refused = [self.fault] if self.fault else []
        told, hidden = self.causes.reach
        return {
            **shared_record(self.aircraft, channels, units, self.judgement, refused, self.notes),
            "estimates": [fitted.to_dict() for fitted in self.causes.named],
            "log": self.log,
            "log_sha256": self.log_sha256,
            "simulated": self.simulated,
            "aircraft": self.aircraft,
            "engine": self.engine,
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
            "reach": {"told": [part.to_dict() for part in told], "not_told": hidden},
        }


def _describe_band(name: str, band: Band, min_db: float = 1.0, min_deg: float = 10.0) -> str:
    """Return gain and phase between measured and modelled in a coherent band; empty if they agree."""
    gain, phase = band.gain_db, band.phase_deg
    if gain is None or phase is None or (abs(gain) < min_db and abs(phase) < min_deg):
        return ""
    if abs(gain) > MAX_GAIN_DB:
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
    noise_deviations: float = 2.0,
) -> Replay:
    """Fly a recorded flight again with its engines' commands.

    The start of each window, and a constant moment of the air on it, are fitted to what was recorded.  Then the vehicle
    is drawn, with ``noise_deviations`` of the log's noise around it as envelope, and each of its numbers is fitted.
    Raises InputError and FlightError.
    """
    model, count = Model(scenario), choices.draws + 2
    length = choices.window_s or usual_window(model.vehicle)
    tell("start", 0, count)
    flying = without_gyro_offset(cut_windows(model, flight, length))
    wind = estimate_wind(model, flying)
    flying = settle_starts(model, flying, wind.velocity)
    flight = flying.flight

    def fly(change: Change) -> ModelOutput:
        return model.fly(flight, flying.windows, flying.starts, change, wind.velocity)

    modelled = flying.modelled(fly(Change()))
    zero = np.zeros(len(CHANNELS))
    zero[3:6] = accelerometer_zero((flying.measured() - modelled)[:, :, 3:6], model.vehicle)
    modelled = modelled + zero
    low = high = modelled
    for number, change in enumerate(draw_vehicles(model, choices)):
        tell("draws", number + 1, count)
        drawn = flying.modelled(fly(change)) + zero
        low, high = np.minimum(low, drawn), np.maximum(high, drawn)
    low, high = low - noise_deviations * flying.scale, high + noise_deviations * flying.scale
    channels = measure_channels(flying, modelled, low, high)
    tell("causes", count - 1, count)
    causes = find_causes(model, flying, wind.velocity, (low - modelled, high - modelled))
    engine = model.engine
    assert engine is not None
    return Replay(
        log, model.vehicle, engine.name, choices, flying, modelled, low, high, channels,
        wind, causes, engine.uncertainty is not None,
        _describe_tolerances(engine, choices), _list_notes(flight),
    )  # fmt: skip


def are_explained(channels: Sequence[ChannelMeasures], causes: Causes) -> bool:
    """Return whether every moving channel is inside the envelope; angles need not if their rates are."""
    return all(c.within >= MIN_TIME_WITHIN or is_attitude_error(c, causes) for c in channels if c.excited)


def is_attitude_error(channel: ChannelMeasures, causes: Causes) -> bool:
    """Return whether a channel is an angle that is off while no rate or force is: an error of the attitude."""
    return channel.unit == "rad" and not causes.is_off


def is_uncommanded(channel: ChannelMeasures, max_u: float = 0.5) -> bool:
    """Return whether a channel moves by something else than the commands, which move the model otherwise.

    Beyond a Theil's U of ``max_u`` a model that is coherent in no band does not do what was measured.
    """
    alike = any(band.gain_db is not None and abs(band.gain_db) <= MAX_GAIN_DB for band in channel.bands)
    is_level = channel.name == LEVEL_CHANNEL and channel.theil.bias > 0.5  # thrust over mass
    return channel.theil.u > max_u and not is_level and not alike


def are_beyond_tolerances(causes: Causes, choices: Choices, draws_engine: bool, span_m: float) -> bool:
    """Return whether causes are named and each is beyond its tolerance of two standard deviations.

    An attitude that is late is no fault of the vehicle.
    """
    return bool(causes.named) and not any(
        row.parts and all(_is_tolerated(part, choices, draws_engine, span_m) for part in row.parts)
        for row in causes.named
    )


def _is_tolerated(part: FittedNumber, choices: Choices, draws_engine: bool, span_m: float) -> bool:
    if part.name.endswith(SENSORS[2]) or (draws_engine and ("of the engines" in part.name or part.name == THRUST)):
        return True
    deviations = {MASS: choices.mass, THRUST: choices.thrust}
    deviation = deviations.get(part.name, choices.inertia if INERTIA in part.name else 0.0)
    if CENTRE in part.name:
        # The centre of gravity is taken to be known to half a percent of the span.
        deviation = 0.005 * span_m
    return abs(part.value - part.stated) <= 2.0 * deviation


def describe_reach(causes: Causes) -> list[str]:
    """Return sentences on which errors of the vehicle the log would show, and which not."""
    told, hidden = causes.reach
    lines = []
    if told:
        lines.append(f"off by 30 %, 20 ms or 5 % of the span these would show: {_join([part.name for part in told])}")
    return [*lines, *([f"these would not: {_join(hidden)}"] if hidden else [])]


def _join(names: Sequence[str]) -> str:
    """Return names joined by semicolons, those of engines as a list of numbers."""
    engine = "thrust of engine "
    numbers = ", ".join(name.removeprefix(engine) for name in names if name.startswith(engine))
    others = [name for name in names if not name.startswith(engine)]
    return "; ".join([*others, *([engine + numbers] if numbers else [])])


def usual_window(vehicle: Vehicle) -> float:
    """Return the duration of a window [s]: it scales with the root of the vehicle's size (Froude).

    It is a second for the Hex-Jet with its span of 0.4 m.
    """
    return float(round(min(max((vehicle.aero.span_m / 0.4) ** 0.5, 0.3), 3.0), 1))


def draw_vehicles(model: Model, choices: Choices) -> Iterator[Change]:
    """Yield random vehicles: inertia and mass by their tolerances, engines by their ``[uncertainty]``."""
    rng = np.random.default_rng(choices.seed)
    engine = model.engine
    for _ in range(choices.draws):
        x, y, z, mass, thrust = np.clip(rng.standard_normal(5), -MAX_SIGMA, MAX_SIGMA).tolist()
        parameters = _drawn_parameters(engine, rng) if engine is not None and engine.uncertainty else {}
        yield Change(
            inertia=(1.0 + choices.inertia * x, 1.0 + choices.inertia * y, 1.0 + choices.inertia * z),
            mass=1.0 + choices.mass * mass,
            thrust=1.0 if parameters else 1.0 + choices.thrust * thrust,
            parameters=parameters,
        )


def _drawn_parameters(engine: EngineSpec, rng: np.random.Generator) -> dict[str, float]:
    """Draw engine parameters by their uncertainty, common to all engines."""
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


def _describe_tolerances(engine: EngineSpec, choices: Choices) -> tuple[str, ...]:
    """Return the tolerances of the drawn vehicles, a sentence each."""
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


def _list_notes(flight: RecordedFlight) -> tuple[str, ...]:
    notes = list(flight.notes)
    if not flight.has_angles:
        notes.append(
            "no attitude in the log: windows start level, which only drag and a measured velocity could notice"
        )
    if not flight.has_force:
        notes.append("no accelerometer in the log: thrust and mass are not told from inertia")
    return tuple(notes)
