"""Component metadata: names, units, ranges and groups of the parameters, for a ground station to show.

Two JSON files, packed with xz, that are read over MAVLink's file transfer, and the message that says where the first
one is.  https://mavlink.io/en/services/component_information.html
"""

from __future__ import annotations

import json
import lzma
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from cosim.control.autopilot.parameters import Parameter
from cosim.groundstation.mavlink.services.service import crc32
from cosim.groundstation.mavlink.telemetry import parse_version
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.dialect import mav as wire

# Paths of the metadata files, as in PX4.
GENERAL, PARAMETERS = "etc/extras/component_general.json.xz", "etc/extras/parameters.json.xz"


class Metadata:
    """Metadata files of one vehicle, and messages with their addresses.

    Both files are of version 1, the only one that QGroundControl reads; so is their type, COMP_METADATA_TYPE_PARAMETER.
    ``on_request``: COMPONENT_METADATA, and COMPONENT_INFORMATION for older ground stations, by their numbers; each is
    made of simulation time in ms.
    """

    def __init__(self, parameters: Iterable[Parameter], name: str, version: str) -> None:
        inner = _compress({"version": 1, "parameters": [describe_parameter(line) for line in parameters]})
        general = _compress(
            {
                "version": 1,
                "vendorName": "hexjet-cosim",
                "modelName": name,
                "firmwareVersion": ".".join(map(str, parse_version(version))),
                "metadataTypes": [{"type": 1, "uri": _make_uri(PARAMETERS), "fileCrc": crc32(inner)}],
            }
        )
        self.files: Mapping[str, bytes] = {GENERAL: general, PARAMETERS: inner}
        crc, uri = crc32(general), _make_uri(GENERAL).encode()

        self.on_request: Mapping[int, Callable[[int], Message]] = {
            wire.MAVLINK_MSG_ID_COMPONENT_METADATA: (
                lambda boot: wire.MAVLink_component_metadata_message(boot, crc, uri)
            ),
            wire.MAVLINK_MSG_ID_COMPONENT_INFORMATION: (
                lambda boot: wire.MAVLink_component_information_message(boot, crc, uri, 0, b"")
            ),
        }


def describe_parameter(line: Parameter) -> dict[str, Any]:
    """Return a parameter in the format of MAVLink's parameter.schema.json."""
    number = int if line.kind == "int" else float
    described: dict[str, Any] = {
        "name": line.name,
        "type": "Int32" if line.kind == "int" else "Float",
        "shortDesc": line.text[:1].upper() + line.text[1:],
        "group": line.group,
        "category": "Standard",
        "default": number(line.default),
        "min": number(line.least),
        "max": number(line.most),
    }
    if line.unit:
        described["units"] = line.unit
    if line.kind == "float":
        described["decimalPlaces"] = line.decimals
    if line.values:
        described["values"] = [{"value": meaning.value, "description": meaning.text} for meaning in line.values]
    if line.read_only:
        described["readOnly"] = True
    return described


def _compress(content: Mapping[str, Any]) -> bytes:
    """Return JSON compressed by xz with CRC32, as not every reader knows the default CRC64."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return lzma.compress(text.encode(), format=lzma.FORMAT_XZ, check=lzma.CHECK_CRC32)


def _make_uri(path: str) -> str:
    return f"mftp:///{path}"
