"""A run's log as ULog, for PlotJuggler and PX4's Flight Review.

ULog follows PX4's "ULog File Format", version 1.  Topics have PX4's names and fields where a quantity is the same thing
in the same frame and unit (FRD body, NED, quaternions from body to NED); ``vehicle_*`` is what the sensors say,
``*_groundtruth`` is what is so, and ``wind`` is the true wind.  What PX4 has no topic for is in topics that begin with
``hexjet_``, and what blocks show of their own in ``hexjet_own``.  Values are float32, as PX4 logs them; the CSV has
every digit.  Parameters are the autopilot's, and the vehicle's and the scenario's numbers under their keys, with ``/``
where a key has a point, which a ULog's name must not have.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import Run
from cosim.logs import custom_columns, logged_vehicle_of, run_properties
from hexjet_export.logs import ulog_autopilot
from hexjet_export.logs.contents import (
    Block,
    Line,
    describe_column,
    list_numbers,
    log_lines,
    read_flown_scenario,
    read_pilot,
)
from hexjet_export.logs.ulog_topics import AUTOPILOT_TOPICS, CUSTOM, INTERVAL_S, REPLACED_TOPICS, Field, column, topics

Rates = Literal["all", "px4"]
_TYPES = {"float": "<f4", "bool": "<u1", "uint8_t": "<u1", "int32_t": "<i4", "uint64_t": "<u8"}  # numpy type of each


def export_ulog(run: Run, path: Path, rates: Rates = "all") -> None:
    """Write a run's log as ULog, with its autopilot's record if there is one.

    ``rates``: ``all`` writes every step, ``px4`` each topic about as often as PX4's default profile does
    (:data:`INTERVAL_S`), a tenth of that, and at the last step.  Raises InputError if there is no run or the file
    cannot be written.
    """
    step, lines = run.summary.step_s, read_pilot(run)
    custom = custom_columns(run.log.described)
    topics_by_name = dict(_select_topics(lines, run.log.columns)) | (
        {CUSTOM: [column("float", c.name, c.name) for c in custom]} if custom else {}
    )
    topics_held = {
        name: _make_topic(fields, step if rates == "all" else INTERVAL_S[name], step)
        for name, fields in topics_by_name.items()
    }
    pilot = ulog_autopilot.states(lines, run.summary.steps, step)
    at_start, changes = ulog_autopilot.parameters(lines)
    at_start = _list_parameters(list_numbers(read_flown_scenario(run))) | at_start
    with open(path, "wb") as file:
        file.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
        file.write(_pack(b"B", bytes(40)))
        file.writelines(_pack(b"I", _encode_info(key, value)) for key, value in _list_properties(run).items())
        file.writelines(_pack(b"I", _encode_info(f"{CUSTOM}_{c.name}", describe_column(c))) for c in custom)
        file.writelines(_pack(b"P", ulog_autopilot.parameter(name, value)) for name, value in at_start.items())
        file.writelines(_pack(b"F", _encode_format(name, topic.fields)) for name, topic in topics_held.items())
        file.writelines(_pack(b"F", _encode_format(name, _series_fields(series))) for name, series in pilot.items())
        file.writelines(
            _pack(b"A", struct.pack("<BH", 0, number) + name.encode())
            for number, name in enumerate([*topics_held, *pilot])
        )
        events = [
            *_make_series_messages(pilot, len(topics_held), step),
            *((line.k, _encode_log_message(line.severity, line.time_s, line.text)) for line in log_lines(run, lines)),
            *((k, _pack(b"P", ulog_autopilot.parameter(name, value))) for k, name, value in changes),
        ]
        events.sort(key=lambda event: event[0])
        done, first = 0, 0
        estimates, last = ulog_autopilot.estimates(lines), len(run.log) - 1
        for block in run.log.blocks(run.log.columns):
            if estimates is not None:
                block = block | _hold_estimates(estimates, first, len(block["time_s"]))
            messages = [
                message
                for n, topic in enumerate(topics_held.values())
                for message in _make_messages(topic, n, block, first, last)
            ]
            first += len(block["time_s"])
            while done < len(events) and events[done][0] < first:
                messages.append(events[done])
                done += 1
            messages.sort(key=lambda message: message[0])
            file.writelines(content for _, content in messages)
        file.writelines(content for _, content in events[done:])


class _Topic(NamedTuple):
    """A topic of log rows: its fields, its interval in rows, and the layout of its messages."""

    fields: list[Field]
    every: int
    kind: np.dtype[np.void]


_Timed = tuple[int, bytes]  # step and message


def _select_topics(lines: Sequence[Line], names: Sequence[str]) -> list[tuple[str, list[Field]]]:
    """Return the topics to write of log rows; those of an autopilot replace the loops'."""
    rows = topics(logged_vehicle_of(names))
    if not any(line["kind"] == "state" for line in lines):
        return list(rows.items())
    return [(name, fields) for name, fields in (rows | AUTOPILOT_TOPICS).items() if name not in REPLACED_TOPICS]


def _make_topic(fields: list[Field], seconds: float, step: float) -> _Topic:
    return _Topic(fields, max(1, round(seconds / step)), _make_dtype(fields))


def _make_messages(topic: _Topic, number: int, block: Block, first: int, last: int) -> Iterator[_Timed]:
    """Yield a topic's data messages of a block that begins at step ``first``, always including step ``last``."""
    count = len(block["time_s"])
    steps = [*range(first + -first % topic.every, first + count, topic.every)]
    if first <= last < first + count and last % topic.every:
        steps.append(last)
    rows = {name: values[np.array(steps, dtype=np.intp) - first] for name, values in block.items()}
    messages = np.zeros(len(steps), dtype=topic.kind)
    _fill_messages(messages, number, topic.fields, rows)
    content, size = messages.tobytes(), topic.kind.itemsize
    for n, k in enumerate(steps):
        yield k, content[n * size : (n + 1) * size]


def _hold_estimates(estimates: ulog_autopilot.Series, first: int, count: int) -> Block:
    """Return the autopilot's estimates as columns of a block, each held until the next."""
    at = np.searchsorted(estimates.k, np.arange(first, first + count), side="right") - 1
    return {
        f"autopilot_{name}": np.where(at < 0, np.nan, values[np.maximum(at, 0)])
        for name, values in estimates.values.items()
    }


def _series_fields(series: ulog_autopilot.Series) -> list[Field]:
    """Return the fields of a topic of the autopilot's record."""
    return [column(ulog_autopilot.TYPES.get(name, "float"), name, name) for name in series.values]


def _make_series_messages(pilot: Mapping[str, ulog_autopilot.Series], number: int, step: float) -> Iterator[_Timed]:
    """Yield the data messages of the autopilot's topics, numbered from ``number``."""
    for n, series in enumerate(pilot.values(), number):
        fields = _series_fields(series)
        messages = np.zeros(len(series.k), dtype=_make_dtype(fields))
        _fill_messages(messages, n, fields, {"time_s": series.k.astype(np.float64) * step, **series.values})
        yield from ((k, message.tobytes()) for k, message in zip(series.k.tolist(), messages, strict=True))


def _list_parameters(numbers: Mapping[str, float]) -> dict[str, float]:
    """Return the numbers that a ULog parameter can hold, with names of the characters that it allows."""
    named = {re.sub(r"[^A-Za-z0-9_/-]", "_", name): value for name, value in numbers.items()}
    return {
        name: value
        for name, value in named.items()
        if len(name) <= 240 and not (isinstance(value, int) and not -(2**31) <= value < 2**31)
    }


def _encode_log_message(severity: int, time: float, text: str) -> bytes:
    level = str(severity).encode()
    return _pack(b"L", level + struct.pack("<Q", _to_microseconds(time)) + text.encode()[:60_000])


def _fill_messages(message: NDArray[np.void], number: int, fields: Iterable[Field], block: Block) -> None:
    """Write one data message per row."""
    message["size"] = message.dtype.itemsize - 3  # size without the header's three bytes
    message["type"] = ord("D")
    message["id"] = number
    message["timestamp"] = np.rint(1e6 * block["time_s"])
    with np.errstate(over="ignore"):  # float32 overflows to infinity
        for field in fields:
            message[field.name] = field.values(block)


def _make_dtype(fields: Iterable[Field]) -> np.dtype[np.void]:
    head = [("size", "<u2"), ("type", "u1"), ("id", "<u2"), ("timestamp", "<u8")]
    return np.dtype(head + [(f.name, _TYPES[f.kind], (f.length,) if f.length else ()) for f in fields])


def _encode_format(name: str, fields: Iterable[Field]) -> bytes:
    declarations = (f"{f.kind}[{f.length}] {f.name};" if f.length else f"{f.kind} {f.name};" for f in fields)
    return f"{name}:uint64_t timestamp;{''.join(declarations)}".encode()


def _encode_info(key: str, value: str) -> bytes:
    content = value.encode()[:60_000]
    full_key = f"char[{len(content)}] {key}".encode()
    return bytes([len(full_key)]) + full_key + content


def _pack(kind: bytes, content: bytes) -> bytes:
    """Return a ULog message: the content behind its size and kind."""
    return struct.pack("<H", len(content)) + kind + content


def _list_properties(run: Run) -> dict[str, str]:
    values = run_properties(run.summary)
    names = ("scenario", "engine", "controller", "seed", "outcome", "reason")
    return {
        "sys_name": "hexjet-cosim",
        "ver_sw": values["version"],
        "ver_hw": values["aircraft"],
        **{f"hexjet_{name}": values[name] for name in names},
    }


def _to_microseconds(seconds: float) -> int:
    return round(1e6 * seconds)
