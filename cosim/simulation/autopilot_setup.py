"""A flight that an autopilot flies: the one place where the two are joined."""

from __future__ import annotations

from typing import Any, get_args

from cosim.base.errors import InputError
from cosim.base.protocols import EngineState, Predictor
from cosim.base.storage.toml import validate
from cosim.control.autopilot.autopilot import Autopilot
from cosim.control.autopilot.flight_state import FaultCommands, Thrust
from cosim.control.autopilot.requests import InjectFault
from cosim.control.autopilot.tuning import ControlLoops
from cosim.simulation.controllers.models import make_predictors
from cosim.simulation.engine_reference import make_engine_reference, measure_fuel_flow
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Fault
from cosim.spec.vehicle import PredictorTuning

_FAULT_CLASSES = {get_args(kind.model_fields["kind"].annotation)[0]: kind for kind in get_args(Fault)}  # by kind


def attach_autopilot(simulation: Simulation, airborne: bool = False) -> Autopilot:
    """Replace the scenario's commands by an autopilot that flies as ground stations request, and return it.

    ``airborne``: the flight begins in the air, armed and holding.
    What tunes the loops that a controller from outside takes the place of cannot be changed in flight.
    Raises InputError where the vehicle does not state [control.position] and [control.pilot], and where a block of a
    program flies in place of the controller.
    """
    scenario, vehicle, engine = simulation.scenario, simulation.vehicle, simulation.engine
    cascade, source = simulation.replaced_cascade or simulation.cascade, simulation.controller_source
    roll = engine.models_in(vehicle.identified).get("roll")
    delay = None if roll is None else roll.delay_samples + scenario.added_delay_samples

    def make_tuned_predictors(controller: str, samples: float, tuning: PredictorTuning) -> list[Predictor]:
        models = dict(engine.models_in(vehicle.identified))
        if "roll" in models:
            models["roll"] = models["roll"].model_copy(update={"delay_samples": samples})
        control = vehicle.control.model_copy(update={"predictor": tuning})
        tuned_vehicle = vehicle.model_copy(
            update={"control": control, "identified": {**vehicle.identified, engine.family: models}}
        )
        # The controller's own added delay is in `samples` already.
        flown = scenario.model_copy(update={"controller": controller, "added_delay_samples": 0})
        return make_predictors(flown, tuned_vehicle, engine)

    references = [make_engine_reference(spec, scenario.step_s) for spec in simulation.stations]
    pilot = Autopilot(
        vehicle,
        scenario.step_s,
        Thrust(
            cascade.allocator.hover,
            cascade.thrust_map.idle,
            (
                max(reference.delay + reference.lag for reference in references),
                max(reference.delay + reference.longest for reference in references),
            ),
        ),
        ControlLoops(
            cascade.attitude,
            cascade.altitude,
            cascade.rate,
            make_tuned_predictors,
            scenario.controller if source is None else source.predictor if source.level == "attitude" else source.label,
            delay,
            "" if source is None else source.level,
        ),
        FaultCommands(lambda request: simulation.inject(make_fault(request)), simulation.clear_faults),
        EngineState.FLY if airborne else EngineState(scenario.initial.engines),
        scenario.sensor_noise,
    )
    pilot.energy.hover_burn = _hover_burn_rate(simulation)
    pilot.reset(simulation.measured)
    simulation.pilot = pilot
    return pilot


def _hover_burn_rate(simulation: Simulation) -> float | None:
    """Return the fraction of a full tank used per second of hover; None: unknown or no tank."""
    tank, cascade = simulation.propulsion.tank, simulation.replaced_cascade or simulation.cascade
    if tank is None:
        return None
    allocator = cascade.allocator
    throttles = cascade.thrust_map.throttle(allocator.trim(allocator.hover))
    step = simulation.scenario.step_s
    flows = [
        measure_fuel_flow(spec, throttle, step) for spec, throttle in zip(simulation.stations, throttles, strict=True)
    ]
    return None if any(flow is None for flow in flows) else sum(flow or 0.0 for flow in flows) / tank.mass


def make_fault(request: InjectFault) -> Fault:
    """Return the scenario's fault for a request.  Raises InputError for an unknown one."""
    kind = _FAULT_CLASSES.get(request.fault)
    if kind is None:
        raise InputError(f"fault {request.fault!r}: must be one of {', '.join(sorted(_FAULT_CLASSES))}")
    table: dict[str, Any] = {"kind": request.fault, "start_s": 0.0}
    if request.jets:
        table["jet"] = list(request.jets)
    for key in ("servo", "sensor", "duration_s"):
        if getattr(request, key) is not None:
            table[key] = getattr(request, key)
    if request.amount is not None:
        if not kind.amount:
            raise InputError(f"fault {request.fault}: it has no amount")
        table[kind.amount] = [request.amount] if kind.amount == "bias" else request.amount
    if request.vector is not None:
        table["bias"] = list(request.vector)
    fault: Fault = validate(kind, table, f"fault {request.fault}")
    return fault
