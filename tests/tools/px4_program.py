"""A stand-in for PX4's program that is as unkind as that: started like it, configured like it, late and deaf like it.

Written from what PX4's sources (1.17) do, by rules of its own; it shares nothing with what it talks to but pymavlink.
``px4 -d -i N -w FOLDER ETC`` takes ``PX4_PARAM_NAME`` from its environment and complains of names that it does not have.
It connects to port 4560 + N and is told of HIL_SENSOR, and what is hard for a simulator is hard here too:

* an answer waits for the estimator, which runs once in as many samples as ``IMU_INTEG_RATE`` makes of their rate;
* a compass or barometer that says the same number too often is stale, and is not listened to;
* what the gyro says before arming is its bias from then on;
* the throttle is held down for ``COM_SPOOLUP_TIME`` after arming and comes up at 50 %/s;
* mid-stick is the hover throttle, yaw has a dead zone and is bent, channels have ends and a middle of their own;
* without a fix for some seconds it holds no place: it says so, and leans no more;
* its mixer takes what a tilt does from ``CA_SV_TLn_TD`` and the side of its rotors alone, wherever these stand in height;
* all numbers are of single precision.

What it saw is in ``seen.json`` in its folder, told anew every quarter of a thousand samples and when the link closes.
"""

from __future__ import annotations

import json
import os
import re
import socket
import struct
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common as mav

Array = npt.NDArray[np.float32]
PATIENCE_S = 60.0
BOOT = 9  # samples before the first answer
ESTIMATOR_S = 2.0  # from then on answers wait for it
READY_S = 10.0  # before that it does not arm
TAKEOFF_S = 30.198  # when it says that it has taken off
BLIND_S = 5.0  # without a fix, from which on it lands blind
HOLD_DEAD = 0.1  # MPC_HOLD_DZ: a stick within it is let go of
SAME = 1e-6  # values that are nearer to each other are the same
STALE = {"mag": 1000, "baro": 100}  # so many of the same in a row

_AXES = ("ROLL", "PITCH", "YAW")
DEFAULTS: dict[str, float] = {
    "SYS_AUTOSTART": 0, "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 0, "CA_SV_TL_COUNT": 0, "IMU_INTEG_RATE": 250,
    "IMU_GYRO_CUTOFF": 40.0, "IMU_DGYRO_CUTOFF": 20.0, "IMU_GYRO_RATEMAX": 800, "MC_AIRMODE": 0, "MC_YAW_TQ_CUTOFF": 2.0,
    "MC_REF_W_N": 50.0, "SENS_GPS0_DELAY": 10,
    "COM_RC_IN_MODE": 3, "COM_SPOOLUP_TIME": 1.0, "MAN_DEADZONE": 0.1, "MPC_THR_HOVER": 0.5, "MPC_MANTHR_MIN": 0.08,
    "MPC_THR_MAX": 1.0, "MPC_THR_CURVE": 0, "MPC_MAN_TILT_MAX": 35.0, "MPC_MAN_Y_MAX": 150.0, "MPC_MAN_Y_TAU": 0.08,
    "THR_MDL_FAC": 0.0, "RC_MAP_ROLL": 0, "RC_MAP_PITCH": 0, "RC_MAP_YAW": 0, "RC_MAP_THROTTLE": 0, "RC_MAP_ARM_SW": 0,
    "RC_MAP_FLTMODE": 0, "RC_CHAN_CNT": 0, "SDLOG_MODE": 0, "SDLOG_PROFILE": 1,
    "MC_ROLL_P": 6.5, "MC_PITCH_P": 6.5, "MC_YAW_P": 2.8, "MC_RR_INT_LIM": 0.3, "MC_PR_INT_LIM": 0.3, "MC_YR_INT_LIM": 0.3,
    **{f"MC_{axis}RATE_{key}": value for axis in _AXES
       for key, value in (("P", 0.15), ("I", 0.2), ("D", 0.0), ("FF", 0.0), ("K", 1.0), ("MAX", 220.0))},
    **{f"CA_ROTOR{n}_{key}": value for n in range(12)
       for key, value in (("PX", 0.0), ("PY", 0.0), ("PZ", 0.0), ("CT", 6.5), ("KM", 0.05), ("TILT", 0))},
    **{f"CA_SV_TL{n}_{key}": value for n in range(4) for key, value in (("MINA", 0.0), ("MAXA", 90.0), ("TD", 0), ("CT", 1))},
    **{f"PWM_MAIN_FUNC{n}": 0 for n in range(1, 17)}, **{f"COM_FLTMODE{n}": -1 for n in range(1, 7)},
    **{f"RC{n}_{key}": value for n in range(1, 19) for key, value in (("MIN", 1000), ("TRIM", 1500), ("MAX", 2000), ("DZ", 10))},
}  # fmt: skip


def configured(environment: Mapping[str, str]) -> dict[str, float]:
    """Its parameters, those of the environment over its own; one that it does not have is an error that it prints."""
    values = dict(DEFAULTS)
    print("ERROR [param] Parameter UXRCE_DDS_KEY not found.", flush=True)  # its own script's, of a module left out
    for key, text in environment.items():
        name = key.removeprefix("PX4_PARAM_")
        if name == key:
            continue
        if name not in values:
            print(f"ERROR [param] Parameter {name} not found.", flush=True)
        elif isinstance(DEFAULTS[name], int):
            whole = re.match(r"[-+]?\d+", text)
            values[name] = int(whole[0]) if whole else 0
        else:
            values[name] = float(np.float32(float(text)))
    return values


def mixer(values: Mapping[str, float]) -> Array:
    """What roll, pitch, yaw and upward thrust make of motors and tilts: its normalised pseudo-inverse, a row each."""
    motors, tilts = int(values["CA_ROTOR_COUNT"]), int(values["CA_SV_TL_COUNT"]) if values["CA_AIRFRAME"] == 8 else 0
    by = [{key: values[f"CA_SV_TL{n}_{key}"] for key in ("TD", "CT")} for n in range(tilts)]
    turns = any(tilt["CT"] in (1, 3) for tilt in by)  # then the rotors' own reaction is not used
    effect = np.zeros((4, motors + tilts))
    for n in range(motors):
        place = np.array([values[f"CA_ROTOR{n}_P{axis}"] for axis in "XYZ"])
        thrust, reaction = values[f"CA_ROTOR{n}_CT"], values[f"CA_ROTOR{n}_KM"]
        upward = np.array([0.0, 0.0, -1.0])
        moment = thrust * np.cross(place, upward) - thrust * reaction * upward
        effect[:, n] = (moment[0], moment[1], 0.0 if turns else moment[2], -thrust)
        carried = int(values[f"CA_ROTOR{n}_TILT"]) - 1 if tilts else -1
        if not 0 <= carried < tilts:
            continue
        towards = np.radians(by[carried]["TD"])
        side = place[1] * np.cos(towards) - place[0] * np.sin(towards)
        if by[carried]["CT"] in (1, 3) and abs(side) > 0.01:
            effect[2, motors + carried] = -np.sign(side)
        if by[carried]["CT"] in (2, 3):
            effect[1, motors + carried] = -1.0 if by[carried]["TD"] < 90 or by[carried]["TD"] > 270 else 1.0
    mix = np.linalg.pinv(effect)
    sizes = [np.sqrt(2.0 * np.mean(mix[np.abs(mix[:, axis]) > 1e-3, axis] ** 2)) for axis in (0, 1)
             if np.any(np.abs(mix[:, axis]) > 1e-3)]  # fmt: skip
    mix[:, :2] /= max(sizes, default=1.0)
    mix[:, 2] /= mix[:, 2].max() if mix[:, 2].max() > 0.0 else 1.0
    thrusts = np.abs(mix[:, 3])
    mix[:, 3] /= -np.mean(thrusts[thrusts > 1e-7])  # told as a share of full thrust, upward positive
    mix[np.abs(mix) < 1e-3] = 0.0
    return mix.astype(np.float32)


class Sensor:
    """One that is called stale when it says the same for too long."""

    def __init__(self, most: int) -> None:
        self.most, self.last, self.same = most, (float("nan"),), 0
        self.good = self.stale = 0  # samples

    def heard(self, said: tuple[float, ...]) -> bool:
        """Whether it is listened to after it said this."""
        same = len(said) == len(self.last) and all(abs(a - b) < SAME for a, b in zip(said, self.last, strict=True))
        self.same, self.last = self.same + 1 if same else 0, said
        fresh = self.same <= self.most
        self.good, self.stale = self.good + fresh, self.stale + (not fresh)
        return fresh


class Estimator:
    """Lean by the gyro, drawn towards the accelerometer; heading by the gyro, drawn towards a compass that is heard."""

    def __init__(self) -> None:
        self.roll = self.pitch = self.yaw = 0.0
        self.bias, self.count = np.zeros(3, np.float32), 0
        self.force, self.forces = np.zeros(3), 0

    def update(self, gyro: Array, force: Array, mag: Array | None, armed: bool, dt: float) -> None:
        """One of its runs."""
        if not armed:
            self.count += 1
            self.bias += (gyro - self.bias) / np.float32(self.count)
        p, q, r = (float(value) for value in gyro - self.bias)
        sr, cr, cp = np.sin(self.roll), np.cos(self.roll), max(np.cos(self.pitch), 0.1)
        turn = (q * sr + r * cr) / cp
        lean_r, lean_p = p + turn * np.sin(self.pitch), q * cr - r * sr
        towards = 0.0 if armed else min(1.0, dt / 0.5)  # an estimator of motion is not led astray by it in flight
        self.roll += dt * lean_r + towards * (np.arctan2(-force[1], -force[2]) - self.roll)
        self.pitch += dt * lean_p + towards * (np.arctan2(force[0], np.hypot(force[1], force[2])) - self.pitch)
        self.yaw = _wrapped(self.yaw + dt * turn)
        if mag is not None:
            sr, cr, sp, cp = np.sin(self.roll), np.cos(self.roll), np.sin(self.pitch), np.cos(self.pitch)
            ahead = mag[0] * cp + (mag[1] * sr + mag[2] * cr) * sp
            heading = np.arctan2(mag[2] * sr - mag[1] * cr, ahead)
            self.yaw = _wrapped(self.yaw + min(1.0, dt / (1.0 if armed else 0.2)) * _wrapped(heading - self.yaw))


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


class Loops:
    """Sticks, attitude and rate loop, and the mixer."""

    def __init__(self, values: Mapping[str, float]) -> None:
        self.values, self.mix = values, mixer(values)
        self.motors = int(values["CA_ROTOR_COUNT"])
        self.integral, self.slope, self.before = (np.zeros(3, np.float32) for _ in range(3))
        self.asked = np.zeros(3, np.float32)  # rates, of the attitude loop of the sample before
        self.most, self.thrust, self.turn, self.yaw_torque = 0.0, 0.0, 0.0, 0.0
        self.heading: float | None = None
        self.position, self.model, self.blind = Position(), Model(), False

    def stick(self, channels: tuple[int, ...], name: str) -> float:
        """From -1 to 1, by the ends and the middle of its channel; 0 where no channel is named."""
        number = int(self.values[f"RC_MAP_{name}"])
        if number == 0:
            return 0.0
        low, middle, high = (self.values[f"RC{number}_{key}"] for key in ("MIN", "TRIM", "MAX"))
        if name == "THROTTLE" and middle == low:
            middle = 0.5 * (low + high)
        return float(np.interp(channels[number - 1], (low, middle, high), (-1.0, 0.0, 1.0)))

    def mode(self, channels: tuple[int, ...]) -> int:
        """What the slot of its switch selects, six of them over the channel's range."""
        number = int(self.values["RC_MAP_FLTMODE"])
        slot = 1 + min(int(6.0 * np.interp(channels[number - 1], (1000, 2000), (0.0, 1.0))), 5) if number else 1
        return int(self.values[f"COM_FLTMODE{slot}"])

    def attitude(self, channels: tuple[int, ...], seen: Estimator, armed_s: float, dt: float) -> None:
        """Rate set-points and thrust from the sticks."""
        v = self.values
        if armed_s > v["COM_SPOOLUP_TIME"]:
            self.most = min(1.0, self.most + 0.5 * dt)
        else:
            self.most = 0.0
        throttle = self.stick(channels, "THROTTLE")
        middle = 0.5 * (v["MPC_MANTHR_MIN"] + v["MPC_THR_MAX"]) if v["MPC_THR_CURVE"] == 1 else v["MPC_THR_HOVER"]
        wanted = np.interp(throttle, (-1.0, 0.0, 1.0), (v["MPC_MANTHR_MIN"], middle, v["MPC_THR_MAX"]))
        self.thrust = float(min(wanted, self.most))
        dead, yaw = v["MAN_DEADZONE"], self.stick(channels, "YAW")
        outside = max(abs(yaw) - dead, 0.0) / (1.0 - dead)
        bent = float(np.copysign(0.4 * outside + 0.6 * outside**3, yaw))
        self.turn += min(1.0, dt / (v["MPC_MAN_Y_TAU"] + dt)) * (bent * np.radians(v["MPC_MAN_Y_MAX"]) - self.turn)
        if abs(self.turn) > 1e-4:
            self.heading = None
        elif self.heading is None:
            self.heading = seen.yaw
        full = np.radians(v["MPC_MAN_TILT_MAX"])
        roll, pitch = full * self.stick(channels, "ROLL"), -full * self.stick(channels, "PITCH")
        if self.mode(channels) == 2:
            roll, pitch, self.thrust = self.position.hold(self.thrust, seen.yaw, throttle, dt)
            roll, pitch = (0.0, 0.0) if self.blind else (roll, pitch)
        else:
            self.position.place = None
        towards = np.array([roll, pitch, seen.yaw if self.heading is None else self.heading])
        errors = self.model.follow(towards, self.turn, max(v["MC_REF_W_N"], 0.1), dt) - (
            seen.roll,
            seen.pitch,
            seen.yaw,
        )
        errors[2] = _wrapped(errors[2])
        gains = np.array([v[f"MC_{axis}_P"] for axis in _AXES])
        most = np.radians([v[f"MC_{axis}RATE_MAX"] for axis in _AXES])
        lean = np.array([-np.sin(seen.pitch), np.sin(seen.roll), np.cos(seen.roll)]) * self.turn
        self.asked = np.clip(gains * errors + lean, -most, most).astype(np.float32)

    def torque(self, gyro: Array, dt: float, flies: bool) -> Array:
        """The rate loop, which hears the attitude loop of the sample before."""
        v = self.values
        gains = {k: np.array([v[f"MC_{a}RATE_{k}"] for a in _AXES], np.float32) for k in ("P", "I", "D", "FF", "K")}
        share = 2.0 * np.pi * v["IMU_DGYRO_CUTOFF"] * dt
        self.slope += np.float32(share / (1.0 + share)) * ((gyro - self.before) / np.float32(dt) - self.slope)
        self.before = gyro
        error = self.asked - gyro
        torque = gains["K"] * (gains["P"] * error - gains["D"] * self.slope) + self.integral + gains["FF"] * self.asked
        if flies:
            limits = np.array([v["MC_RR_INT_LIM"], v["MC_PR_INT_LIM"], v["MC_YR_INT_LIM"]], np.float32)
            added = self.integral + gains["K"] * gains["I"] * error * np.float32(dt)
            self.integral = np.clip(added, -limits, limits)
        if v["MC_YAW_TQ_CUTOFF"] > 0.0:
            share = 2.0 * np.pi * v["MC_YAW_TQ_CUTOFF"] * dt
            self.yaw_torque += share / (1.0 + share) * (float(torque[2]) - self.yaw_torque)
            torque[2] = self.yaw_torque
        return torque.astype(np.float32)

    def outputs(self, torque: Array) -> list[float]:
        """Sixteen channels, each with what its function says, between their limits; lean before thrust in air mode."""
        given = self.mix @ np.array([*torque, self.thrust], np.float32)
        motors, tilts = given[: self.motors], np.clip(given[self.motors :], -1.0, 1.0)
        if self.values["MC_AIRMODE"] > 0:
            motors = motors - min(motors.min(), 0.0) if motors.max() - min(motors.min(), 0.0) <= 1.0 else motors
            motors = motors - max(motors.max() - 1.0, 0.0)
        by = {101 + n: value for n, value in enumerate(np.clip(motors, 0.0, 1.0))}
        by |= {201 + n: value for n, value in enumerate(tilts)}
        return [float(by.get(int(self.values[f"PWM_MAIN_FUNC{n}"]), 0.0)) for n in range(1, 17)]


class Model:
    """What attitude set-points go through on the way to their loop: second order, both poles the same, exact over a step.

    While the stick turns the heading, the set-point is the heading itself, and only the turn is carried on.
    """

    def __init__(self) -> None:
        self.angle: Array | None = None
        self.rate = np.zeros(3)

    def follow(self, towards: Array, turn: float, hertz: float, dt: float) -> Array:
        """``hertz`` in rad/s."""
        if self.angle is None:
            self.angle = towards.copy()
            return self.angle.copy()
        off, fade = towards - self.angle, np.exp(-hertz * dt)
        off[2] = _wrapped(off[2])
        moved = (1.0 - (1.0 + hertz * dt) * fade) * off + dt * fade * self.rate
        self.rate = hertz**2 * dt * fade * off + (1.0 - hertz * dt) * fade * self.rate
        if turn:
            self.rate[2] = 0.0
        self.angle = self.angle + moved + dt * np.array([0.0, 0.0, turn])
        return self.angle.copy()


class Position:
    """Place and height held by GNSS and barometer, from where the mode begins, and moved by the sticks beyond a dead zone.

    Its hover throttle is that which flew when the mode begins.
    """

    def __init__(self) -> None:
        self.place: Array | None = None  # degrees of latitude and longitude at which it began
        self.heard_us = 0  # of the last fix
        self.fix, self.speed = np.zeros(2), np.zeros(3)
        self.height = self.held = self.hover = self.lift = 0.0
        self.drift = np.zeros(2)

    def hear(self, told: Any) -> None:
        self.heard_us = told.time_usec
        self.fix = 1e-7 * np.array([told.lat, told.lon])
        self.speed = 0.01 * np.array([told.vn, told.ve, told.vd])

    def hold(self, thrust: float, yaw: float, climb_stick: float, dt: float) -> tuple[float, float, float]:
        """Roll and pitch to be asked for [rad], and thrust."""
        if self.place is None:
            self.place, self.held, self.hover, self.lift, self.drift = self.fix, self.height, thrust, 0.0, np.zeros(2)
        climb = 3.0 * climb_stick if abs(climb_stick) > HOLD_DEAD else 0.0
        self.held = self.height if climb else self.held
        off = (self.place - self.fix) * 111_190.0 * np.array([1.0, np.cos(np.radians(self.place[0]))])
        error = 0.95 * off - self.speed[:2]
        self.drift = np.clip(self.drift + 0.4 * error * dt, -2.0, 2.0)
        north, east = np.clip(1.8 * error + self.drift, -4.0, 4.0)
        forward, right = north * np.cos(yaw) + east * np.sin(yaw), east * np.cos(yaw) - north * np.sin(yaw)
        rise = (climb or (self.held - self.height)) + self.speed[2]
        self.lift = float(np.clip(self.lift + 2.0 * rise * dt, -4.0, 4.0))
        up = float(np.clip(4.0 * rise + self.lift, -6.0, 6.0))
        return right / 9.81, -forward / 9.81, self.hover * (1.0 + up / 9.81)


class Px4Program:
    """The program: a link, a clock that the link moves, and what runs at each of its samples."""

    def __init__(self, port: int, folder: Path, values: Mapping[str, float]) -> None:
        self.values, self.loops, self.seen = values, Loops(values), Estimator()
        self.port, self.folder = port, folder
        self.sensors = {name: Sensor(most) for name, most in STALE.items()}
        self.times: list[int] = []
        self.channels: tuple[int, ...] = (0,) * 18
        self.armed_at: int | None = None
        self.answers = 0
        self.said: list[tuple[int, str]] = []
        self.mag: Array | None = None
        self.sums: dict[str, list[float]] = {}

    def fly(self) -> None:
        """Until the link closes."""
        link, end = mav.MAVLink(None, srcSystem=1, srcComponent=1), time.monotonic() + PATIENCE_S
        while True:
            try:
                connected = socket.create_connection(("127.0.0.1", self.port), PATIENCE_S)
                break
            except ConnectionRefusedError:
                if time.monotonic() > end:
                    return
                time.sleep(0.01)
        with connected, suppress(OSError):
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connected.sendall(link.heartbeat_encode(2, 12, 0, 0, 0).pack(link))
            while data := connected.recv(65536):
                for message in link.parse_buffer(data) or []:
                    if message.get_type() == "RC_CHANNELS":
                        self.channels = tuple(getattr(message, f"chan{n}_raw") for n in range(1, 19))
                    elif message.get_type() == "HIL_GPS":
                        self.loops.position.hear(message)
                    elif message.get_type() == "HIL_SENSOR" and (controls := self.sample(message)) is not None:
                        mode = 129 if self.armed_at is not None else 1
                        connected.sendall(
                            link.hil_actuator_controls_encode(self.times[-1], controls, mode, 1).pack(link)
                        )
        self.write()

    def sample(self, told: Any) -> list[float] | None:
        """What one HIL_SENSOR comes to; None: no answer."""
        self.times.append(told.time_usec)
        if len(self.times) % 250 == 0:
            self.write()
        gyro = np.array([told.xgyro, told.ygyro, told.zgyro], np.float32)
        force = np.array([told.xacc, told.yacc, told.zacc], np.float32)
        if told.fields_updated & 448 and self.sensors["mag"].heard((told.xmag, told.ymag, told.zmag)):
            self.mag = np.array([told.xmag, told.ymag, told.zmag], np.float32)
        if told.fields_updated & 6656:
            self.sensors["baro"].heard((told.abs_pressure, told.temperature))
            self.loops.position.height = told.pressure_alt
        if len(self.times) <= BOOT:
            return None
        dt = 1e-6 * (self.times[-1] - self.times[-2])
        every = max(1, round(1.0 / (self.values["IMU_INTEG_RATE"] * dt)))
        runs = len(self.times) % every == 0
        if runs:
            self.seen.update(gyro, force, self.mag, self.armed_at is not None, every * dt)
            self.mag = None
        elif 1e-6 * self.times[-1] > ESTIMATOR_S:
            return None  # the logger waits for it, and the answer for the logger
        self._arm()
        torque = self.loops.torque(gyro, dt, self.loops.thrust > 0.1)
        if runs:
            armed_s = 0.0 if self.armed_at is None else 1e-6 * (self.times[-1] - self.armed_at)
            self.loops.attitude(self.channels, self.seen, armed_s, every * dt)
        self._note(force)
        if self.loops.position.place is not None and not self.loops.blind:
            self.loops.blind = self.times[-1] - self.loops.position.heard_us > BLIND_S * 1e6
            if self.loops.blind:
                self.said.append((self.times[-1], "Failsafe: blind land"))
                self.write()
        if self.times[-1] > TAKEOFF_S * 1e6 and len(self.said) == 1:
            self.said.append((self.times[-1], "Takeoff detected"))
            self.write()
        self.answers += 1
        return [0.0] * 16 if self.armed_at is None else self.loops.outputs(torque)

    def _arm(self) -> None:
        number = int(self.values["RC_MAP_ARM_SW"])
        raised = number > 0 and self.values["COM_RC_IN_MODE"] in (0, 2, 3) and self.channels[number - 1] > 1750
        if not raised:
            self.armed_at = None
        elif (
            self.armed_at is None
            and self.loops.stick(self.channels, "THROTTLE") < -0.9
            and 1e-6 * self.times[-1] > READY_S
        ):
            self.armed_at = self.times[-1]
            self.said.append((self.armed_at, "Armed by RC"))

    def _note(self, force: Array) -> None:
        """Means of the accelerometer, as it stands disarmed and as it flies."""
        if self.armed_at is not None and self.loops.thrust < 0.1:
            return
        total = self.sums.setdefault("stood" if self.armed_at is None else "flew", [0.0] * 4)
        for index, value in enumerate((*force, 1.0)):
            total[index] += float(value)

    def write(self) -> None:
        """What was seen, for a test to read; and its own log, as its logger writes it if it is not switched off."""
        if self.values["SDLOG_MODE"] >= 0:
            log = self.folder / "log" / "2026-11-27" / "08_00_00.ulg"
            log.parent.mkdir(parents=True, exist_ok=True)
            log.write_bytes(b"".join(ulog(self.values, self.said)))
        seen = {
            "frames": len(self.times),
            "answers": self.answers,
            "heard": {name: sensor.good for name, sensor in self.sensors.items()},
            "stale": {name: sensor.stale for name, sensor in self.sensors.items()},
            "gyro_bias": [float(value) for value in self.seen.bias],
            "force": {name: [value / total[3] for value in total[:3]] for name, total in self.sums.items()},
            "values": {name: value for name, value in self.values.items() if value != DEFAULTS[name]},
        }
        part = self.folder / "seen.part"
        part.write_text(json.dumps(seen))
        part.rename(self.folder / "seen.json")


def ulog(values: Mapping[str, float], said: list[tuple[int, str]]) -> Iterator[bytes]:
    """A ULog without topics: facts, parameters, and what was said when, each message with its size and its kind."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<Hc", len(body), kind) + body

    def entry(kind: bytes, key: str, value: bytes) -> bytes:
        return message(kind, bytes([len(key)]) + key.encode() + value)

    yield b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    revision = "0123abcd" + 32 * "0"
    yield entry(b"I", f"char[{len(revision)}] ver_sw", revision.encode())
    yield entry(b"I", "uint32_t ver_sw_release", struct.pack("<I", 0x011100C0))
    for name, value in values.items():
        if isinstance(DEFAULTS[name], int):
            yield entry(b"P", f"int32_t {name}", struct.pack("<i", int(value)))
        else:
            yield entry(b"P", f"float {name}", struct.pack("<f", value))
    yield message(b"A", struct.pack("<BH", 0, 0) + b"no_topic")
    for time_us, text in said:
        yield message(b"L", b"6" + struct.pack("<Q", time_us) + text.encode())
    yield struct.pack("<Hc", 400, b"D") + b"cut short"


def main(arguments: list[str]) -> None:
    """As PX4's command line has it; its scripts stand in the folder that is named last."""
    if not (Path(arguments[-1]) / "init.d-posix" / "rcS").is_file():
        print("ERROR [px4] Error opening startup file, does not exist: etc/init.d-posix/rcS")
        sys.exit(255)
    stated = dict(pairwise(arguments))
    folder = Path(stated.get("-w", "."))
    folder.mkdir(parents=True, exist_ok=True)
    Px4Program(4560 + int(stated.get("-i", "0")), folder, configured(os.environ)).fly()


def installed(folder: Path) -> Path:
    """The program as a build has it: ``bin/px4`` beside ``etc``."""
    binary = folder / "bin" / "px4"
    binary.parent.mkdir(parents=True)
    (folder / "etc" / "init.d-posix").mkdir(parents=True)
    (folder / "etc" / "init.d-posix" / "rcS").write_text("#!/bin/sh\n")
    path = os.pathsep.join(part for part in sys.path if part)
    binary.write_text(f'#!/bin/sh\nPYTHONPATH="{path}" exec "{sys.executable}" "{Path(__file__).absolute()}" "$@"\n')
    binary.chmod(0o755)
    return binary


if __name__ == "__main__":
    main(sys.argv[1:])
