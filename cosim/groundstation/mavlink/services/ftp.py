"""MAVLink file transfer (https://mavlink.io/en/services/ftp.html): files and folders that do not change, read only.

The session of a file is the number that its client says when it opens it, and every answer echoes it: MAVProxy counts
its own, QGroundControl and MAVSDK have one file open and say 0 (MAVSDK does not look at what it is given).  Opening
again on a number that is in use takes the place of the old file, so that a request that is repeated because its answer
was lost does no harm; nor does any other: nothing here depends on what was asked before but the open file.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from cosim.groundstation.mavlink.services.service import MAX_CLIENTS, Client, Outgoing, RateLimit, Service, crc32
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.dialect import mav as wire
from cosim.groundstation.mavlink.wire.peer import Peer

NONE, TERMINATE, RESET, LIST, OPEN, READ = 0, 1, 2, 3, 4, 5  # opcodes of MAVLink FTP
CRC, BURST, ACK, NAK = 14, 15, 128, 129  # opcodes of MAVLink FTP
_WRITE_OPCODES = range(6, 14)  # opcodes that change files
FAIL, BAD_SIZE, BAD_SESSION, END, UNKNOWN, PROTECTED, NOT_FOUND = 1, 3, 4, 6, 7, 9, 10  # error codes of MAVLink FTP

MAX_DATA_BYTES = 239  # data in one message
_HEAD = struct.Struct("<HBBBBBxI")  # header of a payload


class File(Protocol):
    """Readable file: ``size`` in bytes, and access to any part."""

    size: int

    def read(self, offset: int, length: int) -> bytes: ...


class MemoryFile:
    """Readable file whose content is in memory."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.size = len(data)

    def read(self, offset: int, length: int) -> bytes:
        return self._data[offset : offset + length]


# Returns the existing files at and below a path that a client names ("log/run.ulg"), by full path.
Files = Callable[[str], Mapping[str, File]]


class _Request(NamedTuple):
    """Request of a client: the header's fields and the data."""

    sequence: int
    session: int
    opcode: int
    size: int
    offset: int
    data: bytes


@dataclass
class _Burst:
    """Burst read that is being sent: position in the file and remaining messages."""

    request: _Request
    offset: int
    remaining: int  # messages still to be sent
    sequence: int


class _ClientState:
    """State of one client: its open files, and its burst at up to 239 kB/s."""

    def __init__(self) -> None:
        self.open: OrderedDict[int, File] = OrderedDict()
        self.burst: _Burst | None = None
        self.pace = RateLimit(1000.0, 16)


class FileService(Service):
    """MAVLink FTP service that serves :data:`Files`; a path that begins with ``@MAV_LOG`` is in ``log``.

    ``max_open``: files of one client that are open at most.  ``burst_length``: messages of one burst (24 kB), after
    which the client asks for the next.
    """

    handles = frozenset({"FILE_TRANSFER_PROTOCOL"})

    def __init__(self, files: Files, max_open: int = 8, burst_length: int = 100) -> None:
        self.burst_length = burst_length
        self.max_open = max_open
        self._files = files
        self._clients: OrderedDict[Client, _ClientState] = OrderedDict()

    def handle(self, message: Message, client: Client, now: float) -> list[Message]:
        """Return the answer to one request; bursts are sent later."""
        request = _parse_request(message.payload)
        if request is None:
            return []
        answer = self._answer_request(request, self._get_state(client))
        return [] if answer is None else [_make_message(client, answer)]

    def poll(self, now: float) -> Outgoing:
        """Return the messages of all bursts that may be sent now."""
        out: Outgoing = []
        for client, state in self._clients.items():
            if state.burst is not None:
                for _ in range(state.pace.take_tokens(now, state.burst.remaining, client.peer)):
                    out.append((client.peer, _make_message(client, _next_burst_message(state))))
                    if state.burst is None:
                        break
        return out

    @property
    def is_busy(self) -> bool:
        return any(state.burst for state in self._clients.values())

    def forget(self, peer: Peer) -> None:
        for client in [client for client in self._clients if client.peer == peer]:
            del self._clients[client]

    def _get_state(self, client: Client) -> _ClientState:
        """Return a client's state; of too many clients the least recently active one is dropped."""
        if client not in self._clients:
            if len(self._clients) >= MAX_CLIENTS:
                self._clients.popitem(last=False)
            self._clients[client] = _ClientState()
        self._clients.move_to_end(client)
        return self._clients[client]

    def _answer_request(self, request: _Request, state: _ClientState) -> bytes | None:
        code = request.opcode
        if code == NONE:
            return _make_ack(request)
        if code == TERMINATE:
            return self._close_file(request, state)
        if code == RESET:
            state.open.clear()
            state.burst = None
            return _make_ack(request)
        if code in _WRITE_OPCODES:
            return _make_nak(request, PROTECTED)
        if code not in (LIST, OPEN, CRC, READ, BURST):
            return _make_nak(request, UNKNOWN)
        if request.size > MAX_DATA_BYTES:
            return _make_nak(request, BAD_SIZE)
        return self._read_file(request, state) if code in (READ, BURST) else self._serve_path(request, state)

    def _serve_path(self, request: _Request, state: _ClientState) -> bytes:
        """Return the answer to a request on a path: list a folder, open a file, or compute a checksum."""
        code, path = request.opcode, _parse_path(request.data)
        if code == LIST:
            return self._list_folder(request, path)
        file = None if path is None else self._files(path).get(path)
        if file is None:
            return _make_nak(request, NOT_FOUND)
        if file.size >= 1 << 32:  # size does not fit in 32 bits
            return _make_nak(request, FAIL)
        if code == CRC:
            return _make_ack(request, struct.pack("<I", _compute_crc32(file)))
        state.open.pop(request.session, None)
        if len(state.open) >= self.max_open:
            state.open.popitem(last=False)
        state.open[request.session] = file
        return _make_ack(request, struct.pack("<I", file.size))

    def _close_file(self, request: _Request, state: _ClientState) -> bytes:
        """Close a file; repeated closing succeeds, as the first answer may have been lost."""
        state.open.pop(request.session, None)
        if state.burst is not None and state.burst.request.session == request.session:
            state.burst = None
        return _make_ack(request)

    def _read_file(self, request: _Request, state: _ClientState) -> bytes | None:
        file = state.open.get(request.session)
        if file is None:
            return _make_nak(request, BAD_SESSION)
        state.open.move_to_end(request.session)
        if request.offset >= file.size:
            return _make_nak(request, END)
        if request.opcode == BURST:
            state.burst = _Burst(request, request.offset, self.burst_length, request.sequence)
            return None
        return _make_ack(request, file.read(request.offset, request.size or MAX_DATA_BYTES), request.offset)

    def _list_folder(self, request: _Request, path: str | None) -> bytes:
        entries = None if path is None else _format_entries(self._files(path), path)
        if entries is None:
            return _make_nak(request, NOT_FOUND)
        if request.offset >= len(entries):
            return _make_nak(request, END)
        data = b""
        for entry in entries[request.offset :]:
            if len(data) + len(entry) > MAX_DATA_BYTES:
                break
            data += entry
        return _make_ack(request, data, request.offset)


def _next_burst_message(state: _ClientState) -> bytes:
    """Return the payload of a burst's next message; the last one is marked as last."""
    burst = state.burst
    assert burst is not None
    request, file = burst.request, state.open.get(burst.request.session)
    burst.sequence += 1
    if file is None:
        state.burst = None
        return _make_nak(request, BAD_SESSION, burst.sequence)
    data = file.read(burst.offset, request.size or MAX_DATA_BYTES)
    offset = burst.offset
    burst.offset += len(data)
    burst.remaining -= 1
    last = burst.remaining == 0 or burst.offset >= file.size or not data
    if last:
        state.burst = None
    return _pack_payload(request, ACK, data, offset, burst.sequence, last)


def _compute_crc32(file: File, part_bytes: int = 1 << 22) -> int:
    value = 0
    for offset in range(0, file.size, part_bytes):
        value = crc32(file.read(offset, part_bytes), value)
    return value


def _format_entries(files: Mapping[str, File], folder: str) -> list[bytes] | None:
    """Return the entries of a folder in MAVLink FTP's format, sorted; None if there is no such folder."""
    start = f"{folder}/" if folder else ""
    entries = {}
    for path, file in files.items():
        if path.startswith(start):
            name, slash, _ = path[len(start) :].partition("/")
            entries[name] = f"D{name}\0" if slash else f"F{name}\t{file.size}\0"
    return [entries[name].encode() for name in sorted(entries)] if entries or not folder else None


def _parse_path(data: bytes) -> str | None:
    """Return the normalised path in a request's data, or None if it is not UTF-8.

    It is looked up among the files' names and never goes to the disk, so that ``..`` leads nowhere.
    """
    try:
        text = data.split(b"\0")[0].decode("utf-8")
    except UnicodeDecodeError:
        return None
    parts = [part for part in text.split("/") if part not in ("", ".")]
    if parts and parts[0] == "@MAV_LOG":
        parts[0] = "log"
    return "/".join(parts)


def _parse_request(payload: list[int]) -> _Request | None:
    data = bytes(payload)
    if len(data) < _HEAD.size:
        return None
    sequence, session, opcode, size, _, _, offset = _HEAD.unpack_from(data)
    return _Request(sequence, session, opcode, size, offset, data[_HEAD.size : _HEAD.size + min(size, MAX_DATA_BYTES)])


def _make_ack(request: _Request, data: bytes = b"", offset: int = 0) -> bytes:
    return _pack_payload(request, ACK, data, offset, request.sequence + 1)


def _make_nak(request: _Request, code: int, sequence: int | None = None) -> bytes:
    return _pack_payload(request, NAK, bytes((code,)), 0, request.sequence + 1 if sequence is None else sequence)


def _pack_payload(request: _Request, code: int, data: bytes, offset: int, sequence: int, last: bool = False) -> bytes:
    head = _HEAD.pack(sequence & 0xFFFF, request.session, code, len(data), request.opcode, last, offset)
    return (head + data).ljust(_HEAD.size + MAX_DATA_BYTES, b"\0")


def _make_message(client: Client, payload: bytes) -> Message:
    return wire.MAVLink_file_transfer_protocol_message(0, client.system, client.component, list(payload))
