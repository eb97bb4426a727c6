"""Temporary files are in one folder a process, which goes with it, or with the next where it was killed."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

from places import ROOT

HOME = "base/storage/scratch.py"
BUILT = {"groundstation/mavlink/wire/generate.py"}  # runs while the package is installed, and imports nothing of it
KILLED = """
import os, signal
from pathlib import Path
from cosim.base.storage.scratch import temporary
from cosim.campaign.workers.flight_row import fly_one, failed_row
from cosim.campaign.workers.local import LocalWorkers, _Process
from cosim.groundstation.mavlink.services.logs import LogStore
store, worker = LogStore(lambda: []), _Process(fly_one)
with temporary("anything-") as folder:
    (folder / "file").write_text("x")
    print(worker._process.pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""
NEXT = "from cosim.base.storage.scratch import scratch; scratch()"


def test_no_folder_is_made_elsewhere() -> None:
    """Each would stay for ever after a kill -9: what is made says ``dir``, which is below the one folder."""
    wrong = []
    for path in sorted(file for name in ("cosim", "tools", "benchmarks") for file in (ROOT / name).rglob("*.py")):
        place = path.relative_to(ROOT).as_posix().removeprefix("cosim/")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            made = isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2]
            if made in ("mkdtemp", "TemporaryDirectory", "NamedTemporaryFile", "mkstemp", "mktemp"):
                assert isinstance(node, ast.Call)
                if place not in {HOME, *BUILT} and not {"dir"} & {keyword.arg for keyword in node.keywords}:
                    wrong.append(f"{place}:{node.lineno}")
    assert wrong == []


def test_nothing_stays_of_a_process_that_was_killed(tmp_path: Path) -> None:
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    killed = subprocess.run([sys.executable, "-c", KILLED], env=environment, check=False, stdout=subprocess.PIPE)
    assert killed.returncode == -9
    assert list(tmp_path.rglob("anything-*/file"))
    subprocess.run([sys.executable, "-c", NEXT], env=environment, check=True)
    assert list(tmp_path.iterdir()) == []
