"""The credibility table: every factor of the standard, a level from what exists, honest where there is nothing."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from places import ROOT

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml
from cosim.campaign.proof.credibility import RECORD, Evidence, assess_credibility, read_comparison
from cosim.results.report.marks import page_parts
from cosim.results.summary import versions

FACTORS = (  # NASA-STD-7009B, Appendix E: five of the model, six of its use
    "Data pedigree",
    "Verification",
    "Validation",
    "Development technical review",
    "Development process and product management",
    "Use assessment",
    "Input pedigree",
    "Uncertainty characterization",
    "Results robustness",
    "Use and analysis technical review",
    "Use process and product management",
)
GOOD = Evidence(
    aircraft="hexjet",
    engine="turbojet",
    is_shipped=True,
    version=versions()["hexjet-cosim"],
    own_code=[],
    uncertainty_source="hexjet identify bench of 12.csv",
    is_engine_drawn=True,
    varied=6,
    not_varied=[],
    ranked=6,
    searched=True,
    warnings=[],
    replayed=3,
    replayed_same=3,
    comparisons=[{"log": "f.ulg", "aircraft": "hexjet", "engine": "turbojet", "verdict": "explained", "seconds": 20.0}],
)


def level(evidence: Evidence, factor: str) -> int:
    (found,) = [one for one in assess_credibility(evidence) if one.name == factor]
    return found.level


def test_every_factor_is_there_with_what_it_rests_on() -> None:
    for evidence in (GOOD, replace(GOOD, is_shipped=False, varied=0, ranked=0, searched=False, comparisons=[])):
        factors = assess_credibility(evidence)
        assert tuple(one.name for one in factors) == FACTORS
        assert [one.assessment for one in factors].count("capability") == 5
        assert all(one.level in range(4) and one.evidence and one.raised_by for one in factors)


def test_the_most_that_is_given() -> None:
    """No level that a person has to judge, and none of the reviews, which are on no record."""
    levels = {one.name: one.level for one in assess_credibility(GOOD)}
    assert levels == dict(zip(FACTORS, (2, 2, 2, 0, 2, 1, 2, 2, 3, 0, 2), strict=True))


@pytest.mark.parametrize(
    ("changes", "factor", "expected"),
    [
        ({"is_shipped": False}, "Data pedigree", 0),
        ({"uncertainty_source": "chosen, from fits of speed"}, "Data pedigree", 1),
        ({"uncertainty_source": None}, "Data pedigree", 1),
        ({"version": "0.0.1"}, "Verification", 1),
        ({"own_code": ["mine.py"]}, "Verification", 1),
        ({"comparisons": []}, "Validation", 1),  # with the paper
        ({"comparisons": [], "is_shipped": False}, "Validation", 0),
        ({"comparisons": [], "aircraft": "crazyflie"}, "Validation", 0),  # compared, and not explained
        ({"comparisons": [], "aircraft": "octojet"}, "Validation", 0),
        ({"comparisons": [], "aircraft": "octojet", "engine": "jetcat-p300"}, "Validation", 0),  # of the engine alone
        ({"comparisons": [GOOD.comparisons[0] | {"verdict": "not explained"}]}, "Validation", 0),
        ({"comparisons": [GOOD.comparisons[0] | {"aircraft": "mine"}]}, "Validation", 1),
        ({"is_shipped": False}, "Development process and product management", 1),
        ({"warnings": ["its proof failed"]}, "Use assessment", 0),
        ({"varied": 0}, "Input pedigree", 0),
        ({"uncertainty_source": "chosen"}, "Input pedigree", 1),
        ({"is_engine_drawn": False}, "Input pedigree", 1),
        ({"is_engine_drawn": False}, "Uncertainty characterization", 1),  # it states one
        ({"is_engine_drawn": False, "uncertainty_source": None}, "Uncertainty characterization", 2),
        ({"varied": 0}, "Uncertainty characterization", 0),
        ({"searched": False}, "Results robustness", 2),
        ({"ranked": 3}, "Results robustness", 2),
        ({"not_varied": ["servos"]}, "Results robustness", 2),
        ({"ranked": 0}, "Results robustness", 1),
        ({"ranked": 0, "searched": False}, "Results robustness", 0),
        ({"replayed_same": 2}, "Use process and product management", 0),
        ({"replayed": 0, "replayed_same": 0}, "Use process and product management", 1),
    ],
)
def test_less_evidence_is_a_lower_level(changes: dict[str, object], factor: str, expected: int) -> None:
    assert level(replace(GOOD, **changes), factor) == expected  # type: ignore[arg-type]


def test_what_is_not_varied_is_named() -> None:
    (factor,) = [
        one
        for one in assess_credibility(replace(GOOD, not_varied=["servos", "wind and air"]))
        if one.name == "Uncertainty characterization"
    ]
    assert "nothing of servos and wind and air" in factor.evidence


def test_the_record_is_what_the_pages_say() -> None:
    record = read_toml(RECORD)
    cases = page_parts(ROOT / "docs" / "accuracy.md")["check cases"]
    verdicts = re.findall(r"^\| \d.*\| (.*?) \|$", cases, re.MULTILINE)
    assert record["verification"] == {
        "version": versions()["hexjet-cosim"],
        "compared": len(verdicts),
        "inside": verdicts.count("inside"),
    }
    for one in record["comparison"]:
        assert (ROOT / one["page"]).is_file(), one
        assert (ROOT / one["test"]).is_file(), one


def test_what_replay_left_is_read(tmp_path: Path) -> None:
    told = dict(GOOD.comparisons[0]) | {"more": 1}
    (tmp_path / "replay.json").write_text(json.dumps(told))
    assert read_comparison(tmp_path) == read_comparison(tmp_path / "replay.json") == GOOD.comparisons[0]
    (tmp_path / "replay.json").write_text("{}")
    with pytest.raises(InputError, match=r"replay\.json: is no replay.json of hexjet replay"):
        read_comparison(tmp_path)
