"""Deviations of parameters whose residuals are not as white as they should be."""

from __future__ import annotations

import numpy as np

from cosim.base.arrays import Array

MEMORY_TOLD = 2.0  # standard errors of an autocorrelation up to which it is nothing


def invert(matrix: Array) -> Array:
    """Return the inverse of normal equations whose columns are of very different size."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size))


def memory_rows(white: Array) -> int:
    """Return over how many rows residuals that should be white still remember themselves."""
    rows = len(white)
    least = MEMORY_TOLD / np.sqrt(rows)
    power = float(white @ white)
    longest = 0
    for lag in range(1, max(2, rows // 20)):
        if lag > longest + 20:
            break
        if abs(float(white[lag:] @ white[:-lag])) > least * power:
            longest = lag
    return longest


def robust_factor(jacobian: Array, white: Array, covariance: Array, memory: int) -> Array:
    """Return by how much what the residuals really do widens each deviation, at least 1 (Newey and West, 1987)."""
    if memory == 0:
        return np.ones(len(covariance))
    scores = jacobian * white[:, None]
    spread = scores.T @ scores
    for lag in range(1, 2 * memory + 1):
        part = (1.0 - lag / (2.0 * memory + 1.0)) * (scores[lag:].T @ scores[:-lag])
        spread += part + part.T
    inverse = invert(jacobian.T @ jacobian)
    robust = np.diag(inverse @ spread @ inverse)
    return np.asarray(np.sqrt(np.maximum(robust / np.maximum(np.diag(covariance), 1e-300), 1.0)))
