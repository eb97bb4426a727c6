"""One control step of every flight of a batch: the stages of :meth:`cosim.simulation.step.Simulation.step` over arrays.

``step(numbers, state, inputs)`` gives the next state and what was on the wires, and keeps nothing itself.  With NumPy
the rings of delayed values are written in place: a state that has been stepped is not to be used again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from hexjet_batch.numbers import Numbers, is_absent, limit
from hexjet_batch.stages.airframe import Mass, Motion, air_at, change_mass, drag_of, mass_with, move
from hexjet_batch.stages.delays import make_ring, push
from hexjet_batch.stages.engines import Air, Report
from hexjet_batch.stages.loops import (
    Allocated,
    RateState,
    allocate_banks,
    allocate_rotors,
    apply_schedule,
    start_rate,
    update_attitude,
    update_height,
    update_rate,
)
from hexjet_batch.stages.rotations import Quaternion, Vector, add, cross, rotate_back
from hexjet_batch.stages.sensors import Measured, SensorState, fade, sample, start_sensors


class Inputs(NamedTuple):
    """What acts in one step: set-points, disturbances, wind [m/s, NED] and the sensors' draws."""

    k: Any
    setpoint: Quaternion
    altitude: Any
    rate: Vector | None
    collective: Any
    force: Vector
    moment: Vector
    torque_command: Vector
    torque_output: Vector
    torque_seen: Vector
    wind: Vector
    payload: tuple[Any, Vector] | None
    draws: Any = None


class State(NamedTuple):
    """The state of all flights between two steps."""

    motion: Motion
    mass: Mass
    measured: Measured
    sensors: SensorState
    rate: tuple[RateState, ...]
    unallocated: Vector
    height: tuple[Any, Any]  # integral, lead
    added: Any
    engines: Any
    tilt: Vector | None
    tilt_rate: Vector
    spin: Vector | None
    burnt: Any
    payload: Any
    gains: Any  # level, level of the gains, the gains
    start: tuple[Any, Any]  # down [m] and height above the ground [m]


class Outputs(NamedTuple):
    """Signals of a step of all flights, as :class:`cosim.base.signals.Sample` has them of one flight.

    ``throttle`` has a row for each of ``jets.channels``, ``fuel`` [kg] is None without a tank.
    """

    motion: Motion
    rate_setpoint: Vector
    torque: Vector
    unallocated: Vector
    collective: Any
    throttle: Any
    tilt_command: Vector | None
    report: Report
    altitude: Any
    fuel: Any


def start(n: Numbers, motion: Motion, height: Any, inputs: Inputs) -> State:
    """Return flights at rest with their engines settled at the throttle that holds the vehicle up.

    Raises InputError where numbers, motion, heights or inputs are of different numbers of flights.
    """
    if len(sizes := _count_flights((n, motion, height, inputs)) - {1}) > 1:
        raise InputError(f"arrays of {', '.join(map(str, sorted(sizes)))} flights: those of a batch have one length")
    xp, zero, fuel = n.xp, 0.0 * motion.position[0], n.flown.fuel
    burnt = zero if fuel is None else (1.0 - fuel.share) * fuel.mass_kg + zero
    hover, throttle = hold_up(n, burnt)
    gains = None
    if n.schedule is not None:
        level = limit(hover, n.schedule.low, n.schedule.high, xp)
        gains = (level, level, n.schedule.at(level, xp))
    sensors, told = start_sensors(n, motion, height + zero)
    tilt = None if n.servo is None else (zero, zero)
    mass, rate = _mass_with_fuel_burnt(n, burnt, None), tuple(start_rate(own, zero, xp) for own in n.predictors)
    added, begin = make_ring(n.added_delay, zero, xp), (motion.position[2], height + zero)
    s = State(
        motion, mass, told, sensors, rate, (zero,) * 4, (zero, None), added, None, tilt, (zero, zero), None, burnt,
        None, gains, begin,
    )  # fmt: skip
    engines, report = n.engine.kind.start(n.engine, _to_engines(n, throttle), _air(n, s, inputs.wind))
    return s._replace(engines=engines, spin=_spin(n, report, tilt))


def _count_flights(value: Any) -> set[int]:
    """Return the lengths of the arrays over flights."""
    if isinstance(value, (Numbers, tuple)):
        return set().union(*map(_count_flights, vars(value).values() if isinstance(value, Numbers) else value))
    return {len(value)} if getattr(value, "ndim", 0) == 1 else set()


def hold_up(n: Numbers, burnt: Any) -> tuple[Any, Any]:
    """Return the share of thrust that holds the vehicle up, and the throttle of each channel."""
    hover = ((n.height.mass_kg - burnt) * GRAVITY / n.height.jets - n.height.low) / n.height.span
    return hover, to_throttle(n, n.xp.stack([hover] * (max(n.jets.channels) + 1)))


def step(n: Numbers, s: State, u: Inputs) -> tuple[State, Outputs]:
    """Return the state a control step later, and the signals of the step."""
    xp, fuel = n.xp, n.flown.fuel
    rates, torque, collective, given, s = _control(n, s, u)
    share, tilt_command, unallocated = given
    throttle = to_throttle(n, share)

    engines, report = n.engine.kind.step(n.engine, s.engines, u.k, _to_engines(n, throttle), _air(n, s, u.wind))
    tilt, burnt = _turn_servos(n, s.tilt, tilt_command), s.burnt
    if fuel is not None:
        burnt = xp.minimum(burnt + n.step * sum(report.fuel[row] for row in n.jets.engines), fuel.mass_kg)
    force, moment = _wrench(n, s, report, tilt, u.wind)
    spin = _spin(n, report, tilt)
    if spin is not None and s.spin is not None:
        moment = add(moment, add(s.spin, spin, -1.0), 1.0 / n.step)
    tilt_rate, reaction = _bank_reaction(n, s, tilt)
    moment = add(moment, reaction)

    mass, motion = s.mass, s.motion
    if fuel is not None or u.payload is not s.payload:
        mass = _mass_with_fuel_burnt(n, burnt, u.payload)
        motion = change_mass(motion, s.mass, mass)
    force, moment = add(force, u.force), add(moment, u.moment)
    if not is_absent(*n.flown.centre_m, *mass.centre):
        drag = drag_of(n.flown, motion.velocity, motion.attitude, u.wind)
        moment = add(
            add(moment, cross(mass.centre, force), -1.0), cross(add(n.flown.centre_m, mass.centre, -1.0), drag)
        )
    moved = move(n, mass, motion, (force, moment), spin, u.wind)

    altitude = altitude_of(s, moved)
    sensors, told = sample(n, s.sensors, u.k, moved, altitude, u.draws)
    after = s._replace(
        motion=moved, mass=mass, measured=told, sensors=sensors, engines=engines, tilt=tilt, tilt_rate=tilt_rate,
        spin=spin, burnt=burnt, payload=u.payload,
    )  # fmt: skip
    left = None if fuel is None else fuel.mass_kg - s.burnt
    at = altitude_of(s)
    return after, Outputs(s.motion, rates, torque, unallocated, collective, throttle, tilt_command, report, at, left)


def _control(n: Numbers, s: State, u: Inputs) -> tuple[Vector, Vector, Any, Allocated, State]:
    """Return rates, torque and collective asked for, what allocation gives, and the state of the controller after."""
    xp, measured, attitude, roll, height = n.xp, s.measured, n.attitude, n.rate[0], n.height
    if n.schedule is not None:
        attitude, roll, height = apply_schedule(s.gains[2], attitude, roll, height)
    rates = u.rate
    if rates is None:
        rates = update_attitude(attitude, u.setpoint, measured.attitude, xp)
    axes = tuple(
        update_rate(axis, n.predictors[i], s.rate[i], u.k, rates[i], measured.rate[i], s.unallocated[i], xp)
        for i, axis in enumerate((roll, *n.rate[1:]))
    )
    torque = tuple(state.command for state in axes)
    collective, held = u.collective, (s.height[0], None)
    if collective is None:
        collective, held = update_height(height, s.height, u.altitude, measured, s.unallocated[3], s.burnt, xp)
    if not is_absent(*u.torque_seen):
        axes = tuple(state._replace(command=state.command + u.torque_seen[i]) for i, state in enumerate(axes))
    asked = add(torque, u.torque_output)
    added, late = push(s.added, u.k, n.added_delay, asked[0], xp)
    allocate = allocate_banks if n.allocation.method == "banks" else allocate_rotors
    given = allocate(n.allocation, collective, add((late, *asked[1:]), u.torque_command), xp)
    gains = None if n.schedule is None else n.schedule.update(s.gains, collective - given[2][3], xp)
    after = s._replace(rate=axes, height=held, added=added, gains=gains, unallocated=given[2])
    return rates, torque, collective, given, after


def altitude_of(s: State, motion: Motion | None = None) -> Any:
    """Return the height of a state above the ground [m]; ``motion``: one that came after it."""
    return s.start[1] - ((motion or s.motion).position[2] - s.start[0])


def to_throttle(n: Numbers, share: Any) -> Any:
    """Return the throttle of each channel: the engine's static curve inverted, linear between its points."""
    xp, curve = n.xp, n.thrust
    if curve.throttles is None:
        return share
    thrust = n.height.low + share * n.height.span
    value = curve.throttles[0] + 0.0 * thrust
    last = len(curve.thrusts) - 2
    for i, (x, y) in enumerate(zip(curve.thrusts, curve.thrusts[1:], strict=False)):
        slope = (curve.throttles[i + 1] - curve.throttles[i]) / (y - x)
        inside = xp.maximum(thrust - x, 0.0) if i else thrust - x
        value = value + slope * (inside if i == last else xp.minimum(inside, y - x))
    return limit(value, 0.0, 1.0, xp)


def _to_engines(n: Numbers, rows: Any) -> Any:
    """Return rows of the channels as rows of the engines, of which there is one a jet where they differ."""
    return rows if n.jets.engines == n.jets.channels else n.xp.stack([rows[channel] for channel in n.jets.channels])


def _turn_servos(n: Numbers, tilt: Vector | None, command: Vector | None) -> Vector | None:
    if tilt is None or command is None:
        return None
    xp, servo = n.xp, n.servo
    gain, most, end = fade(n.step, servo.lag_s, xp), servo.rate_limit_rad_s * n.step, servo.range_rad
    pairs = zip(tilt, command, strict=True)
    return tuple(angle + limit(gain * (limit(goal, -end, end, xp) - angle), -most, most, xp) for angle, goal in pairs)


def _axes(tilt: Vector | None, xp: Any) -> list[tuple[Any, Any]]:
    """Return where the jets of each bank point, or all where none tilts: ahead and down [unit, body]."""
    return [(0.0, -1.0)] if tilt is None else [(xp.sin(angle), -xp.cos(angle)) for angle in tilt]


def _air(n: Numbers, s: State, wind: Vector) -> Air:
    """Return the air at the engines: where the vehicle is, and how fast it goes into each intake along its jet."""
    if not n.needs_air:
        return Air(0.0, 0.0, 0.0)
    body = rotate_back(s.motion.attitude, add(s.motion.velocity, wind, -1.0))
    axes = [(x, 0.0, z) for x, z in _axes(s.tilt, n.xp)]
    turning = [cross(axis, s.motion.rate) for axis in axes]
    speeds = [
        _scalar_product(body, axes[bank]) + _scalar_product(place, turning[bank])
        for place, bank in zip(n.jets.places, n.jets.banks, strict=True)
    ]
    return Air(*air_at(n.flown.ground_m + altitude_of(s)), n.xp.stack(speeds))


def _scalar_product(a: Sequence[Any], b: Sequence[Any]) -> Any:
    terms = [x * y for x, y in zip(a, b, strict=True) if not (is_absent(x) or is_absent(y))]
    return sum(terms[1:], terms[0]) if terms else 0.0


def _wrench(n: Numbers, s: State, report: Report, tilt: Vector | None, wind: Vector) -> tuple[Vector, Vector]:
    """Return the force [N] of jets and intakes, and their moment [N m] about the centre of gravity as built."""
    force: Vector = (0.0, 0.0, 0.0)
    moment: Vector = (0.0, 0.0, 0.0)
    for bank, (x, z) in enumerate(_axes(tilt, n.xp)):
        jets = [jet for jet, own in enumerate(n.jets.banks) if own == bank]
        thrusts = [n.factors[jet] * report.thrust[n.jets.engines[jet]] for jet in jets]
        places = [n.jets.places[jet] for jet in jets]
        push, twist = sum(thrusts[1:], thrusts[0]), _scalar_product([n.jets.reactions[jet] for jet in jets], thrusts)
        a, b, c = (_scalar_product(lever, thrusts) for lever in zip(*places, strict=True))
        force = add((x * push, 0.0, z * push), force)
        moment = add((b * z, c * x - a * z, -b * x), moment)
        if not is_absent(twist):
            moment = (moment[0] - x * twist, moment[1], moment[2] - z * twist)
        if n.airflow is not None:
            drag, twist = _intakes(n, s, thrusts, places, (x, 0.0, z), wind)
            force, moment = add(force, drag), add(moment, twist)
    return force, moment


def _intakes(
    n: Numbers, s: State, thrusts: list[Any], places: list[Vector], axis: Vector, wind: Vector
) -> tuple[Vector, Vector]:
    """Return force and moment of the air streams of jets: :class:`cosim.vehicle.effects.intakes.IntakeDrag`."""
    force: Vector = (0.0, 0.0, 0.0)
    moment: Vector = (0.0, 0.0, 0.0)
    across = _across(rotate_back(s.motion.attitude, add(s.motion.velocity, wind, -1.0)), axis)
    for thrust, place in zip(thrusts, places, strict=True):
        flow = -n.airflow.kg_s * n.xp.maximum(thrust / n.airflow.at_thrust_n, 0.0) ** n.airflow.exponent
        inlet, outlet = add(place, axis, n.airflow.intake_m), add(place, axis, n.airflow.exhaust_m)
        drag = tuple(flow * part for part in across)
        damping = tuple(flow * part for part in _across(cross(s.motion.rate, outlet), axis))
        force = add(add(force, drag), damping)
        moment = add(add(moment, cross(inlet, drag)), cross(outlet, damping))
    return force, moment


def _across(v: Vector, axis: Vector) -> Vector:
    """Return the part of a vector across a unit vector."""
    return add(v, axis, -_scalar_product(v, axis))


def _spin(n: Numbers, report: Report, tilt: Vector | None) -> Vector | None:
    """Return the angular momentum of the rotors [kg m^2/s, body]; None where none is modelled."""
    if is_absent(*n.jets.rotors):
        return None
    total: Vector = (0.0, 0.0, 0.0)
    axes = _axes(tilt, n.xp)
    for rotor, bank, row in zip(n.jets.rotors, n.jets.banks, n.jets.engines, strict=True):
        total = add(total, (axes[bank][0], 0.0, axes[bank][1]), rotor * report.speed[row])
    return total


def _bank_reaction(n: Numbers, s: State, tilt: Vector | None) -> tuple[Vector, Vector]:
    """Return the rates of the banks and the moment [N m] of turning them: :mod:`cosim.vehicle.effects.banks`."""
    if tilt is None or s.tilt is None or is_absent(n.servo.bank_inertia_kg_m2):
        return s.tilt_rate, (0.0, 0.0, 0.0)
    rates = tuple((new - old) / n.step for old, new in zip(s.tilt, tilt, strict=True))
    turning = sum((new - old) / n.step for old, new in zip(s.tilt_rate, rates, strict=True))
    p, _, r = s.motion.rate
    h = -n.servo.bank_inertia_kg_m2 * (rates[0] + rates[1])
    return rates, (r * h, n.servo.bank_inertia_kg_m2 * turning, -p * h)


def _mass_with_fuel_burnt(n: Numbers, burnt: Any, payload: tuple[Any, Vector] | None) -> Mass:
    points = [] if payload is None else [payload]
    return mass_with(n.flown, points if n.flown.fuel is None else [(-burnt, n.flown.fuel.position_m), *points])
