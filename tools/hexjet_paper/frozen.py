"""The unknowns of the paper as they were found and frozen: ``calibration.toml`` beside this file."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict

from cosim.files import read_toml, validate

FILE = Path(__file__).with_name("calibration.toml")  # the calibration that is kept


class Calibration(BaseModel):
    """The unknowns of the paper."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    # Quadrotor, fitted.
    p: float  # command per rad/s
    i: float  # command per rad
    d: float  # command per rad/s^2
    attitude_gain_1_s: float
    disturbance_each_s: float  # s, of either half of the doublet
    observer_rad_s: float  # both observer poles, double integrator
    payload_gain: float  # gain factor with 230 g of payload
    # Hex-Jet, fitted; the rate integral stays in proportion to vehicle.toml.
    hexjet_p: float
    hexjet_attitude_gain_1_s: float
    # The same with the turbojet's dynamics in the plant and the printed gain (hexjet_paper.readings).
    corrected_p: float
    corrected_attitude_gain_1_s: float
    # Chosen, not fitted.
    predictor_sees_disturbance: bool = True  # see claims.py
    extra_delay_samples: float = 0.0  # no printed number needs any
    d_filter_s: float = 0.0053  # PX4's default of 30 Hz
    gyro_noise_rad_s: float = 0.02  # small MEMS gyro at 400 Hz
    filter_s: float = 0.05  # of the filtered Smith predictor
    model_observer_rad_s: float = 60.0
    disturbance_observer_rad_s: float = 40.0


class FittedNumber(BaseModel):
    """A printed number that the calibration was fitted to, and its value after the fit."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    key: str
    paper: float
    ours: float
    scale: float  # the residual is (ours - paper) / scale
    stage: str


class Frozen(BaseModel):
    """The file: unknowns, the numbers that were used, and how they were met."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    parameters: Calibration
    used: list[FittedNumber]


def load(path: Path = FILE) -> Frozen:
    """Return the frozen calibration.  Raises InputError for a file that does not fit."""
    return validate(Frozen, read_toml(path), str(path))
