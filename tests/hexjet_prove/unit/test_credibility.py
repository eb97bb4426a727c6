"""The form of credibility: every factor of the standard with what is on record, and no level that is computed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cosim.base.errors import InputError
from cosim.results.summary import versions
from hexjet_prove.proof.credibility import Evidence, list_evidence, read_comparison

FACTORS = (  # NASA-STD-7009B, Appendix E: five of the model, six of its use
    "Data pedigree", "Verification", "Validation", "Development technical review",
    "Development process and product management", "Use assessment", "Input pedigree", "Uncertainty characterization",
    "Results robustness", "Use and analysis technical review", "Use process and product management",
)  # fmt: skip
REPLAY = {
    "log": "f.ulg", "log_sha256": "ab" * 32, "simulated": False, "aircraft": "hexjet", "engine": "turbojet",
    "verdict": "explained", "seconds": 20.0,
}  # fmt: skip
GOOD = Evidence(
    aircraft="hexjet", engine="turbojet", is_shipped=True, version=versions()["hexjet-cosim"], own_code=[],
    uncertainty_source="hexjet engine from-bench of 12.csv", is_engine_drawn=True, varied=6, not_varied=[], ranked=6,
    searched=True, warnings=[], replayed=3, replayed_same=3, comparisons=[REPLAY],
)  # fmt: skip


def evidence_of(evidence: Evidence, factor: str) -> str:
    (found,) = [one for one in list_evidence(evidence) if one.name == factor]
    return found.evidence


def test_every_factor_is_there_with_what_is_on_record_and_a_level_to_fill_in() -> None:
    for evidence in (GOOD, replace(GOOD, is_shipped=False, varied=0, ranked=0, searched=False, comparisons=[])):
        factors = list_evidence(evidence)
        assert tuple(one.name for one in factors) == FACTORS
        assert [one.assessment for one in factors].count("capability") == 5
        assert all(one.evidence and (one.level, one.reason, one.judged_by) == (None, "", "") for one in factors)


def test_a_replay_is_listed_by_log_hash_aircraft_engine_and_length() -> None:
    text = evidence_of(GOOD, "Validation").partition("; compared with")[0]
    assert text == "20 s of f.ulg (sha256 abababababababab, hexjet with turbojet): explained"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"simulated": True}, "explained; a run of this program, no recorded flight"),
        ({"engine": "edf"}, "; of another engine than flew here"),
        ({"aircraft": "mine", "engine": "edf"}, "; of another aircraft and another engine than flew here"),
        ({"seconds": 0.02}, "0.02 s of f.ulg"),
    ],
)
def test_what_a_replay_is_not_is_said(changes: dict[str, object], words: str) -> None:
    """A run of the program itself, another engine, two hundredths of a second: nothing of it counts for more."""
    assert words in evidence_of(replace(GOOD, comparisons=[{**REPLAY, **changes}]), "Validation")


@pytest.mark.parametrize(
    ("changes", "factor", "words"),
    [
        ({"is_shipped": False}, "Data pedigree", "nothing says where they are from"),
        ({"uncertainty_source": "chosen, from fits of speed"}, "Data pedigree", "many are published or chosen"),
        ({}, "Data pedigree", "identified: hexjet engine from-bench of 12.csv"),
        ({"version": "0.0.1"}, "Verification", "0.0.1 flew"),
        ({"own_code": ["mine.py"]}, "Verification", "none of them sees: mine.py"),
        ({"comparisons": []}, "Validation", "some hold, some under a condition and some do not"),
        ({"comparisons": [], "is_shipped": False}, "Validation", "compared with no measurement of the real vehicle"),
        ({"comparisons": [], "aircraft": "crazyflie"}, "Validation", "neither flight is explained"),
        ({"warnings": ["its proof failed"]}, "Use assessment", "its proof failed; no earlier use is on record"),
        ({"varied": 0}, "Input pedigree", "nothing was varied"),
        ({"uncertainty_source": "chosen"}, "Input pedigree", "that was not measured: chosen"),
        ({"is_engine_drawn": False}, "Uncertainty characterization", "an uncertainty that was not drawn"),
        ({"ranked": 0}, "Results robustness", "no sensitivity is known; a search"),
        ({"replayed_same": 2}, "Use process and product management", "2 of 3 flights came out the same"),
    ],
)
def test_the_evidence_is_what_there_is(changes: dict[str, object], factor: str, words: str) -> None:
    assert words in evidence_of(replace(GOOD, **changes), factor)  # type: ignore[arg-type]


def test_what_is_not_varied_is_named() -> None:
    evidence = replace(GOOD, not_varied=["servos", "wind and air"])
    assert "nothing of servos and wind and air" in evidence_of(evidence, "Uncertainty characterization")


def test_what_replay_left_is_read(tmp_path: Path) -> None:
    told = dict(GOOD.comparisons[0]) | {"more": 1}
    (tmp_path / "replay.json").write_text(json.dumps(told))
    assert read_comparison(tmp_path) == read_comparison(tmp_path / "replay.json") == GOOD.comparisons[0]
    (tmp_path / "replay.json").write_text("{}")
    with pytest.raises(InputError, match=r"replay\.json: lacks 'log'; hexjet replay of this version writes it$"):
        read_comparison(tmp_path)
    five = {key: REPLAY[key] for key in ("log", "aircraft", "engine", "verdict", "seconds")}
    (tmp_path / "replay.json").write_text(json.dumps(five))
    with pytest.raises(InputError, match=r"replay\.json: lacks 'log_sha256'"):
        read_comparison(tmp_path)
    (tmp_path / "replay.json").write_text("[]")
    with pytest.raises(InputError, match=r"replay\.json: is no replay.json of hexjet replay"):
        read_comparison(tmp_path)
