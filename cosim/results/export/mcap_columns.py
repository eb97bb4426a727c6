"""The columns of a run's log out of the MCAP that it was exported to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.storage.files import one_line

_PREFIX = "hexjet."  # of the schemas of our channels
_VARINT_END = 0x80  # the last byte of a tag is below it


def read_mcap_columns(path: Path) -> dict[str, Array]:
    """Return every column of a flight of ours, ``time_s`` among them.  Raises InputError for MCAP of another tool.

    A message of ours is one row of a channel: each field a tag and eight bytes, all messages of a channel alike.
    """
    try:
        from google.protobuf.descriptor_pb2 import FileDescriptorSet
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: MCAP needs {error.name}, which is not installed: pip install 'hexjet-cosim[export]'"
        ) from None
    rows: dict[str, list[bytes]] = {}
    names: dict[str, list[str]] = {}
    try:
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                if schema is None or not schema.name.startswith(_PREFIX):
                    continue
                if channel.topic not in names:
                    (described,) = FileDescriptorSet.FromString(schema.data).file
                    names[channel.topic] = [field.name for field in described.message_type[0].field]
                rows.setdefault(channel.topic, []).append(message.data)
    except (McapError, ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be read as MCAP: {one_line(error)}") from error
    if not rows:
        raise InputError(f"{path}: is MCAP of another tool; export the flight as ULog or CSV")
    columns: dict[str, Array] = {}
    for topic, messages in rows.items():
        columns |= _columns(path, names[topic], messages)
    return columns


def _columns(path: Path, names: list[str], messages: list[bytes]) -> dict[str, Array]:
    size = len(messages[0])
    layout: list[Any] = []
    for number in range(1, len(names) + 1):
        tag = 1 if number << 3 < _VARINT_END else 2
        layout += [(f"tag{number}", "u1", (tag,)), (f"value{number}", "<f8")]
    kind = np.dtype(layout)
    if kind.itemsize != size or any(len(message) != size for message in messages):
        raise InputError(f"{path}: its messages are not as hexjet export writes them")
    table = np.frombuffer(b"".join(messages), kind)
    return {name: table[f"value{n}"].astype(np.float64) for n, name in enumerate(names, 1)}
