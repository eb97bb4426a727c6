"""What a study says, from a file and from a command line; and everything that is wrong with one, in one line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.api.listing import catalogue
from cosim.base.errors import InputError
from cosim.campaign.study.distributions import LogNormal, Normal, Triangular, Vary, parse_vary
from cosim.campaign.study.options import open_study, parse_correlate, parse_success
from cosim.campaign.study.plan import flights
from cosim.campaign.study.study import Study, study_names
from cosim.campaign.workers.flight_row import fly_one
from cosim.spec.scenario import Range, Scenario, scenario_names

MASS, GAIN = "vehicle.mass_kg", "engine_parameters.gain"


@pytest.mark.parametrize(
    ("text", "table"),
    [
        ("a.b=1:2", {"range": (1.0, 2.0)}),
        (" a.b = -1e-3 : 2.5 ", {"range": (-0.001, 2.5)}),
        ("a.b=1:2:5", {"range": (1.0, 2.0), "levels": 5}),
        ("a.b*=0.7:1.3", {"range": (0.7, 1.3), "relative": "factor"}),
        ("a.b+=-5:5", {"range": (-5.0, 5.0), "relative": "offset"}),
        ("a.b=log(0.1:10)", {"range": (0.1, 10.0), "scale": "log"}),
        ("a.b=log(0.1:10:3)", {"range": (0.1, 10.0), "scale": "log", "levels": 3}),
        ("a.b=1,2.5,-3", {"values": [1, 2.5, -3]}),
        ("a.b=true,false", {"values": [True, False]}),
        ("a.b=edf, edf-as-flown", {"values": ["edf", "edf-as-flown"]}),
        ("a.b=normal(1,0.5)", {"normal": Normal(mean=1.0, sd=0.5)}),
        ("a.b=normal(1, 0.5, 0, 2)", {"normal": Normal(mean=1.0, sd=0.5, min=0.0, max=2.0)}),
        ("a.b=normal(1,0.5,,2)", {"normal": Normal(mean=1.0, sd=0.5, max=2.0)}),
        ("a.b*=lognormal(1,0.2,0.5,)", {"lognormal": LogNormal(median=1.0, sigma=0.2, min=0.5), "relative": "factor"}),
        ("a.b=triangular(1,2,4)", {"triangular": Triangular(min=1.0, mode=2.0, max=4.0)}),
    ],
)
def test_a_text_says_what_varies(text: str, table: dict[str, Any]) -> None:
    assert parse_vary(text) == Vary(key="a.b", **table)


KEYS = st.from_regex(r"[a-z_]+(\.[a-z0-9_-]+)*", fullmatch=True)
NUMBER = st.floats(-1e9, 1e9)
SPAN = st.tuples(NUMBER, NUMBER).filter(lambda pair: pair[0] < pair[1])
WORD = st.from_regex(r"[a-zA-Z][a-zA-Z_-]*", fullmatch=True).filter(lambda w: w not in ("true", "false", "nan", "inf"))
FORM = st.one_of(
    st.builds(lambda span, levels: {"range": span, "levels": levels}, SPAN, st.none() | st.integers(2, 1000)),
    st.builds(
        lambda low, ratio: {"range": (low, low * ratio), "scale": "log"}, st.floats(1e-9, 1e9), st.floats(1.001, 1e9)
    ),
    st.one_of(
        *(st.lists(kind, min_size=2, max_size=5, unique=True) for kind in (NUMBER, st.integers(-(2**53), 2**53), WORD))
    ).map(lambda values: {"values": values}),
    st.builds(lambda span, sd: {"normal": {"mean": span[0], "sd": sd, "max": span[1]}}, SPAN, st.floats(1e-3, 1e3)),
    st.builds(lambda median, sigma: {"lognormal": {"median": median, "sigma": sigma}}, st.floats(1e-6, 1e6), st.floats(0.01, 5.0)),
    st.builds(lambda span: {"triangular": {"min": span[0], "mode": span[1], "max": span[1]}}, SPAN),
)  # fmt: skip


@settings(max_examples=60)
@given(KEYS, FORM, st.sampled_from(["", "factor", "offset"]))
def test_a_text_comes_back_from_what_it_says(key: str, form: dict[str, Any], relative: str) -> None:
    numbers = not any(isinstance(value, str) for value in form.get("values", []))
    vary = Vary.model_validate({"key": key, "relative": relative if numbers else "", **form})
    assert parse_vary(vary.text) == vary


def test_correlations_and_criteria_are_read() -> None:
    assert parse_correlate("a.b, c.d = -0.5").model_dump() == {"keys": ("a.b", "c.d"), "rank": -0.5}
    read = parse_success(["roll.rmse_rad<=0.1", "pitch.rmse_rad >= 0", "pitch.rmse_rad<=2"])
    assert read == {"roll.rmse_rad": Range(max=0.1), "pitch.rmse_rad": Range(min=0.0, max=2.0)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a", "vary a: write it as KEY=LO:HI, "),
        ("a=5", "one value does not vary; KEY=LO:HI or KEY=A,B do, or settings a=5"),
        ("a=5-6", "vary a=5-6: write the range as 5:6"),
        ("a=2:1", "a: 2 to 1 is empty; the lower bound comes first"),
        ("a=1:x", "'x' is not a number"),
        ("a=nan:2", "finite"),
        ("a=1:2:0", "levels = 0: should be greater than or equal to 2"),
        ("a=1:2:x", "'x' is no number of levels: a whole one from 2 on"),
        ("a=1,1.0", "a: 1 is there twice"),
        ("a=1,x", "values of different kinds: 1, x"),
        ("a=1,nan", "must be a finite number, true, false or a text"),
        ("a=1,[2]", "1,[2]: values.1"),
        ("a*=x,y", "a factor is a number, not x"),
        ("a=log(0:1)", "a logarithmic range needs bounds above 0, not 0"),
        ("a=norml(1,2)", "unknown distribution 'norml'; did you mean 'normal'? allowed: log, lognormal, normal, triang"),
        ("a=normal(1)", "normal takes mean, sd, min, max"),
        ("a=normal(1,0)", "normal.sd = 0.0: should be greater than 0"),
        ("a=normal(0,1,9,)", "9 to inf is too far out for this normal"),
        ("a=lognormal(1,0.1,0,4)", "a lognormal number is above 0, and so must be min"),
        ("a=triangular(1,5,4)", "min 1, mode 5, max 4: must grow in this order"),
    ],
)  # fmt: skip
def test_a_wrong_text_is_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_vary(text)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"vary {text}: ")


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (parse_correlate, "a=0.5", "write it as KEY,KEY=R"),
        (parse_correlate, "a,b=1", "rank = 1.0: should be less than 1"),
        (lambda text: parse_success([text]), "roll.rmse_rad=1", "write it as METRIC<=X or METRIC>=X"),
        (lambda text: parse_success([text]), "roll.rmse_rad<=inf", "must be finite"),
        (lambda text: parse_success([text, "m<=2"]), "m<=1", "there is one already"),
        (lambda text: parse_success([text, "m<=1"]), "m>=2", "nothing lies between 2 and 1"),
    ],
)
def test_wrong_correlations_and_criteria_are_refused_in_one_line(read: Any, text: str, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        read(text)


@pytest.mark.parametrize(
    ("vary", "options", "message"),
    [
        (["vehicle.mas_kg=1:2"], {}, "unknown key 'vehicle.mas_kg'; did you mean vehicle.mass_kg"),
        (["vehicle.control=1:2"], {}, "is not one value but several; below it: attitude, rate, "),
        ([f"{MASS}=-1:2"], {}, "vehicle.mass_kg would be -1 to 2, and must be a number above 0"),
        ([f"{MASS}=normal(5,1)"], {}, "must be a number above 0; state min and max, it is truncated there"),
        (["environment.wind_ned_m_s.0*=1:2"], {}, "is 0, and stays so times any factor; += adds to it"),
        (["monitor=1:2"], {}, "monitor is one of true or false; list values of them"),
        (["controller=smith,baseline"], {}, "controller: list controllers"),
        (["seed=1:5"], {}, "seed: every draw has a seed of its own"),
        (["duration_s=1:5"], {}, "duration_s: a row says under this name how long the flight lasted"),
        (["engine=edf,fde"], {}, "engine = fde: must be one of edf, "),
        (["sensor_noise=1,2"], {}, "sensor_noise = 1: must be true or false"),
        (["substeps=1,1.5"], {}, "substeps = 1.5: takes whole numbers"),
        (["substeps=1.2:1.9"], {}, "substeps takes whole numbers; 2 are needed, and here are 0"),
        ([f"{MASS}=1:2", f"{MASS}=1:3"], {}, "vehicle.mass_kg: is there twice"),
        ([f"{MASS}=1:2:3"], {}, "has 3 levels, which only a grid has; leave them out under design = 'latin-hypercube'"),
        ([f"{MASS}=1:2:3"], {"design": "grid"}, "runs: a grid has as many draws as it has points; repeats flies it more"),
        ([f"{MASS}=1:2:3", f"{GAIN}=1:2"], {"design": "grid", "runs": None}, f"{GAIN} needs levels or values in a grid, such"),
        ([f"{MASS}=1:2:3", f"{GAIN}=normal(1,2)"], {"design": "grid", "runs": None}, "distributions belong to latin-hypercube"),
        ([f"{MASS}=5:6:9999", f"{GAIN}=1:2:9999"], {"runs": None}, "a grid of 99980001 draws; at most 10000000"),
        ([f"{MASS}=1:2"], {"runs": None}, "runs is missing: how many draws the latin-hypercube has"),
        ([f"{MASS}=1:2"], {"repeats": 3}, "only a grid is repeated; a latin-hypercube has more runs instead"),
        ([f"{MASS}=1:2"], {"controllers": ["smth"]}, "unknown controller 'smth'; did you mean 'smith'?"),
        ([f"{MASS}=1:2"], {"controllers": ["smith", "smith"]}, "smith is there twice"),
        ([f"{MASS}=1:2"], {"success": ["roll.rmse<=1"]}, "success: unknown metric 'roll.rmse'; did you mean 'roll.rmse_rad', '"),
        ([f"{MASS}=1:2"], {"settings": ["durations=3"]}, "settings: unknown key 'durations'; did you mean 'duration_s', '"),
        ([f"{MASS}=1:2"], {"correlate": [f"{MASS},{GAIN}=0.5"]}, "'engine_parameters.gain' is not varied"),
        ([f"{MASS}=1:2", "engine=edf,motor"], {"correlate": [f"{MASS},engine=0.5"]}, "values of engine have no order"),
        ([f"{MASS}=1:2", f"{GAIN}=1:2"], {"correlate": [f"{MASS},{GAIN}=0.5"], "runs": 2}, "runs = 2: a latin-hypercube with these"),
        ([f"{MASS}=1,2", f"{GAIN}=1,2"], {"correlate": [f"{MASS},{GAIN}=0.5"], "runs": None}, "the points of a grid are not drawn"),
        (
            [f"{MASS}=1:2", f"{GAIN}=1:2", "substeps=1:9"],
            {"correlate": [f"{MASS},{GAIN}=0.9", f"{GAIN},substeps=0.9", f"{MASS},substeps=-0.9"]},
            "cannot hold together (the matrix is not positive definite",
        ),
        (["engine=edf,motor", f"{GAIN}*=0.9:1.1"], {}, "engine = edf: engine_parameters.gain belongs to edf-as-flown"),
        ([], {}, "nothing varies; vary KEY=LO:HI says what does"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_one_line(vary: list[str], options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        open_study("hover", vary=vary, **{"runs": 10, **options})


FILE = """
name = "mine"
scenario = "hover"
design = "latin-hypercube"
runs = 10
[[vary]]
key = "vehicle.mass_kg"
range = [5.0, 6.0]
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("runs = 10", "runs = = 10", "not valid TOML"),
        ("runs = 10", "rnus = 10", "unknown key 'rnus'; did you mean 'runs'?"),
        ("runs = 10", "runs = 2.5", "runs = 2.5: "),
        ('name = "mine"', 'name = "my study"', "name = 'my study': "),
        ('scenario = "hover"', 'scenario = "hoover"', "unknown scenario 'hoover'; did you mean 'hover'?"),
        ('design = "latin-hypercube"', 'design = "lhs"', "design = 'lhs': should be 'grid', 'latin-hypercube', 'random' or"),
        ('design = "latin-hypercube"', "", "design is missing"),
        ("range = [5.0, 6.0]", "", "vehicle.mass_kg: give one of range, values, normal, lognormal, triangular; none given"),
        ("range = [5.0, 6.0]", "range = [5.0, 6.0]\nvalues = [1, 2]", "give one of range, values, normal, lognormal, triangular; range and values"),
        ("range = [5.0, 6.0]", "values = [1, 2]\nlevels = 3", "levels and scale go with a range, not with values"),
        ("range = [5.0, 6.0]", "values = []", "vehicle.mass_kg: values: needs at least 2"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(FILE.replace(old, new))
    with pytest.raises(InputError) as caught:
        Study.load(path)
    assert message in str(caught.value)
    assert str(path.parent) in str(caught.value) or "hoover" in new


def test_unknown_names_list_the_known_ones(tmp_path: Path) -> None:
    message = r"unknown study or scenario 'hovr'; did you mean 'hover'.*\? see: hexjet show"
    with pytest.raises(InputError, match=message):
        open_study("hovr", vary=[f"{MASS}=5:6"])
    for read in (Study.load, open_study):
        with pytest.raises(InputError, match=r"none\.toml: no such study"):
            read(tmp_path / "none.toml")
    with pytest.raises(InputError, match="unknown study 'hover'"):
        Study.load("hover")


def test_a_study_is_saved_and_read_again(tmp_path: Path) -> None:
    vary = [f"{MASS}*=0.8:1.2", f"{GAIN}=normal(0.25,0.02,0.2,0.3)", "substeps=1,2,4"]
    more: dict[str, Any] = {"correlate": [f"{MASS},{GAIN}=-0.25"], "success": ["roll.overshoot_percent<=30"]}
    more["settings"] = ["duration_s=10", "command.0.amplitude=5", "vehicle.sensors.gyro.filter_s=0.01"]
    more |= {"controllers": ["smith", "baseline"], "design": "sobol", "runs": 64, "seed": 3}
    made = open_study("roll-doublet", vary=vary, **more)
    made.save(tmp_path / "study.toml")
    read = Study.load(tmp_path / "study.toml")
    assert read == made
    assert read.base() == made.base()
    assert read != made.changed(runs=128)


def test_settings_are_written_over_the_scenario_as_on_a_flight(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        FILE.replace("hover", "roll-doublet")
        + '[settings]\nduration_s = 5.0\n"vehicle.sensors.gyro.noise_rad_s" = 0.0\ncommand.0.amplitude = 4.0\n'
    )
    base = Study.load(path).base()
    texts = ["duration_s=5.0", "vehicle.sensors.gyro.noise_rad_s=0.0", "command.0.amplitude=4.0"]
    assert base.model_dump() == {**Scenario.load("roll-doublet", texts).model_dump(), "expect": []}


def test_options_go_over_a_studys_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(FILE)
    made = open_study(path, vary=[f"{GAIN}*=0.9:1.1", f"{MASS}=4:5"], runs=20, seed=9, controllers=["state"])
    assert [vary.text for vary in made.vary] == [f"{MASS}=4:5", f"{GAIN}*=0.9:1.1"]
    assert (made.name, made.runs, made.seed, made.controllers) == ("mine", 20, 9, ["state"])
    assert open_study(path) == Study.load(path)


def test_a_scenario_is_flown_over_a_grid_or_a_latin_hypercube(tmp_path: Path) -> None:
    assert open_study("hover", vary=[f"{MASS}=5:6:3", "engine=edf,motor"]).design == "grid"
    assert open_study("hover", vary=[f"{MASS}=5,6"], runs=9).design == "latin-hypercube"
    assert open_study("hover", vary=[f"{MASS}=5:6"], runs=9).controller_names == ["smith"]
    own = tmp_path / "own.toml"
    own.write_text("name = 'own'\nduration_s = 1.0\nengine = 'edf'\n")
    made = open_study(own, vary=[f"{MASS}=5:6"], runs=9)
    assert (made.name, made.base().engine) == ("own", "edf")


def test_a_study_finds_its_files_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "flown.toml").write_text("name = 'flown'\nduration_s = 1.0\nsubsteps = 2\n")
    (tmp_path / "mine.toml").write_text(FILE.replace('"hover"', '"flown.toml"'))
    monkeypatch.chdir(tmp_path.parent)
    made = Study.load(tmp_path / "mine.toml")
    assert made.base().substeps == 2
    (tmp_path / "elsewhere").mkdir()
    made.resolved().save(tmp_path / "elsewhere" / "study.toml")
    assert Study.load(tmp_path / "elsewhere" / "study.toml").base() == made.base()
    # a campaign has the scenario beside the study, with the settings in it
    (tmp_path / "elsewhere" / "scenario.toml").write_text((tmp_path / "flown.toml").read_text())
    made.changed(settings={"substeps": 2}).resolved(Path("scenario.toml")).save(tmp_path / "elsewhere" / "study.toml")
    kept = Study.load(tmp_path / "elsewhere" / "study.toml")
    assert (kept.scenario, kept.settings, kept.base().substeps) == ("scenario.toml", {}, 2)


def test_sobol_without_a_power_of_two_is_told() -> None:
    made = open_study("hover", vary=[f"{MASS}=5:6"], design="sobol", runs=100)
    assert made.notes() == ["sobol: 100 runs are no power of two; Sobol's points are balanced at 64 and 128"]
    assert made.changed(runs=128).notes() == []


def test_shipped_studies_are_listed_and_sound() -> None:
    assert {entry["name"] for entry in catalogue("studies")} == set(study_names())
    assert not set(study_names()) & set(scenario_names()), "hexjet sweep NAME would have two meanings"
    for name in study_names():
        made = Study.load(name)
        assert made.name == name
        assert made.title
        assert made.description
        assert made.success, f"{name} does not say what success is"


@pytest.mark.parametrize("name", study_names())
def test_a_shipped_study_flies(name: str) -> None:
    """Its first draw with every controller; what became of it is the study's business, that it could be judged is ours."""
    made = Study.load(name)
    rows = [fly_one(made, flight) for flight in flights(made)[: len(made.controller_names)]]
    assert [row["controller"] for row in rows] == made.controller_names
    assert {row["outcome"] for row in rows} <= {"completed", "diverged", "crashed"}, [row["reason"] for row in rows]
    assert len({row["seed"] for row in rows}) == 1
    for metric in made.success:
        assert any(row[metric] is not None for row in rows), f"{name}: no flight has {metric}"
