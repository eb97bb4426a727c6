"""What is printed fits the terminal, whatever its width and its alphabet, and nothing is lost without a word."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import pytest
from command_tools import Hexjet
from places import TESTS

from cosim.cli import main as command
from cosim.cli.controllers.design import fly_command
from cosim.cli.flight.fly import print_run
from cosim.results.run import open_run

RUN = sorted((TESTS / "older").iterdir())[0] / "run"


@pytest.mark.parametrize("width", [40, 80, 120])
def test_a_run_fits_so_many_columns(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """COLUMNS counts in a pipe, and no cell is cut short."""
    monkeypatch.setenv("COLUMNS", str(width))
    print_run(open_run(RUN))
    lines = capsys.readouterr().out.splitlines()
    report = [line for line in lines if line.startswith("report: ")]
    assert len(report) == 1  # a path is not broken, so that it can be copied
    assert max(len(line) for line in lines if line not in report) <= width
    text = " ".join("\n".join(lines).split())
    assert "…" not in text
    for figure in ("0.0", "roll", "altitude", "completed, nothing checked; flew", "Nothing was expected of it"):
        assert figure in text


def test_without_a_width_a_pipe_has_one(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    print_run(open_run(RUN))
    assert 80 < max(map(len, capsys.readouterr().out.splitlines()[:8])) <= 120


def test_a_process_without_memory_ends_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(**_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(command.cli, "main", fail)
    with pytest.raises(SystemExit) as end:
        command.main([])
    assert end.value.code == 1
    assert capsys.readouterr().err == "hexjet: the memory that this process may have is used up\n"


def test_a_terminal_without_the_signs_and_one_that_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    poor = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", poor)
    monkeypatch.setattr(command.cli, "main", lambda **_: print_run(open_run(RUN)))
    with pytest.raises(SystemExit) as end:
        command.main([])
    assert end.value.code == 0
    poor.flush()
    assert b"roll" in poor.buffer.getvalue()  # type: ignore[attr-defined]
    monkeypatch.setattr(sys, "stdout", None)
    print_run(open_run(RUN))


def test_who_stops_reading_makes_no_failure() -> None:
    """``hexjet ... | head -1`` ends with 0."""
    script = (
        "from cosim.cli import main as m; import click\n"
        "@click.command()\ndef lines():\n    for k in range(100000): click.echo('line')\n"
        "m.cli = lines; m.main([])"
    )
    reading = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE)
    assert reading.stdout is not None
    assert reading.stdout.readline() == b"line\n"
    reading.stdout.close()
    assert reading.wait() == 0


@pytest.mark.parametrize("raised", [KeyboardInterrupt(), click.Abort()])
def test_ctrl_c_is_answered_in_a_line(
    raised: BaseException, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(**_: object) -> None:
        raise raised

    monkeypatch.setattr(command.cli, "main", stopped)
    with pytest.raises(SystemExit) as end:
        command.main([])
    assert (end.value.code, capsys.readouterr().err) == (130, "hexjet: stopped; what was written before is kept\n")


def test_a_design_that_no_flight_would_know_is_refused_before_the_search(hexjet: Hexjet, tmp_path: Path) -> None:
    done = hexjet("design", "--engine", "edf", "--out", "d.txt")
    assert (done.status, done.err) == (2, "hexjet: --out d.txt: must end in .toml, by which --controller knows it\n")


def test_a_design_says_the_command_that_flies_it() -> None:
    options: Any = SimpleNamespace(aircraft="hexjet", engine=None, settings=())
    assert fly_command(options, Path("runs/d/c.toml")) == "hexjet fly SCENARIO --controller runs/d/c.toml"
    options = SimpleNamespace(aircraft="quadjet", engine="my e.fmu", settings=("engine_parameters.delay=4",))
    assert fly_command(options, Path("c.toml")) == (
        "hexjet fly SCENARIO --aircraft quadjet --engine 'my e.fmu' --set engine_parameters.delay=4 --controller c.toml"
    )
