"""The command line in tests: what a command came to."""

from __future__ import annotations

import site
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple


class Done(NamedTuple):
    """What a command came to, and what it wrote to standard output and standard error."""

    status: int
    out: str
    err: str

    @property
    def told(self) -> str:
        """What a command that came to its end printed."""
        assert self.status == 0, self.err
        return self.out

    @property
    def refusal(self) -> str:
        """The one line of a command that was refused."""
        assert (self.status, self.out, self.err.count("\n")) == (2, "", 1), self
        return self.err


Hexjet = Callable[..., Done]


def install(prefix: Path, name: str, version: str, entry: str) -> Path:
    """Make a folder of installed packages below ``prefix``, in which this one states its entry points."""
    place = Path(site.getsitepackages([str(prefix)])[-1])
    info = place / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(entry)
    return place


def hexjet_beside(place: Path, *arguments: str) -> Done:
    """The command where the packages of this folder are installed."""
    installed = f"import site, sys; site.PREFIXES.append({str(place.parents[2])!r}); sys.path.insert(0, {str(place)!r})"
    command = [sys.executable, "-c", f"{installed}; from cosim.cli.main import main; main()", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=place, check=False)
    return Done(done.returncode, done.stdout, done.stderr)
