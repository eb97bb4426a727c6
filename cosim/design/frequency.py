"""A sampled loop from its response on the unit circle: predictors, rate PID, margins, poles outside the circle.

Nothing here knows a vehicle.  ``z`` are points on the upper half of the unit circle; ``y`` is the measured rate, ``u``
the command, ``y^`` the predicted rate, ``T`` the control step:

    y^ = P_y y + P_u u
    C_e = p + i T / (1 - z^-1),  D = d s (1 - z^-1) / (T (1 - (1 - s) z^-1)),  s = T / (T_f + T)
"""

from __future__ import annotations

from collections.abc import Callable
from math import exp, pi, prod

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from cosim.base.errors import InputError
from cosim.base.protocols import Predictor
from cosim.control.predictors.registry import PREDICTORS
from cosim.control.predictors.smith import robustness_filter
from cosim.control.predictors.state import Modes, modal_observer
from cosim.spec.vehicle import PredictorTuning, RateGains, RateModel

Complex = NDArray[np.complex128]
Array = NDArray[np.float64]
Pair = tuple[Complex, Complex]
Response = Callable[[Complex], Complex]
Make = Callable[[str, RateModel, PredictorTuning], Predictor]

_TAPS = 20_000
_QUIET = 1e-13  # an impulse response that stays below this has ended


class Margins(BaseModel):
    """Of an open loop; None where there is no crossing.  Of several crossings, the one with the smallest margin."""

    model_config = ConfigDict(frozen=True)

    cutoff: float | None  # Hz, the first frequency at which the gain falls below 1
    gain_margin: float | None  # dB
    phase_margin: float | None  # deg


def grid(step: float, points: int = 3000, lowest: float = 1e-4) -> Complex:
    """The upper half of the unit circle, dense at low frequency; ``lowest`` in rad per sample."""
    angles = np.union1d(np.geomspace(lowest, pi, points // 2), np.linspace(pi / points, pi, points // 2))
    return np.asarray(np.exp(1j * angles))


def model_response(model: RateModel, z: Complex) -> Complex:
    """The identified response without its delay."""
    zeros = prod((z - zero for zero in model.all_zeros), start=np.ones_like(z))
    poles = prod((z - pole for pole in model.all_poles), start=np.ones_like(z))
    return np.asarray(model.gain * zeros / poles)


def delayed_response(model: RateModel, z: Complex) -> Complex:
    """The identified response with its delay of ``n + f`` samples: mode by mode, the modified z-transform."""
    n = int(model.delay_samples)
    f = model.delay_samples - n
    if not f:
        return np.asarray(model_response(model, z) * z**-n)
    total = np.zeros_like(z)
    poles = model.all_poles
    for i, pole in enumerate(poles):
        others = poles[:i] + poles[i + 1 :]
        residue = model.gain * prod(pole - zero for zero in model.all_zeros) / prod(pole - other for other in others)
        share = 1.0 - f if pole == 1.0 else (pole ** (1.0 - f) - 1.0) / (pole - 1.0)
        total += residue * (share + (1.0 - share) / z) / (z - pole)
    return np.asarray(total * z**-n)


def _make(controller: str, model: RateModel, tuning: PredictorTuning) -> Predictor:
    return PREDICTORS[controller](model, tuning)


def predictor_response(
    controller: str, model: RateModel, tuning: PredictorTuning, make: Make = _make
) -> Callable[[Complex], Pair]:
    """``P_y`` and ``P_u`` as a function of z, both for samples taken at ``t_k``; ``make`` makes the predictor itself.

    The state predictors have no closed form worth writing: they are finite sums over past commands and a fast
    observer, so their impulse response ends and its transform is exact.
    """
    if controller == "baseline":
        return lambda z: (np.ones_like(z), np.zeros_like(z))
    if controller in ("smith", "filtered-smith"):
        numerator, denominator = [1.0], [1.0]
        if controller == "filtered-smith":
            numerator, denominator = robustness_filter(model, tuning.filter_s)

        def smith(z: Complex) -> Pair:
            f = np.polyval(numerator, z) / np.polyval(denominator, z)
            return f, model_response(model, z) - f * delayed_response(model, z)

        return smith
    of_rate = _impulse(make(controller, model, tuning), controller, model, (1.0, 0.0))
    of_command = _impulse(make(controller, model, tuning), controller, model, (0.0, 1.0))
    # the predictor is told the command of the step before: its first answer to it belongs to u / z
    return lambda z: (_transform(of_rate, z), _transform(of_command, z) / z)


def _impulse(predictor: Predictor, controller: str, model: RateModel, unit: tuple[float, float]) -> Array:
    values = [predictor.update(*unit)]
    wait = int(model.delay_samples) + 2  # nothing may come before that
    silent = 0
    while silent <= wait:
        values.append(predictor.update(0.0, 0.0))
        silent = silent + 1 if abs(values[-1]) < _QUIET else 0
        if len(values) > _TAPS:
            raise InputError(f"{controller}: its impulse response does not end; it must be stable on its own")
    return np.array(values)


def _transform(taps: Array, z: Complex) -> Complex:
    """``sum_k h_k z^-k``: by powers for a few points, by Horner's rule for many."""
    inverse = 1.0 / z
    if z.size < 8:
        return np.asarray(inverse[:, None] ** np.arange(len(taps)) @ taps)
    total = np.zeros_like(z)
    for tap in taps[::-1]:
        total = total * inverse + tap
    return total


def pid_response(gains: RateGains, step: float, z: Complex) -> Pair:
    """``C_e`` (set-point and feedback) and ``D`` (feedback alone) of the rate PID."""
    share = step / (gains.d_filter_s + step)
    difference = 1.0 - 1.0 / z
    of_slope = gains.d * share * difference / (step * (1.0 - (1.0 - share) / z))
    return np.asarray(gains.p + gains.i * step / difference), np.asarray(of_slope)


def zeros_outside(values: Complex) -> int:
    """Zeros outside the unit circle of a function that is analytic there and goes to a constant at infinity.

    ``values`` along the upper half circle, closely spaced: the function's turns about 0 count its zeros.
    """
    turn = np.unwrap(np.angle(values))
    return -round(float(turn[-1] - turn[0]) / pi)


def margins(response: Response, step: float, low: float = 0.05, points: int = 4000) -> Margins:
    """Margins of a sampled open loop from its response on the unit circle, from ``low`` Hz to half the sample rate."""
    frequencies = np.geomspace(low, 0.5 / step * (1.0 - 1e-9), points)
    values = response(np.exp(2j * pi * frequencies * step))

    def at(frequency: float) -> complex:
        return complex(response(np.exp(np.array([2j * pi * frequency * step])))[0])

    gains, falls, phases = [], [], []
    size = np.abs(values) - 1.0
    for k in np.flatnonzero(np.sign(size[:-1]) != np.sign(size[1:])):
        crossing = _bisect(lambda f: abs(at(f)) - 1.0, frequencies[k], frequencies[k + 1])
        phases.append(wrapped(float(np.degrees(np.angle(at(crossing)))) + 180.0))
        if size[k] > 0.0:
            falls.append(crossing)
    turns = (np.sign(values.imag[:-1]) != np.sign(values.imag[1:])) & (values.real[:-1] < 0.0)
    for k in np.flatnonzero(turns):
        crossing = _bisect(lambda f: at(f).imag, frequencies[k], frequencies[k + 1])
        gains.append(-20.0 * float(np.log10(abs(at(crossing)))))
    return Margins(
        cutoff=falls[0] if falls else None,
        gain_margin=min(gains, key=abs, default=None),
        phase_margin=min(phases, key=abs, default=None),
    )


def _bisect(function: Callable[[float], float], low: float, high: float) -> float:
    sign = function(low)
    for _ in range(40):
        middle = 0.5 * (low + high)
        if (function(middle) > 0.0) == (sign > 0.0):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def wrapped(degrees: float) -> float:
    """An angle between -180 and 180 degrees."""
    return (degrees + 180.0) % 360.0 - 180.0


def observer_response(model: RateModel, bandwidth: float, disturbance: bool) -> Callable[[Complex], Pair]:
    """``P_y`` and ``P_u`` of ``state-model`` and, with ``disturbance``, of ``state-disturbance``, in closed form.

    With ``x`` the observer's state, ``M = (I - L C) F`` and ``v`` what each state is worth when the delay is over,

        P_y = v z (z I - M)^-1 L,   P_u = sum_i c_i (1 - p_i^h D_i) / (z - p_i) + v (z I - M)^-1 (I - L C) D,

    ``D_i = z^-n (s_i + (1 - s_i) / z)`` the way from a command to mode ``i``; ``det(z I - M) = (z - q)^n``, and the
    numerators come from Faddeev's recursion.
    """
    modes = Modes(model)
    step, order = model.sample_time_s, len(modes.poles)
    F, gain = modal_observer(modes, bandwidth, step, disturbance)
    n = len(F)
    c = np.zeros(n, F.dtype)
    c[:order] = modes.residues
    v = np.zeros(n, F.dtype)
    v[:order] = modes.ahead()
    if disturbance:
        v[order] = modes.gathered()
    correct = np.eye(n) - np.outer(gain, c)
    M = correct @ F
    denominator = np.poly([exp(-bandwidth * step)] * n)
    rows = []
    adjugate = np.eye(n, dtype=F.dtype)
    for k in range(n):
        rows.append(v @ adjugate)
        adjugate = M @ adjugate + denominator[k + 1] * np.eye(n)
    of_rate = [row @ gain for row in rows]
    of_mode = [[row @ correct[:, i] for row in rows] for i in range(order)]

    def response(z: Complex) -> Pair:
        under = np.polyval(denominator, z)
        command = np.zeros_like(z)
        late = z**-modes.whole
        for c_i, p, s, numerator in zip(modes.residues, modes.poles, modes.shares, of_mode, strict=True):
            arrives = late if s == 1.0 else late * (s + (1.0 - s) / z)
            command += c_i * (1.0 - p**modes.delay * arrives) / (z - p)
            command += np.polyval(numerator, z) / under * arrives
        return np.asarray(z * np.polyval(of_rate, z) / under), command

    return response
