"""A user's JSBSim file counts as proven where the process that tried it ended with status 0, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.errors import InputError
from cosim.vehicle import model_trial

XML = b"<fdm_config/>"


def test_a_trial_that_fails_is_a_line_and_not_remembered(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    model = tmp_path / "own.xml"
    with monkeypatch.context() as there:
        there.setattr(model_trial, "_TRIAL_CODE", "raise ImportError('none')")
        said = r"own.xml: JSBSim fails: the process ended with status 1 \(ImportError: none\); look for an element"
        with pytest.raises(InputError, match=said):
            model_trial.check_model_loads(XML, model, XML)
        assert not list(tmp_path.rglob("*.txt"))
        there.setattr(model_trial, "_TRIAL_CODE", "pass")
        model_trial.check_model_loads(XML, model, XML)
    assert [path.read_text() for path in tmp_path.rglob("*.txt")] == [f"{model}\n"]
