"""``requests.jsonl``: what was asked of the autopilot, before which step, by whom, and what it answered.

Written while a flight lasts, a line a request, and flown again later without a ground station.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.errors import InputError
from cosim.base.storage.appended import AppendedFile
from cosim.base.storage.files import map_os_errors, parse_json, read_text
from cosim.control.autopilot.autopilot import Autopilot
from cosim.control.autopilot.requests import Answer, Request, from_dict, to_dict

_ENTRY_KEYS = ("step", "sender", "result", "text", "asked")  # keys of an entry beside the request's


class Entry(NamedTuple):
    """One request with sender and answer."""

    step: int
    sender: str
    request: Request
    result: str  # result of the answer
    asked: bool = True  # False: refused without asking the pilot


class RequestLog:
    """Appends lines to a new file; each is handed to the system whole, so that a killed process loses none.

    Raises InputError if the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        with map_os_errors(InputError, path):
            self._file = AppendedFile(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self.close = self._file.close

    def write(self, k: int, sender: str, request: Request, answer: Answer, asked: bool = True) -> None:
        """Append a request that was handled before step ``k``, or refused without asking the pilot.

        Raises FlightError if it cannot be written.
        """
        line: dict[str, Any] = {"step": k, "sender": sender, "result": answer.result.value}
        if answer.text:
            line["text"] = answer.text
        if not asked:
            line["asked"] = False
        self._file.append((json.dumps(line | to_dict(request), allow_nan=False) + "\n").encode())


def read_requests(path: Path) -> list[Entry]:
    """Return all lines of the file, without a torn last one, which was never flown.

    Raises InputError, naming the line, for anything that :class:`RequestLog` does not write.
    """
    entries: list[Entry] = []
    for number, line in enumerate(read_text(path).split("\n")[:-1], 1):
        entry = _parse_entry(line, f"{path}, line {number}")
        if entries and entry.step < entries[-1].step:
            raise InputError(f"{path}, line {number}: step {entry.step} comes after step {entries[-1].step}")
        entries.append(entry)
    return entries


def _parse_entry(line: str, where: str) -> Entry:
    data = parse_json(line, where)
    if not isinstance(data, dict):
        raise InputError(f"{where}: must be a JSON object")
    step = data.get("step")
    if not isinstance(step, int) or isinstance(step, bool) or step < 0:
        raise InputError(f"{where}: step = {step!r}: must be a whole number, 0 or more")
    request = {key: value for key, value in data.items() if key not in _ENTRY_KEYS}
    try:
        asked = data.get("asked") is not False
        return Entry(step, str(data.get("sender", "")), from_dict(request), str(data.get("result", "")), asked)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


class Replay:
    """Repeats recorded requests to an autopilot, each before the step at which it came."""

    def __init__(self, pilot: Autopilot, entries: Sequence[Entry]) -> None:
        self.pilot = pilot
        self._entries = entries
        self._next = 0
        self.otherwise: list[str] = []  # answers that differ from the record

    def __call__(self, k: int) -> None:
        while self._next < len(self._entries) and self._entries[self._next].step <= k:
            entry = self._entries[self._next]
            self._next += 1
            if not entry.asked:
                continue
            answer = self.pilot.handle(entry.request, k)
            if entry.result and answer.result.value != entry.result:
                name = type(entry.request).__name__
                self.otherwise.append(
                    f"{name} before step {k} ({entry.sender}): {entry.result} then, {answer.result.value} now"
                )
