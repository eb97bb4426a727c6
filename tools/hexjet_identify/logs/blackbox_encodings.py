"""The encodings of Betaflight's blackbox: each from a place in the data to the values and the place behind them.

IndexError where the data end before the value does.
"""

from __future__ import annotations

from collections.abc import Sequence

MASK = (1 << 32) - 1  # the lowest 32 bits of a number


def unsigned(data: bytes, at: int) -> tuple[int, int]:
    """Read a number of seven bits a byte, the lowest first, five bytes at most; return it and where it ends."""
    value, shift = 0, 0
    while shift < 35:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & MASK, at
        shift += 7
    raise IndexError


def signed(data: bytes, at: int) -> tuple[int, int]:
    """Read a signed number in zigzag, 0, -1, 1, -2 as 0, 1, 2, 3; return it and where it ends."""
    value, at = unsigned(data, at)
    return (value >> 1) ^ -(value & 1), at


def extended(value: int, bits: int) -> int:
    value &= (1 << bits) - 1
    return value - (1 << bits) if value >> (bits - 1) else value


def _signed_bytes(data: bytes, at: int, count: int) -> tuple[int, int]:
    """Read a signed integer of so many bytes, the lowest first; return it and where it ends."""
    if at + count > len(data):
        raise IndexError
    return int.from_bytes(data[at : at + count], "little", signed=True), at + count


def tag8(data: bytes, at: int, count: int) -> tuple[list[int], int]:
    """Read values behind a byte with a bit for each that is not 0; one value alone has no such byte."""
    tags, at = (1, at) if count == 1 else (data[at], at + 1)
    values = []
    for _ in range(count):
        value = 0
        if tags & 1:
            value, at = signed(data, at)
        values.append(value)
        tags >>= 1
    return values, at


def tag2_3(data: bytes, at: int, packed: Sequence[tuple[int, Sequence[tuple[int, int]]]]) -> tuple[list[int], int]:
    """Read three values whose width two bits say: one of three packings, or whole bytes for each."""
    lead = data[at]
    if lead >> 6 < 3:
        length, places = packed[lead >> 6]
        if at + length > len(data):
            raise IndexError
        word = int.from_bytes(data[at : at + length], "big")
        return [extended(word >> shift, bits) for shift, bits in places], at + length
    at += 1
    values = []
    for _ in range(3):
        value, at = _signed_bytes(data, at, (lead & 3) + 1)
        values.append(value)
        lead >>= 2
    return values, at


# Packings by their tag: number of bytes, and shift and width [bits] of each value.
_TWO_BIT_PACKING = (1, ((4, 2), (2, 2), (0, 2)))
EVEN = (_TWO_BIT_PACKING, (2, ((8, 4), (4, 4), (0, 4))), (3, ((16, 6), (8, 6), (0, 6))))
UNEVEN = (_TWO_BIT_PACKING, (2, ((9, 5), (4, 5), (0, 4))), (3, ((14, 8), (7, 7), (0, 7))))


def tag8_4(data: bytes, at: int) -> tuple[list[int], int]:
    """Read four values of 0, 4, 8 or 16 bits, as two bits each say; packed by half bytes, the high one first."""
    tags = data[at]
    at = 2 * (at + 1)  # in half bytes
    values = []
    for _ in range(4):
        bits = (0, 4, 8, 16)[tags & 3]
        value = 0
        for _ in range(bits // 4):
            value = value << 4 | (data[at >> 1] >> (0 if at & 1 else 4) & 0x0F)
            at += 1
        values.append(extended(value, bits) if bits else 0)
        tags >>= 2
    return values, (at + 1) >> 1
