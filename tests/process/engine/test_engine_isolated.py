"""Engines in a process of their own: the same flight bit for bit, and a named end whatever an FMU does."""

from __future__ import annotations

import os
import pickle
import re
import shutil
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from broken_fmus import Kit, packed
from campaign_tools import study, without_chance
from engine_tools import STEP
from foreign_engines import force, foreign, lever, mapped

from cosim import Scenario, fly
from cosim.base.errors import EngineError, InputError
from cosim.base.runtime.pipes import Pipes
from cosim.base.signals import Ambient
from cosim.campaign.study.plan import flights
from cosim.campaign.workers.flight_row import fly_one
from cosim.engine import EngineBank, IsolatedBank, bank, isolated, load_engine, measure
from cosim.engine.qualify import check
from cosim.engine.qualify.supervisor import ChildResult
from cosim.identify.sweep import identify_engine
from cosim.results.log.digest import log_digest


def test_a_bank_apart_gives_the_same_numbers() -> None:
    """With air and without, and with a switch."""
    spec = load_engine("turbine-20", {}, STEP)
    throttle = np.random.default_rng(1).uniform(0.0, 1.0, (50, 2))
    runs = []
    with EngineBank(spec, 2, STEP) as inside:
        apart = IsolatedBank([spec, spec], STEP)
        try:
            assert apart.wants_ambient == inside.wants_ambient
            for bank in (inside, apart):
                rows = [bank.reset((0.4, 0.5))]
                for k, each in enumerate(throttle):
                    air = Ambient(95000.0 + k, 280.0, (3.0, 4.0)) if k % 2 else None
                    rows.append(bank.step(k, tuple(each), air))
                rows.append((bank.set_run(0, False),))  # type: ignore[arg-type]
                runs.append(repr(rows))
            with pytest.raises(ValueError, match="is next"):
                apart.step(3, (0.1, 0.1))
        finally:
            apart.close()
            apart.close()
    assert runs[0] == runs[1]


def test_a_flight_is_the_same_with_its_engines_apart() -> None:
    scenario = Scenario.load("hover").replace(duration_s=1.0, expect=[])
    one, other = (fly(scenario.replace(engine_isolated=apart)) for apart in (False, True))
    assert log_digest(one.log) == log_digest(other.log)


LITTLE = isolated._SERVE.replace("serve(*", "import cosim.engine.isolated as it; it.MAX_MEGABYTES = 150.0; serve(*")


@pytest.mark.parametrize(
    ("made_of", "said"),
    [
        ("lag=0.1,crashes=1", r"engines \(crashes.fmu\): its process crashed \(SIGSEGV\) at step 1\d\d \(0\.\d+ s\)"),
        ("lag=0.1,hangs=1", r"engines \(hangs.fmu\): no answer within 0.5 s at step 1\d\d .* a call to the FMU hangs"),
        ("lag=0.1,leaks=0.5", r"engines: their process takes \d+ MB of memory at step 250, 150 MB at most: it leaks"),
    ],
)
def test_what_an_fmu_does_to_its_process_ends_the_flight_and_nothing_else(
    made_of: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fit for the check, and bad with six of it after 3 s of its own time, 0.4 s into the flight; the log is kept."""
    assert isolated.HANG_S < 5.0  # of the clock, and of the flight the leak: a named end within 5 s
    assert isolated.MEMORY_CHECK_STEPS * STEP < 5.0
    monkeypatch.setattr(isolated, "HANG_S", 0.5)
    if "leaks" in made_of:
        monkeypatch.setattr(isolated, "_SERVE", LITTLE)
    name = made_of.partition(",")[2].partition("=")[0]
    path = mapped(foreign(tmp_path, name, made_of), "isolated = true")
    scenario = Scenario.load("hover").replace(
        engine=str(path), controller="baseline", engine_unchecked=True, duration_s=2.0, expect=[]
    )
    run = fly(scenario, tmp_path / "run", report=False)
    assert run.outcome == "failed"
    assert re.search(said, run.reason), run.reason
    step = re.search(r"at step (\d+)", run.reason)
    assert step is not None
    assert len(run.log["time_s"]) == int(step[1])  # all that was flown
    assert (tmp_path / "run" / "flight.parquet").is_file()


IN_FLIGHT = {
    "crashes=1": r"its process crashed \(SIGSEGV\) at step \d+",
    "hangs=1": "no answer within 0.5 s at step",
    "leaks=0.5": r"their process takes \d+ MB of memory at step 250, 150 MB at most: it leaks",
    "floods=1": "",
    "threads=3": "",
}


def test_other_flights_of_a_campaign_are_unharmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One worker flies a sound engine, those that misbehave, and the sound one again: the same row as before."""
    monkeypatch.setattr(isolated, "HANG_S", 0.5)
    monkeypatch.setattr(isolated, "_SERVE", LITTLE)
    sound = study(runs=1, duration=0.1, controllers=["baseline"])
    before = fly_one(sound, flights(sound)[0])
    for made_of, reason in IN_FLIGHT.items():
        path = mapped(foreign(tmp_path, made_of.partition("=")[0], f"lag=0.1,{made_of}"), "isolated = true")
        fixed = [f"engine='{path}'", "engine_unchecked=true"]
        duration = 1.2 if "leaks" in made_of else 0.5
        bad = study(runs=1, duration=duration, fixed=fixed, controllers=["baseline"])
        row = fly_one(bad, flights(bad)[0])
        assert row["outcome"] == ("failed" if reason else "completed"), row["reason"]
        assert re.search(reason, str(row["reason"]))
    assert without_chance(fly_one(sound, flights(sound)[0])) == without_chance(before)


def test_a_flood_reaches_nobody(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = mapped(foreign(tmp_path, "floods", "lag=0.1,floods=1"), "isolated = true")
    scenario = Scenario.load("hover").replace(
        engine=str(path), controller="baseline", engine_unchecked=True, duration_s=0.5, expect=[]
    )
    assert fly(scenario).outcome == "completed"
    assert "no use to anybody" not in capfd.readouterr().out


@pytest.mark.parametrize(
    ("made_of", "why"),
    [
        ("lag=0.1,prints=1", "prints to standard output or standard error"),
        ("lag=0.1,threads=2", "starts 2 threads of its own"),
        ("lag=0.1", ""),
    ],
)
def test_what_a_check_finds_is_remembered_and_the_flight_takes_it_apart(
    made_of: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the archive's contents: under another name, and not where its mapping file says that it is harmless."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = foreign(tmp_path, "mine", made_of)
    parts = ("start", "measure")
    report, _ = check._check(str(path), STEP, {}, check.LIMITS, parts)
    assert (report.apart or "") == why
    if not why:
        check.record_misbehaviour(report.sha256, "crashed once")
        check._check(str(path), STEP, {}, check.LIMITS, parts)
        assert check.read_misbehaviour(report.sha256)  # a part of a check clears nobody
        return
    assert ("flown", f"in a process of its own: it {why}") in report.lines()
    other = shutil.copy(path, tmp_path / "other.fmu")
    spec = load_engine(str(other), {}, STEP, unchecked=True)
    assert (spec.isolated, spec.misbehaviour) == (True, why)
    harmless = load_engine(str(mapped(path, "isolated = false")), {}, STEP, unchecked=True)
    assert (harmless.isolated, harmless.misbehaviour) == (False, "")
    scenario = Scenario.load("hover").replace(
        engine=str(other), controller="baseline", engine_unchecked=True, duration_s=0.1, expect=[]
    )
    run = fly(scenario)
    assert {each.apart for each in run.summary.stations} == {why}


def test_a_crash_in_a_check_is_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = foreign(tmp_path, "dies", "dies=1")
    report, _ = check._check(str(path), STEP, {}, check.LIMITS, ("start",))
    assert check.read_misbehaviour(report.sha256).startswith("crashed when it was instantiated")
    with pytest.raises(
        InputError, match="crashed while its thrust"
    ):  # it is not loaded here to be measured, unchecked or not
        load_engine(str(path), {}, STEP, unchecked=True)


@pytest.mark.parametrize(
    ("moment", "remembered"), [("when it was instantiated", True), ("while its process started", False)]
)
def test_a_hang_is_the_engines_only_where_the_engine_was_called(
    moment: str, remembered: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine that is busy may take as long to start a process."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    ended = ChildResult(problem=f"hangs {moment}", has_hung=True, moment=moment)
    monkeypatch.setattr(check, "run_in_child", lambda task, limits: ended)
    report, _ = check._check(str(foreign(tmp_path, "stays", "lag=0.1")), STEP, {}, check.LIMITS)
    assert check.read_misbehaviour(report.sha256) == (f"hangs {moment}" if remembered else "")


def test_a_whole_check_without_a_finding_forgives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(check._TrialRunner, "all", lambda self, parts: None)
    path = foreign(tmp_path, "mine", "lag=0.1")
    digest = check._check(str(path), STEP, {}, check.LIMITS)[0].sha256
    check.record_misbehaviour(digest, "printed once")
    check._check(str(path), STEP, {}, check.LIMITS)
    assert not check.read_misbehaviour(digest)


def test_an_engine_that_cannot_be_made_says_so_from_over_there(tmp_path: Path) -> None:
    spec = load_engine(str(foreign(tmp_path, "gone", "lag=0.1")), {}, STEP, unchecked=True)
    os.remove(tmp_path / "gone.fmu")
    with pytest.raises(InputError, match=r"gone.fmu: no such file"):
        IsolatedBank([spec], STEP)


def test_a_child_that_is_killed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    bank = IsolatedBank([load_engine("edf", {}, STEP)], STEP)
    bank.reset(0.5)
    bank._child.kill()
    bank._child.wait()
    with pytest.raises(EngineError, match=r"its process crashed \(SIGKILL\) at step 0 \(0 s\)"):
        bank.step(0, (0.5,))
    bank.close()


class Evil:
    """What runs code where it is unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, ...]:
        return Path.write_text, (self.target, "run here")


@pytest.fixture(scope="module")
def turbine() -> Iterator[IsolatedBank]:
    bank = IsolatedBank([load_engine("turbine-20", {}, STEP)], STEP, in_flight=True)
    yield bank
    bank.close()


@pytest.mark.parametrize("head", [b"p", b"s", b""])
@pytest.mark.parametrize(
    "answer",
    [
        lambda target: pickle.dumps((True, Evil(target))),
        lambda target: b"[true, [0, 1e9]]",
        lambda target: b"[true, 5]",
        lambda target: b"[false, 5]",
        lambda target: b"[" * 100_000,
        lambda target: b"",
        lambda target: b"\xff" * 7,
    ],
)
def test_what_a_child_answers_runs_nothing_here(
    head: bytes, answer: Callable[[Path], bytes], turbine: IsolatedBank, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is an engine's library that has the pipe there, and can send whatever it likes."""
    bank = turbine
    reader, writer = os.pipe()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    monkeypatch.setattr(bank, "_pipes", Pipes(reader, nowhere))
    sender = Pipes(reader, writer)
    data, calls = (
        head + answer(tmp_path / "ran"),
        (
            lambda: bank.step(0, (0.5,)),
            lambda: bank.reset(0.5),
            lambda: bank.run_down(1.0),
            lambda: bank.shown,
            lambda: bank._update_starting(True, "then"),
        ),
    )
    for call in calls:
        thread = Thread(target=sender.send_message, args=(data,))  # more than a pipe holds, once
        thread.start()
        with pytest.raises(EngineError, match=r"turbine-20.*their process answered what is no answer$"):
            call()
        thread.join()
    sender.send(b"\xff\xff\xff\xff")  # a message of 4 GB
    with pytest.raises(EngineError, match=r"turbine-20.*their process answered what is no answer$"):
        bank.step(0, (0.5,))
    for number in (reader, writer, nowhere):
        os.close(number)
    assert not (tmp_path / "ran").exists()


def test_the_bits_of_every_double_come_back(turbine: IsolatedBank, monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN of either sign, infinity, the smallest number and zero below zero among them."""
    values = (float("inf"), float("-inf"), 5e-324, -0.0, 0.1, *struct.unpack("<2d", bytes(6) + b"\xf8\xff" + bytes(6) + b"\xf8\x7f"))  # fmt: skip
    monkeypatch.setattr(turbine, "_exchange", lambda *_: isolated._double_answer(values))
    monkeypatch.setattr(turbine, "_in_flight", False)
    for answer in (turbine.step(0, (0.5,)), turbine.reset(0.5), turbine.run_down(1.0)):
        got = [value for row in answer for value in row]
        assert struct.pack("<7d", *got) == struct.pack("<7d", *values)


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    return Kit(tmp_path_factory.mktemp("libraries"))


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("crash-later", r"bad.fmu: crashed while its thrust was measured \(SIGSEGV"),
        ("hang-later", r"bad.fmu: hangs while its thrust was measured: no answer within 2 s"),
    ],
)
def test_an_isolated_engine_is_measured_in_a_process_of_its_own(
    fault: str, said: str, kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody has tried it before: it crashes or hangs after 1 s of its own time."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(check, "LIMITS", replace(check.LIMITS, silence=2.0))
    (tmp_path / "bad.fmu").write_bytes(packed(kit.contents(fault)))
    scenario = Scenario.load("hover").replace(
        engine=str(tmp_path / "bad.fmu"), engine_unchecked=True, engine_isolated=True, controller="baseline", expect=[]
    )
    with pytest.raises(InputError, match=said):
        fly(scenario)


def test_no_library_of_an_isolated_engine_is_loaded_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measured in two airs, checked and not, stepped for its reference, identified, of the library too."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def loaded(*_: object) -> None:
        raise AssertionError("loaded in this process")

    monkeypatch.setattr(bank, "FmuInstance", loaded)
    monkeypatch.setattr(measure, "FmuInstance", loaded)
    rows = [lever(), force(), ("rho", "density", "input", 'unit="kg/m3" start="1.225"')]
    path = foreign(tmp_path, "lagging", "lag=0.1", rows)
    hover = Scenario.load("hover").replace(
        engine=str(path), engine_isolated=True, controller="baseline", duration_s=0.1, expect=[]
    )
    assert "density" in load_engine(str(path), {}, STEP, isolated=True).archive.ports
    library = hover.replace(engine="turbine-20")
    for scenario in (hover.replace(engine_unchecked=True), hover, hover.replace(vehicle={"mass_kg": 7.0}), library):
        assert fly(scenario).outcome == "completed"
    found = identify_engine(str(mapped(path, "isolated = true")), step=STEP, from_hz=0.5, to_hz=5.0)
    assert found.chosen.model.rate == pytest.approx(10.0, rel=0.1)
