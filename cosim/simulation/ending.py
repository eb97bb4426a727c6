"""How a flight ends, and when it does so before its time."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, degrees, radians

from cosim.base.frames import upright
from cosim.base.outcomes import Outcome
from cosim.base.signals import AXES, State
from cosim.spec.vehicle import Limits


@dataclass(frozen=True)
class Ending:
    """The outcome of a flight, and its reason in words."""

    outcome: Outcome
    reason: str


class TerminationCheck:
    """Detects crash, divergence and other early endings of a flight."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._least_upright = cos(radians(limits.tilt_deg))
        self._rate_limit = radians(limits.rate_deg_s)
        self.reset(on_ground=False)

    def reset(self, on_ground: bool) -> None:
        """Start a flight; ``on_ground``: on its legs."""
        self._was_on_ground = on_ground
        self._descent = 0.0

    def check(self, state: State, now: float) -> Ending | None:
        """Return the ending if ``state`` at the time ``now`` [s] ends the flight, else None."""
        p, q, r = state.rate
        limit = self._rate_limit
        if state.hull_contact:
            return Ending("crashed", f"the hull touched the ground at {now:.3f} s ({_lean(state)})")
        limits = self._limits
        if state.on_ground and not self._was_on_ground and self._descent > limits.touchdown_m_s:
            return Ending("crashed", f"hit the ground at {self._descent:.1f} m/s at {now:.3f} s ({_lean(state)})")
        self._was_on_ground = state.on_ground
        self._descent = state.velocity[2]
        if upright(state.attitude) < self._least_upright:
            return Ending("diverged", f"leaned past {limits.tilt_deg:g} deg at {now:.3f} s ({_lean(state)})")
        if not (-limit < p < limit and -limit < q < limit and -limit < r < limit):
            return Ending("diverged", f"turned faster than {limits.rate_deg_s:g} deg/s at {now:.3f} s ({_lean(state)})")
        return None


def _lean(state: State) -> str:
    """Return the attitude as text: roll, pitch and yaw in degrees."""
    return ", ".join(f"{axis} {degrees(angle):z.0f} deg" for axis, angle in zip(AXES, state.euler, strict=True))
