"""A controller of the user's flies, is recorded as what it is, and is named where it goes wrong."""

from __future__ import annotations

import hashlib
import json
import linecache
import re
import shutil
import sys
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_tools import hexjet_beside, install
from places import of_page

from cosim import InputError, Run, Scenario, fly, open_run
from cosim.base.signals import UNKNOWN3, Unallocated
from cosim.campaign import open_campaign
from cosim.campaign.run import choose_workers, fly_again, run_campaign
from cosim.campaign.study.keys import find_key
from cosim.campaign.study.options import open_study
from cosim.control.attitude import AttitudeController
from cosim.control.rate import RateController
from cosim.results.summary import OwnController
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from hexjet_prove.api.surveys import faults
from hexjet_prove.search.folder import resolve_search, run_search

DOUBLET = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.04, "amplitude": 8.0, "width_s": 0.2}
ROLL = Scenario.load("roll-doublet").replace(duration_s=0.8, command=[DOUBLET], expect=[])
SHORT = ROLL.replace(duration_s=0.2)


def same(one: Any, other: Any) -> bool:
    names = [name for name in one.log.columns if name in other.log.columns]
    return len(names) >= 80 and all(one.log[name].tobytes() == other.log[name].tobytes() for name in names)


def own_of(run: Run) -> OwnController:
    """What the run says of the controller that it flew."""
    assert run.summary.own_controller is not None
    return run.summary.own_controller


@pytest.fixture
def mine(tmp_path: Path) -> str:
    return f"{of_page('predictor', tmp_path / 'mine.py')}:Mine"


@pytest.fixture
def whole(tmp_path: Path) -> str:
    return f"{of_page('cascade', tmp_path / 'cascade.py')}:Cascade"


def test_a_class_of_thirty_lines_that_repeats_the_cascade_leaves_its_log(whole: str) -> None:
    """But for the class of the records, everything: a gust and a payload too."""
    times = {"start_s": 0.1, "rise_s": 0.1, "hold_s": 0.2, "fall_s": 0.1}
    scenario = ROLL.replace(disturbance=[{"kind": "gust", "velocity_ned_m_s": [0.0, 4.0, 1.0], **times}])
    ours, theirs = fly(scenario.replace(controller="smith")), fly(scenario.replace(controller=whole))
    assert theirs.outcome == "completed"
    assert ours.log.columns == theirs.log.columns
    assert same(ours, theirs)
    assert (own_of(theirs).level, theirs.summary.controller) == ("controller", "cascade.py:Cascade")


def test_the_predictor_of_the_page_is_between_smith_and_none(mine: str) -> None:
    whole = fly(ROLL.replace(controller=mine))
    assert whole.log.columns[-1] == "roll_correction_rad_s"
    np.testing.assert_array_equal(
        whole.log["roll_correction_rad_s"], whole.log["rate_p_predicted_rad_s"] - whole.log["rate_p_measured_rad_s"]
    )
    smith = fly(ROLL.replace(controller="smith"))
    # measured + (smith - measured) is smith to the rounding of two sums
    assert np.abs(whole.log["roll_rad"] - smith.log["roll_rad"]).max() < 1e-12
    none = fly(ROLL.replace(controller=mine, controller_parameters={"share": 0.0}))
    assert same(none, fly(ROLL.replace(controller="baseline")))


class OwnRate:
    """Ours, behind the protocol of one from outside; what was applied tells it what could not be given."""

    level = "rate"

    def prepare(self, belief: Any) -> None:
        gains = belief.vehicle.control.rate
        self._inner = RateController((gains.roll, gains.pitch, gains.yaw), belief.predictors("smith"), belief.step_s)

    def reset(self) -> None:
        self._inner.reset()
        self._asked = np.zeros(3)
        self.predicted = UNKNOWN3

    def update(self, setpoint: Any, measured: Any, applied: Any) -> Any:
        roll, pitch, yaw = (self._asked - np.array(applied)).tolist()
        answer = self._inner.update(setpoint, measured, Unallocated(roll, pitch, yaw))
        self.predicted = self._inner.predicted
        self._asked = np.array(answer)
        return self._asked


class OwnAttitude:
    level = "attitude"
    predictor = "smith"

    def prepare(self, belief: Any) -> None:
        self._inner = AttitudeController(belief.vehicle.control.attitude)

    def reset(self) -> None:
        self._inner.reset()

    def update(self, command: Any, measured: Any) -> list[float]:
        return list(self._inner.update(command, measured))


@pytest.mark.parametrize("loop", [OwnRate, OwnAttitude])
def test_a_loop_of_ones_own_between_ours(loop: type) -> None:
    ours, theirs = fly(ROLL.replace(controller="smith")), fly(ROLL, controller=loop)
    assert theirs.outcome == "completed", theirs.reason
    assert same(ours, theirs)


def test_what_a_rate_loop_keeps_as_its_predictor_is_its_own() -> None:
    loop = OwnRate()
    loop.predictor = RateController  # type: ignore[attr-defined]
    assert same(fly(SHORT, controller=loop), fly(SHORT, controller=OwnRate))


def test_what_a_controller_is_told_is_never_the_truth() -> None:
    told: list[Any] = []

    class Curious(OwnRate):
        def prepare(self, belief: Any) -> None:
            super().prepare(belief)
            vehicle = belief.vehicle.model_dump_json()
            told.append((vehicle, belief.models["roll"], belief.hover, belief.engines, belief.step_s))

    wrong = {"mass_factor": 1.2, "thrust_factor": 0.9, "delay_samples": 5, "centre_m": [0.0, 0.01, 0.0]}
    for changes in ({}, {"mismatch": wrong}, {"added_delay_samples": 3}):
        assert fly(SHORT.replace(**changes), controller=Curious()).outcome == "completed"
    assert told[0] == told[1]
    assert told[2][1].delay_samples == told[0][1].delay_samples + 3  # that one its own loop adds


def test_a_quadrotor_has_no_tilts() -> None:
    class Hover:
        level = "controller"

        def reset(self) -> None: ...

        def update(self, command: Any, measured: Any, applied: Any) -> Any:
            return np.array(applied.throttle)

    quadrotor = {"aircraft": "quadrotor", "engine": "motor", "step_s": 0.0025}
    base = Scenario.load("hover").replace(**quadrotor, duration_s=0.1, expect=[])
    assert fly(base, controller=Hover).outcome == "completed"


class Wrong:
    level = "controller"

    def __init__(self, answer: Any = None) -> None:
        self.answer = answer

    def reset(self) -> None:
        self.k = 0

    def update(self, command: Any, measured: Any, applied: Any) -> Any:
        self.k += 1
        if self.k <= 10:
            return applied.throttle, applied.tilt
        return self.answer(applied) if callable(self.answer) else self.answer


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (lambda applied: (applied.throttle[:5], applied.tilt), "throttles: update gave 5 numbers: must be 6"),
        (lambda applied: ([nan, *applied.throttle[1:]], applied.tilt), "throttle 1 = nan: must be finite"),
        (lambda applied: ([*applied.throttle[:5], 1.5], applied.tilt), "throttle 6 = 1.5: must be from 0 to 1"),
        (lambda applied: (applied.throttle, (0.0, nan)), "the tilt of the right servo = nan: must be finite"),
        (lambda applied: ("abc", applied.tilt), "throttles: update gave 'abc': must be 6 numbers"),
        (None, "update gave None: must be throttles and tilts"),
        (lambda applied: 1 / 0, r"update raised ZeroDivisionError: division by zero (test_own_controller.py:"),
    ],
)
def test_what_a_controller_does_wrong_ends_the_run_which_names_it(answer: Any, reason: str, tmp_path: Path) -> None:
    run = fly(SHORT, tmp_path / "run", controller=Wrong(answer), report=False)
    assert run.outcome == "failed"
    assert f"Wrong: {reason}" in run.reason
    assert "at step 10 (0.040 s)" in run.reason
    assert len(open_run(tmp_path / "run").log) == 10


def test_a_predictor_and_a_loop_too() -> None:
    class Bad:
        level = "predictor"

        def reset(self) -> None: ...

        def update(self, measured: float, applied: float) -> float:
            return nan

    class Short(OwnAttitude):
        def update(self, command: Any, measured: Any) -> list[float]:
            return [0.0]

    assert "Bad: the rate of roll = nan: must be finite at step 0" in fly(SHORT, controller=Bad).reason
    assert "update gave 1 numbers: must be 3 at step 0" in fly(SHORT, controller=Short).reason


RESET, UPDATE = "    def reset(self): ...\n", "    def update(self, a, b): ...\n"
PREDICTOR = f"class Mine:\n    level = 'predictor'\n{RESET}{UPDATE}"
RATE = f"class Mine:\n    level = 'rate'\n{RESET}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "class Mine:\n    pass\n",
            r"mine.py:Mine: level = None: must be one of predictor, rate, attitude, controller",
        ),
        (RATE, r"has no update\(setpoint, measured, applied\)"),
        (RATE + "    def update(self, a): ...\n", r"update\(self, a\): must take \(setpoint, measured, applied\)"),
        ("class Other:\n    level = 'rate'\n", r"mine.py has no class 'Mine'; allowed: Other"),
        ("x = \n", r"mine.py, line 1: SyntaxError"),
        ("import nowhere_to_be_found\n", r"ModuleNotFoundError: No module named 'nowhere_to_be_found' \(mine.py:1\)"),
        (PREDICTOR + "    def __init__(self, x): ...\n", "cannot be made without arguments: TypeError"),
        (PREDICTOR + "    parameters = (('a b', 1.0),)\n", "parameter 'a b': a name is of letters, digits and _"),
        (
            PREDICTOR + "    parameters = (('a', 2.0, '', '', 0.0, 1.0),)\n",
            "parameter a: default = 2.0: must be from least to most",
        ),
        (
            PREDICTOR + "    def prepare(self, belief): raise ValueError('no')\n",
            r"prepare raised ValueError: no \(mine.py:5\)",
        ),
    ],
)
def test_what_cannot_fly_is_one_line(mine: str, text: str, message: str) -> None:
    Path(mine.removesuffix(":Mine")).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        fly(SHORT, controller=mine)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"controller": "nowhere.py:Mine"}, "nowhere.py: no such file"),
        ({"controller": "no.such.module:Mine"}, "no.such.module cannot be imported: ModuleNotFoundError"),
        ({"controller": "mine.py"}, "controller mine.py: a file alone is none; name its class too: mine.py:Mine"),
        (
            {"controller": "mine.toml"},
            "controller mine.toml is a design, which no scenario names: give it as controller",
        ),
        ({"controller": "smiht"}, "unknown controller 'smiht'; did you mean 'smith'?"),
        (
            {"controller_parameters": {"share": 1.0}},
            "controller smith has none of its own; it is tuned under vehicle.control",
        ),
        (
            {"controller": "mine", "controller_parameters": {"shear": 1.0}},
            "controller_parameters.shear: unknown parameter; did you mean 'share'?",
        ),
        (
            {"controller": "mine", "controller_parameters": {"share": 2.0}},
            "controller_parameters.share = 2: must be from 0 to 1",
        ),
    ],
)
def test_wrong_names_and_parameters_are_refused(mine: str, changes: dict[str, Any], message: str) -> None:
    if changes.get("controller") == "mine":
        changes = changes | {"controller": mine}
    with pytest.raises(InputError, match=re.escape(message)):
        fly(SHORT.replace(**changes))


@pytest.mark.parametrize(
    "changes",
    [{"added_delay_samples": 2},
     {"disturbance": [{"kind": "torque_command", "axis": "roll", "start_s": 0.0, "duration_s": 0.1, "amplitude": 0.1}]}],
)  # fmt: skip
def test_what_only_a_cascade_has_is_refused_of_a_whole_controller(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"rate loop's output, which controller .*Wrong does not have"):
        fly(SHORT.replace(**changes), controller=Wrong)


def test_a_run_has_the_file_and_flies_it_again_or_says_what_is_another(mine: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    (tmp_path / "gain.py").write_text("SHARE = 0.7\n")
    file = Path(mine.removesuffix(":Mine"))
    file.write_text("import gain\n" + file.read_text().replace("self.share = ", "self.share = gain.SHARE * "))
    first = fly(SHORT.replace(controller=mine, controller_parameters={"share": 0.5}), folder, report=False)
    own = own_of(first)
    assert own.parameters == {"share": 0.5}
    assert set(own.files) == {"mine.py", "gain.py"}
    assert own.files["mine.py"] == first.summary.sha256["mine.py"]
    assert not list(tmp_path.glob("**/__pycache__"))
    assert "gain" not in sys.modules
    shutil.copytree(folder, tmp_path / "moved")
    file.write_text("raise SystemError\n")  # the copy is what flies
    (tmp_path / "gain.py").unlink()
    moved = Scenario.load(tmp_path / "moved" / "scenario.toml")
    again = fly(moved)
    assert same(first, again)
    assert own_of(again).sha256 == own.sha256
    (tmp_path / "moved" / "gain.py").write_text("SHARE = 0.8\n")
    said = rf"mine.py:Mine is not the one that was flown: .*then it was {own.sha256[:12]}"
    with pytest.raises(InputError, match=said):
        fly(moved)
    # another controller is not held against that hash
    other = moved.replace(controller="baseline")
    assert (other.controller_sha256, other.controller_parameters) == (None, {})
    assert fly(other).outcome == "completed"


def test_an_object_with_values_of_its_own_is_not_flown_again_by_a_file(tmp_path: Path) -> None:
    block = Wrong(lambda applied: (applied.throttle, applied.tilt))
    assert not own_of(fly(SHORT, tmp_path / "object", controller=block, report=False)).again
    with pytest.raises(InputError, match="was an object of a program, which no file can make again"):
        fly(Scenario.load(tmp_path / "object" / "scenario.toml"))
    # one as its class makes it is: its file is copied
    assert own_of(fly(SHORT, tmp_path / "class", controller=Wrong(), report=False)).again
    assert (tmp_path / "class" / Path(__file__).name).read_bytes() == Path(__file__).read_bytes()


def test_of_a_class_in_a_notebooks_cell_the_text_is_hashed(tmp_path: Path) -> None:
    """IPython keeps a cell's lines for its tracebacks; where nobody keeps them the run says that there is no hash."""
    mine = RATE + "    def update(self, setpoint, measured, applied):\n        return [0.0] * 3"
    cell = f"import math\n{mine}\nx = 1\n"
    said = {}
    linecache.cache["<cell>"] = (len(cell), None, cell.splitlines(keepends=True), "<cell>")
    for name in ("<cell>", "<stdin>"):
        told: dict[str, Any] = {"__name__": "__main__"}  # whose file, pytest's, is not the class's
        exec(compile(cell, name, "exec"), told)
        folder = tmp_path / name.strip("<>")
        run = fly(SHORT, folder, controller=told["Mine"]())
        own = own_of(run)
        assert (own.again, own.name) == (False, "python:__main__.Mine")
        assert "an object of a program, which no file makes again" in run._repr_html_()
        assert "an object of a program" in (folder / "report.html").read_text(encoding="utf-8")
        said[name] = own.sha256
    linecache.cache.pop("<cell>")
    assert said == {"<cell>": hashlib.sha256(mine.encode()).hexdigest(), "<stdin>": ""}


def test_a_study_compares_it_with_ours_in_spawned_workers(mine: str, tmp_path: Path) -> None:
    vary = ["controller_parameters.share=0,1"]
    study = open_study("roll-doublet", vary=vary, controllers=[mine, "smith"], settings=["duration_s=0.2"])
    assert study.key("controller_parameters.share").nominal == 1.0
    campaign = run_campaign(study, tmp_path / "campaign", workers=1)
    Path(mine.removesuffix(":Mine")).unlink()
    columns = campaign.columns
    assert list(columns["outcome"]) == ["completed"] * 4
    assert list(columns["controller"]) == ["mine.py:Mine", "smith"] * 2
    own, none, *rest = columns["controller_sha256"]
    assert rest == [own, none]
    assert own is not None
    assert none is None
    assert len({*columns["log_sha256"]}) == 4
    assert fly_again(campaign, 2, report=False).same
    copied = tmp_path / "campaign" / "mine.py"
    copied.write_text(copied.read_text().replace("return measured +", "return measured + 2.0 *"))
    again = fly_again(campaign, 2, report=False)
    assert not again.same
    assert any(line.startswith("mine.py was ") for line in again.otherwise)


def test_a_search_and_a_survey_of_faults_fly_it_and_say_which_it_was(mine: str, whole: str, tmp_path: Path) -> None:
    """And the survey says where nothing watches the engines."""
    sha256 = {name: hashlib.sha256(Path(name.rpartition(":")[0]).read_bytes()).hexdigest() for name in (mine, whole)}
    out = tmp_path / "survey"
    asked: dict[str, Any] = {"controllers": [mine, whole], "kinds": ["gyro bias"], "workers": 1}
    found = faults("hexjet", "edf-as-flown", out=out, **asked)
    flown = {(row.controller, row.controller_sha256) for row in found.survey.rows}
    assert flown == {(Path(name).name, value) for name, value in sha256.items()}
    assert {row.verdict for row in found.survey.rows if row.start == "hover"} == {"held"}
    assert "no engine monitor with cascade.py:Cascade" in "\n".join(found.lines())
    assert [each["engine_monitor"] for each in found.to_dict()["own_controllers"]] == [True, False]
    assert (out / "mine.py").read_bytes() == Path(mine.removesuffix(":Mine")).read_bytes()

    vary = ["controller_parameters.share=0.5:1:2"]
    study, plan = resolve_search("hover", vary=vary, controllers=[mine], settings=["duration_s=0.2"])
    with choose_workers(1, None, None) as workers:
        searched = run_search(study, plan, tmp_path / "search", workers)
    assert list(searched.to_json()["controller_sha256"].values()) == [sha256[mine]]
    assert set(open_campaign(tmp_path / "search").columns["controller_sha256"]) == {sha256[mine]}


def test_a_run_of_one_gets_its_page_again_and_says_that_nothing_watched(whole: str, tmp_path: Path) -> None:
    """From what is in the folder alone, the file that was flown being gone."""
    run = fly(SHORT.replace(controller=whole, monitor=True), tmp_path / "run", report=False)
    Path(whole.removesuffix(":Cascade")).unlink()
    told = hexjet_beside(tmp_path, "show", "run", "--page").told
    assert "engines were not watched: cascade.py:Cascade is a whole controller" in told
    assert own_of(run).sha256[:12] in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


BLOCKS = """
def rows(log, step_s):
    return len(log["time_s"])

class Blows:
    def velocity(self, time, north, east, height):
        return (3.0, 0.0, 0.0)

class Low:
    def reset(self, state, measured):
        return measured
    def sample(self, state, measured):
        return measured._replace(altitude=-7.0)

class Counts:
    seen = 0
    def observe(self, sample):
        self.seen += 1
    def close(self):
        open("seen.txt", "w").write(str(self.seen))
"""


def test_a_ground_station_session_of_one_leaves_a_run_with_it(whole: str, tmp_path: Path) -> None:
    """And of the other blocks that a user brings."""
    (tmp_path / "mine.py").write_text(BLOCKS)
    blocks = "--metric mine.py:rows --wind mine.py:Blows --sensors mine.py:Low --observer mine.py:Counts"
    link = "--mavlink udpout:127.0.0.1:9 --duration 0.2 --rtf 0 --params none --out run --json"
    told = hexjet_beside(tmp_path, "gcs", "--controller", whole, *link.split(), *blocks.split()).told
    summary = json.loads(told)["runs"][0]
    own = summary["own_controller"]
    assert own["level"] == "controller"
    assert own["sha256"] == hashlib.sha256((tmp_path / "run" / "cascade.py").read_bytes()).hexdigest()
    assert summary["own_metrics"] == {"own.rows": 50.0}
    assert {each["key"] for each in summary["brought"]} == {"metrics", "observers", "sensors", "wind"}
    assert (tmp_path / "seen.txt").read_text() == "50"
    log = open_run(tmp_path / "run").log
    assert set(log["altitude_measured_m"][1:]) == {-7.0}
    assert log["wind_north_m_s"][-1] == pytest.approx(3.0)


def test_its_parameters_are_keys(mine: str) -> None:
    key = find_key(SHORT.replace(controller=mine), "controller_parameters.share")
    assert (key.nominal, key.low, key.high) == (1.0, 0.0, 1.0)
    with pytest.raises(InputError, match=r"did you mean controller_parameters\.share"):
        open_study("hover", vary=["controller_parameters.shear=0,1"], controllers=[mine])
    wrong = ["controller_parameters.shear=1"]
    with pytest.raises(InputError, match=r"controller_parameters\.shear"):
        open_study("hover", vary=["vehicle.mass_kg=5,6"], controllers=[mine], settings=wrong)


def test_an_installed_package_brings_one(tmp_path: Path) -> None:
    package = install(tmp_path, "my-controllers", "1.2", "[hexjet.controllers]\nmine = my_controllers:Mine\n")
    source = of_page("predictor", package / "my_controllers.py")
    assert re.search(r"mine +my_controllers:Mine \(predictor\)", hexjet_beside(package, "show", "controllers").out)
    asked = "--set duration_s=0.2 --set controller_parameters.share=0.5 --out run --json"
    told = hexjet_beside(package, "fly", "roll-doublet", "--controller", "mine", *asked.split()).told
    own = json.loads(told)["own_controller"]
    assert (own["name"], own["version"], own["parameters"]) == ("mine", "my-controllers 1.2", {"share": 0.5})
    source.write_text(source.read_text() + "# edited\n")
    assert "controller mine is not the one that was flown" in hexjet_beside(package, "fly", "run/scenario.toml").err


@pytest.mark.parametrize("name", ["mine", "whole"])
def test_the_autopilot_flies_it_and_what_it_has_not_cannot_be_set(name: str, request: pytest.FixtureRequest) -> None:
    """The same steps as over our own; the built-in loops beside it are tuned by nobody."""
    controller, is_whole = request.getfixturevalue(name), name == "whole"
    hover = Scenario.load("hover").replace(duration_s=0.4, expect=[])

    def flown(controller: str) -> tuple[list[list[float]], Any]:
        with build(hover.replace(controller=controller)) as simulation:
            pilot = attach_autopilot(simulation, airborne=True)
            samples = [simulation.step() for _ in range(100)]
            return [[*s.state.position, *s.actuation.throttle] for s in samples], pilot

    ours, _ = flown("smith")
    theirs, pilot = flown(controller)
    # the page's predictor adds and takes away the measurement
    np.testing.assert_allclose(theirs, ours, rtol=0.0, atol=0.0 if is_whole else 1e-12)
    kept = {line.name: line.read_only for line in pilot.parameters}
    assert kept["HJ_PRED_TYPE"]
    assert not kept["HJ_YAW_RATE"]
    assert kept["HJ_ROLL_P"] == kept["HJ_CLIMB_P"] == is_whole
    meanings = dict(pilot.parameters.table["HJ_PRED_TYPE"].values)
    assert meanings[pilot.parameters["HJ_PRED_TYPE"]] == Path(controller).name


def test_a_notebook_is_shown_a_run_and_its_log_is_a_table() -> None:
    run = fly("hover", controller=Wrong)
    assert "flew" not in repr(run)
    assert repr(run) == "<Run hover: failed, 10 steps>"
    shown = run._repr_html_()
    assert "update gave None: must be throttles and tilts" in shown
    assert "<td>altitude.max_abs_error_m</td>" in shown
    table = dict(run.log)
    assert list(run.log) == list(table) == list(run.log.columns)
    assert {len(column) for column in table.values()} == {len(run.log)} == {10}
