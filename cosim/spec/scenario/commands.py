"""Models of a scenario's commands: signals over time, positions, velocities, waypoints and tracks."""

from typing import Annotated, Literal, get_args

from pydantic import Field

from cosim.base.storage.toml import Duration, Model, Positive, Seconds

Amplitude = Annotated[float, Field(ge=-1e6, le=1e6)]
Height = Annotated[float, Field(ge=0.0, le=20000.0)]  # m, above the ground
Heading = Annotated[float, Field(ge=-360.0, le=360.0)]  # deg, from north
Signal = Literal[
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
    "altitude_m",
    "rate_p_deg_s",
    "rate_q_deg_s",
    "rate_r_deg_s",
    "collective",
    "ahead_m_s",
]
SIGNALS: tuple[str, ...] = get_args(Signal)  # signals that a command may set


class SignalCommand(Model):
    """Command of one signal from ``start_s`` on."""

    kind: str
    signal: Signal
    start_s: Seconds
    amplitude: Amplitude


class StepCommand(SignalCommand):
    """Step of a signal: ``amplitude`` from ``start_s`` on."""

    kind: Literal["step"]


class DoubletCommand(SignalCommand):
    """Doublet of a signal: ``amplitude`` for ``width_s``, then minus ``amplitude`` for ``width_s``."""

    kind: Literal["doublet"]
    width_s: Duration

    @property
    def duration_s(self) -> float:
        """Duration of both halves [s]."""
        return 2.0 * self.width_s


class RampCommand(SignalCommand):
    """Ramp of a signal from zero at ``start_s`` to ``amplitude`` after ``duration_s``, then held."""

    kind: Literal["ramp"]
    duration_s: Duration


class SweepCommand(SignalCommand):
    """Sine whose frequency rises exponentially from ``from_hz`` to ``to_hz`` over ``duration_s``."""

    kind: Literal["sweep"]
    from_hz: Positive
    to_hz: Positive
    duration_s: Duration


class TableCommand(Model):
    """Signals from a CSV with ``time_s`` and any signals, held or interpolated linearly between rows."""

    kind: Literal["table"]
    file: str
    start_s: Seconds = 0.0
    interpolate: Literal["hold", "linear"] = "linear"


class SticksCommand(Model):
    """Recorded stick positions, a CSV with ``time_s, roll, pitch, yaw, throttle`` in -1..1.

    Roll and pitch ask for an angle, yaw for a turn rate, throttle for a climb rate.
    """

    kind: Literal["sticks"]
    file: str
    start_s: Seconds = 0.0
    tilt_deg: Positive = 20.0
    yaw_rate_deg_s: Positive = 45.0
    climb_m_s: Positive = 1.0


class PlaceCommand(Model):
    """Fly to a place from ``start_s`` on and hold it; omitted values are those at ``start_s``.

    m, NED, from the place below the start; ``altitude_m`` above the ground there.  Height and heading that no place has
    stated yet are those of other commands.
    """

    kind: Literal["place"]
    start_s: Seconds = 0.0
    north_m: Amplitude | None = None
    east_m: Amplitude | None = None
    altitude_m: Height | None = None
    yaw_deg: Heading | None = None  # from north, the short way round
    speed_m_s: Positive | None = None  # limit; default: [control.pilot]


class VelocityCommand(Model):
    """Fly at a velocity over the ground [m/s, NED] from ``start_s`` on, by the autopilot's position law.

    Not stated: ``climb_m_s``, the height stays that of other commands; ``yaw_deg``, the heading.
    """

    kind: Literal["velocity"]
    start_s: Seconds = 0.0
    north_m_s: Amplitude = 0.0
    east_m_s: Amplitude = 0.0
    # At most the autopilot's climb and sink rates; ends above the ground.
    climb_m_s: Amplitude | None = None
    yaw_deg: Heading | None = None  # from north, the short way round


class Waypoint(Model):
    """One place of a :class:`WaypointsCommand`; omitted values stay as before."""

    north_m: Amplitude
    east_m: Amplitude
    altitude_m: Height | None = None
    yaw_deg: Heading | None = None
    speed_m_s: Positive | None = None
    hold_s: Seconds | None = None


class WaypointsCommand(Model):
    """Fly to the places in turn from ``start_s`` on and hold the last.

    A waypoint is reached where the estimated place is within ``radius_m`` of it, horizontally and, where it states a
    height, vertically; ``hold_s`` later the next one is flown to.  Places as in :class:`PlaceCommand`.
    """

    kind: Literal["waypoints"]
    start_s: Seconds = 0.0
    speed_m_s: Positive | None = None
    radius_m: Positive = 1.5  # the autopilot's default HJ_ACC_RADIUS
    hold_s: Seconds = 0.0
    waypoint: Annotated[list[Waypoint], Field(min_length=1)]


class TrackCommand(Model):
    """Track of places over time, a CSV with ``time_s, north_m, east_m`` and optionally ``altitude_m, yaw_deg``.

    Between its rows runs the cubic spline that begins and ends at rest; the law is given its place, velocity and
    acceleration.  Before its first row the first place holds, after the last the last.
    """

    kind: Literal["track"]
    file: str
    start_s: Seconds = 0.0


GuidedCommand = PlaceCommand | VelocityCommand | WaypointsCommand | TrackCommand  # flown by the position law
CommandEntry = Annotated[
    StepCommand | DoubletCommand | RampCommand | SweepCommand | TableCommand | SticksCommand | GuidedCommand,
    Field(discriminator="kind"),
]
