"""What a reproduction of the paper finds: what is flown and found by hand beside the experiments, and all of it."""

from __future__ import annotations

from dataclasses import dataclass

from hexjet_paper.claims import ClaimRow, Evidence
from hexjet_paper.comparison import LinearPart, Row
from hexjet_paper.experiments import Result
from hexjet_paper.loops import Sweep
from hexjet_paper.readings import ModelError, ReadingResult

COMPARISON, REPORT, DATA = "comparison.csv", "report.html", "comparison.json"


@dataclass(frozen=True)
class Offset:
    """A flight with half a kilogram 1 cm to the right of the centre of gravity: roll over time."""

    controller: str
    time: list[float]  # s after the load came on board
    roll: list[float]  # rad
    late: float  # rad, mean over the last second


Tracked = dict[str, tuple[list[float], list[float]]]  # by axis: set-point and what was flown


@dataclass(frozen=True)
class Manual:
    """The Hex-Jet's manual flight."""

    numbers: dict[str, float]  # by the printed numbers' keys
    time: list[float]  # s
    angle: Tracked  # rad
    rate: Tracked  # rad/s, as the gyro gives them


@dataclass(frozen=True)
class TurbojetFlight:
    """The Hex-Jet on true turbojets, flown through its roll doublet at the gains that the linear search found."""

    controller: str
    outcome: str
    overshoot_percent: float | None
    settling_s: float | None
    rmse: float | None  # rad


@dataclass(frozen=True)
class Response:
    """A measured frequency response of the identification, thrust in kgf, rate in rad/s, per unit command."""

    hertz: list[float]
    gain: list[float]  # dB
    phase: list[float]  # deg


@dataclass(frozen=True)
class Identified:
    """What the identification found: numbers by the printed ones' keys, and the responses they were fitted to."""

    numbers: dict[str, float]
    responses: dict[str, Response]  # turbojet, edf, roll
    deviation: tuple[float, float]  # dB, deg: the swept roll response from the printed G(z), at worst
    band: tuple[float, float]  # Hz


@dataclass(frozen=True)
class Reproduction:
    """Everything that the report shows."""

    linear: LinearPart
    flight_results: dict[str, Result]
    flight_evidence: Evidence
    flight_sweeps: dict[str, Sweep]
    offsets: list[Offset]
    turbojet: list[TurbojetFlight]
    manual: Manual
    extra: dict[str, float]
    rows: list[Row]
    claims: list[ClaimRow]
    consistency: list[ClaimRow]
    readings: list[ReadingResult]
    model_errors: list[ModelError]
    identified: Identified
