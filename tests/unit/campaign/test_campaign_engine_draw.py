"""An engine drawn by its own uncertainty: moments and correlation of a seeded ensemble against exact values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT
from scipy import stats
from uncertain_engines import CORRELATION, NOMINAL, fan

from cosim.base.errors import InputError
from cosim.campaign.study.draws import Draws, flight_seed
from cosim.campaign.study.engine_draw import engine_draw
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import flights, scenario_of
from cosim.campaign.study.study import Study
from hexjet_prove.search.folder import resolve_search
from hexjet_prove.search.probe import Prober

DEVIATION, SPREAD = [1.2, 0.006, 0.02], [0.0, 0.002, 0.01]
RUNS = 6000
CUT = float(stats.truncnorm(-3.0, 3.0).std())  # 0.9866: what is left of a deviation that is cut off at 3 of it
COMMON, STATION = "mismatch.engine_parameters.", "mismatch.stations."


def study(file: Path, runs: int | None = RUNS, **options: Any) -> Study:
    settings = [f"engine={file}", "controller=baseline", *options.pop("settings", [])]
    return open_study("roll-doublet", **({"vary": ["engine"], "settings": settings, "runs": runs} | options))


def columns(made: Study) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    drawn = Draws(made)[:]
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
    for name, values in ((name, [draw.values[name] for draw in Draws(wide)]) for name in wide.drawn):
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
    assert Draws(short)[1200] == Draws(long)[1200]
    assert Draws(long)[3] == Draws(study(file, 2000, design="random"))[3]
    assert Draws(long)[3] != Draws(study(file, 2000, design="random", seed=2))[3]


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
    message = r"s\.toml: vary = .vehicle\.mass_kg.: vehicle\.mass_kg: write it as KEY=LO:HI"
    with pytest.raises(InputError, match=message):
        Study.from_table(table | {"vary": "vehicle.mass_kg"}, tmp_path, "s.toml")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"settings": ["engine=edf"]}, "edf has no .uncertainty. in a mapping file; hexjet engine from-bench writes"),
        ({"vary": ["engine", f"{COMMON}gain=0.2:0.3"]}, "gain: engine draws it by its .uncertainty. already"),
        ({"vary": ["engine", "stations.1.engine=edf,motor"]}, "brings another engine than the one that is drawn"),
        ({"design": "grid", "runs": None}, "engine needs levels or values in a grid, such as engine=A,B"),
        ({"vary": ["engine", "vehicle.mass_kg=5:6"], "correlate": ["engine,vehicle.mass_kg=0.5"]}, "have no order"),
        ({"vary": ["engine", "engine"]}, "engine: is there twice"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as complaint:
        study(fan(tmp_path, DEVIATION, SPREAD), **({"runs": 4} | options))
    assert len(str(complaint.value).splitlines()) == 1


def test_a_search_does_not_draw(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is drawn with seeds N, or by hexjet sweep"):
        resolve_search("hover", vary=["engine"], settings=[f"engine={fan(tmp_path, DEVIATION)}"])


def keys(made: Study) -> list[str]:
    return [vary.key for vary in made.vary]


def test_an_uncertain_engine_is_drawn_by_default_and_said_so(tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION, SPREAD)
    mass = ["vehicle.mass_kg=5:6"]
    by_default = study(file, 5, vary=mass)
    assert keys(by_default) == ["vehicle.mass_kg", "engine"]
    assert by_default.notes()[-1] == (
        "the engine of each flight is drawn by the engine's [uncertainty] (delay_samples, pole, gain, each engine by "
        "itself too; source: bench.csv: 6 steps, 2 holds); nominal_engine flies it as it is stated"
    )
    assert [draw.values for draw in Draws(by_default)] == [draw.values for draw in Draws(study(file, 5, vary=mass))]
    nominal = study(file, 5, vary=mass, nominal_engine=True)
    assert keys(nominal) == ["vehicle.mass_kg"]
    assert "flies as it is stated" in nominal.notes()[-1]
    assert Study.from_table(nominal.table(), Path(), "again").nominal_engine
    assert keys(study(file, 5, vary=[])) == ["engine"]


def test_what_is_stated_is_not_drawn_over(tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION, SPREAD)
    pole = study(file, 5, vary=[f"{COMMON}pole=0.85:0.9"])
    assert keys(pole) == [f"{COMMON}pole"]
    assert pole.notes()[-1].endswith(f": {COMMON}pole is varied")
    assert keys(study(file, None, vary=["engine=turbojet,edf"], settings=["controller=baseline"])) == ["engine"]
    library = open_study("roll-doublet", vary=["vehicle.mass_kg=5:6"], runs=2)  # whose engine has no table
    assert keys(library) == ["vehicle.mass_kg"]
    assert not library.notes()


def test_an_uncertain_engine_of_a_single_station_is_not_drawn_and_that_is_said(tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION, SPREAD)
    station, mass = f"stations.3.engine={file}", ["vehicle.mass_kg=5:6"]
    said = f"[uncertainty] of engines at single stations is not drawn (3: {file})"
    alone = open_study("roll-doublet", vary=mass, settings=[station, "controller=baseline"], runs=2)
    assert (keys(alone), alone.notes()[-1]) == (["vehicle.mass_kg"], said)
    beside = study(file, 2, settings=[station])
    assert beside.notes()[-1].endswith(f"as it is stated; {said}")
    assert not [name for name in beside.drawn if name.startswith(f"{STATION}3.")]


def test_the_file_of_a_vehicles_own_station_is_relative_to_the_vehicle(tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION)
    text = (ROOT / "aircraft" / "trijet" / "vehicle.toml").read_text(encoding="utf-8")
    text = text.replace('"edf-as-flown"', f'"{file.name}"').replace('name = "trijet"', 'name = "mine"')
    (tmp_path / "vehicle.toml").write_text(text, encoding="utf-8")
    own = [f"aircraft={tmp_path}", "controller=baseline"]
    found = open_study("trijet-hover", vary=["vehicle.mass_kg=5:6"], settings=own, runs=2)
    assert found.notes()[-1] == f"[uncertainty] of engines at single stations is not drawn (3: {file})"


def test_each_point_of_a_grid_has_an_engine_of_its_own(tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION, SPREAD)
    grid = study(file, None, vary=["vehicle.mass_kg=5,6"], repeats=3)
    assert (grid.design, grid.draws) == ("grid", 6)
    drawn = columns(grid)
    assert drawn["vehicle.mass_kg"].tolist() == [5.0, 6.0] * 3
    assert len(set(drawn[f"{COMMON}gain"])) == 6
    nominal = columns(study(file, None, vary=["vehicle.mass_kg=5,6"], repeats=3, nominal_engine=True))
    assert drawn["vehicle.mass_kg"].tolist() == nominal["vehicle.mass_kg"].tolist()
    assert [draw.seed for draw in Draws(grid)] == [flight_seed(1, number) for number in range(6)]


def test_a_search_draws_in_all_flights_of_a_point_but_the_first(tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION, SPREAD)
    options: dict[str, Any] = {"settings": [f"engine={file}", "controller=baseline"], "seed": 5}
    searched, plan = resolve_search("roll-doublet", vary=["mismatch.mass_factor=0.8:1.2"], seeds=3, **options)
    assert plan.draws_engine
    prober = Prober(searched, plan.seeds, engine=engine_draw(searched.base()))
    point = plan.point("baseline", {})
    flown = [prober.flight(point, seed).values for seed in plan.seeds]
    assert list(flown[0]) == ["mismatch.mass_factor"]
    gains = [values[f"{COMMON}gain"] for values in flown[1:]]
    assert len(set(gains)) == 2
    assert [prober.flight(point, seed).values for seed in plan.seeds] == flown
    for more in ({"nominal_engine": True}, {"seeds": 1}):
        assert not resolve_search(
            "roll-doublet", vary=["mismatch.mass_factor=0.8:1.2"], **({"seeds": 3} | options | more)
        )[1].draws_engine


def test_a_named_draw_is_the_same_everywhere(tmp_path: Path) -> None:
    draw = engine_draw(study(fan(tmp_path, DEVIATION, SPREAD), 2).base())
    assert draw.draw_by_name("flame-out jet 1 hover") == draw.draw_by_name("flame-out jet 1 hover")
    values = np.array([draw.draw_by_name(str(number))[f"{COMMON}gain"] for number in range(2000)])
    assert np.mean(values) == pytest.approx(NOMINAL["gain"], abs=4.0 * 0.02 / np.sqrt(2000))
    assert np.std(values) == pytest.approx(CUT * 0.02, rel=4.0 / np.sqrt(4000))
