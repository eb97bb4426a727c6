"""Engines in a process of their own: the same flight bit for bit, and a named end whatever an FMU does."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
from engine_tools import STEP
from foreign_engines import foreign, mapped

from cosim import Scenario, fly
from cosim.base.errors import EngineError, InputError
from cosim.base.signals import Ambient
from cosim.engine import EngineBank, IsolatedBank, isolated, load_engine
from cosim.results.digest import log_digest


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


@pytest.mark.parametrize(
    ("made_of", "said"),
    [
        ("lag=0.1,crashes=1", r"engines \(crashes.fmu\): its process crashed \(SIGSEGV\) at step 1\d\d \(0\.\d+ s\)"),
        ("lag=0.1,hangs=1", r"engines \(hangs.fmu\): no answer within 0.5 s at step 1\d\d .* a call to the FMU hangs"),
    ],
)
def test_what_an_fmu_does_to_its_process_ends_the_flight_and_nothing_else(
    made_of: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fit for the check, and bad with six of it after 3 s of its own time, 0.4 s into the flight; the log is kept."""
    monkeypatch.setattr(isolated, "HANG_S", 0.5)
    path = mapped(foreign(tmp_path, "crashes" if "crash" in made_of else "hangs", made_of), "isolated = true")
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


def test_a_flood_reaches_nobody(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = mapped(foreign(tmp_path, "floods", "lag=0.1,floods=1"), "isolated = true")
    scenario = Scenario.load("hover").replace(
        engine=str(path), controller="baseline", engine_unchecked=True, duration_s=0.5, expect=[]
    )
    assert fly(scenario).outcome == "completed"
    assert "no use to anybody" not in capfd.readouterr().out


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
