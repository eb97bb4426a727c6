"""The functions of the package: one path with the commands, wrong arguments in a line, results that show themselves."""

from __future__ import annotations

import ast
import html
import inspect
import json
import linecache
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command_tools import Hexjet
from patience import PATIENCE
from places import DOCS, ROOT

import cosim
from cosim import InputError
from cosim.api import Progress, Result
from cosim.api.call.choices import list_engine_notes
from cosim.base.errors import Notice
from cosim.cli import table
from cosim.cli.main import run as run_command
from cosim.spec.scenario import Scenario
from cosim.spec.scenario.changes import Changes
from hexjet_prove.surveys.failsafes import WINDS_M_S

PUBLIC = runpy.run_path(str(DOCS / "api.py"))["MODULES"]
CALLS = (
    "compare", "design", "export", "export_controller", "export_vehicle", "failsafes", "faults",
    "identify", "identify_bench", "identify_log", "margins", "prove", "rare", "replay", "search", "show", "sweep",
    "validate",
)  # fmt: skip


def test_a_changed_model_of_an_engine_that_does_not_fly_is_noted(tmp_path: Path) -> None:
    changed = Scenario.load("hover", settings={"vehicle.identified.edf.roll.gain": 0.05})
    assert list_engine_notes(changed) == ["vehicle.identified.edf: that engine does not fly"]
    run = cosim.fly("hover", settings={"duration_s": 0.1}, out=tmp_path / "run")
    assert list_engine_notes(Scenario.load(run.folder / "scenario.toml")) == []  # it states all models


@pytest.mark.parametrize("name", CALLS)
def test_a_call_is_typed_and_refuses_a_name_that_is_none(name: str) -> None:
    call = getattr(cosim, name)
    signature = inspect.signature(call)
    assert signature.return_annotation not in (inspect.Signature.empty, "Any")
    assert all(each.annotation is not inspect.Parameter.empty for each in signature.parameters.values())
    near, meant = ("ou", "out") if "out" in signature.parameters else ("kin", "kind")
    with pytest.raises(InputError, match=rf"^{name}: no argument '{near}'; did you mean '{meant}'\? "):
        call("hover", **{near: "x"})


@pytest.mark.parametrize(
    ("name", "arguments", "options", "line"),
    [
        ("sweep", (42,), {}, "sweep: name: 42 is a value of type int; allowed: str | Path"),
        ("sweep", ("hover",), {"runs": "x"}, "sweep: runs: 'x' is a value of type str; allowed: int | None"),
        ("sweep", ("hover",), {"settings": {"seed": object}}, "settings: seed: <class 'object'> is no number, text"),
        ("sweep", (), {}, "sweep: missing a required argument: 'name'"),
        ("identify", ("rol",), {}, "identify: subject: 'rol': did you mean 'roll'? allowed: engine, pitch, roll, yaw"),
        ("identify", ("engine",), {}, "identify: engine: name which"),
        ("design", (), {"out": __file__}, f"out: {__file__}/controller.toml: cannot be written to: "),
        ("compare", ("a",), {}, "compare: 1 flight; allowed: 2 to 8"),
        ("search", ("hover",), {"within": 3.0}, "within: goes with worst or likely"),
        ("search", ("hover",), {"seeds": 0}, "search: seeds: 0; allowed: at least 1, at most 10000"),
        ("margins", (), {"from_hz": float("nan")}, "margins: from_hz: nan is no finite number"),
        ("margins", (), {"out": __file__}, f"{__file__}: is a file; name a folder as out"),
        ("identify", ("roll",), {"lags": 0}, "identify: lags: 0; allowed: at least 1 of an axis"),
        ("identify_log", ("a.ulg",), {}, "identify_log: say axis (roll, pitch or yaw) or engine"),
        ("identify_bench", (), {}, "identify_bench: logs: name one at least"),
        ("identify_bench", ("a.csv",), {"fit": ["lag"]}, "identify_bench: fit and settings are for an engine's"),
        (
            "failsafes",
            ("quadrotor",),
            {"kinds": ["nonesuch"]},
            "no failsafe begins with 'nonesuch'; there are: GNSS lost, ",
        ),
        ("sweep", ("hover",), {"out": "a\0b"}, "sweep: out: 'a\\x00b' has a zero in it, and is no name"),
        ("sweep", ("hover",), {"vary": ["vehicle.mass_kg=5:6"], "runs": 2, "workers": 0}, "workers = 0: at least 1"),
    ],
)
def test_a_wrong_argument_is_one_line(name: str, arguments: tuple[object, ...], options: dict, line: str) -> None:
    with pytest.raises(InputError) as error:
        getattr(cosim, name)(*arguments, **options)
    assert str(error.value).startswith(line)


def test_failsafes_without_winds_are_those_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    winds = []

    def plan(aircraft: object, engine: object, controller: object, kinds: object, conditions: Any) -> Any:
        winds.append(conditions.winds)
        raise InputError("enough")

    monkeypatch.setattr("hexjet_prove.surveys.failsafes.plan_failsafes", plan)
    for given in ({}, {"winds": []}, {"winds": [3.0]}):
        with pytest.raises(InputError, match="enough"):
            cosim.failsafes(**given)
    assert winds == [WINDS_M_S, WINDS_M_S, (3.0,)]


@pytest.mark.parametrize("command", ["fly hover", "sweep hover --vary vehicle.mass_kg=5,6", "gcs --mavlink none"])
def test_an_engine_in_this_process_is_noted(command: str, hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise InputError("enough")

    engine = str(ROOT / "fmus" / "edf.fmu")
    for flies in ("cosim.flight.fly_watched", "cosim.campaign.run.run_campaign"):
        monkeypatch.setattr(flies, stop)
    done = hexjet(*command.split(), "--engine", engine, "--controller", "baseline", "--set", "engine_isolated=false")
    assert f"{engine}: isolated = false: a crash or a hang of its library ends the process that flies it" in done.err
    assert "edf: that engine does" in hexjet(*command.split(), "--set", "vehicle.identified.edf.roll.gain=1").err


def test_a_note_is_a_warning_at_the_line_of_the_caller() -> None:
    late = Scenario.load("roll-doublet").replace(duration_s=0.1, engine_parameters={"delay_samples": 40}, expect=[])
    with pytest.warns(Notice) as said:
        run = cosim.fly(late, controller="smith")
    assert {str(each.message) for each in said} == {
        *run.summary.notes,
        "scenario roll-doublet: command.0 begins at 1 s and the flight ends at 0.1 s",
    }
    assert any("all delay 35.3 samples, and 49.3 by engine" in note for note in run.summary.notes)
    assert html.escape(run.summary.notes[0]) in run._repr_html_()
    with pytest.warns(Notice) as noted:
        Progress().note("one")
    for each, call in [*((each, "cosim.fly(late") for each in said), (noted[0], 'Progress().note("one")')]:
        assert call in linecache.getline(each.filename, each.lineno)


def test_an_import_loads_no_more_than_it_needs() -> None:
    code = "import sys; before = set(sys.modules); from cosim import fly; print(*sys.modules.keys() - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=PATIENCE)
    loaded = set(done.stdout.split())
    assert "cosim.base.errors" in loaded
    assert loaded & {"click", "inspect", "numpy", "pydantic"} == set()


def test_a_package_that_is_called_stays_a_package() -> None:
    from cosim.identify import identify_engine

    assert cosim.identify.identify_engine is identify_engine
    assert cosim.identify is sys.modules["cosim.identify"]
    assert callable(cosim.design)


def test_what_is_shown_is_what_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    assert cosim.show(ROOT / "docs" / ".." / "aircraft" / "hexjet").verdict.endswith("on two tilting banks")
    shown = cosim.show("roll-doublet")
    run_command(["show", "roll-doublet", "--json"])
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(shown.to_list()))
    assert str(shown).startswith("roll-doublet, scenario: ")
    assert "<td>duration_s</td>" in shown._repr_html_()
    assert shown.folder is None


def test_a_result_says_where_its_files_are_and_escapes_what_it_shows(tmp_path: Path) -> None:
    class Found(Result):
        def __init__(self) -> None:
            self.files = {"report": tmp_path / "report.html"}

        def lines(self) -> list[str]:
            return ["a < b", "and c"]

    found = Found()
    assert repr(found) == f"<Found: a < b, {tmp_path}>"
    assert "<b>a &lt; b</b>" in found._repr_html_()
    assert f'href="{tmp_path}/report.html"' in found._repr_html_()


_STATE = """
import os, sys, signal, warnings, logging, locale, multiprocessing
def state():
    handlers = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    roots = list(logging.root.handlers), logging.root.level
    filters = [each for each in warnings.filters if "numpy" not in repr(each)]  # numpy's own are its business
    return (handlers, filters, warnings.showwarning, roots, locale.setlocale(locale.LC_ALL),
            dict(os.environ), list(sys.path), sys.excepthook, sys.flags.dev_mode, sys.getswitchinterval(),
            multiprocessing.get_start_method(allow_none=True), sys.getrecursionlimit(), os.getcwd(), os.umask(18))
os.umask(18)
before = state()
import cosim
[getattr(cosim, name) for name in cosim.__all__]
after = state()
import numpy
changed = [n for n, (a, b) in enumerate(zip(before, after)) if a != b]
assert not changed, changed
assert numpy.geterr() == {"divide": "warn", "over": "warn", "under": "ignore", "invalid": "warn"}
assert "matplotlib" not in sys.modules
"""


def test_importing_everything_changes_nothing_of_the_caller() -> None:
    """Signals, warnings, logging, locale, environment, search path, how processes start, numpy's errors."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    done = subprocess.run(
        [sys.executable, "-c", _STATE], capture_output=True, text=True, timeout=PATIENCE, env=environment
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "options", "line"),
    [
        ((42,), {}, "fly: scenario: 42 is a value of type int; allowed: Scenario | str | Path"),
        (("a\0b",), {}, "fly: scenario: 'a\\x00b' has a zero in it, and is no name"),
        (("hover",), {"realtime_factor": -1}, "fly: realtime_factor: -1; allowed: above 0"),
    ],
)
def test_a_flight_that_cannot_be_meant_is_one_line(arguments: tuple[Any, ...], options: dict, line: str) -> None:
    with pytest.raises(InputError) as error:
        cosim.fly(*arguments, **options)
    assert str(error.value).startswith(line)


@pytest.mark.parametrize("what", [3, [], "runs/a", [1]])
def test_what_is_no_run_is_not_drawn(what: Any) -> None:
    with pytest.raises(InputError, match=r"^plot: .*allowed: a Run, or a sequence of some$"):
        cosim.plot(what)


def test_what_changes_a_scenario_is_typed_with_its_keys() -> None:
    assert Changes.__annotations__.keys() == Scenario.model_fields.keys()


def test_records_show_themselves_on_one_line_and_as_tables() -> None:
    run = cosim.fly(Scenario.load("hover").replace(duration_s=0.1, expect=[]))
    for shown, begins in (
        (run.scenario, "<Scenario hover: hexjet, engine "),
        (run.summary, "<Summary hover: completed, nothing checked; flew 25 steps"),
        (run.log, "<MemoryLog: 25 steps, "),
        (run, "<Run hover: completed, 25 steps>"),
    ):
        assert repr(shown).startswith(begins)
        assert len(repr(shown)) < 200
        assert "</table>" in shown._repr_html_()
    assert "roll_rad" in run.log._ipython_key_completions_()


PAGES = [ROOT / "README.md", *(DOCS / f"{name}.md" for name in ("tutorial", "python", "metrics", "prove"))]


@pytest.mark.parametrize("path", [*sorted((ROOT / "examples").glob("*.py")), *PAGES], ids=lambda path: path.stem)
def test_an_example_imports_what_is_public(path: Path) -> None:
    """As the paper and the benchmarks do, which the import contracts hold."""
    public = {"cosim", "cosim.base.protocols", *(f"cosim.{name}" for name in PUBLIC)}
    text = path.read_text(encoding="utf-8")
    code = text if path.suffix == ".py" else "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    tree = ast.parse(code)
    assert code
    imported = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imported |= {each.name for node in ast.walk(tree) if isinstance(node, ast.Import) for each in node.names}
    assert {name for name in imported if name.partition(".")[0] == "cosim"} <= public


def test_the_page_has_the_function_of_every_command_or_says_why_there_is_none() -> None:
    page = re.sub(r"```.*?```", "", (DOCS / "python.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    names = {name for name in table.list_names() if name.partition(" ")[0] in ("aircraft", "engine")}
    names |= {name.partition(" ")[0] for name in table.list_names()} - {"aircraft", "engine"}
    named = re.findall(r"`([^`]+)`", page)
    assert [name for name in sorted(names) if not any(each.split("(")[0].startswith(name) for each in named)] == []
    functions = {name for name in cosim.__all__ if inspect.isroutine(getattr(cosim, name))} - {
        "load_vehicle",
        "versions",
    }
    assert [name for name in functions if not re.search(rf"\b{name}\b", page)] == []
