"""The logs of a batch: the columns that metrics and requirements read, of each flight as if it had been recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import AXES, Command
from cosim.results.log.columns import RATES, logged_vehicle
from cosim.results.metrics import FLOW, HEALTH, REFUSED, THROTTLE, TILT, UPSETS, WIND, columns
from cosim.spec.scenario import Scenario
from hexjet_batch.numbers import Numbers
from hexjet_batch.stages.rotations import add, to_euler
from hexjet_batch.stages.step import Inputs, Outputs

SETPOINTS = ("altitude_setpoint_m", *(f"{axis}_setpoint_rad" for axis in AXES))
STILL = ("fault_", "on_ground", "hull_contact")  # column beginnings that stay 0 in a batch
BEGINS = ("altitude_m", "velocity_north_m_s", "velocity_east_m_s", *(f"{axis}_rad" for axis in AXES))


class FlightLog:
    """The columns of a flight, as :class:`cosim.results.log.recorder.Log` gives them, or tables of several flights.

    ``last``: values of one more row, of the state that ended a flight; empty: it has no numbers.
    """

    def __init__(
        self, tables: Mapping[str, Array], flight: int | list[int], rows: int, last: Mapping[str, Any] | None = None
    ) -> None:
        self._tables, self._flight, self._rows, self._last = tables, flight, rows, last
        self._known: dict[int, Array] = {}

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(self._tables)

    def __getitem__(self, name: str) -> Array:
        table = self._tables[name]
        if isinstance(self._flight, list):
            if id(table) not in self._known:
                self._known[id(table)] = (table if len(table) == 1 else table[self._flight])[:, : self._rows]
            return self._known[id(table)]
        column = table[min(self._flight, len(table) - 1), : self._rows]
        if self._last is None:
            return column
        return np.append(column, self._last.get(name, column[-1]) if self._last else np.nan)

    @property
    def has_numbers(self) -> bool:
        """Whether each set-point has a number everywhere or nowhere; the other columns of a whole flight have."""
        finite = [np.isfinite(self[name]) for name in SETPOINTS]
        return all(np.all(each) or not np.any(each) for each in finite)

    def __len__(self) -> int:
        return self._rows + (self._last is not None)


class BatchLog:
    """The recording of a batch: after ``finish`` its ``tables`` have a line a flight, or one that all share, by column.

    ``rows``: at most; ``jets``: the rows of throttles and engines; ``memory``: where tables are kept, which the next
    batch with the same takes over.
    """

    def __init__(self, scenarios: Sequence[Scenario], rows: int, jets: Numbers, memory: dict[str, Array]) -> None:
        self._vehicle = logged_vehicle(scenarios[0].resolved_vehicle()[0])
        self._columns = columns(self._vehicle)
        # Nothing fails, nor touches the ground.
        still = dict.fromkeys([name for name in self._columns if name.startswith(STILL)], 0.0)
        self._usual = still | {HEALTH.format(jet): 1.0 for jet in range(1, self._vehicle.jets + 1)}
        # What jets of one channel or one engine share is kept once.
        self._first = {name.format(jet): name.format(rows.index(row) + 1)
                       for name, rows in ((THROTTLE, jets.channels), (FLOW, jets.engines))
                       for jet, row in enumerate(rows, 1)}  # fmt: skip
        self._flights, self._jets, self._memory, self._turned = len(scenarios), jets, memory, 0
        self._rows: list[list[Any]] = []
        self.tables = {name: np.empty((1, rows)) for name in self._columns if self._first.get(name, name) == name}

    def add(self, command: Command, inputs: Inputs, outputs: Outputs, block: int = 64) -> None:
        """Record a step; ``block``: steps that become lines of flights together, in the cache."""
        values = self._usual | self._values(command, inputs, outputs)
        self._rows.append([values.get(name, np.nan) for name in self.tables])
        if len(self._rows) == block:
            self._transpose_block()

    def _transpose_block(self) -> None:
        for name, values in zip(self.tables, zip(*self._rows, strict=True), strict=True):
            if len(self.tables[name]) < self._flights and any(np.ndim(value) for value in values):
                self._widen(name)
            for row, value in enumerate(values, self._turned):
                self.tables[name][:, row] = value
        self._turned += len(self._rows)
        self._rows.clear()

    def _widen(self, name: str) -> None:
        """Give a column a line for each flight from now on."""
        shared = self.tables[name]
        size = self._flights * shared.size
        if name not in self._memory or self._memory[name].size < size:
            self._memory[name] = np.empty(size)
        self.tables[name] = self._memory[name][:size].reshape(self._flights, -1)
        self.tables[name][:, : self._turned] = shared[:, : self._turned]

    def finish(self) -> None:
        """Complete the tables after the last step."""
        if self._rows:
            self._transpose_block()
        self.tables = {name: self.tables[self._first.get(name, name)] for name in self._columns}

    def is_alike(self) -> bool:
        """Return whether all flights begin alike, are asked the same, and are disturbed at the same times."""
        begins = [self.tables[name][:, 0] for name in BEGINS]
        acts = [np.diff(table) != 0.0 for name, table in self.tables.items() if name.startswith(UPSETS)]
        is_asked_alike = all(len(self.tables[name]) == 1 for name in (*WIND, *SETPOINTS))
        return is_asked_alike and all(np.all(each == each[0]) for each in (*begins, *acts))

    def _values(self, command: Command, inputs: Inputs, o: Outputs) -> dict[str, Any]:
        """Return the values of one step by column."""
        jets, xyz = range(1, self._vehicle.jets + 1), "xyz"
        values = {
            **state_values(o.motion, o.altitude),
            **_name_elements("{}_setpoint_rad", AXES, () if command.rate is not None else command.attitude),
            **_name_elements("rate_{}_setpoint_rad_s", RATES, o.rate_setpoint),
            **_name_elements("{}", REFUSED, o.unallocated),
            "altitude_setpoint_m": np.nan if command.collective is not None else command.altitude,
            **_name_elements("{}", WIND, inputs.wind),
            **_name_elements(THROTTLE, jets, [o.throttle[row] for row in self._jets.channels]),
            "payload_kg": 0.0 if inputs.payload is None else inputs.payload[0],
            "fuel_kg": np.nan if o.fuel is None else o.fuel,
            **_name_elements("disturbance_force_{}_N", xyz, inputs.force),
            **_name_elements("disturbance_moment_{}_N_m", xyz, inputs.moment),
            **_name_elements("disturbance_torque_{}", AXES, add(inputs.torque_command, inputs.torque_output)),
            **_name_elements(TILT, self._vehicle.servos, o.tilt_command or (0.0, 0.0)),
        }
        if np.ndim(o.report.fuel):
            values |= _name_elements(FLOW, jets, [o.report.fuel[row] for row in self._jets.engines])
        return values


def state_values(motion: Any, altitude: Any) -> dict[str, Any]:
    """Return the columns of a state by name: attitude, rates, position, velocity and altitude."""
    ned = ("north", "east", "down")
    return {
        **_name_elements("{}_rad", AXES, to_euler(motion.attitude, np)),
        **_name_elements("rate_{}_rad_s", RATES, motion.rate),
        **_name_elements("{}_m", ned, motion.position),
        **_name_elements("velocity_{}_m_s", ned, motion.velocity),
        "altitude_m": altitude,
    }


def _name_elements(name: str, parts: Sequence[Any], values: Any) -> dict[str, Any]:
    return dict(zip(_format_names(name, parts), values, strict=False))


@cache
def _format_names(name: str, parts: Sequence[Any]) -> list[str]:
    return [name.format(part) for part in parts]
