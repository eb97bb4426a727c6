"""The unknowns of the paper as they were found and frozen: ``calibration.toml`` beside this file."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict

from cosim.files import read_toml, validate

FILE = Path(__file__).with_name("calibration.toml")


class Calibration(BaseModel):
    """The unknowns of the paper."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    # quadrotor, found
    p: float  # command per rad/s
    i: float  # command per rad
    d: float  # command per rad/s^2
    attitude_gain_1_s: float
    disturbance_each_s: float  # of either half
    observer_rad_s: float  # both, of the double integrator
    payload_gain: float  # of the plant's gain, with 230 g more
    # Hex-Jet, found; rate integral in proportion to vehicle.toml
    hexjet_p: float
    hexjet_attitude_gain_1_s: float
    # The same with the turbojet's dynamics in the plant and the printed gain (hexjet_paper.readings).
    corrected_p: float
    corrected_attitude_gain_1_s: float
    # chosen
    predictor_sees_disturbance: bool = True  # see the claims
    extra_delay_samples: float = 0.0  # nothing printed asks for any
    d_filter_s: float = 0.0053  # PX4's 30 Hz
    gyro_noise_rad_s: float = 0.02  # small MEMS gyro at 400 Hz
    filter_s: float = 0.05  # filtered Smith
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
