"""The measurements on a terminal."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.page import check_page, write_page
from benchmarks.suite import PARTS, Result, make_plan, measure
from benchmarks.tables import ASKED, BESIDE, MACHINE, MISSED, tables
from benchmarks.targets import to_dict
from cosim import InputError, api
from cosim.api.call import Limits, check_types

UNIT = (
    "Median [quartiles] of the rounds; cpu: processor time of the thread.  A unit is one bare JSBSim run(), timed in "
    "the same round just before and after, cpu by cpu."
)


class BenchResult(api.Result):
    """Measurements, and whether they reach the goals."""

    def __init__(self, measured: Result, files: dict[str, Path]) -> None:
        self.measured, self.files = measured, files
        self._tables = tables(measured)
        shown = [key for key in self._tables if key not in (ASKED, MISSED, BESIDE, MACHINE)]
        self._shown = [table for key in (*shown, ASKED, BESIDE) for table in self._tables[key]]

    def to_dict(self) -> dict[str, Any]:
        """Return the measurements as plain data, with the goals."""
        return to_dict(self.measured)

    def lines(self, quiet_fraction: float = 0.95) -> list[str]:
        """Return lines on the machine, and on what was not measured.

        ``quiet_fraction``: of processor time in the wall time, below which others had the machine too.
        """
        machine, plan, versions = self.measured.machine, self.measured.plan, self.measured.versions
        lines = [
            f"{machine.cpu}, {machine.cores} cores, {machine.system}, Python {versions['python']}, "
            f"JSBSim {versions.get('jsbsim', '?')}; {plan.rounds} rounds of {plan.steps} steps",
            UNIT,
        ]
        if machine.processor_share is not None and machine.processor_share < quiet_fraction:
            lines.append(
                f"Other work took {1.0 - machine.processor_share:.0%} of the wall time: trust the units rather than "
                "the microseconds."
            )
        if not machine.compiled:
            lines.append("The modules of a control step are not compiled: make setup compiles them.")
        lines += [note for table in self._shown for note in table.notes]
        lines += [f"{part} not measured: {why}" for part, why in self.measured.failed.items()]
        left_out = [part for part in PARTS if part not in self._tables and part not in self.measured.failed]
        return lines + ([f"not measured: {', '.join(left_out)}"] if left_out else [])

    def tables(self) -> list[api.Table]:
        """Return the tables of measurements, and last that of the goals."""
        return [api.Table(each.title, ("", *each.columns), each.rows) for each in self._shown]


@check_types(steps=Limits(250), rounds=Limits(1), starts=Limits(1))
def benchmark(
    *,
    full: bool = False,
    only: Sequence[str] = (),
    steps: int | None = None,
    rounds: int | None = None,
    starts: int | None = None,
    folder: str | None = None,
    page: Path | None = None,
    progress: api.Progress | None = None,
) -> BenchResult:
    """Measure what a flight costs on this machine, in microseconds and in JSBSim runs.

    Beside bare JSBSim, and beside ecos, libcosim, FMPy, PathSim and RotorPy as far as they are installed.  Times belong
    to the machine.

    Parameters
    ----------
    full : bool
        More rounds of longer flights.
    only : sequence of str
        This part alone, or these: step, peers, pathsim, rotorpy, start.
    steps : int or None
        Steps of a timed flight; None: 2500, in full 5000.
    rounds : int or None
        Repetitions; None: 5, in full 9.
    starts : int or None
        Processes started for each figure of a process; None: 5.
    folder : str or None
        Where flights are recorded; None: the system's place for temporary files.
    page : Path or None
        Write the tables in.
    """
    plan = make_plan(full, only, {"steps": steps, "rounds": rounds, "starts": starts, "folder": folder})
    if folder is not None and not Path(folder).is_dir():
        raise InputError(f"folder {folder}: is no folder")
    if page is not None:
        check_page(page)
    measured = measure(plan, (progress or api.Progress()).update)
    if page is not None:
        words = sys.argv[1:] if sys.argv[1:2] == ["benchmark"] else ["benchmark", *sys.argv[1:]]
        write_page(page, measured, shlex.join(["hexjet", *words]))
    return BenchResult(measured, {} if page is None else {"page": page})
