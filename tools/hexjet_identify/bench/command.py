"""The command of a bench log as a function of time, and the exact answer of lags to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cosim.base.arrays import Array

LONGEST_EXPONENT = 200.0  # of a block of the recursion: e^200 is far from what a double overflows at
MOST_KNOWN = 8  # lags, whose states are kept
SMOOTH = 1e-4  # of a command's range: straight through so near to its rows it is the same
LARGEST_RATIO = 0.999  # of two lags: nearer to each other their two answers cancel
NOISE_TURNS = 0.3  # share of the rows at which a command turns back, above which that is noise
NOISE_SIZE = 0.02  # of its range, up to which it is
SAME_SLOPE = 1e-9  # of the command's range a row: slopes that differ by less are one


@dataclass(frozen=True)
class Command:
    """A command in pieces: ``values[k] + slopes[k] (t - times[k])`` from ``times[k]`` [s] to the next.

    Before the first piece it has stood at its value for ever, behind the last one it goes on as that does.
    """

    times: Array
    values: Array
    slopes: Array
    _known: dict[float, Array] = field(default_factory=dict, compare=False, repr=False)

    def lagged(self, lag: float, at: Array) -> Array:
        """Return the answer of ``1 / (lag s + 1)`` at these times [s], from rest at the first value."""
        state = self._states(lag)
        piece = np.searchsorted(self.times, at, side="right") - 1
        k = np.maximum(piece, 0)
        within = np.maximum(at - self.times[k], 0.0)
        answer = _over(lag, within, state[k], self.values[k], self.slopes[k])
        return np.asarray(np.where(piece < 0, self.values[0], answer))

    def twice_lagged(self, lag: float, ratio: float, at: Array) -> Array:
        """Return the answer of two lags in series, the second ``ratio`` (0 to 1) times the first, as :meth:`lagged`."""
        ratio = min(ratio, LARGEST_RATIO)
        first = self.lagged(lag, at)
        if ratio * lag < 1e-6:
            return first
        return np.asarray((first - ratio * self.lagged(ratio * lag, at)) / (1.0 - ratio))

    def lagged_means(self, lag: float, begins: Array, ends: Array) -> Array:
        """Return the means of :meth:`lagged` from each of these times [s] to its end: of lag y' = u - y, integrated."""
        seconds = ends - begins
        command = (self._integral(ends) - self._integral(begins)) / seconds
        return np.asarray(command - lag * (self.lagged(lag, ends) - self.lagged(lag, begins)) / seconds)

    def twice_lagged_means(self, lag: float, ratio: float, begins: Array, ends: Array) -> Array:
        """Return the means of :meth:`twice_lagged` from each of these times [s] to its end."""
        ratio = min(ratio, LARGEST_RATIO)
        first = self.lagged_means(lag, begins, ends)
        if ratio * lag < 1e-6:
            return first
        return np.asarray((first - ratio * self.lagged_means(ratio * lag, begins, ends)) / (1.0 - ratio))

    def _integral(self, at: Array) -> Array:
        """Return the command's integral from its first time to these times [s]."""
        h = np.diff(self.times)
        whole = np.concatenate([[0.0], np.cumsum(h * (self.values[:-1] + 0.5 * h * self.slopes[:-1]))])
        k = np.maximum(np.searchsorted(self.times, at, side="right") - 1, 0)
        within = at - self.times[k]
        slope = np.where(within < 0.0, 0.0, self.slopes[k])
        return np.asarray(whole[k] + within * (self.values[k] + 0.5 * within * slope))

    def _states(self, lag: float) -> Array:
        """Return the lag's state where each piece begins: x[k+1] = E[k] x[k] + q[k], summed in blocks."""
        if lag in self._known:
            return self._known[lag]
        h = np.diff(self.times)
        forced = _over(lag, h, np.zeros(len(h)), self.values[:-1], self.slopes[:-1])
        state = np.empty(len(self.times))
        state[0] = self.values[0]
        since = (self.times - self.times[0]) / lag
        begins = np.flatnonzero(np.diff(np.floor(since / LONGEST_EXPONENT), prepend=-1.0))
        for begin, end in zip(begins, [*begins[1:], len(state)], strict=True):
            if begin > 0:
                state[begin] = np.exp(-h[begin - 1] / lag) * state[begin - 1] + forced[begin - 1]
            grown = np.exp(since[begin + 1 : end] - since[begin])
            state[begin + 1 : end] = (state[begin] + np.cumsum(grown * forced[begin : end - 1])) / grown
        if len(self._known) >= MOST_KNOWN:
            self._known.clear()
        self._known[lag] = state
        return state


def _over(lag: float, seconds: Array, state: Array, value: Array, slope: Array) -> Array:
    """Return the state of a lag so many seconds into pieces that begin with this state, value and slope."""
    fade = np.exp(-seconds / lag)
    return np.asarray(value + slope * (seconds - lag) + (state - value + slope * lag) * fade)


def make_command(times: Array, values: Array, straight: bool) -> Command:
    """Return a logged command [any unit]: held from each row to the next, or ``straight`` between rows.

    Rows that change nothing are left out.
    """
    if straight and len(times) > 1:
        slopes = np.append(np.diff(values) / np.diff(times), 0.0)
        near = SAME_SLOPE * max(float(np.ptp(values)), 1e-300) / float(np.median(np.diff(times)))
        use = np.abs(np.diff(slopes, prepend=np.inf)) > near
    else:
        slopes = np.zeros(len(times))
        use = np.diff(values, prepend=np.inf) != 0.0
    use[0] = True
    return Command(times[use], values[use], slopes[use])


def moves_on(values: Array) -> bool:
    """Return whether a command moves from row to row where it moves at all, as a ramp does and a step does not.

    Noise on every row, as of an analogue set-point, counts as moving on.
    """
    moved = np.diff(values) != 0.0
    if not moved.any():
        return False
    again = moved[1:] & moved[:-1]
    return bool(again.sum() > 0.5 * moved.sum())


def is_noisy(values: Array) -> bool:
    """Return whether a command moves to and fro from row to row, by little: noise of an analogue set-point."""
    moves = np.diff(values)
    turns = np.mean(moves[1:] * moves[:-1] < 0.0) if len(moves) > 1 else 0.0
    return bool(turns > NOISE_TURNS and np.median(np.abs(moves)) < NOISE_SIZE * np.ptp(values))


def thin(times: Array, values: Array, every: int) -> tuple[Array, Array]:
    """Return each so many rows of a straight command, or fewer left out, where straight lines between them meet all."""
    for each in range(every, 1, -1):
        keep = np.unique([*range(0, len(times), each), len(times) - 1])
        off = np.abs(np.interp(times, times[keep], values[keep]) - values)
        if float(off.max()) <= SMOOTH * float(np.ptp(values)):
            return times[keep], values[keep]
    return times, values
