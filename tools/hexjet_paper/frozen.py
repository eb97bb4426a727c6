"""The unknowns of the paper as they were found and frozen: ``calibration.toml`` beside this file."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict

from cosim.files import read_toml, validate

FILE = Path(__file__).with_name("calibration.toml")  # the calibration that is used


class Calibration(BaseModel):
    """The parameters that the paper does not print, fitted or chosen."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    # These are fitted for the quadrotor.
    p: float  # command per rad/s
    i: float  # command per rad
    d: float  # command per rad/s^2
    attitude_gain_1_s: float
    disturbance_each_s: float  # s, either half of the doublet
    observer_rad_s: float  # state predictor: both observer poles
    payload_gain: float  # gain factor with 230 g of payload
    # These are fitted for the Hex-Jet; the rate integral stays in proportion to vehicle.toml.
    hexjet_p: float
    hexjet_attitude_gain_1_s: float
    # These are fitted with the turbojet's dynamics in the plant and the printed gain (hexjet_paper.readings).
    corrected_p: float
    corrected_attitude_gain_1_s: float
    # These are chosen, not fitted.
    predictor_sees_disturbance: bool = True  # claims.py judges both cases
    extra_delay_samples: float = 0.0  # 0: printed numbers are met without any
    d_filter_s: float = 0.0053  # PX4's default of 30 Hz
    gyro_noise_rad_s: float = 0.02  # small MEMS gyro at 400 Hz
    filter_s: float = 0.05  # of the filtered Smith predictor
    model_observer_rad_s: float = 60.0
    disturbance_observer_rad_s: float = 40.0


class FittedNumber(BaseModel):
    """A printed number that the calibration was fitted to, and our value after the fit."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    key: str
    paper: float
    ours: float
    scale: float  # the residual is (ours - paper) / scale
    stage: str


class Frozen(BaseModel):
    """The file of the calibration: parameters, and the printed numbers that they were fitted to."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    parameters: Calibration
    used: list[FittedNumber]


def load(path: Path = FILE) -> Frozen:
    """Return the frozen calibration.  Raises InputError for a file that is none."""
    return validate(Frozen, read_toml(path), str(path))
