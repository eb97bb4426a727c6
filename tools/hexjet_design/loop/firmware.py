"""The rate and attitude loops of other people's autopilots, as responses of a channel's controller.

An autopilot runs its loop ``N`` times while a measurement stands still, and what the actuators are given is its answer
of the first of these.  A law is linear around rest, so it is written down once, as what it does in one of its own
loops, and its matrices are read off that, column by column:

    s' = A s + B (r, y),   u = C s + D (r, y)          one loop; r: rate set-point of the attitude loop, y: gyro
    s_k+1 = A^N s_k + (1 + A + ... + A^(N-1)) B (r, y)_k

so ``u(z) = (C (z - A^N)^-1 (1 + ... + A^(N-1)) B + D) (r, y)`` at the flight's step, exactly.  P, I and D enter
linearly, each with its own matrices.

Sources: Betaflight 4.6 ``flight/pid.c``, ``pid_init.c``, ``sensors/gyro.c``, ``common/filter.c``; PX4 1.18
``rate_control.cpp``, ``VehicleAngularVelocity.cpp``, ``AlphaFilter.hpp``; ArduPilot 4.6 ``AC_PID.cpp``, ``Copter.cpp``.
That PX4's and ArduPilot's rate loops hear the attitude loop one step later follows from the order of their tasks.  PX4:
``mc_rate_control`` runs at each new rate, in the work queue of the highest priority (``rate_ctrl`` in
``WorkQueueManager.hpp``); ``mc_att_control`` runs at each new attitude, which the estimator makes of the same sample,
in a queue of a lower one (``nav_and_controllers``).  ArduPilot: the fast tasks of ``Copter.cpp`` are gyro, rate loop,
motors, estimator, and then the flight mode with its attitude loop.  What the programs flew stands beside what their
designs say in docs/autopilots.md.

PX4 and ArduPilot have the attitude from an estimator, which integrates the gyro: what the gyro's low-pass makes late is
late in the angle too.  ArduPilot's mixer of a script (``AP_MotorsMatrix_6DoF_Scripting``) leaves its outputs to the
servos, which take them up in the next loop: measured with a gyro of one sample, and not so with its own frames.

Of limits and anti-windup nothing is in it, nor of gains that follow the throttle: our settings switch these off.  So
they do with ArduPilot's limits of acceleration (``ATC_ACC_R_MAX`` and the others), and the square root of a large error
that comes with them, and with its shaping of the pilot's angles and the feed-forward of their rate
(``ATC_RATE_FF_ENAB``), which are others since 4.8.  What is left is ``rate = gain (pilot - angle)``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import pi

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.spec.vehicle import RateGains

# Betaflight's gyro low-passes as shipped, both of first order; here the first does not rise with throttle.
GYRO_LPF1_HZ, GYRO_LPF2_HZ = 250.0, 500.0
LEVEL_HZ = 50.0  # Betaflight's ATTITUDE_CUTOFF_HZ
YAW_P_HZ = 100.0  # Betaflight's yaw_lowpass_hz
# CUTOFF_CORRECTION_PT3: with it three equal lags together are 3 dB down at the cutoff.
PT3_CORRECTION = 1.961459177

# One loop: state, set-point, gyro, loop period [s], derivative cutoff [Hz] -> new state, and P, I and D parts.
Loop = Callable[[list[float], float, float, float, float], tuple[list[float], float, float, float]]


def lowpass_gain(hertz: float, period: float) -> float:
    """Return the gain of a first-order low-pass in one loop, by backward Euler as in all three autopilots."""
    return 2.0 * pi * hertz * period / (2.0 * pi * hertz * period + 1.0)


def _make_betaflight_loop(levels: bool, yaw: bool) -> Loop:
    def step_loop(
        s: list[float], r: float, y: float, period: float, hertz: float
    ) -> tuple[list[float], float, float, float]:
        g1, g2, a, b, c, integral, slope, p = s
        g1 += lowpass_gain(GYRO_LPF1_HZ, period) * (y - g1)
        before, g2 = g2, g2 + lowpass_gain(GYRO_LPF2_HZ, period) * (g1 - g2)
        if levels:
            k = lowpass_gain(LEVEL_HZ * PT3_CORRECTION, period)
            a += k * (r - a)
            b += k * (a - b)
            c += k * (b - c)
        error = (c if levels else r) - g2
        p = p + lowpass_gain(YAW_P_HZ, period) * (error - p) if yaw else error
        integral += period * error
        slope += lowpass_gain(hertz, period) * ((before - g2) / period - slope)
        return [g1, g2, a, b, c, integral, slope, p], p, integral, slope

    return step_loop


def _step_px4_loop(
    s: list[float], r: float, y: float, period: float, hertz: float
) -> tuple[list[float], float, float, float]:
    # The rate set-point is that of the attitude loop one step before.
    setpoint, last, slope, integral = s
    slope += lowpass_gain(hertz, period) * ((last - y) / period - slope)
    error = setpoint - y
    return [r, y, slope, integral + period * error], error, integral, slope  # the next step integrates this error


def _step_ardupilot_loop(
    s: list[float], r: float, y: float, period: float, hertz: float
) -> tuple[list[float], float, float, float]:
    # A loop runs the rate controller first, the attitude controller after it.
    setpoint, last, slope, integral = s
    error = setpoint - y
    slope += lowpass_gain(hertz, period) * ((error - last) / period - slope)  # derivative of the error, with set-point
    integral += period * error
    return [r, error, slope, integral], error, integral, slope


_STATES = {"betaflight": 8, "px4": 4, "ardupilot": 4}  # states of each firmware's loop


def find_law(name: str, axis: str) -> Loop:
    """Return a function that runs an autopilot's rate loop on an axis once."""
    if name == "betaflight":
        # Betaflight has no attitude loop in yaw: the pilot, or a program, holds the heading by the stick.
        return _make_betaflight_loop(axis != "yaw", axis == "yaw")
    return _step_px4_loop if name == "px4" else _step_ardupilot_loop


Units = tuple[float, float, float, float]


@dataclass(frozen=True)
class Firmware:
    """Loop structure of an autopilot on an axis, and the allowed values of its gains.

    ``output_delay``: steps of the flight that its mixer keeps an answer for.  ``units``: what one of the attitude gain
    [1/s] and of P, I and D [command per rad/s and so on] is, where it has whole numbers of them.  ``max_gain``: the
    largest of these.  ``common_filter``, ``common_angle``: one of all axes,
    and of roll and pitch; ``d_filter_s`` and ``angle_gain``: those that another axis has chosen.
    """

    name: str
    axis: str = "roll"
    output_delay: int = 0
    units: Mapping[str, Units] | None = None
    max_gain: int = 250
    common_filter: bool = False
    common_angle: bool = False
    d_filter_s: float | None = None
    angle_gain: float | None = None

    @property
    def estimates_attitude(self) -> bool:
        """Whether the autopilot estimates attitude from the gyro; Betaflight's simulation is given it."""
        return self.name != "betaflight"

    def responses(self, gains: RateGains, step: float, z: Complex) -> tuple[Complex, Complex]:
        """Return the response of the command to the rate set-point, and the negative one to the measured rate."""
        at = z.tobytes()
        p, i = _loop_parts(self.name, self.axis, step, 0.0, at)[:2]
        of_set, of_rate = gains.p * p[0] + gains.i * i[0], gains.p * p[1] + gains.i * i[1]
        if gains.d:
            slope = _loop_parts(self.name, self.axis, step, 1.0 / (2.0 * pi * gains.d_filter_s), at)[2]
            of_set, of_rate = of_set + gains.d * slope[0], of_rate + gains.d * slope[1]
        return of_set, -of_rate

    def unit(self, name: str) -> float | None:
        """Return the unit in which ``angle_gain``, ``p``, ``i`` or ``d`` is quantised; None if it is not."""
        return None if self.units is None else self.units[self.axis][("angle_gain", "p", "i", "d").index(name)]

    def smooth(self, seconds: float) -> float:
        """Return the nearest time constant, s, that the derivative's filter may have: whole hertz with whole gains."""
        if self.d_filter_s is not None:
            return self.d_filter_s
        return seconds if self.units is None else 1.0 / (2.0 * pi * max(1.0, round(1.0 / (2.0 * pi * seconds))))


@lru_cache(maxsize=64)
def _loop_parts(name: str, axis: str, step: float, hertz: float, at: bytes) -> Complex:
    """Return the response of P, I and D part to set-point and gyro, at points of the unit circle: 3 x 2 x points."""
    z = np.frombuffer(at, np.complex128)
    a, b, c, d = matrices(name, axis, step, hertz or 1.0)
    # Few states each: states that a part does not use are omitted, to keep the equations small.
    response = np.empty((3, 2, len(z)), np.complex128)
    needed = (2,) if hertz else (0, 1)
    for part in needed:
        keep = _reachable_states(a, c[part])
        small = z[:, None, None] * np.eye(len(keep)) - a[np.ix_(keep, keep)]
        solved = np.linalg.solve(small, np.broadcast_to(b[keep], (len(z), *b[keep].shape)))
        response[part] = (c[part][keep] @ solved + d[part]).T
    return np.asarray(response)


def _reachable_states(a: Array, c: Array) -> list[int]:
    """Return the indices of the states on which an output depends."""
    reached = {int(i) for i in np.flatnonzero(c)}
    while more := {int(j) for i in reached for j in np.flatnonzero(a[i])} - reached:
        reached |= more
    return sorted(reached)


def matrices(name: str, axis: str, step: float, hertz: float) -> tuple[Array, Array, Array, Array]:
    """Return the law's A and B over a step of the flight, and C and D of the first loop's P, I and D part."""
    size, loop = _STATES[name], find_law(name, axis)
    loop_s = 125e-6  # period at which SITL steps its gyro
    count = max(1, round(step / loop_s)) if name == "betaflight" else 1
    period = step / count
    columns = np.eye(size + 2)
    results = [loop(list(column[:size]), column[size], column[size + 1], period, hertz) for column in columns]
    after = np.array([state for state, *_ in results]).T
    matrix = np.array([answer[1:] for answer in results]).T
    a, b = after[:, :size], after[:, size:]
    total, power = np.zeros_like(a), np.eye(size)
    for _ in range(count):
        total, power = total + power, power @ a
    return power, total @ b, matrix[:, :size], matrix[:, size:]
