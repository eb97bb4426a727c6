"""A flight as a block with inputs and outputs: names, units and sources of its variables.

What is outside is replaced by a block that waits there for its values: the engines' bank, the controller, or,
where both are inside, the pilot.  The step itself is the simulation's own, so the numbers are its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, nan
from typing import NamedTuple

from cosim import InputError, Scenario
from cosim.base.protocols import Controller, Diagnostics, Engines, EngineState, Pilot, Report
from cosim.base.signals import (
    ALL_HEALTHY,
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
from cosim.blocks import AMBIENT, OUTPUTS, Air, CommandScript, Propulsion, build
from cosim.spec.scenario import EngineFault
from cosim.spec.vehicle import Vehicle
from hexjet_export.controller.quantity import Quantity

XYZ, WXYZ, NED = "xyz", "wxyz", ("north", "east", "down")  # suffixes of vectors and quaternions
REPORTS = OUTPUTS  # outputs of an engine
UNITS = {  # unit of each engine port
    "throttle": "1", "thrust": "N", "spool_speed": "rad/s", "exhaust_temperature": "K", "fuel_flow": "kg/s",
    "force_forward": "N", "force_right": "N", "torque": "N.m",
    "run": "1", "ambient_pressure": "Pa", "ambient_temperature": "K", "air_speed": "m/s", "altitude": "m", "mach": "1",
    "density": "kg/m3", "total_pressure": "Pa", "total_temperature": "K",
}  # fmt: skip
_ENGINE_STATES = (EngineState.FLY, EngineState.IDLE, EngineState.OFF)  # engine state of each input number


class OutputGroup(NamedTuple):
    """Outputs that are read by one function."""

    quantities: Sequence[Quantity]
    read: Callable[[], Sequence[float]]


@dataclass(frozen=True)
class VehicleContents:
    """Whether the exported vehicle contains its engines and its controller."""

    engines: bool = True
    controller: bool = True


class ExportedFlight:
    """A simulation whose engines, controller or commands are in the importing tool.

    ``exchange`` is called in every step where the flight needs inputs: before it the :attr:`outputs` are those of
    ``t_k``, after it :attr:`input_values` holds the inputs by name.  Raises InputError as :func:`build` does, and for a
    flight that cannot be exported.
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
        # Blocks that are replaced by external ones are built all the same, so that the inputs do not depend on them.
        if contents.engines:
            simulation.propulsion.engines.bank = _ObservedEngines(bank, self)
        else:
            bank.close()
            simulation.propulsion.engines.bank = _ExternalEngines(self, bank.wants_ambient)
        if contents.controller:
            simulation.pilot = _SetpointPilot(self, simulation.pilot, simulation.command_script)
        else:
            simulation.controller = _ExternalController(self, simulation.controller)

    @property
    def ambient(self) -> Ambient:
        """Ambient air at the engines in this step."""
        simulation = self.simulation
        wind = simulation.state.wind if simulation.k else self._wind
        return simulation.propulsion.ambient(simulation.state, wind)

    def read_outputs(self) -> tuple[float, ...]:
        """Return the outputs now, in the order of :attr:`outputs`."""
        return tuple([float(value) for group in self._groups for value in group.read()])

    def read_engine_output(self) -> EngineOutput:
        """Return the external engines' outputs from the inputs; NaN for what an engine does not report."""
        input_values = self.input_values
        return EngineOutput(
            *[tuple([input_values.get(f"{name}_{jet}", nan) for jet in self.jet_numbers]) for name in REPORTS]
        )

    @property
    def jet_numbers(self) -> range:
        return range(1, self.jets + 1)

    def read_per_jet(self, name: str) -> PerJet:
        """Return the values of an input that every jet has."""
        return tuple([self.input_values[f"{name}_{jet}"] for jet in self.jet_numbers])

    def _list_inputs(self) -> Iterator[Quantity]:
        yield from self._list_setpoints() if self.contents.controller else self._list_actuators()
        if not self.contents.engines:
            for name, starts in zip(REPORTS, self.start_engines, strict=True):
                for jet, (start, spec) in enumerate(zip(starts, self.simulation.stations, strict=True), 1):
                    if spec.has_port(name):
                        yield Quantity(f"{name}_{jet}", UNITS[name], f"Of the engine of jet {jet}: {name}", start)

    def _list_setpoints(self) -> Iterator[Quantity]:
        """List set-points for the internal controller, which may replace the scenario's commands."""
        command = self.simulation.command_script.at(0)
        yield Quantity("commanded", "1", "0: the scenario's commands are flown; 1: the set-points here")
        for axis, angle in zip(AXES, command.attitude, strict=True):
            yield Quantity(f"{axis}_setpoint", "rad", f"Commanded attitude: {axis}", angle)
        yield Quantity("altitude_setpoint", "m", "Commanded height above the ground", command.altitude)
        yield Quantity("rates_commanded", "1", "1: body rates are commanded instead of an attitude")
        for axis in AXES:
            yield Quantity(f"{axis}_rate_setpoint", "rad/s", f"Commanded body rate: {axis}")
        yield Quantity("collective_commanded", "1", "1: a mean throttle is commanded instead of a height")
        yield Quantity("collective_setpoint", "1", "Commanded mean throttle")
        yield Quantity("engines", "1", "0: as the loops ask; 1: idle; 2: off")

    def _list_actuators(self) -> Iterator[Quantity]:
        """List commands of an external controller: throttles of internal engines, and servos."""
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
            for n, name in enumerate(_list_movables(vehicle)):
                yield Quantity(f"tilt_{name}", _unit_of(vehicle, n), f"Asked of the servo {name}", vehicle.rest[n])

    def _list_outputs(self) -> Iterator[OutputGroup]:
        propulsion = self.simulation.propulsion
        if self.contents.controller:
            yield OutputGroup(
                _list("throttle_{}", self.jet_numbers, "1", "Told to the engine of jet {}"), lambda: self.throttle
            )
        else:
            yield from self._list_command()
        vehicle = self.simulation.vehicle
        names = ("left", "right") if vehicle.servo is not None else _list_movables(vehicle)
        text = "Where the {} servo stands" if vehicle.servo is not None else "Where the servo {} stands"
        positions = [
            Quantity(f"servo_{name}", "rad" if vehicle.servo is not None else _unit_of(vehicle, n), text.format(name))
            for n, name in enumerate(names)
        ]
        yield OutputGroup(positions, lambda: propulsion.tilt[: len(names)])
        yield from self._list_reports() if self.contents.engines else self._list_engine_inputs()
        if propulsion.tank is not None:
            yield OutputGroup(
                [Quantity("fuel_burnt", "kg", "Fuel burnt since the full tank")], lambda: (propulsion.burnt,)
            )
        yield from self._list_state()
        yield from self._list_measured()

    def _list_command(self) -> Iterator[OutputGroup]:
        """List the scenario's command, for an external controller."""
        yield OutputGroup(_list("{}_setpoint", AXES, "rad", "Commanded attitude: {}"), lambda: self.command.attitude)
        height = Quantity("altitude_setpoint", "m", "Commanded height above the ground")
        yield OutputGroup([height], lambda: (self.command.altitude,))
        flag = Quantity("rates_commanded", "1", "1: body rates are commanded instead of an attitude")
        yield OutputGroup([flag], lambda: (self.command.rate is not None,))
        rates = _list("{}_rate_setpoint", AXES, "rad/s", "Commanded body rate: {}")
        yield OutputGroup(rates, lambda: self.command.rate or ZERO3)
        flag = Quantity("collective_commanded", "1", "1: a mean throttle is commanded instead of a height")
        mean = Quantity("collective_setpoint", "1", "Commanded mean throttle")
        yield OutputGroup([flag, mean], lambda: (self.command.collective is not None, self.command.collective or 0.0))

    def _list_reports(self) -> Iterator[OutputGroup]:
        """List thrust and other outputs of internal engines."""
        output = self.simulation.propulsion
        for n, name in enumerate(REPORTS):
            indices = [i for i, spec in enumerate(self.simulation.stations) if spec.has_port(name)]
            jets = [i + 1 for i in indices]
            quantities = _list(f"{name}_{{}}", jets, UNITS[name], f"Of the engine of jet {{}}: {name}")
            yield OutputGroup(quantities, partial(_read_jets, output, n, indices))

    def _list_engine_inputs(self) -> Iterator[OutputGroup]:
        """List inputs of external engines other than throttle."""
        stations = self.simulation.stations
        text = "Throttle at which the engine stands in equilibrium before the first step: jet {}"
        starts = _list("start_throttle_{}", self.jet_numbers, "1", text)
        yield OutputGroup(starts, lambda: self.start_throttle)
        indices = [i for i, spec in enumerate(stations) if spec.has_port("run")]
        runs = _list("run_{}", [i + 1 for i in indices], "1", "1: fuel on at jet {}")
        yield OutputGroup(runs, lambda: [self.run[i] for i in indices])
        for i, spec in enumerate(stations):
            ports = [port for port in AMBIENT if spec.has_port(port)]
            text = f"Around the engine of jet {i + 1}"
            yield OutputGroup(
                [Quantity(f"{port}_{i + 1}", UNITS[port], f"{text}: {port}") for port in ports],
                self._make_air_reader(i, ports),
            )

    def _make_air_reader(self, jet: int, ports: Sequence[str]) -> Callable[[], Sequence[float]]:
        def read() -> Sequence[float]:
            if not ports:
                return ()
            pressure, temperature, speeds = self.ambient
            air = Air(pressure, temperature, speeds[jet])
            quantities = dict(zip(AMBIENT[:3], air, strict=True)) | air.derive()
            return [quantities[port] for port in ports]

        return read

    def _list_state(self) -> Iterator[OutputGroup]:
        now = self.simulation
        yield OutputGroup(_list("position_{}", NED, "m", "Position from the start: {}"), lambda: now.state.position)
        yield OutputGroup(_list("velocity_{}", NED, "m/s", "Velocity over the ground: {}"), lambda: now.state.velocity)
        yield OutputGroup(_list("attitude_{}", WXYZ, "1", "Quaternion body to NED: {}"), lambda: now.state.attitude)
        angles = _list("{}", AXES, "rad", "Attitude, in the order yaw, pitch, roll: {}")
        yield OutputGroup(angles, lambda: now.state.euler)
        yield OutputGroup(_list("{}_rate", AXES, "rad/s", "Body rate: {}"), lambda: now.state.rate)
        force = _list("specific_force_{}", XYZ, "m/s2", "Specific force at the centre of gravity, body: {}")
        yield OutputGroup(force, lambda: now.state.specific_force)
        yield OutputGroup(_list("wind_{}", NED, "m/s", "Wind with turbulence: {}"), lambda: now.state.wind)
        yield OutputGroup([Quantity("altitude", "m", "Height above the ground")], lambda: (now.state.altitude,))
        yield OutputGroup([Quantity("mass", "kg", "Mass of the vehicle")], lambda: (now.state.mass,))
        yield OutputGroup([Quantity("on_ground", "1", "1: a leg touches")], lambda: (now.state.on_ground,))

    def _list_measured(self) -> Iterator[OutputGroup]:
        now = self.simulation
        rates = _list("measured_{}_rate", AXES, "rad/s", "Measured body rate: {}")
        yield OutputGroup(rates, lambda: now.measured.rate)
        attitude = _list("measured_attitude_{}", WXYZ, "1", "Measured quaternion body to NED: {}")
        yield OutputGroup(attitude, lambda: now.measured.attitude)
        position = _list("measured_position_{}", NED, "m", "Measured position: {}")
        yield OutputGroup(position, lambda: now.measured.position)
        velocity = _list("measured_velocity_{}", NED, "m/s", "Measured velocity: {}")
        yield OutputGroup(velocity, lambda: now.measured.velocity)
        height = Quantity("measured_altitude", "m", "Measured height above the ground")
        yield OutputGroup([height], lambda: (now.measured.altitude,))
        if all(isfinite(value) for value in now.measured.specific_force):  # there is an accelerometer
            force = _list("measured_specific_force_{}", XYZ, "m/s2", "Measured specific force, body: {}")
            yield OutputGroup(force, lambda: now.measured.specific_force)

    def close(self) -> None:
        """Free engines and airframe."""
        self.simulation.close()


class _ObservedEngines:
    """Internal engines whose throttles are kept as outputs."""

    def __init__(self, inner: Engines, flight: ExportedFlight) -> None:
        self._inner, self._flight = inner, flight
        self.wants_ambient = inner.wants_ambient

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        self._flight.throttle = _repeat_per_jet(throttle, self._flight.jets)
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


class _ExternalEngines:
    """Placeholder for external engines: throttles of step ``k`` are outputs, thrusts at its end inputs."""

    def __init__(self, flight: ExportedFlight, wants_ambient: bool) -> None:
        self._flight, self.wants_ambient = flight, wants_ambient

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        flight = self._flight
        flight.throttle, flight.run = _repeat_per_jet(throttle, flight.jets), [1.0] * flight.jets
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
        """Do nothing, as there is nothing to free."""


class _SetpointPilot:
    """Pilot that flies set-points from the inputs while they are commanded, else the scenario's."""

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
            self.engines = _ENGINE_STATES[(input_values["engines"] > 0.5) + (input_values["engines"] > 1.5)]
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


class _ExternalController:
    """Placeholder for an external controller; the built-in one sets throttles before the first step."""

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
        return ALL_HEALTHY

    def forgive(self) -> None:
        """Do nothing, as no engine counts as failed."""


def _list_movables(vehicle: Vehicle) -> tuple[str, ...]:
    """Return names of hinges and surfaces; empty with two banks, or if nothing moves."""
    return vehicle.actuators if vehicle.servo is None and vehicle.ranges else ()


def _unit_of(vehicle: Vehicle, index: int) -> str:
    """Return the unit of a hinge's angle [rad] or a surface's deflection [1]."""
    return "rad" if index < len(vehicle.hinges) else "1"


def _repeat_per_jet(throttle: float | Sequence[float], jets: int) -> PerJet:
    return tuple(throttle) if isinstance(throttle, Sequence) else (throttle,) * jets


def _list(name: str, parts: Iterable[object], unit: str, text: str) -> list[Quantity]:
    """Return one quantity per part, whose name replaces the braces in name and text."""
    return [Quantity(name.format(part), unit, text.format(part)) for part in parts]


def _read_jets(propulsion: Propulsion, report: int, jets: Sequence[int]) -> list[float]:
    values = propulsion.output[report]
    return [values[jet] for jet in jets]
