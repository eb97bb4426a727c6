"""What a log would tell of a model: how well each number, and which exchange would show, were the model wrong in it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import Vector3
from hexjet_identify.replay.candidates import ALL_AXES, ONE_AXIS, Hypothesis, list_exchanges, list_numbers
from hexjet_identify.replay.causes import bounds
from hexjet_identify.replay.flown import Model
from hexjet_identify.replay.measures import EXCITED
from hexjet_identify.replay.misfit import MISFIT, Residuals
from hexjet_identify.replay.windows import Flying

WRONG, WRONG_S = 0.3, 0.02  # by which a factor, or a delay or a lag, is off that has to show
_ENGINE: Final = "thrust of engine "


class Reach(NamedTuple):
    """``told``: what would show, were it off, with half of its 95 % interval, alone; ``hidden``: what would not."""

    told: tuple[tuple[str, str, float], ...]  # name, unit, half
    hidden: tuple[str, ...]

    @property
    def tells_inertia(self) -> bool:
        """Whether the moment of inertia about one axis is told."""
        return any(ONE_AXIS in name for name, _, _ in self.told)

    @property
    def lines(self) -> tuple[str, ...]:
        """What would show and what not, in words."""
        would = f"off by {100.0 * WRONG:.0f} %, or {1e3 * WRONG_S:.0f} ms"
        told = _joined([name for name, _, _ in self.told])
        lines = [f"each of these, {would}, would show: {told}"] if told else []
        return (*lines, *([f"these would not: {_joined(self.hidden)}"] if self.hidden else []))

    def to_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        told = [{"name": name, "unit": unit, "bound_95": half} for name, unit, half in self.told]
        return {"told": told, "not_told": list(self.hidden)}


def _joined(names: Sequence[str]) -> str:
    """Return names in a row; of engines their numbers."""
    engines = ", ".join(name.removeprefix(_ENGINE) for name in names if name.startswith(_ENGINE))
    return "; ".join(
        [
            *(n.removesuffix(" by") for n in names if not n.startswith(_ENGINE)),
            *([_ENGINE + engines] if engines else []),
        ]
    )


def find_reach(model: Model, flying: Flying, wind: Vector3) -> Reach:
    """Change each number and exchange engines in pairs, and see what stands out of the noise."""
    residuals = Residuals(model, flying, wind)
    nominal = residuals.nominal
    moves = np.mean(residuals.movement() ** 2, axis=(0, 1)) > EXCITED**2

    def shows(change: Array) -> bool:  # as much as a search needs to begin
        return bool(np.any(moves & (np.mean(change**2, axis=(0, 1)) > MISFIT - 1.0)))

    told, hidden = [], []
    for cause in list_numbers(model):
        slope = (residuals.of(Hypothesis((cause,)), (cause.begin + cause.probe,)) - nominal) / cause.probe
        off = WRONG_S if cause.unit == "s" else WRONG
        if np.isfinite(slope).all() and shows(off * slope) and 2.0 * (half := _half(slope, nominal)) <= off:
            told.append((cause.name, cause.unit, half))
        elif cause.name != ALL_AXES:
            hidden.append(cause.name)
    shown = {
        one.name
        for one in list_exchanges(model, flying.flight.throttle)
        if shows(residuals.of(Hypothesis((), one)) - nominal)
    }
    pairs = [
        (a, b)
        for a, b in combinations(range(1, len(model.vehicle.jets) + 1), 2)
        if f"engines {a} and {b} swapped" not in shown
    ]
    return Reach(tuple(told), tuple(hidden + _swaps(pairs)))


def _half(slope: Array, nominal: Array) -> float:
    """Return half of the 95 % interval of a number, by the noise or by what the windows disagree on."""
    (by_windows,) = bounds(slope[..., None], nominal)
    return max(1.96 / float(np.sqrt(np.sum(slope**2))), by_windows or 0.0)


def _swaps(pairs: Sequence[tuple[int, int]]) -> list[str]:
    return [f"engines swapped: {', '.join(f'{a} with {b}' for a, b in pairs)}"] if pairs else []
