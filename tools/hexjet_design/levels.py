"""The design while fuel burns: the channel at less thrust, what the gains of a full tank make of it, and a schedule.

At less thrust an engine answers more slowly, and there is less room below the thrust of hover.  Where the gains of a
full tank no longer keep the requirements, each level of fuel gets its own, searched from those of the level above; in
flight :mod:`cosim.control.schedule` goes from one to the next with the collective.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from cosim.control.schedule import Factors, GainSchedule
from cosim.engine import EngineSpec
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import EngineLead, Leads, Schedule, ScheduledGains, ThrustLevel, Vehicle
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels, combine_poles, hover_fraction
from hexjet_design.loop.criteria import fine_loop, is_acceptable
from hexjet_design.loop.tuning import Tuning, round_gain
from hexjet_design.tune import tune_near

DESIGN_FUELS = (1.0, 0.5, 0.0)  # fuel fractions designed first
# Fuel fractions at which requirements are checked; if one is missed, that level is designed too.
PROOF_FUELS = (1.0, 0.75, 0.5, 0.25, 0.0)
# Axes that engines drive: a tilt gives the same moment at every thrust.
THRUST_AXES = ("roll", "altitude")


@dataclass(frozen=True)
class Level:
    """One fuel level: hover thrust in the engines' range, and channels."""

    fuel: float
    mass_kg: float
    thrust_fraction: float
    channels: Mapping[str, Channel]


def make_levels(
    scenario: Scenario, vehicle: Vehicle, spec: EngineSpec, dynamics: Callable[[Vehicle], Actuator]
) -> list[Level]:
    """Return the fuel levels of a proof, full tank first; ``dynamics`` returns the engine model of a vehicle.

    With less thrust in hover there is less room below it, for a step as for noise, and the requirements stay the same.
    Of an axis that hinges give they are those of a full tank: allocation turns more where there is less to turn.
    """
    designed: list[Level] = []
    for fuel in PROOF_FUELS:
        there = vehicle.with_fuel(fuel)
        level_channels = channels(scenario, there, spec, dynamics(there))
        full = designed[0].channels if designed else level_channels
        thrust_channels = {axis: full[axis] if full[axis].is_by_servo else level_channels[axis] for axis in THRUST_AXES}
        designed.append(Level(fuel, there.mass_kg, hover_fraction(there, spec), thrust_channels))
    return designed


def meets_requirements(channel: Channel, tuning: Tuning, need: Requirements) -> bool:
    return is_acceptable(fine_loop(channel, tuning), need)


def adapt_lead(lead: EngineLead | None, channel: Channel) -> EngineLead | None:
    """Return a lead of the same form that cancels the engine's poles of this channel."""
    if lead is None:
        return None
    slowest, *others = sorted(channel.actuator.dynamics.poles, key=abs)
    if lead.damping is None:
        return lead.model_copy(update={"natural_rad_s": abs(slowest)})
    natural, damping = combine_poles(slowest, others[0])
    return lead.model_copy(update={"natural_rad_s": natural, "damping": damping})


def tune_levels(
    axis: str, levels: Sequence[Level], full: Tuning, need: Requirements, begin: Mapping[float, Tuning],
    designed: Collection[float] = DESIGN_FUELS,
) -> dict[float, Tuning] | None:  # fmt: skip
    """Tune each level in ``designed`` by its fuel; return None if one cannot meet the requirements.

    ``begin``: where the search begins, for levels at which that is known.
    """
    tunings = {1.0: full}
    last = full
    for level in levels:
        if level.fuel == 1.0 or level.fuel not in designed:
            continue
        channel = level.channels[axis]
        if channel.is_by_servo:
            tunings[level.fuel] = full
            continue
        start = begin.get(level.fuel, last)
        # The derivative's filter, the predictor and its model stay those of the full tank.
        gains = start.gains.model_copy(update={"d_filter_s": full.gains.d_filter_s})
        begun = replace(full, angle_gain=start.angle_gain, gains=gains, lead=adapt_lead(start.lead, channel))
        tuned = tune_near(channel, begun, need, level=True)
        if tuned is None:
            return None
        tunings[level.fuel] = last = tuned
    return tunings


def make_schedule(levels: Sequence[Level], tunings: Mapping[str, Mapping[float, Tuning]]) -> Schedule:
    """Return the gain schedule of the tunings at each level, in the form of a vehicle's file."""
    rows = [level for level in reversed(levels) if all(level.fuel in of for of in tunings.values())]
    return Schedule(
        # Slow compared with the loops, fast compared with changes of fuel and payload.
        filter_s=2.0,
        level=[
            ThrustLevel(
                share=round_gain(level.thrust_fraction),
                **{axis: _make_gain_factors(of[level.fuel], of[1.0]) for axis, of in tunings.items()},
            )
            for level in rows
        ],
    )


def _make_gain_factors(here: Tuning, full: Tuning) -> ScheduledGains:
    lead = here.lead
    factors = {
        "angle": round_gain(here.angle_gain / full.angle_gain),
        "p": round_gain(here.gains.p / full.gains.p),
        "i": round_gain(here.gains.i / full.gains.i) if full.gains.i else 1.0,
        "d": round_gain(here.gains.d / full.gains.d) if full.gains.d else 1.0,
    }
    if lead is not None:
        factors |= {key: round_gain(value) for key, value in lead.model_dump(exclude_none=True).items()}
    return ScheduledGains.model_validate(factors)


def tunings_at(plan: Schedule, full: Mapping[str, Tuning], thrust_fraction: float, step: float) -> dict[str, Tuning]:
    """Return the scheduled tunings at a collective, which is a fraction of the range of the engines."""
    there = GainSchedule(plan, Leads(**{axis: tuning.lead for axis, tuning in full.items()}), step).at(thrust_fraction)
    return {"roll": scale_gains(full["roll"], there.roll), "altitude": scale_gains(full["altitude"], there.altitude)}


def scale_gains(full: Tuning, factors: Factors) -> Tuning:
    """Return a tuning with the gains multiplied by the schedule's factors."""
    gains = full.gains
    changed = {"p": factors.p * gains.p, "i": factors.i * gains.i, "d": factors.d * gains.d}
    return replace(
        full,
        angle_gain=factors.angle * full.angle_gain,
        gains=gains.model_copy(update=changed),
        lead=factors.lead or full.lead,
    )
