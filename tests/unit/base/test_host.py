"""A process that was started can be ended, whatever an interrupt has left behind."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from patience import PATIENCE, is_ended

from cosim.base.runtime.host import Host, HostError, end_group, python_command, reap, run_code, run_to_end


@pytest.fixture
def sleeper() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(["sleep", "1000"], process_group=0)
    yield process
    process.kill()
    process.returncode = -9 if process.returncode is None else process.returncode  # a failed test leaves no warning


def test_an_interrupt_that_left_the_lock_taken_does_not_keep_it(sleeper: subprocess.Popen[bytes]) -> None:
    """What a Ctrl-C between ``poll()``'s taking of its lock and the ``try`` behind leaves: ``wait()`` hangs for ever."""
    assert sleeper._waitpid_lock.acquire(False)
    end_group(sleeper)
    assert sleeper.returncode == -9
    assert not psutil.pid_exists(sleeper.pid)
    end_group(sleeper)  # may be said twice


def test_a_status_that_was_taken_is_not_waited_for(sleeper: subprocess.Popen[bytes]) -> None:
    sleeper.kill()
    os.waitpid(sleeper.pid, 0)  # as by a poll() that was interrupted before it wrote the status down
    reap(sleeper)
    assert sleeper.returncode == 0


# What leaves the group and the session, and its parent too; the number of what stays is all that is said.
DAEMON = """
import os, time
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        os.write(1, f"{os.getpid()}\\n".encode())
        time.sleep(1000.0)
    os._exit(0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="told by /proc")
def test_what_a_child_has_started_in_a_session_of_its_own_is_ended_with_it() -> None:
    with Host(python_command(DAEMON + "time.sleep(1000.0)"), stdout=subprocess.PIPE) as child:
        daemon = int(child.stdout.readline())
        assert psutil.Process(daemon).status() != psutil.STATUS_ZOMBIE
        child.end()
    assert is_ended(daemon)


@pytest.mark.skipif(sys.platform != "linux", reason="told by /proc")
def test_children_of_others_are_left_alone() -> None:
    with Host(["sleep", "1000"]) as other:
        with Host(["sleep", "1000"]) as child:
            child.end()
        assert other.poll() is None
        other.end()


def test_a_command_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    """With what it started, which would keep its output open."""
    started = tmp_path / "started"
    shell = f"sleep 1000 & echo $! > {started}; wait"
    with pytest.raises(HostError, match="the process was not done within 1 s"):
        run_to_end(["sh", "-c", shell], 1.0)
    number = started.read_text().strip() if started.is_file() else ""
    assert not number or is_ended(int(number))


def test_a_command_says_what_it_printed() -> None:
    done = run_to_end(python_command("print(sys.argv[1:]); sys.exit(3)", "one", "two words"), PATIENCE)
    assert (done.returncode, done.stdout) == (3, b"['one', 'two words']\n")


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("sys.exit('no licence')", r"the process ended with status 1 \(no licence\)"),
        ("import os; os.abort()", "the process was ended by SIGABRT"),
        ("while True: pass", "the process was not done within 1 s of CPU"),
    ],
)
def test_code_that_does_not_end_well_is_a_line(code: str, said: str) -> None:
    with pytest.raises(HostError, match=said):
        run_code(code, seconds=1.0, megabytes=1024.0)


def test_a_process_that_answers_is_held_to_its_limits() -> None:
    """Of time and of memory, while it is waited for; its end is told, and it is ended once."""
    code = "held = b'x' * (200 * 2**20); sys.stdout.buffer.write(sys.stdin.buffer.read(2)); sys.stdout.flush()\n"
    for megabytes, said in ((None, "did not answer within 5 s"), (100.0, "takes [12].. MB of memory, 100 MB at most")):
        with Host.open(python_command(code + "sys.stdin.read()"), megabytes=megabytes) as host:
            if megabytes is None:
                assert host.exchange(b"hi", 2, PATIENCE) == b"hi"
            with pytest.raises(HostError, match=f"the process {said}"):
                host.exchange(b"a", 9, 5.0 if megabytes is None else PATIENCE)
            host.end()
            host.end()
        with pytest.raises(HostError, match="was ended before"):
            host.send(b"", PATIENCE)


def test_python_finds_what_this_process_finds_and_nothing_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PYTHONPATH works, and an empty entry of the path, which is the current folder, goes no further."""
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    (tmp_path / "here" / "mine.py").write_text("")
    (tmp_path / "there" / "theirs.py").write_text("")
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(sys, "path", ["", *sys.path, str(tmp_path / "there")])
    assert run_to_end(python_command("import theirs, cosim"), PATIENCE).returncode == 0
    assert b"No module named 'mine'" in run_to_end(python_command("import mine"), PATIENCE).stderr
