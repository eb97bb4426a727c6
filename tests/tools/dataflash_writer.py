"""Write logs as an ArduPilot does: each kind of message is described, then packed."""

import struct

CODES = {"c": "h", "n": "4s", "N": "16s", "Z": "64s"}  # by the letter in a description; others are struct's own


def pack(kind: int, columns: str, *values: float | bytes) -> bytes:
    return bytes([0xA3, 0x95, kind]) + struct.pack("<" + "".join(CODES.get(each, each) for each in columns), *values)


def describe(kind: int, name: str, columns: str, labels: str) -> bytes:
    size = 3 + struct.calcsize("<" + "".join(CODES.get(each, each) for each in columns))
    return pack(0x80, "BBnNZ", kind, size, name.encode(), columns.encode(), labels.encode())


HEAD = describe(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
