"""What a reproduction of the paper finds: what is flown and found by hand beside the experiments, and all of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cosim.api import call
from hexjet_paper.claims import ClaimRow, Evidence
from hexjet_paper.comparison import LinearPart, Row, as_data
from hexjet_paper.experiments import Result
from hexjet_paper.loops import Sweep
from hexjet_paper.readings import ModelError, ReadingResult

COMPARISON, REPORT, DATA = "comparison.csv", "report.html", "comparison.json"  # files that a reproduction writes


@dataclass(frozen=True)
class Offset:
    """Roll over time of a flight with half a kilogram 1 cm to the right of the centre of gravity."""

    controller: str
    time: list[float]  # s, from when the load is on board
    roll: list[float]  # rad
    late: float  # rad, mean over the last second


Tracked = dict[str, tuple[list[float], list[float]]]  # by axis: set-point and flown


@dataclass(frozen=True)
class Manual:
    """Tracking errors and signals of the Hex-Jet's manual flight."""

    numbers: dict[str, float]  # by key of the printed numbers
    time: list[float]  # s
    angle: Tracked  # rad
    rate: Tracked  # rad/s, as the gyro measures them


@dataclass(frozen=True)
class TurbojetFlight:
    """Roll doublet of the Hex-Jet on true turbojets, at the gains that the linear search found."""

    controller: str
    outcome: str
    overshoot_percent: float | None
    settling_s: float | None
    rmse: float | None  # rad


@dataclass(frozen=True)
class Response:
    """Measured frequency response per unit command: of thrust in kgf, of rate in rad/s."""

    hertz: list[float]
    gain: list[float]  # dB
    phase: list[float]  # deg


@dataclass(frozen=True)
class Identified:
    """Results of the identification: our values of printed numbers, and frequency responses."""

    numbers: dict[str, float]
    responses: dict[str, Response]  # by "turbojet", "edf" or "roll"
    deviation: tuple[float, float]  # largest from printed G(z): dB, deg
    band: tuple[float, float]  # Hz


@dataclass(frozen=True)
class Reproduction(call.Result):
    """All results of a reproduction, as the report shows them."""

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
    files: dict[str, Path] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return comparison, claims and results of the linear plant, with the flights' under ``flight``."""
        decibel, degree = self.identified.deviation
        flight = {
            "metrics": {name: result.metrics.model_dump() for name, result in self.flight_results.items()},
            "measured_margins": {name: sweep.margins.model_dump() for name, sweep in self.flight_sweeps.items()},
            "offsets": [asdict(offset) for offset in self.offsets],
            "turbojet": [asdict(design) for design in self.turbojet],
            "readings": [reading.model_dump() for reading in self.readings],
            "model_errors": [error.model_dump() for error in self.model_errors],
            "consistency": [row.model_dump() for row in self.consistency],
            "worst_deviation_from_printed_roll": {"db": decibel, "deg": degree},
        }
        return as_data(self.linear, self.rows, self.claims) | {"flight": flight}

    def lines(self) -> list[str]:
        """Return sentences on how many claims hold, and on how G(z) is read."""
        from hexjet_paper.report.page import counts_in_words

        return [counts_in_words(self.claims), "G(z) is read as delay only; the other readings are flown in the report"]

    def tables(self) -> list[call.Table]:
        """Return the tables of the comparison with the paper and of the claims."""
        from hexjet_paper.report.page import rows_to_compare

        numbers = []
        for row in rows_to_compare(self.rows):
            name = f"{row.quantity} ({row.note})" if ".state" in row.key else row.quantity
            linear = _format_cell(row.linear, "{:.4g}"), _format_cell(row.linear_deviation, "{:+.1f} %")
            flight = _format_cell(row.flight, "{:.4g}"), _format_cell(row.flight_deviation, "{:+.1f} %")
            numbers.append((name, row.unit, f"{row.paper:.4g}", *linear, *flight, row.origin))
        claims = [
            (claim.claim, claim.linear.verdict, claim.flight.verdict if claim.flight else "-")
            for claim in [*self.claims, *self.consistency]
        ]
        return [
            call.Table("", ("quantity", "unit", "paper", "linear", "", "flight", "", "origin"), numbers),
            call.Table("", ("claim", "linear plant", "six degrees of freedom"), claims),
        ]


def _format_cell(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
