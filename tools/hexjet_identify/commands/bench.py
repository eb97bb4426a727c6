"""hexjet engine from-bench: an engine out of its bench logs."""

from __future__ import annotations

from cosim.commands import Command, one_thread
from hexjet_identify.commands import LOG_METAVARS, LOG_OPTIONS

engine_from_bench = Command(
    "engine from-bench",
    "hexjet_identify.api.bench:identify_bench",
    "bench.csv --out my-engine",
    options={"throttle_range": "--throttle-range --range", **LOG_OPTIONS},
    metavars={"logs": "FILE", "command": "SUM", "output": "SUM", "throttle_range": "LOW HIGH", "fit": "PARAMETER",
              "settings": "PARAMETER=VALUE", **LOG_METAVARS},
    folder=lambda arguments: "engine-from-bench",
    before=lambda arguments: one_thread(),
    succeeded=lambda result: result.found,
    ends="Status 1: the logs do not tell, or the model does not explain them.",
)  # fmt: skip
