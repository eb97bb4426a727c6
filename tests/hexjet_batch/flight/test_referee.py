"""JSBSim finds what differs between flights on arrays and its own, and the campaign says so and counts it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from campaign_tools import Here

import hexjet_batch.campaign as on_arrays
from cosim.api.studies import SweepResult
from cosim.campaign import Campaign, fly_again, open_study, run_campaign
from cosim.campaign.analysis.page import make_page
from cosim.campaign.analysis.statistics import widen
from cosim.campaign.study.keys import with_values
from cosim.campaign.workers.flight_row import Row
from cosim.spec.scenario import Scenario
from hexjet_batch.referee import rates

pytestmark = pytest.mark.flight


def fly(folder: Path, runs: int = 12, **options: Any) -> Campaign:
    """Doublets in roll whose throttle is limited, of vehicles that differ."""
    settings = ["duration_s=4", "command.0.start_s=0.2", "command.0.width_s=0.7", "command.0.amplitude=20",
                "vehicle.control.allocation.throttle_max=0.55", "limits.settling_s=false"]  # fmt: skip
    given = {"vary": ["mismatch.thrust_factor=0.95:1.05"], "runs": runs, "settings": settings, "controllers": ["smith"]}
    flown = open_study("roll-doublet", **given | {"batch": True} | options)
    return run_campaign(flown, folder, Here())  # type: ignore[arg-type]


def shifted(**values: Callable[[Scenario], Any]) -> Any:
    """What flies a batch of scenarios in which these keys are otherwise."""
    fly_groups = on_arrays.fly_groups

    def fly(scenarios: list[Scenario], *memory: Any, **options: Any) -> Any:
        changed = ({key.replace("__", "."): value(each) for key, value in values.items()} for each in scenarios)
        return fly_groups([with_values(*both) for both in zip(scenarios, changed, strict=True)], *memory, **options)

    return fly


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return fly(tmp_path_factory.mktemp("honest") / "c")


def test_an_honest_batch_is_confirmed_and_said_to_be(honest: Campaign) -> None:
    assert honest.columns["by"] == ["batch"] * 12
    assert honest.referee["confirmed"]
    said = "JSBSim flew 11 of 12 flights again, the 10 nearest to a limit and 1 at random: every verdict"
    assert SweepResult(honest, honest.folder).lines()[2].startswith(said)


PLANTED = {
    "drag 10 % off": shifted(**{
        f"vehicle__aero__drag_area_m2__{i}": lambda scenario, i=i: 1.1 * scenario.resolved_vehicle()[0].aero.drag_area_m2[i]
        for i in range(3)
    }),
    "a delay one step off": shifted(mismatch__delay_samples=lambda scenario: 1),
    "noise from another seed": shifted(seed=lambda scenario: scenario.seed + 1),
    "an allocation limit left out": shifted(vehicle__control__allocation__throttle_max=lambda scenario: 1.0),
}  # fmt: skip


@pytest.mark.parametrize("planted", PLANTED.values(), ids=PLANTED)
def test_a_planted_difference_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, planted: Any) -> None:
    monkeypatch.setattr(on_arrays, "fly_groups", planted)
    flown = fly(tmp_path / "c")
    assert not flown.referee["confirmed"]
    assert SweepResult(flown, flown.folder).lines()[0].startswith("JSBSim does not fly the same flights")


def test_a_verdict_that_differs_is_line_one_and_counted(
    honest: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step of delay more overshoots by 3 % of the step more: what fails on arrays succeeds by JSBSim, whose verdict counts."""
    monkeypatch.setattr(on_arrays, "fly_groups", PLANTED["a delay one step off"])
    most = max(float(value or 0.0) for value in honest.columns["roll.overshoot_percent"])
    flown = fly(tmp_path / "c", success=[f"roll.overshoot_percent<={most + 0.1}"])
    numbers = [int(number) for number in flown.referee["success"]]
    assert numbers
    assert all(flown.columns["success"][number] for number in numbers)
    said = f"JSBSim does not confirm this: {len(numbers)} verdicts differ; the shares and intervals count it"
    assert SweepResult(flown, flown.folder).lines()[0] == said
    make_page(flown).write(tmp_path / "page.html")
    assert "Verdicts that differ" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_what_differs_at_random_widens_the_interval() -> None:
    """1 of 20 that differ may be 24.9 % of the others by Clopper and Pearson: the upper end of 95 %."""
    rows: dict[int, Row] = {number: {"success": True} for number in range(20)}
    again: dict[int, Row] = rows | {7: {"success": False}}
    down, up = rates(list(rows), rows, again)
    assert down == pytest.approx(0.2487, abs=1e-4)
    assert up == 0.0
    assert widen((0.1, 0.99), down, up) == (0.0, 0.99)


def test_a_flight_flown_again_has_its_verdict_compared(honest: Campaign) -> None:
    again = fly_again(honest, 3)
    assert (again.same, again.verdict) == (True, "the same verdict by JSBSim")
