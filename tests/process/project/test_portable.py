"""A system without what POSIX alone has flies: modules, calls and signals are blocked in a process of its own."""

from __future__ import annotations

from pathlib import Path

from patience import PATIENCE

from cosim import open_run
from cosim.base.runtime.host import python_command, run_to_end

FLIGHT = """
import os, signal

sys.modules |= dict.fromkeys(("fcntl", "resource"))  # an import of one of them raises ImportError
import cosim, fmpy, jsbsim, numpy, pyarrow, scipy  # what others ask their own system for is theirs
for name in ("writev", "killpg", "sysconf", "uname", "sched_getaffinity", "O_NOFOLLOW"):
    delattr(os, name)
for name in ("SIGHUP", "SIGKILL", "SIGALRM", "SIGUSR2", "SIGXCPU", "setitimer", "pthread_kill"):
    delattr(signal, name)
from cosim.cli.main import main

sys.argv[1:] = ["fly", "hover", "--set", "duration_s=0.1", "--out", sys.argv[1]]
try:
    main()
finally:
    assert sys.modules["fcntl"] is None and sys.modules["resource"] is None
"""


def test_a_flight_needs_nothing_of_posix(tmp_path: Path) -> None:
    done = run_to_end(python_command(FLIGHT, str(tmp_path / "run")), PATIENCE)
    assert done.returncode == 0, done.stderr
    assert open_run(tmp_path / "run").summary.steps == 25
