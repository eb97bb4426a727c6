"""From a swept record to a frequency response with coherence.

The record starts and ends at rest, so the Fourier transforms of its signals leak nothing and divide without a window;
Welch's segments would, for a chirp, hold one frequency each and smear its delay.  The response is estimated locally
(the local polynomial method of Pintelon and Schoukens, System Identification, 2nd ed., section 7.2): over a handful of
neighbouring bins it is a parabola in frequency, and what the parabola does not explain is noise.  That gives the
coherence from one sweep.  In a loop the command contains the noise that came back through the controller; what was
injected does not, so it serves as the instrument and the estimate stays unbiased.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError

# Fewest bins per group: with three complex unknowns six bins remain to separate noise from response.
MIN_BINS = 9


@dataclass(frozen=True)
class Record:
    """Equally spaced signals of one sweep, which starts and ends at rest.

    ``injected`` is what the sweep adds, known exactly; ``command`` is what acts over ``[t_k, t_k+1)``, the injected
    signal included; ``output`` is taken at ``t_k``.  Constant offsets do no harm.
    """

    injected: Array
    command: Array
    output: Array
    step: float  # s, sample time


@dataclass(frozen=True)
class FrequencyResponse:
    """Response from command to output at the centre of each group of bins."""

    hertz: Array
    value: Complex
    coherence: Array  # lesser of command and output, 0 to 1
    spread: Array  # standard deviation over |value|
    step: float  # s, sample time

    @property
    def magnitude_db(self) -> Array:
        """20 log10 of the magnitude."""
        return np.asarray(20.0 * np.log10(np.abs(self.value)))

    @property
    def phase_deg(self) -> Array:
        """Phase in degrees, unwrapped from group to group."""
        return np.asarray(np.degrees(np.unwrap(np.angle(self.value))))


def shortest_record(low: float, max_width: float = 0.25) -> float:
    """Return the least length [s] of a record for a group of bins at ``low`` Hz.

    ``max_width``: half a group's width over its centre, at most: beyond it the parabola would bend the response.
    """
    return (MIN_BINS - 1) / (2.0 * max_width * low)


def estimate(
    record: Record, low: float, high: float, model: Callable[[Array], Complex] | None = None
) -> FrequencyResponse:
    """Estimate the response between ``low`` and ``high`` Hz.

    With a first ``model`` (a function of Hz) what is estimated is the ratio of the response to it, which is flat: that
    takes away the last of the parabola's error.  The coherence is the lesser of those of the injected signal with
    command and with output: what the loop's own noise moves does not count.
    Raises InputError if the record is too short for ``low``.
    """
    count = len(record.output)
    seconds = count * record.step
    if seconds < shortest_record(low):
        raise InputError(
            f"a record of {seconds:g} s is too short for {low:g} Hz; "
            f"that takes {shortest_record(low):.3g} s, or start at {shortest_record(low) * low / seconds:.2g} Hz"
        )
    hertz = np.asarray(np.fft.rfftfreq(count, record.step), np.float64)
    injected, command, output = (np.fft.rfft(x) for x in (record.injected, record.command, record.output))
    guess = model(hertz[1:]) if model is not None else np.ones(len(hertz) - 1, complex)
    coefficients = np.concatenate(([1.0], guess))
    rows = []
    for first, last in _group_bins(seconds, low, high, len(hertz)):
        part = slice(first, last)
        centre = float(hertz[part].mean())
        value, coherence, spread = _fit_group(
            hertz[part] - centre, injected[part] * coefficients[part], command[part] * coefficients[part], output[part]
        )
        at_centre = complex(model(np.array([centre]))[0]) if model is not None else 1.0
        rows.append((centre, value * at_centre, coherence, spread))
    columns = list(zip(*rows, strict=True))
    return FrequencyResponse(
        np.array(columns[0]), np.array(columns[1]), np.array(columns[2]), np.array(columns[3]), record.step
    )


def _group_bins(seconds: float, low: float, high: float, count: int, max_groups: int = 60) -> list[tuple[int, int]]:
    """Return first bin and end bin (exclusive) of each group, evenly spaced in log frequency if possible."""
    first = max(1, round(low * seconds) - MIN_BINS // 2)
    end = min(round(high * seconds) + MIN_BINS // 2 + 1, count)
    edges = [first]
    growth = (end / first) ** (1.0 / max_groups)
    while edges[-1] + MIN_BINS <= end:
        edges.append(min(end, max(edges[-1] + MIN_BINS, round(edges[-1] * growth))))
    if edges[-1] < end and len(edges) > 2:
        edges[-1] = end
    return list(pairwise(edges))


def _fit_group(offset: Array, injected: Complex, command: Complex, output: Complex) -> tuple[complex, float, float]:
    """Estimate response, coherence and relative deviation at the centre of a group of bins."""
    basis = np.vander(offset / np.abs(offset).max(), 3, increasing=True)
    regressors, instruments = command[:, None] * basis, injected[:, None] * basis
    gram = instruments.conj().T @ regressors
    try:
        inverse = np.linalg.inv(gram)
    except np.linalg.LinAlgError:
        return complex("nan"), 0.0, float("inf")
    solution = inverse @ (instruments.conj().T @ output)
    noise = _residual_power(output, regressors, solution)
    variance = noise * np.real((inverse @ (instruments.conj().T @ instruments) @ inverse.conj().T)[0, 0])
    value = complex(solution[0])
    if value == 0.0:
        return value, 0.0, float("inf")
    coherence = min(_explained_fraction(output, instruments), _explained_fraction(command, instruments))
    return value, coherence, float(np.sqrt(variance)) / abs(value)


def _explained_fraction(signal: Complex, instruments: Complex) -> float:
    """Return the fraction of power that the injected signal explains, by a response quadratic in frequency."""
    power = float(np.mean(np.abs(signal) ** 2))
    if power == 0.0:
        return 0.0
    solution = np.asarray(np.linalg.lstsq(instruments, signal, rcond=None)[0], np.complex128)
    return max(0.0, 1.0 - _residual_power(signal, instruments, solution) / power)


def _residual_power(signal: Complex, regressors: Complex, solution: Complex) -> float:
    """Return the residual power per bin after a fit of three complex unknowns."""
    return float(np.sum(np.abs(signal - regressors @ solution) ** 2)) / (len(signal) - 3)
