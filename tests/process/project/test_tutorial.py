"""docs/tutorial.md, run as it is written: its files, its commands, in an empty folder, one after the other.

Long.  That its commands exist is asked daily, in test_site.py.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from places import DOCS

PAGE = (DOCS / "tutorial.md").read_text(encoding="utf-8")
FILE = re.compile(r"<!-- file: (\S+) -->\n```\w*\n(.*?)^```$|^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.long
def test_the_tutorial_as_written(tmp_path: Path) -> None:
    pytest.importorskip("pythonfmu3", reason="no pythonfmu3, with which the tutorial makes its engine")
    here = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{here}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "80"}
    said = {}
    for name, text, commands in FILE.findall(PAGE):
        if name:
            (tmp_path / name).write_text(text, encoding="utf-8")
        for line in commands.splitlines():
            done = subprocess.run(line, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True)
            assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
            said[line] = done.stdout
    assert "fit to fly" in next(out for line, out in said.items() if line.startswith("hexjet fmu check"))
    for page in ("designed/report.html", "verdict/report.html", "check-mine/aircraft.svg"):
        assert (tmp_path / "runs" / page).stat().st_size > 1000
    assert (tmp_path / "mine.html").exists()
    verdict = next(out for line, out in said.items() if line.startswith("hexjet sweep"))
    assert "\n  mine: " in verdict  # the designed one, by its file
    assert "my_controller.py:Mine" in verdict
