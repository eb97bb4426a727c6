"""A sampled loop from its response on the unit circle: predictors, rate PID, poles outside the circle.

Nothing here knows a vehicle.  ``z`` are points on the upper half of the unit circle; ``y`` is the measured rate, ``u``
the command, ``y^`` the predicted rate, ``T`` the control step:

    y^ = P_y y + P_u u
    C_e = p + i T / (1 - z^-1),  D = d s (1 - z^-1) / (T (1 - (1 - s) z^-1)),  s = T / (T_f + T)
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.base.protocols import Predictor
from cosim.control.predictors.linear import Pair, PairResponse
from cosim.spec.vehicle import RateGains, RateModel


def grid(points: int = 3000, lowest: float = 1e-4) -> Complex:
    """Return points z on the upper half of the unit circle, dense at low frequency; ``lowest`` in rad per sample.

    >>> print(np.angle(grid(6, lowest=0.01)).round(3))
    [0.01  0.177 0.524 1.833 3.142]
    """
    angles = np.union1d(np.geomspace(lowest, pi, points // 2), np.linspace(pi / points, pi, points // 2))
    return np.asarray(np.exp(1j * angles))


def impulse_response(predictor: Callable[[], Predictor], model: RateModel) -> PairResponse:
    """Return ``P_y`` and ``P_u`` as a function of z, from the impulse responses of the predictor, which must end.

    Those of a state predictor do, being finite sums over past commands and a fast observer; so the transform is exact.
    Raises InputError for one whose response does not end.

    >>> from cosim.loops import PREDICTORS
    >>> vehicle, _ = load_vehicle("hexjet")
    >>> model = vehicle.identified["edf-as-flown"]["roll"]
    >>> make = lambda: PREDICTORS["state"].predictor(model, vehicle.control.predictor)
    >>> of_rate, _ = impulse_response(make, model)(grid(4))
    >>> print(abs(of_rate).round(3))
    [0.998 0.689 0.273]
    """
    of_rate = _record_impulse_response(predictor(), model, (1.0, 0.0))
    of_command = _record_impulse_response(predictor(), model, (0.0, 1.0))
    # The predictor gets the command of the previous step, so its first answer to it belongs to u / z.
    return lambda z: (_evaluate_z_transform(of_rate, z), _evaluate_z_transform(of_command, z) / z)


def _record_impulse_response(
    predictor: Predictor,
    model: RateModel,
    unit: tuple[float, float],
    ended_below: float = 1e-13,
    max_taps: int = 20_000,
) -> Array:
    values = [predictor.update(*unit)]
    wait = int(model.delay_samples) + 2  # no response before this sample
    ended = 0
    while ended <= wait:
        values.append(predictor.update(0.0, 0.0))
        ended = ended + 1 if abs(values[-1]) < ended_below else 0
        if len(values) > max_taps:
            raise InputError(f"{type(predictor).__name__}: its impulse response does not end; it must be stable alone")
    return np.array(values)


def _evaluate_z_transform(taps: Array, z: Complex) -> Complex:
    """Return ``sum_k h_k z^-k`` at points z: by powers for a few points, by Horner's rule for many."""
    inverse = 1.0 / z
    if z.size < 8:
        return np.asarray(inverse[:, None] ** np.arange(len(taps)) @ taps)
    total = np.zeros_like(z)
    for tap in taps[::-1]:
        total = total * inverse + tap
    return total


def pid_response(gains: RateGains, step: float, z: Complex) -> Pair:
    """Return ``C_e`` (set-point and feedback) and ``D`` (feedback alone) of the rate PID at ``z``; ``step`` in s.

    >>> gains = RateGains(p=2.0, i=1.0, d=0.1, d_filter_s=0.01, integral_limit=1.0)
    >>> error, feedback = pid_response(gains, 0.004, grid(4))
    >>> print(f"{error[-1].real:.3f}, {feedback[-1].real:.3f}")  # at half the sampling rate
    2.002, 8.333
    """
    weight = step / (gains.d_filter_s + step)
    difference = 1.0 - 1.0 / z
    of_slope = gains.d * weight * difference / (step * (1.0 - (1.0 - weight) / z))
    return np.asarray(gains.p + gains.i * step / difference), np.asarray(of_slope)


def zeros_outside(values: Complex) -> int:
    """Return the number of a function's zeros outside the unit circle, where it is analytic and constant at infinity.

    ``values`` along the upper half circle, closely spaced: the function's turns about 0 count its zeros.

    >>> zeros_outside(1.0 - 2.0 / grid())
    1
    """
    turn = np.unwrap(np.angle(values))
    return -round(float(turn[-1] - turn[0]) / pi)
