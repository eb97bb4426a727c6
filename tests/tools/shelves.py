"""Folders of runs that nobody flew: summaries alone, as many as a test wants."""

from __future__ import annotations

import json
from pathlib import Path

CONTROLLERS = ("smith", "baseline", "filtered-smith")


def shelf(folder: Path, runs: int) -> Path:
    """``runs`` finished runs, ``run-00000`` on: the k-th has a roll RMSE of k/1000 rad."""
    for k in range(runs):
        place = folder / f"run-{k:05d}"
        place.mkdir(parents=True)
        summary = {
            "scenario": "roll-doublet",
            "aircraft": "hexjet",
            "engine": "edf",
            "controller": CONTROLLERS[k % 3],
            "started": f"2026-01-{1 + k // 1440 % 28:02d}T{k // 60 % 24:02d}:{k % 60:02d}:00+00:00",
            "outcome": "completed",
            "verdict": "as planned" if k % 5 else "beyond limits",
            "expectations_met": True,
            "duration_s": 20.0,
            "metrics": {"roll": {"commanded": True, "rmse_rad": k / 1000.0, "overshoot_percent": None}},
            "position": {"drift_m": 1.0 + k % 7},
            "own_metrics": {"own.jerk": 2.0},
        }
        (place / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
        (place / "report.html").write_text(f"<title>{place.name}</title>", encoding="utf-8")
    return folder
