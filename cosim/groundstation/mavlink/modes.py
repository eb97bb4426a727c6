"""Flight modes in the numbers of each personality.

PX4: main mode in bits 16 to 23 of custom_mode, sub mode in bits 24 to 31 (PX4, px4_custom_mode.h).
ArduPilot: Copter's numbers (COPTER_MODE).  A vehicle of no personality uses PX4's, because MAVSDK reads those.
"""

from __future__ import annotations

from typing import NamedTuple

from cosim.control.autopilot.modes import STICK_MODES, LandedState, Mode
from cosim.groundstation.mavlink.telemetry_state import Personality
from cosim.groundstation.mavlink.wire.dialect import mav

AUTOPILOT: dict[Personality, int] = {"px4": 12, "ardupilot": 3, "generic": 0}  # MAV_AUTOPILOT of a heartbeat
# MAV_TYPE by number of engines: tricopter, quadrotor, hexa-, octo-, deca- and dodecarotor.
_MAV_TYPES = {3: 15, 4: 2, 6: 13, 8: 14, 10: 35, 12: 29}


def vehicle_type(jets: int) -> int:
    """Return MAV_TYPE of a vehicle that hovers on ``jets`` engines."""
    return _MAV_TYPES.get(jets, int(mav.MAV_TYPE_GENERIC_MULTIROTOR))


_AUTO = 4  # main mode AUTO of PX4
_PX4_MODES: dict[Mode, tuple[int, int]] = {  # main and sub mode of PX4
    Mode.MANUAL: (1, 0),
    Mode.ALTCTL: (2, 0),
    Mode.POSCTL: (3, 0),
    Mode.TAKEOFF: (_AUTO, 2),
    Mode.HOLD: (_AUTO, 3),
    Mode.MISSION: (_AUTO, 4),
    Mode.RTL: (_AUTO, 5),
    Mode.LAND: (_AUTO, 6),
    Mode.OFFBOARD: (6, 0),
    Mode.STABILIZED: (7, 0),
    Mode.ORBIT: (3, 1),  # a sub mode of position control
}
# ArduCopter's mode numbers; it takes off and flies to requested positions in GUIDED (4).
_COPTER_MODES: dict[Mode, int] = {
    Mode.STABILIZED: 0,
    Mode.MANUAL: 0,
    Mode.ALTCTL: 2,
    Mode.MISSION: 3,
    Mode.HOLD: 4,
    Mode.TAKEOFF: 4,
    Mode.POSCTL: 5,
    Mode.RTL: 6,
    Mode.LAND: 9,
    Mode.OFFBOARD: 20,
    Mode.ORBIT: 7,  # CIRCLE
}
_FROM_PX4 = {value: mode for mode, value in _PX4_MODES.items()}  # inverse
# Names of PX4 modes, by main and sub mode, that are refused.
REFUSED_PX4 = {
    (_AUTO, 8): "follow-me",
    (_AUTO, 9): "precision landing",
    (_AUTO, 10): "VTOL take-off",
    (5, 0): "acro",
    (8, 0): "rattitude",
    (10, 0): "termination",
}
_FROM_COPTER = {  # modes that ArduPilot stations ask for
    0: Mode.STABILIZED, 2: Mode.ALTCTL, 3: Mode.MISSION, 4: Mode.HOLD, 5: Mode.POSCTL, 6: Mode.RTL, 9: Mode.LAND,
    16: Mode.POSCTL, 17: Mode.HOLD, 20: Mode.OFFBOARD,
}  # fmt: skip

# MAV_STANDARD_MODE of each mode that has one.
STANDARD: dict[Mode, int] = {
    Mode.POSCTL: 1, Mode.ALTCTL: 4, Mode.RTL: 5, Mode.MISSION: 6, Mode.LAND: 7, Mode.TAKEOFF: 8,
}  # fmt: skip
FROM_STANDARD = {value: mode for mode, value in STANDARD.items()}  # inverse of STANDARD

# Bits of MAV_MODE_PROPERTY.
_ADVANCED, _AUTOMATIC = 1, 4


class ModeLine(NamedTuple):
    """Mode as reported to stations, with QGroundControl's name for PX4."""

    mode: Mode
    name: str
    properties: int


MODES = (  # modes reported to stations
    ModeLine(Mode.MANUAL, "Manual", 0),
    ModeLine(Mode.STABILIZED, "Stabilized", 0),
    ModeLine(Mode.ALTCTL, "Altitude", 0),
    ModeLine(Mode.POSCTL, "Position", 0),
    ModeLine(Mode.HOLD, "Hold", _AUTOMATIC),
    ModeLine(Mode.TAKEOFF, "Takeoff", _AUTOMATIC),
    ModeLine(Mode.LAND, "Land", _AUTOMATIC),
    ModeLine(Mode.RTL, "Return", _AUTOMATIC),
    ModeLine(Mode.MISSION, "Mission", _AUTOMATIC),
    ModeLine(Mode.OFFBOARD, "Offboard", _AUTOMATIC | _ADVANCED),
)

LANDED: dict[LandedState, int] = {  # MAV_LANDED_STATE
    LandedState.ON_GROUND: 1,
    LandedState.IN_AIR: 2,
    LandedState.TAKING_OFF: 3,
    LandedState.LANDING: 4,
}

# Bits of MAV_MODE_FLAG.
CUSTOM, AUTO, GUIDED, STABILIZE, MANUAL_INPUT, ARMED = 1, 4, 8, 16, 64, 128


def custom_mode(mode: Mode, personality: Personality) -> int:
    if personality == "ardupilot":
        return _COPTER_MODES[mode]
    main, sub = _PX4_MODES[mode]
    return main << 16 | sub << 24


def base_mode(mode: Mode, armed: bool) -> int:
    flags = MANUAL_INPUT | STABILIZE if mode in STICK_MODES else STABILIZE | GUIDED | AUTO
    return CUSTOM | flags | (ARMED if armed else 0)


def from_custom(value: int, personality: Personality) -> Mode | None:
    """Return the mode for the field custom_mode of SET_MODE; None for an unknown number."""
    if personality == "ardupilot":
        return _FROM_COPTER.get(value)
    return None if value & 0xFFFF else from_main_sub(value >> 16 & 0xFF, value >> 24 & 0xFF)


def from_main_sub(main: int, sub: int) -> Mode | None:
    """Return the mode for PX4's main and sub mode (DO_SET_MODE); the sub mode counts in AUTO only."""
    return _FROM_PX4.get((main, sub if main == _AUTO else 0))
