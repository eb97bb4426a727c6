"""The built-in blocks, each where its protocol is asked for: mypy, which reads this file too, proves that they fit."""

from __future__ import annotations

from cosim import metrics, protocols
from cosim.campaign.cluster import DaskWorkers
from cosim.campaign.local import LocalWorkers
from cosim.campaign.one import Row
from cosim.campaign.plan import Flight
from cosim.campaign.study import Study
from cosim.control.allocation import RotorAllocator, TiltAllocator
from cosim.control.cascade import Cascade
from cosim.control.predictor import FilteredSmithPredictor, NoPredictor, SmithPredictor
from cosim.control.state_predictor import ModalPredictor, StatePredictor
from cosim.disturbances import Disturber
from cosim.engine import EngineBank
from cosim.pilot.autopilot import Autopilot
from cosim.placed import PlacePilot
from cosim.recorder import Recorder
from cosim.run import Recording
from cosim.sensors import FaultySensors, SensorSuite

METRICS: list[protocols.Metric] = [metrics.flight_metrics]


def controller(block: Cascade) -> protocols.Controller:
    return block


def predictor(
    block: NoPredictor | SmithPredictor | FilteredSmithPredictor | StatePredictor | ModalPredictor,
) -> protocols.Predictor:
    return block


def allocator(block: TiltAllocator | RotorAllocator) -> protocols.Allocator:
    return block


def engines(block: EngineBank) -> protocols.Engines:
    return block


def sensors(block: SensorSuite | FaultySensors) -> protocols.Sensors:
    return block


def disturbances(block: Disturber) -> protocols.Disturbances:
    return block


def pilot(block: PlacePilot | Autopilot) -> protocols.Pilot:
    return block


def observer(block: Recorder | Recording) -> protocols.Observer:
    return block


def workers(block: LocalWorkers | DaskWorkers) -> protocols.Workers[Study, Flight, Row]:
    return block
