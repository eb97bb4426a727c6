"""A stand-in for ArduCopter's SITL over JSON, as a program: as unkind as that is, and nothing in it is of the project.

Written from the sources of ArduCopter 4.8 and measured beside one that flew, in the standard
library alone.  When it is armed it begins a log with all its parameters.  It waits for a ground station on its first serial port unless it is told otherwise; listens on TCP on the others; goes at real time unless it
is told otherwise; its frame rate begins at 1200 and slides; it refuses to be armed early, holds its motors for 2 s after
that, and lets them go slowly; its sticks have ranges and dead zones and the throttle's is bent; its mixer has the signs
of its frames, or of the script that it finds, whose outputs it sends a loop late.  It lets what is asked follow the
sticks slowly and feeds its rate forward; its attitude is the integral of its gyro, drawn to the one that it is told.
It holds its place in Loiter, once it has one.

    arducopter_standin.py --model JSON:127.0.0.1 --home 0,0,0,0 -I0 --defaults FILE --serial0 tcp:0 --speedup 100
"""

from __future__ import annotations

import argparse
import json
import math
import re
import socket
import struct
import sys
import time
from pathlib import Path

TITLE = "ArduCopter V4.8.0-dev"
# By its own names, as it ships.
DEFAULTS: dict[str, float] = {
    "FRAME_CLASS": 1, "FRAME_TYPE": 1, "SCHED_LOOP_RATE": 400, "SIM_RATE_HZ": 1200, "SIM_SPEEDUP": 1, "ARMING_SKIPCHK": 0,
    "SIM_DRIFT_SPEED": 0.05, "SIM_BARO_RND": 0.2, "SIM_GPS1_LAG_MS": 100,
    "ATC_ANGLE_MAX": 30, "PILOT_Y_RATE": 202.5, "PILOT_Y_EXPO": 0, "INS_GYRO_FILTER": 20, "ATC_ANGLE_BOOST": 1,
    "MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000, "MOT_THST_EXPO": 0.65, "MOT_SPIN_MAX": 0.95, "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_ARM": 0.1, "MOT_THST_HOVER": 0.35, "MOT_SPOOL_TIME": 0.5, "CC_TYPE": 0, "CC_AXIS_MASK": 0,
    **{f"RC{n}_{key}": value for n in range(1, 17) for key, value in
       (("MIN", 1100), ("MAX", 1900), ("TRIM", 1500), ("DZ", 0), ("REVERSED", 0), ("OPTION", 0))},
    **{f"RC{n}_DZ": 20 for n in (1, 2, 4)}, "RC3_DZ": 30,
    **{f"SERVO{n}_{key}": value for n in range(1, 17) for key, value in
       (("MIN", 1100), ("MAX", 1900), ("TRIM", 1500), ("FUNCTION", 32 + n if n < 5 else 0))},
    **{f"ATC_RAT_{axis}_{key}": value for axis, p, i, d, f in
       (("RLL", 0.135, 0.135, 0.0036, 20), ("PIT", 0.135, 0.135, 0.0036, 20), ("YAW", 0.18, 0.018, 0.0, 2.5))
       for key, value in (("P", p), ("I", i), ("D", d), ("FLTT", 20), ("FLTE", f if axis == "YAW" else 0),
                          ("FLTD", 20), ("IMAX", 0.5))},
    **{f"ATC_ANG_{axis}_P": 4.5 for axis in ("RLL", "PIT", "YAW")},
    "ATC_INPUT_TC": 0.15, "ATC_RATE_FF_ENAB": 1, "ATC_ACC_R_MAX": 1100, "ATC_ACC_P_MAX": 1100,
    "ATC_ACC_Y_MAX": 270, "SCR_ENABLE": 0, "MOT_YAW_HEADROOM": 200,
    **{f"FLTMODE{n}": 0 for n in range(1, 7)},
}  # fmt: skip
# FRAME_TYPE of four motors: of every motor where it is, degrees to the right of the nose, and 1 for counter-clockwise.
_X = ((45, 1), (-135, 1), (-45, -1), (135, -1))
_PLUS = ((90, 1), (-90, 1), (0, -1), (180, -1))
_BETAFLIGHT = ((135, -1), (45, 1), (-135, 1), (-45, -1))


def _other_way(motors: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
    return tuple((angle, -turn) for angle, turn in motors)


FRAMES = {
    0: _PLUS, 1: _X, 3: _other_way(_X), 6: _other_way(_PLUS), 12: _BETAFLIGHT, 18: _other_way(_BETAFLIGHT),
}  # fmt: skip
SERIALS = {0: "tcp:0:wait", 1: "tcp:2", 2: "tcp:3", 5: "tcp:5", 6: "tcp:6", 7: "tcp:7", 8: "tcp:8"}
HOLDS_S = 2.0  # after arming
READY_S = 25.0  # its estimator's, before which it is not armed
PLACE_S = 44.0  # before that it has no position
LOITER, DRAWN_S, CLIMB = 5, 2.0, 2.5  # a mode; how slowly its attitude is drawn to what it is told; full stick, m/s
AXES = ("RLL", "PIT", "YAW")
LEAST_ACCEL, MOST_ACCEL = (40.0, 40.0, 10.0), (720.0, 720.0, 120.0)  # of large errors, deg/s^2
ROW = re.compile(r"^Motors_6DoF:add_motor\(([^)]*)\)")
# Messages of its log by their name: number, format characters and fields.
LOGGED = {"FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"), "PARM": (64, "QNff", "TimeUS,Name,Value,Default"),
          "VER": (65, "QBBBZ", "TimeUS,Maj,Min,Pat,FWS")}  # fmt: skip
PACKED = {"B": "B", "n": "4s", "N": "16s", "Z": "64s", "Q": "Q", "f": "f"}


def say(text: str) -> None:
    print(text, flush=True)


def limit(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def part(hertz: float, dt: float) -> float:
    """Of a first-order low-pass, in a step; no low-pass for 0 Hz."""
    return 1.0 if hertz <= 0.0 else dt / (dt + 1.0 / (2.0 * math.pi * hertz))


def root(error: float, gain: float, most: float, dt: float) -> float:
    """In proportion to a small error and by the root of a large one, so that ``most`` slows it down; at most all of it."""
    part = most / gain**2 if most > 0.0 else math.inf
    size = abs(error)
    asked = gain * size if size <= part else math.sqrt(2.0 * most * (size - 0.5 * part))
    return math.copysign(min(asked, size / dt), error)


def log_message(name: str, *values: float | str) -> bytes:
    """Return a message of a DataFlash log."""
    number, form, _ = LOGGED[name]
    filled = [value.encode() if isinstance(value, str) else value for value in values]
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(PACKED[letter] for letter in form), *filled)


def begin_log(parameters: dict[str, float], now: float) -> None:
    """Write the next log below the folder that it runs in: formats, every parameter by name, then the version."""
    folder = Path("logs")
    folder.mkdir(exist_ok=True)
    lengths = {name: 3 + struct.calcsize("<" + "".join(PACKED[x] for x in row[1])) for name, row in LOGGED.items()}
    made = [log_message("FMT", row[0], lengths[name], name, *row[1:]) for name, row in LOGGED.items()]
    made += [log_message("PARM", int(1e6 * now), name, value, value) for name, value in parameters.items()]
    made += [log_message("VER", int(1e6 * now), 4, 8, 0, f"stand-in for {TITLE}")]
    (folder / f"{len(list(folder.iterdir())) + 1:08d}.BIN").write_bytes(b"".join(made))


class Radio:
    """Sixteen channels on UDP, heard fifty times a second, and what the sticks mean."""

    def __init__(self, port: int, parameters: dict[str, float]) -> None:
        self._parameters = parameters
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setblocking(False)
        self.heard = False
        self.pulses = [1500, 1500, 1000, 1500, *[1500] * 12]
        self._next = 0.0

    def listen(self, now: float) -> bool:
        """Whether it is time to hear; the latest is what it hears."""
        if now < self._next:
            return False
        self._next = now + 0.02
        while True:
            try:
                self.pulses = list(struct.unpack("<16H", self._socket.recv(64)))
                self.heard = True
            except BlockingIOError:
                return True

    def of(self, channel: int, key: str) -> float:
        return self._parameters[f"RC{channel}_{key}"]

    def angle(self, channel: int) -> float:
        """From -1 to 1, with a dead zone around the middle."""
        pulse = limit(self.pulses[channel - 1], self.of(channel, "MIN"), self.of(channel, "MAX"))
        high, low = (self.of(channel, "TRIM") + way * self.of(channel, "DZ") for way in (1, -1))
        if pulse > high:
            share = (pulse - high) / (self.of(channel, "MAX") - high)
        else:
            share = (pulse - low) / (low - self.of(channel, "MIN")) if pulse < low else 0.0
        return round(4500 * share) / 4500

    def range(self, channel: int, pulse: float) -> int:
        """From 0 to 1000, with a dead zone at the bottom."""
        low = self.of(channel, "MIN") + self.of(channel, "DZ")
        pulse = limit(pulse, self.of(channel, "MIN"), self.of(channel, "MAX"))
        return int(1000 * (pulse - low) / (self.of(channel, "MAX") - low)) if pulse > low else 0

    def throttle(self, hover: float) -> float:
        """The stick as it is bent: in its middle is ``hover``."""
        middle = self.range(3, (self.of(3, "MIN") + self.of(3, "MAX")) / 2)
        stick = self.range(3, self.pulses[2])
        share = 0.5 * stick / middle if stick < middle else 0.5 + 0.5 * (stick - middle) / (1000 - middle)
        bend = limit(-(hover - 0.5) / 0.375, -0.5, 1.0)
        return share * (1.0 - bend) + bend * share**3


class Motors:
    """Spooling, mixing and pulses of a quadrotor."""

    def __init__(self, parameters: dict[str, float]) -> None:
        self._parameters = parameters
        self._mix = self._make_mix()
        self.state, self._spun, self.most = "SHUT_DOWN", 0.0, 0.0
        self.limited = True

    def _make_mix(self) -> list[tuple[float, ...]]:
        """In its own order, by roll (left up), pitch (nose up) and yaw (nose right), the greatest a half."""
        if int(self._parameters["FRAME_CLASS"]) != 1:
            raise SystemExit("no such frame")
        frame = FRAMES[int(self._parameters["FRAME_TYPE"])]
        rows = [(-math.sin(math.radians(angle)), math.cos(math.radians(angle)), float(turn)) for angle, turn in frame]
        most = [max(abs(row[k]) for row in rows) for k in range(3)]
        return [tuple(0.5 * row[k] / most[k] for k in range(3)) for row in rows]

    def spool(self, dt: float, runs: bool, wanted: str, throttle: float) -> None:
        """As its states go: shut down, idling, going up, free, going down."""
        step = dt / self._parameters["MOT_SPOOL_TIME"]
        self.limited = self.state in ("SHUT_DOWN", "GROUND_IDLE")
        if not runs:
            self.state, self._spun, self.most = "SHUT_DOWN", 0.0, 0.0
        elif self.state == "SHUT_DOWN":
            self.state = "GROUND_IDLE"
        elif self.state == "GROUND_IDLE":
            least = self._parameters["MOT_SPIN_MIN"]
            idle = self._parameters["MOT_SPIN_ARM"] / least if least > 0.0 else 0.0
            self._spun = self._spun + step if wanted == "FREE" else self._spun + limit(idle - self._spun, -step, step)
            if wanted == "FREE" and self._spun >= 1.0:
                self.state, self._spun = "SPOOLING_UP", 1.0
        elif wanted != "FREE":
            self.state, self.most = "SPOOLING_DOWN", max(0.0, min(self.most, 1.0) - step)
            if self.most == 0.0:
                self.state = "GROUND_IDLE"
        elif self.state in ("SPOOLING_UP", "SPOOLING_DOWN"):
            self.state, self.most = "SPOOLING_UP", self.most + step
            if self.most >= min(throttle, 1.0):
                self.state, self.most = "FREE", 1.0

    def pulses(self, torque: tuple[float, float, float], throttle: float) -> list[int]:
        """Of sixteen outputs, by the functions of the servos."""
        shares = self._shares(torque, min(throttle, self.most))
        least, most = self._parameters["MOT_PWM_MIN"], self._parameters["MOT_PWM_MAX"]
        made = [0] * 16
        for output in range(16):
            motor = int(self._parameters[f"SERVO{output + 1}_FUNCTION"]) - 33
            if 0 <= motor < len(shares):
                made[output] = int(least + (most - least) * shares[motor])
        return made

    def _shares(self, torque: tuple[float, float, float], throttle: float) -> list[float]:
        least = self._parameters["MOT_SPIN_MIN"]
        if self.state == "SHUT_DOWN":
            return [0.0] * len(self._mix)
        if self.state == "GROUND_IDLE":
            return [self._spun * least] * len(self._mix)
        asked = [sum(a * b for a, b in zip(row, torque, strict=True)) for row in self._mix]
        spread = max(asked) - min(asked)
        if spread > 1.0:
            asked, self.limited = [value / spread for value in asked], True
        # as much thrust as is asked for, and no more or less than leaves room for the torques
        throttle = limit(throttle, -min(asked), 1.0 - max(asked))
        expo, most = self._parameters["MOT_THST_EXPO"], self._parameters["MOT_SPIN_MAX"]
        return [least + (most - least) * self._linear(limit(throttle + value, 0.0, 1.0), expo) for value in asked]

    @staticmethod
    def _linear(thrust: float, expo: float) -> float:
        """The motor for a thrust, of motors whose thrust is bent by ``expo``."""
        if expo < 0.01:
            return thrust
        return (expo - 1.0 + math.sqrt((1.0 - expo) ** 2 + 4.0 * expo * thrust)) / (2.0 * expo)


class Motors6(Motors):
    """Of a script: every motor's parts as they are; one that goes both ways has a dead zone around its middle."""

    def _make_mix(self) -> list[tuple[float, ...]]:
        """By roll, pitch, yaw and throttle, then whether it goes both ways; nothing without a script."""
        scripts = sorted(Path("scripts").glob("*.lua")) if self._parameters["SCR_ENABLE"] else []
        lines = [line for path in scripts for line in path.read_text(encoding="utf-8").splitlines()]
        words = [found[1].replace(" ", "").split(",") for line in lines if (found := ROW.match(line))]
        if not any(f"init({len(words)})" in line for line in lines):
            say("Check frame class and type")
        said = "\n".join(lines)
        self.flies_level = any(f"set_{way}_enable(false)" not in said for way in ("forward", "lateral"))
        return [(*map(float, row[1:5]), float(row[7] == "true")) for row in words]

    def pulses(self, torque: tuple[float, float, float], throttle: float) -> list[int]:
        throttle = min(throttle, self.most)
        turns = [sum(a * b for a, b in zip(row[:3], torque, strict=True)) for row in self._mix]
        kept, room = [throttle * row[3] for row in self._mix], 1.0
        for turn, base in zip(turns, kept, strict=True):
            if abs(base + turn) > 1.0:
                room, self.limited = min(room, (math.copysign(1.0, base + turn) - base) / turn), True
        asked = [limit(base + room * turn, -1.0, 1.0) for base, turn in zip(kept, turns, strict=True)]
        made, dead = [0] * 16, limit(1e-3 * self._parameters["MOT_YAW_HEADROOM"], 0.0, 0.25)
        for output in range(16):
            motor = int(self._parameters[f"SERVO{output + 1}_FUNCTION"])
            motor -= 33 if motor < 82 else 74
            if 0 <= motor < len(asked):
                made[output] = self._pulse(asked[motor], self._mix[motor][4] > 0.0, dead)
        return made

    def _pulse(self, asked: float, both: bool, dead: float) -> int:
        turns = self.state not in ("SHUT_DOWN", "GROUND_IDLE")
        least, most = self._parameters["MOT_SPIN_MIN"], self._parameters["MOT_SPIN_MAX"]
        if both:
            return int(1500 + 500 * most * asked * turns * (abs(asked) >= dead))
        spun = least + (most - least) * self._linear(limit(asked, 0.0, 1.0), self._parameters["MOT_THST_EXPO"])
        return int(1000 + 1000 * spun * turns)


class Copter:
    """Arming, sticks, attitude and rate loops."""

    def __init__(self, parameters: dict[str, float], radio: Radio) -> None:
        self.parameters, self.radio = parameters, radio
        self.motors = (Motors6 if parameters["FRAME_CLASS"] == 16 else Motors)(parameters)
        self._goal, self._goal_rate, self._goal_slope = [0.0] * 3, [0.0] * 3, [0.0] * 3
        self.armed_at: float | None = None
        self._switches: dict[int, str] = {}
        self._closed_since: float | None = 0.0
        self._heading: float | None = None
        self._asked = [0.0, 0.0, 0.0]  # rates that the attitude loop asked for, one loop ago
        self._target, self._error, self._slope, self._sum = ([0.0] * 3 for _ in range(4))
        self._throttle = 0.0
        self._quaternion: list[float] | None = None
        self._bias, self._rests = [0.0] * 3, 0
        self._sent = [0] * 16
        self._mode, self._place = 0, [0.0, 0.0, 0.0]

    def step(self, told: dict, now: float, dt: float) -> list[int]:
        """Pulses for what it is told of an instant."""
        if self.radio.listen(now) and self.radio.heard:
            self._hear(now)
            self._choose(now, told["position"])
        # on top of the gyro that it is told, for the first five minutes
        drift = math.radians(self.parameters["SIM_DRIFT_SPEED"]) * now / 60.0
        told["imu"]["gyro"] = [rate + drift for rate in told["imu"]["gyro"]]
        runs = self.armed_at is not None and now - self.armed_at > HOLDS_S
        closed = self._closed_since is not None and now - self._closed_since > 0.4
        torque = self._rates(told["imu"]["gyro"], dt)
        self.motors.spool(dt, runs, "IDLE" if closed else "FREE", self._throttle)
        pulses = self.motors.pulses(torque, self._throttle)
        self._attitude(self._estimate(told, dt), told, dt)
        if isinstance(self.motors, Motors6):
            pulses, self._sent = self._sent, pulses
        return pulses

    def _estimate(self, told: dict, dt: float) -> list[float]:
        """The gyro's integral, drawn to what is told."""
        if self._quaternion is None:
            self._quaternion = told["quaternion"]
        w, x, y, z = self._quaternion
        if self.armed_at is None:  # what the gyro says until then is its bias
            self._rests += 1
            self._bias = [b + (g - b) / self._rests for b, g in zip(self._bias, told["imu"]["gyro"], strict=True)]
        p, q, r = (0.5 * dt * (rate - bias) for rate, bias in zip(told["imu"]["gyro"], self._bias, strict=True))
        turned = [
            w - x * p - y * q - z * r,
            x + w * p + y * r - z * q,
            y + w * q + z * p - x * r,
            z + w * r + x * q - y * p,
        ]
        sign = 1.0 if sum(a * b for a, b in zip(turned, told["quaternion"], strict=True)) > 0.0 else -1.0
        drawn = [a + dt / DRAWN_S * (sign * b - a) for a, b in zip(turned, told["quaternion"], strict=True)]
        size = math.sqrt(sum(a * a for a in drawn))
        self._quaternion = [a / size for a in drawn]
        return self._quaternion

    def _choose(self, now: float, place: list[float]) -> None:
        """The mode of the fifth channel; one that holds the place needs one."""
        slot = 1 + sum(self.radio.pulses[4] > limit for limit in (1230, 1360, 1490, 1620, 1749))
        mode = int(self.parameters[f"FLTMODE{slot}"])
        if mode == LOITER and now < PLACE_S:
            say("Mode change to LOITER failed: requires position")
        elif mode != self._mode:
            self._mode, self._place = mode, [*place]
            say(f"mode {mode}")

    def _loiter(self, told: dict, yaw: float, dt: float) -> list[float]:
        """The lean that holds the place, and the throttle that holds the height, into the place of the stick's."""
        moving = told["velocity"]
        self._place[2] -= dt * CLIMB * (self.radio.range(3, self.radio.pulses[2]) / 500.0 - 1.0)
        north, east, down = (
            limit(1.6 * (1.0 * (a - b) - v), -3.0, 3.0)
            for a, b, v in zip(self._place, told["position"], moving, strict=True)
        )
        self._throttle = limit(self.parameters["MOT_THST_HOVER"] * (1.0 - 2.0 * down / 9.81), 0.0, 1.0)
        ahead = north * math.cos(yaw) + east * math.sin(yaw)
        right = east * math.cos(yaw) - north * math.sin(yaw)
        return [math.atan2(right, 9.81), -math.atan2(ahead, 9.81)]

    def _hear(self, now: float) -> None:
        stick = self.radio.range(3, self.radio.pulses[2])
        self._closed_since = None if stick > 0 else self._closed_since if self._closed_since is not None else now
        for channel in range(1, 17):
            option, pulse = int(self.radio.of(channel, "OPTION")), self.radio.pulses[channel - 1]
            at = "HIGH" if pulse > 1800 else "LOW" if pulse < 1200 else "MIDDLE"
            if option and at != self._switches.get(channel):
                self._switches[channel] = at
                self._switched(option, at, now)

    def _switched(self, option: int, at: str, now: float) -> None:
        if option == 153 and at == "HIGH":
            if now < READY_S or self._closed_since is None:
                say(f"Arm: not ready at {now:.3f}")
                return
            self.armed_at = now
            begin_log(self.parameters, now)
            say(f"Arming motors at {now:.3f}")
        elif option == 153 and at == "LOW" and self.armed_at is not None:
            self.armed_at = None
            say(f"Disarming motors at {now:.3f}")
        elif option == 109 and self.parameters["CC_TYPE"]:
            say(f"Custom controller is {'ON' if at == 'HIGH' else 'OFF'} at {now:.3f}")

    def _rates(self, gyro: list[float], dt: float) -> tuple[float, float, float]:
        made = []
        for k, axis in enumerate(AXES):
            p, i, d, target, error, slope, most = (
                self.parameters[f"ATC_RAT_{axis}_{key}"] for key in ("P", "I", "D", "FLTT", "FLTE", "FLTD", "IMAX")
            )
            self._target[k] += part(target, dt) * (self._asked[k] - self._target[k])
            before = self._error[k]
            self._error[k] += part(error, dt) * (self._target[k] - gyro[k] - before)
            self._slope[k] += part(slope, dt) * ((self._error[k] - before) / dt - self._slope[k])
            grown = self._sum[k] + i * self._error[k] * dt
            if not self.motors.limited or abs(grown) < abs(self._sum[k]):
                self._sum[k] = limit(grown, -most, most)
            made.append(p * self._error[k] + self._sum[k] + d * self._slope[k])
        if self.motors.state in ("SHUT_DOWN", "GROUND_IDLE"):
            self._sum, self._heading = [0.0] * 3, None
        return made[0], made[1], made[2]

    def _attitude(self, quaternion: list[float], told: dict, dt: float) -> None:
        w, x, y, z = quaternion
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(limit(2.0 * (w * y - z * x), -1.0, 1.0))
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        full = math.radians(self.parameters["ATC_ANGLE_MAX"])
        wanted = [full * self.radio.angle(1), full * self.radio.angle(2)]
        if getattr(self.motors, "flies_level", False):
            wanted = [0.0, 0.0]  # it would push sideways and stay level
        if self._mode == LOITER:
            wanted = self._loiter(told, yaw, dt)
        turn, bend = self.radio.angle(4), self.parameters["PILOT_Y_EXPO"]
        turn = math.radians(self.parameters["PILOT_Y_RATE"]) * (1.0 - bend) * turn / (1.0 - bend * abs(turn))
        self._shape(wanted, turn, yaw, dt)
        off = (self._goal[2] - yaw + math.pi) % (2.0 * math.pi) - math.pi
        errors = (self._goal[0] - roll, self._goal[1] - pitch, off)
        for k, (axis, error) in enumerate(zip(AXES, errors, strict=True)):
            most = self.parameters[f"ATC_ACC_{axis[0]}_MAX"]
            most = math.radians(limit(most / 2.0, LEAST_ACCEL[k], MOST_ACCEL[k])) if most > 0.0 else 0.0
            self._asked[k] = root(error, self.parameters[f"ATC_ANG_{axis}_P"], most, dt) + self._goal_rate[k]
        if self._mode != LOITER:
            self._throttle = self.radio.throttle(self.parameters["MOT_THST_HOVER"])
        if self.parameters["ATC_ANGLE_BOOST"]:
            self._throttle /= limit(math.cos(wanted[0]) * math.cos(wanted[1]), 0.1, 1.0)
        if self.motors.state in ("SHUT_DOWN", "GROUND_IDLE"):
            self._throttle = 0.0 if self._closed_since is not None else self._throttle

    def _shape(self, wanted: list[float], turn: float, yaw: float, dt: float) -> None:
        """Let the goal follow the sticks, of roll and pitch by ATC_INPUT_TC; its rate is fed forward.

        With a limit of jerk too, by an acceleration of 1800 deg/s^2 where none is set.
        """
        feeds = self.parameters["ATC_RATE_FF_ENAB"] != 0.0
        self._goal = [goal + rate * dt for goal, rate in zip(self._goal, self._goal_rate, strict=True)]
        if self._heading is None:
            self._goal[2], self._goal_rate[2] = yaw, 0.0
        self._heading = yaw
        for k, axis in enumerate(AXES):
            most = math.radians(self.parameters[f"ATC_ACC_{axis[0]}_MAX"])
            late = max(self.parameters["ATC_INPUT_TC"], 0.01)
            most, late = most or math.radians(1800.0), 10.0 * dt if k == 2 else late
            asked = turn if k == 2 else root(wanted[k] - self._goal[k], 0.5 / late, most, dt)
            jerk = most / late * dt
            self._goal_slope[k] += limit((asked - self._goal_rate[k]) / late - self._goal_slope[k], -jerk, jerk)
            asked = self._goal_rate[k] + self._goal_slope[k] * dt
            self._goal_rate[k] = limit(asked, self._goal_rate[k] - most * dt, self._goal_rate[k] + most * dt)
        if not feeds:
            self._goal, self._goal_rate = [*wanted, self._goal[2] + turn * dt], [0.0] * 3


def lines_of(text: str) -> list[str]:
    """As it reads them, into 99 bytes: what is behind them is a line of its own, a note no more."""
    return [line[k : k + 98] for line in text.splitlines() for k in range(0, max(1, len(line)), 98)]


def read(path: str | None) -> dict[str, float]:
    """Its parameters, with those of a file over them; a name that it does not have is left out, and said."""
    parameters = dict(DEFAULTS)
    for line in lines_of(Path(path).read_text(encoding="utf-8")) if path else ():
        words = line.split("#")[0].replace(",", " ").split()
        if words and words[0] not in parameters:
            say(f"Ignored unknown param {words[0]}")
        elif words:
            parameters[words[0]] = float(words[1])
    return parameters


def open_serials(stated: dict[int, str], base: int) -> list[socket.socket]:
    """Its serial ports that are TCP, here on loopback alone; the first waits unless it is told otherwise."""
    opened = []
    for number, path in (SERIALS | stated).items():
        kind, *rest = path.split(":")
        if kind != "tcp":
            continue
        listening = socket.create_server(("127.0.0.1", base + int(rest[0])))
        opened.append(listening)
        say(f"SERIAL{number} on TCP port {base + int(rest[0])}")
        if rest[1:] == ["wait"]:
            say("Waiting for connection ....")
            opened.append(listening.accept()[0])
    return opened


def fly(copter: Copter, port: int, speedup: float) -> None:
    """Send, wait, and live through what is answered, for ever."""
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.settimeout(1.0)
    rate, count, now, pulses, begun = 1200.0, 0, None, [0] * 16, time.monotonic()
    while True:
        packet = struct.pack("<HHI16H", 18458, int(rate), count, *pulses)
        out.sendto(packet, ("127.0.0.1", port))
        while True:
            try:
                told = json.loads(out.recv(4096))
                break
            except TimeoutError:
                say("No JSON sensor message received, resending servos")
                out.sendto(packet, ("127.0.0.1", port))
            except ConnectionRefusedError:
                return
        before, now, count = now, told["timestamp"], count + 1
        if before is not None and 0.0 < now - before < 0.1:
            pulses = copter.step(told, now, now - before)
            rate += limit(copter.parameters["SIM_RATE_HZ"] - rate, -1.0, 1.0)
        ahead = now / speedup - (time.monotonic() - begun)
        if ahead > 0.0:
            time.sleep(ahead)


def installed(folder: Path) -> Path:
    """It as a program in a folder."""
    program = folder / "arducopter"
    program.write_text(f"#!{sys.executable}\n{Path(__file__).read_text(encoding='utf-8')}", encoding="utf-8")
    program.chmod(0o755)
    return program


def main() -> None:
    known = argparse.ArgumentParser(allow_abbrev=False)
    for name in ("--model", "--home", "--defaults"):
        known.add_argument(name)
    known.add_argument("-I", "--instance", type=int, default=0)
    known.add_argument("--speedup", type=float, default=1.0)
    known.add_argument("--wipe", action="store_true")
    for number in SERIALS:
        known.add_argument(f"--serial{number}")
    stated = known.parse_args(sys.argv[1:])
    say(f"Starting SITL: JSON, speedup {stated.speedup:g}")
    parameters = read(stated.defaults)
    paths = {number: getattr(stated, f"serial{number}") for number in SERIALS}
    held = open_serials({n: path for n, path in paths.items() if path}, 5760 + 10 * stated.instance)
    radio = Radio(5501 + 10 * stated.instance, parameters)
    say(f"{len(held)} sockets")
    fly(Copter(parameters, radio), 9002 + 10 * stated.instance, stated.speedup)


if __name__ == "__main__":
    main()
