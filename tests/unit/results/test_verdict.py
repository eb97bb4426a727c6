"""What a verdict rests on: "as planned" is said only of what was planned and checked."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from places import TESTS

from cosim.base.errors import InputError
from cosim.base.outcomes import RunVerdict
from cosim.results.run import open_run
from cosim.results.verdict import describe_end, judge


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
def test_a_verdict_is_of_outcome_limits_and_expectations(
    outcome: str, beyond: list[str], met: bool | None, verdict: str
) -> None:
    assert judge(outcome, beyond, met) == verdict


@pytest.mark.parametrize(
    ("verdict", "said"),
    [
        ("as planned", "completed, flew 5 steps; as planned"),
        ("completed, nothing checked", "completed, nothing checked; flew 5 steps"),
        ("beyond limits", "completed, flew 5 steps; beyond limits"),
        (None, "completed, flew 5 steps"),
    ],
)
def test_the_end_is_described_in_words(verdict: RunVerdict | None, said: str) -> None:
    assert describe_end("completed", "flew 5 steps", verdict) == said
    assert describe_end("diverged", "leaned past 80 deg", "not completed") == "diverged, leaned past 80 deg"


def test_a_run_written_before_version_0_2_is_told_to_open_with_it(tmp_path: Path) -> None:
    shutil.copytree(TESTS / "older" / "0.2.0-a" / "run", tmp_path / "run")
    summary = tmp_path / "run" / "summary.json"
    summary.write_text(summary.read_text().replace('"hexjet-cosim": "0.2.0"', '"hexjet-cosim": "0.1.0"'))
    with pytest.raises(InputError, match=r"run: written before version 0\.2\.0; open it with 0\.2\.0$"):
        open_run(tmp_path / "run")
