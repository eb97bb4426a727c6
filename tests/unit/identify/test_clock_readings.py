"""A delay of each stretch of a log is taken where it explains the log, and not where the engine lacks something."""

from typing import NamedTuple

import numpy as np
import pytest

from cosim.base.arrays import Array
from cosim.identify.bench.evidence import Misfit
from cosim.identify.bench.fit import Part, Problem
from cosim.identify.bench.timing.readings import Model, follow_clock
from cosim.identify.bench.timing.stretches import Answered

LATE_S = np.array([-0.03, -0.04, 0.1, 0.0, -0.03])  # of five stretches
STEP_S, STRETCH_S = 0.1, 20.0


class Fit(NamedTuple):
    bic: float
    late: Array  # s, of each row


def steps() -> Part:
    """Return a command up and down each 20 s, and a first-order answer of 1 s with little noise."""
    times = np.arange(0.0, len(LATE_S) * STRETCH_S, STEP_S)
    stretch = (times // STRETCH_S).astype(int)
    command = (stretch % 2 == 0).astype(float)
    since = times - stretch * STRETCH_S
    output = np.where(command > 0.0, 1.0 - np.exp(-since), np.exp(-since))
    return Part(times, command, times, 100.0 * output, STEP_S, False)


@pytest.mark.parametrize(("gained", "is_moved"), [(20.0, False), (200.0, True)])
def test_stretches_are_moved_where_that_clearly_explains_the_log(gained: float, is_moved: bool) -> None:
    part = steps()
    problem = Problem([part], 2.0)
    late = np.repeat(LATE_S, round(STRETCH_S / STEP_S))
    noise = np.random.default_rng(1).normal(0.0, 0.05, len(late))

    def answer(asked: Problem, fit: Fit) -> Answered:
        slope = -np.gradient(part.output, part.times)
        return Answered(slope * fit.late + noise, slope, 0.0, 1.0)

    def refit(moved: Problem, fit: Fit) -> Fit:
        return Fit(1000.0 - gained, late + moved.parts[0].times - part.times)

    notes: list[str] = []
    model = Model(answer, refit, lambda asked, fit: Misfit(1.0, 0.0, 0.0))
    found = follow_clock(problem, Fit(1000.0, late), model, notes, lambda fit: fit.bic)
    assert found.is_moved is is_moved
    assert found.spread == pytest.approx(float(np.std(LATE_S)), rel=0.25)
    assert len(notes) == 1
    assert ("what the engine lacks" in notes[0]) is not is_moved
