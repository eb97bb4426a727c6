"""Every number that the paper prints, with its place; "MAE" there is the maximum absolute error.

Source: J. Liang, H. Zheng, Y. Zhang, Y. Gao, W. Dong, X. Lyu, "Predictor-Based Time Delay Control of A Hex-Jet
Unmanned Aerial Vehicle", accepted January 2025.
"""

from __future__ import annotations

from math import sqrt
from typing import Literal, NamedTuple

from pydantic import BaseModel, ConfigDict

from cosim.loops import RateModel

SOURCE = (  # the paper that is reproduced
    "J. Liang, H. Zheng, Y. Zhang, Y. Gao, W. Dong, X. Lyu, “Predictor-Based Time Delay Control of A Hex-Jet "
    "Unmanned Aerial Vehicle”, accepted January 2025."
)


# What our answer depends on, and so what its agreement with the paper is worth. calibrated: the printed number itself
# was fitted; chosen by us: a choice of ours decides it; follows from a choice: computed from something that the paper
# does not print and we chose; predicted: none of these.
Basis = Literal["calibrated", "chosen by us", "follows from a choice", "predicted"]


class Record(BaseModel):
    """Base of records whose fields cannot be changed."""

    model_config = ConfigDict(frozen=True)


class Printed(NamedTuple):
    """One number that the paper prints."""

    key: str  # its name in this package
    value: float
    unit: str
    place: str
    meaning: str


SETUP = "Experimental verification in quadrotor platform"  # section of the paper
TRACKING, FREQUENCY = "Tracking performance", "Frequency response"  # sections of the paper
DISTURBANCE, TABLE_DISTURBANCE = "Disturbance rejection", "Table of disturbance rejection"  # sections of the paper
PAYLOAD, TABLE_PAYLOAD = "Robustness to additional load", "Table of disturbance rejection with payload"
FLIGHT, IDENTIFICATION, SPECIFICATION = "Flight test on the Hex-Jet", "Identification", "Table of specifications"

_PRINTED_NUMBERS: list[Printed] = [
    # These numbers describe the vehicles.
    Printed("hexjet.mass", 5.525, "kg", SPECIFICATION, "take-off weight of the scaled Hex-Jet"),
    Printed("hexjet.thrust", 12.0, "kgf", SPECIFICATION, "maximum thrust"),
    Printed("hexjet.length", 0.400, "m", SPECIFICATION, "length, and width"),
    Printed("hexjet.height", 0.260, "m", SPECIFICATION, "height"),
    Printed("hexjet.step", 0.004, "s", FLIGHT, "sample time of the flight controller"),
    Printed("hexjet.delay", 25, "samples", FLIGHT, "delay of the turbojet"),
    Printed("quadrotor.mass", 0.5948, "kg", PAYLOAD, "take-off weight of the quadrotor"),
    Printed("quadrotor.payload", 0.230, "kg", PAYLOAD, "added load"),
    Printed("quadrotor.payload_percent", 40, "%", PAYLOAD, "the load as a part of the take-off weight"),
    Printed("quadrotor.rate", 400, "Hz", SETUP, "rate controller's frequency"),
    # These are parameters of identified models.
    Printed("turbojet.gain", 0.01866, "kgf", IDENTIFICATION, "numerator of G_turbo(z)"),
    Printed("turbojet.pole", 0.9879, "-", IDENTIFICATION, "pole of G_turbo(z)"),
    Printed("turbojet.time_constant", 0.33, "s", IDENTIFICATION, "time constant of the turbojet"),
    Printed("turbojet.delay", 0.1, "s", IDENTIFICATION, "delay of the turbojet"),
    Printed("edf.gain", 0.2554, "kgf", IDENTIFICATION, "numerator of G_EDF(z)"),
    Printed("edf.pole", 0.8748, "-", IDENTIFICATION, "pole of G_EDF(z)"),
    Printed("edf.time_constant", 0.029, "s", IDENTIFICATION, "time constant of the EDF"),
    Printed("roll.gain", 0.0689, "rad/s", IDENTIFICATION, "leading coefficient of G(z), Hex-Jet roll"),
    Printed("roll.zero", -1.4538, "-", IDENTIFICATION, "zero of G(z)"),
    Printed("roll.pole_slow", 0.9999, "-", IDENTIFICATION, "slow pole of G(z)"),
    Printed("roll.pole_fast", 0.9024, "-", IDENTIFICATION, "fast pole of G(z)"),
    Printed("quadrotor.b1", -0.7549, "rad/s", SETUP, "coefficient of z in the numerator of G_n(z)"),
    Printed("quadrotor.b0", 0.9393, "rad/s", SETUP, "constant of the numerator of G_n(z)"),
    Printed("quadrotor.a1", -1.8770, "-", SETUP, "coefficient of z in the denominator of G_n(z)"),
    Printed("quadrotor.a0", 0.8786, "-", SETUP, "constant of the denominator of G_n(z)"),
    # These are results on tracking.
    Printed("step.amplitude", 15, "deg", TRACKING, "roll command, either way"),
    Printed("step.each", 0.5, "s", TRACKING, "length of either half of the doublet"),
    Printed("step.start", 0.2, "s", TRACKING, "start of the doublet"),
    Printed("step.record", 2.0, "s", TRACKING, "length of the record"),
    Printed("step.time_constant", 0.1161, "s", TRACKING, "closed attitude loop, 5 samples"),
    Printed("step-5.baseline.rmse", 0.0750, "rad", TRACKING, "tracking error, 5 samples, baseline"),
    Printed("step-5.smith.rmse", 0.0705, "rad", TRACKING, "tracking error, 5 samples, Smith"),
    Printed("step-5.state.rmse", 0.0717, "rad", TRACKING, "tracking error, 5 samples, state predictor"),
    Printed("step-10.smith.rmse", 0.0703, "rad", TRACKING, "tracking error, 10 samples, Smith"),
    Printed("step-10.state.rmse", 0.0690, "rad", TRACKING, "tracking error, 10 samples, state predictor"),
    Printed("step-25.smith.rmse", 0.0787, "rad", TRACKING, "tracking error, 25 samples, Smith"),
    Printed("step-25.smith.increase", 11, "%", TRACKING, "growth of Smith's tracking error at 25 samples"),
    # These are results of the frequency response with 5 samples.
    Printed("frequency.dc_gain", 10, "dB", FREQUENCY, "gain of C G* at the low end, all controllers"),
    Printed("frequency.baseline.cutoff", 4.74, "Hz", FREQUENCY, "cut-off frequency, baseline"),
    Printed("frequency.state.cutoff", 4.49, "Hz", FREQUENCY, "cut-off frequency, state predictor"),
    Printed("frequency.smith.cutoff", 3.71, "Hz", FREQUENCY, "cut-off frequency, Smith"),
    Printed("frequency.baseline.gain_margin", 4.22, "dB", FREQUENCY, "gain margin, baseline"),
    Printed("frequency.state.gain_margin", 6.13, "dB", FREQUENCY, "gain margin, state predictor"),
    Printed("frequency.smith.gain_margin", 3.18, "dB", FREQUENCY, "gain margin, Smith"),
    Printed("frequency.baseline.phase_margin", 22.7, "deg", FREQUENCY, "phase margin, baseline"),
    Printed("frequency.state.phase_margin", 39.8, "deg", FREQUENCY, "phase margin, state predictor"),
    Printed("frequency.smith.phase_margin", 46.0, "deg", FREQUENCY, "phase margin, Smith"),
    # These are results under a disturbance.
    Printed("disturbance.amplitude", 0.1, "command", DISTURBANCE, "doublet added to u; printed with rad/s^2"),
    Printed("disturbance-5.baseline.rmse", 1.4890, "rad/s", TABLE_DISTURBANCE, "rate error, 5 samples, baseline"),
    Printed("disturbance-5.smith.rmse", 0.9512, "rad/s", TABLE_DISTURBANCE, "rate error, 5 samples, Smith"),
    Printed("disturbance-5.state.rmse", 1.0217, "rad/s", TABLE_DISTURBANCE, "rate error, 5 samples, state"),
    Printed("disturbance-10.smith.rmse", 0.9788, "rad/s", TABLE_DISTURBANCE, "rate error, 10 samples, Smith"),
    Printed("disturbance-10.state.rmse", 1.4432, "rad/s", TABLE_DISTURBANCE, "rate error, 10 samples, state"),
    Printed("disturbance-5.baseline.max", 6.9428, "rad/s", TABLE_DISTURBANCE, "largest error, 5 samples, baseline"),
    Printed("disturbance-5.smith.max", 4.7416, "rad/s", TABLE_DISTURBANCE, "largest error, 5 samples, Smith"),
    Printed("disturbance-5.state.max", 5.9337, "rad/s", TABLE_DISTURBANCE, "largest error, 5 samples, state"),
    Printed("disturbance-10.smith.max", 4.7512, "rad/s", TABLE_DISTURBANCE, "largest error, 10 samples, Smith"),
    Printed("disturbance-10.state.max", 7.2624, "rad/s", TABLE_DISTURBANCE, "largest error, 10 samples, state"),
    # These are results with payload.
    Printed("disturbance-5-payload.smith.rmse", 0.9726, "rad/s", TABLE_PAYLOAD, "rate error with payload, Smith"),
    Printed("disturbance-5-payload.smith.max", 5.1532, "rad/s", TABLE_PAYLOAD, "largest error with payload, Smith"),
    Printed("disturbance-5-payload.state.rmse", 1.2679, "rad/s", TABLE_PAYLOAD, "rate error with payload, state"),
    Printed("disturbance-5-payload.state.max", 7.1853, "rad/s", TABLE_PAYLOAD, "largest error with payload, state"),
    # These are results of the Hex-Jet's flights.
    Printed("hexjet.amplitude", 10, "deg", FLIGHT, "roll doublet"),
    Printed("hexjet.less_overshoot", 42.6, "%", FLIGHT, "less overshoot with Smith than baseline"),
    Printed("hexjet.faster_settling", 64.3, "%", FLIGHT, "faster settling with Smith than baseline"),
    Printed("hexjet-doublet.smith.rmse", 0.0599, "rad", FLIGHT, "roll doublet, tracking error, Smith"),
    Printed("hexjet-doublet.smith.max", 0.3810, "rad", FLIGHT, "roll doublet, largest error, Smith"),
    Printed("hexjet-manual.roll.rmse", 0.0544, "rad", FLIGHT, "manual flight, roll"),
    Printed("hexjet-manual.roll.rate_rmse", 0.2131, "rad/s", FLIGHT, "manual flight, roll rate"),
    Printed("hexjet-manual.pitch.rmse", 0.0470, "rad", FLIGHT, "manual flight, pitch"),
    Printed("hexjet-manual.yaw.rmse", 0.049, "rad", FLIGHT, "manual flight, yaw"),
    Printed("hexjet-manual.pitch.rate_rmse", 0.2103, "rad/s", FLIGHT, "manual flight, pitch rate"),
    Printed("hexjet-manual.yaw.rate_rmse", 0.3217, "rad/s", FLIGHT, "manual flight, yaw rate"),
]
PRINTED: dict[str, Printed] = {row.key: row for row in _PRINTED_NUMBERS}  # by key

# Discrete state matrices as printed. Their poles are those of G_n(z), but from command to first state they have 1/3660
# of its gain: a predictor with these matrices hardly responds to the commands that are still in the delay.
A_D = ((0.9991, 0.0023), (-0.6953, 0.8777))
B_D = (0.0, 0.0234)  # discrete input matrix as printed


def value(key: str) -> float:
    """Return a printed number, by its key, in the printed unit."""
    return PRINTED[key].value


def quadrotor_model(delay_samples: float = 0.0) -> RateModel:
    """Return G_n(z), the quadrotor's response from command to roll rate at 400 Hz, with an added delay."""
    b1, b0, a1, a0 = (value(f"quadrotor.{name}") for name in ("b1", "b0", "a1", "a0"))
    root = sqrt(0.25 * a1 * a1 - a0)
    return RateModel(
        gain=b1,
        zeros=[-b0 / b1],
        poles=[-0.5 * a1 + root, -0.5 * a1 - root],
        delay_samples=delay_samples,
        sample_time_s=1.0 / value("quadrotor.rate"),
        source="paper, discretised roll rate transfer function G_n(z)",
    )


def roll_model(delay_samples: float = 25.0) -> RateModel:
    """Return G(z), the Hex-Jet's response from command to roll rate at 250 Hz."""
    return RateModel(
        gain=value("roll.gain"),
        zeros=[value("roll.zero")],
        poles=[value("roll.pole_slow"), value("roll.pole_fast")],
        delay_samples=delay_samples,
        sample_time_s=value("hexjet.step"),
        source="paper, refined roll response G(z)",
    )
