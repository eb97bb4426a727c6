"""A campaign that stops by its rule: the same rows and the same verdict, however and wherever it is flown."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import campaign_tools as tools
import pytest
from campaign_tools import light, without_chance
from command_tools import Hexjet

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml
from cosim.campaign import Campaign, open_campaign, run_campaign
from cosim.campaign.analysis.claim import ClaimResult, judge_claim
from cosim.campaign.analysis.page import write_campaign_report
from cosim.campaign.analysis.summary import campaign_summary
from cosim.campaign.folder import STUDY
from cosim.campaign.run import extend_campaign
from cosim.campaign.study.plan import Flight, flights
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Row
from cosim.campaign.workers.local import LocalWorkers


def known(claim: str = "90%@95%", **options: Any) -> Study:
    """A study in which 95 of 100 flights succeed: a threshold on one key that is drawn evenly."""
    given = {"vary": ["vehicle.mass_kg=5.4:5.8"], "controllers": ["smith"], "runs": None, "until": claim}
    return tools.study(**(given | options))


class Reversed:
    """Workers that finish sixteen flights at a time in another order, and stop after so many."""

    def __init__(self, most: int | None = None) -> None:
        self.most = most

    def fly(self, study: Study, planned: Iterable[Flight]) -> Iterator[Row]:
        waiting = islice(planned, self.most)
        while batch := list(islice(waiting, 16)):
            yield from (light(study, flight) for flight in reversed(batch))


def rows(campaign: Campaign) -> list[Row]:
    return [without_chance(campaign.row(int(number or 0))) for number in campaign.columns["flight"]]


def run(study: Study | None, folder: Path, most: int | None = None) -> Campaign:
    """The study in another order, or what is left of a campaign."""
    return run_campaign(study, folder, Reversed(most), resume=study is None)  # type: ignore[arg-type]


def verdict(campaign: Campaign) -> ClaimResult:
    judged = judge_claim(campaign)
    assert judged is not None
    return judged


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """The study, one flight after the other."""
    with LocalWorkers(1, fly=light) as workers:
        return run_campaign(known(), tmp_path_factory.mktemp("until") / "c", workers)


def test_it_stops_at_the_first_flight_that_decides(flown: Campaign) -> None:
    result = verdict(flown)
    smith = result.verdicts["smith"]
    assert result.is_finished
    assert len(flown) == smith.flights < flown.of == 290
    assert (smith.decision, smith.bound, smith.failures) == ("shown", 0.9, flown.columns["success"].count(False))


def test_two_workers_and_another_order_leave_the_same_rows(flown: Campaign, tmp_path: Path) -> None:
    with LocalWorkers(2, fly=light) as workers:
        assert rows(run_campaign(known(), tmp_path / "two", workers)) == rows(flown)
    turned = run(known(), tmp_path / "turned")
    assert (rows(turned), verdict(turned)) == (rows(flown), verdict(flown))


def test_stopped_and_resumed_it_comes_to_the_same(flown: Campaign, tmp_path: Path) -> None:
    first = run(known(), tmp_path / "c", 20)
    assert len(first) < len(flown)
    assert not verdict(first).is_finished
    assert campaign_summary(first)["finished"] is False
    for _ in range(2):  # decided the first time: nothing more is flown
        assert rows(run(None, tmp_path / "c")) == rows(flown)


def test_a_campaign_without_a_rule_goes_on_with_one(flown: Campaign, tmp_path: Path, hexjet: Hexjet) -> None:
    run(tools.study(runs=10, vary=["vehicle.mass_kg=5.4:5.8"], controllers=["smith"], design="random"), tmp_path / "c")
    refused = hexjet(*["sweep", "c", "--resume", "--until", "99.9%@95%", "--runs", "20"]).refusal
    assert "20 flights do not show it" in refused
    assert read_toml(tmp_path / "c" / STUDY).get("until") is None
    extend_campaign(tmp_path / "c", until="90%@95%")
    assert rows(run(None, tmp_path / "c")) == rows(flown)
    with pytest.raises(InputError, match="has 290 draws"):
        extend_campaign(tmp_path / "c", runs=100)


def test_a_claim_that_was_judged_by_all_draws_takes_no_more_of_them(tmp_path: Path) -> None:
    used_up = run(known("95%@95%", runs=60), tmp_path / "c")
    assert verdict(used_up).is_finished
    assert len(used_up) == 60
    with pytest.raises(InputError, match="was judged by all of its 60 draws"):
        extend_campaign(tmp_path / "c", runs=300)


def test_what_is_printed_and_drawn_says_how_it_stopped(flown: Campaign) -> None:
    summary = json.loads(json.dumps(campaign_summary(flown)))
    assert summary["finished"] is True
    assert summary["until"]["tests"]["smith"]["decision"] == "shown"
    assert summary["controllers"]["smith"]["wilson_95"] is None  # that of a number fixed before does not hold
    page = write_campaign_report(flown).read_text()
    assert summary["until"]["says"][0] in page
    assert "is not finished" not in page


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"claim": "99.9%@95%", "runs": 100}, "100 flights do not show it, even if all succeed; that takes 2,995"),
        ({"design": "latin-hypercube", "runs": 300}, "counts independent draws; design must be random"),
        ({"claim": "99.9999%@95%", "runs": 3_000_000}, "at most 1,000,000 runs"),
        ({"claim": "nine of ten"}, "write it as"),
    ],
)
def test_a_claim_that_a_study_cannot_show_is_refused(options: dict[str, Any], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        known(**options)


def test_a_pair_needs_controllers_that_fly(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no controller 'baseline' flies here"):
        run_campaign(known("smith>baseline@95%"), tmp_path / "c", 1)
    assert not (tmp_path / "c").exists()


def test_real_flights_stop_too(hexjet: Hexjet) -> None:
    asked = "--set duration_s=0.1 --until 50%@90% --json --out c --workers 2"
    answer = hexjet("sweep", "hover", "--vary", "vehicle.mass_kg=5.4:5.8", *asked.split())
    assert json.loads(answer.out)["flights"] == 5  # 0.5^5 < 0.05 < 0.5^4
    made = open_campaign("c")
    assert len(made) == 5
    assert [flight.number for flight in flights(made.study)][:3] == [0, 1, 2]
