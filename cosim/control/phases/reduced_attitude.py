"""A quadrotor without one of its rotors: the direction of thrust alone is held, and the vehicle spins about it.

The rotor across turns the same way as the lost one.  The other two carry the vehicle and turn the frame the same way,
so that it spins up until damping holds their reaction, ``c_z r = sum kappa_i T_i``.  Their difference gives a moment
about one axis of the body, ``a``; about the other one nothing is left but the rotor across, which pushes only the way
that the loss has tipped it.  The spin makes up for it: in turning body axes the direction ``d`` that the body's z axis
is to have, and the rates p and q, follow

    d_x' = r d_y - q d_z,   d_y' = -r d_x + p d_z
    J_x p' = M_x - c_x p - (J_z - J_y) q r,   J_y q' = M_y - c_y q - (J_x - J_z) p r

and each part that ``a`` does not reach is soon one that it does.  Linear about ``d = (0, 0, 1)`` that is controllable
with one input for any spin but none.  State feedback is the optimal one along the spin-up, from the Riccati recursion
run backwards from the last spin to none; it is tabulated by spin.  The reports of the rotors and their commands are
predicted over their delay by the equations above, with ``M' = (M_c - M) / tau``; feedback acts on the prediction.

M. W. Mueller and R. D'Andrea, Stability and control of a quadrocopter despite the complete loss of one, two, or three
propellers, ICRA 2014, have the equilibria and the feedback at one spin.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import copysign, exp, hypot, radians
from typing import TYPE_CHECKING, Any, Final

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import ZERO3, PerJet, Vector3
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.spec.vehicle import Vehicle

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Spacing of the spins for which gains are stored.
_SPIN_SPACING_RAD_S: Final = 0.5

Gains = tuple[tuple[float, ...], ...]


class ReducedAttitude:
    """Control of the thrust direction of four rotors with one out, while the vehicle spins.

    ``lag`` and ``delay`` of the rotors [s]; ``added_delay``: of every command, steps.  Raises InputError
    where the vehicle has not four rotors in opposite pairs, each pair turning the frame its own way.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        opposites: Sequence[int],
        thrust_map: ThrustMap,
        lag: float,
        delay: float,
        step: float,
        added_delay: int = 0,
    ) -> None:
        jets = vehicle.jets
        turns_left = [jet.reaction_m > 0.0 for jet in jets]
        is_paired = all(turns_left[i] == turns_left[o] and jets[i].reaction_m for i, o in enumerate(opposites))
        if len(jets) != 4 or not is_paired or sum(turns_left) != 2:
            raise InputError(f"{vehicle.name}: control.monitor.catch: not four rotors in pairs that turn alike")
        if not vehicle.aero.damping_n_m_s[2] > 0.0:
            raise InputError(
                f"{vehicle.name}: control.monitor.catch: without damping of yaw (aero) no spin is the last"
            )
        limits = vehicle.control.allocation
        self._opposites, self._map, self._step = tuple(opposites), thrust_map, step
        self._least = thrust_map.low + thrust_map.span * limits.throttle_min
        self._most = thrust_map.low + thrust_map.span * limits.throttle_max
        self._positions = [jet.position_m[:2] for jet in jets]
        self._reactions = [jet.reaction_m for jet in jets]
        self._inertia, self._damping = vehicle.inertia_kg_m2[:3], vehicle.aero.damping_n_m_s
        lag = max(lag, step)
        self._lag_weight = 1.0 - exp(-step / lag)
        self._added_delay, self._delay = added_delay, round(delay / step) + added_delay
        self._signs = [
            (copysign(1.0, -jet.position_m[1]), copysign(1.0, jet.position_m[0]), copysign(1.0, jet.reaction_m))
            for jet in jets
        ]
        # Final spin [rad/s], and the thrust [N] of the opposite rotor at that spin.
        weight, limit = vehicle.mass_kg * GRAVITY, radians(vehicle.limits.rate_deg_s)
        self._spin, self._opposite_thrust = self._find_equilibrium(weight, limit)
        self._gains = [self._gains_for_loss(jet, lag) for jet in range(4)]
        self.is_flying = False

    def _find_equilibrium(self, weight: float, limit: float, max_spin: float = 0.9) -> tuple[float, float]:
        """Return the final spin [rad/s] and the opposite rotor's thrust there [N].

        ``max_spin``: of the rate ``limit`` at which the vehicle is lost; the rest is for thrust beyond the weight.
        """
        lever, damping = abs(self._reactions[0]), self._damping[2]
        opposite = max(self._least, 0.5 * (weight - damping * max_spin * limit / lever))
        return lever * (weight - 2.0 * opposite) / damping, opposite

    def _gains_for_loss(self, failed: int, lag: float) -> Gains:
        pair = next(i for i in range(4) if i not in (failed, self._opposites[failed]))
        x, y = self._positions[pair]
        arm = hypot(x, y)
        sense = 1.0 if self._reactions[pair] > 0.0 else -1.0
        return feedback_gains((-y / arm, x / arm), sense * self._spin, self._inertia, self._damping, lag)

    def begin(self, failed: int, thrust: PerJet, commands: Sequence[PerJet]) -> None:
        """Begin without rotor ``failed``, from 0; ``thrust`` as reported and ``commands``, oldest first [N]."""
        opposite = self._opposites[failed]
        one, other = [i for i in range(4) if i not in (failed, opposite)]
        self._jets = (failed, opposite, one, other)
        self._thrust = thrust
        delay = self._delay - self._added_delay
        self._commands = [*commands[max(0, len(commands) - delay) :], *[commands[-1]] * self._added_delay]
        self.is_flying = True

    def end(self) -> None:
        """End the spinning flight, because the rotors idle or are off."""
        self.is_flying = False

    def observe(self, thrust: PerJet) -> None:
        """Store the rotors' reported thrusts [N] at the end of a step."""
        self._thrust = thrust

    def update(
        self, direction: Vector3, rate: Vector3, total: float, added_torque: Vector3 = ZERO3
    ) -> tuple[PerJet, float]:
        """Return the thrust fractions of all rotors, and the sum of thrusts [N] that they give in place of ``total``.

        ``direction``: set-point of the body's z axis, in body axes; ``rate`` [rad/s]; ``added_torque``: a disturbance
        of roll, pitch and yaw in throttle, unknown to the law.
        """
        failed, opposite, one, other = self._jets
        predicted_direction, rate, moment = self._predict(direction, rate)
        state = (rate[0], rate[1], predicted_direction[0], predicted_direction[1], moment)
        gain = self._gains[failed]
        position = min(abs(rate[2]) / _SPIN_SPACING_RAD_S, len(gain) - 1.001)
        index = int(position)
        part = position - index
        command = 0.0
        for low, high, value in zip(gain[index], gain[index + 1], state, strict=True):
            command -= (low + part * (high - low)) * value
        arm = hypot(*self._positions[one])
        least, most = self._least, self._most
        turning = min(1.0, abs(rate[2]) / self._spin)
        opposite_thrust = max(least, self._opposite_thrust * turning * turning)
        half = max(-0.5 * (most - least), min(0.5 * (most - least), command / (2.0 * arm)))
        size = abs(half)
        mean = max(least + size, min(most - size, 0.5 * (total - opposite_thrust)))
        commands = [0.0] * 4
        commands[failed], commands[opposite] = least, opposite_thrust
        commands[one], commands[other] = mean + half, mean - half
        self._commands.append(tuple(commands))
        delayed = list(self._commands[-1 - self._added_delay])
        if len(self._commands) > self._delay:
            del self._commands[0]
        allocated = delayed[opposite] + delayed[one] + delayed[other]
        if added_torque != ZERO3:
            for i, signs in enumerate(self._signs):
                for sign, value in zip(signs, added_torque, strict=True):
                    delayed[i] += self._map.span * sign * value
                delayed[i] = max(least, min(most, delayed[i]))
        return tuple([self._map.fraction(thrust) for thrust in delayed]), allocated

    def _predict(self, direction: Vector3, rate: Vector3) -> tuple[Vector3, Vector3, float]:
        """Return thrust direction, body rates and the pair's moment, predicted to when the present command acts."""
        step, (jx, jy, jz), (cx, cy, cz) = self._step, self._inertia, self._damping
        (x, y, z), (p, q, r), thrust = direction, rate, list(self._thrust)
        failed = self._jets[0]
        for command in self._commands:
            mx = my = mz = 0.0
            for i, (px, py) in enumerate(self._positions):
                mx -= py * thrust[i]
                my += px * thrust[i]
                mz += self._reactions[i] * thrust[i]
                thrust[i] += self._lag_weight * ((0.0 if i == failed else command[i]) - thrust[i])
            x, y, z = x + step * (r * y - q * z), y + step * (p * z - r * x), z + step * (q * x - p * y)
            p, q, r = (
                p + step * (mx - cx * p - (jz - jy) * q * r) / jx,
                q + step * (my - cy * q - (jx - jz) * p * r) / jy,
                r + step * (mz - cz * r) / jz,
            )
        _, _, one, other = self._jets
        return (x, y, z), (p, q, r), hypot(*self._positions[one]) * (thrust[one] - thrust[other])


def linear_model(
    axis: tuple[float, float], spin: float, inertia: Vector3, damping: Vector3, lag: float
) -> tuple[Any, Any]:
    """Return A, B of ``x' = A x + B u`` for p, q, d_x, d_y and the moment about ``axis``, at a spin [rad/s]."""
    import numpy as np

    (jx, jy, jz), (cx, cy, _), (ax, ay), r = inertia, damping, axis, spin
    a = np.array(
        [
            [-cx / jx, -(jz - jy) * r / jx, 0.0, 0.0, ax / jx],
            [-(jx - jz) * r / jy, -cy / jy, 0.0, 0.0, ay / jy],
            [0.0, -1.0, 0.0, r, 0.0],
            [1.0, 0.0, -r, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, -1.0 / lag],
        ]
    )
    return a, np.array([0.0, 0.0, 0.0, 0.0, 1.0 / lag])


@cache
def feedback_gains(
    axis: tuple[float, float], last: float, inertia: Vector3, damping: Vector3, lag: float, step: float = 0.01
) -> Gains:
    """Return the feedback gains by spin, every ``_SPIN_SPACING_RAD_S`` from none to the ``last`` one, signed [rad/s].

    A lean of 1 rad weighs as much as a rate of 10 rad/s, and as a moment of 100 rad/s^2: the first lean, of less than
    half a radian, then takes less than the pair has to give beside the weight.  ``step`` of the recursion [s]: short
    against the spin's turn and the loop's tenth of a second; 10 s of spin-up follow on 10 s at the last spin.
    """
    import numpy as np

    q = np.diag([0.1**2, 0.1**2, 1.0, 1.0, 0.0]) * step
    weight = step / (inertia[0] * 100.0) ** 2
    lasting = inertia[2] / damping[2]
    count = round(10.0 / step)
    cost = np.zeros((5, 5))
    spins: list[float] = []
    gains: list[NDArray[Any]] = []
    for k in range(2 * count, 0, -1):
        spin = last if k > count else last * (1.0 - np.exp(-(k - 1) * step / lasting))
        a, b = _discretise(*linear_model(axis, spin, inertia, damping, lag), step)
        row = b @ cost
        gain = (row @ a) / (weight + row @ b)
        cost = q + a.T @ cost @ (a - np.outer(b, gain))
        if k <= count:
            spins.append(abs(spin))
            gains.append(gain)
    grid = np.arange(0.0, abs(last) + _SPIN_SPACING_RAD_S, _SPIN_SPACING_RAD_S)
    table = np.array([np.interp(grid, spins[::-1], column[::-1]) for column in np.array(gains).T]).T
    return tuple([tuple(row) for row in table.tolist()])


def _discretise(a: NDArray[Any], b: NDArray[Any], step: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a linear system discretised with the input held, by the exponential series to the fifth power."""
    import numpy as np

    system = np.zeros((6, 6))
    system[:5, :5], system[:5, 5] = a * step, b * step
    term = transition = np.eye(6)
    for n in range(1, 6):
        term = term @ system / n
        transition = transition + term
    return transition[:5, :5], transition[:5, 5]
