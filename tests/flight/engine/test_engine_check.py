"""``engine check`` and the measurements behind it."""

from __future__ import annotations

import base64
import itertools
import json
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from engine_tools import NEWTON_PER_KGF, PAPER, STEP, archive, edit_description, paper_thrust
from long_cases import long_case

from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.engine import CheckReport, check_fmu, list_engine_names, load_engine
from cosim.engine.check_report import QUESTIONS
from cosim.engine.library import build_all
from cosim.engine.response import (
    Hold,
    ResponseError,
    measure_static_curve,
    measure_step_response,
    settle,
    settling_window,
)
from cosim.results.report.engine_check import write_check

pytestmark = pytest.mark.usefixtures("built_engines")


@cache
def checked(name: str) -> CheckReport:
    """The check of an engine of the library, once for all tests."""
    return check_fmu(name)


@pytest.mark.parametrize(
    ("name", "suffix"),
    [
        *((name, "") for name in list_engine_names()),
        # the same C source behind the other adapter
        *((name, "-fmi2") if name in PAPER else long_case((name, "-fmi2")) for name in list_engine_names()),
    ],
)
def test_the_library_is_sound(name: str, suffix: str) -> None:
    report = checked(name + suffix)
    assert (report.ok, report.problems, report.notes) == (True, [], [])
    assert report.answers == dict.fromkeys(QUESTIONS, True)
    assert report.thrust is not None
    spec = load_engine(name + suffix, {}, report.step)
    assert tuple(report.thrust) == spec.curve.thrust  # measured in two processes by the same steps


@pytest.mark.parametrize("suffix", ["", "-fmi2"])
@pytest.mark.parametrize("name", PAPER)
def test_delay_and_rise_are_the_papers(name: str, suffix: str) -> None:
    report = checked(name + suffix)
    assert report.delay_samples_up == report.delay_samples_down == PAPER[name][2]
    # when the paper's transfer function comes to 10 and 90 %, interpolated between samples by numpy
    thrust = np.concatenate([[0.0], paper_thrust(name, np.ones(6000))])
    tenth, nine_tenths = np.interp([0.1 * thrust[-1], 0.9 * thrust[-1]], thrust, np.arange(len(thrust)) * STEP)
    for way in ("up", "down"):
        assert getattr(report, f"tenth_{way}") == pytest.approx(tenth, rel=1e-9)
        assert getattr(report, f"rise_time_{way}") == pytest.approx(nine_tenths - tenth, rel=1e-9)
    assert report.course_up is not None
    assert report.course_step_up == STEP  # no point is left out of a short course
    np.testing.assert_allclose(report.course_up, thrust[: len(report.course_up)], rtol=0.0, atol=1e-9)


def test_a_turbine_answers_up_and_down_in_its_own_way() -> None:
    """The P220 spools down faster than up, as its identified equation says and its README shows."""
    report = checked("p220")
    assert (report.rise_time_down or 1e9) < 0.7 * (report.rise_time_up or 0.0)


def test_a_check_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    check_fmu("edf")
    assert capfd.readouterr() == ("", "")


def test_the_report_is_plain_json_and_readable_lines() -> None:
    report = checked("edf-as-flown")
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert data["ok"] is True
    assert [v["name"] for v in data["outputs"]] == ["thrust"]
    assert data["inputs"][0] == {
        "name": "throttle", "type": "Float64", "unit": "1", "min": 0.0, "max": 1.0, "start": 0.0,
        "description": "Throttle, limited to 0..1 where it enters the engine",
    }  # fmt: skip
    assert data["ports"][0] == {
        "port": "throttle", "name": "throttle", "unit": "1", "from": 0.0, "to": 1.0, "found": "in engine.toml",
        "scale": 1.0, "offset": 0.0, "si": "1",
    }  # fmt: skip
    assert {
        "static thrust [N]": "0: 0, 0.2: 4.001, 0.4: 8.002, 0.6: 12.003, 0.8: 16.004, 1: 20.005",
        "throttle up": "delay 25 samples (0.1 s), 10 % after 0.1032 s, then 10 to 90 % in 0.06571 s",
        "thrust": "thrust [N], found in engine.toml",
        "runs six at once": "yes",
    }.items() <= dict(report.lines()).items()


def test_the_page_shows_curve_and_response(tmp_path: Path) -> None:
    report = checked("edf-as-flown")
    page = write_check(report, tmp_path / "checked").read_text()
    assert json.loads((tmp_path / "checked" / "check.json").read_text()) == json.loads(json.dumps(report.to_dict()))
    assert "fit to fly" in page
    assert re.findall(r'data-figure="(\w+)"', page) == ["curve", "response"]
    response = json.loads(dict(re.findall(r'id="figure-(\w+)">(.*?)</script>', page))["response"])
    drawn = [np.frombuffer(base64.b64decode(trace["y"]["bdata"])).tolist() for trace in response["data"]]
    assert drawn == [report.course_up, report.course_down]
    assert [shape["x0"] for shape in response["layout"]["shapes"]] == [0.1, 0.1]


def test_what_is_left_unsaid_is_noted(tmp_path: Path) -> None:
    path = edit_description(archive("edf", 3), tmp_path / "a.fmu", ' unit="N" min="0.0" />\n    <F', " />\n    <F")
    stated = ' unit="1" min="0.0" max="1.0" start="0.0" />\n    <F'
    report = check_fmu(str(edit_description(path, tmp_path / "b.fmu", stated, ' start="0" />\n    <F')))
    assert report.ok
    assert sorted(report.notes) == [
        "reports no fuel flow: the tank of a vehicle stays full with it",
        "throttle states no range; it is taken to run from 0 to 1",
        "thrust states no unit; it is taken to be in N",
    ]


@pytest.fixture
def mapped(tmp_path: Path) -> Callable[[str], str]:
    """A mapping file of an EDF with these lines."""
    shutil.copy(archive("edf", 2), tmp_path / "their.fmu")

    def write(lines: str) -> str:
        (tmp_path / "map.toml").write_text(f'fmu = "their.fmu"\n{lines}')
        return str(tmp_path / "map.toml")

    return write


def test_a_mapping_file_is_checked_with_what_it_states(mapped: Callable[[str], str]) -> None:
    lines = '[ports]\nthrust = "thrust"\n[range]\nthrottle = [0.5, 1.0]\n[parameters]\ngain = 0.5\n'
    report = check_fmu(mapped(lines))
    assert report.problems == []
    gain = 0.5 / (1.0 - PAPER["edf"][1]) * NEWTON_PER_KGF
    assert report.thrust is not None
    assert (report.thrust[0], report.thrust[-1]) == pytest.approx((0.5 * gain, gain))
    assert [(each["port"], each["from"], each["to"], each["found"]) for each in report.ports[:2]] == [
        ("throttle", 0.5, 1.0, "by its name"),
        ("thrust", None, None, "in the mapping file"),
    ]


def test_the_report_has_the_parameters_that_were_measured(mapped: Callable[[str], str], tmp_path: Path) -> None:
    """Not the FMU's own where others were given: by a mapping file, and over that by the call."""
    report = check_fmu(mapped("[parameters]\ngain = 0.5\npole = 0.9\n"), parameters={"gain": 0.25})
    assert report.thrust is not None
    assert report.thrust[-1] == pytest.approx(0.25 / (1.0 - 0.9) * NEWTON_PER_KGF)
    values = {each["name"]: (each["start"], each["value"]) for each in report.parameters}
    gain, pole, _ = PAPER["edf"]
    assert {"gain": (gain, 0.25), "pole": (pole, 0.9), "delay_samples": (0.0, 0.0)}.items() <= values.items()
    page = write_check(report, tmp_path / "checked").read_text()
    assert f"gain = 0.25, from {gain:g}, " in page
    first = json.loads((tmp_path / "checked" / "check.json").read_text())["parameters"][0]
    assert (first["name"], first["value"]) == ("gain", 0.25)


def test_what_fmpy_says_against_dependencies_that_nothing_reads_is_a_note(tmp_path: Path) -> None:
    """Some exporters leave them out, or count them wrongly."""
    old = '<Output valueReference="2" dependencies="" />'
    wrong = '<Output valueReference="2" dependencies="" dependenciesKind="dependent" />'
    for new, said in (
        ("", 'ModelStructure/Outputs must have exactly one entry for each variable with causality="output".'),
        (wrong, "number of elements in the dependencies and dependenciesKind attributes"),
    ):
        report = check_fmu(str(edit_description(archive("edf", 3), tmp_path / "x.fmu", old, new)))
        assert report.problems == []
        assert any(said in note for note in report.notes)


def test_an_engine_with_memory_it_does_not_own_is_found_out(tmp_path: Path) -> None:
    """It leaks a static variable into its thrust at one throttle, and its static thrust has a hump."""
    engines = Path(shutil.copytree(data_folder("engines"), tmp_path / "engines"))
    source = engines / "delayed_lag.c"
    head, _, tail = source.read_text().rpartition("v->thrust = v->newton_per_unit * s->y;\n}\n")
    assert not tail
    leaks = "static double leak = 0.0;\nleak += v->throttle == 7.0 / 19.0 ? 0.001 : 0.0;\n"
    hump = "v->newton_per_unit * s->y * (1.5 - v->gain / (1.0 - v->pole) * 0.4 * s->y / 2.04)"
    source.write_text(f"{head}{leaks}v->thrust = {hump} + leak;\n}}\n")
    for path in build_all(engines, tmp_path / "fmus", ["edf"]):
        assert check_fmu(str(path)).problems == [
            "its thrust does not rise with the throttle: 13.79 N at 0.9, 13.78 N at 0.95",
            "six of it at once do not answer as one alone: they are not independent",
        ]


def test_what_cannot_be_loaded_cannot_be_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        check_fmu(str(tmp_path / "nowhere.fmu"))
    said = r"step 0\.005 s is not a whole multiple of the engine's internal step 0\.004 s"
    with pytest.raises(InputError, match=said):
        check_fmu("edf", step=0.005)


def engine(law: Callable[[float, int], float], lag: float = 0.9, delay: int = 0) -> Hold:
    """``hold`` of an engine whose thrust follows ``law(throttle, k)`` with a lag and a delay."""
    state = {"y": law(0.0, 0)}
    line = [0.0] * delay
    count = itertools.count()

    def hold(throttle: float, steps: int) -> list[float]:
        thrusts = []
        for _ in range(steps):
            line.append(throttle)
            state["y"] += (1.0 - lag) * (law(line.pop(0), next(count)) - state["y"])
            thrusts.append(state["y"])
        return thrusts

    return hold


@pytest.mark.parametrize("delay", [0, 1, 63, 64, 65, 700])
def test_any_delay_is_measured(delay: int) -> None:
    response = measure_step_response(engine(lambda u, k: 10.0 * u, delay=delay), 0.0, 1.0, STEP)
    assert response.delay == delay
    assert response.after == pytest.approx(10.0, abs=1e-7)
    # ln 9 time constants, as far as straight lines between samples follow the exponential
    assert response.rise == pytest.approx(np.log(9.0) * -STEP / np.log(0.9), rel=2e-3)


def test_a_curve_with_an_idle_thrust() -> None:
    hold = engine(lambda u, k: 3.0 + 5.0 * u * u)
    assert settle(hold, 0.0, 50, STEP) == pytest.approx(3.0)
    measure_step_response(hold, 3.0, 1.0, STEP)
    curve = measure_static_curve(hold, settling_window(0), STEP)
    np.testing.assert_allclose(curve.thrust, 3.0 + 5.0 * np.square(curve.throttle), atol=1e-7)


def test_an_engine_that_never_stands_still() -> None:
    with pytest.raises(ResponseError, match=r"thrust does not settle within 180 s at throttle 0\.5"):
        settle(engine(lambda u, k: 10.0 * u + (k % 2), lag=0.5), 0.5, 50, STEP)


@pytest.mark.parametrize(
    ("law", "rest", "said"),
    [
        (lambda u, k: 10.0 * u + (k % 2), 0.0, "does not settle"),
        (lambda u, k: 2.0, 2.0, "thrust does not answer the throttle within 10 s"),
        (lambda u, k: 1.0 if 20 < k < 40 else 0.0, 0.0, "thrust is the same at throttle 0 and 1"),
    ],
    ids=["restless", "dead", "comes back"],
)
def test_an_engine_without_a_response(law: Callable[[float, int], float], rest: float, said: str) -> None:
    with pytest.raises(ResponseError, match=said):
        measure_step_response(engine(law), rest, 1.0, STEP)
