"""Whose code runs: commands that look run none, commands that fly run what the user named, accepted or flew before."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import select
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from known_benches import Truth, bench_log
from patience import PATIENCE

import cosim
from cosim import fly
from cosim.base import trust
from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.campaign import open_campaign
from cosim.cli.main import main
from cosim.flight import record
from cosim.results.run import LOG, REPORT, SUMMARY, open_run
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario

REFUSED = "has code that has not been run before"
MARK = "import pathlib\n\n\ndef mark(word):\n    with open({mark!r}, 'a') as file:\n        file.write(word)\n\n\nmark('run ')\n"
CONTROLLER = """
class Mine:
    level = "predictor"
    parameters = (("share", 1.0, "", "of nothing", 0.0, 1.0),)

    def reset(self):
        pass

    def update(self, measured, applied):
        return measured
"""
METRIC = "\n\ndef worst(log, step_s):\n    mark('measured ')\n    return float(abs(log['roll_rad']).max())\n"
PROGRAM = """
import json, struct, sys
mark("begun ")
print(json.dumps({"level": "predictor"}), flush=True)
told = json.loads(sys.stdin.buffer.readline())
width = 8 * (1 + len(told["inputs"]))
while len(frame := sys.stdin.buffer.read(width)) == width:
    values = struct.unpack(f"={width // 8}d", frame)
    sys.stdout.buffer.write(struct.pack("=2d", values[0], values[1]))
    sys.stdout.buffer.flush()
"""
HOVER = 'name = "theirs"\nduration_s = 0.2\ncontroller = "baseline"\n'


@pytest.fixture(autouse=True)
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user who has flown nothing so far, and says nothing in the environment."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(trust.ENV_VAR, raising=False)
    monkeypatch.setattr(trust, "_decision", trust.TrustDecision())


def forget(tmp_path: Path) -> None:
    shutil.rmtree(tmp_path / "settings", ignore_errors=True)
    trust._decision = trust.TrustDecision()


def code(mark: Path, text: str) -> str:
    return MARK.format(mark=str(mark)) + text


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What somebody else has made: a folder with scenarios, a study and the code that they name, a run, a campaign."""
    folder = tmp_path_factory.mktemp("made") / "theirs"
    folder.mkdir()
    mark = folder.parent / "ran"
    (folder / "law.py").write_text(code(mark, "import helper\n" + CONTROLLER))
    (folder / "helper.py").write_text("SHARE = 1.0\n")
    (folder / "own.py").write_text(code(mark, METRIC))
    (folder / "program.py").write_text(code(mark, PROGRAM))
    shutil.copy(data_folder("fmus") / "edf-as-flown.fmu", folder / "their.fmu")
    with (folder / "their.fmu").open("ab") as file:  # no shipped one
        file.write(b"\0")
    (folder / "scenario.toml").write_text(f'{HOVER}metrics = ["own.py:worst"]\n'.replace("baseline", "law.py:Mine"))
    (folder / "engine.toml").write_text(f'{HOVER}engine = "their.fmu"\n')
    (folder / "process.toml").write_text(HOVER.replace("baseline", "process:program.py"))
    (folder / "study.toml").write_text(
        'name = "many"\nscenario = "scenario.toml"\ncontrollers = ["law.py:Mine"]\ndesign = "random"\nruns = 2\n'
        '[[vary]]\nkey = "controller_parameters.share"\nrange = [0.0, 1.0]\n'
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(folder.parent / "settings"))
        for command in (("fly", "scenario.toml", "--out", str(folder.parent / "run")),
                        ("sweep", "study.toml", "--workers", "1", "--out", str(folder.parent / "many"))):  # fmt: skip
            with pytest.raises(SystemExit) as end:
                main([command[0], str(folder / command[1]), *command[2:], "--trust"])
            assert end.value.code == 0
    assert "run measured " in mark.read_text()
    return folder.parent


@pytest.fixture
def mark(made: Path) -> Path:
    """Where code leaves a mark when it runs; there is none."""
    (made / "ran").unlink(missing_ok=True)
    return made / "ran"


@pytest.fixture
def theirs(made: Path, mark: Path, tmp_path: Path) -> Path:
    """The folder, as it was sent."""
    return Path(shutil.copytree(made / "theirs", tmp_path / "theirs"))


@pytest.fixture
def flown(made: Path, mark: Path, tmp_path: Path) -> Path:
    """The run and the campaign, as they were sent; nobody here has flown them."""
    for name in ("run", "many"):
        shutil.copytree(made / name, tmp_path / "box" / name)
    return tmp_path / "box"


def test_commands_that_look_run_nothing(flown: Path, mark: Path, hexjet: Hexjet, tmp_path: Path) -> None:
    shutil.copytree(flown / "run", flown / "other")
    run, many = str(flown / "run"), str(flown / "many")
    looks: list[Sequence[str]] = [
        ("show", run, "--page"), ("show", many, "--page"),
        ("compare", run, str(flown / "other"), "--out", str(tmp_path / "page")),
        *(("export", run, "--to", to) for to in ("csv", "mat", "ulog")), ("show",), ("show", "smith"),
    ]  # fmt: skip
    for words in looks:
        done = hexjet(*words)
        assert done.status == 0, (words, done.err)
        assert not mark.exists(), words
    trust.trust(flown)  # nor does it matter what the user trusts
    assert open_campaign(flown / "many").columns["own.worst"] != [None, None]
    assert not mark.exists()
    assert not (tmp_path / "settings").exists()


def test_the_page_of_a_campaign_says_what_is_stored(made: Path, flown: Path, mark: Path, hexjet: Hexjet) -> None:
    """Rows, metrics of one's own and the units of its parameters, without the code; campaigns from before 0.2.0 have no columns."""
    many = flown / "many"
    page = (many / REPORT).read_text(encoding="utf-8").replace(str(made / "many"), str(many))
    said = json.loads((many / "columns.json").read_text())
    assert (said["own"], [key["path"] for key in said["keys"]]) == (["own.worst"], ["controller_parameters.share"])
    assert hexjet("show", str(many), "--page").status == 0
    assert (many / REPORT).read_text(encoding="utf-8") == page
    (many / "columns.json").unlink()
    line = hexjet("show", str(many), "--page").refusal
    assert "columns.json is missing, as where it was written before version 0.2.0; open it with 0.2.0" in line
    assert not mark.exists()


@pytest.mark.parametrize(
    "text", ["", "[]", '{"own": 1, "keys": []}', '{"own": [], "keys": [{"path": "a"}]}', '{"own": "ab", "keys": []}']
)
def test_columns_that_are_none(text: str, flown: Path, hexjet: Hexjet) -> None:
    (flown / "many" / "columns.json").write_text(text)
    line = hexjet("show", str(flown / "many"), "--page").refusal
    assert "columns.json: not the columns of a campaign" in line
    stated = 'must be an object with "own", a list of names, and "keys", a list of objects with path, '
    assert not text or stated in line


def test_what_was_killed_is_finished_without_its_metric(
    theirs: Path, mark: Path, hexjet: Hexjet, tmp_path: Path
) -> None:
    trust.trust(theirs)
    with build(Scenario.load(theirs / "scenario.toml")) as simulation:
        recording = record(simulation, tmp_path / "killed")
        simulation.run([recording])
        recording._recorder.flush()
        recording._sink.close()  # type: ignore[union-attr]
    mark.unlink()
    forget(tmp_path)
    told = hexjet("show", "killed", "--page").told
    assert "metric own.py:worst: not measured: the flight was killed" in told
    assert not mark.exists()
    assert {LOG, SUMMARY} <= {path.name for path in (tmp_path / "killed").iterdir()}
    assert len(open_run(tmp_path / "killed").log) == 50


def test_a_page_of_the_folder_of_runs_compares_without_running(flown: Path, mark: Path) -> None:
    from cosim.api.compare import write_page

    shutil.copytree(flown / "run", flown / "other")
    write_page([str(flown / "run"), str(flown / "other")], flown / "comparison")
    with pytest.raises(InputError, match="nothing is run to look at something"):
        write_page([str(flown / "run"), f"{flown / 'many'}:0"], flown / "another")
    assert not mark.exists()


LAW = ("law.py", "own.py", "helper.py")
# What flies somebody else's code, and the files of it; THEIRS, RUN and MANY are folders.
COMMANDS = {
    "fly": ("fly THEIRS/scenario.toml", "THEIRS", LAW),
    "engine": ("fly THEIRS/engine.toml", "THEIRS", ("their.fmu",)),
    "process": ("fly THEIRS/process.toml", "THEIRS", ("program.py",)),
    "run": ("fly RUN/scenario.toml", "RUN", LAW),
    "sweep": ("sweep THEIRS/study.toml --workers 1", "THEIRS", LAW),
    "resume": ("sweep MANY --resume --workers 1", "MANY", LAW),
    "again": ("fly MANY --flight 0", "MANY", LAW),
    "compare": ("compare MANY:0 MANY:1", "MANY", LAW),
    "scenario": ("compare RUN THEIRS/scenario.toml", "THEIRS", LAW),
    "search": ("search THEIRS/scenario.toml --vary vehicle.mass_kg=5.5:5.6:2 --workers 1", "THEIRS", LAW),
}


@pytest.mark.parametrize("which", COMMANDS)
def test_what_flies_asks_for_trust_once_and_again_for_another_byte(
    which: str, theirs: Path, flown: Path, mark: Path, hexjet: Hexjet, tmp_path: Path
) -> None:
    folders = {"THEIRS": theirs, "RUN": flown / "run", "MANY": flown / "many"}
    asked, owner, names = COMMANDS[which]
    for name, folder in folders.items():
        asked = asked.replace(name, str(folder))
    out, files = tmp_path / "out", [folders[owner] / name for name in names]
    words = [*asked.split(), *(() if which == "resume" else ("--out", str(out)))]

    def refused(by: Path) -> None:
        mark.unlink(missing_ok=True)
        line = hexjet(*words).refusal
        is_edited = which in ("again", "compare") and "changed since its first flight" in line
        assert is_edited or (f"{by.parent} (" in line and f": {REFUSED}" in line and "--trust" in line)
        assert not mark.exists()
        assert not out.exists()

    def flies(*more: str) -> None:
        done = hexjet(*words, *more)
        assert (done.status, done.err) == (0, "")
        shutil.rmtree(out, ignore_errors=True)

    refused(files[0])
    flies("--trust")
    flies()  # it is remembered
    for file in files[: None if which == "fly" else 1]:
        before = file.read_bytes()
        file.write_bytes(before + b"\n")
        refused(file)
        file.write_bytes(before)


def test_what_the_user_names_is_his_and_so_are_his_runs(
    theirs: Path, mark: Path, hexjet: Hexjet, tmp_path: Path
) -> None:
    """Folders of files on the command line are not asked for; nor is the run that is made with them."""
    shutil.copytree(theirs, tmp_path / "mine")  # the folder that the command is called in
    (tmp_path / "mapped.toml").write_text('fmu = "mine/their.fmu"\n')
    named = ["--controller", "mine/law.py:Mine", "--metric", "mine/own.py:worst", "--engine", "mapped.toml"]
    assert hexjet("fly", "hover", "--set", "duration_s=0.2", *named, "--out", "run").status == 0
    assert hexjet("fly", "run/scenario.toml", "--out", "again").status == 0
    words = ["--vary", "vehicle.mass_kg=5.5,5.6", "--set", "duration_s=0.2", "--workers", "1", "--out", "many"]
    assert hexjet("sweep", "hover", *words, *named[:4]).status == 0
    assert hexjet("fly", "many", "--flight", "0").status == 0
    remembered = (tmp_path / "settings" / "hexjet" / trust.TRUSTED_LIST).read_text().splitlines()
    names = [str(Path(line[66:]).relative_to(tmp_path)) for line in remembered]
    assert names.count("mine") == 1
    assert {"mine", "run", "many"} <= set(names)


def test_the_engine_of_a_named_aircraft_is_asked_for(theirs: Path, hexjet: Hexjet, tmp_path: Path) -> None:
    """Who names a folder has not named what it names in turn."""
    assert hexjet("aircraft", "new", "drone").status == 0
    give_engine(tmp_path / "drone", "their.fmu")
    shutil.copy(theirs / "their.fmu", tmp_path / "drone" / "their.fmu")
    for words in (("fly", "hover", "--aircraft", "./drone"), ("aircraft", "check", "./drone")):
        line = hexjet(*words).refusal
        assert REFUSED in line
        assert "their.fmu" in line


def give_engine(folder: Path, engine: str) -> None:
    """State the engine of the vehicle in this folder."""
    text, count = re.subn('(?m)^engine = ".*"$', f'engine = "{engine}"', (folder / "vehicle.toml").read_text())
    assert count == 1
    (folder / "vehicle.toml").write_text(text)


def test_an_engine_that_an_identification_wrote_is_flown_without_a_question(hexjet: Hexjet, tmp_path: Path) -> None:
    times, throttle, thrust, _ = bench_log("stairs of 2 s", 50.0, Truth(gain=20.0, offset=1.0), noise=0.1)
    rows = np.column_stack([times, throttle, thrust])
    np.savetxt(tmp_path / "bench.csv", rows, "%.9g", ",", header="time_s,throttle,thrust_N", comments="")
    assert hexjet("engine", "from-bench", "bench.csv", "--out", "my-engine").status == 0
    assert hexjet("aircraft", "new", "gryphon").status == 0
    give_engine(tmp_path / "gryphon", "../my-engine/engine.toml")
    asked = "fly hover --aircraft ./gryphon --set duration_s=0.1 --controller baseline"
    for status in (0, 2):
        done = hexjet(*asked.split())
        assert (done.status, REFUSED in done.err) == (status, status == 2), done.err
        forget(tmp_path)


def test_a_terminal_is_asked_once_for_all(
    theirs: Path, mark: Path, hexjet: Hexjet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    answers = iter([False, True])

    def ask(folders: Sequence[str]) -> bool:
        asked.extend(folders)
        return next(answers)

    monkeypatch.setattr("cosim.cli.main.trust_prompt", lambda: ask)
    assert hexjet("fly", str(theirs / "scenario.toml")).status == 2
    assert not mark.exists()
    assert hexjet("fly", str(theirs / "scenario.toml")).status == 0
    assert hexjet("fly", str(theirs / "scenario.toml")).status == 0
    assert asked == 2 * [f"{theirs} (law.py, own.py)"]


def test_a_compiled_copy_is_not_what_was_looked_at(theirs: Path, mark: Path, hexjet: Hexjet) -> None:
    """Python would run it in place of the source beside which it lies, without a look at that; none is left there."""
    program = theirs / "program.py"
    program.write_text("import helper\n" + program.read_text())
    assert hexjet("fly", str(theirs / "process.toml"), "--trust").status == 0
    assert not (theirs / "__pycache__").exists()
    helper = theirs / "helper.py"
    text = compile(code(mark, "SHARE = 1.0\nmark('compiled ')\n"), str(helper), "exec")
    cached = theirs / "__pycache__" / f"helper.{sys.implementation.cache_tag}.pyc"
    cached.parent.mkdir()
    from importlib._bootstrap_external import _code_to_hash_pyc  # type: ignore[import-not-found]

    cached.write_bytes(_code_to_hash_pyc(text, importlib.util.source_hash(helper.read_bytes()), False))
    done = hexjet("fly", str(theirs / "process.toml"))
    assert done.status == 0, done.err
    assert "compiled" not in mark.read_text()


def test_settings_that_cannot_be_written_forget(theirs: Path, hexjet: Hexjet, tmp_path: Path) -> None:
    """The flight and its workers have the decision all the same."""
    (tmp_path / "settings").write_text("a file")
    words = ("sweep", str(theirs / "study.toml"), "--workers", "1")
    assert hexjet(*words, "--trust", "--out", "a").status == 0
    assert set(open_campaign("a").columns["outcome"]) == {"completed"}
    assert hexjet(*words, "--out", "b").status == 2


def test_a_program_names_its_own_code_and_not_that_of_files(theirs: Path, mark: Path, tmp_path: Path) -> None:
    path = theirs / "scenario.toml"
    for attempt in (lambda: fly(path), lambda: fly(Scenario.load(path)), lambda: cosim.Stepper(path)):
        with pytest.raises(InputError, match=REFUSED):
            attempt()
    assert not mark.exists()
    hover = Scenario.load("hover").replace(duration_s=0.2, expect=[])
    assert fly(hover, controller=f"{theirs / 'law.py'}:Mine").outcome == "completed"
    assert fly(hover.replace(metrics=[f"{theirs / 'own.py'}:worst"])).outcome == "completed"
    assert fly(path).outcome == "completed"  # what was flown is remembered
    with pytest.raises(InputError, match=r"trust: .*absent: is not there"):
        cosim.trust(tmp_path / "absent")


def test_the_environment_trusts(theirs: Path, hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(trust.ENV_VAR, "0")
    assert hexjet("fly", str(theirs / "scenario.toml")).status == 2
    monkeypatch.setenv(trust.ENV_VAR, "1")
    assert hexjet("fly", str(theirs / "scenario.toml")).status == 0


def test_a_real_terminal_names_the_folder(theirs: Path, mark: Path) -> None:
    words = [sys.executable, "-c", "from cosim.cli.main import main; main()", "fly", str(theirs / "scenario.toml")]
    ours, terminal = os.openpty()
    asked = subprocess.Popen(words, stdin=terminal, stdout=terminal, stderr=terminal, cwd=theirs)
    os.close(terminal)
    said = ""
    while "remember it? [y/N]: " not in said:
        assert select.select([ours], [], [], PATIENCE)[0], said
        assert len(said) < 10_000, said  # a bar draws for ever
        said += os.read(ours, 65536).decode()
    redrawn = said.rpartition("[y/N]: ")[2]
    if select.select([ours], [], [], 0.5)[0]:  # a bar would draw over the question ten times a second
        redrawn += os.read(ours, 65536).decode()
    assert redrawn == ""
    os.write(ours, b"n\n")
    assert asked.wait(PATIENCE) == 2
    os.close(ours)
    assert f"{theirs} (law.py, own.py)" in " ".join(said.split())
    assert not mark.exists()
