"""The autopilot: what a ground station asks for, and the command of every control step.

Requests come in between two steps (:meth:`Autopilot.handle`); :meth:`Autopilot.update` then gives the command of the
step.  Time is counted in steps, so that the same requests at the same steps give the same flight, bit for bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import atan2, cos, degrees, hypot, inf, nan, pi, radians, sin
from typing import Any, NamedTuple

from cosim.base.errors import InputError
from cosim.base.frames import to_euler
from cosim.base.protocols import EngineState, Report
from cosim.base.signals import (
    AXES,
    Command,
    Measured,
    Vector3,
)
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.autopilot.descent import (
    Floor,
    HeightLimits,
    descent_for,
    height_limits,
    thrust_margins,
)
from cosim.control.autopilot.failsafes import OUTSIDE, Watch
from cosim.control.autopilot.guidance import Guide
from cosim.control.autopilot.mission import Mission
from cosim.control.autopilot.modes import (
    BY_STICK,
    DIRECT,
    Home,
    LandedState,
    Message,
    Mode,
    Severity,
)
from cosim.control.autopilot.navigation import (
    Estimator,
    Fix,
    Pair,
    PositionController,
    Tracker,
    limited,
    wrap,
)
from cosim.control.autopilot.parameters import (
    HOLD,
    LAND,
    RETURN,
    Blocks,
    Live,
    Parameters,
    PredictorMaker,
    table,
)
from cosim.control.autopilot.reckoning import Reckoning
from cosim.control.autopilot.requests import (
    Answer,
    Arm,
    ClearFaults,
    Disarm,
    FenceUpload,
    FenceZone,
    Goto,
    Hold,
    InjectFault,
    ItemKind,
    Kill,
    Land,
    LinkBack,
    LinkLost,
    MissionClear,
    MissionItem,
    MissionSetCurrent,
    MissionStart,
    MissionUpload,
    OffboardAttitude,
    OffboardPosition,
    OffboardVelocity,
    Orbit,
    OrbitYaw,
    RallyPoint,
    RallyUpload,
    Request,
    Result,
    ReturnHome,
    SetHome,
    SetMode,
    SetParameter,
    SetSpeed,
    Sticks,
    Takeoff,
    quaternion_of,
)
from cosim.control.autopilot.senses import Senses
from cosim.control.autopilot.shaper import (
    AttitudeLimits,
    Shaper,
    angular_authority,
    attitude_limits,
)
from cosim.control.autopilot.touchdown import Touchdown
from cosim.control.rate import RateController
from cosim.spec.vehicle import Vehicle

# Chosen by us, with the reason.
_APART = 2.5  # attitude gain over velocity gain, at least: nearer, the loop that the law takes for done is not
_SETTLED_EPOCHS_S = 1.0  # a second of GNSS before its place may be called home
_MOVING = 0.2  # rad/s: a vehicle that turns like this is being carried
_STICK_LOW = 0.05  # throttle below this is "off" on the ground
_STICK_UP = 0.6  # throttle above this asks to leave the ground
_STICK_DEAD = 0.05  # of full stick around the centre
_LIFT_M = 0.3  # above the ground with no leg in contact is in the air
_DOUBTED_S = 1.0  # contact that neither height nor weight bears out, for so long: the switch is broken
_CLEAR_M = 1.0  # above the ground by three deviations more than this is in the air, whatever the legs say
_LIFT_S = 10.0  # after spooling up without leaving the ground, the take-off is given up
_REACHED_M = 0.4  # of height; a take-off or climb is over, or a waypoint's height is reached
_NEAR_HOME_M = 2.0  # no climb and no flight is needed to land here
_LOWEST_M = 1.0  # above the ground: nothing flies there by itself, and a stop ends no lower
_SETTLE_S = 0.7  # from contact to idle
_SETTLE_SINK = 1.0  # m/s: sinking faster than this is no contact
_BLIND_S = 1.0  # s without a fix: the lean alone is off by half a metre by then for a degree that it is wrong
_OFFBOARD_UP = 0.1  # m/s: a climb or descent that is meant
_RETURNED_M = 0.7  # from home and slower than 0.5 m/s: the descent begins
_SLOW = 0.5  # m/s
_SPEED_SURE = 1.0  # m/s, one deviation: a speed that is less sure is not told as valid; as PX4's COM_VEL_FS_EVH
_LEAN_SURE = radians(5.0)  # one deviation: a twelfth of the weight pushes sideways unseen
_ORBIT_CHECKED = 36  # places of a circle that must be inside the fence
_MESSAGES = 200  # kept

Fault = Callable[[InjectFault], None]


class Trust(NamedTuple):
    """How far what the autopilot flies with can be believed.

    ``place``, ``height``: something measures them; ``speed``, ``climb``, ``attitude``: known to less than 1 m/s and
    5 degrees, measured or carried on.  Then the sensors that are believed themselves, and the standard deviations of
    the estimates: m and m/s per axis, m, m/s, rad.
    """

    place: bool = True
    speed: bool = True
    height: bool = True
    climb: bool = True
    attitude: bool = True
    gyro: bool = True
    accelerometer: bool = True
    barometer: bool = True
    gnss: bool = True
    attitude_sensor: bool = True
    place_m: float = nan
    speed_m_s: float = nan
    height_m: float = nan
    climb_m_s: float = nan
    attitude_rad: float = nan


class Status(NamedTuple):
    """What there is to tell at one instant."""

    k: int
    mode: Mode
    armed: bool
    landed: LandedState
    engines: EngineState
    ready: bool
    refusals: tuple[str, ...]  # why arming would be refused
    home: Home | None
    fix: Fix
    target: Home | None  # where it is on its way to or stays
    track: Pair | None  # the set-point of position on the way there, m
    altitude: float  # asked for, m; the last one where the height is not held
    yaw: float  # asked for, rad
    mission_count: int
    mission_current: int
    mission_reached: int  # the last item that was finished, -1: none
    mission_done: bool
    failsafe: str  # what is being acted upon; empty: nothing
    remaining: float | None  # share of fuel or battery, None: not known
    sticks_fresh: bool
    link_lost: bool
    zones: tuple[FenceZone, ...] = ()  # of the fence that was drawn
    rally: tuple[RallyPoint, ...] = ()
    orbit: Orbit | None = None  # that it flies; ``target`` is its centre
    positioned: bool = True  # fixes of the GNSS come
    seen: Measured | None = None  # what it flies with: attitude, rates, height and climb as estimated
    trust: Trust = Trust()


class Autopilot:
    """Modes, arming, guidance, mission and failsafes of one vehicle.

    ``hover``: the collective at which it hovers.  ``controller`` and ``delay`` (samples; None without a model) are
    what the rate loops fly with at the start; ``predictors`` makes others.  ``inject`` and ``clear`` are called for
    faults by command, and may raise InputError.  ``airborne``: the flight begins in the air, armed, holding.
    ``idle``: thrust of an engine without throttle, as a share of what full throttle adds to it.  ``answer``: delay
    and lag [s] with which the thrust answers, about hover and the longest.  ``noisy``: the sensors have their noise, by
    which a receiver that has stopped is told from one that stands.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        step: float,
        hover: float,
        controller: str,
        delay: float | None,
        attitude: AttitudeController,
        altitude: AltitudeController,
        rate: RateController,
        predictors: PredictorMaker,
        inject: Fault | None = None,
        clear: Callable[[], None] | None = None,
        airborne: bool = False,
        idle: float = 0.0,
        answer: tuple[float, float] = (0.2, 0.2),
        noisy: bool = True,
    ) -> None:
        gains, settings = vehicle.control.position, vehicle.control.pilot
        if gains is None or settings is None:
            missing = "position" if gains is None else "pilot"
            raise InputError(
                f"vehicle.control.{missing} is missing: {vehicle.name} cannot be flown from a ground station"
            )
        slowest = min(vehicle.control.attitude.gain_1_s[:2])
        if gains.velocity_1_s > slowest / _APART or gains.position_1_s > gains.velocity_1_s / 2.0:
            raise InputError(
                f"vehicle.control.position: velocity_1_s {gains.velocity_1_s:g} and position_1_s "
                f"{gains.position_1_s:g} are too fast for {vehicle.name}, whose attitude gain is {slowest:g} 1/s: at "
                f"most {slowest / _APART:.3g}, and at most half of velocity_1_s"
            )
        self._dt = step
        self._hover = hover
        self._limits = vehicle.control.allocation
        self.parameters = Parameters(table(vehicle.control, settings, controller, delay))
        position = PositionController(gains, step)
        tracker = Tracker(settings.acceleration_m_s2, settings.jerk_m_s3, step)
        blocks = Blocks(attitude, altitude, rate, position, tracker, predictors)
        self._live = Live(self.parameters, vehicle.control, blocks, step)
        gnss = vehicle.sensors.gnss
        noisy = noisy and max(gnss.position_noise_m, gnss.velocity_noise_m_s) > 0.0
        self._estimator = Estimator(gains, gnss, step, noisy, Reckoning(vehicle.sensors, step))
        self._settled = round(_SETTLED_EPOCHS_S / step)
        self._margins = thrust_margins(hover, idle, self._limits.throttle_min, self._limits.throttle_max)
        self._heights = self._height_limits()
        self._guide = Guide(tracker, position, self.parameters, self._heights, step)
        self._floor = Floor(hover, idle, self._limits.throttle_min, self._limits.throttle_max, *answer, step)
        self._vehicle, self._idle = vehicle, idle
        # a flight that begins in the air knows the ground as 0: it stands on its legs there
        self._standing = max((each.position_m[2] for each in vehicle.contacts if each.kind == "leg"), default=0.0)
        self._shaper = Shaper(self._attitude_limits(), step)
        self._senses = Senses(vehicle.sensors, step, slowest)
        self._touchdown = Touchdown(hover, step, idle, settings.spool_s)
        self._watch = Watch(self.parameters, hover, step, self._failsafe)
        self._inject, self._clear = inject, clear
        self._airborne = airborne
        self.mission = Mission()
        self.rally: tuple[RallyPoint, ...] = ()
        self.reset()

    def reset(self, measured: Measured | None = None) -> None:
        """As at the start, where the sensors say ``measured``; parameters and mission stay."""
        self.mode = Mode.HOLD
        self.armed = self._airborne
        self.landed = LandedState.IN_AIR if self._airborne else LandedState.ON_GROUND
        self.engines = EngineState.FLY if self._airborne else EngineState.IDLE
        self.home: Home | None = None
        self.failsafe = ""
        self.messages: deque[Message] = deque(maxlen=_MESSAGES)
        self._said = 0
        self._k = -1
        self._measured = measured
        self._senses.reset(measured)
        if measured is not None:
            self._estimator.reset((measured.position[0], measured.position[1]))
        self._report = Report(not self._airborne, 0.0)
        self._euler: Vector3 = (0.0, 0.0, 0.0) if measured is None else to_euler(measured.attitude)
        self._fix = self._estimator.fix
        self._home_given = False
        self._cruise: float | None = None
        self._sticks: Sticks | None = None
        self._sticks_at = self._setpoint_at = -(10**9)
        self._setpoint: OffboardAttitude | OffboardVelocity | OffboardPosition | None = None
        self._began = 0  # the step of arming, of the begin of a take-off, or of standing again
        self._takeoff_to: float | None = None  # height above home
        self._settling: float | None = None  # collective while the thrust is taken away
        self._disarming = False  # as soon as it stands
        self._flew = self._airborne  # since arming
        self._doubted = 0.0  # s for which the legs have reported a ground that cannot be there
        self._ground = self._standing if self._airborne else 0.0  # height on its legs where it last took off
        self._left: Pair | None = None  # where that was
        self._phase = 0  # of RTL and of a mission's landing
        self._return_to: Pair | None = None  # where the return lands; None: it has not begun
        self._orbit: Orbit | None = None
        self._turned = 0.0  # rad round the centre, on the circle
        self._bearing: float | None = None  # from the centre a step ago; None: not on the circle
        self._climb_to: float | None = None  # height to reach before a mission leaves the place of its take-off
        self._descending = False
        self._place: Pair | None = None  # where to; None: where it comes to rest
        self._height: float | None = None  # how high
        self._heading: float | None = None  # None: as it is
        self._guide.reset()
        self._shaper.reset()
        self._floor.level(self._hover if self._airborne else self._limits.throttle_min)
        self._touchdown.reset()
        self._watch.reset()

    # --- requests ----------------------------------------------------------------------------------------------

    def handle(self, request: Request, k: int) -> Answer:
        """Take a request before step ``k``.  Never raises for what a ground station may send."""
        handler = _HANDLERS.get(type(request))
        if handler is None:
            return _no(Result.UNSUPPORTED, f"{type(request).__name__} is not known here")
        try:
            answer: Answer = handler(self, request, k)
        except InputError as error:
            return _no(Result.DENIED, str(error))
        return answer

    def _arm(self, request: Arm, k: int) -> Answer:
        if self.armed:
            return _yes("already armed")
        flying = self.landed is not LandedState.ON_GROUND
        if flying and not request.force:
            return _no(Result.DENIED, "arming refused: it is in the air")
        reasons = self.refusals()
        if reasons and not request.force:
            self._say(k, Severity.ERROR, f"arming refused: {reasons[0]}")
            return _no(Result.DENIED, f"arming refused: {'; '.join(reasons)}")
        self.armed = True
        self.engines = EngineState.FLY if flying else EngineState.IDLE
        self._cruise = None
        self.failsafe = ""
        self._flew = flying
        self._began = k
        if flying:
            self._enter(Mode.HOLD, k)
        else:
            self._touchdown.reset()
            if not self._home_given:
                self._home_here()
        self._say(k, Severity.INFO, "armed")
        return _yes()

    def refusals(self) -> tuple[str, ...]:
        """Every reason for which arming would be refused now."""
        measured = self._measured
        if measured is None:
            return ("no measurements yet",)
        found = []
        limit = self.parameters["HJ_ARM_LEAN"]
        roll, pitch, _ = self._euler
        lean = degrees(max(abs(roll), abs(pitch)))
        if lean > limit:
            found.append(f"not level: leans {lean:.0f} deg, {limit:g} deg are allowed")
        if max(abs(rate) for rate in measured.rate) > _MOVING:
            found.append("it is being moved")
        if self._report.lost:
            found.append(f"engine {', '.join(map(str, self._report.lost))} failed")
        remaining = self._watch.remaining
        if remaining is not None and 100.0 * remaining <= self.parameters["HJ_FUEL_CRIT"]:
            found.append(f"fuel or battery at {100.0 * remaining:.0f} %")
        if self.home is None:
            found.append("no home: waiting for the position")
        if self.landed is not LandedState.ON_GROUND:
            found.append("it is in the air")
        found.extend(self._senses.failed)
        if blind := self._blind(self.mode):
            found.append(blind)
        if self.mode in BY_STICK:
            if not self._sticks_fresh():
                found.append(f"mode {self.mode.value} needs sticks, and there are none")
            elif self._sticks is not None and self.mode in DIRECT and self._sticks.throttle > _STICK_LOW:
                found.append("the throttle stick is not down")
        if self.mode is Mode.OFFBOARD and not self._setpoint_fresh():
            found.append("mode OFFBOARD needs set-points, and there are none")
        return tuple(found)

    def _blind(self, mode: Mode) -> str:
        """Why a mode cannot be flown from the ground for want of a position; empty: it can."""
        by_thrust = mode is Mode.OFFBOARD and isinstance(self._setpoint, OffboardAttitude)
        if self._estimator.silent <= _BLIND_S or mode in (*DIRECT, Mode.ALTCTL) or by_thrust:
            return ""
        return f"mode {mode.value} needs the position, and the GNSS receiver has stopped"

    def _disarm(self, request: Disarm, k: int) -> Answer:
        if not self.armed:
            return _yes("already disarmed")
        if self.landed is LandedState.ON_GROUND or self._on_legs():
            self._stand_down(k, "disarmed")
            return _yes()
        if request.force:
            return self._shut_off(k)
        if self._touchdown.bouncing:
            # the legs say so, and nothing else yet: the thrust goes first
            self._enter(Mode.LAND, k)
            self._disarming = True
            return _yes("disarms when it stands")
        return _no(Result.DENIED, "disarming refused: it is in the air")

    def _on_legs(self) -> bool:
        """On the ground by more than the switch's word, whatever the engines do."""
        if self.landed is LandedState.TAKING_OFF:
            return not self._touchdown.off and self._altitude() < self._ground + _LIFT_M
        return self._touchdown.touching and self._touchdown.carried

    def _kill(self, request: Kill, k: int) -> Answer:
        if self.landed is not LandedState.ON_GROUND and not request.force and not self._on_legs():
            return _no(Result.DENIED, "kill refused: it is in the air, and force was not given")
        return self._shut_off(k)

    def _shut_off(self, k: int) -> Answer:
        self.armed = False
        self.engines = EngineState.OFF
        self._settling = None
        self._say(k, Severity.CRITICAL, "engines shut off")
        return _yes()

    def _set_mode(self, request: SetMode, k: int) -> Answer:
        try:
            mode = Mode(request.mode)
        except ValueError:
            known = ", ".join(mode.value for mode in Mode)
            return _no(Result.UNSUPPORTED, f"mode {request.mode!r} is not one of {known}")
        if mode is Mode.TAKEOFF:
            return self._take_off(Takeoff(), k)
        if mode is Mode.LAND:
            return self._land(Land(), k)
        if mode is Mode.RTL:
            return self._return(ReturnHome(), k)
        if mode is Mode.MISSION:
            return self._start_mission(MissionStart(), k)
        if mode is Mode.HOLD:
            return self._stop(Hold(), k)
        if mode is Mode.ORBIT:
            return _no(Result.DENIED, "ORBIT is begun by a command that names its radius")
        if mode is Mode.OFFBOARD and not self._setpoint_fresh():
            return _no(Result.TEMPORARILY_REJECTED, "OFFBOARD needs a set-point that is not old, send those first")
        if mode in BY_STICK and self._flying() and not self._sticks_fresh():
            return _no(Result.TEMPORARILY_REJECTED, f"{mode.value} needs sticks, and there are none")
        self._enter(mode, k)
        return _yes()

    def _take_off(self, request: Takeoff, k: int) -> Answer:
        height = request.altitude_m if request.altitude_m is not None else self.parameters["MIS_TAKEOFF_ALT"]
        if self._flying():
            return _no(Result.DENIED, "take-off refused: already flying")
        if blind := self._blind(Mode.TAKEOFF):
            return _no(Result.DENIED, f"take-off refused: {blind}")
        if height < _LOWEST_M:
            return _no(Result.DENIED, f"take-off refused: {height:g} m, at least {_LOWEST_M:g} m above home are needed")
        home = self.home or Home(*self._fix.position, self._altitude())
        if home.altitude + height < self._altitude() + _LIFT_M:
            below = self._altitude() - home.altitude
            return _no(
                Result.DENIED, f"take-off refused: {height:g} m above home, and it stands {below:.1f} m above it"
            )
        why = self._watch.outside(*self._fix.position, home.altitude + height, home)
        if why:
            return _no(Result.DENIED, f"take-off refused: {why}")
        self._enter(Mode.TAKEOFF, k)
        self._takeoff_to = height
        self._flew = False
        self._began = k
        return _yes("" if self.armed else "begins when armed")

    def _land(self, request: Land, k: int) -> Answer:
        if not self._flying():
            return _no(Result.TEMPORARILY_REJECTED, "landing refused: it is on the ground")
        self._enter(Mode.LAND, k)
        return _yes()

    def _return(self, request: ReturnHome, k: int) -> Answer:
        if not self._flying():
            return _no(Result.TEMPORARILY_REJECTED, "return refused: it is on the ground")
        if self.home is None:
            return _no(Result.DENIED, "return refused: there is no home")
        self._enter(Mode.RTL, k)
        return _yes()

    def _goto(self, request: Goto, k: int) -> Answer:
        if not self._flying():
            return _no(Result.TEMPORARILY_REJECTED, "goto refused: it is on the ground")
        place, altitude = self._place, request.altitude
        if self.mode is not Mode.HOLD:
            place = None
        if request.north is not None or request.east is not None:
            north, east = place or self._fix.position
            place = (
                request.north if request.north is not None else north,
                request.east if request.east is not None else east,
            )
        if altitude is None:
            altitude = self._height if self._height is not None else self._stop_height()
        ground = min(self._home_altitude(), self._ground)
        if request.altitude is not None and altitude < ground + _LOWEST_M:
            above = altitude - ground
            return _no(
                Result.DENIED, f"goto refused: {above:.1f} m above the ground, at least {_LOWEST_M:g} m are needed"
            )
        why = self._watch.outside(*(place or self._fix.position), altitude, self.home)
        if why:
            return _no(Result.DENIED, f"goto refused: {why}")
        if request.speed:
            answer = self._set_speed(SetSpeed(request.speed), k)
            if not answer.accepted:
                return answer
        heading = self._heading if request.yaw is None and self.mode is Mode.HOLD else request.yaw
        if self.mode is not Mode.HOLD:
            self._enter(Mode.HOLD, k)
        self._new_place(place, altitude, heading)
        return _yes()

    def _begin_orbit(self, request: Orbit, k: int) -> Answer:
        if not self._flying():
            return _no(Result.TEMPORARILY_REJECTED, "orbit refused: it is on the ground")
        limit = self.parameters.table["MPC_XY_VEL_MAX"]
        if request.speed is not None and not limit.least <= request.speed <= limit.most:
            return _no(
                Result.DENIED, f"orbit refused: speed {request.speed:g} m/s, from {limit.least:g} to {limit.most:g} m/s"
            )
        here = self._fix.position
        centre = here if request.north is None or request.east is None else (request.north, request.east)
        altitude = request.altitude if request.altitude is not None else self._stop_height()
        ground = min(self._home_altitude(), self._ground)
        if altitude < ground + _LOWEST_M:
            return _no(Result.DENIED, f"orbit refused: at least {_LOWEST_M:g} m above the ground are needed")
        if why := self._circle_outside(centre, request.radius, altitude):
            return _no(Result.DENIED, f"orbit refused: {why}")
        self._enter(Mode.ORBIT, k)
        self._aim_round(request, centre, altitude)
        return _yes()

    def _circle_outside(self, centre: Pair, radius: float, altitude: float) -> str:
        """Where a circle leaves the fence, in words; empty: it does not."""
        for n in range(_ORBIT_CHECKED):
            angle = 2.0 * pi * n / _ORBIT_CHECKED
            place = (centre[0] + radius * cos(angle), centre[1] + radius * sin(angle))
            if why := self._watch.outside(*place, altitude, self.home):
                return why
        return ""

    def _aim_round(self, orbit: Orbit, centre: Pair, altitude: float) -> None:
        self._orbit = orbit
        self._new_place(centre, altitude, self._euler[2])
        self._turned, self._bearing = 0.0, None

    def _fly_orbit(self, k: int) -> Command:
        command = self._fly_round()
        if self._turned_enough():
            self._say(k, Severity.INFO, "orbit complete")
            self._enter(Mode.HOLD, k)
        return command

    def _turned_enough(self) -> bool:
        return self._orbit is not None and 0.0 < 2.0 * pi * self._orbit.turns <= self._turned

    def _fly_round(self) -> Command:
        """Round the centre; the turns count once it is on the circle."""
        assert self._orbit is not None
        assert self._place is not None
        assert self._height is not None
        orbit, guide, (north, east) = self._orbit, self._guide, self._fix.position
        n, e = north - self._place[0], east - self._place[1]
        speed = orbit.speed if orbit.speed is not None else self._speed()
        lean = guide.around(self._place, orbit.radius, speed, orbit.clockwise)
        held = guide.to_height(self._height, self.parameters["HJ_CLIMB_AUTO"], self.parameters["HJ_DESC_AUTO"])
        self._descending = self._height < held
        bearing = atan2(e, n)
        if orbit.yaw is OrbitYaw.CENTRE:
            heading = atan2(-e, -n)
        elif orbit.yaw is OrbitYaw.TANGENT:
            heading = wrap(bearing + (0.5 * pi if orbit.clockwise else -0.5 * pi))
        else:
            heading = self._heading if self._heading is not None else self._euler[2]
        command = guide.command(lean, held, guide.to_yaw(heading))
        if self._bearing is not None:
            self._turned += wrap(bearing - self._bearing) * (1.0 if orbit.clockwise else -1.0)
        self._bearing = bearing if abs(hypot(n, e) - orbit.radius) < max(1.0, 0.1 * orbit.radius) else None
        return command

    def _stop(self, request: Hold, k: int) -> Answer:
        if self.mode is Mode.HOLD and self._place is None:
            # it stops or has stopped: asking again does not move where it stays
            self.failsafe = ""
            return _yes()
        self._enter(Mode.HOLD, k)
        return _yes()

    def _set_speed(self, request: SetSpeed, k: int) -> Answer:
        limit = self.parameters.table["MPC_XY_VEL_MAX"]
        if not limit.least <= request.m_s <= limit.most:
            return _no(Result.DENIED, f"speed {request.m_s:g} m/s refused: from {limit.least:g} to {limit.most:g} m/s")
        self._cruise = request.m_s
        return _yes()

    def _set_home(self, request: SetHome, k: int) -> Answer:
        north, east = self._fix.position
        self.home = Home(
            request.north if request.north is not None else north,
            request.east if request.east is not None else east,
            request.altitude if request.altitude is not None else self._altitude(),
        )
        self._home_given = True
        return _yes()

    def _take_sticks(self, request: Sticks, k: int) -> Answer:
        self._sticks, self._sticks_at = request, k
        return _yes()

    def _take_setpoint(self, request: OffboardAttitude | OffboardVelocity | OffboardPosition, k: int) -> Answer:
        self._setpoint, self._setpoint_at = request, k
        return _yes()

    def _upload(self, request: MissionUpload, k: int) -> Answer:
        if self.mode is Mode.MISSION and self.armed:
            return _no(Result.TEMPORARILY_REJECTED, "upload refused: the mission is being flown")
        for index, item in enumerate(request.items):
            if item.north is not None and item.east is not None:
                height = item.altitude if item.altitude is not None else self._altitude()
                place = (item.north, item.east)
                if item.kind is ItemKind.CIRCLE and item.radius is not None:
                    why = self._circle_outside(place, item.radius, height)
                else:
                    why = self._watch.outside(*place, height, self.home)
                if why:
                    return _no(Result.DENIED, f"mission item {index} refused: {why}")
        self.mission.load(request.items)
        return _yes()

    def _draw_fence(self, request: FenceUpload, k: int) -> Answer:
        before, self._watch.zones = self._watch.zones, request.zones
        if self._flying():
            why = self._watch.outside(*self._fix.position, self._altitude(), self.home)
            if why:
                self._watch.zones = before
                return _no(Result.DENIED, f"fence refused: it would be outside at once ({why})")
        return _yes()

    def _set_rally(self, request: RallyUpload, k: int) -> Answer:
        for index, point in enumerate(request.points):
            why = self._watch.outside(point.north, point.east, self._home_altitude(), self.home)
            if why:
                return _no(Result.DENIED, f"rally point {index} refused: {why}")
        self.rally = request.points
        return _yes()

    def _start_mission(self, request: MissionStart, k: int) -> Answer:
        if not self.mission.items:
            return _no(Result.DENIED, "there is no mission")
        if not self._flying() and (blind := self._blind(Mode.MISSION)):
            return _no(Result.DENIED, f"mission refused: {blind}")
        if self.mission.done:
            self.mission.restart(0)
        self._enter(Mode.MISSION, k)
        if not self._flying():
            self._flew = False
        self._begin_item(k)
        return _yes("" if self.armed else "begins when armed")

    def _set_current(self, request: MissionSetCurrent, k: int) -> Answer:
        count = len(self.mission.items)
        if request.index >= count:
            return _no(Result.DENIED, f"mission item {request.index}: there are {count}")
        self.mission.restart(request.index)
        if self.mode is Mode.MISSION:
            self._begin_item(k)
        return _yes()

    def _clear_mission(self, request: MissionClear, k: int) -> Answer:
        self.mission.load(())
        if self.mode is Mode.MISSION:
            self._enter(Mode.HOLD, k)
        return _yes()

    def _set_parameter(self, request: SetParameter, k: int) -> Answer:
        self._live.set(request.name, request.value)
        if request.name.startswith(_SHAPING):
            self._shaper.limit(self._attitude_limits())
        if request.name in _CLIMBING:
            self._heights = self._height_limits()
            self._guide.limit(self._heights)
        return _yes()

    def _inject_fault(self, request: InjectFault, k: int) -> Answer:
        if not self.parameters["SYS_FAILURE_EN"]:
            return _no(Result.DENIED, "failures on request are off (SYS_FAILURE_EN)")
        if self._inject is None:
            return _no(Result.UNSUPPORTED, "nothing here can fail on request")
        self._inject(request)
        self._say(k, Severity.WARNING, f"fault on request: {request.fault}")
        return _yes()

    def _clear_faults(self, request: ClearFaults, k: int) -> Answer:
        if self._clear is None:
            return _no(Result.UNSUPPORTED, "nothing here can fail on request")
        self._clear()
        return _yes()

    def _link_lost(self, request: LinkLost, k: int) -> Answer:
        self._watch.lost_link(k)
        self._say(k, Severity.WARNING, "ground station lost")
        return _yes()

    def _link_back(self, request: LinkBack, k: int) -> Answer:
        self._watch.found_link()
        self._say(k, Severity.INFO, "ground station is back")
        return _yes()

    # --- one step ----------------------------------------------------------------------------------------------

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        """The command of step ``k``; :attr:`engines` says what the engines do with it."""
        command = self._decide(k, measured, report)
        if self.engines is not EngineState.FLY:
            self._shaper.reset()
            self._floor.level(self._limits.throttle_min)
            return command
        attitude, rate = command.attitude, command.rate
        if rate is not None:
            rate = self._shaper.rate(rate, self._euler)
        else:
            attitude = self._shaper.attitude(attitude, self._euler)
        return command._replace(attitude=attitude, rate=rate, collective=self._caught(k, command.collective))

    def _caught(self, k: int, collective: float | None) -> float | None:
        """The collective that was asked for, or what it takes not to hit the ground."""
        if collective is None or self._settling is not None or not self._flies_thrust():
            # nothing was allocated before the first step
            if k > 0:
                self._floor.level(self._report.collective)
            return collective
        if not self._touchdown.off:
            return self._floor.slowed(collective)
        measured, fuel, remaining = self._now(), self._vehicle.fuel, self._report.remaining
        _, x, y, _ = measured.attitude
        weight = 1.0
        if fuel is not None and remaining is not None:
            weight -= fuel.mass_kg * (1.0 - remaining) / self._vehicle.mass_kg
        return self._floor.under(
            collective,
            measured.altitude - self._ground,
            measured.velocity[2],
            self.parameters["MPC_LAND_SPEED"],
            1.0 - 2.0 * (x * x + y * y),
            weight,
        )

    def _decide(self, k: int, measured: Measured, report: Report) -> Command:
        """What is asked for at step ``k``, steps and all."""
        still = self.landed is LandedState.ON_GROUND
        measured = self._senses.update(k, measured, still)
        self._k, self._measured, self._report = k, measured, report
        self._euler = to_euler(measured.attitude)
        flying = self._flying()
        grounded = self.landed is LandedState.ON_GROUND or (
            self.landed is LandedState.TAKING_OFF and not self._touchdown.off
        )
        inertial = self._senses.inertial
        lean = 0.0 if inertial.has_attitude else inertial.deviation
        self._fix = self._estimator.update(k, measured, grounded, lean)
        if self.home is None and k >= self._settled and not flying:
            self._home_here()
        elif self.home is None and flying:
            # the flight began in the air
            self.home = Home(*self._fix.position, 0.0)
        self._guide.begin(k, measured, self._euler[2], self._fix, self._sink_allowed())
        sure = self.landed is LandedState.IN_AIR and not self._descending
        self._touchdown.update(measured.velocity[2], self._senses.lift, report, self._descending, sure)
        self._watch.consume(report, self.engines is EngineState.FLY)
        self._look(k, measured, report)
        self._descending = False
        if self.engines is EngineState.OFF or not self.armed:
            return self._unarmed(k)
        if self.landed is LandedState.ON_GROUND:
            return self._on_ground(k)
        if self.landed is LandedState.TAKING_OFF:
            return self._taking_off(k)
        return self._in_air(k)

    def _look(self, k: int, measured: Measured, report: Report) -> None:
        """Everything that may end what is being done."""
        if not self.armed:
            return
        if self._watch.tipped(measured):
            if self.landed in (LandedState.ON_GROUND, LandedState.TAKING_OFF):
                self._say(k, Severity.CRITICAL, "tipped over")
                self._shut_off(k)
            elif not self.failsafe.startswith("leans"):
                self._say(k, Severity.CRITICAL, "leans as if control were lost")
                self.failsafe = "leans as if control were lost"
            return
        if self._flying():
            # what was taken over is watched anew
            acting = self.failsafe.startswith(OUTSIDE)
            self._watch.update(k, measured, self._fix, self.home, report, acting)
            self._watch.sensors(self._senses.failed)
            if self._estimator.silent > _BLIND_S and self.mode not in (*DIRECT, Mode.ALTCTL, Mode.LAND):
                self._failsafe(LAND, "position lost")
        if self.mode in BY_STICK and self._flying() and not self._sticks_fresh():
            self._say(k, Severity.WARNING, "sticks lost, holding")
            self._enter(Mode.HOLD, k)
        if self.mode is Mode.OFFBOARD and not self._setpoint_fresh():
            self._say(k, Severity.WARNING, "no more set-points, holding")
            self._enter(Mode.HOLD, k)

    def _unarmed(self, k: int) -> Command:
        if self.landed is not LandedState.ON_GROUND and self._touchdown.standing:
            self.landed = LandedState.ON_GROUND
        return self._idle_command()

    def _on_ground(self, k: int) -> Command:
        """Armed and standing: waits for a reason to leave, not for ever."""
        if self._wants_up():
            self._leave_ground(k)
            return self._taking_off(k)
        self.engines = EngineState.IDLE
        wait = self.parameters["HJ_DISARM_LAND" if self._flew else "HJ_DISARM_IDLE"]
        if (k - self._began) * self._dt >= wait and (wait > 0.0 or self._flew):
            self._stand_down(k, "landed, disarmed" if self._flew else "not taken off, disarmed")
        return self._idle_command()

    def _leave_ground(self, k: int) -> None:
        self.landed = LandedState.TAKING_OFF
        self.engines = EngineState.FLY
        self._began = k
        self._ground = self._altitude()
        self._left = self._fix.position
        item = self.mission.item
        self._climb_to = None
        if self.mode is Mode.MISSION and item is not None and item.kind is not ItemKind.TAKEOFF:
            height = self._home_altitude() + self.parameters["MIS_TAKEOFF_ALT"]
            self._climb_to = height if item.altitude is None else min(height, item.altitude)
        self._touchdown.reset()
        self._guide.reset()
        self._guide.begin(k, self._now(), self._euler[2], self._fix, self._sink_allowed())

    def _wants_up(self) -> bool:
        """Does what is asked for need the vehicle to leave the ground?"""
        mode, sticks, wanted = self.mode, self._sticks, self._setpoint
        if mode is Mode.TAKEOFF:
            return not self._flew
        if mode is Mode.MISSION:
            item = self.mission.item
            return item is not None and (not self._flew or item.kind is ItemKind.TAKEOFF)
        if mode in BY_STICK and sticks is not None and self._sticks_fresh():
            return sticks.throttle > (_STICK_LOW if mode in DIRECT else _STICK_UP)
        if mode is Mode.OFFBOARD:
            if isinstance(wanted, OffboardAttitude):
                return wanted.thrust > _STICK_LOW
            if isinstance(wanted, OffboardVelocity):
                return wanted.down < -_OFFBOARD_UP
            if isinstance(wanted, OffboardPosition):
                return -wanted.down > self._altitude() + _LIFT_M
        return False

    def _taking_off(self, k: int) -> Command:
        """From idle to the air: thrust up to that of hover, then a climb, level until the legs are free."""
        above = self._altitude() - self._ground
        clear = above - 3.0 * self._senses.vertical.deviation[0] > _CLEAR_M
        if clear or (self._touchdown.off and above > _LIFT_M):
            stuck = not self._touchdown.off
            self.landed = LandedState.IN_AIR
            self._flew = True
            self._touchdown.reset()
            self._touchdown.switch_failed = stuck
            return self._in_air(k)
        if not self._wants_up():
            return self._give_up(k, "")
        if self._flies_thrust():
            return self._by_mode(k)
        since = (k - self._began) * self._dt
        spool = self.parameters["HJ_SPOOL_TIME"]
        if since > spool + _LIFT_S:
            return self._give_up(k, "did not leave the ground")
        yaw = self._guide.to_yaw(None)
        if since < spool:
            low = self._limits.throttle_min
            return Command((0.0, 0.0, yaw), self._altitude(), None, low + (self._hover - low) * since / spool)
        return self._guide.command((0.0, 0.0), self._guide.at_climb(self.parameters["HJ_CLIMB_AUTO"]), yaw)

    def _give_up(self, k: int, why: str) -> Command:
        """Off the take-off: in the air already, or back to standing; with a reason, disarmed."""
        if self._touchdown.off:
            self.landed = LandedState.IN_AIR
            return self._in_air(k)
        self._touch_ground(k)
        if why:
            self._say(k, Severity.ERROR, why)
            self._stand_down(k, "disarmed")
        return self._idle_command()

    def _in_air(self, k: int) -> Command:
        measured = self._now()
        sink = measured.velocity[2]
        touched = self._touched(k)
        if self._settling is None and self.mode is Mode.HOLD and self._place is None and touched:
            # nobody asked it to leave the ground
            self._settling, self.landed = self._report.collective, LandedState.LANDING
        down = touched and sink < _SETTLE_SINK
        if self._settling is not None:
            if down:
                return self._settle(k, self._settling)
            self._settling = None
        command = self._by_mode(k)
        if self._flies_thrust():
            if touched and self._touchdown.standing:
                self._touch_ground(k)
        elif self._descending and down:
            self._settling = self._report.collective
            self.landed = LandedState.LANDING
        elif self.landed is LandedState.LANDING and not self._descending:
            self.landed = LandedState.IN_AIR
        return command

    def _touched(self, k: int) -> bool:
        """The legs report the ground where there can be some: where the height says so, or where they carry weight.

        A switch that goes on reporting it anywhere else is broken, and is asked no more.
        """
        if not self._touchdown.touching or self._near_ground() or self._touchdown.carried:
            self._doubted = 0.0
            return self._touchdown.touching or self._hopping()
        self._doubted += self._dt
        if self._doubted > _DOUBTED_S and not self._touchdown.switch_failed:
            self._touchdown.switch_failed = True
            self._say(k, Severity.WARNING, "the legs report ground in the air, their switch is ignored")
        return False

    def _near_ground(self) -> bool:
        """As low as where it took off, as far as the height is known."""
        return self._altitude() - 3.0 * self._senses.vertical.deviation[0] < self._ground + _LIFT_M

    def _hopping(self) -> bool:
        """The legs have touched a moment ago, where the ground is.

        A vehicle that drifts, or comes down fast, hops from leg to leg on nearly its own weight in thrust until it
        trips: the thrust has to go before a contact lasts.
        """
        return self._near_ground() and self._touchdown.bouncing and not self._touchdown.switch_failed

    def _settle(self, k: int, collective: float) -> Command:
        """On the ground: take the thrust away."""
        self._descending = True
        low = self._limits.throttle_min
        self._settling = collective = max(low, collective - self._dt * self._hover / _SETTLE_S)
        yaw = self._guide.to_yaw(None)
        if collective <= low and (self._touchdown.standing or self._touchdown.borne):
            disarm = self._disarming
            self._touch_ground(k)
            if disarm:
                self._stand_down(k, "disarmed")
        return Command((0.0, 0.0, yaw), self._altitude(), None, collective)

    def _touch_ground(self, k: int) -> None:
        self.landed = LandedState.ON_GROUND
        self.engines = EngineState.IDLE
        self._began = k
        self._settling = None
        self._guide.reset()
        if self.mode is Mode.MISSION and self._flew:
            self.mission.advance()
            self._begin_item(k)
        if self._flew:
            self._say(k, Severity.INFO, "landed")

    # --- what each mode wants --------------------------------------------------------------------------------------

    def _by_mode(self, k: int) -> Command:
        mode = self.mode
        if mode in BY_STICK:
            return self._by_stick(self._sticks or _CENTRED)
        if mode is Mode.OFFBOARD and self._setpoint is not None:
            return self._by_setpoint(self._setpoint)
        if mode is Mode.LAND:
            return self._descend()
        if mode is Mode.RTL:
            return self._fly_home()
        if mode is Mode.MISSION:
            return self._fly_mission(k)
        if mode is Mode.ORBIT:
            return self._fly_orbit(k)
        if mode is Mode.TAKEOFF:
            return self._climb_out(k)
        return self._stay()

    def _stay(self) -> Command:
        """HOLD: stop, or fly to where a goto has asked."""
        return self._fly(self._place, self._height, self._heading)

    def _climb_out(self, k: int) -> Command:
        if self._height is None:
            to = self._takeoff_to if self._takeoff_to is not None else self.parameters["MIS_TAKEOFF_ALT"]
            self._new_place(self._left, self._home_altitude() + to, None)
        assert self._height is not None
        command = self._fly(self._place, self._height, None)
        if abs(self._altitude() - self._height) < _REACHED_M:
            place, height = self._place, self._height
            self._enter(Mode.HOLD, k)
            self._new_place(place, height, None)
            self._say(k, Severity.INFO, "take-off complete")
        return command

    def _descend(self, place: Pair | None = None) -> Command:
        """Down where it is, or at ``place``."""
        self.landed = LandedState.LANDING
        self._descending = True
        lean = self._guide.towards(place, self._speed()) if place else self._guide.at_velocity((0.0, 0.0))
        rate = min(self.parameters["HJ_DESC_AUTO"], self._sink_while_braking())
        return self._guide.command(lean, self._guide.at_climb(-rate), self._guide.to_yaw(self._heading))

    def _sink_while_braking(self) -> float:
        """The most rate of descent [m/s] with which it does not touch before it has come to rest sideways.

        The set-point brakes for ``v / a + a / j``, and the vehicle follows it with ``1 / K_v``, twice that to be slow.
        """
        track, p = self._guide.track, self.parameters
        speed = 0.0 if track is None else hypot(*track.velocity)
        if speed < _SLOW:
            return inf
        left = speed / p["HJ_ACC_HOR"] + p["HJ_ACC_HOR"] / p["HJ_JERK_HOR"] + 2.0 / max(p["HJ_VEL_P"], 0.1)
        return max(0.0, self._altitude() - max(self._home_altitude(), self._ground)) / left

    def _fly_home(self) -> Command:
        """RTL: up, home, down."""
        home = self.home or Home(*self._fix.position, self._home_altitude())
        begins = self._return_to is None
        place = self._return_to = self._return_to or self._nearest(home)
        away = hypot(self._fix.position[0] - place[0], self._fix.position[1] - place[1])
        if begins or self._height is None:
            near = away < _NEAR_HOME_M
            height = home.altitude + self.parameters["RTL_RETURN_ALT"]
            height = max([height, *(p.altitude for p in self.rally if (p.north, p.east) == place)])
            self._height = self._stop_height() if near else max(self._stop_height(), height)
            self._phase = 1 if near else 0
        if self._phase == 0 and self._altitude() > self._height - _REACHED_M:
            self._phase = 1
        if self._phase == 1 and away < _RETURNED_M and hypot(*self._fix.velocity) < _SLOW:
            self._phase = 2
        if self._phase == 2:
            return self._descend(place)
        return self._fly(place if self._phase else None, self._height, self._heading)

    def _nearest(self, home: Home) -> Pair:
        """Home, or the rally point that is nearer."""
        n, e = self._fix.position
        places = [(home.north, home.east), *((point.north, point.east) for point in self.rally)]
        return min(places, key=lambda place: hypot(place[0] - n, place[1] - e))

    def _fly_mission(self, k: int) -> Command:
        item = self.mission.item
        if item is None:
            self._say(k, Severity.INFO, "mission finished")
            place, height = self._place, self._height
            self._enter(Mode.HOLD, k)
            self._new_place(place, height, None)
            return self._stay()
        if self._climb_to is not None:
            if self._altitude() < self._climb_to - _REACHED_M:
                return self._fly(None, self._climb_to, None)
            self._climb_to = None
        if item.kind is ItemKind.LAND:
            place = self._place
            far = place is not None and hypot(*_minus(place, self._fix.position)) > _RETURNED_M
            if not far or self._phase == 2:
                self._phase = 2
                return self._descend(place)
        elif item.kind is ItemKind.RETURN:
            return self._fly_home()
        elif item.kind is ItemKind.CIRCLE:
            command = self._fly_round()
            if self._turned_enough():
                self._new_place(None, self._height, None)  # what names no place is flown from here, not at the centre
                self.mission.advance()
                self._begin_item(k)
            return command
        elif item.kind is ItemKind.ALTITUDE and self._phase == 0:
            radius = self.parameters["HJ_ACC_RADIUS"]
            if self._place is None or hypot(*_minus(self._place, self._fix.position)) <= radius:
                self._phase, self._height = 1, item.altitude
        elif self._reached(item, k):
            self.mission.advance()
            self._begin_item(k)
        if self._height is None:
            self._height = self._stop_height()
        return self._fly(self._place, self._height, self._heading)

    def _begin_item(self, k: int) -> None:
        """Aim at the present item; items that ask for no flight are over at once."""
        for _ in range(len(self.mission.items) + 1):
            item = self.mission.skip_jumps()
            if item is None or item.kind is not ItemKind.SPEED:
                break
            self._cruise = item.speed
            self.mission.advance()
        else:
            item = None
        if item is None:
            return
        self._phase = 0
        there = (item.north, item.east) if item.north is not None and item.east is not None else None
        if item.kind in (ItemKind.WAYPOINT, ItemKind.STAY):
            self._new_place(there, item.altitude, item.yaw)
        elif item.kind is ItemKind.CIRCLE and there is not None and item.altitude is not None:
            radius = item.radius or 1.0
            self._aim_round(Orbit(radius, item.clockwise, turns=item.turns), there, item.altitude)
        elif item.kind is ItemKind.ALTITUDE:
            self._new_place(there, None, None)
        elif item.kind is ItemKind.TAKEOFF:
            height = item.altitude
            if height is not None and self._flying():
                height = max(height, self._stop_height())
            self._new_place(None if self._flying() else self._fix.position, height, item.yaw)
        elif item.kind is ItemKind.LAND:
            self._new_place(there, self._height, item.yaw)
        elif item.kind is ItemKind.RETURN:
            self._new_place(None, None, None)
            self._return_to = None

    def _reached(self, item: MissionItem, k: int) -> bool:
        """Is the item done?  Waiting begins when its place is reached."""
        if item.kind is ItemKind.STAY:
            return False
        if item.kind is not ItemKind.DELAY:
            off = 0.0 if item.altitude is None else self._altitude() - item.altitude
            if off < -_REACHED_M or (off > _REACHED_M and item.kind is not ItemKind.TAKEOFF):
                return False
            if item.kind is ItemKind.WAYPOINT and self._place is not None:
                radius = item.acceptance_m or self.parameters["HJ_ACC_RADIUS"]
                if self.mission.since < 0 and hypot(*_minus(self._place, self._fix.position)) > radius:
                    return False
        if self.mission.since < 0:
            self.mission.since = k
        return (k - self.mission.since) * self._dt >= item.hold_s

    def _by_stick(self, sticks: Sticks) -> Command:
        guide, parameters = self._guide, self.parameters
        yaw = guide.at_turn(_dead(sticks.yaw) * radians(parameters["HJ_YAW_RATE"]))
        most = radians(parameters["HJ_STICK_LEAN"])
        lean = limited(sticks.roll * most, -sticks.pitch * most, most)
        if self.mode in DIRECT:
            low, high, t = self._limits.throttle_min, self._limits.throttle_max, sticks.throttle
            half = (
                2.0 * t * (self._hover - low) + low if t < 0.5 else self._hover + (2.0 * t - 1.0) * (high - self._hover)
            )
            return Command((*lean, yaw), self._altitude(), None, half)
        if self.mode is Mode.POSCTL:
            c, s, speed = cos(self._euler[2]), sin(self._euler[2]), self._speed()
            forward, right = limited(_dead(sticks.pitch) * speed, _dead(sticks.roll) * speed, speed)
            lean = guide.at_velocity((forward * c - right * s, forward * s + right * c))
        climb = _dead(2.0 * sticks.throttle - 1.0)
        rate = climb * parameters["HJ_CLIMB_AUTO" if climb > 0.0 else "HJ_DESC_AUTO"]
        self._descending = rate < 0.0
        return guide.command(lean, guide.at_climb(rate), yaw)

    def _by_setpoint(self, wanted: OffboardAttitude | OffboardVelocity | OffboardPosition) -> Command:
        guide, parameters = self._guide, self.parameters
        if isinstance(wanted, OffboardAttitude):
            quaternion = quaternion_of(wanted)
            roll, pitch, yaw = self._euler if quaternion is None else to_euler(quaternion)
            roll, pitch = limited(roll, pitch, radians(parameters["HJ_STICK_LEAN"]))
            return Command((roll, pitch, yaw), self._altitude(), wanted.rates, wanted.thrust)
        if isinstance(wanted, OffboardPosition):
            return self._fly((wanted.north, wanted.east), -wanted.down, wanted.yaw)
        up, down = parameters["HJ_SPEED_UP"], parameters["HJ_SPEED_DN"]
        climb = min(up, max(-down, -wanted.down))
        self._descending = climb < -_OFFBOARD_UP
        lean = guide.at_velocity(limited(wanted.north, wanted.east, parameters["MPC_XY_VEL_MAX"]))
        yaw = guide.to_yaw(wanted.yaw) if wanted.yaw_rate is None else guide.at_turn(wanted.yaw_rate)
        return guide.command(lean, guide.at_climb(climb), yaw)

    def _fly(self, place: Pair | None, altitude: float | None, yaw: float | None) -> Command:
        """To a place (None: stop) at a height (None: where climbing or sinking stops), with a heading (None: as is)."""
        guide = self._guide
        lean = guide.towards(place, self._speed()) if place is not None else guide.at_velocity((0.0, 0.0))
        if altitude is None:
            held = guide.at_climb(0.0)
        else:
            held = guide.to_height(altitude, self.parameters["HJ_CLIMB_AUTO"], self.parameters["HJ_DESC_AUTO"])
            self._descending = altitude < held
        return guide.command(lean, held, guide.to_yaw(yaw))

    def _attitude_limits(self) -> AttitudeLimits:
        """What the loops may be asked for with the gains of now."""
        p = self.parameters
        gain = [p[f"HJ_ATT_{axis.upper()}"] for axis in AXES]
        most = [radians(p[f"HJ_RLIM_{axis.upper()}"]) for axis in AXES]
        authority = angular_authority(self._vehicle, self._hover, self._idle, gain)
        return attitude_limits(gain, authority, radians(p["HJ_STICK_LEAN"]), radians(p["HJ_YAW_RATE"]), most)

    def _height_limits(self) -> HeightLimits:
        """What the height that is asked for may do with the gains of now."""
        p = self.parameters
        speed = max(p["HJ_CLIMB_AUTO"], p["HJ_DESC_AUTO"])
        return height_limits(p["HJ_ALT_P"], p["HJ_CLIMB_P"], speed, *self._margins)

    # --- small things ----------------------------------------------------------------------------------------------

    def _failsafe(self, action: int, reason: str) -> None:
        """Do what a parameter says, unless something at least as careful is being done."""
        self.failsafe = reason
        mode, k = self.mode, self._k
        if action == RETURN and self.home is None:
            action = LAND
        wanted = {HOLD: Mode.HOLD, RETURN: Mode.RTL, LAND: Mode.LAND}.get(action)
        careful = (Mode.HOLD, Mode.RTL, Mode.LAND)
        rank = careful.index(mode) if mode in careful else -1
        if wanted is None or rank >= careful.index(wanted):
            self._say(k, Severity.WARNING, reason)
            return
        self._enter(wanted, k)
        self.failsafe = reason
        self._say(k, Severity.CRITICAL, f"{reason}: {_DOES[wanted]}")

    def _enter(self, mode: Mode, k: int) -> None:
        if mode is not self.mode:
            self._say(k, Severity.INFO, f"mode {mode.value}")
        self.mode = mode
        self.failsafe = ""
        self._settling, self._disarming = None, False
        self._phase = 0
        self._takeoff_to = self._return_to = None
        self._new_place(None, None, None)
        if self.landed is LandedState.LANDING:
            self.landed = LandedState.IN_AIR

    def _new_place(self, place: Pair | None, height: float | None, heading: float | None) -> None:
        self._place, self._height, self._heading = place, height, heading

    def _stand_down(self, k: int, text: str) -> None:
        self.armed = False
        self.engines = EngineState.OFF
        self.landed = LandedState.ON_GROUND
        self._settling, self._disarming = None, False
        self._flew = False
        if self.mode in (Mode.TAKEOFF, Mode.LAND, Mode.RTL, Mode.MISSION):
            self._enter(Mode.HOLD, k)
        self.failsafe = ""
        self._say(k, Severity.INFO, text)

    def _home_here(self) -> None:
        self.home = Home(*self._fix.position, self._altitude())

    def _idle_command(self) -> Command:
        return Command((0.0, 0.0, self._euler[2]), self._altitude(), None, 0.0)

    def _flies_thrust(self) -> bool:
        """Is the collective asked for as such, and not by height?"""
        offboard = self.mode is Mode.OFFBOARD and isinstance(self._setpoint, OffboardAttitude)
        return offboard or self.mode in DIRECT

    def _flying(self) -> bool:
        return self.landed is not LandedState.ON_GROUND

    def _now(self) -> Measured:
        assert self._measured is not None
        return self._measured

    def _altitude(self) -> float:
        return self._measured.altitude if self._measured is not None else 0.0

    def _home_altitude(self) -> float:
        return self.home.altitude if self.home is not None else 0.0

    def _stop_height(self) -> float:
        """Where it comes to rest if climbing or sinking ends now: not nearer to the ground than it must."""
        if self._measured is None:
            return 0.0
        here = self._altitude()
        stop = here - self._measured.velocity[2] / max(self.parameters["HJ_ALT_P"], 0.1)
        if self._guide.holds_height:
            stop = self._guide.rest
        return max(stop, min(here, self._ground + _LOWEST_M))

    def _sink_allowed(self) -> float:
        """The most rate of descent [m/s] at this height, as far as it is known, where the height is controlled.

        The ground is where it took off, or home where that is higher: there is no sensor for the height above it.
        """
        p, limits = self.parameters, self._heights
        least = self._altitude() - 2.0 * self._senses.vertical.deviation[0]
        above = least - max(self._home_altitude(), self._ground)
        return descent_for(above - p["HJ_LAND_SLOW_H"], limits.braking, limits.late, p["MPC_LAND_SPEED"])

    @property
    def seen(self) -> Measured:
        """What the loops are to fly the present step with."""
        return self._now()

    def _speed(self) -> float:
        return self._cruise if self._cruise is not None else self.parameters["MPC_XY_VEL_MAX"]

    def _sticks_fresh(self) -> bool:
        return (self._k - self._sticks_at) * self._dt <= self.parameters["HJ_STICK_TIME"]

    def _setpoint_fresh(self) -> bool:
        return (self._k - self._setpoint_at) * self._dt <= self.parameters["HJ_OFFB_TIME"]

    def _say(self, k: int, severity: Severity, text: str) -> None:
        if text:
            self._said += 1
            self.messages.append(Message(self._said, k, severity, text))

    @property
    def status(self) -> Status:
        """The state after the last step, for telemetry."""
        refusals = () if self.armed else self.refusals()
        place, track = self._place, self._guide.track
        if place is None and track is not None:
            place = track.position
        target = None
        if place is not None and self._flying():
            height = self._height
            target = Home(*place, height if height is not None else self._guide.altitude)
        return Status(
            self._k,
            self.mode,
            self.armed,
            self.landed,
            self.engines,
            not refusals,
            refusals,
            self.home,
            self._fix,
            target,
            track.position if track else None,
            self._guide.altitude,
            self._guide.yaw,
            len(self.mission.items),
            self.mission.current,
            self.mission.reached,
            self.mission.done and bool(self.mission.items),
            self.failsafe,
            self._watch.remaining,
            self._sticks_fresh(),
            self._watch.link_lost >= 0,
            self._watch.zones,
            self.rally,
            self._orbit if self.mode is Mode.ORBIT else None,
            self._estimator.silent <= _BLIND_S,
            self._measured,
            self._trust(),
        )

    def _trust(self) -> Trust:
        senses, positioned = self._senses, self._estimator.silent <= _BLIND_S
        inertial, vertical = senses.inertial, senses.vertical
        (place, speed), (height, climb) = self._estimator.deviation, vertical.deviation
        lean = inertial.deviation
        return Trust(
            positioned,
            positioned or speed < _SPEED_SURE,
            vertical.has_height or vertical.has_fix,
            climb < _SPEED_SURE,
            inertial.has_attitude or lean < _LEAN_SURE,
            inertial.has_rate and not inertial.biased,
            vertical.has_force,
            vertical.has_height,
            positioned,
            inertial.has_attitude,
            place,
            speed,
            height,
            climb,
            lean,
        )


_SHAPING = ("HJ_ATT_", "HJ_RLIM_", "HJ_STICK_LEAN", "HJ_YAW_RATE")  # parameters that the limits follow from
_CLIMBING = ("HJ_ALT_P", "HJ_CLIMB_P", "HJ_CLIMB_AUTO", "HJ_DESC_AUTO")
_CENTRED = Sticks(0.0, 0.0, 0.0, 0.5)
_DOES = {Mode.HOLD: "holding", Mode.RTL: "returning", Mode.LAND: "landing"}


def _dead(stick: float) -> float:
    """A stick without its dead middle, still 1 at the end."""
    size = max(0.0, abs(stick) - _STICK_DEAD) / (1.0 - _STICK_DEAD)
    return size if stick > 0.0 else -size


def _minus(a: Pair, b: Pair) -> Pair:
    return (a[0] - b[0], a[1] - b[1])


def _yes(text: str = "") -> Answer:
    return Answer(True, Result.ACCEPTED, text)


def _no(result: Result, text: str) -> Answer:
    return Answer(False, result, text)


_HANDLERS: dict[type[Any], Callable[[Autopilot, Any, int], Answer]] = {
    Arm: Autopilot._arm,
    Disarm: Autopilot._disarm,
    Kill: Autopilot._kill,
    SetMode: Autopilot._set_mode,
    Takeoff: Autopilot._take_off,
    Land: Autopilot._land,
    ReturnHome: Autopilot._return,
    Goto: Autopilot._goto,
    Orbit: Autopilot._begin_orbit,
    Hold: Autopilot._stop,
    SetSpeed: Autopilot._set_speed,
    SetHome: Autopilot._set_home,
    Sticks: Autopilot._take_sticks,
    OffboardAttitude: Autopilot._take_setpoint,
    OffboardVelocity: Autopilot._take_setpoint,
    OffboardPosition: Autopilot._take_setpoint,
    MissionUpload: Autopilot._upload,
    MissionStart: Autopilot._start_mission,
    MissionSetCurrent: Autopilot._set_current,
    MissionClear: Autopilot._clear_mission,
    FenceUpload: Autopilot._draw_fence,
    RallyUpload: Autopilot._set_rally,
    SetParameter: Autopilot._set_parameter,
    InjectFault: Autopilot._inject_fault,
    ClearFaults: Autopilot._clear_faults,
    LinkLost: Autopilot._link_lost,
    LinkBack: Autopilot._link_back,
}
