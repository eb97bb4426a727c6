"""What a verdict rests on: "as planned" is said only of what was planned and checked."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from places import TESTS

from cosim.base.outcomes import RunVerdict
from cosim.results.run import open_run
from cosim.results.verdict import describe_end, judge, read_verdict

OLD = TESTS / "older" / "0.1.0-a" / "run"


@pytest.mark.parametrize(
    ("outcome", "beyond", "met", "verdict"),
    [
        ("completed", [], True, "as planned"),
        ("completed", [], None, "completed, nothing checked"),
        ("completed", [], False, "not as expected"),
        ("completed", ["position.drift_m"], None, "beyond limits"),
        ("completed", ["position.drift_m"], True, "beyond limits"),
        ("diverged", [], True, "not completed"),
        ("crashed", ["position.drift_m"], None, "not completed"),
    ],
)
def test_a_verdict_follows_from_outcome_limits_and_expectations(
    outcome: str, beyond: list[str], met: bool | None, verdict: str
) -> None:
    assert judge(outcome, beyond, met) == verdict  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("verdict", "said"),
    [
        ("as planned", "completed, flew 5 steps; as planned"),
        ("completed, nothing checked", "completed, nothing checked; flew 5 steps"),
        ("beyond limits", "completed, flew 5 steps; beyond limits"),
        (None, "completed, flew 5 steps"),
    ],
)
def test_the_end_in_words(verdict: RunVerdict | None, said: str) -> None:
    assert describe_end("completed", "flew 5 steps", verdict) == said
    assert describe_end("diverged", "leaned past 80 deg", "not completed") == "diverged, leaned past 80 deg"


def test_an_older_run_of_which_nothing_was_expected_opens_as_such(tmp_path: Path) -> None:
    recorded = json.loads((OLD / "summary.json").read_text())
    assert (recorded["verdict"], recorded["expectations_met"]) == ("as planned", None)
    summary = open_run(OLD).summary
    assert summary.verdict == "completed, nothing checked"
    assert (summary.succeeded, summary.as_planned) == (True, False)
    shutil.copytree(OLD, tmp_path / "run")
    (tmp_path / "run" / "summary.json").write_text(json.dumps(recorded | {"expectations_met": True}))
    expected = open_run(tmp_path / "run").summary
    assert (expected.verdict, expected.succeeded, expected.as_planned) == ("as planned", True, True)


def test_other_recorded_verdicts_stay() -> None:
    assert read_verdict("beyond limits", None) == "beyond limits"
    assert read_verdict("as planned", True) == "as planned"
