"""The lean that no throttles avoid with one engine out, however they are chosen, and no tilts either without a spin.

See :meth:`RollAxis.least_lean`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, degrees, exp, isfinite
from typing import TYPE_CHECKING

from cosim.base.constants import GRAVITY
from cosim.engine import make_bank
from cosim.engine.wrappers import EngineChain
from cosim.simulation.controllers.built_in import find_opposite_jets
from cosim.simulation.engine_reference import make_engine_reference
from cosim.spec.scenario import FlameOut
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.servo import TiltServo

if TYPE_CHECKING:
    from cosim.engine import EngineSpec
    from cosim.simulation.step import Simulation

FURTHEST_DEG = 180.0  # beyond it the bound is not followed: it has gone over
STEP_S = 0.004
FOLLOWED_S = 2.0  # the slowest engine of the library needs less than 1.5 s to 180 deg, or to come back


@dataclass(frozen=True)
class Bound:
    """The least lean that was within reach, and when."""

    lean_deg: float  # inf: beyond FURTHEST_DEG
    time_s: float  # from the flame-out to the moment at which it is reached

    @property
    def words(self) -> str:
        return f"{self.lean_deg:.0f}°" if isfinite(self.lean_deg) else f"over {FURTHEST_DEG:.0f}°"


class ThrustCourses:
    """The fastest that an engine's thrust can rise, fall and vanish from hover, by stepping the engine itself [N].

    An engine whose thrust at every later time grows with every throttle before cannot leave the strip between what
    full and least throttle give; a test throws random throttles at each of the library's.
    """

    def __init__(self, spec: EngineSpec, hover: float, lowest: float, highest: float, steps: int) -> None:
        """``hover``, ``least``, ``most``: throttles."""
        self._spec, self._hover, self._lowest = spec, hover, lowest
        self._steps = steps
        self.up = self._run(lambda k: highest)
        self.down = self._run(lambda k: lowest)
        self.out = self._run(lambda k: hover, out_at=0)
        self._shut: dict[int, list[float]] = {}

    def shut(self, at: int) -> list[float]:
        """Return the course at least throttle from the start and shut off from step ``at`` on."""
        if at not in self._shut:
            self._shut[at] = self._run(lambda k: self._lowest, shut_at=at)
        return self._shut[at]

    def _run(self, throttle: Callable[[int], float], out_at: int = -1, shut_at: int = -1) -> list[float]:

        spec = self._spec
        courses = []
        with make_bank([spec], STEP_S) as bank:
            engines = EngineChain(bank, [spec.flame_out], lambda _: make_engine_reference(spec, STEP_S).lag, STEP_S)
            engines.reset(self._hover)
            for k in range(self._steps):
                if k == out_at:
                    engines.begin_fault(FlameOut(kind="flame_out", start_s=0.0, jet=[1]))
                if k == shut_at:
                    engines.switch_engine(0, False)
                courses.append(engines.step(k, (throttle(k),)).thrust[0])
        return courses


@dataclass(frozen=True)
class RollAxis:
    """A vehicle's dynamics about its roll axis, and the changes of it that are compared."""

    vehicle: Vehicle
    courses: ThrustCourses
    hover: float  # N, of a jet
    inertia: float = 1.0  # moment of inertia over that of the vehicle

    def least_lean(self, jet: int, after: int = 0, shut_at: int | None = None, tilting: bool = False) -> Bound:
        """Return the lean that no throttles avoid with jet ``jet`` (from 1) out, knowing it from step ``after`` on.

        Roll obeys ``J p' = M - c p``, ``phi' = p``, with ``M = -sum y_i T_i cos(tilt_i)`` and damping c.  Full throttle
        beside the engine that is out and least throttle across from it, with ``tilting`` also the largest tilt there,
        make M the least that it can be at every instant at once, so that p and phi are the least at every instant
        until p comes back to 0.  A vehicle that is to be held has to come back to p = 0, and no control does so earlier
        or at a smaller phi.

        Optimistic: whatever else throttles and tilts do (pitch, yaw, height, the way back) costs nothing.  Left out: a
        vehicle that spins about its vertical axis meanwhile, by banks tilted apart.  It carries its lean round with
        it, and can lean less than either bound; throttles alone cannot make it spin.
        ``shut_at``: the opposite engine is shut off from that step on.
        """
        vehicle, courses = self.vehicle, self.courses
        sign = 1.0 if vehicle.jets[jet - 1].position_m[1] > 0.0 else -1.0
        opposite = find_opposite(vehicle, jet) if shut_at is not None else 0
        before = [self.hover] * after
        shut_course = courses.shut(shut_at) if shut_at is not None else []
        inertia = self.inertia * vehicle.inertia_kg_m2[0]
        decay = exp(-_damping(vehicle) * STEP_S / inertia)
        p = phi = 0.0
        upright = _upright_fractions(vehicle, after) if tilting else [1.0]
        for k in range(len(courses.up)):
            moment = 0.0
            for number, station in enumerate(vehicle.jets, 1):
                lever = station.position_m[1]
                if number == jet:
                    thrust = courses.out[k]
                elif number == opposite:
                    thrust = shut_course[k] * value_at(upright, k)
                elif lever * sign > 0.0:
                    thrust = before[k] if k < after else courses.up[k - after]
                else:
                    thrust = (before[k] if k < after else courses.down[k - after]) * value_at(upright, k)
                moment -= sign * lever * thrust
            rate_before = p
            p = decay * p + STEP_S * moment / inertia
            if p <= 0.0:
                return Bound(degrees(phi), (k + 1) * STEP_S)
            phi += 0.5 * STEP_S * (rate_before + p)
            if degrees(phi) > FURTHEST_DEG:
                break
        return Bound(float("inf"), (k + 1) * STEP_S)


def value_at(values: Sequence[float], k: int) -> float:
    """Return the value of step ``k``, or the last one if there are no more."""
    return values[k] if k < len(values) else values[-1]


def _upright_fractions(vehicle: Vehicle, after: int) -> list[float]:
    """Return the fraction of its thrust that a bank keeps upright, tilted as far and as fast as its servo goes."""

    if vehicle.servo is None:
        return [1.0]
    servo = TiltServo(vehicle.servo, STEP_S)
    steps = round(20.0 * vehicle.servo.lag_s / STEP_S) + round(2.0 / STEP_S)
    return [1.0] * after + [cos(servo.update(vehicle.servo.range_rad)) for _ in range(steps)]


def _damping(vehicle: Vehicle) -> float:
    """Return the roll damping, N m s: the airframe's, and an upper bound of that of six streams at full flow."""
    damping = vehicle.aero.damping_n_m_s[0]
    flow = vehicle.airflow
    if flow is not None:
        damping += sum(flow.kg_s * (jet.position_m[2] - flow.exhaust_m) ** 2 for jet in vehicle.jets)
    return damping


def find_opposite(vehicle: Vehicle, jet: int) -> int:
    """Return the jet, from 1, across the centre of gravity."""

    return find_opposite_jets(vehicle)[jet - 1] + 1


def measure_courses(simulation: Simulation, fraction: float, seconds: float = FOLLOWED_S) -> ThrustCourses:
    """Return the courses of a built flight's engines, all alike, from a ``fraction`` of their range of thrust on."""
    limits = simulation.vehicle.control.allocation
    count = len(simulation.vehicle.jets)
    hover, lowest, highest = (
        simulation.cascade.thrust_map.throttle((level,) * count)[0]
        for level in (fraction, limits.throttle_min, limits.throttle_max)
    )
    return ThrustCourses(simulation.engine, hover, lowest, highest, round(seconds / STEP_S))


def make_roll_axis(simulation: Simulation, seconds: float = FOLLOWED_S) -> RollAxis:
    """Return the roll axis of a built flight's vehicle with engines all alike, followed for ``seconds``."""
    vehicle = simulation.vehicle
    courses = measure_courses(simulation, simulation.cascade.allocator.hover, seconds)
    return RollAxis(vehicle, courses, vehicle.mass_kg * GRAVITY / len(vehicle.jets))
