"""What the attitude of a log says of its gyro: a constant that is off, and another unit.  No model is needed for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.results.log.columns import RATES
from hexjet_identify.replay.windows import Flying, slopes

SURE: Final = 0.99865  # quantile: three standard deviations, were they known
OTHER_UNIT: Final = 5.0  # times as far as the rates say the attitude turns, or a fifth of it: the units differ
ALIKE: Final = 0.9  # correlation of both turns from where on their ratio says something


def without_gyro_offset(flying: Flying, log: str) -> Flying:
    """Return the flight with the offset of its gyro taken off and noted, where its attitude tells one.

    Raises InputError where the attitude turns by another unit than the rates.
    """
    flight, angles = flying.flight, flying.flight.angles[flying.rows]
    if not np.isfinite(angles).all():
        return flying
    matrices = euler_rates(angles)
    rates = np.nan_to_num(flight.rate[flying.rows])
    turned = flight.step * np.cumsum(np.einsum("wnij,wnj->wni", matrices, rates), axis=1)
    _check_units(log, angles - angles[:, :1], turned - turned[:, :1])
    drift = slopes(angles - turned, flight.step)
    offsets = -np.linalg.solve(matrices.mean(axis=1), drift[:, :, None])[:, :, 0]
    offset = offsets.mean(axis=0)
    off = np.abs(offset) > np.maximum(_bound(offsets), flying.scale[6:] / (flight.step * angles.shape[1]))
    if not off.any():
        return flying
    offset = np.where(off, offset, 0.0)
    told = ", ".join(f"{r} by {value:.3g}" for r, value, here in zip(RATES, offset.tolist(), off, strict=True) if here)
    note = f"the gyro is off, as the attitude of the log says: {told} rad/s; taken off before the model is compared"
    corrected = replace(flight, rate=flight.rate - offset, notes=(*flight.notes, note))
    starts = flying.starts._replace(rate=flying.starts.rate - offset)
    return replace(flying, flight=corrected, starts=starts)


def euler_rates(angles: Array) -> Array:
    """Return the matrices (..., 3, 3) from body rates to the rates of roll, pitch and yaw at these angles [rad]."""
    roll, pitch = angles[..., 0], np.clip(angles[..., 1], -1.5, 1.5)
    zero, one = np.zeros_like(roll), np.ones_like(roll)
    rows = (
        (one, np.sin(roll) * np.tan(pitch), np.cos(roll) * np.tan(pitch)),
        (zero, np.cos(roll), -np.sin(roll)),
        (zero, np.sin(roll) / np.cos(pitch), np.cos(roll) / np.cos(pitch)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _bound(offsets: Array) -> Array:
    """Return what a mean over the windows (w, 3) has to exceed to be more than chance."""
    from scipy.stats import t

    count = len(offsets)
    spread = np.std(offsets, axis=0, ddof=1) / np.sqrt(count)
    return np.asarray(float(t.ppf(SURE, count - 1)) * spread)


def _check_units(log: str, measured: Array, turned: Array) -> None:
    """Raise InputError where the attitude turns many times as far as the rates say, or hardly."""
    one, other = (values - values.mean(axis=1, keepdims=True) for values in (measured, turned))
    power = float(np.sum(other**2))
    ratio = float(np.sum(one * other)) / power if power > 0.0 else 1.0
    alike = abs(ratio) * np.sqrt(power / max(float(np.sum(one**2)), 1e-300))
    if alike > ALIKE and not 1.0 / OTHER_UNIT < abs(ratio) < OTHER_UNIT:
        raise InputError(
            f"{log}: the attitude turns {abs(ratio):.3g} times as far as the rates say: both must be in radians, "
            f"{'the attitude' if abs(ratio) > 1.0 else 'the rates'} may be in degrees"
        )
