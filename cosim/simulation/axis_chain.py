"""How a command turns the vehicle about an axis: by which actuators, by how much, and how the rate is measured.

From the places of the jets, the moments of inertia and the allocation; the engines come in by their thrust, and by the
momentum of their rotors.
The designs' channels (:mod:`hexjet_design.loop.channel`) are made of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, exp, expm1
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.constants import GRAVITY, SERVOS
from cosim.base.protocols import Allocator
from cosim.base.signals import ZERO3, Vector3
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.engine import EngineSpec
from cosim.simulation.engine_reference import measure_small_steps
from cosim.spec.vehicle import Hinge, Servo, Surface, Vehicle
from cosim.vehicle.effects.hinges import HingeReactions
from cosim.vehicle.effects.rotors import RotorDynamics


@dataclass(frozen=True)
class AxisPart:
    """Actuators with a common lag that provide a fraction of an axis: engines, or servos and hinges.

    They act as ``fraction + lead_s (1 - 1/z) / T + reaction_s2 ((1 - 1/z) / T)^2`` times the actuators' response:
    ``lead_s`` [s] is the momentum of rotors that they turn or speed up, which acts by the rate at which it changes, and
    ``reaction_s2`` [s^2] the reaction of what the servos turn, which follows its angular acceleration.
    """

    servos: tuple[Servo | Hinge, ...]  # servos that turn the axis; (): engines
    moves: tuple[float, ...]  # travel per command; (): engines
    fraction: float
    reaction_s2: float = 0.0
    lead_s: float = 0.0

    def compute_weights(self, step: float) -> tuple[float, float, float]:
        """Return the weights of the actuators' response in this step and in the two before it."""
        lead, kick = self.lead_s / step, self.reaction_s2 / (step * step)
        return (self.fraction + lead + kick, -lead - 2.0 * kick, kick)


class AxisFractions(NamedTuple):
    """Fractions of a small angular acceleration about an axis by actuator, with sum 1, and the actuators' moves.

    ``thrusts`` and ``servos``: the share of each jet's thrust, and of each hinge and surface or of each bank's servo.
    ``moves``: by how much each thrust [N] and then each servo [rad] moves per rad/s^2; () for banks, whose rotors act
    about no axis that they turn.
    """

    thrusts: list[float]
    servos: list[float]
    moves: list[float]


def compute_axis_fractions(vehicle: Vehicle, allocator: Allocator, index: int) -> AxisFractions:
    """Return the fraction of each actuator in hover about an axis; zeros if nothing turns it.

    ``index``: 0 roll, 1 pitch, 2 yaw; ``allocator``: the one that it is flown with.
    """
    jets = len(vehicle.jets)
    if isinstance(allocator, EffectivenessAllocator):
        moves, effects = allocator.unit_changes(index)
        shares = [move * effect for move, effect in zip(moves, effects, strict=True)]
        return AxisFractions(shares[:jets], shares[jets:], moves)
    if not is_turned_by_throttle(vehicle, index):
        return AxisFractions([0.0] * jets, [1.0 / len(SERVOS)] * len(SERVOS), [])
    arms = levers(vehicle, index)
    total = sum(abs(arm) for arm in arms)
    if not total:
        return AxisFractions([0.0] * jets, [0.0] * len(list_servos(vehicle)), [])
    moves = [] if vehicle.servo else thrust_per_acceleration(vehicle, index)
    return AxisFractions([abs(arm) / total for arm in arms], [0.0] * len(list_servos(vehicle)), moves)


def thrust_per_acceleration(vehicle: Vehicle, index: int) -> list[float]:
    """Return what each jet adds in thrust per rad/s^2 about an axis [N s^2/rad], all by the same amount."""
    arms = levers(vehicle, index)
    per_newton = vehicle.inertia_kg_m2[index] / sum(abs(arm) for arm in arms)
    return [per_newton * ((arm > 0.0) - (arm < 0.0)) for arm in arms]


def thrust_momentum_lead(vehicle: Vehicle, engine: EngineSpec, index: int, step: float) -> float:
    """Return the lead by rotor momentum about an axis that thrusts alone turn, in control steps; 0 with banks."""
    jets = len(vehicle.jets)
    if vehicle.servo is not None or not any(levers(vehicle, index)):
        return 0.0
    hover = [vehicle.mass_kg * GRAVITY / jets] * jets
    return rotor_momentum_lead(vehicle, [engine] * jets, hover, thrust_per_acceleration(vehicle, index), step)[index]


def list_servos(vehicle: Vehicle) -> list[Servo | Hinge | Surface]:
    """Return the servos of a vehicle in the order of :class:`AxisFractions`."""
    if vehicle.servo is not None:
        return [vehicle.servo] * len(SERVOS)
    return [*vehicle.hinges, *vehicle.surfaces]


def levers(vehicle: Vehicle, index: int) -> list[float]:
    """Return the moment about an axis [N m] per newton of each upright jet's thrust: of its lever or its reaction."""
    return [(-jet.position_m[1], jet.position_m[0], jet.reaction_m)[index] for jet in vehicle.jets]


def axis_gain(vehicle: Vehicle, index: int, span_n: float) -> float:
    """Return the angular acceleration at rest [rad/s^2] of one unit of the command of an axis, 0 roll to 2 yaw.

    It is per share of the thrust where throttles turn the axis, per rad where banks do, and 1 with the allocation
    ``effectiveness``, whose command is the acceleration itself.  ``span_n``: thrust [N] that a command of 1 adds to one
    engine at rest.
    """
    if vehicle.allocation == "effectiveness":
        return 1.0
    return axis_moment(vehicle, index, span_n) / vehicle.inertia_kg_m2[index]


def axis_moment(vehicle: Vehicle, index: int, span_n: float) -> float:
    """Return the moment at rest [N m] of one unit of an axis' command, of banks and rotors; see :func:`axis_gain`."""
    jets = vehicle.jets
    if is_turned_by_throttle(vehicle, index):
        return sum(abs(lever) for lever in levers(vehicle, index)) * span_n
    thrust = vehicle.mass_kg * GRAVITY / len(jets)  # N, hover thrust of each jet
    return abs(sum(jet.position_m[2] if index == 1 else abs(jet.position_m[1]) for jet in jets)) * thrust


def is_turned_by_throttle(vehicle: Vehicle, index: int) -> bool:
    """Return whether throttles turn the axis of a vehicle with banks or rotors, and not the banks' servos."""
    return index == 0 or vehicle.servo is None


def bank_reaction(vehicle: Vehicle, index: int, moment: float, step: float) -> float:
    """Return the reaction of turning both banks, ``2 J / (moment step^2)``, in pitch; in yaw it cancels.

    ``moment``: of the axis, N m per rad.  Below the centre of gravity thrust and reaction agree, above they do not.
    """
    if index != 1 or vehicle.servo is None:
        return 0.0
    height = sum(jet.position_m[2] for jet in vehicle.jets)
    return float(copysign(2.0 * vehicle.servo.bank_inertia_kg_m2 / (moment * step * step), height))


def list_hinged_parts(
    vehicle: Vehicle, allocator: EffectivenessAllocator, index: int, engine: EngineSpec, step: float
) -> list[AxisPart]:
    """Return the parts of an ``effectiveness`` axis in hover: engines, then hinges by lag.

    Surfaces do nothing in hover.  ``engine``: at every station; ``step``: control step, s.
    """
    moves, effects = allocator.unit_changes(index)
    jets = len(vehicle.jets)
    kicks = compute_hinge_reactions(vehicle, step)[:, index]
    engines, thrusts = [engine] * jets, allocator.solve_hover(ZERO3)[0][:jets]

    def make_part(movers: Sequence[int], servos: tuple[Hinge, ...]) -> AxisPart:
        own = [move if k in movers else 0.0 for k, move in enumerate(moves)]
        return AxisPart(
            servos,
            tuple([moves[k] for k in movers]) if servos else (),
            sum([moves[k] * effects[k] for k in movers]),
            sum([moves[k] * kicks[k - jets] for k in movers]) if servos else 0.0,
            step * rotor_momentum_lead(vehicle, engines, thrusts, own, step)[index],
        )

    parts = [make_part(range(jets), ())]
    for lag in dict.fromkeys(hinge.lag_s for hinge in vehicle.hinges):
        with_lag = [k for k, hinge in enumerate(vehicle.hinges) if hinge.lag_s == lag]
        parts.append(make_part([jets + k for k in with_lag], tuple([vehicle.hinges[k] for k in with_lag])))
    return parts


def rotor_momentum_lead(
    vehicle: Vehicle, engines: Sequence[EngineSpec], thrusts: Sequence[float], moves: Sequence[float], step: float
) -> Vector3:
    """Return the lead by rotor momentum about each axis, in control steps: a command's change turns the rotors at once.

    About x, y and z of the body, rad/s^2 per rad/s^2 of change, so in control steps; 0 where no rotor's inertia is
    stated.  ``engines`` and ``thrusts`` [N, in hover]: at each station; ``moves``: of each thrust [N], then each hinge
    [rad], per rad/s^2 of command; ``step`` [s].
    """
    rotors = RotorDynamics(vehicle.jets, engines, step, vehicle.hinges)
    if not rotors.is_active or not any(moves):
        return ZERO3
    around = [
        measure_small_steps(
            engine, float(np.interp(thrust, engine.rising_curve.thrust, engine.rising_curve.throttle)), step
        )
        if engine.rotor_inertia
        else None
        for engine, thrust in zip(engines, thrusts, strict=True)
    ]
    speeds = [0.0 if around_one is None else around_one.speed for around_one in around]
    speed_per_newton = [0.0 if around_one is None else around_one.speed_per_n for around_one in around]
    change = 1e-6  # difference of command, rad/s^2
    small = [change * move for move in moves]
    rotors.reset(tuple(speeds))
    faster = tuple([speed + slope * move for speed, slope, move in zip(speeds, speed_per_newton, small, strict=False)])
    rest = [hinge.rest_rad for hinge in vehicle.hinges]
    tilt = tuple([angle + move for angle, move in zip(rest, small[len(engines) :], strict=False)]) or (0.0, 0.0)
    x, y, z = np.linalg.solve(np.array(vehicle.tensor), np.array(rotors.update(faster, tilt)))
    return (float(x) / change, float(y) / change, float(z) / change)


def compute_hinge_reactions(vehicle: Vehicle, step: float) -> Array:
    """Return each hinge's reaction, one row per hinge: angular acceleration of the body per rad/s^2 of the hinge."""
    reactions = HingeReactions(vehicle.hinges, vehicle.jets, step)
    small, rows = 1e-6, []
    for number in range(len(vehicle.hinges)):
        reactions.reset()
        angles = [hinge.rest_rad + small * (k == number) for k, hinge in enumerate(vehicle.hinges)]
        push, moment = reactions.reaction(tuple(angles), ZERO3)
        total = np.array(moment) + np.cross(vehicle.jets[0].position_m, push)
        rows.append(np.linalg.solve(np.array(vehicle.tensor), total) / (small / step**2))
    return np.array(rows).reshape(-1, 3)


def discretise_rate(
    damping_1_s: float, step: float, substeps: int, shape: Sequence[float] = (1.0, 0.0, 0.0)
) -> tuple[tuple[float, ...], float]:
    """Return the discrete response of the rate to a moment over JSBSim's runs: weights of steps, and the pole.

    ``rate_k+1 = p rate_k + step f (share_0 moment_k + share_1 moment_k-1 + share_2 moment_k-2 ...)``.  A run moves the
    rate by ``h (3 a_n - a_n-1) / 2`` with the accelerations at its beginning and one run before (Adams and
    Bashforth); those of a step's moment begin with the second run, the first of them with half its change on top
    (:mod:`cosim.vehicle.airframe`).  Summed over three and more runs this is the moment's impulse over the step
    and nothing else; two runs leave a quarter of a change to the step after, and one has no run to correct.
    ``shape``: shares of the actuators' answers, of this step and of those before, that make the moment.
    """
    fall = damping_1_s * step
    pole = exp(-fall)
    mean = -expm1(-fall) / fall if fall else 1.0
    runs = {1: (0.0, 1.5, -0.5), 2: (1.125, -0.25, 0.125)}.get(substeps)
    shares = shape if runs is None else np.convolve(runs, np.trim_zeros(shape, "b")).tolist()
    return tuple([mean * share for share in shares]), pole


def rate_response(z: Complex, shares: Sequence[float], pole: float) -> Complex:
    """Return the response at ``z`` of the rate to a moment, per step and inertia, from :func:`discretise_rate`."""
    now, before, *earlier = shares
    moment = now * z + before
    for k, share in enumerate(earlier, 1):
        moment = moment + share / z**k
    return np.asarray(moment / (z - pole))


def filter_pole(filter_s: float, step: float) -> float:
    """Return the pole in z of a first-order low-pass with time constant ``filter_s``; 0 without one."""
    return exp(-step / filter_s) if filter_s > 0.0 else 0.0


def measurement_response(z: Complex, pole: float, latency: int, hold: int = 1) -> Complex:
    """Return the response at ``z`` of the measured rate to the rate: low-pass, latency, and a held measurement."""
    hold_response = (1.0 - z**-hold) / (hold * (1.0 - 1.0 / z)) if hold > 1 else 1.0
    return np.asarray((1.0 - pole) * z / (z - pole) * z**-latency * hold_response)
