"""Many engines, one line each: is it fit, is there a design, does it fly as promised.

Every command runs in a process of its own with a limit of time, so that an engine that crashes or hangs is a line
like any other.
"""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.base.runtime.processes import python_command, run_child
from cosim.base.storage.scratch import temporary
from cosim.engine.fmu.container import to_one_line
from cosim.results.report import marks

FLIES, NONE, UNFIT, REFUSED, FAULT = "flies as promised", "no design", "unfit", "refused", "FAULT OF OURS"
MARK = "engines"  # of a page that has the table
COLUMNS = ("engine", "check", "design", "flights kept", "verdict", "s")
_MAIN = "from cosim.cli.main import main; main()"


@dataclass(frozen=True)
class Row:
    """The outcome of one engine."""

    engine: str
    check: str  # what hexjet fmu check said
    design: str  # bandwidth and sensitivity of roll, or why there is none
    proof: str  # flights that kept what was promised
    verdict: str
    seconds: float

    @property
    def cells(self) -> tuple[str, ...]:
        """Cells of the table, as :data:`COLUMNS` head them."""
        return self.engine, self.check, self.design, self.proof, self.verdict, f"{self.seconds:.0f}"


def survey(engines: Sequence[Path], controller: str, limit: float) -> Iterator[Row]:
    """Check, design and prove every engine, one after the other; ``limit`` [s] for each of the two commands."""
    for path in engines:
        begin = time.monotonic()
        with temporary("survey-") as folder:
            row = _one(path, controller, limit, folder)
        yield Row(path.stem, *row, time.monotonic() - begin)


def add_to_page(page: Path, row: Row) -> None:
    """Write a row into the table of a page, in the place of an earlier one of the same engine, else below the others.

    Raises InputError for a page that cannot be read or written, or has no mark for the table.
    """
    marks.check_marks(page, [MARK])
    rows = read_rows(page)
    line = marks.row(row.cells)
    rows[line.split("|")[1].strip()] = line
    head = marks.table(COLUMNS, [], left=len(COLUMNS) - 1)
    marks.write_marks(page, {MARK: head + "".join(f"{row}\n" for row in rows.values())})


def read_rows(page: Path) -> dict[str, str]:
    """Return the rows of a page's table, by engine."""
    before = marks.page_parts(page)[MARK].splitlines()[2:]
    return {line.split("|")[1].strip(): line for line in before}


def _one(path: Path, controller: str, limit: float, folder: Path) -> tuple[str, str, str, str]:
    status, report, message = _run(["fmu", "check", str(path), "--json", "--out", str(folder / "check")], limit)
    if status == 2:
        return message, "", "", REFUSED
    if report is None:
        return message, "", "", FAULT
    if not report["ok"]:
        return report["problems"][0], "", "", UNFIT
    arguments = [
        "design",
        "--engine",
        str(path),
        "--controller",
        controller,
        "--json",
        "--out",
        str(folder / "made.toml"),
    ]
    status, designed, message = _run(arguments, limit)
    if status == 2:
        return "fit", message, "", REFUSED
    if designed is None:
        return "fit", message, "", FAULT
    return "fit", *describe_design(designed)


def describe_design(designed: dict[str, Any]) -> tuple[str, str, str]:
    """Describe a design that ``--json`` printed: the design, the flights that kept it, and the verdict."""
    proof, roll = designed["proof"], designed["axes"]["roll"]["after"]
    flights = proof["flights"] if proof else []
    passed = f"{sum(not flight['fault'] for flight in flights)} of {len(flights)}" if flights else ""
    if not designed["ok"]:
        return designed["reason"], passed, NONE
    design = f"{designed['controller']}, {roll['bandwidth_hz']:.2g} Hz, peak |S| {roll['peak_sensitivity']:.2f}"
    return design, passed, FLIES if flights and all(not flight["fault"] for flight in flights) else NONE


def _run(arguments: Sequence[str], limit: float) -> tuple[int, dict[str, Any] | None, str]:
    """Run ``hexjet`` and return its status, what it printed as JSON, and its last complaint or line on stderr."""
    try:
        done = run_child(python_command(_MAIN, *arguments), limit)
    except subprocess.TimeoutExpired:
        return -1, None, f"not done within {limit:g} s"
    complaints = [line for line in done.stderr.splitlines() if line.startswith("hexjet: ") and "warning:" not in line]
    message = to_one_line((complaints or done.stderr.splitlines() or ["nothing was said"])[-1]).removeprefix("hexjet: ")
    if done.returncode not in (0, 1) or "Traceback" in done.stderr:
        fault = done.returncode == 2 and "Traceback" not in done.stderr
        return (2 if fault else -1), None, message if fault else f"status {done.returncode}: {message}"
    try:
        return done.returncode, json.loads(done.stdout), message
    except ValueError:
        return -1, None, f"status {done.returncode}: {message}"
