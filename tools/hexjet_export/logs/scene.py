"""What Foxglove draws of a flight: frames, the vehicle from its ``vehicle.toml``, thrust and wind, the place on a map.

Frames: ``world`` is east-north-up, as the viewer has it; ``ned`` lies in it, with its origin on the ground below the
start; ``body`` (forward-right-down) moves in ``ned``; ``jet_N`` stands at station N of the body and tilts with its
servo, the thrust along its -z.

=================  ===========================  ================================================================
topic              schema                       what
=================  ===========================  ================================================================
``/tf``            foxglove.FrameTransforms     all frames in each message, so that a seek finds them all
``/pose``          foxglove.PoseInFrame         the true pose, in ``ned``
``/location``      foxglove.LocationFix         the true place, its height above the sea
``/scene``         foxglove.SceneUpdate         hull, legs and jets, once: they move with their frames
``/scene/arrows``  foxglove.SceneUpdate         thrust of each jet, and the wind where the vehicle is
=================  ===========================  ================================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, cos, hypot, isfinite, sin, sqrt
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap_protobuf.schema import register_schema

from cosim import Scenario
from cosim.base.arrays import Array
from cosim.base.constants import GRAVITY
from cosim.base.geodesy import Geodesy
from cosim.base.signals import AXES, Quaternion, Vector3
from cosim.spec.vehicle import Vehicle
from hexjet_export.logs.contents import Block, Timed, quaternions

# Seconds between a topic's messages, chosen by us: pose and arrows as often as a screen draws, with no more bytes than
# the columns take; a map needs fewer.
INTERVAL_S = {"/tf": 0.02, "/pose": 0.02, "/scene/arrows": 0.04, "/location": 0.1}

# The world has x east, y north, z up: NED is turned by half a turn about the bisector of x and y.
_NED_IN_WORLD = (0.0, sqrt(0.5), sqrt(0.5), 0.0)
_UP = (cos(0.7853981633974483), 0.0, sin(0.7853981633974483), 0.0)  # quarter turn about y: +x to -z
_HULL, _LEG, _JET = (0.12, 0.31, 0.47, 0.45), (0.45, 0.45, 0.45, 1.0), (0.75, 0.75, 0.75, 0.9)  # RGBA colours
_THRUST, _WIND = (0.75, 0.22, 0.17, 1.0), (0.18, 0.5, 0.8, 1.0)  # RGBA colours of arrows


class Scene:
    """3D scene of a flight as Foxglove messages; without a scenario only frames and pose, without jets."""

    def __init__(self, writer: Any, step_s: float, scenario: Scenario | None) -> None:
        kinds: dict[str, Any] = {"/tf": FrameTransforms, "/pose": PoseInFrame}
        self._vehicle = None if scenario is None else scenario.resolved_vehicle()[0]
        self._layout = None if self._vehicle is None else self._vehicle.layout()
        self._angles: list[str] = []  # columns of the jets' hinge angles
        if scenario is not None and self._vehicle is not None and self._layout is not None:
            servos = self._vehicle.actuators[: len(self._layout.turns)]
            self._angles = [f"tilt_{name}_rad" for name in servos]
            environment = scenario.environment
            self._map = Geodesy(environment.latitude_deg, environment.longitude_deg, environment.ground_m)
            kinds |= {"/location": LocationFix, "/scene": SceneUpdate, "/scene/arrows": SceneUpdate}
        ids: dict[Any, int] = {}
        for kind in kinds.values():
            if kind not in ids:
                ids[kind] = register_schema(writer, kind)
        self._channels = {name: writer.register_channel(name, "protobuf", ids[kind]) for name, kind in kinds.items()}
        self._every = {name: max(1, round(seconds / step_s)) for name, seconds in INTERVAL_S.items()}

    def messages(self, block: Block, first: int, last: int) -> Iterator[Timed]:
        """Yield the messages of a block whose first row is step ``first``, always including step ``last``."""
        q = quaternions(*(block[f"{axis}_rad"] for axis in AXES))
        made = {
            "/tf": self._make_frame_message,
            "/pose": self._make_pose_message,
            "/location": self._make_fix_message,
            "/scene/arrows": self._make_arrow_message,
        }
        for row, seconds in enumerate(block["time_s"].tolist()):
            k, time = first + row, round(1e9 * seconds)
            if k == 0 and self._vehicle is not None:
                yield k, time, self._channels["/scene"], draw_vehicle(self._vehicle, time).SerializeToString()
            for topic, make in made.items():
                if topic in self._channels and (k % self._every[topic] == 0 or k == last):
                    yield k, time, self._channels[topic], make(block, row, q, time).SerializeToString()

    def _make_frame_message(self, block: Block, row: int, q: Array, time: int) -> FrameTransforms:
        frames = FrameTransforms()

        def add_frame(parent: str, child: str, at: Any, turned: Any) -> None:
            frame = frames.transforms.add(parent_frame_id=parent, child_frame_id=child)
            frame.timestamp.FromNanoseconds(time)
            _set_pose(frame.translation, frame.rotation, at, turned)

        add_frame("world", "ned", (0.0, 0.0, 0.0), _NED_IN_WORLD)
        add_frame("ned", "body", _ned_point(block, row), q[row])
        if self._layout is not None:
            angles = [float(block[name][row]) for name in self._angles]
            axes, positions = self._layout.axes(angles), self._layout.positions(angles)
            for number, (position, group) in enumerate(zip(positions, self._layout.groups, strict=True), 1):
                add_frame("body", f"jet_{number}", position, _rotate_thrust_to(axes[group]))
        return frames

    def _make_pose_message(self, block: Block, row: int, q: Array, time: int) -> PoseInFrame:
        pose = PoseInFrame(frame_id="ned", pose=_make_pose(_ned_point(block, row), q[row]))
        pose.timestamp.FromNanoseconds(time)
        return pose

    def _make_fix_message(self, block: Block, row: int, q: Array, time: int) -> LocationFix:
        north, east = float(block["north_m"][row]), float(block["east_m"][row])
        latitude, longitude, height = self._map.to_geodetic(north, east, float(block["altitude_m"][row]))
        fix = LocationFix(frame_id="body", latitude=latitude, longitude=longitude, altitude=height)
        fix.timestamp.FromNanoseconds(time)
        return fix

    def _make_arrow_message(self, block: Block, row: int, q: Array, time: int) -> SceneUpdate:
        assert self._vehicle is not None
        update = SceneUpdate()
        size = vehicle_reach(self._vehicle)
        newton_m = hover_n(self._vehicle) / size
        for number in range(1, len(self._vehicle.jets) + 1):
            thrust = float(block[f"thrust_{number}_N"][row])
            entity = _add_entity(update, f"thrust_{number}", f"jet_{number}", time)
            entity.metadata.add(key="thrust_N", value=repr(thrust))
            entity.metadata.add(key="N per m of arrow", value=repr(newton_m))
            _add_arrow(entity, (0.0, 0.0, 0.0), _UP, thrust / newton_m, 0.04 * size, _THRUST)
        wind = [float(block[f"wind_{axis}_m_s"][row]) for axis in ("north", "east", "down")]
        entity = _add_entity(update, "wind", "ned", time)
        entity.frame_locked = False
        entity.metadata.add(key="speed_m_s", value=repr(hypot(*wind)))
        # An arrow of 1 m stands for 5 m/s.
        _add_arrow(entity, _ned_point(block, row), direction_quaternion(*wind), 0.2 * hypot(*wind), 0.04 * size, _WIND)
        return update


def draw_vehicle(vehicle: Vehicle, time: int) -> SceneUpdate:
    """Draw hull, legs and jets: positions from ``vehicle.toml``, thicknesses as fractions of its size."""
    update, size = SceneUpdate(), vehicle_reach(vehicle)
    body = _add_entity(update, "body", "body", time)
    # The hull is the box around its contacts, or else the stations, and the centre of gravity.
    positions = [contact.position_m for contact in vehicle.contacts if contact.kind == "hull"]
    positions = [*(positions or [jet.position_m for jet in vehicle.jets]), (0.0, 0.0, 0.0)]
    low, high = np.min(positions, axis=0), np.max(positions, axis=0)
    cube = body.cubes.add(pose=_make_pose(0.5 * (low + high), (1.0, 0.0, 0.0, 0.0)))
    cube.size.x, cube.size.y, cube.size.z = (max(float(length), 0.05 * size) for length in high - low)
    _set_colour(cube.color, _HULL)
    legs = body.lines.add(type=LinePrimitive.LINE_LIST, thickness=0.03 * size, pose=_make_pose((0, 0, 0), (1, 0, 0, 0)))
    _set_colour(legs.color, _LEG)
    for contact in vehicle.contacts:
        x, y, z = contact.position_m
        if contact.kind == "leg":
            legs.points.add(x=x, y=y, z=min(0.0, z))
            legs.points.add(x=x, y=y, z=z)
    for number in range(1, len(vehicle.jets) + 1):
        entity = _add_entity(update, f"jet_{number}", f"jet_{number}", time)
        cylinder = entity.cylinders.add(pose=_make_pose((0, 0, 0), (1, 0, 0, 0)), bottom_scale=1.0, top_scale=1.0)
        cylinder.size.x = cylinder.size.y = 0.2 * size
        cylinder.size.z = 0.4 * size
        _set_colour(cylinder.color, _JET)
        text = entity.texts.add(billboard=True, font_size=0.12 * size, text=str(number))
        text.pose.CopyFrom(_make_pose((0.0, 0.0, 0.3 * size), (1, 0, 0, 0)))
        _set_colour(text.color, _LEG)
    return update


def vehicle_reach(vehicle: Vehicle) -> float:
    """Return the greatest distance of a station or contact from the centre of gravity along an axis [m]."""
    positions = [*(jet.position_m for jet in vehicle.jets), *(contact.position_m for contact in vehicle.contacts)]
    return max(max(map(abs, position)) for position in positions) or 1.0


def hover_n(vehicle: Vehicle) -> float:
    """Return the thrust of a jet in hover [N]; its arrow is drawn as long as :func:`vehicle_reach`."""
    return vehicle.mass_kg * GRAVITY / len(vehicle.jets)


def direction_quaternion(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the quaternion that turns +x to a direction by yaw and pitch; the identity for a zero vector."""
    yaw, pitch = 0.5 * atan2(y, x), -0.5 * atan2(z, hypot(x, y))
    return cos(yaw) * cos(pitch), -sin(yaw) * sin(pitch), cos(yaw) * sin(pitch), sin(yaw) * cos(pitch)


def _rotate_thrust_to(axis: Vector3) -> Quaternion:
    """Return the smallest rotation that turns -z, the direction of thrust, to a unit axis."""
    x, y, z = axis
    w = sqrt(max(0.0, 0.5 * (1.0 - z)))
    if w < 1e-9:
        return (0.0, 1.0, 0.0, 0.0)  # straight down: half a turn about x
    # The cross product of -z and the axis, divided by 2 w.
    return (w, 0.5 * y / w, -0.5 * x / w, 0.0)


def _ned_point(block: Block, row: int) -> tuple[float, ...]:
    return tuple(float(block[f"{axis}_m"][row]) for axis in ("north", "east", "down"))


def _add_entity(update: SceneUpdate, name: str, frame: str, time: int) -> SceneEntity:
    """Add an entity that stays in the scene until another of its name replaces it."""
    entity: SceneEntity = update.entities.add(id=name, frame_id=frame, frame_locked=True)
    entity.timestamp.FromNanoseconds(time)
    return entity


def _add_arrow(entity: SceneEntity, at: Any, turned: Any, length: float, thickness: float, colour: Any) -> None:
    """Add an arrow to the entity; for zero length none, which removes the one drawn before."""
    if isfinite(length) and length > 0.0:
        head = min(2.0 * thickness, 0.5 * length)
        arrow = entity.arrows.add(pose=_make_pose(at, turned), shaft_length=length - head, head_length=head)
        arrow.shaft_diameter, arrow.head_diameter = thickness, 2.0 * thickness
        _set_colour(arrow.color, colour)


def _make_pose(at: Any, turned: Any) -> Pose:
    pose = Pose()
    _set_pose(pose.position, pose.orientation, at, turned)
    return pose


def _set_pose(vector: Any, quaternion: Any, at: Any, turned: Any) -> None:
    """Write a position and a quaternion, w first, into their messages."""
    vector.x, vector.y, vector.z = (float(value) for value in at)
    quaternion.w, quaternion.x, quaternion.y, quaternion.z = (float(value) for value in turned)


def _set_colour(message: Any, rgba: tuple[float, float, float, float]) -> None:
    message.r, message.g, message.b, message.a = rgba
