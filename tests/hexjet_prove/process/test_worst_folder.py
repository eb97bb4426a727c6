"""The worst case of real flights: the same wherever they are flown, killed and resumed, and as a run that replays."""

from __future__ import annotations

import json
from functools import partial
from itertools import combinations, product
from math import prod
from pathlib import Path
from typing import Any

import pytest
from campaign_tools import without_chance
from command_tools import Hexjet
from places import DESIGNS

from cosim.campaign import open_campaign
from cosim.campaign.study.draws import Draws
from cosim.campaign.workers.local import LocalWorkers
from cosim.results.log.digest import log_digest
from cosim.results.run import open_run
from hexjet_prove.search.folder import RESULT
from hexjet_prove.search.probe import Point, Prober, answer_all
from hexjet_prove.search.worst_folder import SavedWorst, resolve_worst, run_worst

SEARCH = [
    "hover", "--likely", "--vary", "environment.wind_ned_m_s.1=normal(0,3,-30,30)", "--vary",
    "vehicle.mass_kg=normal(5.6,0.05,5.2,6)", "--set", "duration_s=0.4", "--success", "speed.max_m_s<=0.05", "--budget", "60",
]  # fmt: skip


PLANTED = """
from math import prod
from cosim.base.protocols import Parameter

class Planted:
    level = "predictor"
    parameters = tuple(Parameter(f"k{n}", 0.5, "", "one of six that break it together", 0.0, 1.0) for n in range(6))

    def prepare(self, belief):
        self.share = 1.0 - 1.9 * prod(0.5 + 0.5 * value for value in belief.parameters.values())

    def reset(self):
        pass

    def update(self, measured, applied):
        return self.share * measured
"""  # the rate is fed back with less of it, at last with the wrong sign, the nearer all six come to 1
KEYS = [f"controller_parameters.k{n}" for n in range(6)]


def plan() -> tuple[Any, Any]:
    return resolve_worst(
        "hover", likely=True, vary=[SEARCH[3], SEARCH[5]], settings=[SEARCH[7]], success=[SEARCH[9]], budget=60
    )


def told(folder: Path) -> dict[str, Any]:
    """The result without where it is."""
    result: dict[str, Any] = json.loads((folder / RESULT).read_text())
    return {key: value for key, value in result.items() if key != "folder"}


def rows(folder: Path) -> list[str]:
    """What was flown."""
    campaign = open_campaign(folder)
    return [json.dumps(without_chance(campaign.row(number))) for number in range(len(campaign))]


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> SavedWorst:
    """The search by one process, not stopped."""
    with LocalWorkers(1) as workers:
        return run_worst(*plan(), tmp_path_factory.mktemp("worst") / "one", workers)


def test_what_was_found_replays_bit_for_bit(searched: SavedWorst, hexjet: Hexjet, tmp_path: Path) -> None:
    (found,) = searched.result.cases
    assert found.fails
    assert found.distance is not None
    assert 0.5 < found.distance < 6.0
    (case,) = searched.cases
    assert case.same
    assert case.name == "smith-likely"
    kept = searched.folder / "cases" / case.name
    answer = hexjet("fly", str(kept / "scenario.toml"), "--out", str(tmp_path / "again"))
    assert answer.status == 0
    assert log_digest(open_run(tmp_path / "again").log) == log_digest(open_run(kept).log)
    page = (searched.folder / "search.html").read_text()
    assert searched.result.lines()[0].split(":")[1].strip() in page
    assert "environment.wind_ned_m_s.1" in page


def test_two_workers_come_to_the_same(searched: SavedWorst, tmp_path: Path) -> None:
    with LocalWorkers(2) as workers:
        run_worst(*plan(), tmp_path / "two", workers)
    assert told(tmp_path / "two") == told(searched.folder)
    assert rows(tmp_path / "two") == rows(searched.folder)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--worst"], "likely: goes without worst"),
        (["--over", "seed=1:2:2"], "over: is of a search of one key"),
        (["--tolerance", "0.1"], "tolerance: is of a search of one key"),
        (["--within", "12"], "within 12: must be above 0"),
        (["--resume"], "resume: give the folder of the search with out"),
    ],
)
def test_wrong_options_are_one_line(hexjet: Hexjet, more: list[str], words: str) -> None:
    answer = hexjet("search", *SEARCH, *more)
    assert answer.status == 2
    assert words in answer.err
    assert answer.err.count("\n") == 1


def test_within_goes_with_a_search_of_all_keys(hexjet: Hexjet) -> None:
    answer = hexjet("search", "hover", "--vary", "mismatch.delay_samples=0:9", "--within", "3")
    assert (answer.status, "within: goes with worst or likely" in answer.err) == (2, True)


def test_of_a_design_it_is_the_box_of_its_tolerances(hexjet: Hexjet, tmp_path: Path) -> None:
    answer = hexjet(
        "search", str(DESIGNS / "edf.toml"), "--worst", "--budget", "2", "--workers", "1", "--json", "--out",
        str(tmp_path / "box"),
    )  # fmt: skip
    assert answer.status == 0
    result = json.loads(answer.out)
    assert result["within"] == "ranges"
    assert [text.partition("=")[0] for text in result["vary"]] == ["mismatch.inertia_factor", "mismatch.delay_samples"]
    assert result["success"].keys() == {"roll.overshoot_percent", "roll.oscillation_rad"}


@pytest.mark.long
def test_a_law_that_breaks_in_a_corner_of_six_keys_is_found_in_flight(tmp_path: Path) -> None:
    """No key alone and no pair shows it, nor do 2,000 draws; the search does, within 300 flights."""
    (tmp_path / "law.py").write_text(PLANTED)
    study, asked = resolve_worst(
        "roll-doublet", vary=[f"{key}=0:1" for key in KEYS], controllers=[f"{tmp_path / 'law.py'}:Planted"],
        settings=["engine='edf'", "command.0.start_s=0.1", "duration_s=0.9"],
        success=["roll.overshoot_percent<=500"], within="5", budget=300,
    )  # fmt: skip
    with LocalWorkers(2) as workers:
        prober = Prober(study, (1,))

        def breaks(points: list[Point]) -> bool:
            return any(answer_all(prober.evaluate(points), partial(workers.fly, study)))

        controller, middle = study.controller_names[0], dict.fromkeys(KEYS, 0.5)
        pairs = [
            Point.of(controller, middle | dict(zip(pair, ends, strict=True)))
            for pair in combinations(KEYS, 2) for ends in product((0.0, 1.0), repeat=2)
        ]  # fmt: skip
        singles = [Point.of(controller, middle | {key: end}) for key in KEYS for end in (0.0, 1.0)]
        assert not breaks([*singles, *pairs])
        safe = 2.0 * 0.7 ** (1.0 / 6.0) - 1.0  # six of it have a product of 0.7 in the law, and keep
        assert not breaks([Point.of(controller, dict.fromkeys(KEYS, safe))])
        counted = [
            prod(0.5 + 0.5 * float(draw.values[key]) for key in KEYS) for draw in Draws(study.changed(runs=2000))
        ]
        assert len(counted) == 2000
        assert max(counted) < 0.7
        saved = run_worst(study, asked, tmp_path / "worst", workers)
    (found,), (case,) = saved.result.cases, saved.cases
    assert found.fails
    assert found.flights <= 300
    assert all(effect.alone is not None and effect.alone > 0.0 for effect in found.effects)
    assert case.same
