"""A flight that a script sends to places: the scenario's commands with the autopilot's position law below them.

Until the first command of a place, a velocity, waypoints or a track begins, the script's leans are flown; from there on
the law's.  Height and heading are the script's until one of them states them; then they go there with the autopilot's
bounds of climb, descent and turn, and stay.  The law, its estimate of the motion and its set-points' limits are those
of the autopilot (:mod:`cosim.control.autopilot.guidance`), with the vehicle's [control.position] and [control.pilot].
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import hypot, radians, tan
from typing import TYPE_CHECKING

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.frames import heading_of
from cosim.base.protocols import Column, EngineState, Report
from cosim.base.signals import Command, Measured
from cosim.control.autopilot.estimation.position import Fix, PositionEstimator
from cosim.control.autopilot.geometry import Pair, lean_from_acceleration, wrap
from cosim.control.autopilot.guidance.descent import descent_rate, height_limits, thrust_margins
from cosim.control.autopilot.guidance.position_control import PositionController
from cosim.control.autopilot.guidance.tracker import Track, Tracker
from cosim.control.cascade import Cascade
from cosim.simulation.script.command_script import CommandScript, read_columns
from cosim.spec.scenario import (
    GuidedCommand,
    PlaceCommand,
    Scenario,
    TrackCommand,
    VelocityCommand,
    Waypoint,
    WaypointsCommand,
)

if TYPE_CHECKING:
    from cosim.spec.vehicle import Vehicle

LEAN_SIGNALS = ("roll_deg", "pitch_deg", "rate_p_deg_s", "rate_q_deg_s", "rate_r_deg_s")  # signals that command a lean
TRACK_COLUMNS = ("north_m", "east_m", "altitude_m", "yaw_deg")  # columns of a track


class GuidedPilot:
    """Pilot that flies a scenario's guided commands in turn.

    ``hover`` and ``idle`` are the collective in hover and the idle thrust in its unit.  Raises InputError where the
    vehicle states no position law, where a command of a lean or a body rate stands beside a guided one, or one of the
    height or the heading beside one that states it, where two begin at the same step, and for a track that cannot be
    read or that the law cannot lean for.
    """

    seen: Measured  # sensors, as in any script

    def __init__(
        self, scenario: Scenario, vehicle: Vehicle, commander: CommandScript, hover: float, idle: float
    ) -> None:
        gains, settings = vehicle.control.position, vehicle.control.pilot
        where = f"scenario {scenario.name}: command"
        if gains is None or settings is None:
            missing = "position" if gains is None else "pilot"
            raise InputError(f"{where}: {vehicle.name} has no [control.{missing}] to fly to a place with")
        self.engines = EngineState.FLY
        self._commander = commander
        self._speed = settings.speed_m_s
        self._step = scenario.step_s
        self._guided: list[tuple[int, GuidedCommand, SplineTrack | None]] = []
        for index, entry in enumerate(scenario.command):
            if isinstance(entry, GuidedCommand):
                start = scenario.count(entry.start_s, f"command.{index}.start_s")
                drawn = None
                if isinstance(entry, TrackCommand):
                    most = GRAVITY * tan(gains.lean_rad)
                    drawn = SplineTrack(scenario, entry, f"{where}.{index}.file", most)
                self._guided.append((start, entry, drawn))
        self._guided.sort(key=lambda aim: aim[0])
        self._starts = [start for start, _, _ in self._guided]
        self._check_commands(where)
        self._estimator = PositionEstimator(gains, vehicle.sensors, scenario.step_s)
        self._tracker = Tracker(settings.acceleration_m_s2, settings.jerk_m_s3, scenario.step_s)
        self._law = PositionController(gains, scenario.step_s)
        altitude, allocation = vehicle.control.altitude, vehicle.control.allocation
        self._rates = settings.climb_m_s, settings.descent_m_s
        margins = thrust_margins(hover, idle, allocation.throttle_min, allocation.throttle_max)
        self._limits = height_limits(altitude.position_1_s, altitude.velocity_1_s, max(self._rates), *margins)
        self._height = Tracker(self._limits.acceleration, self._limits.jerk, scenario.step_s)
        self._turn = settings.yaw_rate_rad_s * scenario.step_s
        self._points = sum(len(aim.waypoint) for _, aim, _ in self._guided if isinstance(aim, WaypointsCommand))
        self._begin_flight()

    @property
    def columns(self) -> tuple[Column, ...]:
        """Column of waypoints still to be reached, if any."""
        if not self._points:
            return ()
        return (Column("waypoints_left", "1", "", "waypoints of the script that were not reached yet"),)

    @property
    def shown(self) -> tuple[float, ...]:
        """The values of :attr:`columns`."""
        return (float(self._left),) if self._points else ()

    def reset(self, measured: Measured) -> None:
        """Start at rest at the measured position."""
        self.seen = measured
        self._estimator.reset((measured.position[0], measured.position[1]))
        self._law.reset()
        self._begin_flight()

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        self.seen = measured
        fix = self._estimator.update(k, measured, report.legs)
        command = self._commander.at(k)
        number = bisect_right(self._starts, k) - 1
        if number < 0:
            return command
        start, aim, drawn = self._guided[number]
        if number != self._number:
            self._begin_command(number, aim, command, fix)
        if self._waypoints is not None:
            self._advance_waypoints(k, self._waypoints, command, fix, measured.altitude)
        if drawn is not None:
            track = self._follow_track(drawn, (k - start) * self._step)
        elif self._velocity is not None:
            track = self._tracker.at_velocity(self._velocity)
        else:
            track = self._tracker.towards(self._target, self._most)
        yaw = heading_of(measured.attitude)
        roll, pitch = lean_from_acceleration(self._law.update(track, fix), yaw)
        heading, altitude = self._heading(command.attitude[2]), self._altitude(command.altitude)
        return Command((roll, pitch, heading), altitude, None, command.collective, track.position, None)

    def _check_commands(self, where: str) -> None:
        """Raise InputError for conflicting guided commands."""
        asked = self._commander.signals
        leaning = [signal for signal in asked if signal in LEAN_SIGNALS]
        if leaning:
            raise InputError(f"{where}: {', '.join(leaning)}: a place needs the lean to itself")
        for key, others in (("altitude_m", ("altitude_m", "collective")), ("yaw_deg", ("yaw_deg",))):
            beside = [signal for signal in asked if signal in others]
            stated = next((name for _, aim, drawn in self._guided if (name := _describe_target(aim, drawn, key))), None)
            if beside and stated:
                raise InputError(f"{where}: {beside[0]}: a {stated}; one of them can ask for it")
        if len(set(self._starts)) < len(self._starts):
            raise InputError(f"{where}: two places, velocities, waypoints or tracks begin at the same step")

    def _begin_flight(self) -> None:
        self._number = -1
        self._waypoints: WaypointsCommand | None = None
        self._velocity: Pair | None = None
        self._target: Pair = (0.0, 0.0)
        self._most = self._speed
        self._to_altitude: float | None = None
        self._climb: float | None = None
        self._to_yaw: float | None = None
        self._yaw = 0.0
        # Last point of the running track, and (height, rate) or None; the next command starts there.
        self._last_point: tuple[Track, Pair | None] | None = None
        self._left = self._points
        self._point = 0  # index of the current waypoint
        self._reached: int | None = None  # step at which the waypoint was reached

    def _begin_command(self, number: int, aim: GuidedCommand, command: Command, fix: Fix) -> None:
        """Begin a guided command; set-points that it does not state are unchanged."""
        if self._last_point is not None:
            track, height = self._last_point
            self._tracker.start(track.position, track.velocity)
            if height is not None:
                self._height.start((height[0], 0.0), (height[1], 0.0))
                self._to_altitude = self._height.stop_position[0]
            self._last_point = None
        elif self._number < 0:
            self._tracker.start(fix.position, fix.velocity)
        self._number = number
        # isinstance is evaluated once per command, because it takes as long as half a step's law.
        self._waypoints = aim if isinstance(aim, WaypointsCommand) else None
        self._velocity = (aim.north_m_s, aim.east_m_s) if isinstance(aim, VelocityCommand) else None
        if self._climb is not None:  # it stops climbing as soon as possible
            self._to_altitude, self._climb = self._height.stop_position[0], None
        if isinstance(aim, PlaceCommand):
            north, east = self._tracker.stop_position
            self._target = (north if aim.north_m is None else aim.north_m, east if aim.east_m is None else aim.east_m)
            self._most = aim.speed_m_s or self._speed
            self._start_height_and_heading(aim.altitude_m, aim.yaw_deg, command)
        elif isinstance(aim, WaypointsCommand):
            self._point, self._reached = 0, None
            self._set_waypoint(aim, aim.waypoint[0], command)
        elif isinstance(aim, VelocityCommand):
            if aim.climb_m_s is not None:
                self._start_height_and_heading(command.altitude, None, command)
                self._climb = aim.climb_m_s
            self._start_height_and_heading(None, aim.yaw_deg, command)

    def _set_waypoint(self, aim: WaypointsCommand, point: Waypoint, command: Command) -> None:
        self._target = (point.north_m, point.east_m)
        self._most = point.speed_m_s or aim.speed_m_s or self._speed
        self._start_height_and_heading(point.altitude_m, point.yaw_deg, command)

    def _advance_waypoints(self, k: int, aim: WaypointsCommand, command: Command, fix: Fix, height: float) -> None:
        """Advance to the next waypoint after one was reached and held for its time."""
        while self._point < len(aim.waypoint):
            point = aim.waypoint[self._point]
            if self._reached is None:
                north, east = fix.position
                distance = max(
                    hypot(point.north_m - north, point.east_m - east),
                    0.0 if point.altitude_m is None else abs(point.altitude_m - height),
                )
                if distance > aim.radius_m:
                    return
                self._reached = k
                self._left -= 1
            hold = aim.hold_s if point.hold_s is None else point.hold_s
            if (k - self._reached) * self._step < hold - 0.5 * self._step:
                return
            self._point += 1
            if self._point < len(aim.waypoint):
                self._reached = None
                self._set_waypoint(aim, aim.waypoint[self._point], command)

    def _follow_track(self, drawn: SplineTrack, t: float) -> Track:
        """Return the set-points of a track at ``t`` [s] from its start, and store those of height and heading."""
        track, height, yaw = drawn.evaluate(t)
        self._last_point = (track, height)
        if height is not None:
            self._to_altitude = height[0]
        if yaw is not None:
            self._yaw = self._to_yaw = wrap(yaw)
        return track

    def _start_height_and_heading(self, altitude: float | None, yaw_deg: float | None, command: Command) -> None:
        """Set the targets of height and heading that are stated; set-points start from the present commands."""
        if altitude is not None:
            if self._to_altitude is None:
                self._height.start((command.altitude, 0.0), (0.0, 0.0))
            self._to_altitude = altitude
        if yaw_deg is not None:
            if self._to_yaw is None:
                self._yaw = command.attitude[2]
            self._to_yaw = radians(yaw_deg)

    def _altitude(self, scripted: float) -> float:
        """Return the height command [m] on its way to the target, no faster than what stops above the ground."""
        if self._to_altitude is None:
            return scripted
        if self._last_point is not None and self._last_point[1] is not None:
            return self._to_altitude
        here, (up, down) = self._height.track.position[0], self._rates
        sink = min(down, descent_rate(here, self._limits.braking, self._limits.response_time))
        if self._climb is not None:
            return self._height.at_velocity((min(max(self._climb, -sink), up), 0.0)).position[0]
        return self._height.towards((self._to_altitude, 0.0), up if self._to_altitude > here else sink).position[0]

    def _heading(self, scripted: float) -> float:
        """Return the heading command [rad] on its way to the target."""
        if self._to_yaw is None:
            return scripted
        self._yaw = wrap(self._yaw + min(max(wrap(self._to_yaw - self._yaw), -self._turn), self._turn))
        return self._yaw


class SplineTrack:
    """Track of a file: cubic splines through its rows, at rest at both ends; the heading is linear between rows.

    ``max_acceleration``: that which the law may lean for, m/s^2.  Raises InputError as the commands' other files, where
    a column of the place is missing, and where the track asks for more.
    """

    def __init__(self, scenario: Scenario, entry: TrackCommand, where: str, max_acceleration: float) -> None:
        path = scenario.folder / entry.file
        self._times, columns = read_columns(path, TRACK_COLUMNS, where)
        for name in TRACK_COLUMNS[:2]:
            if name not in columns:
                raise InputError(f"{path}: line 1: no column {name}; a track has time_s, north_m and east_m")
        self.states = [name for name in TRACK_COLUMNS[2:] if name in columns]
        # Tolerance for rounding, so that a row on the grid counts from its own step on.
        self._slack = 1e-9 * scenario.step_s
        self._yaw = [radians(value) for value in columns["yaw_deg"]] if "yaw_deg" in columns else None
        self._pieces = {name: _spline(self._times, columns[name]) for name in TRACK_COLUMNS[:3] if name in columns}
        for t in self._times:
            asked = hypot(*self.evaluate(t)[0].acceleration)  # rows are joined by straight lines
            if asked > max_acceleration:
                raise InputError(
                    f"{path}: commands {asked:.2f} m/s^2 at {t:g} s; the position law leans for "
                    f"{max_acceleration:.2f} m/s^2 at most ([control.position] lean_rad): give it more time"
                )

    def evaluate(self, t: float) -> tuple[Track, Pair | None, float | None]:
        """Return horizontal set-points, height and climb rate, and heading [rad] at ``t`` [s], each if it is stated."""
        times = self._times
        i = min(max(bisect_right(times, t + self._slack) - 1, 0), max(len(times) - 2, 0))
        u = min(max(t, times[0]), times[-1]) - times[i]
        resting = not times[0] <= t <= times[-1]
        of = {name: _evaluate_cubic(pieces[i], u, resting) for name, pieces in self._pieces.items()}
        north, east = of["north_m"], of["east_m"]
        yaw = None
        if self._yaw is not None:
            span = times[i + 1] - times[i] if len(times) > 1 else 1.0
            yaw = self._yaw[i] + u / span * (self._yaw[min(i + 1, len(times) - 1)] - self._yaw[i])
        track = Track((north[0], east[0]), (north[1], east[1]), (north[2], east[2]))
        return track, (of["altitude_m"][:2] if "altitude_m" in of else None), yaw


Cubic = tuple[float, float, float, float]


def _spline(times: Sequence[float], values: Sequence[float]) -> list[Cubic]:
    """Return the clamped cubic spline through the values: a cubic from each row on, highest power first."""
    if len(times) == 1:
        return [(0.0, 0.0, 0.0, values[0])]
    from scipy.interpolate import CubicSpline

    a, b, c, d = CubicSpline(times, values, bc_type="clamped").c.tolist()
    return list(zip(a, b, c, d, strict=True))


def _evaluate_cubic(cubic: Cubic, u: float, resting: bool) -> tuple[float, float, float]:
    """Return value, slope and curvature of a cubic at ``u``; ``resting``: beyond the ends, without slope."""
    a, b, c, d = cubic
    value = ((a * u + b) * u + c) * u + d
    return (value, 0.0, 0.0) if resting else (value, (3.0 * a * u + 2.0 * b) * u + c, 6.0 * a * u + 2.0 * b)


def _describe_target(aim: GuidedCommand, drawn: SplineTrack | None, key: str) -> str:
    """Return the part of a guided command that states height (``altitude_m``) or heading (``yaw_deg``), or ""."""
    if drawn is not None:
        return f"track states {key}" if key in drawn.states else ""
    if isinstance(aim, WaypointsCommand):
        return f"waypoint states {key}" if any(getattr(point, key) is not None for point in aim.waypoint) else ""
    if isinstance(aim, VelocityCommand):
        stated = "climb_m_s" if key == "altitude_m" else key
        return f"velocity states {stated}" if getattr(aim, stated) is not None else ""
    return f"place states {key}" if getattr(aim, key, None) is not None else ""


def make_guided_pilot(
    scenario: Scenario, vehicle: Vehicle, commander: CommandScript, cascade: Cascade
) -> GuidedPilot | None:
    """Return the pilot of a script that asks for a place, a velocity, waypoints or a track; else None."""
    if not any(isinstance(entry, GuidedCommand) for entry in scenario.command):
        return None
    return GuidedPilot(scenario, vehicle, commander, cascade.allocator.hover, cascade.thrust_map.idle)
