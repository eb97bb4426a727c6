"""What a ground station may ask of the vehicle, one frozen record each, and the answer it gets.

Frames: north, east and down are NED with the origin of the flight; *altitude* is height in m above that origin, as
``Measured.altitude``; *height* is above home.  None is "not given".  Every number is finite and in range when a record
exists; the constructors raise InputError with one line otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from math import pi, sqrt
from typing import Annotated, Any, NamedTuple, get_args

from cosim.base.errors import InputError
from cosim.base.signals import Quaternion
from cosim.control.checked_record import Bounds, CheckedRecord, make_record, to_plain

# Limits far beyond any flight of these vehicles, but small enough that no arithmetic overflows.
Metres = Annotated[float, Bounds(-1e5, 1e5)]
Speed = Annotated[float, Bounds(0.0, 1e3)]
Velocity = Annotated[float, Bounds(-1e3, 1e3)]
Angle = Annotated[float, Bounds(-2.0 * pi, 2.0 * pi)]
AngularRate = Annotated[float, Bounds(-50.0, 50.0)]
Stick = Annotated[float, Bounds(-1.0, 1.0)]
Share = Annotated[float, Bounds(0.0, 1.0)]
Seconds = Annotated[float, Bounds(0.0, 1e5)]
Number = Annotated[float, Bounds(-1e9, 1e9)]
Index = Annotated[int, Bounds(0, 10_000)]

# Chosen by us: more than a flight needs, and few enough to be checked within a step.
MAX_MISSION_ITEMS = 1000
MAX_ZONES, MAX_CORNERS, MAX_RALLY_POINTS = 50, 500, 100  # corners are of one polygon


class Result(Enum):
    """The result of a request, with MAVLink's names."""

    ACCEPTED = "accepted"
    DENIED = "denied"
    TEMPORARILY_REJECTED = "temporarily_rejected"
    UNSUPPORTED = "unsupported"
    FAILED = "failed"


class Answer(NamedTuple):
    """Answer to a request; ``text`` gives the reason of a refusal."""

    accepted: bool
    result: Result
    text: str


class Arm(CheckedRecord):
    """Arm the vehicle; ``force`` skips the checks that are not about the vehicle's safety on the ground."""

    force: bool = False


class Disarm(CheckedRecord):
    """Disarm the standing vehicle; in the air only with ``force``, which shuts the engines off."""

    force: bool = False


class SetMode(CheckedRecord):
    """Change into a flight mode, by its name in lower case."""

    mode: str


class Takeoff(CheckedRecord):
    """Take off to a height above home, by default the parameter's."""

    altitude_m: Metres | None = None


class Land(CheckedRecord):
    """Land below the present position."""


class ReturnHome(CheckedRecord):
    """Return: climb, fly home and land."""


class Goto(CheckedRecord):
    """Fly to a position and hold there; an omitted value stays unchanged."""

    north: Metres | None = None
    east: Metres | None = None
    altitude: Metres | None = None
    yaw: Angle | None = None
    speed: Speed | None = None


class OrbitYaw(Enum):
    """Direction of the nose on a circle."""

    CENTRE = "centre"
    AS_IT_IS = "as_it_is"
    TANGENT = "tangent"


class Orbit(CheckedRecord):
    """Circle around a centre ``turns`` times or without end; omitted values are the present ones.

    ``speed``, m/s, may come out less: the vehicle has to lean into the circle.
    """

    radius: Annotated[float, Bounds(1.0, 1e4)]
    clockwise: bool = True
    speed: Speed | None = None
    north: Metres | None = None
    east: Metres | None = None
    altitude: Metres | None = None
    yaw: OrbitYaw = OrbitYaw.CENTRE
    turns: Annotated[float, Bounds(0.0, 1e4)] = 0.0  # 0: circle without end

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.north is None) != (self.east is None):
            raise InputError("Orbit: give north and east, or neither")


class Hold(CheckedRecord):
    """Stop and hold the position."""


class SetSpeed(CheckedRecord):
    """Horizontal speed of automatic flight until the next arming or return, m/s."""

    m_s: Speed


class SetHome(CheckedRecord):
    """Set the home position; omitted values are the vehicle's present ones."""

    north: Metres | None = None
    east: Metres | None = None
    altitude: Metres | None = None


class Kill(CheckedRecord):
    """Shut the engines off at once; in the air only with ``force``."""

    force: bool = False


class Sticks(CheckedRecord):
    """Manual sticks: roll right, pitch forward (nose down), yaw right in -1..1; throttle 0..1, centre 0.5."""

    roll: Stick
    pitch: Stick
    yaw: Stick
    throttle: Share


class OffboardAttitude(CheckedRecord):
    """Attitude (body to NED, normalised here) or body rates, rad/s; ``thrust`` is the collective."""

    quaternion: tuple[Stick, Stick, Stick, Stick] | None = None
    rates: tuple[AngularRate, AngularRate, AngularRate] | None = None
    thrust: Share = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.quaternion is None) == (self.rates is None):
            raise InputError("OffboardAttitude: give either quaternion or rates")
        if self.quaternion is not None and abs(sqrt(sum(v * v for v in self.quaternion)) - 1.0) > 0.05:
            raise InputError(f"OffboardAttitude.quaternion = {list(self.quaternion)}: must be of length 1")


class OffboardVelocity(CheckedRecord):
    """NED velocity, m/s, with a heading or a turn rate or neither."""

    north: Velocity
    east: Velocity
    down: Velocity
    yaw: Angle | None = None
    yaw_rate: AngularRate | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.yaw is not None and self.yaw_rate is not None:
            raise InputError("OffboardVelocity: give yaw or yaw_rate, not both")


class OffboardPosition(CheckedRecord):
    """Hold a position relative to home [m, NED] and optionally a yaw angle."""

    north: Metres
    east: Metres
    down: Metres
    yaw: Angle | None = None


class ItemKind(Enum):
    """Kind of a mission item, with the fields that it uses.

    ``ALTITUDE`` goes to north and east, if given, at its present height, and there to the altitude.  ``LEFT_OUT`` is
    of a payload that is not here: passed at once, so that the other items keep their numbers.
    """

    WAYPOINT = "waypoint"  # flies to a position, waits hold_s
    TAKEOFF = "takeoff"  # climbs to altitude
    LAND = "land"  # lands at north, east, or where it is
    RETURN = "return"
    SPEED = "speed"  # changes the speed
    DELAY = "delay"  # waits for hold_s
    JUMP = "jump"  # to item target; `repeat` -1: always
    CIRCLE = "circle"  # circles round north, east at altitude
    STAY = "stay"  # holds a position without end
    ALTITUDE = "altitude"  # climbs or sinks to altitude
    LEFT_OUT = "left_out"


_REQUIRED_FIELDS = {  # fields that an item must have
    ItemKind.WAYPOINT: ("north", "east", "altitude"),
    ItemKind.TAKEOFF: ("altitude",),
    ItemKind.SPEED: ("speed",),
    ItemKind.JUMP: ("target",),
    ItemKind.CIRCLE: ("north", "east", "altitude", "radius"),
    ItemKind.STAY: ("north", "east", "altitude"),
    ItemKind.ALTITUDE: ("altitude",),
}


class MissionItem(CheckedRecord):
    """One mission item; its kind determines which fields count."""

    kind: ItemKind
    north: Metres | None = None
    east: Metres | None = None
    altitude: Metres | None = None
    yaw: Angle | None = None
    hold_s: Seconds = 0.0
    acceptance_m: Annotated[float, Bounds(0.0, 1e3)] = 0.0  # 0: as the parameter says
    speed: Annotated[float, Bounds(0.1, 1e3)] | None = None
    target: Index | None = None
    repeat: Annotated[int, Bounds(-1, 1000)] = 0
    radius: Annotated[float, Bounds(1.0, 1e4)] | None = None
    clockwise: bool = True
    turns: Annotated[float, Bounds(0.0, 1e4)] = 1.0  # 0: without end

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in _REQUIRED_FIELDS.get(self.kind, ()):
            if getattr(self, name) is None:
                raise InputError(f"MissionItem {self.kind.value}: {name} is missing")
        if (self.north is None) != (self.east is None):
            raise InputError(f"MissionItem {self.kind.value}: give north and east, or neither")


class MissionUpload(CheckedRecord):
    """Replace the mission."""

    items: tuple[MissionItem, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.items) > MAX_MISSION_ITEMS:
            raise InputError(f"MissionUpload.items: {len(self.items)} items, at most {MAX_MISSION_ITEMS} are allowed")
        for index, item in enumerate(self.items):
            if item.target is not None and item.target >= len(self.items):
                raise InputError(
                    f"MissionUpload.items[{index}].target = {item.target}: there are items 0 to {len(self.items) - 1}"
                )


class MissionStart(CheckedRecord):
    """Fly the mission from its present item."""


class MissionSetCurrent(CheckedRecord):
    """Continue the mission at this item."""

    index: Index


class MissionClear(CheckedRecord):
    """Delete the mission."""


class ZoneKind(Enum):
    """What a zone of the geofence forbids."""

    STAY_IN_POLYGON = "stay_in_polygon"
    STAY_OUT_OF_POLYGON = "stay_out_of_polygon"
    STAY_IN_CIRCLE = "stay_in_circle"
    STAY_OUT_OF_CIRCLE = "stay_out_of_circle"


_POLYGON_ZONES = (ZoneKind.STAY_IN_POLYGON, ZoneKind.STAY_OUT_OF_POLYGON)  # zones that are polygons


class FenceZone(CheckedRecord):
    """A polygon by its corners (north, east), or a circle by its centre and ``radius``, m."""

    kind: ZoneKind
    points: tuple[tuple[Metres, Metres], ...]
    radius: Annotated[float, Bounds(0.0, 1e5)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        corners = len(self.points)
        if self.kind in _POLYGON_ZONES and not 3 <= corners <= MAX_CORNERS:
            raise InputError(f"FenceZone.points: {corners} corners, a polygon has 3 to {MAX_CORNERS}")
        if self.kind not in _POLYGON_ZONES and (corners != 1 or self.radius <= 0.0):
            raise InputError("FenceZone: a circle has one centre and a radius above 0")


class FenceUpload(CheckedRecord):
    """Replace the fence; without zones remove it."""

    zones: tuple[FenceZone, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.zones) > MAX_ZONES:
            raise InputError(f"FenceUpload.zones: {len(self.zones)} zones, at most {MAX_ZONES} are allowed")


class RallyPoint(CheckedRecord):
    """Return point used if it is nearer than home; ``altitude``: minimum of the flight there."""

    north: Metres
    east: Metres
    altitude: Metres


class RallyUpload(CheckedRecord):
    """Replace the rally points."""

    points: tuple[RallyPoint, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.points) > MAX_RALLY_POINTS:
            raise InputError(f"RallyUpload.points: {len(self.points)} points, at most {MAX_RALLY_POINTS} are allowed")


class SetParameter(CheckedRecord):
    """Set a parameter of the autopilot by its name."""

    name: str
    value: Number


class InjectFault(CheckedRecord):
    """Inject a fault from the next step on; kinds are those of a scenario's faults.

    ``amount`` is the one number of its kind (throttle, share, lag, delay, angle, the barometer's bias), ``vector`` the
    bias of another sensor.  The simulation says which combinations there are.
    """

    fault: str
    jets: tuple[Index, ...] = ()
    servo: str | None = None
    sensor: str | None = None
    amount: Number | None = None
    vector: tuple[Number, Number, Number] | None = None
    duration_s: Seconds | None = None  # None: to the end of the flight


class ClearFaults(CheckedRecord):
    """End every injected fault."""


class LinkLost(CheckedRecord):
    """Report that the link to the last ground station is lost."""


class LinkBack(CheckedRecord):
    """Report that a ground station is connected again."""


Request = (
    Arm | Disarm | SetMode | Takeoff | Land | ReturnHome | Goto | Orbit | Hold | SetSpeed | SetHome | Kill | Sticks
    | OffboardAttitude | OffboardVelocity | OffboardPosition | MissionUpload | MissionStart | MissionSetCurrent
    | MissionClear | FenceUpload | RallyUpload | SetParameter | InjectFault | ClearFaults | LinkLost | LinkBack
)  # fmt: skip
_REQUEST_TYPES: dict[str, type[Any]] = {kind.__name__: kind for kind in get_args(Request)}  # request type by name


def to_dict(request: Request) -> dict[str, Any]:
    """Return a request as plain JSON values, its class under ``request``; fields at their default are left out."""
    return {"request": type(request).__name__, **to_plain(request)}


def from_dict(data: Mapping[str, Any]) -> Request:
    """Return the request that :func:`to_dict` wrote.  Raises InputError for anything else."""
    values = dict(data)
    name = values.pop("request", None)
    if not isinstance(name, str) or name not in _REQUEST_TYPES:
        raise InputError(f"request = {name!r}: must be one of {', '.join(_REQUEST_TYPES)}")
    made: Request = make_record(_REQUEST_TYPES[name], values, name)
    return made


def quaternion_of(request: OffboardAttitude) -> Quaternion | None:
    """Return the unit quaternion of an attitude set-point, or None if it has none."""
    if request.quaternion is None:
        return None
    w, x, y, z = request.quaternion
    scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)
