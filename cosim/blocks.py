"""The blocks of a flight, for a tool that writes them in another form or puts one of its own in their place.

What a block computes with is an attribute of it; ``build`` wires those of a scenario.
"""

from cosim.control.allocation.allocation import MIN_HOVER_FRACTION, RotorAllocator, TiltAllocator
from cosim.control.allocation.effectiveness import MAX_FIRST, MAX_ITERATIONS, EffectivenessAllocator
from cosim.control.allocation.reallocation import command_to_torque
from cosim.control.allocation.thrust_map import Inverse, ThrustMap
from cosim.control.altitude import MIN_UPRIGHT
from cosim.control.cascade import Cascade
from cosim.control.laws.axis import RateLaw
from cosim.control.lead import Lead
from cosim.control.predictors.registry import PREDICTORS
from cosim.control.predictors.smith import DelayLine, DiscreteModel, FilteredSmithPredictor, NoPredictor, SmithPredictor
from cosim.control.predictors.state import (
    DoubleIntegratorObserver,
    LinearPredictor,
    ModalPredictor,
    ModelObserver,
    StatePredictor,
)
from cosim.control.schedule import SCHEDULE_RESOLUTION
from cosim.engine import Air, EngineSpec
from cosim.engine.fmu.port_kinds import AMBIENT, OUTPUTS
from cosim.engine.fmu.variables import REALS, Port
from cosim.simulation.build import build
from cosim.simulation.script.command_script import CommandScript
from cosim.simulation.step import Simulation
from cosim.vehicle.propulsion import Propulsion
