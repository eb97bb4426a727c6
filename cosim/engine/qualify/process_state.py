"""State of the child process that an FMU shares with everything else in it."""

from __future__ import annotations

import locale
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from cosim.base.runtime.processes import measure_megabytes


def read_process_state() -> dict[str, Any]:
    """Return the process-wide state that an FMU may change, by its description."""
    third, smallest = [1.0, 3.0], [sys.float_info.min, 0.5]  # in lists, so that Python computes it here and now
    return {
        "the working directory": os.getcwd(),
        "how the processor rounds": (third[0] / third[1], -third[0] / third[1]),
        "how the processor handles tiny numbers (is it built with -ffast-math?)": (
            # as text, because numbers that are flushed to 0 also compare equal to it
            (smallest[0] * smallest[1]).hex()
        ),
        "the locale's decimal point": locale.localeconv()["decimal_point"],
    }


def describe_changes(before: Mapping[str, Any]) -> list[str]:
    """Return problems about changes since ``before``, a result of :func:`read_process_state`; restore the folder."""
    after = read_process_state()
    with suppress(OSError):
        os.chdir(before["the working directory"])
    return [f"changes {what}, for everything in the same process" for what in before if after[what] != before[what]]


def count_threads() -> int:
    """Return the number of this process's threads; 0 where there is no ``/proc``."""
    try:
        return len(os.listdir("/proc/self/task"))
    except OSError:
        return 0


def list_mapped_libraries() -> set[str]:
    """Return the names of the files mapped by this process; empty where there is no ``/proc``."""
    try:
        with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
            return {os.path.basename(line.split()[-1]) for line in maps if "/" in line}
    except OSError:
        return set()


def measure_resident_bytes() -> float:
    """Return the resident memory [bytes]; where there is no ``/proc``, its maximum so far."""
    if size := measure_megabytes(os.getpid()):
        return size * 2**20
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)
