"""What an autopilot did, as PX4 logs it: the topics, messages and parameters that ULog gets from ``autopilot.jsonl``.

PX4 v1.15's numbers: ``arming_state`` 1 standby, 2 armed; ``nav_state`` as in :data:`NAV_STATE`.  States are logged when
they change and once a second, as PX4 does.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from hexjet_export.logs.contents import Line

# Value of nav_state in PX4's msg/VehicleStatus.msg for each mode of the autopilot.
NAV_STATE = {
    "MANUAL": 0,
    "ALTCTL": 1,
    "POSCTL": 2,
    "MISSION": 3,
    "HOLD": 4,
    "RTL": 5,
    "OFFBOARD": 14,
    "STABILIZED": 15,
    "TAKEOFF": 17,
    "LAND": 18,
    "ORBIT": 21,
}
STANDBY, ARMED = 1, 2  # values of arming_state


class Series(NamedTuple):
    """Values of a topic over time by field name, and the step ``k`` of each."""

    k: NDArray[np.int64]
    values: dict[str, Array]


def states(lines: Sequence[Line], steps: int, step: float) -> dict[str, Series]:
    """Return ``vehicle_status``, ``vehicle_land_detected``, ``home_position`` and ``mission_result`` of a flight."""
    again = max(1, round(1.0 / step))
    by_state: dict[str, Series] = {}
    for topic, kind, fields in (
        ("vehicle_status", "state", _STATUS),
        ("vehicle_land_detected", "state", _LANDED),
        ("home_position", "home", _HOME),
        ("mission_result", "mission", _MISSION),
    ):
        if series := _repeat([line for line in lines if line["kind"] == kind], fields, steps, again):
            by_state[topic] = series
    return by_state


def estimates(lines: Sequence[Line]) -> Series | None:
    """Return position, velocity and set-points as estimated by the autopilot; None if unknown."""
    found = [line for line in lines if line["kind"] == "estimate"]
    if not found:
        return None
    nowhere = (np.nan, np.nan)
    names = (
        *("x", "y", "vx", "vy", "x_sp", "y_sp", "z_sp", "yaw_sp", "xy_valid", "v_xy_valid", "z_valid", "v_z_valid"),
        *("z", "vz", "heading", "eph", "evh", "epv", "evv"),
    )
    columns: dict[str, list[float]] = {name: [] for name in names}
    for line in found:
        pairs = (line["position"], line["velocity"], line["track"] or nowhere)
        values = (*(value for pair in pairs for value in pair), -line["altitude"], line["yaw"], *_quality_fields(line))
        for column, value in zip(columns.values(), values, strict=True):
            column.append(value)
    return Series(_read_steps(found), {name: np.array(column, dtype=np.float64) for name, column in columns.items()})


def _quality_fields(line: Line) -> tuple[float, ...]:
    """Return validity, height, climb, heading and deviations as estimated; NaN for what an old record lacks."""
    positioned = line.get("positioned", True)
    valid, deviation = line.get("valid", {}), line.get("deviation", {})
    deviations = [deviation.get(name) for name in ("place_m", "speed_m_s", "height_m", "climb_m_s")]
    return (
        float(valid.get("place", positioned)),
        float(valid.get("speed", positioned)),
        float(valid.get("height", True)),
        float(valid.get("climb", True)),
        -line.get("height", np.nan),
        -line.get("climb", np.nan),
        line["attitude"][2] if "attitude" in line else np.nan,
        *(np.nan if value is None else value for value in deviations),
    )


def parameters(lines: Sequence[Line]) -> tuple[dict[str, float], list[tuple[int, str, float]]]:
    """Return the autopilot's parameters at the start, and each change as step, name and value."""
    first: dict[str, float] = next((line["values"] for line in lines if line["kind"] == "parameters"), {})
    return first, [(line["k"], line["name"], line["value"]) for line in lines if line["kind"] == "parameter"]


def parameter(name: str, value: float) -> bytes:
    """Return the content of a parameter message: int32 for a whole number, else float."""
    is_integer = isinstance(value, int)
    key = f"{'int32_t' if is_integer else 'float'} {name}".encode()
    return bytes([len(key)]) + key + struct.pack("<i" if is_integer else "<f", value)


def _repeat(lines: Sequence[Line], fields: dict[str, Callable[[Line], float]], steps: int, again: int) -> Series | None:
    """Return the fields' values at each line and every ``again`` steps until the next; None without lines."""
    if not lines:
        return None
    rows: list[tuple[int, Line]] = []
    for line, following in zip(lines, [*lines[1:], None], strict=True):
        end = steps if following is None else following["k"]
        rows += [(k, line) for k in range(line["k"], max(end, line["k"] + 1), again)]
    values = {name: np.array([read(line) for _, line in rows], dtype=np.float64) for name, read in fields.items()}
    return Series(np.array([k for k, _ in rows], dtype=np.int64), values)


def _read_steps(lines: Sequence[Line]) -> NDArray[np.int64]:
    return np.array([line["k"] for line in lines], dtype=np.int64)


_STATUS: dict[str, Callable[[Line], float]] = {  # fields of vehicle_status
    "arming_state": lambda line: ARMED if line["armed"] else STANDBY,
    "nav_state": lambda line: NAV_STATE[line["mode"]],
    "failsafe": lambda line: bool(line["failsafe"]),
}
_LANDED: dict[str, Callable[[Line], float]] = dict.fromkeys(  # fields of vehicle_land_detected
    ("landed", "maybe_landed", "ground_contact"), lambda line: line["landed"] == "on_ground"
)
_HOME: dict[str, Callable[[Line], float]] = {  # fields of home_position
    "x": lambda line: line["north"],
    "y": lambda line: line["east"],
    "z": lambda line: -line["altitude"],
    "valid_lpos": lambda line: True,
}
_MISSION: dict[str, Callable[[Line], float]] = {  # fields of mission_result
    "seq_total": lambda line: line["count"],
    "seq_current": lambda line: line["current"],
    "seq_reached": lambda line: line["reached"],
    "valid": lambda line: line["count"] > 0,
    "finished": lambda line: line["count"] > 0 and line["current"] >= line["count"],
}
# ULog types of the fields; all others are float.
TYPES = dict.fromkeys(("arming_state", "nav_state"), "uint8_t")
TYPES |= dict.fromkeys(("seq_total", "seq_current", "seq_reached"), "int32_t")
TYPES |= dict.fromkeys(
    ("failsafe", "landed", "maybe_landed", "ground_contact", "valid_lpos", "valid", "finished"), "bool"
)
