"""The table ``[uncertainty]`` of a mapping file: how well an engine's parameters are identified.

The parameters of an engine are ``nominal + u + v``: ``u`` is normal with covariance ``deviation_i correlation_ij
deviation_j`` and the same for all engines of a vehicle, ``v`` is normal with the standard deviation ``spread_i``, drawn
for each engine by itself.  Both are cut off at :data:`MAX_SIGMA` deviations and at the FMU's own limits: the common
ones through a Gaussian copula, so that each parameter keeps its distribution whatever it is correlated with.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from math import sqrt
from pathlib import Path
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from cosim.base.arrays import Array
from cosim.base.errors import InputError, nearest
from cosim.base.storage.toml import Model, NotNegative, read_toml, toml_text
from cosim.engine.fmu.variables import THROTTLE_TYPES, Variable

# Number of standard deviations at which distributions are cut off: no identification is normal beyond it.
MAX_SIGMA = 3.0
# Largest negative eigenvalue of a correlation that counts as rounding: files have about three digits.
MIN_EIGENVALUE = 1e-3
SETTABLE = ("", "fixed", "tunable")  # variabilities of settable parameters

Matrix = list[list[Annotated[float, Field(ge=-1.0, le=1.0)]]]


class ParameterRange(NamedTuple):
    """Uncertainty of one parameter: nominal value, 95 % range, and deviation between engines, in its unit."""

    name: str
    nominal: float
    low: float
    high: float
    spread: float


class Uncertainty(Model):
    """Standard deviations of an engine's parameters, each in its parameter's unit."""

    source: str = ""  # origin of the numbers, one line
    parameters: Annotated[list[str], Field(min_length=1)]  # names, in the order of the other keys
    deviation: list[NotNegative]  # shared by all engines of a vehicle
    correlation: Matrix | None = None  # matrix of the shared deviations
    spread: list[NotNegative] | None = None  # deviation between engines of a kind

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        names, count = self.parameters, len(self.parameters)
        if repeated := [a for a, b in pairwise(sorted(names)) if a == b]:
            raise ValueError(f"parameters: {repeated[0]} is there twice")
        for key, values in (("deviation", self.deviation), ("correlation", self.correlation), ("spread", self.spread)):
            if values is not None and len(values) != count:
                raise ValueError(f"{key} has {len(values)} entries, and there are {count} parameters")
        if not any([*self.deviation, *(self.spread or [])]):
            raise ValueError("deviation and spread are 0: nothing is uncertain; leave the table out")
        self._check_correlation()
        return self

    def _check_correlation(self) -> None:
        """Raise ValueError for a matrix that is not a correlation."""
        rows, names = self.correlation or [], self.parameters
        for row, name in zip(rows, names, strict=False):
            if len(row) != len(names):
                raise ValueError(f"correlation: the row of {name} has {len(row)} entries, of {len(names)}")
        for i, name in enumerate(names[: len(rows)]):
            if rows[i][i] != 1.0:
                raise ValueError(f"correlation: {name} with itself is {rows[i][i]:g}, and must be 1")
            for j in range(i):
                if rows[i][j] != rows[j][i]:
                    pair = f"{name} with {names[j]} is {rows[i][j]:g}, {names[j]} with {name} {rows[j][i]:g}"
                    raise ValueError(f"correlation: {pair}; it must be symmetric")
        smallest = float(np.linalg.eigvalsh(np.array(rows))[0]) if rows else 0.0
        if smallest < -MIN_EIGENVALUE:
            raise ValueError(
                "correlation: these numbers cannot hold together (the matrix is not positive semidefinite: its "
                f"smallest eigenvalue is {smallest:.3g})"
            )

    @property
    def spreads(self) -> list[float]:
        """Standard deviation of each parameter between engines, by name."""
        return self.spread or [0.0] * len(self.parameters)

    @property
    def correlations(self) -> list[list[float]]:
        """Correlation matrix of the deviations that all engines share."""
        return self.correlation or np.eye(len(self.parameters)).tolist()

    @property
    def factor(self) -> list[list[float]]:
        """Lower triangle L of the correlation R = L L^T; fully dependent deviations have zero columns."""
        return lower_factor(self.correlations)

    def quantiles(self, normal: Array) -> list[Array]:
        """Return quantiles of the parameters' common deviations for independent normal numbers, one row per draw."""
        from scipy.special import ndtr

        return [
            # Summed in a fixed order: a matrix product's order of additions depends on the machine.
            np.asarray(ndtr(sum(factors[column] * normal[:, column] for column in range(row + 1))))
            for row, factors in enumerate(self.factor)
        ]

    def ranges(
        self, nominal: Mapping[str, float], variables: Iterable[Variable], deviations: float = 1.96
    ) -> list[ParameterRange]:
        """Return the 95 % range of each parameter of one engine about its nominal value, within the FMU's limits.

        ``deviations``: standard deviations of a normal number's 95 % range.
        """
        limits = {variable.name: (variable.min, variable.max) for variable in variables}
        rows = []
        for name, deviation, spread in zip(self.parameters, self.deviation, self.spreads, strict=True):
            value, half = nominal[name], deviations * float(np.hypot(deviation, spread))
            least, most = limits[name]
            low = value - half if least is None else max(value - half, least)
            high = value + half if most is None else min(value + half, most)
            rows.append(ParameterRange(name, value, float(f"{low:.6g}"), float(f"{high:.6g}"), spread))
        return rows

    def check_parameters(self, parameters: Iterable[Variable], start: str | None, where: str) -> None:
        """Raise InputError, beginning with ``where``, for a parameter that the FMU lacks or that cannot be drawn.

        ``start`` names the parameter that the simulation sets itself.
        """
        known = {variable.name: variable for variable in parameters if variable.name != start}
        for name in self.parameters:
            if name not in known:
                reason = "is set by the simulation itself" if name == start else "no such parameter"
                allowed = nearest(name, known) if known else "the FMU has none"
                raise InputError(f"{where}: uncertainty.parameters: {name}: {reason}; {allowed}")
            variable = known[name]
            if variable.type not in THROTTLE_TYPES or variable.variability not in SETTABLE or variable.start is None:
                kind = " ".join([variable.variability or "fixed", variable.type])
                raise InputError(
                    f"{where}: uncertainty.parameters: {name} is a {kind}; allowed: fixed or tunable numbers "
                    "that have a start value"
                )

    def describe(self, index: int) -> str:
        """Return a text on one parameter's uncertainty, without the deviation itself."""
        words = [f"standard deviation, cut off at {MAX_SIGMA:g} of it"]
        if self.spreads[index]:
            words.append(f"{self.spreads[index]:g} between engines")
        correlated = [
            f"{value:+.2g} with {name}"
            for name, value in zip(self.parameters, self.correlations[index], strict=True)
            if value and name != self.parameters[index]
        ]
        return "; ".join([*words, *([f"correlation {', '.join(correlated)}"] if correlated else [])])


def lower_factor(matrix: Sequence[Sequence[float]]) -> list[list[float]]:
    """Return the lower triangle L of a positive semidefinite matrix L L^T, row by row (Cholesky).

    Summed here and not by LAPACK, whose order of additions is the machine's: draws are the same everywhere.
    """
    size = len(matrix)
    lower = [[0.0] * size for _ in range(size)]
    for j in range(size):
        pivot = matrix[j][j] - sum([value * value for value in lower[j][:j]])
        lower[j][j] = sqrt(pivot) if pivot > MIN_EIGENVALUE * MIN_EIGENVALUE else 0.0
        for i in range(j + 1, size):
            rest = matrix[i][j] - sum([a * b for a, b in zip(lower[i][:j], lower[j][:j], strict=True)])
            lower[i][j] = rest / lower[j][j] if lower[j][j] else 0.0
    return lower


def without_uncertainty(path: Path) -> bytes:
    """Return a mapping file's contents without ``[uncertainty]``, in canonical form."""
    table = read_toml(path)
    table.pop("uncertainty", None)
    return toml_text(table).encode()


def cut_normal(quantiles: Array, centre: Array, deviation: float, low: float = -np.inf, high: float = np.inf) -> Array:
    """Return quantiles of a normal distribution about each centre, cut off at :data:`MAX_SIGMA` and at limits."""
    if not deviation:
        return centre
    from scipy.special import ndtr, ndtri

    least = ndtr(np.maximum((low - centre) / deviation, -MAX_SIGMA))
    most = ndtr(np.minimum((high - centre) / deviation, MAX_SIGMA))
    drawn = centre + deviation * ndtri(least + quantiles * (most - least))
    return np.asarray(np.clip(drawn, low, high))  # rounding may exceed the limits
