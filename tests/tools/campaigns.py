"""Campaigns that nobody flew: the draws of a study with outcomes from formulas, for what reads campaigns."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from math import sin
from pathlib import Path
from typing import Any

import numpy as np

from cosim.campaign.store import Campaign
from cosim.campaign.study.plan import Flight, flights
from cosim.campaign.study.study import Study
from cosim.results.metrics import metric_names

Row = dict[str, Any]
Outcome = Callable[[Flight, np.random.Generator], Row]

DELAY, MASS, GAIN = "mismatch.delay_samples", "vehicle.mass_kg", "mismatch.thrust_factor"
WIND, TURBULENCE, NOISE = "environment.wind_ned_m_s.1", "environment.turbulence_severity", "sensor_noise"
INPUTS = json.dumps({"versions": {"jsbsim": "1.3.2", "numpy": "2.4.6"}, "sha256": {"edf.fmu": "ab" * 32}})


def study(**changes: Any) -> Study:
    """Three keys under a Latin hypercube, two controllers."""
    table: dict[str, Any] = {
        "name": "made-up",
        "title": "Delay, mass and wind",
        "scenario": "roll-doublet",
        "controllers": ["baseline", "smith"],
        "design": "latin-hypercube",
        "runs": 300,
        "vary": [
            {"key": DELAY, "range": [0, 20]},
            {"key": MASS, "range": [0.7, 1.3], "relative": "factor"},
            {"key": WIND, "normal": {"mean": 0.0, "sd": 3.0}},
        ],
        "success": {"roll.overshoot_percent": {"max": 60.0}},
    }
    table |= changes
    return Study.from_table({key: value for key, value in table.items() if value is not None}, Path(), "made-up")


def loop(flight: Flight, chance: np.random.Generator) -> Row:
    """A made-up loop: delay and mass make it swing, the predictor takes half of it, wind adds a little."""
    delay = float(flight.values.get(DELAY, 0.0))
    mass = float(flight.values.get(MASS, 5.525)) / 5.525
    wind = float(flight.values.get(WIND, 0.0))
    rough = 0.03 * float(flight.values.get(TURBULENCE, 0)) + (0.02 if flight.values.get(NOISE, True) else 0.0)
    helped = 0.55 if flight.controller == "smith" else 1.0
    swing = helped * (0.3 + 0.03 * delay + 0.8 * abs(mass - 1.0) + 0.01 * abs(wind)) + (rough + 0.04) * chance.normal()
    if swing > 0.95:
        at = 1.2 + 3.0 * chance.random()
        return {
            "outcome": "diverged",
            "reason": f"leaned past 60 deg at {at:.3f} s (roll {60 + delay:.1f} deg)",
            "duration_s": at,
        }
    if mass > 1.25 and swing > 0.6:
        at = 4.0 + chance.random()
        return {
            "outcome": "crashed",
            "reason": f"hit the ground at {mass:.1f} m/s at {at:.3f} s (upright)",
            "duration_s": at,
        }
    return {
        "outcome": "completed",
        "reason": "flew 2500 steps",
        "duration_s": 10.0,
        "roll.overshoot_percent": max(0.0, 90.0 * swing),
        "roll.rmse_rad": 0.05 + 0.1 * max(swing, 0.0),
        "roll.settling_time_s": None if swing > 0.7 else 0.8 + max(swing, 0.0),
        "roll.final_error_rad": 10.0 ** (-3.0 + 2.0 * swing),
        "pitch.max_abs_error_rad": 0.01 * (1.0 + abs(wind)),
        "altitude.max_abs_error_m": 0.3 * abs(1.0 + sin(mass)),
    }


def campaign(folder: Path, of: Study, outcome: Outcome = loop, finished: int | None = None) -> Campaign:
    """Every flight of a study, or the first ones, as a campaign in ``folder``."""
    chance = np.random.default_rng(7)
    plan = flights(of)
    rows = [_row(of, flight, outcome(flight, chance)) for flight in plan[:finished]]
    names = rows[0] if rows else _row(of, plan[0], {})
    return Campaign(folder, of, {name: [row[name] for row in rows] for name in names}, len(plan))


def _row(of: Study, flight: Flight, outcome: Mapping[str, Any]) -> Row:
    row: Row = {"flight": flight.number, "draw": flight.draw, "controller": flight.controller, "seed": flight.seed}
    row |= dict(flight.values)
    row |= {"outcome": "completed", "reason": "", "steps": 2500, "duration_s": 10.0} | dict.fromkeys(metric_names())
    row |= {"inputs": INPUTS, "wall_s": 0.11, "worker": "here:1"} | outcome
    met = all(
        row[name] is not None
        and (span.min is None or row[name] >= span.min)
        and (span.max is None or row[name] <= span.max)
        for name, span in of.success.items()
    )
    return {"success": row["outcome"] == "completed" and met, "beyond": ""} | row
