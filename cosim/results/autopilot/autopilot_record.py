"""``autopilot.jsonl``: what the autopilot did, beside the rows of a flight: states, messages, parameters, estimates.

An observer writes a line whenever something changes, and the estimate at a fixed rate, so that an hour of flight is a
few megabytes.  The file follows from the flight alone: who flies a run again gets it again, byte for byte.

==============  ======================================================================================================
kind            what else is in the line
==============  ======================================================================================================
``parameters``  ``values``: every parameter by name, at the start; whole where the vehicle counts
``parameter``   ``name``, ``value``: changed by somebody
``state``       ``mode``, ``armed``, ``landed``, ``engines``, ``failsafe``: the autopilot's own words
``mission``     ``count``, ``current``, ``reached``
``home``        ``north``, ``east``, ``altitude``: m, NED and height above the ground at the start
``message``     ``severity`` as in syslog, ``text``
``estimate``    ``position``, ``velocity`` (north and east, m and m/s), ``altitude``, ``yaw`` (asked for, m and rad),
                ``track`` (set-point of position, m; or null), ``positioned`` (GNSS fixes come), ``height``, ``climb``
                (m and m/s, upwards), ``attitude`` (roll, pitch, yaw, rad), ``deviation`` (standard deviations of place,
                speed, height, climb, attitude: m, m/s, rad; null: not known), ``valid`` (the same five, and then the
                sensors: whether they are believed): ten times a second
==============  ======================================================================================================

``k`` is the step in which it was so; a message carries the step before which it was said.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.base.errors import InputError
from cosim.base.frames import to_euler
from cosim.base.signals import Sample
from cosim.base.storage.appended import AppendedFile
from cosim.base.storage.files import map_os_errors, parse_json, read_text
from cosim.results.run import AUTOPILOT

if TYPE_CHECKING:  # unused when a record is read
    from cosim.control.autopilot.autopilot import Autopilot
    from cosim.control.autopilot.status import Status


Line = dict[str, Any]


class PilotRecord:
    """Observes a flight that ``pilot`` flies, and writes its file.  Raises InputError if the file cannot be made.

    ``estimate_s``: s between two estimates; PX4 logs its local position as often.
    """

    def __init__(self, pilot: Autopilot, path: Path, step: float, estimate_s: float = 0.1) -> None:
        self.estimate_s = estimate_s
        self._pilot = pilot
        self._every = max(1, round(self.estimate_s / step))
        self._last: dict[str, Line] = {}
        self._values: dict[str, float] = {}
        self._said = 0
        self._waiting: list[bytes] = []
        self._size = 0
        with map_os_errors(InputError, path):
            self._file = AppendedFile(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)

    def observe(self, sample: Sample) -> None:
        """Write the pilot's state after a step.  Raises FlightError if the file cannot be written."""
        self.write_changes(sample.k)

    def write_changes(self, k: int) -> None:
        """Write all changes since the last call, before step ``k``."""
        pilot = self._pilot
        self._write_messages()
        self._write_parameters(k)
        state: Line = {
            "mode": pilot.mode.value,
            "armed": pilot.armed,
            "landed": pilot.landed.value,
            "engines": pilot.engines.value,
            "failsafe": pilot.failsafe,
        }
        self._write_changed("state", k, state)
        mission = pilot.mission
        if mission.items or "mission" in self._last:
            count = len(mission.items)
            self._write_changed("mission", k, {"count": count, "current": mission.current, "reached": mission.reached})
        if pilot.home is not None:
            self._write_changed("home", k, pilot.home._asdict())
        if k % self._every == 0:
            self._add_line("estimate", k, **_describe_estimate(pilot.status))

    def close(self) -> None:
        """Write the messages since the last step and close the file; may be called twice."""
        if self._file.number >= 0:
            try:
                self._write_messages()
                self._flush_file()
            finally:
                self._file.close()

    def _write_messages(self) -> None:
        messages = self._pilot.messages
        if messages and messages[-1].number > self._said:
            for message in messages:
                if message.number > self._said:
                    self._add_line("message", message.k, severity=int(message.severity), text=message.text)
            self._said = messages[-1].number

    def _write_parameters(self, k: int) -> None:
        table, values = self._pilot.parameters.table, self._pilot.parameters.values
        if not self._values:
            self._values = dict(values)
            numbers = {name: int(value) if table[name].kind == "int" else value for name, value in values.items()}
            self._add_line("parameters", k, values=numbers)
        elif values != self._values:
            for name, value in values.items():
                if value != self._values[name]:
                    self._add_line("parameter", k, name=name, value=int(value) if table[name].kind == "int" else value)
            self._values = dict(values)

    def _write_changed(self, kind: str, k: int, now: Line) -> None:
        if self._last.get(kind) != now:
            self._last[kind] = now
            self._add_line(kind, k, **now)

    def _add_line(self, kind: str, k: int, **fields: Any) -> None:
        line = (json.dumps({"k": k, "kind": kind, **fields}, allow_nan=False) + "\n").encode()
        self._waiting.append(line)
        self._size += len(line)
        # If the process is killed, a few seconds are lost at most.
        if self._size > 64 * 1024 or kind in ("state", "message"):
            self._flush_file()

    def _flush_file(self) -> None:
        lines = b"".join(self._waiting)
        self._waiting, self._size = [], 0
        self._file.append(lines)


def read_pilot_record(folder: Path) -> list[Line]:
    """Return every line of a run's autopilot file in the order of steps; none where there is no file.

    A last line that is torn is left out.  Raises InputError for a file that :class:`PilotRecord` does not write.
    """
    path = folder / AUTOPILOT
    return list(_parse_lines(path, read_text(path))) if path.exists() else []


def _parse_lines(path: Path, text: str) -> Iterator[Line]:
    for number, line in enumerate(text.split("\n")[:-1], 1):
        entry = parse_json(line, f"{path}, line {number}")
        if not isinstance(entry, dict) or not isinstance(entry.get("k"), int) or not isinstance(entry.get("kind"), str):
            raise InputError(f"{path}, line {number}: must be an object with the step k and a kind")
        yield entry


def _describe_estimate(status: Status) -> Line:
    fix, seen, quality = status.fix, status.seen, status.quality
    deviations = {
        "place_m": quality.position_m,
        "speed_m_s": quality.speed_m_s,
        "height_m": quality.height_m,
        "climb_m_s": quality.climb_m_s,
        "attitude_rad": quality.attitude_rad,
    }
    valid = {name: value for name, value in quality._asdict().items() if isinstance(value, bool)}
    line: Line = (
        {}
        if seen is None
        else {
            "height": seen.altitude,
            "climb": -seen.velocity[2],
            "attitude": list(to_euler(seen.attitude)),
            "deviation": {name: value if isfinite(value) else None for name, value in deviations.items()},
            "valid": {"place" if name == "position" else name: value for name, value in valid.items()},
        }
    )
    return {
        "position": list(fix.position),
        "velocity": list(fix.velocity),
        "track": None if status.track is None else list(status.track),
        "positioned": status.positioned,
        "altitude": status.altitude,
        "yaw": status.yaw,
        **line,
    }
