"""What is printed fits the terminal, whatever its width and its alphabet, and nothing is lost without a word."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command_tools import Hexjet
from places import ROOT, TESTS

from cosim.api.flights import FlightResult
from cosim.base.wording import name_options, printable_line, spell
from cosim.cli import main as command
from cosim.cli.console import show_result, show_table
from cosim.results.run import open_run
from hexjet_design.api import DesignResult

RUN = sorted((TESTS / "older").iterdir())[0] / "run"


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_run_fits_so_many_columns(width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    """COLUMNS counts in a pipe, and no cell is cut short."""
    monkeypatch.setenv("COLUMNS", str(width))
    show_result(FlightResult(open_run(RUN)), verbose=True)
    lines = capsys.readouterr().out.splitlines()
    report = [line for line in lines if line.startswith("report: ")]
    assert len(report) == 1  # a path is not broken, so that it can be copied
    assert max(len(line) for line in lines if line not in report) <= width
    text = " ".join("\n".join(lines).split())
    assert "…" not in text
    for figure in ("0.0", "roll", "altitude", "completed, nothing checked; flew"):
        assert figure in text


def test_a_flight_prints_eight_lines_tables_when_asked_and_nothing_when_quiet(hexjet: Hexjet, tmp_path: Path) -> None:
    short, whole, quiet = (
        hexjet("fly", "hover", "--set", "duration_s=2.0", "--out", str(tmp_path / name), *words)
        for name, words in (("short", ()), ("whole", ("-v",)), ("quiet", ("--quiet",)))
    )
    lines = short.out.splitlines()
    assert "least margin" in lines[0]
    assert lines[-1] == f"report: {tmp_path / 'short' / 'report.html'}"
    assert len(lines) <= 8
    assert "largest ground speed" in whole.out
    assert len(whole.out.splitlines()) > 24
    assert quiet == (0, "", "")


def test_of_many_lines_the_first_are_printed_the_others_counted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")

    class Noted(FlightResult):
        def lines(self) -> list[str]:
            return [*super().lines(), *(f"note {n}" for n in range(20))]

    show_result(Noted(open_run(RUN)))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 8
    assert re.fullmatch(r"\d+ more lines with --verbose", lines[-2])


def test_a_key_is_not_broken_and_messages_have_options(monkeypatch: Any, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    show_table(("key", "meaning"), [("vehicle.sensors.time_constant_s", "gain " * 30)], plain=True)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[3:6]] == ["vehicle.", "sensors.", "time_constant_s"]
    name_options({"time_unit": "--time-unit"})
    keys = "not x.time_unit or time_unit=ms; unknown key 'time'; allowed: time_s, time_unit; time_unit = 3: wrong"
    assert spell(f"a time_unit of ms, {keys}") == f"a --time-unit of ms, {keys}"


def test_without_a_width_a_pipe_has_one(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    show_result(FlightResult(open_run(RUN)))
    assert 80 < max(map(len, capsys.readouterr().out.splitlines()[:8])) <= 120


def test_a_process_without_memory_ends_in_a_line(monkeypatch: Any, capsys: pytest.CaptureFixture) -> None:
    def fail(words: object) -> None:
        raise MemoryError

    monkeypatch.setattr(command, "run", fail)
    with pytest.raises(SystemExit) as end:
        command.main([])
    assert end.value.code == 1
    assert capsys.readouterr().err == "hexjet: the memory that this process may have is used up\n"


def test_a_terminal_without_the_signs_and_one_that_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    poor = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", poor)
    monkeypatch.setattr(command, "run", lambda words: show_result(FlightResult(open_run(RUN))) or 0)
    with pytest.raises(SystemExit) as end:
        command.main([])
    assert end.value.code == 0
    poor.flush()
    assert b"roll" in poor.buffer.getvalue()
    monkeypatch.setattr(sys, "stdout", None)
    show_result(FlightResult(open_run(RUN)))


def test_who_stops_reading_makes_no_failure() -> None:
    """``hexjet ... | head -1`` ends with 0."""
    script = (
        "from cosim.cli import main as m\n"
        "m.run = lambda words: [m.echo('line') for k in range(100000)] and 0\n"
        "m.main([])"
    )
    reading = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE)
    assert reading.stdout.readline() == b"line\n"
    reading.stdout.close()
    assert reading.wait() == 0


def test_ctrl_c_is_answered_in_a_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def stopped(words: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run", stopped)
    with pytest.raises(SystemExit) as end:
        command.main([])
    assert (end.value.code, capsys.readouterr().err) == (130, "hexjet: stopped; what was written before is kept\n")


def test_a_design_that_no_flight_would_know_is_refused_before_the_search(hexjet: Hexjet, tmp_path: Path) -> None:
    done = hexjet("design", "--engine", "edf", "--out", "d.txt")
    wanted = "hexjet design writes a folder, or a file that ends in .toml"
    assert (done.status, done.err) == (2, f"hexjet: --out d.txt: names a file by its ending; {wanted}\n")


def test_a_design_says_the_command_that_flies_it() -> None:
    designed: Any = None
    chosen = [("aircraft", "quadjet"), ("engine", "my e.fmu"), ("set", "engine_parameters.delay=4")]
    result = DesignResult(designed, None, chosen)
    assert result.fly_command == ""
    result.files = {"controller": Path("c.toml")}
    assert result.fly_command == (
        "hexjet fly SCENARIO --aircraft quadjet --engine 'my e.fmu' --set engine_parameters.delay=4 --controller c.toml"
    )


HOSTILE = "\x1b]52;c;cm0gLXJmIH4=\x07\x1b[2J\x9b31m\u202e"


def test_no_file_writes_to_the_terminal_as_it_likes(tmp_path: Path, hexjet: Hexjet) -> None:
    """Titles, names and reasons, in what is shown and in what is refused."""
    import json
    import shutil

    quoted = json.dumps(HOSTILE)
    scenario = (ROOT / "scenarios" / "hover.toml").read_text()
    title = f'title = {quoted[:-1]} flight"'
    (tmp_path / "title.toml").write_text(re.sub("(?m)^title = .*$", lambda _: title, scenario))
    (tmp_path / "key.toml").write_text(f"{quoted} = 1\n{scenario}")
    shutil.copytree(RUN, tmp_path / "run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    summary |= dict.fromkeys(("title", "scenario", "reason", "engine", "controller"), HOSTILE)
    (tmp_path / "run" / "summary.json").write_text(json.dumps(summary))
    for words in (("title.toml",), ("key.toml",), ("run",), ("run", "--page"), (HOSTILE,)):
        done = hexjet("show", *(each if each in (HOSTILE, "--page") else str(tmp_path / each) for each in words))
        printed = done.out + done.err
        assert "x1b" in printed, words
        assert not set(HOSTILE) & set("\x1b\x07\x9b\u202e") & set(printed), words


def test_a_refusal_echoes_eighty_characters_of_a_value(tmp_path: Path, hexjet: Hexjet) -> None:
    scenario = (ROOT / "scenarios" / "hover.toml").read_text()
    (tmp_path / "long.toml").write_text(f"duration_s = '{'x' * 10_000}'\n" + re.sub("(?m)^duration_s.*$", "", scenario))
    done = hexjet("fly", str(tmp_path / "long.toml"))
    assert done.status == 2
    assert f"'{'x' * 80}...'" in done.err
    assert len(done.err) < 400 + len(str(tmp_path))
    said = printable_line("no column 'a b'; 'c' grows from row to row: the log's own word\nand " + 3000 * "y")
    assert said.startswith("no column 'a b'; 'c' grows from row to row: the log's own word\\nand yyy")
    assert len(said) < 2100


def test_a_value_too_long_for_a_name_is_refused_in_a_line(hexjet: Hexjet) -> None:
    long = 10_000 * "y"
    for call in (("fly", long), ("fly", "hover", "--engine", long), ("show", long), ("sweep", "hover", "--vary", long)):
        status, out, line = hexjet(*call)
        assert (status, out, line.count("\n")) == (2, "", 1)
        assert (81 * "y" in line, "yyy..." in line) == (False, True), line


def test_one_module_of_the_command_line_prints() -> None:
    """It takes the control characters out."""
    for path in (ROOT / "cosim" / "cli").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        printers = re.findall(r"(?<![\w.])print\((?!f\"\\r|\"\\r)", text)
        assert not printers or path.name == "console.py", path
