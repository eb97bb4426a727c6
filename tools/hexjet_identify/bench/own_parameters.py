"""Parameters of an engine that is simulated, fitted to bench logs: a turbine with its ECU, or anybody's FMU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cosim.base.errors import InputError
from hexjet_identify.bench.engine_form import EngineChoices, EngineForm, make_form
from hexjet_identify.bench.identification import Identification
from hexjet_identify.bench.identify import Choices, as_log, check_moves, make_problem, moves_gradually, throttle_limits
from hexjet_identify.bench.record import BenchRecord
from hexjet_identify.bench.remarks import describe_small_movements
from hexjet_identify.bench.running import RPM_PER_UNIT
from hexjet_identify.fit.estimate import Estimate, find_start, fit
from hexjet_identify.fit.evidence import judge, predict_held_back, spread_of_delay
from hexjet_identify.fit.forms import Lags
from hexjet_identify.fit.problem import Problem


def fit_engine(records: Sequence[BenchRecord], engine: EngineChoices, choices: Choices | None = None) -> Identification:
    """Fit parameters of an engine, and the delay before it, to bench logs; each log begins at rest.

    Raises InputError for an engine, a parameter or an output that does not serve.
    """
    choices, first, notes = choices or Choices(), records[0], list[str]()
    for record in records:
        check_moves(record)
    form = make_form(records, engine, choices.longest_delay)
    limits = (0.0, 1.0 / RPM_PER_UNIT.get(first.command_unit, 1.0))
    if not form.is_set_point:
        limits, is_known = throttle_limits(records, choices.limits, notes)
        if not is_known:
            raise InputError(f"{first.path}: what throttle 0 and 1 are is not known: throttle_range LOW HIGH")
    is_open = choices.between == "auto" and any(moves_gradually(record.command) for record in records)
    if is_open:
        half = 500.0 * max(record.command_row for record in records)
        notes.append(
            f"{first.command_name} moves from row to row: taken for straight between rows; if it is held, the delay is "
            f"{half:.3g} ms less (between held)"
        )
    unit = RPM_PER_UNIT.get(first.output_unit, first.newtons or 1.0)
    logs = [as_log(record, limits, is_open or choices.between == "straight") for record in records]
    problem = make_problem([replace(log, output=unit * log.output) for log in logs], choices.longest_delay)
    form = replace(form, seconds=Lags(1).total(find_start(problem)))
    estimate = fit(problem, form, form.start)
    held_back = predict_held_back(problem, estimate, form.seconds)
    row = max(log.command_row for log in logs)
    half = 1.96 * estimate.deviation(0) + spread_of_delay(problem, estimate, form.seconds, row)
    bounds = max(estimate.delay - half, 0.0), estimate.delay + half
    verdict = judge(problem, estimate, form.seconds, held_back)
    notes = [*_describe_beginning(problem, estimate, records), *_note_limits_reached(problem, estimate, form), *notes]
    if form.is_speed:
        notes.append(f"the log has no thrust: thrust, fuel and temperature are those of {engine.engine} as it is set")
    notes += [note for record in records for note in record.notes]
    return Identification(
        tuple(records), problem, limits, True, (replace(estimate, delay_bounds=bounds),), form.seconds, verdict,
        held_back, tuple(dict.fromkeys(notes)), tuple(describe_small_movements(records, form.seconds)),
    )  # fmt: skip


def _describe_beginning(
    problem: Problem, estimate: Estimate, records: Sequence[BenchRecord], seconds: float = 0.5, share: float = 0.05
) -> list[str]:
    """Return a note for each log that does not begin at rest: ``seconds`` of it are off by ``share`` of the range."""
    notes = []
    for record, log, rows in zip(records, problem.logs, problem.spans, strict=True):
        off = abs(float(np.mean(estimate.residual[rows][log.times - log.times[0] <= seconds])))
        if off > share * problem.swing:
            notes.append(
                f"{record.path.name} begins {100.0 * off / problem.swing:.2g} % of the output's range from where the "
                f"engine rests: each log has to begin at rest; begin after {log.times[0]:.4g} s"
            )
    return notes


def _note_limits_reached(problem: Problem, estimate: Estimate, form: EngineForm) -> list[str]:
    low, high = form.limits(problem)
    return [
        f"{name} ends at {value:.4g}, a limit of what is looked for"
        for name, value, least, most in zip(form.choices.fitted, estimate.x[1:], low[1:], high[1:], strict=True)
        if value <= 1.001 * least or value >= 0.999 * most
    ]
