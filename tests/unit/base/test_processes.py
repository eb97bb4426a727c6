"""A process that was started can be ended, whatever an interrupt has left behind."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator

import psutil
import pytest

from cosim.base.runtime.processes import end_group, reap


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
