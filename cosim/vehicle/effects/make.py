"""Which effects a vehicle has."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.engine import EngineSpec
from cosim.engine.fmu.port_kinds import SIDE_LOADS
from cosim.spec.vehicle import Vehicle, layout_of
from cosim.vehicle.effects.banks import Banks
from cosim.vehicle.effects.effect import Effect
from cosim.vehicle.effects.ground_effect import LiftLoss
from cosim.vehicle.effects.hinges import HingeReactions
from cosim.vehicle.effects.intakes import IntakeDrag
from cosim.vehicle.effects.jets import CarriedJets, EngineSideForces, EngineTorques, JetReactions
from cosim.vehicle.effects.rotors import RotorDynamics


def make_effects(vehicle: Vehicle, flown: Vehicle, engines: Sequence[EngineSpec], step: float) -> list[Effect]:
    """Return the effects of a vehicle besides thrust, in order of evaluation.

    ``flown``: the vehicle whose stations fly; ``engines``: the one at each station.  An engine that gives a torque has
    no other reaction: ``reaction_m`` of its jet does not act.  The ground's suction is of the thrust alone, and sums
    of floating-point numbers depend on their order: it is part of what flights with the same bits rest on.
    Raises InputError for an engine whose rotor has inertia and no speed.
    """
    jets, hinges = flown.jets, flown.hinges
    layout = layout_of(jets, hinges)
    ports_aside = [{port for port in SIDE_LOADS if engine.has_port(port)} for engine in engines]
    reactions = [0.0 if "torque" in ports else jet.reaction_m for jet, ports in zip(jets, ports_aside, strict=True)]
    rotors, intakes = RotorDynamics(jets, engines, step, hinges), IntakeDrag(vehicle.airflow, jets, hinges)
    hinged, effect = HingeReactions(hinges, jets, step), vehicle.ground_effect
    ground = LiftLoss(effect, jets) if effect and effect.suckdown else None
    banks = Banks(vehicle.servo, jets, step) if vehicle.servo else None
    effects: list[tuple[bool, Effect | None]] = [
        (any(reactions), JetReactions(layout, reactions)),
        (rotors.is_active, rotors),
        (any("torque" in ports for ports in ports_aside), EngineTorques(layout, ports_aside)),
        (ground is not None, ground),
        (any(ports_aside), EngineSideForces(layout, ports_aside)),
        (intakes.is_active, intakes),
        (banks is not None and banks.is_active, banks),
        (layout.moves, CarriedJets(layout)),
        (hinged.is_active, hinged),
    ]
    return [effect for is_present, effect in effects if is_present and effect is not None]
