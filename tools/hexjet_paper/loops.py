"""The loop of :mod:`hexjet_paper.linear` as transfer functions: margins, unstable poles, sensitivity, and a sweep.

``y`` measured rate, ``u`` command, ``y^`` predicted rate, ``P_y`` and ``P_u`` the predictor's two ways to it, ``G`` the
plant, ``d`` the added delay, ``T`` the control step:

    y^ = P_y y + P_u u,  y = G z^-d u,  G* = y^ / u = P_u + P_y G z^-d          (the paper's augmented plant)
    C_e = p + i T / (1 - z^-1),  D = d s (1 - z^-1) / (T (1 - (1 - s) z^-1)),  C = C_e + D
    closed: 1 + C G* + C_e K T/2 (z + 1)/(z - 1) G z^-d = 0                     (K the attitude gain)
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, pi

import numpy as np

from cosim import InputError
from cosim.loops import (
    PredictorTuning,
    RateModel,
    delayed_response,
    grid,
    impulse_response,
    model_response,
    pid_response,
    zeros_outside,
)
from hexjet_paper.linear import Array, Axis, Complex, Pair, PairResponse, Plant, Response, predictor, simulate
from hexjet_paper.numbers import Record

BY_IMPULSE = ("state-model", "state-disturbance")  # without a closed form here
# Low end of the paper's Bode diagrams as read, where their gain is compared: with an integral there is none at 0 Hz.
LOW_END_HZ = 1.0


def plant_response(plant: Plant, z: Complex, delay: int) -> Complex:
    """Return the frequency response from command to rate, with the added delay."""
    model = plant.model.model_copy(update={"delay_samples": plant.extra_samples})
    return np.asarray(plant.gain * delayed_response(model, z) * z ** -float(delay))


def predictor_response(controller: str, model: RateModel, tuning: PredictorTuning) -> PairResponse:
    """Return ``P_y`` and ``P_u`` of a predictor as a function of z, also with the paper's printed matrices."""
    spec = predictor(controller)
    if spec.response is not None and controller not in BY_IMPULSE:
        return spec.response(model, spec.own(tuning))
    return impulse_response(lambda: spec.predictor(model, tuning), model)


def controllers_response(axis: Axis, z: Complex) -> Pair:
    """Return ``C_e`` (on set-point and feedback) and ``D`` (on feedback alone) of the rate PID."""
    return pid_response(axis.gains, axis.step, z)


def open_loop(axis: Axis, answer: PairResponse | None = None) -> Response:
    """Return ``C G*`` of the rate loop, as in the paper's Bode diagrams; ``answer``: the predictor's, if known."""
    of_predictor = answer or predictor_response(axis.controller, axis.model, axis.tuning)

    def rate_loop_response(z: Complex) -> Complex:
        of_rate, of_command = of_predictor(z)
        error, slope = controllers_response(axis, z)
        augmented = of_command + of_rate * plant_response(axis.plant, z, axis.delay_samples)
        return np.asarray((error + slope) * augmented)

    return rate_loop_response


class Margins(Record):
    """Smallest margins of an open loop [dB, deg], and first frequency [Hz] of gain 1; None without a crossing."""

    cutoff: float | None
    gain_margin: float | None
    phase_margin: float | None


def margins(response: Response, step: float, low: float = 0.05, points: int = 4000) -> Margins:
    """Return the margins of a sampled open loop from ``low`` [Hz] to half the sample rate."""
    hertz = np.geomspace(low, 0.5 / step, points)
    return _find_margins(hertz, *_to_bode(response(np.exp(2j * pi * hertz * step))))


class Sweep(Record):
    """Measured frequency response of an open loop, with its margins."""

    frequency: list[float]  # Hz
    gain: list[float]  # dB
    phase: list[float]  # deg, unwrapped
    augmented_gain: list[float]  # dB, of y^/u alone
    augmented_phase: list[float]  # deg, of y^/u alone
    margins: Margins


def sweep(axis: Axis, period: float = 8.0, low: float = 0.25, high: float = 20.0, amplitude: float = 1e-3) -> Sweep:
    """Measure ``C G*`` in the closed rate loop with sines added to the command, as the paper does.

    All multiples of ``1 / period`` from ``low`` to ``high`` Hz at once, with Schroeder's phases; the second period is
    evaluated.  With ``w`` added before the predictor's tap, ``G* = y^ / (u + w)`` and ``C G* = -u / (u + w)``.
    Raises InputError where the loop is not stable: it cannot be swept closed.
    """
    loop = replace(axis, attitude_gain=0.0, noise=0.0, command_limit=inf, rate_limit=inf, knows_disturbance=True)
    if unstable_poles(loop):
        raise InputError(f"{axis.controller}: the rate loop is unstable, lower its gain or its delay before a sweep")
    n = round(period / axis.step)
    bins = range(round(low * period), round(high * period) + 1)
    phases = [-pi * i * i / len(bins) for i in range(len(bins))]
    wave = [
        amplitude * sum(cos(2.0 * pi * (b * k % n) / n + phase) for b, phase in zip(bins, phases, strict=True))
        for k in range(n)
    ]
    record = simulate(loop, 3 * n, disturbance=lambda k: wave[k % n])

    def find_spectrum(values: Array) -> Complex:
        return np.asarray(np.fft.rfft(values[2 * n :])[bins.start : bins.stop])

    u, w = find_spectrum(np.array(record.command)), find_spectrum(np.array(record.disturbance))
    augmented = find_spectrum(np.array(record.predicted)) / (u + w)
    measured = -u / (u + w)
    gain, phase = _to_bode(augmented)
    update = {"augmented_gain": gain.tolist(), "augmented_phase": phase.tolist()}
    return measured_sweep(np.array(bins) / period, measured).model_copy(update=update)


def measured_sweep(hertz: Array, response: Complex) -> Sweep:
    """Return a sweep from points of an open loop ``C G*`` measured elsewhere; ``hertz`` rises."""
    gain, phase = _to_bode(response)
    return Sweep(
        frequency=hertz.tolist(), gain=gain.tolist(), phase=phase.tolist(), augmented_gain=[], augmented_phase=[],
        margins=_find_margins(hertz, gain, phase),
    )  # fmt: skip


def _to_bode(values: Complex) -> tuple[Array, Array]:
    phase = np.degrees(np.unwrap(np.angle(values)))
    return 20.0 * np.log10(np.abs(values)), phase - 360.0 * np.round(phase[0] / 360.0)


def _find_margins(frequency: Array, gain: Array, phase: Array) -> Margins:
    """Return margins from measured points, with gain and phase linear over the logarithm of frequency."""
    x = np.log(frequency)

    def find_crossings(values: Array, level: float) -> list[tuple[float, int]]:
        above = values > level
        crossed = []
        for k in np.flatnonzero(above[:-1] != above[1:]):
            fraction = (level - values[k]) / (values[k + 1] - values[k])
            crossed.append((float(x[k] + fraction * (x[k + 1] - x[k])), int(k)))
        return crossed

    cuts = find_crossings(gain, 0.0)
    levels = 360.0 * np.arange(np.ceil(phase.min() / 360.0 + 0.5), np.floor(phase.max() / 360.0 + 0.5) + 1.0) - 180.0
    turns = [at for level in levels for at, _ in find_crossings(phase, level)]
    return Margins(
        cutoff=next((float(np.exp(at)) for at, k in cuts if gain[k] > 0.0), None),
        gain_margin=min((-float(np.interp(at, x, gain)) for at in turns), key=abs, default=None),
        phase_margin=min((_wrap(float(np.interp(at, x, phase)) + 180.0) for at, _ in cuts), key=abs, default=None),
    )


def _wrap(degrees: float) -> float:
    """Return an angle between -180 and 180 degrees."""
    return (degrees + 180.0) % 360.0 - 180.0


class LoopMap:
    """One loop with its predictor's response cached, to judge it with many plants."""

    def __init__(self, axis: Axis, points: int = 3000, known: tuple[Complex, Complex, Complex] | None = None) -> None:
        """Compute the loop's responses; ``known``: points of the upper half circle with ``P_y`` and ``P_u`` there."""
        self._axis = axis
        z = known[0] if known else grid(points)
        of_rate, of_command = known[1:] if known else predictor_response(axis.controller, axis.model, axis.tuning)(z)
        error, slope = controllers_response(axis, z)
        angle = 0.5 * axis.step * (z + 1.0) / (z - 1.0)
        self._z = z
        self._inner = 1.0 + (error + slope) * of_command
        self._outer = (error + slope) * of_rate + error * axis.attitude_gain * angle
        self._model = axis.plant.gain * model_response(axis.plant.model, z)
        integrators = (1 if axis.gains.i else 0) + (1 if axis.attitude_gain else 0)
        self._clear = (1.0 - 1.0 / z) ** integrators

    def plant(self, gain: float, delay: int) -> Complex:
        """Return the response from command to rate at ``gain`` times the plant's and ``delay`` samples in all."""
        return np.asarray(gain * self._model * self._z ** -float(delay))

    def characteristic(self, gain: float, delay: int) -> Complex:
        """Return the characteristic function ``1 + C G* + C_e K I G z^-d`` with that plant."""
        return np.asarray(self._inner + self._outer * self.plant(gain, delay))

    def unstable_poles(self, gain: float, delay: int) -> int:
        """Count the closed-loop poles outside the unit circle.

        All blocks are stable on their own but for integrators, whose poles at 1 are cancelled: the rest is analytic
        outside the circle and goes to 1 at infinity, so its turns about 0 along the circle count its zeros there.
        """
        return zeros_outside(self._clear * self.characteristic(gain, delay))

    def peak_sensitivity(self, gain: float, delay: int) -> float:
        """Return ``M_s = max |1 / (1 + L)|``, the loop ``L`` opened at the plant's input."""
        return float(np.max(np.abs(self._inner / self.characteristic(gain, delay))))


def unstable_poles(axis: Axis) -> int:
    """Count the loop's closed-loop poles outside the unit circle, with the attitude loop if it has a gain.

    Raises InputError for an unmodelled delay that is not whole.
    """
    extra = axis.plant.extra_samples
    if extra != int(extra):
        raise InputError(f"unstable poles: an extra delay of {extra:g} samples must be whole")
    return LoopMap(axis).unstable_poles(1.0, axis.delay_samples + int(extra))


def gain_at(loop: Axis, frequency: float) -> float:
    """Return the gain [dB] of ``C G*`` at a frequency [Hz]."""
    z = np.exp(np.array([2j * np.pi * frequency * loop.step]))
    return float(20.0 * np.log10(np.abs(open_loop(loop)(z)[0])))
