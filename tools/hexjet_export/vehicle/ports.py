"""A flight as a block with inputs and outputs: names, units and sources of its variables.

What is outside is replaced by a block that waits there for its values: the engines' bank, the controller, or,
where both are inside, the pilot.  The step itself is the simulation's own, so the numbers are its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, nan
from typing import NamedTuple

from cosim.base.errors import InputError
from cosim.base.protocols import Controller, Diagnostics, Engines, EngineState, Pilot, Report
from cosim.base.signals import (
    ALL_WELL,
    AXES,
    UNKNOWN3,
    ZERO3,
    Actuation,
    Ambient,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    Measured,
    PerJet,
    Unallocated,
)
from cosim.engine.fmu.air import Air
from cosim.engine.fmu.port_kinds import AMBIENT, OUTPUTS
from cosim.simulation.build import build
from cosim.simulation.script.command_script import CommandScript
from cosim.spec.scenario import EngineFault, Scenario
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.propulsion import Propulsion
from hexjet_export.controller.quantity import Quantity

XYZ, WXYZ, NED = "xyz", "wxyz", ("north", "east", "down")
REPORTS = OUTPUTS
UNITS = {
    "throttle": "1", "thrust": "N", "spool_speed": "rad/s", "exhaust_temperature": "K", "fuel_flow": "kg/s",
    "force_forward": "N", "force_right": "N", "torque": "N.m",
    "run": "1", "ambient_pressure": "Pa", "ambient_temperature": "K", "air_speed": "m/s", "altitude": "m", "mach": "1",
    "density": "kg/m3", "total_pressure": "Pa", "total_temperature": "K",
}  # fmt: skip
_ENGINES = (EngineState.FLY, EngineState.IDLE, EngineState.OFF)


class OutputGroup(NamedTuple):
    """Outputs that one function reads together."""

    quantities: Sequence[Quantity]
    read: Callable[[], Sequence[float]]


@dataclass(frozen=True)
class VehicleContents:
    """Which parts the exported vehicle contains."""

    engines: bool = True
    controller: bool = True


class ExportedFlight:
    """One simulation whose engines, or controller, or commands are outside, in the importing tool.

    ``exchange`` is called in every step where the flight needs inputs: before it the :attr:`outputs` are those of
    ``t_k``, after it :attr:`input_values` holds the inputs by name.  Raises InputError as :func:`build` does, and for a
    flight that cannot be had so.
    """

    def __init__(self, scenario: Scenario, contents: VehicleContents, exchange: Callable[[], None]) -> None:
        if scenario.requests is not None:
            raise InputError(f"scenario {scenario.name}: is flown by an autopilot's requests; choose one with commands")
        if not contents.engines and not contents.controller:
            for fault in scenario.fault:
                if isinstance(fault, EngineFault):
                    raise InputError(
                        f"scenario {scenario.name}: fault {fault.kind}: acts between controller and engines, and both "
                        "are outside; leave it out, or one of them inside"
                    )
        self.contents, self.exchange = contents, exchange
        self.simulation = simulation = build(scenario)
        self._wind = simulation.disturbances.at(0).wind
        self.jets = len(simulation.vehicle.jets)
        self.throttle: PerJet = ()
        self.command = Command((0.0, 0.0, 0.0), 0.0)
        self.run = [1.0] * self.jets
        bank = simulation.propulsion.engines.bank
        initial = simulation.scenario.initial
        self.start_throttle = simulation.controller.reset(initial.on_ground, simulation.propulsion.burnt)
        self.start_engines = bank.reset(self.start_throttle, self.ambient if bank.wants_ambient else None)
        self.inputs = tuple(self._list_inputs())
        self._groups = tuple(self._list_outputs())
        self.outputs = tuple(quantity for group in self._groups for quantity in group.quantities)
        self.input_values: dict[str, float] = {quantity.name: quantity.start for quantity in self.inputs}
        # The blocks that those outside replace are built and measured all the same, so that the inputs are the same.
        if contents.engines:
            simulation.propulsion.engines.bank = _ObservedEngines(bank, self)
        else:
            bank.close()
            simulation.propulsion.engines.bank = _EnginesOutside(self, bank.wants_ambient)
        if contents.controller:
            simulation.pilot = _PilotOutside(self, simulation.pilot, simulation.command_script)
        else:
            simulation.controller = _ControllerOutside(self, simulation.controller)

    @property
    def ambient(self) -> Ambient:
        """Ambient air at the engines now."""
        simulation = self.simulation
        wind = simulation.state.wind if simulation.k else self._wind
        return simulation.propulsion.ambient(simulation.state, wind)

    def read_outputs(self) -> tuple[float, ...]:
        """Return the outputs now, in the order of :attr:`outputs`."""
        return tuple([float(value) for group in self._groups for value in group.read()])

    def read_engine_output(self) -> EngineOutput:
        """Return the outside engines' outputs from the inputs; NaN for a quantity that they do not have."""
        input_values = self.input_values
        return EngineOutput(
            *[tuple([input_values.get(f"{name}_{jet}", nan) for jet in self.jet_numbers]) for name in REPORTS]
        )

    @property
    def jet_numbers(self) -> range:
        """The jets' numbers, from 1."""
        return range(1, self.jets + 1)

    def read_per_jet(self, name: str) -> PerJet:
        """Return the input of this name of every jet."""
        return tuple([self.input_values[f"{name}_{jet}"] for jet in self.jet_numbers])

    def _list_inputs(self) -> Iterator[Quantity]:
        yield from self._list_setpoints() if self.contents.controller else self._list_actuators()
        if not self.contents.engines:
            for name, starts in zip(REPORTS, self.start_engines, strict=True):
                for jet, (start, spec) in enumerate(zip(starts, self.simulation.stations, strict=True), 1):
                    if spec.has_port(name):
                        yield Quantity(f"{name}_{jet}", UNITS[name], f"Of the engine of jet {jet}: {name}", start)

    def _list_setpoints(self) -> Iterator[Quantity]:
        """List set-points for the controller inside, which fly in place of the scenario's commands."""
        command = self.simulation.command_script.at(0)
        yield Quantity("commanded", "1", "0: the scenario's commands are flown; 1: the set-points here")
        for axis, angle in zip(AXES, command.attitude, strict=True):
            yield Quantity(f"{axis}_setpoint", "rad", f"Attitude asked for: {axis}", angle)
        yield Quantity("altitude_setpoint", "m", "Height above the ground asked for", command.altitude)
        yield Quantity("rates_commanded", "1", "1: body rates are asked for in place of an attitude")
        for axis in AXES:
            yield Quantity(f"{axis}_rate_setpoint", "rad/s", f"Body rate asked for: {axis}")
        yield Quantity("collective_commanded", "1", "1: a mean throttle is asked for in place of a height")
        yield Quantity("collective_setpoint", "1", "Mean throttle asked for")
        yield Quantity("engines", "1", "0: as the loops ask; 1: idle; 2: off")

    def _list_actuators(self) -> Iterator[Quantity]:
        """List what a controller outside commands: throttles of engines inside, and servos."""
        vehicle = self.simulation.vehicle
        if self.contents.engines:
            for jet, start in zip(self.jet_numbers, self.start_throttle, strict=True):
                yield Quantity(f"throttle_{jet}", "1", f"Throttle of jet {jet}", start)
            for jet in self.jet_numbers:
                yield Quantity(f"off_{jet}", "1", f"1: jet {jet} is shut off on purpose")
        if vehicle.servo is not None:
            yield Quantity("tilt_left", "rad", "Tilt asked of the left servo, positive forward")
            yield Quantity("tilt_right", "rad", "Tilt asked of the right servo, positive forward")
        else:
            for n, name in enumerate(_name_movables(vehicle)):
                yield Quantity(f"tilt_{name}", _unit_of(vehicle, n), f"Asked of the servo {name}", vehicle.rest[n])

    def _list_outputs(self) -> Iterator[OutputGroup]:
        simulation, propulsion = self.simulation, self.simulation.propulsion
        if self.contents.controller:
            throttles = [
                Quantity(f"throttle_{jet}", "1", f"Told to the engine of jet {jet}") for jet in self.jet_numbers
            ]
            yield OutputGroup(throttles, lambda: self.throttle)
        else:
            yield from self._list_command()
        if simulation.vehicle.servo is not None:
            sides = [Quantity(f"servo_{side}", "rad", f"Where the {side} servo stands") for side in ("left", "right")]
            yield OutputGroup(sides, lambda: propulsion.tilt)
        elif movables := _name_movables(simulation.vehicle):
            positions = [
                Quantity(f"servo_{name}", _unit_of(simulation.vehicle, n), f"Where the servo {name} stands")
                for n, name in enumerate(movables)
            ]
            yield OutputGroup(positions, lambda: propulsion.tilt)
        yield from self._list_reports() if self.contents.engines else self._list_engine_inputs()
        if propulsion.tank is not None:
            yield OutputGroup(
                [Quantity("fuel_burnt", "kg", "Fuel burnt since the full tank")], lambda: (propulsion.burnt,)
            )
        yield from self._list_state()
        yield from self._list_measured()

    def _list_command(self) -> Iterator[OutputGroup]:
        """List the scenario's command, for a controller outside."""
        yield OutputGroup(_list_angles("_setpoint", "rad", "Attitude asked for"), lambda: self.command.attitude)
        height = Quantity("altitude_setpoint", "m", "Height above the ground asked for")
        yield OutputGroup([height], lambda: (self.command.altitude,))
        flag = Quantity("rates_commanded", "1", "1: body rates are asked for in place of an attitude")
        yield OutputGroup([flag], lambda: (self.command.rate is not None,))
        yield OutputGroup(
            _list_angles("_rate_setpoint", "rad/s", "Body rate asked for"), lambda: self.command.rate or ZERO3
        )
        flag = Quantity("collective_commanded", "1", "1: a mean throttle is asked for in place of a height")
        mean = Quantity("collective_setpoint", "1", "Mean throttle asked for")
        yield OutputGroup([flag, mean], lambda: (self.command.collective is not None, self.command.collective or 0.0))

    def _list_reports(self) -> Iterator[OutputGroup]:
        """List what engines inside deliver and report."""
        output = self.simulation.propulsion
        for n, name in enumerate(REPORTS):
            indices = [i for i, spec in enumerate(self.simulation.stations) if spec.has_port(name)]
            quantities = [
                Quantity(f"{name}_{i + 1}", UNITS[name], f"Of the engine of jet {i + 1}: {name}") for i in indices
            ]
            yield OutputGroup(quantities, partial(_read_jets, output, n, indices))

    def _list_engine_inputs(self) -> Iterator[OutputGroup]:
        """List what engines outside get beside their throttles."""
        stations = self.simulation.stations
        text = "Throttle at which the engine stands in equilibrium before the first step: jet"
        starts = [Quantity(f"start_throttle_{jet}", "1", f"{text} {jet}") for jet in self.jet_numbers]
        yield OutputGroup(starts, lambda: self.start_throttle)
        indices = [i for i, spec in enumerate(stations) if spec.has_port("run")]
        runs = [Quantity(f"run_{i + 1}", "1", f"1: fuel on at jet {i + 1}") for i in indices]
        yield OutputGroup(runs, lambda: [self.run[i] for i in indices])
        for i, spec in enumerate(stations):
            ports = [port for port in AMBIENT if spec.has_port(port)]
            text = f"Around the engine of jet {i + 1}"
            yield OutputGroup(
                [Quantity(f"{port}_{i + 1}", UNITS[port], f"{text}: {port}") for port in ports],
                self._reader_of_air(i, ports),
            )

    def _reader_of_air(self, jet: int, ports: Sequence[str]) -> Callable[[], Sequence[float]]:
        def read() -> Sequence[float]:
            if not ports:
                return ()
            pressure, temperature, speeds = self.ambient
            air = Air(pressure, temperature, speeds[jet])
            quantities = dict(zip(AMBIENT[:3], air, strict=True)) | air.derive()
            return [quantities[port] for port in ports]

        return read

    def _list_state(self) -> Iterator[OutputGroup]:
        simulation = self.simulation
        yield OutputGroup(
            _list_parts("position", NED, "m", "Position from the start"), lambda: simulation.state.position
        )
        yield OutputGroup(
            _list_parts("velocity", NED, "m/s", "Velocity over the ground"), lambda: simulation.state.velocity
        )
        yield OutputGroup(
            _list_parts("attitude", WXYZ, "1", "Quaternion body to NED"), lambda: simulation.state.attitude
        )
        yield OutputGroup(
            _list_angles("", "rad", "Attitude, in the order yaw, pitch, roll"), lambda: simulation.state.euler
        )
        yield OutputGroup(_list_angles("_rate", "rad/s", "Body rate"), lambda: simulation.state.rate)
        force = _list_parts("specific_force", XYZ, "m/s2", "Specific force at the centre of gravity, body")
        yield OutputGroup(force, lambda: simulation.state.specific_force)
        yield OutputGroup(_list_parts("wind", NED, "m/s", "Wind with turbulence"), lambda: simulation.state.wind)
        yield OutputGroup([Quantity("altitude", "m", "Height above the ground")], lambda: (simulation.state.altitude,))
        yield OutputGroup([Quantity("mass", "kg", "Mass of the vehicle")], lambda: (simulation.state.mass,))
        yield OutputGroup([Quantity("on_ground", "1", "1: a leg touches")], lambda: (simulation.state.on_ground,))

    def _list_measured(self) -> Iterator[OutputGroup]:
        simulation = self.simulation
        yield OutputGroup(
            _list_angles("_rate", "rad/s", "Measured body rate", "measured_"), lambda: simulation.measured.rate
        )
        attitude = _list_parts("measured_attitude", WXYZ, "1", "Measured quaternion body to NED")
        yield OutputGroup(attitude, lambda: simulation.measured.attitude)
        yield OutputGroup(
            _list_parts("measured_position", NED, "m", "Measured position"), lambda: simulation.measured.position
        )
        yield OutputGroup(
            _list_parts("measured_velocity", NED, "m/s", "Measured velocity"), lambda: simulation.measured.velocity
        )
        height = Quantity("measured_altitude", "m", "Measured height above the ground")
        yield OutputGroup([height], lambda: (simulation.measured.altitude,))
        if all(isfinite(value) for value in simulation.measured.specific_force):  # there is an accelerometer
            force = _list_parts("measured_specific_force", XYZ, "m/s2", "Measured specific force, body")
            yield OutputGroup(force, lambda: simulation.measured.specific_force)

    def close(self) -> None:
        """Free engines and airframe."""
        self.simulation.close()


class _ObservedEngines:
    """Engines inside the vehicle, whose throttles are recorded as outputs."""

    def __init__(self, inner: Engines, flight: ExportedFlight) -> None:
        self._inner, self._flight = inner, flight
        self.wants_ambient = inner.wants_ambient

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        self._flight.throttle = _per_jet(throttle, self._flight.jets)
        return self._inner.reset(throttle, ambient)

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        self._flight.throttle = throttle
        return self._inner.step(k, throttle, ambient)

    def run_down(self, seconds: float) -> EngineOutput:
        return self._inner.run_down(seconds)

    def set_run(self, index: int, on: bool) -> bool:
        return self._inner.set_run(index, on)

    def close(self) -> None:
        self._inner.close()


class _EnginesOutside:
    """Stand-in for engines outside: step ``k``'s throttles are outputs, and the thrusts at its end are inputs."""

    def __init__(self, flight: ExportedFlight, wants_ambient: bool) -> None:
        self._flight, self.wants_ambient = flight, wants_ambient

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        flight = self._flight
        flight.throttle, flight.run = _per_jet(throttle, flight.jets), [1.0] * flight.jets
        return flight.read_engine_output()

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        flight = self._flight
        flight.throttle = throttle
        if flight.contents.controller:
            flight.exchange()
        return flight.read_engine_output()

    def run_down(self, seconds: float) -> EngineOutput:
        return self._flight.read_engine_output()

    def set_run(self, index: int, on: bool) -> bool:
        flight = self._flight
        flight.run[index] = float(on)
        return flight.simulation.stations[index].has_port("run")

    def close(self) -> None:
        """Do nothing, because there is nothing to free."""


class _PilotOutside:
    """A pilot that flies the set-points of the inputs where they are commanded, or else the scenario's."""

    def __init__(self, flight: ExportedFlight, inner: Pilot | None, commander: CommandScript) -> None:
        self._flight, self._inner, self._commander = flight, inner, commander
        self.engines = EngineState.FLY
        self.seen: Measured = flight.simulation.measured

    def reset(self, measured: Measured) -> None:
        if self._inner is not None:
            self._inner.reset(measured)

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        if self._flight.contents.engines:
            self._flight.exchange()
        input_values, inner = self._flight.input_values, self._inner
        self.seen, self.engines = measured, EngineState.FLY
        if input_values["commanded"] > 0.5:
            roll, pitch, yaw = (input_values[f"{axis}_setpoint"] for axis in AXES)
            p, q, r = (input_values[f"{axis}_rate_setpoint"] for axis in AXES)
            self.engines = _ENGINES[(input_values["engines"] > 0.5) + (input_values["engines"] > 1.5)]
            return Command(
                (roll, pitch, yaw),
                input_values["altitude_setpoint"],
                (p, q, r) if input_values["rates_commanded"] > 0.5 else None,
                input_values["collective_setpoint"] if input_values["collective_commanded"] > 0.5 else None,
            )
        if inner is None:
            return self._commander.at(k)
        command = inner.update(k, measured, report)
        self.seen, self.engines = inner.seen, inner.engines
        return command


class _ControllerOutside:
    """Stand-in for a controller outside; the built-in controller gives the engines' throttles before the first step."""

    signals = ControlSignals(UNKNOWN3, UNKNOWN3, UNKNOWN3, nan, nan)
    lost: tuple[int, ...] = ()

    def __init__(self, flight: ExportedFlight, inner: Controller) -> None:
        self._flight, self._inner = flight, inner

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        return self._inner.diagnostics

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        return self._inner.reset(on_ground, burnt)

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        flight = self._flight
        flight.command = command
        flight.exchange()
        input_values = flight.input_values
        vehicle = flight.simulation.vehicle
        tilt = tuple(
            [input_values.get(f"tilt_{name}", rest) for name, rest in zip(vehicle.actuators, vehicle.rest, strict=True)]
        )
        if not flight.contents.engines:
            return Actuation(flight.throttle, tilt, Unallocated())
        off = frozenset([i for i, value in enumerate(flight.read_per_jet("off")) if value > 0.5])
        return Actuation(flight.read_per_jet("throttle"), tilt, Unallocated(), off)

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        return ALL_WELL

    def forgive(self) -> None:
        """Do nothing, because it takes no engine for lost."""


def _name_movables(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of hinges and surfaces; none for two tilting banks, or where nothing moves."""
    return vehicle.actuators if vehicle.servo is None and vehicle.ranges else ()


def _unit_of(vehicle: Vehicle, index: int) -> str:
    return "rad" if index < len(vehicle.hinges) else "1"


def _per_jet(throttle: float | Sequence[float], jets: int) -> PerJet:
    return tuple(throttle) if isinstance(throttle, Sequence) else (throttle,) * jets


def _list_angles(suffix: str, unit: str, text: str, prefix: str = "") -> list[Quantity]:
    return [Quantity(f"{prefix}{axis}{suffix}", unit, f"{text}: {axis}") for axis in AXES]


def _list_parts(name: str, parts: Sequence[str], unit: str, text: str) -> list[Quantity]:
    return [Quantity(f"{name}_{part}", unit, f"{text}: {part}") for part in parts]


def _read_jets(propulsion: Propulsion, report: int, jets: Sequence[int]) -> list[float]:
    values = propulsion.output[report]
    return [values[jet] for jet in jets]
