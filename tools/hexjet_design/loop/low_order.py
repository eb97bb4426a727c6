"""The controller at the limit of performance, of low order: what :mod:`hexjet_design.loop.optimal` is tuned with.

The programme of the limit, with few orthonormal functions in place of splines: their poles are searched, and with given
poles the weights of the least load error within all bounds are the solution of a convex programme.  So a controller of
low order keeps the peak sensitivity, the noise and the tolerance of the delay as the limit does, by construction, and
what its order costs is the load error alone.  The answer to a set-point is a lag of third order, as slow as is wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, sqrt

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import minimize
from scipy.signal import lfilter

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.spec.vehicle import RateModel
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import window_s
from hexjet_design.loop.limit import Limit, Plant
from hexjet_design.loop.optimal import LAGS, ModelForm, Target, fit_weights
from hexjet_design.loop.programme import FREQUENCY_COUNT, Bounds, Cone, Programme, need_solver

# Where searches of poles begin: natural frequency times low-frequency delay, and damping.
START_POLES = ((0.6246, 0.37), (0.594, 0.827), (1.458, 1.4), (5.7, 1.07))
COARSE_POINTS = 160  # frequencies of a search


@dataclass(frozen=True)
class LowOrder:
    """A target of low order, and its closed loop with the model that it was found for."""

    target: Target
    loop: Limit


class _LowOrderProgramme(Programme):
    """Programme with other bases, whose ``T_i`` is exact at rest and at the rate's slow pole."""

    def __init__(
        self, plant: Plant, form: ModelForm, bounds: Bounds, basis: tuple[Array, Array], frequencies: int
    ) -> None:
        super().__init__(plant, bounds, basis, frequencies)
        self._rows_at_rest, self._values = form.interpolation(basis[0])

    def _rest_cones(self) -> list[Cone]:
        return [
            Cone("zero", self._rows(t=self._rows_at_rest), self._values),
            Cone("zero", self._rows(y=self.of_y.sum(0)[None]), np.ones(1)),
        ]


def free_weights(model: RateModel, target: Target) -> Array:
    """Return, a column each, the changes of a target's weights that leave ``T_i`` exact at rest."""
    return np.asarray(null_space(ModelForm.of(model, target).interpolation(target.basis(model.sample_time_s))[0]))


def reduce_order(
    channel: Channel,
    model: RateModel,
    bounds: Bounds,
    lag_s: float,
    start: Sequence[tuple[float, float]] = START_POLES,
    rounds: int = 130,
    frequencies: int = FREQUENCY_COUNT,
) -> LowOrder:
    """Return the target with as many pole pairs as ``start`` and the least load error within ``bounds``.

    The noise is that of ``channel``; ``model`` is what the controller believes of it, with the delay that it adds
    itself, and its loop keeps the bounds.  The answer to a set-point has three lags of ``lag_s``.  The poles are sought
    in ``rounds`` (0: not) from ``start``, natural frequency times the delay at low frequency, and damping; at last the
    peak is kept at so many ``frequencies``.  Raises InputError without the solver, or where none keep the bounds.
    """
    need_solver()
    identified = replace(channel, identified=model, added_delay=0)  # the model includes the added delay
    delay, step = identified.slowness_s, channel.step
    plant = Plant(identified, round(window_s(identified) / step))
    longest = plant.length - len(plant.kept) + 1
    pole = exp(-step / lag_s)
    impulse = np.zeros(longest)
    impulse[0] = (1.0 - pole) ** LAGS
    of_y = np.asarray(lfilter([1.0], np.atleast_1d(np.poly([pole] * LAGS)), impulse))[:, None]

    def target_at(x: Array) -> Target:
        pairs = [(exp(natural) / delay, exp(damping)) for natural, damping in x.reshape(-1, 2)]
        return Target(lag_s, tuple(pairs), (0.0,) * (2 * len(pairs)))

    def solve_programme(target: Target, frequencies: int) -> LowOrder:
        basis, form = target.basis(step), ModelForm.of(model, target)
        inside = np.pad(basis, ((0, max(longest - len(basis), 0)), (0, 0)))[:longest]
        t, y = _LowOrderProgramme(plant, form, bounds, (inside, of_y), frequencies).solve()
        found = np.linalg.lstsq(plant.keep(inside), t, rcond=None)[0]
        weights = fit_weights(form, basis, np.asarray(found, np.float64))
        return LowOrder(
            replace(target, weights=tuple((weights / sqrt(step)).tolist())),
            plant.evaluate(bounds, plant.keep(inside) @ weights, y),
        )

    def cost(x: Array) -> float:
        try:
            return solve_programme(target_at(x), COARSE_POINTS).loop.load_error
        except InputError:
            # An infeasible choice of poles costs as much as a million delays of load error.
            return 1e6 * delay

    x = np.log(np.array(start, np.float64)).ravel()
    size = 0.12  # initial size of the simplex, logarithmic
    if rounds:
        simplex = np.vstack([x, x + size * np.eye(len(x))])
        x = minimize(cost, x, method="Nelder-Mead", options={"maxfev": rounds, "initial_simplex": simplex}).x
    return solve_programme(target_at(x), frequencies)
