"""Campaigns on arrays: their rows are those of JSBSim's flights, however they are cut into chunks, and whoever flies them."""

from __future__ import annotations

from math import radians
from pathlib import Path
from typing import Any

import pytest
from campaign_tools import Here, without_chance

from cosim import InputError, Scenario
from cosim.campaign import open_study, run_campaign
from cosim.campaign.analysis.statistics import proportion
from cosim.campaign.run import extend_campaign
from cosim.campaign.study.plan import flights
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Row, fly_one
from cosim.results.metrics import flatten, flight_metrics
from hexjet_batch.campaign import BatchWorkers, _measure, _reach
from hexjet_batch.fly import fly_groups
from hexjet_prove.rare.estimate import Budget
from hexjet_prove.rare.folder import run_rare
from hexjet_prove.rare.simulation import Plan

pytestmark = pytest.mark.flight


def study(**options: Any) -> Study:
    """Three draws of a hover, each with and without a predictor."""
    given = {"vary": ["vehicle.mass_kg=5.4:5.8"], "runs": 3, "controllers": ["smith", "baseline"], "batch": True}
    return open_study("hover", **({"settings": ["duration_s=0.2"]} | given | options))


def rows(flown: Study, together: int | None = None, *loses: int) -> dict[int, Row]:
    found = BatchWorkers(Here(*loses), together).fly(flown, flights(flown))  # type: ignore[arg-type]
    return {int(row["flight"] or 0): without_chance(row) for row in found}


def test_rows_are_those_of_jsbsim_and_of_any_chunk() -> None:
    """JSBSim runs four times a step: metrics are the same to a thousandth, or 1e-5 of their unit."""
    flown = study()
    found, again = rows(flown), rows(flown, 1)
    for number, flight in enumerate(flights(flown)):
        own = without_chance(fly_one(flown.changed(batch=False), flight))
        assert found[number]["by"] == "batch"
        assert {name for name in own if (own[name] is None) != (found[number][name] is None)} == {"log_sha256"}
        for name, value in own.items():
            if isinstance(value, float):
                assert found[number][name] == pytest.approx(value, rel=1e-3, abs=1e-5), name
                assert again[number][name] == found[number][name], name
            elif name in ("outcome", "success", "reason", "beyond", "decided_by", "steps", "controller", "seed"):
                assert found[number][name] == again[number][name] == value, name


def test_the_metrics_of_many_are_those_of_each_bit_for_bit() -> None:
    base = Scenario.load("roll-doublet", ["duration_s=2.2"]).replace(expect=[])
    (group,) = fly_groups([base.replace(seed=seed, vehicle={"mass_kg": 5.0 + 0.1 * seed}) for seed in range(3)])
    for i, found in _measure(group):
        assert found == flatten(flight_metrics(group.flight(i).log, base.step_s, _reach(group.n, i)))


def test_what_a_batch_does_not_fly_is_flown_by_jsbsim() -> None:
    """A chunk that is lost, and a flight near the ground; a draw that nothing flies says so, and fails as ever."""
    first = {number: row["by"] for number, row in rows(study(), 2, 0).items()}
    assert first == {n: "jsbsim" if n < 2 else "batch" for n in range(6)}
    low = study(vary=["initial.altitude_m=0.6,10,10.5"], runs=None, controllers=["smith"])
    assert [row["by"] for _, row in sorted(rows(low).items())] == ["jsbsim", "batch", "batch"]
    heavy = study(vary=["vehicle.mass_kg=5.4,50"], runs=None, controllers=["smith"])
    light, lost = (row for _, row in sorted(rows(heavy).items()))
    assert (light["outcome"], lost["outcome"]) == ("completed", "failed")
    assert "would hover at" in str(lost["reason"])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"settings": ["environment.turbulence_severity=3"]}, "turbulence"),
        ({"settings": ["require=[{name='t', formula='always(thrust_1_N < 99)'}]"]}, "does not record thrust_1_N"),
    ],
)
def test_a_study_that_is_not_covered_is_refused_by_name(tmp_path: Path, changes: Any, named: str) -> None:
    with pytest.raises(InputError, match=named):
        run_campaign(study(**changes), tmp_path / "c", Here())  # type: ignore[arg-type]
    assert not (tmp_path / "c").exists()
    with pytest.raises(InputError, match="together = 0: at least 1 flight"):
        BatchWorkers(Here(), 0)  # type: ignore[arg-type]


@pytest.mark.process
def test_processes_resume_and_the_folder_says_how_it_flies(tmp_path: Path) -> None:
    """Two processes of this machine; what goes on with the folder flies on arrays too, and asks JSBSim again."""
    first = run_campaign(study(design="random"), tmp_path / "c", 2)
    assert first.referee["flights"] == len(first) == 6
    assert first.referee["confirmed"]  # of micrometres that differ nothing is said
    extend_campaign(tmp_path / "c", runs=4)
    longer = run_campaign(None, tmp_path / "c", 1, resume=True)
    assert (longer.columns["by"], longer.referee["flights"]) == (["batch"] * 8, 8)


@pytest.mark.parametrize(
    ("limit_deg", "share", "runs"), [(2.0, 0.0455, 300), pytest.param(3.890592, 1e-4, 40_000, marks=pytest.mark.long)]
)
def test_a_known_truth_is_counted_and_estimated(limit_deg: float, share: float, runs: int, tmp_path: Path) -> None:
    """A start that leans by N(0, 1) deg is off by its size.  The intervals of counting and of subset simulation hold."""
    leans = study(
        vary=["initial.attitude_deg.0=normal(0,1)"], runs=runs, design="random", controllers=["smith"],
        settings=["duration_s=0.1"], success=[f"roll.max_abs_error_rad<={radians(limit_deg)}"],
    )  # fmt: skip
    found = rows(leans)
    low, high = proportion(sum(not row["success"] for row in found.values()), len(found)).exact
    plan = Plan(Budget(share / 10.0, min(3 * runs, 3000), repeats=4), seeds_vary=False)
    estimate = run_rare(leans, plan, tmp_path / "rare", Here()).result.estimate  # type: ignore[arg-type]
    assert max(low, estimate.low) < share < min(high, estimate.high)
