"""Betaflight's blackbox written: I and P frames with predictors and every encoding, events, slow and GNSS frames.

By the format's own description ("Blackbox Internals" of Betaflight), and apart from the reader: differences are taken
here, and added there.
"""

from dataclasses import dataclass, field

import numpy as np

SVB, UVB, NEG14, TAG8, TAG2_3, TAG8_4, NULL, TAG2_3V = 0, 1, 3, 6, 7, 8, 9, 10
HEAD = "H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n"
MASK = 0xFFFFFFFF


@dataclass(frozen=True)
class Field:
    """Signed; predictor and encoding in an I frame, and in a P frame."""

    name: str
    signed: int
    i: tuple[int, int]
    p: tuple[int, int]


FIELDS = [  # as the firmware lays them out, and TAG2_3V beside
    Field("loopIteration", 0, (0, UVB), (6, NULL)),
    Field("time", 0, (0, UVB), (2, SVB)),
    *[Field(f"axisP[{n}]", 1, (0, SVB), (1, SVB)) for n in range(3)],
    *[Field(f"axisI[{n}]", 1, (0, SVB), (1, TAG2_3)) for n in range(3)],
    *[Field(f"axisF[{n}]", 1, (0, SVB), (1, TAG2_3V)) for n in range(3)],
    *[Field(f"setpoint[{n}]", 1, (0, SVB), (1, TAG8_4)) for n in range(4)],
    Field("vbatLatest", 0, (9, NEG14), (1, TAG8)),
    Field("amperageLatest", 1, (0, SVB), (1, TAG8)),
    Field("rssi", 0, (0, UVB), (1, TAG8)),
    *[Field(f"gyroADC[{n}]", 1, (0, SVB), (3, SVB)) for n in range(3)],
    Field("motor[0]", 0, (11, UVB), (3, SVB)),
    *[Field(f"motor[{n}]", 0, (5, SVB), (3, SVB)) for n in range(1, 4)],
    Field("eRPM[0]", 0, (0, UVB), (1, TAG8)),
]


def uvb(value: int) -> bytes:
    value &= MASK
    made = bytearray()
    while value > 0x7F:
        made.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*made, value])


def svb(value: int) -> bytes:
    value = (value + 0x80000000 & MASK) - 0x80000000
    return uvb((value << 1) ^ (value >> 31))


def fits(value: int, size: int) -> bool:
    return -(1 << size - 1) <= value < 1 << size - 1


def needs(value: int, *widths: int) -> int:
    """The first of the widths [bits] that holds it, by its place."""
    return next(n for n, size in enumerate(widths) if fits(value, size))


def bits(*parts: tuple[int, int]) -> bytes:
    """Values of so many bits one behind the other, the first one highest."""
    word = total = 0
    for value, size in parts:
        word = word << size | value & (1 << size) - 1
        total += size
    assert total % 8 == 0
    return word.to_bytes(total // 8, "big")


def tag2_3(values: list[int], uneven: bool = False) -> bytes:
    a, b, c = values
    most = max(needs(v, 2, 4, 6, 32) for v in values)
    if uneven:
        packed = ((2, 2, 2), (5, 5, 4), (8, 7, 7))
        most = next((n for n, widths in enumerate(packed) if all(map(fits, values, widths))), 3)
    if most == 0:
        return bits((0, 2), (a, 2), (b, 2), (c, 2))
    if most == 1:
        return bits((1, 2), (a, 5), (b, 5), (c, 4)) if uneven else bits((1, 2), (0, 2), (a, 4), (b, 4), (c, 4))
    if most == 2:
        return bits((2, 2), (a, 8), (b, 7), (c, 7)) if uneven else bits((2, 2), (a, 6), (0, 2), (b, 6), (0, 2), (c, 6))
    sizes = [needs(v, 8, 16, 24, 32) for v in values]
    lead = 0xC0 | sizes[2] << 4 | sizes[1] << 2 | sizes[0]
    return bytes([lead]) + b"".join(
        (v & MASK).to_bytes(4, "little")[: n + 1] for v, n in zip(values, sizes, strict=True)
    )


def tag8_4(values: list[int]) -> bytes:
    kinds = [0 if v == 0 else 1 + needs(v, 4, 8, 16) for v in values]
    parts = [(v, (0, 4, 8, 16)[kind]) for v, kind in zip(values, kinds, strict=True) if kind]
    if sum(size for _, size in parts) % 8:
        parts.append((0, 4))
    return bytes([sum(kind << 2 * n for n, kind in enumerate(kinds))]) + (bits(*parts) if parts else b"")


def tag8(values: list[int]) -> bytes:
    if len(values) == 1:
        return svb(values[0])
    return bytes([sum((v != 0) << n for n, v in enumerate(values))]) + b"".join(svb(v) for v in values if v)


def encoded(codes: list[int], values: list[int]) -> bytes:
    made, n = b"", 0
    while n < len(codes):
        code, size = codes[n], {TAG2_3: 3, TAG2_3V: 3, TAG8_4: 4}.get(codes[n], 1)
        while code == TAG8 and size < 8 and n + size < len(codes) and codes[n + size] == TAG8:
            size += 1
        part = values[n : n + size]
        if code == SVB:
            made += svb(part[0])
        elif code == UVB:
            made += uvb(part[0])
        elif code == NEG14:
            made += uvb(-part[0] & 0x3FFF)
        elif code != NULL:
            made += {TAG8: tag8, TAG2_3: tag2_3, TAG8_4: tag8_4}.get(code, lambda v: tag2_3(v, True))(part)
        n += size
    return made


@dataclass
class Writer:
    """``every``: loop iterations from I frame to I frame, ``of``: to the next frame of any kind."""

    fields: list[Field] = field(default_factory=lambda: FIELDS)
    every: int = 32
    of: int = 1
    vbatref: int = 1680
    least_motor: int = 48
    fine: bool = False

    def head(self) -> bytes:
        rows = {
            "I name": [f.name for f in self.fields],
            "I signed": [f.signed for f in self.fields],
            "I predictor": [f.i[0] for f in self.fields],
            "I encoding": [f.i[1] for f in self.fields],
            "P predictor": [f.p[0] for f in self.fields],
            "P encoding": [f.p[1] for f in self.fields],
            "S name": ["flightModeFlags", "stateFlags", "failsafePhase", "rxSignalReceived", "rxFlightChannelsValid"],
            "S signed": [0] * 5,
            "S predictor": [0] * 5,
            "S encoding": [UVB, UVB, TAG2_3, TAG2_3, TAG2_3],
            "G name": ["time", "GPS_numSat", "GPS_coord[0]", "GPS_coord[1]"],
            "G signed": [0, 0, 1, 1],
            "G predictor": [10, 0, 7, 7],
            "G encoding": [UVB, UVB, SVB, SVB],
            "H name": ["GPS_home[0]", "GPS_home[1]"],
            "H signed": [1, 1],
            "H predictor": [0, 0],
            "H encoding": [SVB, SVB],
        }
        stated = {
            "Firmware type": "Cleanflight", "Firmware revision": "Betaflight 4.5.0", "I interval": self.every,
            "P interval": self.of, "P ratio": self.every // self.of, "minthrottle": 1070, "gyro_scale": "0x3f800000",
            "motorOutput": f"{self.least_motor},2047", "vbatref": self.vbatref,
            "blackbox_high_resolution": int(self.fine),
        }  # fmt: skip
        lines = [f"H Field {key}:{','.join(map(str, values))}" for key, values in rows.items()]
        return (HEAD + "\n".join([*lines, *(f"H {k}:{v}" for k, v in stated.items())]) + "\n").encode()

    def frames(self, table: dict[str, np.ndarray]) -> list[bytes]:
        """A frame for each row; ``loopIteration`` says which are I frames.  Fields that are not there are 0."""
        count = len(table["loopIteration"])
        rows = np.column_stack([table.get(f.name, np.zeros(count)).astype(np.int64) for f in self.fields]).tolist()
        made, last, before = [], rows[0], rows[0]
        for row in rows:
            whole = row[0] % self.every == 0 or not made
            motor = row[[f.name for f in self.fields].index("motor[0]")]
            values = []
            for n, f in enumerate(self.fields):
                said = {
                    0: 0, 1: last[n], 2: 2 * last[n] - before[n], 3: int((last[n] + before[n]) / 2), 5: motor,
                    6: row[n], 9: self.vbatref, 11: self.least_motor,
                }[(f.i if whole else f.p)[0]]  # fmt: skip
                values.append(row[n] - said)
            codes = [(f.i if whole else f.p)[1] for f in self.fields]
            made.append((b"I" if whole else b"P") + encoded(codes, values))
            before, last = (row if whole else last), row
        return made


SLOW = b"S" + uvb(3) + uvb(1) + tag2_3([0, 1, 1])
END = b"E\xffEnd of log\0"


def beside(time_since: int) -> bytes:
    """Home, a GNSS frame, and events of every kind but the end."""
    home = b"H" + svb(473977000) + svb(85455000)
    gnss = b"G" + uvb(time_since) + uvb(12) + svb(150) + svb(-70)
    events = b"E\x00" + uvb(77) + b"E\x1e" + uvb(5) + uvb(1) + b"E\x0d\x02" + svb(-9) + b"E\x0d\x82" + bytes(4)
    return home + gnss + events + b"E\x0f" + uvb(4)
