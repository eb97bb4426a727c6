"""Logs whose truth is known: many closed loops at once, solved exactly on a fifth of a sample, with what spoils a log.

Noise of the gyro, turbulence through the airframe, jitter of the sampling, stamps that are wrong, rows that are lost.
The loop is a rate loop inside an attitude loop, flown through doublets: the command contains the noise that came back.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

SUB = 5  # steps of the solution in one of the controller


@dataclass(frozen=True)
class Truth:
    """``gain / ((s + rate) prod(lag s + 1)) e^(-delay s)``; the delay a whole number of fifths of a step."""

    gain: float = 433.0
    rate: float = 0.04
    lags: tuple[float, ...] = (0.0299,)
    delay_samples: float = 25.4
    step: float = 0.004


@dataclass(frozen=True)
class Flaws:
    """What spoils the logs; standard deviations."""

    gyro: float = 0.005  # rad/s
    turbulence: float = 0.1  # rad/s^2, of a first-order process
    turbulence_s: float = 0.5
    jitter: float = 0.15  # of a sample: when it is taken, and the controller acts
    stamps: float = 0.0  # of a sample: what the log says of that
    lost: float = 0.02  # share of the rows


@dataclass(frozen=True)
class Log:
    times: np.ndarray
    command: np.ndarray
    output: np.ndarray
    setpoint: np.ndarray


def drawn(count, seed=1):
    """So many vehicles of 30 to 180 ms of delay, 20 to 120 ms of lag, gains of 150 to 500, and the gains p, attitude of
    a loop that holds each.
    """
    rng = np.random.default_rng([seed, 17])
    fine = Truth.step / SUB
    truths = [
        Truth(gain, 0.04, (lag,), round(delay / fine) / SUB)
        for gain, lag, delay in rng.uniform((150.0, 0.02, 0.03), (500.0, 0.12, 0.18), (count, 3))
    ]
    cut = np.array([0.5 / (truth.delay_samples * truth.step + truth.lags[0] + 0.01) for truth in truths])
    return truths, cut / np.array([truth.gain for truth in truths]), 0.25 * cut


def _exact(truth, fine):
    """Of the lags and the rate over a fine step: transition, of a held command, and of a held angular acceleration."""
    n = len(truth.lags) + 1
    whole = np.zeros((n + 2, n + 2))
    for i, lag in enumerate(truth.lags):
        whole[i, i], whole[i, i - 1 if i else n] = -1.0 / lag, 1.0 / lag
    whole[n - 1, n - 1] = -truth.rate
    whole[n - 1, n - 2 if n > 1 else n] = truth.gain
    whole[n - 1, n + 1] = 1.0
    made = expm(whole * fine)
    return made[:n, :n], made[:n, n], made[:n, n + 1]


def closed_loops(
    count, seconds=20.0, seed=1, truth=Truth(), flaws=Flaws(), p=0.004, attitude=0.8, size=0.25, loop=True, sweep=0.0
):
    """``count`` logs of an axis under control; without ``loop`` the doublets are the command;
    ``sweep`` is the amplitude of one that is added to it, from 0.3 to 8 Hz.

    ``truth``, ``p`` and ``attitude``: the same for all, or one for each, of as many lags.
    """
    truths = truth if isinstance(truth, Sequence) else [truth] * count
    truth = truths[0]
    rng = np.random.default_rng([seed, 16])
    steps, fine = round(seconds / truth.step), truth.step / SUB
    late = np.array([round(each.delay_samples * SUB) for each in truths])
    move, drive, push = (np.array(part) for part in zip(*(_exact(each, fine) for each in truths), strict=True))
    keep = np.exp(-fine / flaws.turbulence_s)
    kick = flaws.turbulence * np.sqrt(1.0 - keep**2)
    doublets = np.zeros((steps, count))
    for n in range(count):
        at = rng.uniform(0.5, 1.5)
        while at < seconds - 2.0:
            half = rng.uniform(0.3, 0.8)
            a, b, c = (round(t / truth.step) for t in (at, at + half, at + 2.0 * half))
            doublets[a:b, n], doublets[b:c, n] = size, -size
            at += rng.uniform(2.5, 4.0)
    at = np.arange(steps) * truth.step
    growth = np.log(8.0 / 0.3) / seconds
    chirp = sweep * np.sin(2.0 * np.pi * 0.3 * np.expm1(growth * at) / growth)
    gyro = flaws.gyro * rng.standard_normal((steps, count))
    most = SUB // 2 - 1
    moved = np.clip(np.rint(flaws.jitter * SUB * rng.standard_normal((steps, count))), -most, most).astype(int)
    instants = (np.arange(steps)[:, None] + 1) * SUB + moved
    command, output, asked = (np.zeros((steps, count)) for _ in range(3))
    gust, lean, torque, since = (np.zeros(count) for _ in range(4))
    state = np.zeros((count, len(truth.lags) + 1))
    buffer = np.zeros((int(late.max()) + 1, count))
    following, every = np.zeros(count, int), np.arange(count)
    for m in range((steps + 1) * SUB):
        act = (following < steps) & (instants[np.minimum(following, steps - 1), every] == m)
        if act.any():
            k = np.minimum(following, steps - 1)
            measured = state[:, -1] + gyro[k, every]
            leaned = lean + measured * (m * fine - since)
            wanted = attitude * (doublets[k, every] - leaned)
            made = p * (wanted - measured) if loop else doublets[k, every]
            made = made + chirp[k]
            lean, since = np.where(act, leaned, lean), np.where(act, m * fine, since)
            torque = np.where(act, made, torque)
            at = (k[act], every[act])
            command[at], output[at], asked[at] = made[act], measured[act], wanted[act]
            following += act
        buffer[m % len(buffer)] = torque
        held = buffer[(m - late) % len(buffer), every]
        gust = keep * gust + kick * rng.standard_normal(count)
        state = (move @ state[:, :, None])[:, :, 0] + drive * held[:, None] + push * gust[:, None]
    times = instants * fine + flaws.stamps * truth.step * rng.standard_normal((steps, count))
    kept = rng.random((steps, count)) >= flaws.lost
    return [
        Log(times[kept[:, n], n], command[kept[:, n], n], output[kept[:, n], n], asked[kept[:, n], n])
        for n in range(count)
    ]
