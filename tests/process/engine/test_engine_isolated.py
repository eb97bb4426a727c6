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
from patience import is_ended

from cosim import Scenario, fly
from cosim.base.errors import EngineError, InputError
from cosim.base.runtime.pipes import Pipes
from cosim.base.signals import Ambient
from cosim.base.storage.paths import data_folder
from cosim.campaign.study.plan import flights
from cosim.campaign.workers.flight_row import fly_one
from cosim.engine import EngineBank, IsolatedBank, bank, isolated, load_engine, measure
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


def test_an_engine_is_found_from_the_folder_of_each_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that served one bank serves the next, and sees relative paths as this process does then."""
    for name in ("one", "other"):
        folder = tmp_path / name
        folder.mkdir()
        shutil.copy(data_folder("fmus") / "edf.fmu", folder / f"{name}.fmu")
        monkeypatch.chdir(folder)
        with IsolatedBank([load_engine(f"{name}.fmu", {}, STEP)] * 2, STEP) as flown:
            assert flown.reset(0.5).thrust[0] > 0.0


def test_a_flight_is_the_same_with_its_engines_apart() -> None:
    scenario = Scenario.load("hover").replace(duration_s=1.0, expect=[])
    one, other = (fly(scenario.replace(engine_isolated=apart)) for apart in (False, True))
    assert log_digest(one.log) == log_digest(other.log)


@pytest.mark.parametrize(
    ("made_of", "said"),
    [
        ("lag=0.1,crashes=1", r"engines \(crashes.fmu\): the process was ended by SIGSEGV at step 1\d\d \(0\.\d+ s\)"),
        ("lag=0.1,hangs=1", r"engines \(hangs.fmu\): the process did not answer within 3 s at step 1\d\d \(0"),
        (
            "lag=0.1,leaks=0.5",
            r"engines \(leaks.fmu\): the process takes \d+ MB of memory, 150 MB at most at step 2\d\d",
        ),
    ],
)
def test_what_an_fmu_does_to_its_process_ends_the_flight_and_nothing_else(
    made_of: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fit for the check, and bad with six of it after 3 s of its own time, 0.4 s into the flight; the log is kept."""
    assert isolated.LIMITS.hang_s < 5.0  # of the clock, and of the flight the leak: a named end within 5 s
    if "hangs" in made_of:
        monkeypatch.setattr(isolated, "LIMITS", isolated.LIMITS._replace(hang_s=3.0))
    if "leaks" in made_of:
        monkeypatch.setattr(isolated, "LIMITS", isolated.LIMITS._replace(max_megabytes=150.0))
    name = made_of.partition(",")[2].partition("=")[0]
    path = foreign(tmp_path, name, made_of)
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
    "crashes=1": r"the process was ended by SIGSEGV at step \d+",
    "hangs=1": "the process did not answer within 3 s at step",
    "leaks=0.5": r"the process takes \d+ MB of memory, 150 MB at most at step",
    "floods=1": "",
    "threads=3": "",
}


def test_other_flights_of_a_campaign_are_unharmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One worker flies a sound engine, those that misbehave, and the sound one again: the same row as before."""
    monkeypatch.setattr(isolated, "LIMITS", isolated.LIMITS._replace(hang_s=3.0, max_megabytes=150.0))
    sound = study(runs=1, duration=0.1, controllers=["baseline"])
    before = fly_one(sound, flights(sound)[0])
    for made_of, reason in IN_FLIGHT.items():
        path = foreign(tmp_path, made_of.partition("=")[0], f"lag=0.1,{made_of}")
        fixed = [f"engine='{path}'", "engine_unchecked=true"]
        duration = 1.2 if "leaks" in made_of else 0.5
        bad = study(runs=1, duration=duration, fixed=fixed, controllers=["baseline"])
        row = fly_one(bad, flights(bad)[0])
        assert row["outcome"] == ("failed" if reason else "completed"), row["reason"]
        assert re.search(reason, str(row["reason"]))
    assert without_chance(fly_one(sound, flights(sound)[0])) == without_chance(before)


def test_a_flood_reaches_nobody(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = foreign(tmp_path, "floods", "lag=0.1,floods=1")
    scenario = Scenario.load("hover").replace(
        engine=str(path), controller="baseline", engine_unchecked=True, duration_s=0.5, expect=[]
    )
    assert fly(scenario).outcome == "completed"
    assert "no use to anybody" not in capfd.readouterr().out


def test_an_engine_of_others_is_isolated_unless_somebody_says_otherwise(tmp_path: Path) -> None:
    """By the scenario first, then by the mapping file; one of the library is not."""
    path = foreign(tmp_path, "mine", "lag=0.1")

    def flown(engine: Path | str, isolated: bool | None = None) -> bool:
        return load_engine(str(engine), {}, STEP, unchecked=True, isolated=isolated).isolated

    assert flown(path)
    assert not flown("edf")
    assert not flown(path, False)
    assert flown("edf", True)
    for stated in (True, False):
        mapping = mapped(path, f"isolated = {str(stated).lower()}")
        assert [flown(mapping), flown(mapping, True), flown(mapping, False)] == [stated, True, False]
    scenario = Scenario.load("hover").replace(
        engine=str(path), controller="baseline", engine_unchecked=True, duration_s=0.1, expect=[]
    )
    runs = [fly(scenario), fly(scenario.replace(engine_isolated=False))]
    assert [{each.isolated for each in run.summary.stations} for run in runs] == [{True}, {False}]
    assert log_digest(runs[0].log) == log_digest(runs[1].log)


def test_a_process_serves_one_bank_after_another_of_its_archives(tmp_path: Path) -> None:
    """Of no others, not after anything has gone wrong, and none is left at the end."""
    isolated.end_idle()
    one, other = (load_engine(str(foreign(tmp_path, name, "lag=0.1")), {}, STEP, unchecked=True) for name in "ab")
    other = replace(other, archive=replace(other.archive, sha256="another"))
    numbers = []
    for _ in range(2):
        with IsolatedBank([one], STEP) as bank:
            numbers.append(bank.host._host.pid)
            bank.reset(0.5)
    assert numbers[0] == numbers[1]
    assert [host._host.pid for host in isolated._idle] == numbers[:1]
    with pytest.raises(InputError), IsolatedBank([other], STEP):
        pass
    assert is_ended(numbers[0])
    with IsolatedBank([one], STEP) as bank:
        bank.reset(0.5)
        with pytest.raises(ValueError, match="is next"):
            bank.step(7, (0.5,))
    assert isolated._idle == []


def test_an_engine_that_cannot_be_made_says_so_from_over_there(tmp_path: Path) -> None:
    spec = load_engine(str(foreign(tmp_path, "gone", "lag=0.1")), {}, STEP, unchecked=True)
    os.remove(tmp_path / "gone.fmu")
    with pytest.raises(InputError, match=r"gone.fmu: no such file"):
        IsolatedBank([spec], STEP)


def test_a_child_that_is_killed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    bank = IsolatedBank([load_engine("edf", {}, STEP)], STEP)
    bank.reset(0.5)
    bank.host._host.kill()
    bank.host._host.wait()
    with pytest.raises(EngineError, match=r"the process was ended by SIGKILL at step 0 \(0 s\)"):
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
    bank = IsolatedBank([load_engine("turbine-20", {}, STEP)], STEP)
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
    monkeypatch.setattr(bank.host._host, "pipes", Pipes(reader, nowhere))
    sender = Pipes(reader, writer)
    data, calls = (
        head + answer(tmp_path / "ran"),
        (lambda: bank.step(0, (0.5,)), lambda: bank.reset(0.5), lambda: bank.run_down(1.0)),
    )
    for call in calls:
        thread = Thread(target=sender.send_message, args=(data,))  # more than a pipe holds, once
        thread.start()
        with pytest.raises(EngineError, match=r"turbine-20.*the process answered what is no answer$"):
            call()
        thread.join()
    for number in (reader, writer, nowhere):
        os.close(number)
    assert not (tmp_path / "ran").exists()


def test_an_answer_without_end_ends_its_process() -> None:
    bank = IsolatedBank([load_engine("edf", {}, STEP)], STEP)
    reader, writer = os.pipe()
    bank.host._host.pipes = Pipes(reader, os.open(os.devnull, os.O_WRONLY))
    os.write(writer, b"\xff\xff\xff\xff")  # a message of 4 GB
    with pytest.raises(EngineError, match=r"edf.*the process answered too much"):
        bank.step(0, (0.5,))
    assert is_ended(bank.host._host.pid)
    os.close(writer)
    bank.close()


def test_the_bits_of_every_double_come_back(turbine: IsolatedBank, monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN of either sign, infinity, the smallest number and zero below zero among them."""
    values = (float("inf"), float("-inf"), 5e-324, -0.0, 0.1, *struct.unpack("<2d", bytes(6) + b"\xf8\xff" + bytes(6) + b"\xf8\x7f"))  # fmt: skip
    monkeypatch.setattr(turbine.host, "exchange", lambda *_: isolated._double_answer(values))
    for answer in (turbine.step(0, (0.5,)), turbine.reset(0.5), turbine.run_down(1.0)):
        got = [value for row in answer for value in row]
        assert struct.pack("<7d", *got) == struct.pack("<7d", *values)


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    return Kit(tmp_path_factory.mktemp("libraries"))


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("crash-later", r"bad.fmu: the process was ended by SIGSEGV while its thrust was measured"),
        ("hang-later", r"bad.fmu: the process did not answer within 5 s while its thrust was measured"),
    ],
)
def test_an_isolated_engine_is_measured_in_a_process_of_its_own(
    fault: str, said: str, kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody has tried it before: it crashes or hangs after 1 s of its own time."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    if fault.startswith("hang"):
        monkeypatch.setattr(isolated, "LIMITS", isolated.LIMITS._replace(start_s=5.0))
    (tmp_path / "bad.fmu").write_bytes(packed(kit.contents(fault)))
    scenario = Scenario.load("hover").replace(
        engine=str(tmp_path / "bad.fmu"), engine_unchecked=True, controller="baseline", expect=[]
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
    rows = [lever(), force(), ("density", "density", "input", 'unit="kg/m3" start="1.225"')]
    path = foreign(tmp_path, "lagging", "lag=0.1", rows)
    hover = Scenario.load("hover").replace(engine=str(path), controller="baseline", duration_s=0.1, expect=[])
    assert "density" in load_engine(str(path), {}, STEP).archive.ports
    library = hover.replace(engine="turbine-20", engine_isolated=True)
    for scenario in (hover.replace(engine_unchecked=True), hover, hover.replace(vehicle={"mass_kg": 7.0}), library):
        assert fly(scenario).outcome == "completed"
    found = identify_engine(str(path), step=STEP, from_hz=0.5, to_hz=5.0)
    assert found.chosen.model.rate == pytest.approx(10.0, rel=0.1)
