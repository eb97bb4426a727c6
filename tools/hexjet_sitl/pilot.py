"""The pilot at the transmitter, who turns a scenario's commands into sticks."""

from __future__ import annotations

from math import inf

from cosim import FlightError
from cosim.base.frames import heading_of
from cosim.base.limits import clip
from cosim.base.signals import Command, Measured, PerJet, Unallocated
from cosim.control.altitude import AltitudeController
from cosim.laws import Belief, wrap
from hexjet_sitl.lockstep import MAX_STICKS_INTERVAL_S, StickPositions

# A vehicle commanded below the ground counts as landed after this vertical speed [m/s] at most for this time [s], below
# the height of its span. Chosen by us: in a hover it may be as still, if the autopilot holds a height of its own.
MAX_STILL_SPEED, MIN_STILL_S = 0.1, 1.0
# If the autopilot holds position and height: climb rate [m/s] of full throttle stick, and the autopilots' dead zone as
# a fraction of full stick.
FULL_STICK_CLIMB, DEAD_ZONE = 3.0, 0.1


def find_hover_throttle(belief: Belief) -> float:
    """Return the mean throttle of the engines in hover at the start of the flight."""
    return _compute_mean_throttle(belief, belief.hover)


def _compute_mean_throttle(belief: Belief, fraction: float) -> float:
    throttle: PerJet = belief.thrust_map.throttle((clip(fraction, 0.0, 1.0),) * len(belief.vehicle.jets))
    return sum(throttle) / len(throttle)


def apply_dead_zone(fraction: float) -> float:
    """Return a stick's fraction of full stick, or 0 within the autopilot's dead zone."""
    return fraction if abs(fraction) > DEAD_ZONE else 0.0


class StickPilot:
    """Pilot that flies a scenario's commands by the sticks of an autopilot, and holds height and heading.

    The autopilot flies the attitude that the sticks ask for, of full stick ``lean`` [rad] and ``turn`` [rad/s].  Height
    is held with the altitude loop of ``vehicle.toml`` and becomes a throttle stick.  Heading is held by
    a turn in proportion to its error, with the yaw gain of the vehicle's attitude loop.
    Once a height below the ground is commanded and the vehicle stands still near it, it is disarmed, and stays so.
    With ``stick_moves_heading`` the stick turns the heading that the autopilot holds, and the loop is closed around
    that heading: around the vehicle's there would be two loops about one error, which overshoot.  The stick
    moves as often as a receiver sends it, so that the turn is what was sent, whenever the autopilot receives it.
    From ``hold_from`` [s] of the flight on the autopilot holds place and height: the sticks are released, but for a
    height or a heading that is off by more than the autopilot's dead zone.
    """

    def __init__(
        self, belief: Belief, lean: float, turn: float, hold_from: float = inf, stick_moves_heading: bool = False
    ) -> None:
        gains, vehicle = belief.vehicle.control, belief.vehicle
        self._belief = belief
        self._altitude = AltitudeController(
            gains.altitude, vehicle.mass_kg, belief.thrust_map.collective, belief.step_s
        )
        self._heading = gains.attitude.gain_1_s[2]
        self._lean, self._turn, self._climb = lean, turn, gains.altitude.position_1_s / FULL_STICK_CLIMB
        self._step, self._hold_from, self._steps = belief.step_s, hold_from, 0
        self._span = vehicle.aero.span_m
        self._stick_moves_heading, self._turned = stick_moves_heading, 0.0
        self._held_steps = max(1, round(MAX_STICKS_INTERVAL_S / belief.step_s))
        # Headings [rad]: the set-point that the autopilot holds after the stick's turns, and the heading to which its
        # loop should have turned by now.
        self._target: tuple[float, float] | None = None
        self._still_needed, self._still = round(MIN_STILL_S / belief.step_s), 0
        self.hover = find_hover_throttle(belief)

    def reset(self) -> None:
        """Reset height loop, heading and landing for a new flight."""
        self._altitude.reset()
        self._still, self._steps, self._turned = 0, 0, 0.0
        self._target = None

    def update(self, command: Command, measured: Measured, burnt: float) -> StickPositions:
        """Return the sticks that fly a command.  Raises FlightError for commanded body rates."""
        if command.rate is not None:
            raise FlightError("the scenario commands body rates; its sticks command angles: roll, pitch, yaw, altitude")
        now, self._steps = self._steps * self._step, self._steps + 1
        if self._has_landed(command.altitude, measured):
            return StickPositions()
        roll, pitch, yaw = command.attitude
        turn = self._make_yaw_stick(yaw, heading_of(measured.attitude))
        if now >= self._hold_from:
            if roll or pitch:
                raise FlightError(
                    "the scenario commands a lean; where the autopilot holds the place its sticks command speed"
                )
            climb = clip(self._climb * (command.altitude - measured.altitude), -1.0, 1.0)
            return StickPositions(
                yaw=apply_dead_zone(turn), throttle=0.5 + 0.5 * apply_dead_zone(climb), armed=True, holds_place=True
            )
        collective = self._altitude.update(command, measured, Unallocated(), burnt)
        return StickPositions(
            roll / self._lean,
            -pitch / self._lean,
            turn,
            _compute_mean_throttle(self._belief, collective),
            True,
        )

    def _make_yaw_stick(self, yaw: float, heading: float, target_s: float = 5.0) -> float:
        """Return the yaw stick for a commanded heading [rad] at a measured one."""
        if not self._stick_moves_heading:
            return self._heading * wrap(yaw - heading) / self._turn
        target, expected = self._target or (heading, heading)
        if self._steps % self._held_steps == 1 or self._held_steps == 1:
            self._turned = clip(self._heading * wrap(yaw - target) / self._turn, -1.0, 1.0)
        # The held set-point may differ from ours: the distance of the vehicle from where it should be shows this
        # slowly. The distance from the set-point would be a second loop during turns.
        off = wrap(heading - expected) / target_s
        expected += self._step * (off + self._heading * wrap(target - expected))
        self._target = target + self._step * (self._turned * self._turn + off), expected
        return self._turned

    def _has_landed(self, height: float, measured: Measured) -> bool:
        """Return whether a vehicle commanded to a negative ``height`` [m] has stood still near the ground."""
        if self._still < self._still_needed:
            is_still = abs(measured.velocity[2]) < MAX_STILL_SPEED and measured.altitude < self._span
            self._still = self._still + 1 if height < 0.0 and is_still else 0
        return self._still >= self._still_needed
