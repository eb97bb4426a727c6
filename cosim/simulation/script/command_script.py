"""What the script or the recorded pilot asks for, step by step."""

from __future__ import annotations

import csv
from bisect import bisect_right
from collections.abc import Callable, Sequence
from io import StringIO
from math import cos, isfinite, log, pi, radians, sin
from pathlib import Path

from cosim.base.errors import InputError, nearest
from cosim.base.signals import Command
from cosim.base.storage.files import read_text
from cosim.spec.scenario import (
    SIGNALS,
    DoubletCommand,
    GuidedCommand,
    RampCommand,
    Scenario,
    StepCommand,
    SticksCommand,
    SweepCommand,
    TableCommand,
)

Waveform = Callable[[int], float]
STICK_COLUMNS = ("roll", "pitch", "yaw", "throttle")  # columns of a file of sticks
_ANGLES = frozenset(index for index, signal in enumerate(SIGNALS) if "deg" in signal)  # indices of signals in deg


class CommandScript:
    """Sum of a scenario's commands at every control step.

    Before and between them the vehicle is asked to stay level, at its initial heading and height.  Any command of a
    body rate replaces the attitude loop for the whole flight (the other rates are 0); a command of the collective
    replaces the altitude hold from its own start on.  Any command of a speed ahead has that law fly the whole flight,
    from the initial speed.  Places and velocities are not its own: see
    :mod:`cosim.simulation.guided_pilot`.
    """

    def __init__(self, scenario: Scenario, height: float) -> None:
        self._waves: list[tuple[int, Waveform]] = []
        collective: list[int] = []
        for index, entry in enumerate(scenario.command):
            where = f"command.{index}"
            start = scenario.count(entry.start_s, f"{where}.start_s")
            if isinstance(entry, GuidedCommand):
                continue
            before = len(self._waves)
            if isinstance(entry, TableCommand):
                self._waves += _read_table_waves(entry, scenario, start, where)
            elif isinstance(entry, SticksCommand):
                self._waves += _read_stick_waves(entry, scenario, start, where)
            else:
                signal = SIGNALS.index(entry.signal)
                wave = _make_waveform(entry, scenario, start, where)
                self._waves.append((signal, _scale_waveform(wave, radians(1.0)) if signal in _ANGLES else wave))
            if any(SIGNALS[signal] == "collective" for signal, _ in self._waves[before:]):
                collective.append(start)
        self.signals = [SIGNALS[signal] for signal in sorted({signal for signal, _ in self._waves})]
        self._rate_mode = any(signal.startswith("rate_") for signal in self.signals)
        # Height is held until the first collective command begins.
        self._collective_from = min(collective, default=None)
        yaw = radians(scenario.initial.attitude_deg[2])
        # The vehicle's own law flies from the speed ahead at the start to the commanded speed.
        north, east, _ = scenario.initial.velocity_ned_m_s
        self._base = [0.0, 0.0, yaw, height, 0.0, 0.0, 0.0, 0.0, north * cos(yaw) + east * sin(yaw)]
        self._ahead = "ahead_m_s" in self.signals
        self._last_values: list[float] = []
        self._last = Command((0.0, 0.0, 0.0), height)

    def at(self, k: int) -> Command:
        """Return the command held over step ``k``."""
        if not self._waves and self._last_values:
            return self._last
        values = self._base.copy()
        for signal, wave in self._waves:
            values[signal] += wave(k)
        has_begun = self._collective_from is not None and k >= self._collective_from
        if values != self._last_values or has_begun != (self._last.collective is not None):
            self._last_values = values
            roll, pitch, yaw, altitude, p, q, r, collective, ahead = values
            self._last = Command(
                (roll, pitch, yaw),
                altitude,
                (p, q, r) if self._rate_mode else None,
                collective if has_begun else None,
                None,
                ahead if self._ahead else None,
            )
        return self._last


def make_sweep(step: float, start: int, length: int, amplitude: float, low: float, high: float) -> Waveform:
    """Return the chirp ``amplitude sin(2 pi low L (exp(t/L) - 1))``, ``L = D / ln(high/low)``, t from ``start``.

    Its frequency is ``low`` Hz at the first and ``high`` Hz at the last of ``length`` steps.
    """
    ratio = high / low
    growth = log(ratio)
    scale = 2.0 * pi * low * step * (length / growth if growth else length)

    def value_at(k: int) -> float:
        n = k - start
        if not 0 <= n < length:
            return 0.0
        progress = ratio ** (n / length) - 1.0 if growth else n / length
        return amplitude * sin(scale * progress)

    return value_at


def make_doublet(start: int, width: int, amplitude: float) -> Waveform:
    """Return a waveform of ``amplitude`` for ``width`` steps, then its opposite for as long."""

    def value_at(k: int) -> float:
        n = k - start
        return 0.0 if n < 0 or n >= 2 * width else (amplitude if n < width else -amplitude)

    return value_at


def make_pulse(start: int, end: int | None, amplitude: float) -> Waveform:
    """Return a waveform of ``amplitude`` from step ``start`` to before ``end``, or for good."""

    def value_at(k: int) -> float:
        return amplitude if k >= start and (end is None or k < end) else 0.0

    return value_at


def _make_waveform(
    entry: StepCommand | DoubletCommand | RampCommand | SweepCommand, scenario: Scenario, start: int, where: str
) -> Waveform:
    if isinstance(entry, StepCommand):
        return make_pulse(start, None, entry.amplitude)
    if isinstance(entry, DoubletCommand):
        return make_doublet(start, scenario.count(entry.width_s, f"{where}.width_s"), entry.amplitude)
    length = scenario.count(entry.duration_s, f"{where}.duration_s")
    if isinstance(entry, SweepCommand):
        return make_sweep(scenario.step_s, start, length, entry.amplitude, entry.from_hz, entry.to_hz)
    amplitude = entry.amplitude
    return lambda k: amplitude * min(1.0, max(0.0, (k - start) / length))


def _scale_waveform(wave: Waveform, factor: float) -> Waveform:
    return lambda k: factor * wave(k)


def _read_table_waves(entry: TableCommand, scenario: Scenario, start: int, where: str) -> list[tuple[int, Waveform]]:
    path = scenario.folder / entry.file
    times, columns = read_columns(path, SIGNALS, f"{where}.file")
    waves = []
    for name, values in columns.items():
        signal = SIGNALS.index(name)
        factor = radians(1.0) if signal in _ANGLES else 1.0
        waves.append(
            (signal, _wave_of_table(times, [factor * v for v in values], entry.interpolate, scenario.step_s, start))
        )
    return waves


def _wave_of_table(
    times: Sequence[float], values: Sequence[float], interpolation: str, step: float, start: int
) -> Waveform:
    """Return the waveform of table rows: 0 before the first, constant after the last."""
    linear = interpolation == "linear"

    def value_at(k: int) -> float:
        # A tolerance of a billionth of a step for rounding, so that a row on the grid counts from its own step on.
        t = (k - start) * step + 1e-9 * step
        i = bisect_right(times, t) - 1
        if i < 0:
            return 0.0
        if not linear or i + 1 == len(times):
            return values[i]
        fraction = (t - times[i]) / (times[i + 1] - times[i])
        return values[i] + fraction * (values[i + 1] - values[i])

    return value_at


def _read_stick_waves(entry: SticksCommand, scenario: Scenario, start: int, where: str) -> list[tuple[int, Waveform]]:
    path = scenario.folder / entry.file
    times, columns = read_columns(path, STICK_COLUMNS, f"{where}.file")
    for name, values in columns.items():
        worst = max(values, key=abs)
        if abs(worst) > 1.0:
            raise InputError(f"{path}: column {name} holds {worst:g}; sticks go from -1 to 1")
    step = scenario.step_s
    tilt = radians(entry.tilt_deg)
    zeros = [0.0] * len(times)
    position = {name: _wave_of_table(times, columns.get(name, zeros), "linear", step, start) for name in STICK_COLUMNS}
    end = min(start + int(min(times[-1], scenario.duration_s) / step) + 1, scenario.steps)
    waves = (
        _scale_waveform(position["roll"], tilt),
        # Stick forward is positive and commands nose down.
        _scale_waveform(position["pitch"], -tilt),
        _running_sum(position["yaw"], radians(entry.yaw_rate_deg_s) * step, start, end),
        _running_sum(position["throttle"], entry.climb_m_s * step, start, end),
    )
    return list(enumerate(waves))  # in the order of SIGNALS


def _running_sum(wave: Waveform, factor: float, start: int, end: int) -> Waveform:
    """Return the sum of ``factor * wave`` over the steps before ``k``; constant from ``end`` on."""
    sums = [0.0]
    for k in range(start, end):
        sums.append(sums[-1] + factor * wave(k))
    return lambda k: sums[min(max(k - start, 0), len(sums) - 1)]


def read_columns(
    path: Path, allowed: Sequence[str], where: str, all_of_them: bool = False
) -> tuple[list[float], dict[str, list[float]]]:
    """Return times and named columns of a CSV file with a header line ``time_s,...``.

    ``all_of_them``: every allowed column must be there, in this order; times may then begin below 0.
    Raises InputError that names the file and the line: unknown column, a cell that is no finite number, times that
    do not grow, no rows.
    """
    try:
        rows = list(csv.reader(StringIO(read_text(path, "utf-8-sig"))))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except csv.Error as error:
        raise InputError(f"{where}: {path}: {error}") from error
    header = _read_header(rows, path, allowed)
    if all_of_them and header[1:] != list(allowed):
        raise InputError(f"{path}: line 1: must be {','.join(('time_s', *allowed))}")
    table: list[list[float]] = []
    for number, row in enumerate(rows[1:], 2):
        if not row:
            continue
        if len(row) != len(header):
            raise InputError(f"{path}: line {number}: {len(row)} cells, the header has {len(header)}")
        table.append([_parse_number(cell, path, number) for cell in row])
        if len(table) > 1 and table[-1][0] <= table[-2][0]:
            raise InputError(
                f"{path}: line {number}: time_s does not grow ({table[-2][0]:g} s, then {table[-1][0]:g} s)"
            )
    if not table or len(header) < 2:
        raise InputError(f"{path}: no rows of data")
    if table[0][0] < 0.0 and not all_of_them:
        raise InputError(f"{path}: line 2: time_s starts below 0")
    times, *columns = (list(column) for column in zip(*table, strict=True))
    return times, dict(zip(header[1:], columns, strict=True))


def _read_header(rows: Sequence[Sequence[str]], path: Path, allowed: Sequence[str]) -> list[str]:
    """Return the names of the columns, of which the first is time_s.  Raises InputError."""
    header = [cell.strip() for cell in rows[0]] if rows else []
    if not header or header[0] != "time_s":
        raise InputError(f"{path}: line 1: the first column must be time_s")
    for name in header[1:]:
        if name not in allowed:
            raise InputError(f"{path}: line 1: unknown column {name!r}; {nearest(name, allowed)}")
    if len(set(header)) != len(header):
        raise InputError(f"{path}: line 1: a column stands twice")
    return header


def _parse_number(cell: str, path: Path, line: int) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise InputError(f"{path}: line {line}: {cell!r} is not a finite number")
    return value
