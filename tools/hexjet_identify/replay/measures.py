"""How alike what was measured and what was modelled are: in time, by Theil, and over frequency."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Complex, Flags
from hexjet_identify.replay.windows import CHANNELS, Flying

EDGES: Final = (1.0, 3.0, 8.0, 25.0)  # of the bands, in periods a window
LEVEL: Final = "specific_force_z"  # whose level is thrust over mass, and says something where nothing moves
COHERENT: Final = 0.6  # from here on a ratio of the two says something
EXCITED: Final = 2.0  # times its noise that a channel moves, rms, from where on it says something
NEEDED: Final = 0.9  # share of the time within the envelope with which a channel is explained


class Theil(NamedTuple):
    """Theil's inequality coefficient, 0 for equal and 1 for useless, and what the squared error consists of.

    ``bias``, ``variance`` and ``covariance`` add up to 1: other means, other sizes, and what goes another way
    (H. Theil, *Economic Forecasts and Policy*, 1961, chapter 2).
    """

    u: float
    bias: float
    variance: float
    covariance: float


class Ratio(NamedTuple):
    """Measured over modelled by frequency: the response that leads from the one to the other, with coherence."""

    hertz: Array
    value: Complex
    coherence: Array
    excited: Flags  # whether the model moves more than the noise of the channel there


class Band(NamedTuple):
    """A band of a channel: what of it moved, and how alike both are in it."""

    low_hz: float
    high_hz: float
    measured_rms: float
    error_rms: float
    u: float
    coherence: float
    gain_db: float | None  # measured over modelled where both are coherent
    phase_deg: float | None
    excited: bool


class ChannelMeasures(NamedTuple):
    """A channel of a replay."""

    name: str
    unit: str
    within: float  # share of the time within the envelope
    rms: float  # of the error
    measured_rms: float  # about its mean in each window
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


class FrequencyBand(NamedTuple):
    """The frequencies of a band: its edges, and which of a window's it has."""

    low_hz: float
    high_hz: float
    inside: Flags


def band_parts(count: int, step: float) -> Iterator[FrequencyBand]:
    """Yield the bands of windows of so many rows; those above what the rows can tell are left out."""
    hertz = np.fft.rfftfreq(count, step)
    for low, high in pairwise(EDGES):
        low_hz, high_hz = (edge / (count * step) for edge in (low, high))
        inside = (hertz >= low_hz - 1e-9) & (hertz < high_hz) & (hertz <= 0.4 / step)
        if inside.any():
            yield FrequencyBand(low_hz, min(high_hz, 0.4 / step), inside)


def theil(measured: Array, modelled: Array) -> Theil:
    """Return the coefficient and the split of two signals (w, n), about the mean measured in each window."""
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

    count = measured.shape[1]
    kind = {"fs": 1.0 / step, "nperseg": count, "noverlap": 0, "detrend": "linear"}
    y, x = measured.ravel(), modelled.ravel()
    hertz, of_x = welch(x, **kind)
    of_y, cross = welch(y, **kind)[1], csd(x, y, **kind)[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.nan_to_num(cross / of_x)
        coherence = np.nan_to_num(np.abs(cross) ** 2 / (of_x * of_y))
    return Ratio(hertz, value, coherence, of_x > 2.0 * step * noise**2)


def measure_bands(measured: Array, modelled: Array, ratio: Ratio, step: float, noise: float) -> tuple[Band, ...]:
    """Return the bands of a channel (w, n)."""
    from scipy.signal import welch

    count = measured.shape[1]
    kind = {"fs": 1.0 / step, "nperseg": count, "noverlap": 0, "detrend": "linear"}
    of = [welch(signal.ravel(), **kind)[1] for signal in (measured, modelled, measured - modelled)]
    width = float(ratio.hertz[1])
    bands = []
    for low_hz, high_hz, inside in band_parts(count, step):
        y, x, e = (float(np.sqrt(width * np.sum(power[inside]))) for power in of)
        power = of[1][inside]
        moves = bool(np.sum(power) > 0.0)
        coherence = float(np.average(ratio.coherence[inside], weights=power)) if moves else 0.0
        excited = bool(y > EXCITED * noise * np.sqrt(2.0 * step * width * np.sum(inside)))
        gain = phase = None
        if excited and moves and coherence >= COHERENT:
            mean = complex(np.average(ratio.value[inside], weights=power))
            gain, phase = float(20.0 * np.log10(max(abs(mean), 1e-6))), float(np.degrees(np.angle(mean)))
        bands.append(Band(low_hz, high_hz, y, e, e / (x + y) if x + y > 0.0 else 0.0, coherence, gain, phase, excited))
    return tuple(bands)


def measure_channels(flying: Flying, modelled: Array, low: Array, high: Array) -> tuple[ChannelMeasures, ...]:
    """Return the measures of each channel that the log has, of a model (w, n, 9) and the ends of its envelope."""
    measured, step, noise = flying.measured(), flying.flight.step, flying.scale
    shares = np.mean((measured >= low) & (measured <= high), axis=(0, 1))
    channels = []
    for c, (name, unit) in enumerate(CHANNELS):
        y, x = measured[:, :, c], modelled[:, :, c]
        if not np.isfinite(y).all():
            continue
        moved = float(np.sqrt(np.mean((y - y.mean(axis=1, keepdims=True)) ** 2)))
        ratio = measure_ratio(y, x, step, float(noise[c]))
        bands = measure_bands(y, x, ratio, step, float(noise[c]))
        error = float(np.sqrt(np.mean((y - x) ** 2)))
        level = float(np.sqrt(np.mean(y**2))) if name == LEVEL else moved
        excited = level > EXCITED * float(noise[c])
        values = (float(shares[c]), error, moved, float(noise[c]), theil(y, x), bands, excited, ratio)
        channels.append(ChannelMeasures(name, unit, *values))
    return tuple(channels)
