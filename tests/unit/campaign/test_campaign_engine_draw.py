"""An engine drawn by its own uncertainty: moments and correlation of a seeded ensemble against exact values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from uncertain_engines import CORRELATION, NOMINAL, fan

from cosim.base.errors import InputError
from cosim.campaign.search.folder import resolve_search
from cosim.campaign.study.draws import draws
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import flights, scenario_of
from cosim.campaign.study.study import Study

DEVIATION, SPREAD = [1.2, 0.006, 0.02], [0.0, 0.002, 0.01]
RUNS = 6000
CUT = float(stats.truncnorm(-3.0, 3.0).std())  # 0.9866: what is left of a deviation that is cut off at 3 of it
COMMON, STATION = "mismatch.engine_parameters.", "mismatch.stations."


def study(file: Path, runs: int = RUNS, **options: Any) -> Study:
    settings = [f"engine={file}", "controller=baseline", *options.pop("settings", [])]
    return open_study("roll-doublet", **({"vary": ["engine"], "settings": settings, "runs": runs} | options))


def columns(made: Study) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    drawn = draws(made)[:]
    return {name: np.array([draw.values[name] for draw in drawn], dtype=float) for name in made.drawn}


@pytest.mark.parametrize("design", ["random", "latin-hypercube", "sobol"])
@pytest.mark.filterwarnings("ignore:The balance properties")
def test_mean_deviation_and_correlation_are_those_of_the_table(tmp_path: Path, design: str) -> None:
    drawn = columns(study(fan(tmp_path, DEVIATION, SPREAD), design=design))
    common = {name: drawn[COMMON + name] for name in NOMINAL}
    for (name, nominal), deviation in zip(NOMINAL.items(), DEVIATION, strict=True):
        # rounding to whole samples adds 1/12 to the variance (W. F. Sheppard, 1898)
        exact = np.sqrt((CUT * deviation) ** 2 + (1.0 / 12.0 if name == "delay_samples" else 0.0))
        assert np.mean(common[name]) == pytest.approx(nominal, abs=4.0 * exact / np.sqrt(RUNS))
        assert np.std(common[name]) == pytest.approx(exact, rel=4.0 / np.sqrt(2.0 * RUNS))
    # of a Gaussian copula Spearman's is 6/pi asin(r/2), whatever is cut off (K. Pearson, 1907); 4 deviations of chance
    for a, b in ((1, 2), (0, 1), (0, 2)):
        rank = stats.spearmanr(*(common[list(NOMINAL)[k]] for k in (a, b))).statistic
        exact = 6.0 / np.pi * np.arcsin(0.5 * CORRELATION[a][b])
        assert rank == pytest.approx(
            exact, abs=4.0 / np.sqrt(RUNS) + (0.03 if a == 0 else 0.0)
        )  # ties of whole numbers


def test_engines_share_one_draw_and_add_one_of_their_own(tmp_path: Path) -> None:
    drawn = columns(study(fan(tmp_path, DEVIATION, SPREAD), design="random"))
    assert not [name for name in drawn if name.startswith(STATION) and name.endswith("delay_samples")]  # no spread
    own = np.array([drawn[f"{STATION}{number}.gain"] for number in range(1, 7)])
    beside = own - drawn[f"{COMMON}gain"]
    assert np.std(beside, axis=1) == pytest.approx(CUT * 0.01, rel=4.0 / np.sqrt(2.0 * RUNS))
    assert np.mean(beside, axis=1) == pytest.approx(0.0, abs=4.0 * 0.01 / np.sqrt(RUNS))
    assert np.max(np.abs(beside)) <= 3.0 * 0.01 + 1e-12
    # each by itself, and both together: r = deviation^2 / (deviation^2 + spread^2)
    assert np.corrcoef(beside)[np.triu_indices(6, 1)] == pytest.approx(0.0, abs=4.0 / np.sqrt(RUNS))
    assert np.corrcoef(own)[np.triu_indices(6, 1)] == pytest.approx(0.02**2 / (0.02**2 + 0.01**2), abs=0.015)


def test_whole_numbers_and_limits_are_kept(tmp_path: Path) -> None:
    wide = study(fan(tmp_path, [15.0, 0.2, 0.2], [15.0, 0.2, 0.2]), design="random", runs=3000)
    for name, values in ((name, [draw.values[name] for draw in draws(wide)]) for name in wide.drawn):
        if name.endswith("delay_samples"):
            assert {type(value) for value in values} == {int}
            assert min(values) == 0
        elif name.endswith("pole"):
            assert 0.0 <= min(values) < 0.5
            assert 0.99 < max(values) <= 0.999999
        else:
            assert min(values) >= 0.0
    gains = columns(wide)[f"{COMMON}gain"]
    exact = stats.truncnorm(-NOMINAL["gain"] / 0.2, 3.0, loc=NOMINAL["gain"], scale=0.2)
    assert np.mean(gains) == pytest.approx(exact.mean(), abs=4.0 * exact.std() / np.sqrt(3000))
    assert np.std(gains) == pytest.approx(exact.std(), rel=4.0 / np.sqrt(2.0 * 3000))
    narrow = columns(study(fan(tmp_path, DEVIATION), design="random"))
    assert max(np.abs(narrow[f"{COMMON}pole"] - NOMINAL["pole"])) <= 3.0 * 0.006
    assert list(narrow) == [COMMON + name for name in NOMINAL]  # without spread there is nothing of single stations


def test_draws_come_from_the_seed_alone(tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION, SPREAD)
    long, short = study(file, 2000, design="random"), study(file, 1500, design="random")
    assert draws(short)[1200] == draws(long)[1200]
    assert draws(long)[3] == draws(study(file, 2000, design="random"))[3]
    assert draws(long)[3] != draws(study(file, 2000, design="random", seed=2))[3]


def test_a_station_is_drawn_about_what_it_states(tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION)
    made = study(file, 500, settings=["stations.2.parameters.gain=0.3", "stations.3.engine=edf"], design="random")
    assert [name for name in made.drawn if name.startswith(STATION)] == ["mismatch.stations.2.gain"]
    drawn = columns(made)
    apart = drawn["mismatch.stations.2.gain"] - drawn[f"{COMMON}gain"]
    assert apart == pytest.approx(0.3 - 0.2554)
    spread = study(fan(tmp_path, DEVIATION, SPREAD), 5, settings=["stations.3.engine=edf"])
    assert not [name for name in spread.drawn if name.startswith("mismatch.stations.3")]  # another engine's


def test_what_is_drawn_flies_and_is_not_believed(tmp_path: Path) -> None:
    made = study(fan(tmp_path, DEVIATION, SPREAD), 3)
    scenario = scenario_of(made, flights(made)[1])
    values = flights(made)[1].values
    assert scenario.mismatch.engine_parameters["gain"] == values[f"{COMMON}gain"]
    assert scenario.mismatch.stations["4"]["pole"] == values["mismatch.stations.4.pole"]
    assert not scenario.engine_parameters


@pytest.mark.parametrize("vary", ["engine", ["engine"], [{"key": "engine"}], [{"key": "engine", "uncertainty": True}]])
def test_a_file_says_it_in_any_of_these_ways(tmp_path: Path, vary: Any) -> None:
    settings = {"engine": str(fan(tmp_path, DEVIATION)), "controller": "baseline"}
    table = {"name": "s", "scenario": "hover", "design": "random", "runs": 2, "vary": vary, "settings": settings}
    made = Study.from_table(table, tmp_path, "s.toml")
    assert made.table()["vary"] == [{"key": "engine", "uncertainty": True}]
    assert [each.text for each in made.vary] == ["engine"]


def test_texts_of_a_file_are_those_of_the_command_line(tmp_path: Path) -> None:
    table = {"name": "s", "scenario": "hover", "design": "random", "runs": 2, "vary": ["vehicle.mass_kg=5:6"]}
    assert Study.from_table(table, tmp_path, "s.toml").vary[0].range == (5.0, 6.0)
    with pytest.raises(
        InputError, match=r"s\.toml: vary = .vehicle\.mass_kg.: vehicle\.mass_kg: write it as KEY=LO:HI"
    ):
        Study.from_table(table | {"vary": "vehicle.mass_kg"}, tmp_path, "s.toml")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"settings": ["engine=edf"]}, "edf has no .uncertainty. in a mapping file; hexjet identify bench writes one"),
        ({"vary": ["engine", f"{COMMON}gain=0.2:0.3"]}, "gain: engine draws it by its .uncertainty. already"),
        ({"vary": ["engine", "stations.1.engine=edf,motor"]}, "brings another engine than the one that is drawn"),
        ({"design": "grid", "runs": None}, "engine needs levels or values in a grid, such as engine=A,B"),
        ({"vary": ["engine", "vehicle.mass_kg=5:6"], "correlate": ["engine,vehicle.mass_kg=0.5"]}, "have no order"),
        ({"vary": ["engine", "engine"]}, "engine: is there twice"),
        ({"vary": ["engine*=0.9:1.1"]}, "engine is one of"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as complaint:
        study(fan(tmp_path, DEVIATION, SPREAD), **({"runs": 4} | options))
    assert len(str(complaint.value).splitlines()) == 1


def test_a_search_does_not_draw(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is drawn, hexjet sweep does"):
        resolve_search("hover", vary=["engine"], settings=[f"engine={fan(tmp_path, DEVIATION)}"])
