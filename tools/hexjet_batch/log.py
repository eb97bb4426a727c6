"""The logs of a batch: the columns that metrics and requirements read, of each flight as if it had been recorded."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import AXES, Command
from cosim.results.log.columns import RATES, logged_vehicle
from cosim.results.metrics import REFUSED, WIND, columns
from cosim.spec.scenario import Scenario
from hexjet_batch.stages.rotations import add, to_euler
from hexjet_batch.stages.step import Inputs, Outputs

NED = ("north", "east", "down")


class FlightLog(Mapping[str, Array]):
    """The columns of one flight, as :class:`cosim.results.log.recorder.Log` gives them."""

    def __init__(self, values: Mapping[str, Array], rows: int) -> None:
        self._values, self._rows = values, rows

    @property
    def columns(self) -> tuple[str, ...]:
        """The names."""
        return tuple(self._values)

    def __getitem__(self, name: str) -> Array:
        return self._values[name][: self._rows]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return self._rows


class BatchLog:
    """The recording of a batch: rows of numbers that all flights share, blocks of those that differ.

    ``channels``: the row of each jet's throttle; ``further`` columns beside those of the metrics; ``block``: steps that
    are turned from rows of steps to rows of flights at once.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        rows: int,
        channels: Sequence[int],
        further: Sequence[str] = (),
        block: int = 64,
    ) -> None:
        self._vehicle = logged_vehicle(scenarios[0].resolved_vehicle()[0])
        self._names = dict.fromkeys((*columns(self._vehicle), *further))
        # Jets of one channel have one throttle, which is kept once.
        self._first = {f"throttle_{jet}": f"throttle_{channels.index(of) + 1}" for jet, of in enumerate(channels, 1)}
        self._channels = channels
        self._flights, self._size, self._rows = len(scenarios), rows, block
        self._varied: dict[str, Array] = {}
        self._block: dict[str, Array] = {}
        self._shared: dict[str, Array] = defaultdict(lambda: np.full(rows, np.nan))

    def add(self, k: int, command: Command, inputs: Inputs, outputs: Outputs) -> None:
        """Record step ``k``."""
        row = k % self._rows
        for name, value in self._values(command, inputs, outputs).items():
            if value is None or name not in self._names:
                continue
            if isinstance(value, np.ndarray) and value.ndim and name not in self._varied:
                self._vary(name)
            if name in self._varied:
                self._block[name][row] = value
            else:
                self._shared[name][k] = value
        if row == self._rows - 1:
            self._turn(k - row, self._rows)

    def _vary(self, name: str) -> None:
        """Keep a column for each flight from now on."""
        self._varied[name] = np.full((self._flights, self._size), np.nan)
        self._block[name] = np.full((self._rows, self._flights), np.nan)
        if name in self._shared:
            before = self._shared.pop(name)
            self._varied[name][:] = before
            self._block[name][:] = before[:1]

    def _turn(self, first: int, rows: int) -> None:
        for name, block in self._block.items():
            self._varied[name][:, first : first + rows] = block[:rows].T

    def finish(self, rows: int) -> None:
        """Turn the last block; call it after the last of ``rows`` steps."""
        if left := rows % self._rows:
            self._turn(rows - left, left)

    def of(self, flight: int, rows: int, last: Mapping[str, Any] | None = None) -> FlightLog:
        """Return the log of a flight of so many rows; ``last``: values of one more, of the state that ended it."""
        nothing = np.full(self._size, np.nan)
        values = {name: self._shared.get(name, nothing) for name in self._names}
        values |= {name: array[flight] for name, array in self._varied.items()}
        values |= {name: values[first] for name, first in self._first.items()}
        for name in values if last is not None else ():
            column = values[name][: rows + 1].copy()
            column[rows] = last.get(name, column[rows - 1]) if last else np.nan
            values[name] = column
        return FlightLog(values, rows if last is None else rows + 1)

    def _values(self, command: Command, inputs: Inputs, o: Outputs) -> dict[str, Any]:
        """Return what a step has in each column."""
        jets, xyz = range(1, self._vehicle.jets + 1), "xyz"
        setpoints = (np.nan,) * 3 if command.rate is not None else command.attitude
        values = {
            **state_values(o.motion, o.altitude),
            **_named("{}_setpoint_rad", AXES, setpoints),
            **_named("rate_{}_setpoint_rad_s", RATES, o.rate_setpoint),
            **_named("torque_{}", AXES, o.torque),
            **_named("{}", REFUSED, o.unallocated),
            "altitude_setpoint_m": np.nan if command.collective is not None else command.altitude,
            "collective": o.collective,
            "on_ground": 0.0,
            "hull_contact": 0.0,
            **_named("{}", WIND, inputs.wind),
            **{name: o.throttle[self._channels[int(name[9:]) - 1]] for name in set(self._first.values())},
            **{f"health_{jet}": 1.0 for jet in jets},
            "payload_kg": 0.0 if inputs.payload is None else inputs.payload[0],
            "fuel_kg": o.fuel,
            **_named("disturbance_force_{}_N", xyz, inputs.force),
            **_named("disturbance_moment_{}_N_m", xyz, inputs.moment),
            **_named("disturbance_torque_{}", AXES, add(inputs.torque_command, inputs.torque_output)),
            **{name: 0.0 for name in self._names if name.startswith("fault_")},
        }
        if np.ndim(o.report.fuel):
            rows = range(len(jets)) if len(o.report.fuel) == len(jets) else self._channels
            values |= _named("fuel_flow_{}_kg_s", jets, [o.report.fuel[row] for row in rows])
        return values | _named("tilt_{}_command_rad", self._vehicle.servos, o.tilt_command or (0.0, 0.0))


def state_values(motion: Any, altitude: Any) -> dict[str, Any]:
    """Return what a state has in each column."""
    return {
        **_named("{}_rad", AXES, to_euler(motion.attitude, np)),
        **_named("rate_{}_rad_s", RATES, motion.rate),
        **_named("{}_m", NED, motion.position),
        **_named("velocity_{}_m_s", NED, motion.velocity),
        "altitude_m": altitude,
    }


def _named(name: str, parts: Sequence[Any], values: Any) -> dict[str, Any]:
    return {name.format(part): value for part, value in zip(parts, values, strict=False)}
