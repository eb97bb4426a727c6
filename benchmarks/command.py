"""hexjet benchmark: what it costs."""

from __future__ import annotations

from cosim.commands import Command

benchmark = Command(
    "benchmark",
    "benchmarks.show:benchmark",
    "--only step --only peers",
    options={"folder": "--dir"},
    metavars={"only": "PART", "page": "FILE.md"},
    runs_code=False,
    succeeded=lambda result: not result.measured.failed,
    ends="Status 1: a part failed; however long anything takes, it is 0.",
)
