"""How alike what was measured and what was modelled are: in time, by Theil, and over frequency."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Complex, Flags
from hexjet_identify.replay.windows import CHANNELS, CutFlight

# Edges of the bands, in periods a window.
BAND_EDGES: Final = (1.0, 3.0, 8.0, 25.0)
# Judged by its rms instead of its variation: it is thrust over mass, which shows without movement.
LEVEL_CHANNEL: Final = "specific_force_z"
# Minimum rms of a channel, in units of its noise, to be judged.
MIN_EXCITATION: Final = 2.0
# Minimum share of the time within the envelope of an explained channel.
MIN_TIME_WITHIN: Final = 0.9


class Theil(NamedTuple):
    """Theil's inequality coefficient, 0 for equal and 1 for useless, and the parts of the squared error.

    ``bias``, ``variance`` and ``covariance`` add up to 1: other means, other sizes, and what goes another way
    (H. Theil, *Economic Forecasts and Policy*, 1961, chapter 2).
    """

    u: float
    bias: float
    variance: float
    covariance: float


class Ratio(NamedTuple):
    """Measured over modelled by frequency, with the coherence and the power spectra of both and of their difference.

    ``excited`` is where the model moves more than the noise of the channel; powers are in squares of the unit a hertz.
    """

    hertz: Array
    value: Complex
    coherence: Array
    excited: Flags
    measured: Array
    modelled: Array
    error: Array


class Band(NamedTuple):
    """A frequency band of a channel: movement, error, Theil's U, coherence, gain and phase.

    ``gain_db`` and ``phase_deg`` are measured over modelled, None where both are not coherent.
    """

    low_hz: float
    high_hz: float
    measured_rms: float
    error_rms: float
    u: float
    coherence: float
    gain_db: float | None
    phase_deg: float | None
    excited: bool


class ChannelMeasures(NamedTuple):
    """A channel of a replay: the share of the time ``within`` the envelope, rms of error, movement and noise, and more.

    ``measured_rms`` is about the mean in each window.
    """

    name: str
    unit: str
    within: float
    rms: float
    measured_rms: float
    noise: float
    theil: Theil
    bands: tuple[Band, ...]
    excited: bool
    ratio: Ratio

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the ratio, for JSON."""
        values = {**self._asdict(), "theil": self.theil._asdict(), "bands": [band._asdict() for band in self.bands]}
        del values["ratio"]
        return values


def theil(measured: Array, modelled: Array) -> Theil:
    """Return Theil's coefficient of two signals (w, n), about the mean measured in each window."""
    mean = measured.mean(axis=1, keepdims=True)
    y, x = (measured - mean).ravel(), (modelled - mean).ravel()
    size = float(np.sqrt(np.mean(y**2)) + np.sqrt(np.mean(x**2)))
    square = float(np.mean((y - x) ** 2))
    if not square > 0.0 or not size > 0.0:
        return Theil(0.0, 0.0, 0.0, 0.0)
    sy, sx = float(np.std(y)), float(np.std(x))
    bias, variance = float(np.mean(y) - np.mean(x)) ** 2 / square, (sy - sx) ** 2 / square
    return Theil(float(np.sqrt(square)) / size, bias, variance, max(1.0 - bias - variance, 0.0))


def measure_ratio(measured: Array, modelled: Array, step: float, noise: float) -> Ratio:
    """Return measured over modelled by frequency of two signals (w, n), a segment a window (Welch)."""
    from scipy.signal import csd, welch

    kind = {"fs": 1.0 / step, "nperseg": measured.shape[1], "noverlap": 0, "detrend": "linear"}
    y, x = measured.ravel(), modelled.ravel()
    hertz, of_x = welch(x, **kind)
    of_y, cross = welch(y, **kind)[1], csd(x, y, **kind)[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.nan_to_num(cross / of_x)
        coherence = np.nan_to_num(np.abs(cross) ** 2 / (of_x * of_y))
    error = np.maximum(of_x + of_y - 2.0 * cross.real, 0.0)
    return Ratio(hertz, value, coherence, of_x > 2.0 * step * noise**2, of_y, of_x, error)


def measure_bands(ratio: Ratio, noise: float, min_coherence: float = 0.6) -> tuple[Band, ...]:
    """Return the bands of a channel below 0.8 of the Nyquist frequency; gain and phase from ``min_coherence`` on."""
    width, most_hz = float(ratio.hertz[1]), 0.8 * float(ratio.hertz[-1])
    bands = []
    for low_hz, high_hz in pairwise(width * edge for edge in BAND_EDGES):
        inside = (ratio.hertz >= low_hz - 1e-9) & (ratio.hertz < high_hz) & (ratio.hertz <= most_hz)
        if not inside.any():
            continue
        powers = (ratio.measured, ratio.modelled, ratio.error)
        y, x, e = (float(np.sqrt(width * np.sum(power[inside]))) for power in powers)
        weights = ratio.modelled[inside]
        coherence = float(np.average(ratio.coherence[inside], weights=weights)) if x > 0.0 else 0.0
        excited = bool(y > MIN_EXCITATION * noise * np.sqrt(np.sum(inside) * width / ratio.hertz[-1]))
        gain = phase = None
        if excited and x > 0.0 and coherence >= min_coherence:
            mean = complex(np.average(ratio.value[inside], weights=weights))
            gain, phase = float(20.0 * np.log10(max(abs(mean), 1e-6))), float(np.degrees(np.angle(mean)))
        u = e / (x + y) if x + y > 0.0 else 0.0
        bands.append(Band(low_hz, min(high_hz, most_hz), y, e, u, coherence, gain, phase, excited))
    return tuple(bands)


def measure_channels(flying: CutFlight, modelled: Array, low: Array, high: Array) -> tuple[ChannelMeasures, ...]:
    """Return the measures of each channel that the log has, of a model (w, n, 9) and the ends of its envelope."""
    measured, step = flying.measured(), flying.flight.step
    shares = np.mean((measured >= low) & (measured <= high), axis=(0, 1))
    channels = []
    for c, (name, unit) in enumerate(CHANNELS):
        y, x, noise = measured[:, :, c], modelled[:, :, c], float(flying.scale[c])
        if not np.isfinite(y).all():
            continue
        moved = float(np.sqrt(np.mean((y - y.mean(axis=1, keepdims=True)) ** 2)))
        ratio = measure_ratio(y, x, step, noise)
        error = float(np.sqrt(np.mean((y - x) ** 2)))
        level = float(np.sqrt(np.mean(y**2))) if name == LEVEL_CHANNEL else moved
        excited = level > MIN_EXCITATION * noise
        bands = measure_bands(ratio, noise)
        values = (float(shares[c]), error, moved, noise, theil(y, x), bands, excited, ratio)
        channels.append(ChannelMeasures(name, unit, *values))
    return tuple(channels)
