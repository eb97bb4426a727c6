"""The margin of a row: what [success] leaves, in parts of the limit; the sign is that of success."""

from __future__ import annotations

from typing import Any

import pytest

from cosim.campaign.analysis.margin import MIN_FAILED_MARGIN, OWN_LIMITS, requirement_margins, row_margin
from cosim.campaign.study.options import open_study
from cosim.campaign.study.study import Study

ROLL, HEIGHT = "roll.overshoot_percent", "altitude.max_abs_error_m"


def study(success: list[str]) -> Study:
    settings = ["duration_s=4"]
    return open_study("hover", vary=["vehicle.mass_kg=5:6"], runs=2, success=success, settings=settings)


def row(**changes: Any) -> dict[str, Any]:
    return {"success": True, "outcome": "completed", "duration_s": 4.0, ROLL: 40.0, HEIGHT: -0.5} | changes


def test_the_nearest_condition_counts_in_parts_of_its_limit() -> None:
    asked = study([f"{ROLL}<=50", f"{HEIGHT}>=-2"])
    assert row_margin(row(), asked) == pytest.approx(0.2)
    assert row_margin(row(**{HEIGHT: -1.9}), asked) == pytest.approx(0.05)
    assert row_margin(row(success=False, **{ROLL: 75.0}), asked) == pytest.approx(-0.5)
    assert row_margin(row(success=False, **{ROLL: None}), asked) == -1.0
    assert row_margin(row(**{ROLL: -0.25}), study([f"{ROLL}<=0"])) == pytest.approx(0.25)
    assert row_margin(row(), study([f"{ROLL}<=50", f"{ROLL}>=10"])) == pytest.approx(0.5)  # of half the band


def test_a_lost_flight_is_the_worse_the_sooner_it_was_lost() -> None:
    asked = study([f"{ROLL}<=50"])
    lost = [row_margin(row(success=False, outcome="crashed", duration_s=t, **{ROLL: 1.0}), asked) for t in (4, 1, 0)]
    assert lost == [-1.0, -1.75, -2.0]
    assert row_margin(row(success=False, outcome="failed", duration_s=None), asked) == -2.0


def test_the_sign_is_that_of_success() -> None:
    """A completed flight beyond one of its limits failed, however well it met what the study asks for."""
    asked = study([f"{ROLL}<=50"])
    assert row_margin(row(success=False), asked) == -MIN_FAILED_MARGIN
    assert row_margin(row(), study([])) == 1.0


def test_a_stated_margin_comes_first() -> None:
    asked = study([f"{ROLL}<=50"])
    assert row_margin(row(margin=0.03), asked) == 0.03
    assert row_margin(row(margin=-0.4, success=False), asked) == -0.4
    assert row_margin(row(margin=-7.0, success=False, outcome="crashed"), asked) == -7.0


def test_each_requirement_has_its_own_margin_and_one_is_broken_in_a_failure() -> None:
    names, margins = requirement_margins(study([f"{ROLL}<=50", f"{HEIGHT}<=2"]))
    assert names == [ROLL, HEIGHT, OWN_LIMITS]
    kept = {"margin_" + ROLL: 10.0, "margin_" + HEIGHT: 1.0, "limits_margin": 0.7, "margin": 0.2}
    assert margins(row(**kept)) == pytest.approx([0.2, 0.5, 0.7])
    broken = kept | {"margin_" + ROLL: -5.0, "margin": -0.1, "success": False}
    assert margins(row(**broken)) == pytest.approx([-0.1, 0.5, 0.7])
    assert margins(row(**kept | {"success": False})) == pytest.approx([0.2, 0.5, -MIN_FAILED_MARGIN])
    assert margins(row(success=False, outcome="failed", duration_s=None)) == [1.0, 1.0, -2.0]
    assert requirement_margins(study([]))[1](row(margin=0.3)) == [0.3]
    assert margins(row(margin=0.3)) == [1.0, 1.0, 0.3]  # the row says no more
