"""A flight that a script sends to places: the scenario's commands with the autopilot's position law below them.

Until the first command of a place or a velocity begins, the script's leans are flown; from there on the law's.  Height
and heading are the script's until a place states them; then they go there with the autopilot's bounds of climb, descent
and turn, and stay.  The law, its estimate of the motion and its set-points' limits are those of the autopilot
(:mod:`cosim.control.autopilot.guidance`), with the vehicle's [control.position] and [control.pilot].
"""

from __future__ import annotations

from bisect import bisect_right
from math import radians
from typing import TYPE_CHECKING

from cosim.base.errors import InputError
from cosim.base.frames import to_euler
from cosim.base.protocols import EngineState, Report
from cosim.base.signals import Command, Measured
from cosim.control.autopilot.estimation.position import Estimator
from cosim.control.autopilot.geometry import Pair, lean_for, wrap
from cosim.control.autopilot.guidance.descent import descent_for, height_limits, thrust_margins
from cosim.control.autopilot.guidance.position_control import PositionController
from cosim.control.autopilot.guidance.tracker import Track, Tracker
from cosim.simulation.commander import Commander
from cosim.spec.scenario import PlaceCommand, Scenario, VelocityCommand

if TYPE_CHECKING:
    from cosim.spec.vehicle import Vehicle

LEANING = ("roll_deg", "pitch_deg", "rate_p_deg_s", "rate_q_deg_s", "rate_r_deg_s")


class PlacePilot:
    """Flies to the scenario's places and at its velocities, one after the other, each from its start on.

    ``hover`` and ``idle`` are the collective in hover and the idle thrust in its unit.  Raises InputError where the
    vehicle states no position law, where a command of a lean or a body rate stands beside a place, or one of the height
    or the heading beside a place that states it, or where two begin at the same step.
    """

    engines: EngineState = EngineState.FLY
    seen: Measured  # what the loops fly with: the sensors as they are, as in any script

    def __init__(self, scenario: Scenario, vehicle: Vehicle, commander: Commander, hover: float, idle: float) -> None:
        gains, settings = vehicle.control.position, vehicle.control.pilot
        if gains is None or settings is None:
            missing = "position" if gains is None else "pilot"
            raise InputError(
                f"scenario {scenario.name}: command: {vehicle.name} has no [control.{missing}] to fly to a place with"
            )
        leaning = [signal for signal in commander.signals if signal in LEANING]
        if leaning:
            raise InputError(
                f"scenario {scenario.name}: command: {', '.join(leaning)}: a place needs the lean to itself"
            )
        places = [entry for entry in scenario.command if isinstance(entry, PlaceCommand)]
        for key, others in (("altitude_m", ("altitude_m", "collective")), ("yaw_deg", ("yaw_deg",))):
            beside = [signal for signal in commander.signals if signal in others]
            if beside and any(getattr(place, key) is not None for place in places):
                raise InputError(
                    f"scenario {scenario.name}: command: {beside[0]}: a place states {key}; one of them can ask for it"
                )
        self._commander = commander
        self._speed = settings.speed_m_s
        self._aims: list[tuple[int, PlaceCommand | VelocityCommand]] = []
        for index, entry in enumerate(scenario.command):
            if isinstance(entry, (PlaceCommand, VelocityCommand)):
                self._aims.append((scenario.count(entry.start_s, f"command.{index}.start_s"), entry))
        self._aims.sort(key=lambda aim: aim[0])
        self._starts = [start for start, _ in self._aims]
        if len(set(self._starts)) < len(self._starts):
            raise InputError(f"scenario {scenario.name}: command: two places or velocities begin at the same step")
        self._estimator = Estimator(gains, vehicle.sensors.gnss, scenario.step_s)
        self._tracker = Tracker(settings.acceleration_m_s2, settings.jerk_m_s3, scenario.step_s)
        self._law = PositionController(gains, scenario.step_s)
        altitude, allocation = vehicle.control.altitude, vehicle.control.allocation
        self._rates = settings.climb_m_s, settings.descent_m_s
        margins = thrust_margins(hover, idle, allocation.throttle_min, allocation.throttle_max)
        self._limits = height_limits(altitude.position_1_s, altitude.velocity_1_s, max(self._rates), *margins)
        self._height = Tracker(self._limits.acceleration, self._limits.jerk, scenario.step_s)
        self._turn = settings.yaw_rate_rad_s * scenario.step_s
        self._number = -1
        self._target: Pair = (0.0, 0.0)
        self._to_altitude: float | None = None
        self._to_yaw: float | None = None
        self._yaw = 0.0

    def reset(self, measured: Measured) -> None:
        """At rest where the sensors say."""
        self.seen = measured
        self._estimator.reset((measured.position[0], measured.position[1]))
        self._law.reset()
        self._number = -1
        self._to_altitude = self._to_yaw = None

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        """The command of step ``k``."""
        self.seen = measured
        fix = self._estimator.update(k, measured, report.legs)
        command = self._commander.at(k)
        number = bisect_right(self._starts, k) - 1
        if number < 0:
            return command
        aim = self._aims[number][1]
        if number != self._number:
            if self._number < 0:
                self._tracker.start(fix.position, fix.velocity)
            self._number = number
            north, east = self._tracker.ahead
            if isinstance(aim, PlaceCommand):
                self._target = (
                    north if aim.north_m is None else aim.north_m,
                    east if aim.east_m is None else aim.east_m,
                )
                self._begin(aim, command)
        track = self._towards(aim)
        yaw = to_euler(measured.attitude)[2]
        roll, pitch = lean_for(self._law.update(track, fix), yaw)
        heading, altitude = self._heading(command.attitude[2]), self._altitude(command.altitude)
        return Command((roll, pitch, heading), altitude, None, command.collective, track.position)

    def _begin(self, aim: PlaceCommand, command: Command) -> None:
        """Height and heading that ``aim`` states are gone to from what is asked for now."""
        if aim.altitude_m is not None:
            if self._to_altitude is None:
                self._height.start((command.altitude, 0.0), (0.0, 0.0))
            self._to_altitude = aim.altitude_m
        if aim.yaw_deg is not None:
            if self._to_yaw is None:
                self._yaw = command.attitude[2]
            self._to_yaw = radians(aim.yaw_deg)

    def _altitude(self, scripted: float) -> float:
        """The height asked for, m: on its way to a place's, and no faster than what stops above the ground."""
        if self._to_altitude is None:
            return scripted
        here, (up, down) = self._height.track.position[0], self._rates
        sink = min(down, descent_for(here, self._limits.braking, self._limits.late))
        return self._height.towards((self._to_altitude, 0.0), up if self._to_altitude > here else sink).position[0]

    def _heading(self, scripted: float) -> float:
        """The heading asked for, rad: on its way to a place's."""
        if self._to_yaw is None:
            return scripted
        self._yaw = wrap(self._yaw + min(max(wrap(self._to_yaw - self._yaw), -self._turn), self._turn))
        return self._yaw

    def _towards(self, aim: PlaceCommand | VelocityCommand) -> Track:
        if isinstance(aim, PlaceCommand):
            return self._tracker.towards(self._target, aim.speed_m_s or self._speed)
        return self._tracker.at_velocity((aim.north_m_s, aim.east_m_s))


def flies_to_places(scenario: Scenario) -> bool:
    """Whether the script asks for a place or a velocity."""
    return any(isinstance(entry, (PlaceCommand, VelocityCommand)) for entry in scenario.command)
