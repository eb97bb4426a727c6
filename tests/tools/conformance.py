"""The built-in blocks, each where its protocol is asked for: mypy, which reads this file too, proves that they fit."""

from __future__ import annotations

from cosim.base import protocols
from cosim.campaign.workers.cluster import DaskWorkers
from cosim.campaign.workers.local import LocalWorkers
from cosim.campaign.workers.protocol import Workers
from cosim.control.allocation.allocation import RotorAllocator, TiltAllocator
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.control.autopilot.autopilot import Autopilot
from cosim.control.cascade import Cascade
from cosim.control.laws.axis import RateLaw
from cosim.control.predictors.smith import FilteredSmithPredictor, NoPredictor, SmithPredictor
from cosim.control.predictors.state import ModalPredictor, StatePredictor
from cosim.engine import EngineBank
from cosim.engine.isolated import IsolatedBank
from cosim.results import metrics
from cosim.results.autopilot.autopilot_record import PilotRecord
from cosim.results.log.recorder import Recorder
from cosim.results.run import Recording
from cosim.simulation.controllers.guard import GuardedController, GuardedPredictor
from cosim.simulation.guided_pilot import GuidedPilot
from cosim.simulation.plugins import GuardedObserver, WindTable
from cosim.vehicle.sensors import FaultySensors, SensorSuite
from hexjet_export.vehicle.ports import _ExternalController, _ExternalEngines, _SetpointPilot
from hexjet_sitl.block import AutopilotBlock

METRICS: list[protocols.Metric] = [metrics.flight_metrics]


def controller(block: Cascade | GuardedController | _ExternalController) -> protocols.Controller:
    return block


def predictor(
    block: GuardedPredictor | NoPredictor | SmithPredictor | FilteredSmithPredictor | StatePredictor | ModalPredictor,
) -> protocols.Predictor:
    return block


def allocator(block: TiltAllocator | RotorAllocator | EffectivenessAllocator) -> protocols.Allocator:
    return block


def engines(block: EngineBank | IsolatedBank | _ExternalEngines) -> protocols.Engines:
    return block


def sensors(block: SensorSuite | FaultySensors) -> protocols.Sensors:
    return block


def pilot(block: GuidedPilot | Autopilot | _SetpointPilot) -> protocols.Pilot:
    return block


def observer(block: Recorder | Recording | PilotRecord | GuardedObserver) -> protocols.Observer:
    return block


def workers(block: LocalWorkers | DaskWorkers) -> Workers:
    return block


def rate_loop(block: RateLaw) -> protocols.RateLoop:
    return block


def whole_controller(block: AutopilotBlock) -> protocols.WholeController:
    return block


def wind(block: WindTable) -> protocols.Wind:
    return block
