"""The limit of performance of a plant stated as a fraction: no vehicle, no engine, no JSBSim."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, log

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.loops import proper_fraction
from hexjet_design.loop.optimal import CIRCLE_TOLERANCE, polynomial, split_zeros
from hexjet_design.loop.programme import UNIFORM_DELAYS, Bounds, InvertedPlant, Programme, need_solver, splines


@dataclass(frozen=True)
class LoadLimit:
    """The least error after a load, and the closed loop that reaches it.

    ``load_error`` is the integral of the output's size over ``window_s`` after a unit step of load, s per unit of the
    command; ``noise`` the command's standard deviation per that of white noise in each sample of the output;
    ``complementary`` the impulse response of ``T = L / (1 + L)``, sample by sample from a command on.
    """

    load_error: float
    peak_sensitivity: float
    noise: float
    complementary: Array
    window_s: float


class _Plant(InvertedPlant):
    """Plant with one output, which is all that the controller measures."""

    def __init__(
        self, numerator: Array, denominator: Array, step: float, delay: int, window: float | None, most: int = 20_000
    ) -> None:
        zeros, poles = np.roots(numerator), np.roots(denominator)
        stable = [complex(pole) for pole in poles if abs(pole - 1.0) >= CIRCLE_TOLERANCE]
        self._integrals = len(poles) - len(stable)
        if self._integrals > 2 or any(abs(pole) > 1.0 - CIRCLE_TOLERANCE for pole in stable):
            raise InputError("denominator: a pole on or outside the unit circle, other than one or two at 1")
        self.name, self.late, self.step = "plant", delay + len(denominator) - len(numerator), step
        if self.late < 1:
            raise InputError("numerator: answers in the step of the command; it must be late by a step or more")
        if any(abs(zero - 1.0) < CIRCLE_TOLERANCE for zero in zeros):
            raise InputError("numerator: a zero at 1, behind which no loop is 1 at rest")
        kept, inside = split_zeros(zeros)
        self.kept = kept / kept.sum()
        self.inverted = inside * (numerator.sum() / denominator[0] / inside.sum())
        self.denominator, self._stable = denominator / denominator[0], polynomial(stable)
        self.is_double = self._integrals == 2
        slowest = max((-1.0 / log(abs(pole)) for pole in stable if pole), default=0.0)
        self.samples = round(max(50.0 * self.late, 3.0 * slowest) if window is None else window / step)
        self.length = self.samples - self.late
        if not 9 * self.late <= self.samples <= most:
            raise InputError(f"window: {self.samples} steps; {9 * self.late}, nine times the delay, to {most}")

    def angle_of_load(self, acts: Array, late: int = 0) -> Array:
        response = self.delayed(acts, late + self.late)
        for _ in range(self._integrals + 1):
            response = response.cumsum(0)
        return np.asarray(lfilter(np.convolve(self.inverted, self.kept), self._stable, response, axis=0))

    def noise_responses(self, t: Array, y: Array) -> tuple[Array, Array, Array]:
        longer = np.concatenate([t, np.zeros((UNIFORM_DELAYS * self.late, *t.shape[1:]))])
        return self.to_command(longer), np.zeros((len(longer), 0)), np.zeros((0, 0))

    def evaluate(self, t: Array) -> LoadLimit:
        complementary = self.delayed(t, self.late)
        acts = self.delayed(np.ones(1), 0) - complementary
        return LoadLimit(
            float(np.abs(self.angle_of_load(acts)).sum()) * self.step,
            float(np.abs(np.fft.rfft(acts, 1 << 17)).max()),
            float(np.linalg.norm(self.noise_responses(t, t)[0])),
            complementary,
            self.samples * self.step,
        )


def least_load_error(
    numerator: ArrayLike,
    denominator: ArrayLike,
    dt: float,
    delay: float = 0.0,
    peak: float = 1.7,
    noise: float = inf,
    window: float | None = None,
) -> LoadLimit:
    """Return the least error after a load that any linear controller leaves on ``N(z) / D(z) z^(-delay / dt)``.

    Over all controllers that stabilise the plant and read its output alone, with ``|S| <= peak`` at every frequency.
    ``T = q^d t``, ``q = 1 / z``, is any stable response behind the plant's delay of ``d`` steps that keeps the zeros on
    or outside the unit circle, is 1 at rest, and of a plant with two integrals has no slope there; output after a load,
    noise and ``S = 1 - T`` are convex in it (:mod:`hexjet_design.loop.limit` has the sources).  The splines of ``t``
    can only miss the least from above.

    A gain of 2, three steps late: a load is there for three steps, and then T, which is z^-3, has removed it.

    >>> found = least_load_error([2.0], [1.0], dt=0.01, delay=0.03, peak=2.1)
    >>> print(f"{found.load_error:.4f} s, peak {found.peak_sensitivity:.3f}, noise {found.noise:.3f}")
    0.0600 s, peak 2.000, noise 0.500

    Parameters
    ----------
    numerator, denominator : array_like, one dimension
        Coefficients of z, highest power first; :func:`cosim.loops.sample_delayed` makes them of s.
    dt, delay : float
        Step and delay, s; the delay of whole steps.
    peak : float
        Largest ``|S|``, above 1.
    noise : float
        Largest standard deviation of the command, per unit of that of the output's white noise.
    window : float or None
        Time over which the error is integrated, s; None: 50 delays, or three times the slowest lag.

    Raises
    ------
    InputError
        Without Clarabel, for a plant that no such loop exists of here, and where no controller keeps the bounds.
    """
    need_solver()
    n, d = proper_fraction(numerator, denominator, dt, delay)
    if not (dt and isfinite(window or 0.0)):
        raise InputError(f"dt: {dt:g} s and window: {window} s; a dt above 0, a finite window")
    steps = round(delay / dt)
    if abs(delay / dt - steps) > 1e-9:
        raise InputError(f"delay: {delay:g} s is not whole steps of {dt:g} s; sample_delayed has the exact plant")
    if not (inf > peak > 1.0 and noise > 0.0):
        raise InputError(f"peak: {peak:g} and noise: {noise:g}; above 1 and above 0")
    plant = _Plant(n, d, dt, steps, window)
    return plant.evaluate(Programme(plant, Bounds(peak, noise, inf), (splines(plant), None)).solve()[0])
