"""Mapping files of the library's fan that state how well it is known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import tomli_w
from engine_tools import archive

NOMINAL = {"delay_samples": 20, "pole": 0.8748, "gain": 0.2554}
CORRELATION = [[1.0, -0.8, 0.3], [-0.8, 1.0, 0.0], [0.3, 0.0, 1.0]]


def fan(folder: Path, deviation: list[float], spread: list[float] | None = None, **more: object) -> Path:
    """Write the mapping file of a fan with these deviations of delay, pole and gain."""
    table: Mapping[str, object] = {
        "source": "bench.csv: 6 steps, 2 holds",
        "parameters": list(NOMINAL),
        "deviation": deviation,
        "correlation": CORRELATION,
        **({} if spread is None else {"spread": spread}),
        **more,
    }
    path = folder / "fan.toml"
    fmu = str(archive("edf-as-flown", 3))
    path.write_text(tomli_w.dumps({"fmu": fmu, "parameters": NOMINAL, "uncertainty": table}))
    return path
