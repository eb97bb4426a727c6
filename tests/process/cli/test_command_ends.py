"""How a command ends that is asked to end, or whose standard streams are closed or full."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_tools import Hexjet
from patience import PATIENCE

from cosim.results.run import open_run

HEXJET = [sys.executable, "-c", "from cosim.cli.start import main; main()"]
SHORT = ["fly", "hover", "--set", "duration_s=0.4", "--out", "flown"]


def heard() -> None:
    """Let a child hear what a shell's background job, or what nohup starts, has ignored, and its children inherit."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT])
def test_a_flight_that_is_asked_to_end_leaves_page_and_summary(number: signal.Signals, tmp_path: Path) -> None:
    """Whoever asks: Ctrl-C, a batch system or a service manager, a terminal that is closed."""
    flown = tmp_path / "flown"
    command = [*HEXJET, "fly", "hover", "--set", "duration_s=3600", "--out", str(flown)]
    flight = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heard
    )
    try:
        end = time.monotonic() + PATIENCE
        while not (flown / "flight.arrows").exists():
            assert flight.poll() is None, flight.communicate()
            assert time.monotonic() < end
            time.sleep(0.05)
        time.sleep(0.5)
        flight.send_signal(number)
        out, err = flight.communicate(timeout=PATIENCE)
    finally:
        flight.kill()
        flight.wait()
    assert flight.returncode == 1, err
    assert "report: " in out
    assert (flown / "report.html").is_file()
    summary = open_run(flown).summary
    assert summary.outcome == "failed"
    assert "interrupted at " in (flown / "summary.json").read_text(encoding="utf-8")


@pytest.fixture
def hearing() -> Iterator[None]:
    """Tests that run behind nohup have the signal of a closed terminal ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("hearing")
def test_every_command_answers_sigterm_as_ctrl_c(hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch) -> None:
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)]
    for number, status in ((signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 143)):
        monkeypatch.setattr("cosim.cli.main.run", lambda words, number=number: os.kill(os.getpid(), number))
        done = hexjet("ask")
        assert (done.status, done.out) == (status, "")
        assert done.err.strip() == "hexjet: stopped; what was written before is kept"
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)] == before


def test_what_is_ignored_stays_ignored(hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch) -> None:
    """As nohup asks for."""
    monkeypatch.setattr("cosim.cli.main.run", lambda words: os.kill(os.getpid(), signal.SIGHUP) or 0)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert hexjet("ask").status == 0
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("closed", ["<&- >&- 2>&-", ">&-", "2>&-"])
def test_a_flight_needs_no_standard_stream(closed: str, tmp_path: Path) -> None:
    """And the log is not written through by what would have gone to the terminal."""
    done = subprocess.run(["sh", "-c", f'exec "$@" {closed}', "sh", *HEXJET, *SHORT], cwd=tmp_path, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert open_run(tmp_path / "flown").summary.steps == 100


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("arguments", [["show", "--json"], SHORT])
def test_an_output_that_is_full_is_named(arguments: list[str], tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([*HEXJET, *arguments], cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if "runs from source" not in line]
    assert line == "hexjet: standard output: No space left on device"
    if arguments is SHORT:  # nothing recorded is lost
        assert open_run(tmp_path / "flown").summary.steps == 100


def test_what_a_flight_prints_in_python_is_not_in_the_json() -> None:
    """Standard output is a pipe here, where Python keeps what is printed for later."""
    code = "from cosim.cli.console import output_to_stderr\nwith output_to_stderr(True):\n    print('a block of yours')\nprint('{}')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout == "{}\n"
    assert "a block of yours" in done.stderr
