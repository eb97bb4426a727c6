"""A run's log as MCAP, for Foxglove, PlotJuggler and Rerun.

Every column is in a channel of its subject (:data:`SUBJECTS`), every step, as float64: the log's own names, units and
meanings in the channel's metadata.  Beside them are Foxglove's own messages, from which it draws: see
:mod:`hexjet_export.logs.scene`.  All are Protocol Buffers, because Rerun reads Foxglove's messages in that encoding
alone, and because it has NaN, which JSON has not.  Times are from the start of the flight; chunks are zstd.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim import InputError, Run
from cosim.logs import Column, custom_columns, describe_columns, run_properties
from hexjet_export.logs.contents import (
    Block,
    LogLine,
    Timed,
    describe_column,
    log_lines,
    read_flown_scenario,
    read_pilot,
)

# Topics with the pattern of their columns' names; columns that blocks added are in CUSTOM.
SUBJECTS = {
    "/attitude": r"(roll|pitch|yaw)(_setpoint|_measured)?_rad",
    "/rate": r"rate_[pqr](_measured|_predicted|_setpoint)?_rad_s",
    "/position": r"(north|east|down|altitude)(_setpoint|_measured)?_m",
    "/velocity": r"velocity_(north|east|down)(_measured)?_m_s",
    "/specific_force": r"specific_force_[xyz](_measured)?_m_s2",
    "/control": r"(torque|refused)_(roll|pitch|yaw)|(refused_)?collective",
    "/jet": r"throttle_\d+|thrust_\d+_N",
    "/tilt": r"tilt_.+_rad|deflection_.+",
    "/engine": r"(spool_speed|exhaust_temperature|fuel_flow)_\d+_\w+|fuel_kg|spool_moment_[xyz]_N_m",
    "/wind": r"wind_(north|east|down)_m_s|air_rate_[pqr]_rad_s",
    "/disturbance": r"disturbance_\w+|payload_\w+",
    "/vehicle": r"mass_kg|on_ground|hull_contact",
    "/fault": r"fault_\w+|health_\d+",
}
CUSTOM, TIME = "/own", "/time"  # topics without a pattern
_PACKAGE = "hexjet"  # package name of our schemas
_LEVELS = {0: 5, 1: 5, 2: 5, 3: 4, 4: 3, 5: 2, 6: 2, 7: 1}  # foxglove.Log level by syslog severity


class Channel(NamedTuple):
    """Number, columns and message layout of a channel of log columns."""

    number: int
    columns: tuple[str, ...]
    kind: np.dtype[np.void]
    tags: tuple[bytes, ...]


def export_mcap(run: Run, path: Path) -> None:
    """Write a run's log as MCAP: columns, vehicle in 3D, position on a map, texts.

    ``scenario.toml`` and ``summary.json`` are attached, the run's facts are a metadata record.  Without a readable
    scenario there is neither vehicle nor map.  Raises InputError if there is no run, the file cannot be written, or
    the packages of the extra ``export`` are not installed.
    """
    try:
        from mcap.writer import CompressionType, Writer

        from hexjet_export.logs import scene
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("mcap", "mcap_protobuf", "google", "foxglove_schemas_protobuf"):
            raise
        raise InputError(
            f"MCAP needs {error.name}, which is not installed: "
            "pip install mcap mcap-protobuf-support foxglove-schemas-protobuf"
        ) from None

    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="hexjet-cosim")
        writer.add_metadata("hexjet", run_properties(run.summary))
        writer.add_metadata(
            "hexjet.columns", {column.name: describe_column(column) for column in describe_columns(run)}
        )
        for name, kind in (("scenario.toml", "application/toml"), ("summary.json", "application/json")):
            if run.folder is not None and (run.folder / name).is_file():
                writer.add_attachment(0, 0, name, kind, (run.folder / name).read_bytes())
        channels = register_channels(writer, describe_columns(run))
        drawing = scene.Scene(writer, run.summary.step_s, read_flown_scenario(run))
        texts = _make_text_messages(writer, log_lines(run, read_pilot(run)))
        done, first, last = 0, 0, len(run.log) - 1
        for block in run.log.blocks(run.log.columns):
            messages = [*iterate_messages(channels, block, first), *drawing.messages(block, first, last)]
            first += len(block["time_s"])
            while done < len(texts) and texts[done][0] < first:
                messages.append(texts[done])
                done += 1
            _write_messages(writer, sorted(messages, key=lambda message: message[0]))
        _write_messages(writer, texts[done:])
        writer.finish()


def _write_messages(writer: Any, messages: Sequence[Timed]) -> None:
    for k, time, channel, content in messages:
        writer.add_message(channel, time, content, time, k)


def group_by_channel(columns: Sequence[Column]) -> dict[str, list[Column]]:
    """Return a log's columns grouped by topic; ``time_s`` has a topic of its own."""
    custom = {column.name for column in custom_columns(columns)}
    groups: dict[str, list[Column]] = {}
    for column in columns:
        matches = [name for name, pattern in SUBJECTS.items() if re.fullmatch(pattern, column.name)]
        own = column.name in custom or not matches
        groups.setdefault(TIME if column.name == "time_s" else CUSTOM if own else matches[0], []).append(column)
    return groups


def register_channels(writer: Any, columns: Sequence[Column]) -> list[Channel]:
    """Register a channel for each topic of a log's columns and return them."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

    channels = []
    for topic, of in group_by_channel(columns).items():
        files = FileDescriptorSet()
        file = files.file.add(name=f"hexjet{topic}.proto", package=_PACKAGE, syntax="proto3")
        message = file.message_type.add(name=topic.strip("/").title().replace("_", ""))
        for number, column in enumerate(of, 1):
            message.field.add(
                name=column.name,
                json_name=column.name,
                number=number,
                type=FieldDescriptorProto.TYPE_DOUBLE,
                label=FieldDescriptorProto.LABEL_OPTIONAL,
            )
        schema = writer.register_schema(f"{_PACKAGE}.{message.name}", "protobuf", files.SerializeToString())
        meanings = {column.name: describe_column(column) for column in of}
        channel = writer.register_channel(topic, "protobuf", schema, meanings)
        # Wire type 1 of Protocol Buffers is a fixed 64-bit number.
        tags = tuple(_varint(number << 3 | 1) for number in range(1, len(of) + 1))
        layout = [part for n, tag in enumerate(tags) for part in ((f"tag{n}", "u1", (len(tag),)), (f"value{n}", "<f8"))]
        channels.append(Channel(channel, tuple(column.name for column in of), np.dtype(layout), tags))
    return channels


def _varint(number: int) -> bytes:
    """Return a number as a Protocol Buffers varint: seven bits a byte, the lowest first."""
    return bytes([number]) if number < 0x80 else bytes([number & 0x7F | 0x80]) + _varint(number >> 7)


def iterate_messages(channels: Sequence[Channel], block: Block, first: int) -> Iterator[Timed]:
    """Yield one message per row and channel; each field is a tag and eight bytes, so all have one layout."""
    times = [round(1e9 * time) for time in block["time_s"].tolist()]
    for channel in channels:
        messages = np.zeros(len(times), dtype=channel.kind)
        for n, (name, tag) in enumerate(zip(channel.columns, channel.tags, strict=True)):
            messages[f"tag{n}"] = np.frombuffer(tag, np.uint8)
            messages[f"value{n}"] = block[name]
        content, size = messages.tobytes(), channel.kind.itemsize
        for row, time in enumerate(times):
            yield first + row, time, channel.number, content[row * size : (row + 1) * size]


def _make_text_messages(writer: Any, lines: Sequence[LogLine]) -> list[Timed]:
    """Register the channel of text lines and return the lines as its messages."""
    from foxglove_schemas_protobuf.Log_pb2 import Log
    from mcap_protobuf.schema import register_schema

    channel: int = writer.register_channel("/log", "protobuf", register_schema(writer, Log))
    messages = []
    for line in lines:
        time = round(1e9 * line.time_s)
        message = Log(level=_LEVELS[line.severity], message=line.text, name=line.kind)
        message.timestamp.FromNanoseconds(time)
        messages.append((line.k, time, channel, message.SerializeToString()))
    return messages
