"""hexjet prove: the same verdict however it is flown, the worst flights again, and what cannot be shown refused."""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_tools import Done, Hexjet
from places import DESIGNS

from cosim import fly
from cosim.api.call.choices import apply_choices
from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.base.storage.paths import data_folder
from cosim.campaign import open_campaign, open_study
from cosim.campaign.analysis.summary import campaign_summary, success_lines
from cosim.campaign.study.plan import Flight, flights
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import NOT_FLOWN, Row, failed_row, fly_one
from cosim.cli.main import main
from cosim.results.log.digest import log_digest
from cosim.results.run import open_run
from hexjet_prove.proof.prove import Request, conclude, fly_study
from hexjet_prove.proof.scope import kinds_not_varied
from hexjet_prove.proof.source import proof_study

HOVER = """
name = "short"
scenario = "hover"
controllers = ["smith"]
design = "random"
runs = 400
until = "99%@95%"

[settings]
duration_s = 0.1
limits.drift_m = 3
limits.speed_m_s = false
limits.oscillation_rad = false

[[vary]]
key = "vehicle.mass_kg"
range = [5.4, 5.8]

[[require]]
name = "level"
formula = "always(abs(roll_deg) < 30)"

[success]
"altitude.max_abs_error_m" = { max = 0.5 }
"""

HEAVY_KG = 5.35  # 3.5 standard deviations below the middle of EDGE's mass
EDGE = """
name = "edge"
scenario = "hover"
controllers = ["smith"]
design = "random"
runs = 400
until = "60%@90%"

[settings]
duration_s = 0.2

[[vary]]
key = "vehicle.mass_kg"
normal = { mean = 5.525, sd = 0.05, min = 5.2, max = 5.9 }

[[vary]]
key = "mismatch.thrust_factor"
normal = { mean = 1.0, sd = 0.03, min = 0.85, max = 1.15 }

[success]
"altitude.max_abs_error_m" = { max = 0.012 }
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of a tenth of a second a flight, which no flight fails."""
    path = tmp_path_factory.mktemp("study") / "short.toml"
    path.write_text(HOVER)
    return path


@pytest.fixture(scope="module")
def proven(study: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """90 % at 95 %, shown by two workers."""
    folder = tmp_path_factory.mktemp("proof") / "p"
    given = ["--claim", "90%@95%", "--no-limit", "--search", "0", "--workers", "2", "--out", str(folder)]
    with pytest.raises(SystemExit) as end:
        main(["prove", str(study), *given])
    assert not end.value.code
    return folder


def told(folder: Path) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((folder / "proof.json").read_text())
    return data


MOST_WORDS = 45  # of the sentence
ASKED = Request(limit=False)


class Some:
    """A worker that flies no more than so many."""

    def __init__(self, most: int) -> None:
        self.most = most

    def fly(self, study: Study, planned: Iterable[Flight]) -> Iterator[Row]:
        yield from (fly_one(study, flight) for flight in islice(planned, self.most))


def test_90_percent_is_shown_on_one_page_and_in_one_json(proven: Path) -> None:
    data = told(proven)
    test = data["claim"]["tests"]["smith"]
    assert (data["decision"], test["flights"], test["failures"]) == ("shown", 36, 0)  # half the error is for none
    assert test["bound"] == 0.9
    assert data["sentence"].startswith(
        "The vehicle hexjet with controller smith and engine edf-as-flown keeps R1 to R3 with probability at least 90 % "
    )
    shown, _, fixed = data["sentence"].partition("; not varied: ")
    assert shown.endswith("(95 % confidence, 36 flights, 0 of them failed, stopped by rule)")
    assert len(shown.split()) <= MOST_WORDS
    assert fixed.startswith("engines, mass and balance but for their mass, ")
    assert list(data["facts"]) == ["probability over", "most likely failure", "controller"]
    assert data["facts"]["probability over"] == data["over"]
    assert [one["label"] for one in data["requirements"]] == ["R1", "R2", "R3"]
    assert data["requirements"][0]["says"] == (
        "flies to its end; limits that count: height_error_m, drift_m = 3, saturated_percent, settling_s, "
        "alternating_percent; limits that are off: place_error_m, speed_m_s, oscillation_rad, throttle_activity_1_s, "
        "tilt_activity_rad_s, fuel_burnt_kg"
    )
    level = data["requirements"][1]
    assert (level["says"], level["broken"], level["unit"]) == ("level: always(abs(roll_deg) < 30)", 0, "deg")
    assert 29.0 < level["margin"] < 30.0
    assert "with options of its own" not in data["study"]["title"]
    assert (data["requirements"][2]["broken"], data["requirements"][2]["unit"]) == (0, "m")
    assert 0.0 < data["requirements"][2]["margin"] < 0.5
    assert {data[part]["done"] for part in ("most_likely_failure", "worst_case", "rare")} == {False}
    assert {axis: limit["done"] for axis, limit in data["limit"].items()} == dict.fromkeys(AXES, False)
    assert "at least 90 % with 95 % confidence; the two-sided interval of 95 % confidence is 9" in data["says"][0]
    page = (proven / "proof.html").read_text()
    names = (one["name"] for one in data["credibility"])
    assert all(text in page for text in (data["sentence"], *data["facts"].values(), data["repeat"]["command"], *names))


def test_the_worst_flights_are_runs_that_fly_again(proven: Path) -> None:
    worst = told(proven)["worst"]
    margins = [one["margin"] for one in worst]
    assert len(worst) == 3
    assert margins == sorted(margins)
    assert all(one["is_same"] for one in worst)
    run = open_run(proven / worst[0]["run"])
    again = fly(proven / worst[0]["run"] / "scenario.toml")
    assert log_digest(again.log) == log_digest(run.log)
    assert worst[0]["values"]["vehicle.mass_kg"] == again.scenario.vehicle["mass_kg"]


def test_its_own_command_repeats_it(proven: Path, hexjet: Hexjet, tmp_path: Path) -> None:
    first = told(proven)["repeat"]
    words = [str(tmp_path / "again") if word == "AGAIN" else word for word in shlex.split(first["command"])]
    assert words[-4:-1] == ["0", "--no-limit", "--out"]
    done = hexjet(*words[1:], "--workers", "1", "--json")
    assert done.status == 0
    assert json.loads(done.out)["repeat"]["rows_sha256"] == first["rows_sha256"]


def test_stopped_and_resumed_it_comes_to_the_same(proven: Path, study: Path, hexjet: Hexjet, tmp_path: Path) -> None:
    stopped = fly_study(proof_study(str(study), "90%@95%"), tmp_path / "p", ASKED, Some(20))  # type: ignore[arg-type]
    partly = conclude(stopped, tmp_path / "p", ASKED)
    assert partly.decision == "open"
    assert partly.sentence.startswith("Nothing can be said yet")
    refused = hexjet("prove", str(tmp_path / "p"))
    assert (refused.status, refused.err.count("\n")) == (2, 1)
    assert "already holds a proof; resume goes on with it" in refused.err
    for name, value in (("claim", "99%@95%"), ("settings", "duration_s=1"), ("out", str(tmp_path / "q"))):
        refused = hexjet("prove", str(tmp_path / "p"), "--resume", f"--{name}", value)
        assert refused.status == 2
        assert f"is a proof and goes on as it began; leave out {name}\n" in refused.err
    assert hexjet("prove", str(tmp_path / "p"), "--resume").status == 0
    data, held = told(tmp_path / "p"), (tmp_path / "p/proof.json").read_bytes()
    assert (
        hexjet("prove", str(tmp_path / "p"), "--resume").status == 0
    )  # finished: nothing is searched, nothing changes
    assert (tmp_path / "p/proof.json").read_bytes() == held
    assert not (tmp_path / "p/searches").exists()
    first = told(proven)
    assert data["repeat"]["rows_sha256"] == first["repeat"]["rows_sha256"]
    assert {**data, "repeat": 0} == {**first, "repeat": 0}


def test_refuted_and_open_are_no_success(study: Path, hexjet: Hexjet, tmp_path: Path) -> None:
    failing = tmp_path / "failing.toml"
    failing.write_text(HOVER.replace("max = 0.5", "max = 1e-9"))
    done = hexjet("prove", str(failing), "--no-limit", "--search", "0", "--workers", "1", "--out", "p")
    data = told(tmp_path / "p")
    assert (done.status, data["decision"]) == (1, "refuted")
    assert data["sentence"].startswith("99 % is refuted: the vehicle hexjet")
    assert "with probability at most" in data["sentence"]
    assert data["worst"][-1]["why"].endswith("fails nearest to the middle of the draws")
    assert f"the middle of the draws is {data['worst'][-1]['run']}" in data["facts"]["most likely failure"]
    assert len(data["sentence"].partition(";")[0].split()) <= MOST_WORDS
    assert data["requirements"][2]["margin"] < 0.0
    seldom = tmp_path / "seldom.toml"  # one in two
    seldom.write_text(HOVER.replace('"altitude.max_abs_error_m" = { max = 0.5 }', '"altitude.rmse_m" = { max = 1.0 }'))
    out = tmp_path / "few"
    few = conclude(fly_study(proof_study(str(seldom), "50%@99.9%", 10), out, ASKED, 1), out, ASKED)
    assert few.decision == "shown"  # 10 of 10: 2^-10 is below the error


def test_what_could_not_be_flown_is_said(tmp_path: Path) -> None:
    """A moment of inertia above the sum of the others is no body's: its flights refute nothing, by one rule."""
    impossible = tmp_path / "impossible.toml"
    text = HOVER.replace('key = "vehicle.mass_kg"', 'key = "vehicle.inertia_kg_m2.2"\nrelative = "factor"')
    impossible.write_text(text.replace("[5.4, 5.8]", "[1.8, 2.4]"))
    out = tmp_path / "p"
    proof = conclude(fly_study(proof_study(str(impossible), "50%@90%", 40), out, ASKED, 1), out, ASKED)
    (line,) = [text for text in proof.not_covered if "could not be flown" in text]
    assert "to a verdict, the first because:" in line
    assert line.endswith(NOT_FLOWN)
    assert NOT_FLOWN in " ".join(success_lines(campaign_summary(open_campaign(tmp_path / "p" / "campaign"))))
    assert "no body has one moment above the sum of the others" in line
    assert proof.requirements[0].broken == 0
    assert (proof.decision, proof.verdict and proof.verdict.failures) == ("open", 0)
    flights = proof.verdict.flights if proof.verdict else 0
    assert f"{flights} flights, 0 of them failed and {flights} not flown to a verdict" in proof.sentence
    assert proof.worst[-1].run == ""
    assert proof.worst[-1].is_same


def test_the_most_likely_failure_and_the_worst_case_are_runs(hexjet: Hexjet, tmp_path: Path) -> None:
    """Of a study that fails where the thrust is off by two standard deviations: the search finds that edge."""
    pytest.importorskip("cmaes", reason="no cmaes: pip install cmaes")
    edge = tmp_path / "edge.toml"
    edge.write_text(EDGE)
    arguments = ("prove", str(edge), "--no-limit", "--search", "60", "--out", "p", "--workers", "2")
    assert hexjet(*arguments).status == 0
    data = told(tmp_path / "p")
    likely, worst = data["most_likely_failure"], data["worst_case"]
    assert (likely["done"], likely["fails"], likely["is_same"], worst["is_same"]) == (True, True, True, True)
    assert likely["distance"] == pytest.approx(2.1, abs=0.1)
    assert max(likely["keys"], key=likely["keys"].get) == "mismatch.thrust_factor"
    assert worst["margin"] < likely["margin"] < 0.0
    assert likely["says"] == data["facts"]["most likely failure"]
    for case, says in ((likely, "its most likely failure within 6"), (worst, "its worst case within 3")):
        assert case["says"].startswith(f"{says} standard deviations of the middle of all keys in")
    for found in (likely, worst):
        assert open_run(tmp_path / "p" / found["run"]).outcome == "completed"
    (robust,) = [one["evidence"] for one in data["credibility"] if one["name"] == "Results robustness"]
    assert robust.endswith("a search for the worst case over all keys together")
    folder = tmp_path / "p" / "searches" / "likely"
    flown = open_campaign(folder)
    kept = [json.dumps(flown.row(number)) for number in range(20)]
    (folder / "flights" / "part-00000.parquet").unlink()
    (folder / "flights.jsonl").write_text("".join(f"{row}\n" for row in kept))
    assert hexjet(*arguments, "--resume").status == 0  # stopped there, a proof goes on and comes to the same
    assert [json.dumps(open_campaign(folder).row(number)) for number in range(20)] == kept
    assert {**told(tmp_path / "p"), "repeat": 0} == {**data, "repeat": 0}
    refused = hexjet("prove", "p", "--resume", "--search", "50")
    assert (refused.status, refused.err) == (2, "hexjet: p: search has begun with 60 flights; leave out search\n")


def test_without_the_package_that_searches_the_terminal_says_so(
    study: Path, hexjet: Hexjet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexjet_prove.search.minimise.find_spec", lambda name: None)
    lacks = "a search needs the package cmaes, which is not installed: pip install cmaes"
    likely = ["search", "hover", "--worst", "--vary", "vehicle.mass_kg=5:6"]
    for words in (["prove", str(study), "--search", "20"], likely):
        refused = hexjet(*words, "--out", "q")
        assert (refused.status, refused.err) == (2, f"hexjet: {lacks}\n")
        assert not (tmp_path / "q").exists()
    done = hexjet("prove", str(study), "--claim", "90%@95%", "--no-limit", "--workers", "1", "--out", "p")
    assert done.status == 0
    assert f"no search for the most likely failure was made: {lacks}" in " ".join(done.out.split())


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (["engine_parameters.delay_samples=20:30"], "engines but for their delay"),
        (["mismatch.delay_samples=0:3"], "engines but for their delay"),
        (["mismatch.delay_samples=0:3", "mismatch.thrust_factor=0.9:1.1"], "engines but for their delay and gain"),
        (["added_delay_samples=0:3", "mismatch.thrust_factor=0.9:1.1", "engine_parameters.pole=0.8:0.9"], ""),
        (["engine=edf,turbojet"], ""),
        (["stations.3.parameters.gain=0.9:1"], "engines but for their gain of station 3"),
        (["vehicle.servo.lag_s=0.01:0.02"], "servos but for their lag"),
        (["vehicle.sensors.gyro.noise_rad_s=0.001:0.002"], "sensors but for their gyro noise"),
        (["mismatch.stretch.0=-0.1:0.1"], "moments of inertia but for their pitch and yaw"),
        (["environment.wind_ned_m_s.0=0:3"], "wind and air but for their wind"),
    ],
)
def test_what_is_varied_of_a_kind_is_told_from_the_rest_of_it(keys: list[str], said: str) -> None:
    """A part is not the whole: the rest of it is as the model has it."""
    left = kinds_not_varied(open_study("hover", vary=keys, design="random", runs=2))
    assert (len(left), [kind for kind in left if "but for" in kind]) == (7 if said else 6, [said] if said else [])


class Known:
    """A worker that flies nothing: a flight fails where the mass is below a threshold, by how far it is."""

    def fly(self, study: Study, planned: Iterable[Flight]) -> Iterator[Row]:
        for flight in planned:
            mass = float(flight.values["vehicle.mass_kg"] or 0.0)
            row = failed_row(study, flight, "too light")
            margin = (mass - HEAVY_KG) / 0.05
            yield row | {"success": margin > 0.0, "outcome": "completed", "steps": 1, "margin": margin}


def test_a_rare_failure_has_its_probability(tmp_path: Path) -> None:
    """Of a known truth, 3.5 standard deviations out: one flight in 4,300."""
    edge = tmp_path / "edge.toml"
    edge.write_text(EDGE)
    out = tmp_path / "p"
    asked = Request(limit=False, rare=2800)
    flown = fly_study(proof_study(str(edge), "60%@90%"), out, asked, Known())  # type: ignore[arg-type]
    proof = conclude(flown, out, asked, Known())  # type: ignore[arg-type]
    data = json.loads((out / "proof.json").read_text())["rare"]
    assert data["done"]
    assert data["low"] < 2.33e-4 < data["high"] < 2e-3
    assert data["says"] == proof.facts["rare failures"]
    assert data["says"] in (out / "proof.html").read_text()
    assert "no method for rare failures" not in " ".join(proof.not_covered)
    assert "--rare 2800" in proof.repeat["command"]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["hover", "--claim", "99.9%@95%", "--budget", "2995"], "nothing varies; a proof is of a study, a .toml file"),
        (["STUDY", "--claim", "99.9%@95%", "--budget", "100"], "even if all succeed; 99.9%@95% takes 2,995 without a"),
        (["STUDY", "--budget", "2000000"], "budget 2000000: at most 1,000,000"),
        (["STUDY", "--claim", "99.9999%@95%"], "claim 99.9999%@95%: 1,000,000 flights do not show it"),
        (["STUDY", "--claim", "smith>baseline@95%"], "compares two controllers, which hexjet sweep --until does"),
        (["predictor-robustness", "--claim", "99%@95%"], "and a proof is one's; controller NAME says which: baseline,"),
        (["predictor-robustness"], "states no claim (until); claim says what is to be shown"),
        (["DESIGN"], "a design states no claim"),
        (["DESIGN", "--claim", "99%@95%", "--controller", "smith"], "a design brings its own controllers"),
        (["STUDY", "--rare", "100"], "rare 100: 8 repeats of 7 levels down to"),
        (["STUDY", "--resume"], "give the folder of the proof"),
        (["STUDY", "--out", "."], "is not empty; choose another folder"),
        (["STUDY", "--replay", "."], "is no replay.json of hexjet replay"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_a_line(
    arguments: list[str], reason: str, study: Path, hexjet: Hexjet, tmp_path: Path
) -> None:
    (tmp_path / "something").touch()
    named = {"STUDY": str(study), "DESIGN": str(DESIGNS / "turbojet.toml")}
    done: Done = hexjet("prove", *(named.get(word, word) for word in arguments))
    assert (done.status, done.err.count("\n")) == (2, 1), done.err
    assert reason.lower() in done.err.lower()


@pytest.mark.parametrize("words", [["prove", "--claim", "99%@95%"], ["search", "--worst"]], ids=["prove", "search"])
def test_a_design_for_an_engine_of_the_users_asks_for_its_file(
    words: list[str], hexjet: Hexjet, tmp_path: Path
) -> None:
    design = (DESIGNS / "turbojet.toml").read_text()
    (tmp_path / "mine.toml").write_text(design.replace('engine = "turbojet"', 'engine = "MyEngine"'))
    done: Done = hexjet(words[0], "mine.toml", *words[1:])
    assert (done.status, done.err.count("\n")) == (2, 1), done.err
    assert "mine.toml: designed for engine 'MyEngine', which is not shipped; give its file as engine" in done.err


def test_a_design_knows_where_its_aircraft_and_engine_are(hexjet: Hexjet, tmp_path: Path) -> None:
    assert hexjet("aircraft", "new", "gryphon", "--out", "ours/gryphon").status == 0
    (tmp_path / "ours/my-engine").mkdir()
    shutil.copy(data_folder("fmus") / "turbojet.fmu", tmp_path / "ours/my-engine/engine.fmu")
    design = tmp_path / "ours/gryphon.toml"
    text = (DESIGNS / "turbojet.toml").read_text()
    for stated, own in (
        ('aircraft = "hexjet"', 'aircraft = "gryphon"\naircraft_path = "gryphon"'),
        ('engine = "turbojet"', 'engine = "my-engine"\nengine_path = "my-engine/engine.fmu"'),
        ("[vehicle.identified.turbojet", '[vehicle.identified."my-engine.fmu"'),
    ):
        assert stated in text
        text = text.replace(stated, own)
    design.write_text(text)
    there = tmp_path / "ours/gryphon", tmp_path / "ours/my-engine/engine.fmu"
    proven = proof_study("ours/gryphon.toml", "99%@95%").base()
    margins = apply_choices("hover", controller="ours/gryphon.toml")
    for flown in (proven, margins):
        assert (flown.aircraft, flown.engine) == tuple(map(str, there))
    assert apply_choices("hover", controller="ours/gryphon.toml", engine="edf").engine == "edf"
    with pytest.raises(InputError, match="designed for aircraft 'gryphon', not for 'quadjet'"):
        apply_choices("hover", controller="ours/gryphon.toml", aircraft="quadjet")
    (tmp_path / "ours/my-engine/engine.fmu").rename(tmp_path / "elsewhere.fmu")
    with pytest.raises(InputError, match=f"engine 'my-engine', which is not at {there[1]}; give its file as engine"):
        proof_study("ours/gryphon.toml", "99%@95%")
    there[0].rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=f"aircraft 'gryphon', which is not at {there[0]}; name it as aircraft"):
        apply_choices("hover", controller="ours/gryphon.toml")


def test_a_design_is_proven_over_the_box_that_it_was_made_for(tmp_path: Path) -> None:
    own = "always(abs(roll_deg) < 40)"
    designed = proof_study(str(DESIGNS / "turbojet.toml"), "99%@95%", success=[own, "altitude.rmse_m<=1"])
    assert designed.require[-1].formula == own
    assert designed.name == "hexjet-turbojet-designed"
    by_key = {vary.key: vary for vary in designed.vary}
    inertia = by_key["mismatch.inertia_factor"]
    assert inertia.range == pytest.approx((1.0 / 1.3, 1.0 / 0.7), rel=1e-5)  # gain 0.7 to 1.3 times as much
    assert by_key["mismatch.delay_samples"].range == (0.0, 7.0)  # 0.3 of 25 samples, whole ones
    assert len(by_key) == 2  # all moments alike: by themselves some would be no body's
    assert set(designed.success) == {"roll.overshoot_percent", "roll.oscillation_rad", "altitude.rmse_m"}
    assert designed.base().command[0].amplitude == 20.0  # type: ignore[union-attr]  # the pilot's lean
    assert "inertia" not in " ".join(kinds_not_varied(designed))
    flight = flights(designed)[0]
    row = fly_one(designed, Flight(0, 0, flight.controller, 1, dict.fromkeys(flight.values, 0) | {
        key: float(value) for key, value in nominal(designed).items()
    }))  # fmt: skip
    assert row["success"], row["reason"]
    folder = tmp_path / "design"
    folder.mkdir()
    (folder / "controller.toml").write_bytes((DESIGNS / "turbojet.toml").read_bytes())
    assert proof_study(str(folder), "99%@95%").vary == designed.vary
    with pytest.raises(InputError, match="do not show it"):
        proof_study(str(folder), "99%@95%", 100)


def nominal(study: Study) -> dict[str, float]:
    """The values of a study's keys as the scenario has them."""
    values = {name: study.key(name).nominal for name in study.drawn}
    return {name: float(value) for name, value in values.items() if isinstance(value, (int, float))}


def test_an_uncertain_engine_is_drawn_in_place_of_the_box(tmp_path: Path) -> None:
    study = proof_study("hover", "90%@90%", settings=["engine='jetcat-p300'", "aircraft='hexjet-p220'"])
    assert [vary.uncertainty for vary in study.vary] == [True]
    assert kinds_not_varied(study)[:2] == ["engines but for 6 of their numbers", "mass and balance"]  # its ECU alone
    assert np.all([key.startswith("mismatch.engine_parameters.") for key in study.drawn])


@pytest.mark.long
def test_the_shipped_example_is_shown(hexjet: Hexjet, tmp_path: Path) -> None:
    """With the limit of the three axes."""
    done = hexjet("prove", "roll-doublet-claim", "--out", "p", "--json")
    data = json.loads(done.out)
    assert (done.status, data["decision"]) == (0, "shown")
    assert set(data["limit"]) == set(AXES)
    assert data["limit"]["roll"]["times"] > data["limit"]["roll"]["times_as_tolerant"] > 1.0
    assert all(limit["times"] >= 1.0 if limit["done"] else limit["says"] for limit in data["limit"].values())
