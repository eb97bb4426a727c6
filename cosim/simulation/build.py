"""Wiring a flight: the one place where its blocks are joined."""

from __future__ import annotations

from contextlib import ExitStack
from math import radians

from cosim.base.errors import InputError
from cosim.base.frames import from_euler, rotate
from cosim.base.protocols import Sensors
from cosim.base.runtime import kernels
from cosim.control.predictors.registry import PREDICTORS
from cosim.simulation.controllers.built_in import make_cascade
from cosim.simulation.controllers.external_controller import ExternalController, find_controller, resolve_parameters
from cosim.simulation.controllers.source import Source
from cosim.simulation.delay_ledger import make_delay_ledger
from cosim.simulation.ending import TerminationCheck
from cosim.simulation.engines import flown_engines, load_engines, make_engines
from cosim.simulation.guided_pilot import make_guided_pilot
from cosim.simulation.plugins import load_plugins
from cosim.simulation.script.command_script import CommandScript
from cosim.simulation.script.disturbance_script import DisturbanceScript
from cosim.simulation.script.fault_schedule import FaultSchedule
from cosim.simulation.script.mismatch import apply_mismatch
from cosim.simulation.step import Blocks, Simulation
from cosim.simulation.user_code import check_scenario_trust
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.airframe import Airframe, standing_height, start_height
from cosim.vehicle.effects.make import make_effects
from cosim.vehicle.effects.rotors import RotorDynamics
from cosim.vehicle.propulsion import make_propulsion
from cosim.vehicle.sensors import FaultySensors, SensorSuite


def build(scenario: Scenario, controller: Source | None = None, with_ledger: bool = True) -> Simulation:
    """Return the simulation of a scenario with its blocks connected; ``controller``: in place of the scenario's.

    ``with_ledger``: whether the delay ledger is made, which takes longer than a thousand steps of a hinged vehicle.
    Raises InputError for anything in scenario, vehicle, engine or controller that does not fit, or is not trusted.
    """
    check_scenario_trust(scenario)
    kernels.warn_of_other_kernels()
    controller = controller or find_controller(scenario)
    parameters = resolve_parameters(scenario, controller)
    plugins = load_plugins(scenario)
    scenario.count(scenario.duration_s, "duration_s")
    vehicle, folder = scenario.resolved_vehicle()
    _check_fuel(scenario, vehicle)
    _check_start_height(scenario, vehicle)
    PREDICTORS.check(vehicle.control.predictor, f"scenario {scenario.name}: vehicle.control.predictor")
    engine, *stations = specs = load_engines(scenario, vehicle)
    step, environment, seed = scenario.step_s, scenario.environment, scenario.seed
    flown = apply_mismatch(vehicle, scenario.mismatch)
    flown_stations = flown_engines(scenario, vehicle, stations)
    effects = make_effects(vehicle, flown, flown_stations, step)
    spinning = any(isinstance(effect, RotorDynamics) for effect in effects)
    with ExitStack() as stack:
        plugged = None
        if controller is not None:
            plugged = ExternalController(controller, parameters, scenario, vehicle, engine, stations)
            stack.callback(plugged.close)
            plugged.make_block()
        cascade = make_cascade(scenario, vehicle, engine, stations, plugged)
        airframe = Airframe(flown, folder, environment, step, scenario.substeps, seed, spinning)
        stack.callback(airframe.close)
        engines = make_engines(scenario, flown_stations)
        stack.callback(engines.close)
        propulsion = make_propulsion(vehicle, flown, engines, effects, airframe.air, step, scenario.initial.fuel)
        suite: Sensors = SensorSuite(vehicle.sensors, step, seed, scenario.sensor_noise)
        sensors = FaultySensors(suite if plugins.sensors is None else plugins.sensors(suite))
        height = start_height(flown, scenario.initial)
        commander = CommandScript(scenario, height)
        flies_ahead = _has_speed_command(scenario, vehicle, commander)
        simulation = Simulation(
            Blocks(
                scenario=scenario,
                vehicle=vehicle,
                specs=specs,
                ledger=make_delay_ledger(scenario, vehicle, flown_stations, cascade.allocator, flies_ahead)
                if with_ledger
                else [],
                command_script=commander,
                pilot=make_guided_pilot(scenario, vehicle, commander, cascade),
                disturbances=DisturbanceScript(scenario),
                cascade=cascade,
                propulsion=propulsion,
                airframe=airframe,
                sensors=sensors,
                faults=FaultSchedule(
                    scenario,
                    engines,
                    propulsion.servos,
                    sensors,
                    [spec.flame_out for spec in stations],
                    vehicle.actuators,
                    len(vehicle.surfaces),
                ),
                termination=TerminationCheck(vehicle.limits),
                plugged=plugged,
                plugins=plugins,
                wind=None if plugins.wind is None else plugins.wind(flown, step, height),
            )
        )
        stack.pop_all()
        return simulation


def _has_speed_command(scenario: Scenario, vehicle: Vehicle, commander: CommandScript) -> bool:
    """Return whether a forward speed is commanded.  Raises InputError if no law flies it."""
    flies_ahead = "ahead_m_s" in commander.signals
    if flies_ahead and vehicle.control.wing is None:
        raise InputError(
            f"scenario {scenario.name}: command: 'ahead_m_s': {vehicle.name} has no [control.wing] to fly ahead "
            "with; take a velocity"
        )
    return flies_ahead


def _check_fuel(scenario: Scenario, vehicle: Vehicle) -> None:
    """Refuse partial fuel for a vehicle without a tank."""
    if vehicle.fuel is None and scenario.initial.fuel != 1.0:
        raise InputError(
            f"scenario {scenario.name}: initial.fuel = {scenario.initial.fuel:g}: {vehicle.name} has no tank; leave it "
            "out, or state vehicle.fuel"
        )


def _check_start_height(scenario: Scenario, vehicle: Vehicle) -> None:
    """Refuse a start in the air with a contact deeper in the ground than when the vehicle stands on its legs.

    What stands deeper is thrown out of the ground by its springs.
    """
    initial = scenario.initial
    if initial.on_ground:
        return
    roll, pitch, yaw = [radians(angle) for angle in initial.attitude_deg]
    attitude = from_euler(roll, pitch, yaw)
    lowest = max([rotate(attitude, contact.position_m)[2] for contact in vehicle.contacts])
    leg_height = max(contact.position_m[2] for contact in vehicle.contacts if contact.kind == "leg")
    least = lowest - (leg_height - standing_height(vehicle))
    if initial.altitude_m < least:
        raise InputError(
            f"scenario {scenario.name}: initial.altitude_m = {initial.altitude_m:g}: {vehicle.name} would start "
            f"{lowest - initial.altitude_m:.3g} m deep in the ground; at least {least:.3g}, or initial.on_ground = true"
        )
