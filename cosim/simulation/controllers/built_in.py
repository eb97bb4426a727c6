"""The built-in cascade, made for a vehicle and its engines."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.allocation.hinged_recovery import HingedRecovery
from cosim.control.allocation.reallocation import load_solver
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.cascade import Cascade
from cosim.control.lead import Lead
from cosim.control.phases.hinged import HingedLean, SurfaceHover
from cosim.control.phases.law import FlightLaw, Loops
from cosim.control.phases.recovery import Recovery
from cosim.control.phases.reduced_attitude import ReducedAttitude
from cosim.control.phases.shut_opposite import ShutOpposite
from cosim.control.phases.spun import SpunFlight
from cosim.control.phases.wing import WingFlight, WingTable
from cosim.control.rate import RateController
from cosim.control.schedule import GainSchedule
from cosim.engine import EngineSpec
from cosim.simulation.controllers.allocators import make_allocator, query_model
from cosim.simulation.controllers.external_controller import ExternalController
from cosim.simulation.controllers.models import make_predictors, make_thrust_map
from cosim.simulation.engine_reference import make_engine_reference
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import EngineLead, Vehicle, WingControl


def make_cascade(
    scenario: Scenario,
    vehicle: Vehicle,
    engine: EngineSpec,
    stations: Sequence[EngineSpec],
    plugged: ExternalController | None,
) -> Cascade:
    """Return the built-in cascade; ``plugged`` has a user's loops.  Raises InputError if engines cannot hover."""
    step = scenario.step_s
    gains = vehicle.control
    thrust_map, hover = make_thrust_map(vehicle, engine, stations)
    by_effectiveness = vehicle.allocation == "effectiveness"
    if not by_effectiveness and not gains.allocation.throttle_min < hover < gains.allocation.throttle_max:
        raise InputError(
            f"engine {engine.name}: {vehicle.name} ({vehicle.mass_kg:g} kg) would hover at throttle {hover:.2f}, "
            f"outside {gains.allocation.throttle_min:g} to {gains.allocation.throttle_max:g}"
        )
    _check_lift(vehicle, stations)
    catch = _make_recovery(scenario, vehicle, stations, thrust_map) if plugged is None else None
    loops = Loops(
        AttitudeController(gains.attitude),
        RateController(
            (gains.rate.roll, gains.rate.pitch, gains.rate.yaw),
            make_predictors(scenario, vehicle, engine) if plugged is None else plugged.make_predictors(),
            step,
            [_make_lead(vehicle, axis, step) for axis in AXES],
        ),
        AltitudeController(
            gains.altitude, vehicle.mass_kg, thrust_map.collective, step, _make_lead(vehicle, "altitude", step)
        ),
        make_allocator(scenario, vehicle, stations, thrust_map, hover, catch),
        scenario.added_delay_samples,
        plugged.attitude if plugged else None,
        plugged.rate if plugged else None,
    )
    return Cascade(
        loops,
        thrust_map,
        _make_monitor(scenario, vehicle, stations) if scenario.monitored else None,
        GainSchedule(gains.schedule, gains.lead, step) if gains.schedule else None,
        [
            *_engine_loss_laws(
                loops,
                vehicle,
                thrust_map,
                _make_reduced_attitude(scenario, vehicle, stations, thrust_map) if plugged is None else None,
                catch,
            ),
            *_effectiveness_laws(scenario, vehicle, loops),
            FlightLaw(loops),
        ],
        vehicle,
        step,
    )


def _engine_loss_laws(
    loops: Loops, vehicle: Vehicle, thrust_map: ThrustMap, reduced: ReducedAttitude | None, catch: Recovery | None
) -> list[FlightLaw]:
    """Return the flight laws for an engine loss, of a vehicle whose allocation does not handle it."""
    monitor = vehicle.control.monitor
    opposite = find_opposite_jets(vehicle) if monitor is not None and monitor.shut_opposite else ()
    if reduced is not None:
        return [SpunFlight(loops, reduced, thrust_map, len(vehicle.jets))]
    return [ShutOpposite(loops, opposite, catch, vehicle.mass_kg)] if opposite else []


def _effectiveness_laws(scenario: Scenario, vehicle: Vehicle, loops: Loops) -> list[FlightLaw]:
    """Return the flight laws for wings, hinges and surfaces of a vehicle that is allocated by effectiveness."""
    allocator = loops.allocator
    if not isinstance(allocator, EffectivenessAllocator):
        return []
    laws: list[FlightLaw] = []
    settings = vehicle.control.wing
    wing = None if settings is None else _make_wing_law(scenario, vehicle, settings, loops, allocator)
    if isinstance(allocator, HingedRecovery):
        laws.append(HingedLean(loops, allocator, wing))
    if wing is not None:
        laws.append(wing)
    if allocator.surfaces:
        laws.append(SurfaceHover(loops, allocator))
    return laws


def _make_wing_law(
    scenario: Scenario,
    vehicle: Vehicle,
    settings: WingControl,
    loops: Loops,
    allocator: EffectivenessAllocator,
    rows: int = 16,
    at_m_s: float = 20.0,
) -> WingFlight:
    """Return the wing flight law, with the wing's coefficients measured in the vehicle's JSBSim model."""
    least, most = settings.alpha_rad
    alphas = [least + (most - least) * row / rows for row in range(rows + 1)]
    lift, drag, moment = query_model("wing", scenario, vehicle, lambda frame: frame.wing_effects(alphas, at_m_s))
    names = [hinge.name for hinge in vehicle.hinges]
    tilts = [names.index(name) for name in settings.tilts]
    table = WingTable(tuple(alphas), tuple(lift), tuple(drag), tuple(moment))
    control = vehicle.control
    attitude_lag = 1.0 / control.attitude.gain_1_s[1] + 1.0 / control.rate.pitch.p  # s, of attitude and rate loop
    return WingFlight(loops, allocator, settings, table, tilts, vehicle.mass_kg, scenario.step_s, attitude_lag)


def _make_reduced_attitude(
    scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec], thrust_map: ThrustMap
) -> ReducedAttitude | None:
    """Return the controller after a rotor loss, if rotors do not tilt and the vehicle states a recovery; else None."""
    monitor = vehicle.control.monitor
    if vehicle.allocation != "rotors" or not scenario.monitored or monitor is None or not monitor.catch:
        return None
    references = [make_engine_reference(spec, scenario.step_s) for spec in stations]
    lag, delay = max(reference.lag for reference in references), max(reference.delay for reference in references)
    added = scenario.added_delay_samples
    return ReducedAttitude(vehicle, find_opposite_jets(vehicle), thrust_map, lag, delay, scenario.step_s, added)


def _make_recovery(
    scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec], thrust_map: ThrustMap
) -> Recovery | None:
    """Return the recovery that shuts off the jet opposite a lost one, if the vehicle flies with its own engine.

    With that one its constants were chosen; slower ones stay longer at their limits, which it does not know.
    """
    monitor, lead = vehicle.control.monitor, getattr(vehicle.control.lead, "roll", None)
    is_nominal = scenario.engine == vehicle.engine and all(spec.name == vehicle.engine for spec in stations)
    if (
        vehicle.allocation != "banks"
        or not is_nominal
        or not scenario.monitored
        or monitor is None
        or not (monitor.shut_opposite and monitor.catch)
    ):
        return None
    if not isinstance(lead, EngineLead) or lead.damping is None:
        return None
    delay = max(make_engine_reference(spec, scenario.step_s).delay for spec in stations)
    return Recovery(vehicle, thrust_map, lead, delay, scenario.step_s)


def find_opposite_jets(vehicle: Vehicle) -> tuple[int, ...]:
    """Return the index of the jet opposite each jet, from 0.  Raises InputError if one has none."""
    places = [jet.position_m for jet in vehicle.jets]
    opposite_jets = []
    for number, (x, y, _) in enumerate(places, 1):
        candidates = [i for i, (a, b, _) in enumerate(places) if hypot(a + x, b + y) < 1e-3 * hypot(x, y)]
        if len(candidates) != 1:
            raise InputError(f"{vehicle.name}: control.monitor.shut_opposite: no jet stands opposite jet {number}")
        opposite_jets.append(candidates[0])
    return tuple(opposite_jets)


def _make_lead(vehicle: Vehicle, command: str, step: float) -> Lead | None:
    settings = getattr(vehicle.control.lead, command, None)
    return Lead(settings, step) if settings else None


def _check_lift(vehicle: Vehicle, stations: Sequence[EngineSpec]) -> None:
    """Refuse engines at the stations that cannot lift the vehicle together."""
    weight, most = vehicle.mass_kg * GRAVITY, sum(station.curve.thrust[-1] for station in stations)
    if most <= weight:
        raise InputError(
            f"stations: the engines give at most {most:.1f} N together; {vehicle.name} ({vehicle.mass_kg:g} kg) "
            f"weighs {weight:.1f} N"
        )


def _make_monitor(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> EngineMonitor:
    settings, limits = vehicle.control.monitor, vehicle.control.allocation
    if settings is None:
        raise InputError(
            f"scenario {scenario.name}: {vehicle.name} has no [control.monitor] to watch its engines with; "
            "state it, or set monitor = false"
        )
    load_solver()
    references = {
        key: make_engine_reference(spec, scenario.step_s) for key, spec in {id(s): s for s in stations}.items()
    }
    return EngineMonitor(
        settings,
        [references[id(spec)] for spec in stations],
        vehicle.mass_kg * GRAVITY / len(stations),
        (limits.throttle_min, limits.throttle_max),
        scenario.step_s,
        settings.catch,
    )
