"""The windows of a recorded flight, what each starts with, and what is left of a measurement when it was flown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.results.log.columns import RATES
from cosim.spec.vehicle import Vehicle
from hexjet_identify.replay.flown import Change, Loads, Model, ModelOutput, Starts, Window
from hexjet_identify.replay.recorded import RecordedFlight

CHANNELS: Final = (
    *((f"rate_{rate}", "rad/s") for rate in "pqr"),
    *((f"specific_force_{axis}", "m/s^2") for axis in "xyz"),
    *((axis, "rad") for axis in ("roll", "pitch", "yaw")),
)


@dataclass(frozen=True)
class CutFlight:
    """A flight cut into windows of one length, with their starts and the noise of each channel (9,)."""

    flight: RecordedFlight
    windows: tuple[Window, ...]
    starts: Starts
    scale: Array

    @property
    def rows(self) -> Array:
        """Compared rows (w, n): those of each window behind its start."""
        return np.array([np.arange(window.first + 1, window.last + 1) for window in self.windows])

    @property
    def seconds(self) -> float:
        """Duration of all windows together, s."""
        return float(self.rows.size * self.flight.step)

    def measured(self) -> Array:
        """Return the measured CHANNELS in the windows, (w, n, 9); NaN where the log has no value."""
        flight = self.flight
        values: Array = np.concatenate([flight.rate, flight.force, flight.angles], axis=1)[self.rows]
        return values

    def modelled(self, flown: ModelOutput) -> Array:
        """Return the modelled CHANNELS in the windows, (w, n, 9), angles on the same turn as the measured ones."""
        angles = flown.angles + 2.0 * np.pi * np.round(
            (np.nan_to_num(self.flight.angles) - flown.angles) / (2.0 * np.pi)
        )
        values: Array = np.concatenate([flown.rate, flown.force, angles], axis=1)[self.rows]
        return values

    def only(self, chosen: Sequence[int]) -> CutFlight:
        """Return the flight with the ``chosen`` windows alone."""
        starts = Starts(*(values[list(chosen)] for values in self.starts))
        return replace(self, windows=tuple(self.windows[n] for n in chosen), starts=starts)


def cut_windows(model: Model, flight: RecordedFlight, length_s: float, settling_s: float = 0.5) -> CutFlight:
    """Cut a flight into windows in which its engines carry the vehicle.

    The first ``settling_s`` are left out: what was commanded before the log is not known.  The rates of a start are
    smoothed, and taken as much later as the gyro's filter and latency are.  Raises InputError where it has no two
    windows.
    """
    loads = model.loads(flight, Change())
    flies = flight.usable & _is_carried(model, loads) & ~_find_impacts(flight)
    rows = max(round(length_s / flight.step), 4)
    first = round(settling_s / flight.step)
    windows = []
    while first + rows < len(flies):
        grounded = np.flatnonzero(~flies[first : first + rows + 1])
        if grounded.size:
            first += int(grounded[-1]) + 1
            continue
        windows.append(Window(first, first + rows))
        first += rows
    if len(windows) < 2:
        raise InputError(
            f"{len(windows)} windows of {length_s:g} s in which the engines carry the vehicle; 2 are needed: "
            "another engine or throttle range, or a shorter window_s"
        )
    starts = [window.first for window in windows]
    smooth = _smooth(flight.rate, flight.step)
    gyro = model.vehicle.sensors.gyro
    late = np.minimum(np.array(starts) + round(gyro.filter_s / flight.step) + gyro.latency_samples, len(smooth) - 1)
    noise = measure_noise(model, flight, flies)
    moment = np.zeros((len(windows), 3))
    return CutFlight(flight, tuple(windows), Starts(smooth[late], np.nan_to_num(flight.angles[starts]), moment), noise)


def _is_carried(model: Model, loads: Loads, min_share: float = 0.4) -> Flags:
    """Return at which steps the engines carry ``min_share`` of the weight; with less it stands or falls."""
    lift = np.linalg.norm(loads.forces.sum(axis=1), axis=1)
    return np.asarray(lift > min_share * model.vehicle.mass_kg * GRAVITY)


def _find_impacts(flight: RecordedFlight, max_g: float = 6.0) -> Flags:
    """Return at which steps it hits something: within 0.1 s of a specific force beyond ``max_g``."""
    hard = np.linalg.norm(np.nan_to_num(flight.force), axis=1) > max_g * GRAVITY
    reach = 2 * round(0.1 / flight.step) + 1
    return np.asarray(np.convolve(hard, np.ones(reach), "same") > 0.0)


def _smooth(values: Array, step: float) -> Array:
    from scipy.signal import savgol_filter

    return np.asarray(savgol_filter(np.nan_to_num(values), _smoothing_rows(step), 2, axis=0))


def _smoothing_rows(step: float, seconds: float = 0.03) -> int:
    """Return the number of rows of the Savitzky-Golay filter over ``seconds``."""
    return max(5, 2 * round(0.5 * seconds / step) + 1)


def measure_noise(model: Model, flight: RecordedFlight, flies: Flags) -> Array:
    """Return each channel's noise: its rms about a moving parabola, at least what the vehicle states."""
    from scipy.signal import savgol_coeffs

    rows = _smoothing_rows(flight.step)
    # Of white noise the parabola leaves this share, and the gyro's filter lets pass the one of ``passed``.
    left = float(np.sqrt(1.0 - savgol_coeffs(rows, 2)[rows // 2]))
    sensors = model.vehicle.sensors
    stated = (sensors.gyro.noise_rad_s, sensors.accelerometer.noise_m_s2, sensors.attitude.noise_rad)
    gain = 1.0 - np.exp(-flight.step / sensors.gyro.filter_s) if sensors.gyro.filter_s > 0.0 else 1.0
    passed = (float(np.sqrt(gain / (2.0 - gain))), 1.0, 1.0)
    levels = []
    for values, least, share in zip((flight.rate, flight.force, flight.angles), stated, passed, strict=True):
        rest = (values - _smooth(values, flight.step))[flies]
        spread = np.nanstd(rest, axis=0) / left if np.isfinite(rest).any() else np.zeros(3)
        levels.append(np.maximum(np.nan_to_num(spread), max(least * share, 1e-6)))
    return np.concatenate(levels)


def accelerometer_zero(error: Array, vehicle: Vehicle) -> Array:
    """Return the accelerometer's zero (3,) [m/s^2] that explains errors of the specific force (w, n, 3).

    Across the thrust all of the mean is, for it also depends on how the accelerometer stands; along it no more than
    twice what the vehicle states, as the rest is thrust over mass.
    """
    settings = vehicle.sensors.accelerometer
    most = 2.0 * float(np.hypot(settings.bias_m_s2[2], settings.bias_sigma_m_s2))
    x, y, z = np.nan_to_num(error.mean(axis=(0, 1)))
    return np.array([x, y, np.clip(z, -most, most)])


def without_gyro_offset(flying: CutFlight) -> CutFlight:
    """Return the flight without the gyro's offset from the derivative of its attitude, and note that.

    It is more than chance from three standard errors over the windows on, and from the attitude's noise on.
    """
    from scipy.stats import t

    flight, angles = flying.flight, flying.flight.angles[flying.rows]
    if not np.isfinite(angles).all():
        return flying
    roll, pitch = np.moveaxis(angles[:, :, :2], 2, 0)
    at_roll, at_pitch, at_yaw = np.moveaxis(np.gradient(angles, flight.step, axis=1), 2, 0)
    across = np.cos(pitch) * at_yaw
    turned = (
        at_roll - np.sin(pitch) * at_yaw,
        np.cos(roll) * at_pitch + np.sin(roll) * across,
        np.cos(roll) * across - np.sin(roll) * at_pitch,
    )
    offsets = (np.nan_to_num(flight.rate[flying.rows]) - np.stack(turned, axis=2)).mean(axis=1)
    count, offset = len(offsets), offsets.mean(axis=0)
    chance = float(t.ppf(0.99865, count - 1)) * np.std(offsets, axis=0, ddof=1) / np.sqrt(count)
    off = np.abs(offset) > np.maximum(chance, flying.scale[6:] / (flight.step * angles.shape[1]))
    if not off.any():
        return flying
    offset = np.where(off, offset, 0.0)
    told = ", ".join(f"{r} by {value:.3g}" for r, value, here in zip(RATES, offset.tolist(), off, strict=True) if here)
    note = f"the gyro is off, as the attitude of the log says: {told} rad/s; taken off before the model is compared"
    corrected = replace(flight, rate=flight.rate - offset, notes=(*flight.notes, note))
    starts = flying.starts._replace(rate=flying.starts.rate - offset)
    return replace(flying, flight=corrected, starts=starts)
