"""A user's JSBSim file counts as proven where the process that tried it ended with status 0, and nowhere else."""

from __future__ import annotations

import re
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from cosim.base.errors import InputError
from cosim.vehicle import model_trial

XML = b"<fdm_config/>"


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (1, "ends the process with it, with status 1 (ImportError: none)"),
        (3, "ends the process with it, with status 3 (ImportError: none)"),
        (-11, "crashes with it (SIGSEGV)"),
        (-24, "was not done with it within 20 s of processor time"),
    ],
)
def test_any_other_status_is_refused_and_not_remembered(
    status: int, said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    ends = CompletedProcess([], status, "", "Traceback\nImportError: none\n")
    monkeypatch.setattr(model_trial, "run_child", lambda *a: ends)
    model = tmp_path / "own.xml"
    with pytest.raises(InputError, match=re.escape(f"own.xml: JSBSim {said}; look for an element")):
        model_trial.check_model_loads(XML, model, XML)
    assert not list(tmp_path.rglob("*.txt"))
    ends.returncode = 0
    model_trial.check_model_loads(XML, model, XML)
    assert [path.read_text() for path in tmp_path.rglob("*.txt")] == [f"{model}\n"]
