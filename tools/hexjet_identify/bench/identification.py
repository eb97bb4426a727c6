"""What bench logs tell of an engine: forms as fitted, verdict, movements held back, and what is not told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cosim.identify.verdict import Judgement, judge_model, shared_record
from hexjet_identify.bench.engine_form import EngineForm
from hexjet_identify.bench.record import BenchRecord, describe_next_step
from hexjet_identify.fit.estimate import Estimate
from hexjet_identify.fit.evidence import PredictedMovement, Verdict
from hexjet_identify.fit.forms import Lags
from hexjet_identify.fit.problem import Problem

# Names of the forms' parameters in a sentence.
WORDS = {"lag_s": "the lag", "second_lag_s": "the second lag", "rise": "the fastest rise", "fall": "the fastest fall"}


@dataclass(frozen=True)
class Identification:
    """Result of identifying an engine from bench logs; ``estimates`` begins with the chosen form.

    ``total``: delay and lags together, s; ``spread``: standard deviations between several logs of the library's engine
    as fitted to each.
    """

    records: tuple[BenchRecord, ...]
    problem: Problem
    limits: tuple[float, float]
    limits_known: bool
    estimates: tuple[Estimate, ...]
    total: float
    verdict: Verdict
    held_back: tuple[PredictedMovement, ...]
    notes: tuple[str, ...] = ()
    untold: tuple[str, ...] = ()
    spread: Mapping[str, float] = field(default_factory=dict)

    @property
    def chosen(self) -> Estimate:
        """The estimate of the chosen form."""
        return self.estimates[0]

    @property
    def engine(self) -> EngineForm | None:
        """The engine model whose own parameters were fitted; None where lags or limits were."""
        return self.chosen.form if isinstance(self.chosen.form, EngineForm) else None

    @property
    def is_explained(self) -> bool:
        """Whether the chosen form explains the logs."""
        return self.verdict.is_explained

    @property
    def is_told(self) -> bool:
        """Whether the logs determine delay and lags, and not the static line alone."""
        return self.chosen.form != Lags(0)

    @property
    def unknown(self) -> list[str]:
        """Names of the chosen form's parameters, without the delay, whose 95 % bounds exceed their value."""
        numbers = self.chosen.numbers.items()
        return [name for name, (value, one) in numbers if name != "delay_s" and not 1.96 * one <= abs(value)]

    @property
    def refused(self) -> list[str]:
        """Reasons not to use the model as this engine, a line each; empty if there is none."""
        if not self.is_explained:
            return ["the model does not explain the log"]
        if not self.is_told:
            return ["the log tells neither delay nor lag, the static line alone"]
        if not self.unknown:
            return []
        names, (total, off) = " and ".join(WORDS.get(name, name) for name in self.unknown), self.chosen.total
        bounds = f" ±{1.96 * off:.2g}" if np.isfinite(off) else ""
        why = f"the log does not tell {names}, whose 95 % bounds exceed the value; delay and lags together are "
        return [f"{why}{total:.3g}{bounds} s. Next: {describe_next_step(self.records, self.total)}"]

    @property
    def judgement(self) -> Judgement:
        """The verdict on the model with its evidence."""
        return judge_model(self.is_explained, self.verdict.words)

    @property
    def residual_rms(self) -> float:
        """Root mean square of the residual, in the output's unit."""
        return float(np.sqrt(np.mean(self.chosen.residual**2)))

    @property
    def unit(self) -> str:
        """Unit of the fitted output: that of the log, or rpm or N where an engine model was fitted."""
        return self.records[0].output_unit if self.engine is None else self.engine.unit

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the signals, for JSON."""
        first, chosen = self.records[0], self.chosen
        channels, units = (first.command_name, first.output_name), (first.command_unit, first.output_unit)
        record = {
            **shared_record("engine", channels, units, self.judgement, self.refused, self.notes),
            "logs": [str(each.path) for each in self.records],
            "throttle_range": list(self.limits),
            "throttle_range_known": self.limits_known,
            "between_rows": "straight" if self.problem.logs[0].is_straight else "held",
            "row_s": max(each.step for each in self.records),
            "lost_fraction": max(each.lost_fraction for each in self.records),
            "explained": self.is_explained,
            "residual_rms": self.residual_rms,
            "residual_of_swing": self.residual_rms / self.problem.swing,
            "off": self.verdict.off,
            "times_near": self.verdict.near,
            "times": self.verdict.times,
            "held_back": {"movements": [one.to_dict() for one in self.held_back]} if self.held_back else None,
            "delay_s": chosen.delay,
            "delay_bounds_95_s": list(chosen.delay_bounds),
            "estimates": [self._estimate_dict(each) for each in self.estimates],
            "spread": dict(self.spread),
            "not_told": list(self.untold),
        }
        if self.engine is not None:
            record |= {"engine": self.engine.choices.engine, "set": dict(self.engine.choices.settings)}
            record |= {"parameters": {name: value for name, (value, _) in chosen.numbers.items()}}
            record |= {"standard_deviations": chosen.to_dict()["standard_deviations"]}
        return record

    def _estimate_dict(self, estimate: Estimate) -> dict[str, Any]:
        """Return one form's parameters, standard deviations and criteria, for JSON."""
        levels = estimate.levels(self.problem)
        at = self.limits[0] + (self.limits[1] - self.limits[0]) * self.problem.knots
        return {
            **estimate.to_dict(),
            "levels": [[float(a), float(b)] for a, b in zip(at, levels, strict=True)] if len(levels) else [],
            "noise_memory": float(estimate.noise.sum()),
            "rows": len(estimate.residual),
        }
