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
run backwards from the last spin to none; it is kept by spin.  What the rotors report and what they were told is
carried on over their delay by the equations above, with ``M' = (M_c - M) / tau``; feedback acts on what comes out.

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

# Chosen by us.  Of the rate at which the vehicle counts as lost, where it is to spin at most: the rest is for thrust
# beyond the weight.
_MOST_SPIN: Final = 0.9
# Chosen by us.  A lean of 1 rad weighs as much as a rate of 10 rad/s, and as a moment of 100 rad/s^2: the first lean,
# of less than half a radian, then takes less than the pair has to give beside the weight.
_RATE_WEIGHT: Final = 0.1  # s
_BEND: Final = 100.0  # rad/s^2 per rad
_GRID: Final = 0.5  # rad/s between stored gains
_STEP: Final = 0.01  # s of the recursion; short against the spin's turn and the loop's tenth of a second
_LONGEST: Final = 10.0  # s of spin-up, and of the recursion before it at the last spin

Gains = tuple[tuple[float, ...], ...]


class ReducedAttitude:
    """Thrusts of four rotors of which one is lost; see the module's text.

    ``lag`` and ``delay`` of the rotors [s]; ``added``: steps by which every command is held back.  Raises InputError
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
        added: int = 0,
    ) -> None:
        jets = vehicle.jets
        left = [jet.reaction_m > 0.0 for jet in jets]
        paired = all(left[i] == left[o] and jets[i].reaction_m for i, o in enumerate(opposites))
        if len(jets) != 4 or not paired or sum(left) != 2:
            raise InputError(f"{vehicle.name}: control.monitor.catch: not four rotors in pairs that turn alike")
        if not vehicle.aero.damping_n_m_s[2] > 0.0:
            raise InputError(
                f"{vehicle.name}: control.monitor.catch: without damping of yaw (aero) no spin is the last"
            )
        limits = vehicle.control.allocation
        self._opposites, self._map, self._step = tuple(opposites), thrust_map, step
        self._least = thrust_map.low + thrust_map.span * limits.throttle_min
        self._most = thrust_map.low + thrust_map.span * limits.throttle_max
        self._places = [jet.position_m[:2] for jet in jets]
        self._reactions = [jet.reaction_m for jet in jets]
        self._inertia, self._damping = vehicle.inertia_kg_m2[:3], vehicle.aero.damping_n_m_s
        lag = max(lag, step)
        self._share = 1.0 - exp(-step / lag)
        self._added, self._delay = added, round(delay / step) + added
        self._signs = [
            (copysign(1.0, -jet.position_m[1]), copysign(1.0, jet.position_m[0]), copysign(1.0, jet.reaction_m))
            for jet in jets
        ]
        # the last spin, and what the rotor across gives there
        self._spin, self._across = self._equilibrium(vehicle.mass_kg * GRAVITY, radians(vehicle.limits.rate_deg_s))
        self._gains = [self._designed(jet, lag) for jet in range(4)]
        self.flies = False

    def _equilibrium(self, weight: float, limit: float) -> tuple[float, float]:
        """Return the final spin [rad/s], and the thrust of the rotor across that keeps it there [N]."""
        lever, damping = abs(self._reactions[0]), self._damping[2]
        across = max(self._least, 0.5 * (weight - damping * _MOST_SPIN * limit / lever))
        return lever * (weight - 2.0 * across) / damping, across

    def _designed(self, lost: int, lag: float) -> Gains:
        pair = next(i for i in range(4) if i not in (lost, self._opposites[lost]))
        x, y = self._places[pair]
        arm = hypot(x, y)
        sense = 1.0 if self._reactions[pair] > 0.0 else -1.0
        return designed((-y / arm, x / arm), sense * self._spin, self._inertia, self._damping, lag)

    def begin(self, lost: int, thrust: PerJet, asked: Sequence[PerJet]) -> None:
        """Rotor ``lost``, from 0, is gone; what all report, and what they were asked for, oldest first [N]."""
        across = self._opposites[lost]
        one, other = [i for i in range(4) if i not in (lost, across)]
        self._jets = (lost, across, one, other)
        self._thrust = thrust
        late = self._delay - self._added
        self._asked = [*asked[max(0, len(asked) - late) :], *[asked[-1]] * self._added]
        self.flies = True

    def end(self) -> None:
        """End the flight with a spin: the rotors idle or are off."""
        self.flies = False

    def look(self, thrust: PerJet) -> None:
        """Take what the rotors report at the end of a step [N]."""
        self._thrust = thrust

    def update(self, wanted: Vector3, rate: Vector3, total: float, disturbed: Vector3 = ZERO3) -> tuple[PerJet, float]:
        """Shares of all rotors, and the thrust that they ask for together [N] in place of ``total``.

        ``wanted``: the direction that the body's z axis is to have, in body axes; ``rate`` [rad/s]; ``disturbed``:
        added to roll, pitch and yaw in throttle, unknown to the law.
        """
        lost, across, one, other = self._jets
        ahead, rate, moment = self._ahead(wanted, rate)
        state = (rate[0], rate[1], ahead[0], ahead[1], moment)
        gain = self._gains[lost]
        place = min(abs(rate[2]) / _GRID, len(gain) - 1.001)
        index = int(place)
        part = place - index
        command = 0.0
        for low, high, value in zip(gain[index], gain[index + 1], state, strict=True):
            command -= (low + part * (high - low)) * value
        arm = hypot(*self._places[one])
        least, most = self._least, self._most
        turning = min(1.0, abs(rate[2]) / self._spin)
        push = max(least, self._across * turning * turning)
        half = max(-0.5 * (most - least), min(0.5 * (most - least), command / (2.0 * arm)))
        size = abs(half)
        mean = max(least + size, min(most - size, 0.5 * (total - push)))
        asked = [0.0] * 4
        asked[lost], asked[across], asked[one], asked[other] = least, push, mean + half, mean - half
        self._asked.append(tuple(asked))
        told = list(self._asked[-1 - self._added])
        if len(self._asked) > self._delay:
            del self._asked[0]
        given = told[across] + told[one] + told[other]
        if disturbed != ZERO3:
            for i, signs in enumerate(self._signs):
                for sign, value in zip(signs, disturbed, strict=True):
                    told[i] += self._map.span * sign * value
                told[i] = max(least, min(most, told[i]))
        return tuple([self._map.share(thrust) for thrust in told]), given

    def _ahead(self, wanted: Vector3, rate: Vector3) -> tuple[Vector3, Vector3, float]:
        """Direction, rates and the pair's moment when what is asked for now arrives."""
        step, (jx, jy, jz), (cx, cy, cz) = self._step, self._inertia, self._damping
        (x, y, z), (p, q, r), thrust = wanted, rate, list(self._thrust)
        lost = self._jets[0]
        for asked in self._asked:
            mx = my = mz = 0.0
            for i, (px, py) in enumerate(self._places):
                mx -= py * thrust[i]
                my += px * thrust[i]
                mz += self._reactions[i] * thrust[i]
                thrust[i] += self._share * ((0.0 if i == lost else asked[i]) - thrust[i])
            x, y, z = x + step * (r * y - q * z), y + step * (p * z - r * x), z + step * (q * x - p * y)
            p, q, r = (
                p + step * (mx - cx * p - (jz - jy) * q * r) / jx,
                q + step * (my - cy * q - (jx - jz) * p * r) / jy,
                r + step * (mz - cz * r) / jz,
            )
        _, _, one, other = self._jets
        return (x, y, z), (p, q, r), hypot(*self._places[one]) * (thrust[one] - thrust[other])


def linear(axis: tuple[float, float], spin: float, inertia: Vector3, damping: Vector3, lag: float) -> tuple[Any, Any]:
    """``x' = A x + B u`` of p, q, d_x, d_y and the moment about ``axis``, at a constant spin [rad/s]."""
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
def designed(axis: tuple[float, float], last: float, inertia: Vector3, damping: Vector3, lag: float) -> Gains:
    """Feedback by spin, every ``_GRID`` from none to the ``last`` one, signed [rad/s]; see the module's text."""
    import numpy as np

    q = np.diag([_RATE_WEIGHT**2, _RATE_WEIGHT**2, 1.0, 1.0, 0.0]) * _STEP
    weight = _STEP / (inertia[0] * _BEND) ** 2
    lasting = inertia[2] / damping[2]
    count = round(_LONGEST / _STEP)
    cost = np.zeros((5, 5))
    spins: list[float] = []
    gains: list[NDArray[Any]] = []
    for k in range(2 * count, 0, -1):
        spin = last if k > count else last * (1.0 - np.exp(-(k - 1) * _STEP / lasting))
        a, b = _discretise(*linear(axis, spin, inertia, damping, lag))
        row = b @ cost
        gain = (row @ a) / (weight + row @ b)
        cost = q + a.T @ cost @ (a - np.outer(b, gain))
        if k <= count:
            spins.append(abs(spin))
            gains.append(gain)
    grid = np.arange(0.0, abs(last) + _GRID, _GRID)
    table = np.array([np.interp(grid, spins[::-1], column[::-1]) for column in np.array(gains).T]).T
    return tuple([tuple(row) for row in table.tolist()])


def _discretise(a: NDArray[Any], b: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a system over a step with the input held: the exponential series to the fifth power."""
    import numpy as np

    whole = np.zeros((6, 6))
    whole[:5, :5], whole[:5, 5] = a * _STEP, b * _STEP
    term = answer = np.eye(6)
    for n in range(1, 6):
        term = term @ whole / n
        answer = answer + term
    return answer[:5, :5], answer[:5, 5]
