"""Margins judged beside their limits, and the line that names the worst."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hexjet_design.measured.estimate import Bounded
from hexjet_design.measured.judgement import falls_below, judge_axis, judgement_line


def an_axis(axis: str, uncertainty: float | None = None, lost: int = 0, **margins: tuple[float, float, float]) -> Any:
    """An axis with these margins, each with its bounds, a transport delay of 100 ms and steps of 4 ms."""
    found = {name: Bounded(*each) for name, each in margins.items()}
    found = {"peak_sensitivity": Bounded(1.7, 1.7, 1.7), "crossover_hz": Bounded(1.0, 1.0, 1.0)} | found
    return SimpleNamespace(
        axis=axis,
        response=SimpleNamespace(margins=found),
        transport_s=0.1,
        sine=SimpleNamespace(step=0.004),
        uncertainty=None if uncertainty is None else SimpleNamespace(delay_s=uncertainty),
        over_engine=None if uncertainty is None else SimpleNamespace(draws=200, unstable=lost),
    )


@pytest.mark.parametrize(
    ("margins", "line"),
    [
        ({"gain_db": (8.4, 8.3, 8.5), "gain_down_db": (-23.0, -23.1, -22.9), "phase_deg": (34.0, 33.9, 34.1),
          "delay_s": (0.124, 0.12, 0.13)},
         "every margin is enough; worst: roll phase, lag 34.0 deg, by its bounds 33.9 deg, "
         "limit 29.0 deg (23.1 deg with a well-known engine)"),
        ({"phase_deg": (24.0, 23.9, 24.1)},
         "fly it only with a well-known engine; worst: roll phase, lag 24.0 deg, by its bounds 23.9 deg, "
         "limit 29.0 deg (23.1 deg with a well-known engine)"),
        ({"gain_db": (6.1, 5.9, 6.3)},  # its bounds may lie below what it was found at
         "fly it only with a well-known engine; worst: roll gain up 6.1 dB, by its bounds 5.9 dB, "
         "limit 6.0 dB (4.4 dB with a well-known engine)"),
        ({"gain_down_db": (-3.0, -3.1, -2.9), "phase_deg": (23.0, 22.9, 23.1)},
         "do not fly on it; worst: roll gain down -3.0 dB, by its bounds -2.9 dB, limit -6.0 dB (-4.4 dB with a well-known engine), "
         "and 1 more too little"),
        ({"phase_deg": (34.0, -40.0, 108.0)},  # bounds that reach beyond 0 are no larger margin
         "do not fly on it; worst: roll phase, lag 34.0 deg, by its bounds 0.0 deg, "
         "limit 29.0 deg (23.1 deg with a well-known engine)"),
        ({"gain_down_db": (-9.0, -25.0, 7.0)},
         "do not fly on it; worst: roll gain down -9.0 dB, by its bounds 0.0 dB, limit -6.0 dB (-4.4 dB with a well-known engine)"),
        ({"delay_s": (0.029, 0.029, 0.029)}, "do not fly on it; worst: roll delay, more 29 ms, limit 30 ms"),
        ({"peak_sensitivity": (2.4, 2.3, 2.51)},
         "do not fly on it; worst: roll peak |S| 2.40, by its bounds 2.51, "
         "limit 2.00 (2.50 with a well-known engine)"),
        ({"uncertainty": 0.01, "delay_s": (0.029, 0.029, 0.029)},
         "do not fly on it; worst: roll delay, more 29 ms, limit 30 ms"),
        ({"uncertainty": 0.0096, "delay_s": (0.029, 0.029, 0.029), "lost": 1},
         "do not fly on it; worst: roll unstable draws 1, limit 0"),
    ],
)  # fmt: skip
def test_the_last_line_judges_every_margin_and_names_the_worst(margins: dict[str, Any], line: str) -> None:
    rows = judge_axis(an_axis("roll", **margins)) + judge_axis(an_axis("yaw", peak_sensitivity=(1.1, 1.1, 1.1)))
    assert judgement_line(rows) == f"judgement: {line}: docs/judging.md"
    bands = ["enough", "narrow", "too little"]
    worst = max(bands.index(row.band or "enough") for row in rows)
    assert [falls_below(rows, band) for band in bands[:2]] == [worst > 0, worst > 1]


def test_what_has_no_known_delay_is_not_judged_by_one() -> None:
    axis = an_axis("pitch", delay_s=(0.001, 0.001, 0.001))
    axis.transport_s = None
    (late,) = [row for row in judge_axis(axis) if row.margin == "delay_s"]
    assert (late.limit, late.band, late.cells()[-2:]) == (None, None, ["not judged", "delay not known"])
    assert judgement_line(judge_axis(axis)).startswith("judgement: every margin is enough; worst: pitch peak |S| 1.70")


def test_a_band_without_a_crossover_tells_no_margins() -> None:
    """A low peak sensitivity is all that such a band shows, and it is no proof of the margins outside."""
    axis = an_axis("yaw")
    del axis.response.margins["crossover_hz"]
    rows = judge_axis(axis)
    assert judgement_line(rows) == ("judgement: the margins are not told; worst: yaw crossover none: docs/judging.md")
    assert [falls_below(rows, band) for band in ("enough", "narrow")] == [True, True]
    assert ["yaw", "crossover", "none", "-", "not told", "widen the band"] in [row.cells() for row in rows]
    axis.response.margins["peak_sensitivity"] = Bounded(2.6, 2.6, 2.6)
    assert judgement_line(judge_axis(axis)).startswith("judgement: do not fly on it; worst: yaw peak |S| 2.60")
