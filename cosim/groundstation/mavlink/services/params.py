"""The parameter protocol: the pilot's parameters as a ground station reads and sets them.

A set is a request to the pilot, executed between two steps; the answer goes out when it is done.  Every change, whoever
made it, is told to every ground station.

How a whole number travels in PARAM_VALUE's 32-bit float depends on whom the vehicle claims to be: PX4 puts the bits of
the integer there, ArduPilot the number itself, and a generic autopilot has floats only.
"""

from __future__ import annotations

import struct
from math import isfinite

import numpy as np

from cosim.base.errors import InputError
from cosim.control.autopilot.parameters import Parameter, Parameters
from cosim.control.autopilot.requests import Answer, Result, SetParameter
from cosim.groundstation.mavlink.services.service import (
    MAX_CLIENTS,
    AnswerQueue,
    Ask,
    Client,
    Outgoing,
    RateLimit,
    Service,
    crc32,
    decode_text,
)
from cosim.groundstation.mavlink.telemetry_state import Personality
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.dialect import mav as wire
from cosim.groundstation.mavlink.wire.peer import Peer

# PX4's parameter with the hash of all others: a station that has cached the same set requests no list.
HASH_NAME = "_HASH_CHECK"

REAL32, INT32, UINT32 = wire.MAV_PARAM_TYPE_REAL32, wire.MAV_PARAM_TYPE_INT32, wire.MAV_PARAM_TYPE_UINT32
_INTEGER_FORMATS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}  # struct format by type
# Values of MAV_PARAM_ERROR; pymavlink lacks the last two.
UNKNOWN, OUT_OF_RANGE, NOT_NOW, READ_ONLY, UNSUPPORTED_TYPE, OTHER_TYPE = 1, 2, 3, 5, 6, 7


class ParameterService(Service):
    """Parameter service: PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET in; PARAM_VALUE, PARAM_ERROR out."""

    handles = frozenset({"PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"})

    def __init__(self, parameters: Parameters, ask: Ask, personality: Personality = "px4") -> None:
        self._personality = personality
        self._answers = AnswerQueue(ask)
        # For each client that reads the list: index of the next parameter, and the rate limit.
        self._lists: dict[Client, tuple[int, RateLimit]] = {}
        self.replace(parameters)

    def replace(self, parameters: Parameters) -> None:
        """Use the parameters of another flight of the same vehicle."""
        self._parameters = parameters
        # PX4 sorts parameters by name and hashes them in this order.
        self._lines = sorted(parameters, key=lambda line: line.name)
        self._index = {line.name: i for i, line in enumerate(self._lines)}
        self._sent = dict(parameters.values)
        self._lists = {client: (0, pace) for client, (_, pace) in self._lists.items()}

    def handle(self, message: Message, client: Client, now: float) -> list[Message]:
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            if client in self._lists or len(self._lists) < MAX_CLIENTS:
                first = -1 if self._personality == "px4" else 0  # the hash first, as index -1
                # The limit is 100 values/s: 3.7 kB/s, two thirds of what a radio at 57600 baud carries.
                pace = self._lists[client][1] if client in self._lists else RateLimit(100.0, 10)
                self._lists[client] = (first, pace)
            return []
        if kind == "PARAM_REQUEST_READ":
            return [self._read_parameter(message, client)]
        return self._set_parameter(message, client)

    def poll(self, now: float) -> Outgoing:
        """Return the autopilot's answers, changed values, and the next values of every list."""
        out = self._answers.take_messages()
        values = dict(self._parameters.values)
        if values != self._sent:
            out += [(None, self._make_value(self._index[n])) for n, v in values.items() if v != self._sent[n]]
            self._sent = values
        for client, (at, pace) in list(self._lists.items()):
            end = at + pace.take_tokens(now, len(self._lines) - at, client.peer)
            out += [(client.peer, self._make_value(i) if i >= 0 else self._make_hash_value()) for i in range(at, end)]
            if end == len(self._lines):
                del self._lists[client]
            else:
                self._lists[client] = (end, pace)
        return out

    @property
    def is_busy(self) -> bool:
        return bool(self._lists)

    def forget(self, peer: Peer) -> None:
        self._lists = {client: state for client, state in self._lists.items() if client.peer != peer}

    def hash(self) -> int:
        """Return PX4's hash over every name and value."""
        state, values = 0, self._parameters.values
        for line in self._lines:
            state = crc32(line.name.encode(), state)
            layout = "<i" if line.kind == "int" else "<f"
            number = int(values[line.name]) if line.kind == "int" else values[line.name]
            state = crc32(struct.pack(layout, number), state)
        return state

    def _read_parameter(self, message: Message, client: Client) -> Message:
        index, name = message.param_index, decode_text(message.param_id)
        if index >= 0:
            return self._make_value(index) if index < len(self._lines) else self._make_error(client, "", index, UNKNOWN)
        if name == HASH_NAME and self._personality == "px4":
            return self._make_hash_value()
        if name not in self._index:
            return self._make_error(client, name, -1, UNKNOWN)
        return self._make_value(self._index[name])

    def _set_parameter(self, message: Message, client: Client) -> list[Message]:
        name = decode_text(message.param_id)
        if name == HASH_NAME and self._personality == "px4":
            # A station that sends the same hash has the set in its cache and needs no list.
            if struct.pack("<f", message.param_value) == struct.pack("<f", self._make_hash_value().param_value):
                self._lists.pop(client, None)
            return []
        if name not in self._index:
            return [self._make_error(client, name, -1, UNKNOWN)]
        line = self._lines[self._index[name]]
        value = self._decode(message.param_value, message.param_type, line)
        if isinstance(value, _TypeRefusal):
            return self._refuse(client, name, value.code)
        value = self._restore_precision(value, line)
        try:
            self._parameters.check(name, value)
            request = SetParameter(name, value)
        except InputError:
            code = READ_ONLY if line.read_only and isfinite(value) else OUT_OF_RANGE
            return self._refuse(client, name, code)
        self._answers.request(request, client, lambda answer: self._reply(answer, client, name))
        return []

    def _reply(self, answer: Answer, client: Client, name: str) -> Outgoing:
        if not answer.accepted:
            code = NOT_NOW if answer.result is Result.TEMPORARILY_REJECTED else OUT_OF_RANGE
            return [(client.peer, message) for message in self._refuse(client, name, code)]
        self._sent[name] = self._parameters[name]
        return [(None, self._make_value(self._index[name]))]

    def _refuse(self, client: Client, name: str, code: int) -> list[Message]:
        """Return PARAM_ERROR and, for stations that do not know it, the present value."""
        return [self._make_error(client, name, -1, code), self._make_value(self._index[name])]

    def _make_value(self, index: int) -> Message:
        line = self._lines[index]
        value, kind = self._encode(self._parameters[line.name], line)
        return wire.MAVLink_param_value_message(line.name.encode(), value, kind, len(self._lines), index)

    def _make_hash_value(self) -> Message:
        (value,) = struct.unpack("<f", struct.pack("<I", self.hash()))
        return wire.MAVLink_param_value_message(HASH_NAME.encode(), value, UINT32, len(self._lines), 65535)

    def _make_error(self, client: Client, name: str, index: int, code: int) -> Message:
        return wire.MAVLink_param_error_message(
            client.system, client.component, name.encode("ascii", "replace")[:16], index, code
        )

    def _encode(self, value: float, line: Parameter) -> tuple[float, int]:
        """Return a value in the encoding of PARAM_VALUE, and its MAV_PARAM_TYPE."""
        if line.kind == "float" or self._personality == "generic":
            return value, REAL32
        if self._personality == "ardupilot":
            return float(int(value)), INT32
        (bits,) = struct.unpack("<f", struct.pack("<i", int(value)))
        return bits, INT32

    def _decode(self, value: float, kind: int, line: Parameter) -> float | _TypeRefusal:
        """Return the value in PARAM_SET, or the refusal of its type."""
        if kind != REAL32 and kind not in _INTEGER_FORMATS:
            return _TypeRefusal(UNSUPPORTED_TYPE)
        if self._personality == "ardupilot":  # ArduPilot clients may state any type
            return value
        expected = INT32 if line.kind == "int" and self._personality == "px4" else REAL32
        if kind != expected and not (expected == INT32 and kind in _INTEGER_FORMATS):
            return _TypeRefusal(OTHER_TYPE)
        if kind == REAL32:
            return value
        layout = _INTEGER_FORMATS[kind]
        (number,) = struct.unpack_from(layout, struct.pack("<f", value))
        return float(number)

    def _restore_precision(self, value: float, line: Parameter) -> float:
        """Return the 64-bit number that a 32-bit one stands for.

        The present value or the default if it is one of these, else the shortest number that is the same in 32 bits:
        0.1 and not 0.10000000149.  Either way it reads back equal.
        """
        if not isfinite(value):
            return value
        for candidate in (self._parameters[line.name], line.default):
            if np.float32(candidate) == np.float32(value):
                return candidate
        return float(str(np.float32(value)))


class _TypeRefusal:
    """Refusal of a parameter's type; ``code`` is the MAV_PARAM_ERROR."""

    def __init__(self, code: int) -> None:
        self.code = code
