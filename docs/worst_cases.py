"""Flies the stored designs over their tolerances and writes what docs/control-design.md says of the corners.

    OPENBLAS_CORETYPE=Haswell python docs/worst_cases.py [--out DIR] [--workers 2] [--budget 100] [--only NAME ...]

Two boxes for each design whose proof is passed: the tolerances that it states, of the gain of the axes and of the
delay; and these with the thrust of one engine off by what the proof has it off.  The proof flies the first at five
points and the second where everything else is as designed.  Here the proof's points are flown, all corners of the box,
and the worst case is searched.  What is finished in the folder is not flown again.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import log
from pathlib import Path

import numpy as np

from cosim.base.arrays import Array
from cosim.campaign.study.normal_space import NormalSpace
from cosim.campaign.study.study import Study
from cosim.campaign.workers.local import LocalWorkers
from cosim.results.report.marks import table, write_marks
from hexjet_design.proof.flights import ENGINE_SPREAD
from hexjet_prove.proof.design_study import design_study
from hexjet_prove.search.probe import Journal, Point, Prober
from hexjet_prove.search.question import JOURNAL
from hexjet_prove.search.worst_case import PlaceMargins, WorstCase, WorstPlan
from hexjet_prove.search.worst_folder import run_worst

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "control-design.md"
DELAY, THRUST = "mismatch.delay_samples", "mismatch.thrust_factor_{}"
TITLES = ("design", "box", "at the proof's points", "at all corners", "worst found", "flights", "where, and how")
SETTLED = 2.0  # sides of the doublet that an engine which is off has for its trim before the doublet, as in the proof


@dataclass(frozen=True)
class Outcome:
    """The least margins of one design in one box."""

    proved: float  # at the points that the proof flies
    corners: Array  # at each of them
    case: WorstCase
    is_corner: bool  # whether the worst case found is a corner of the box
    flights: int


def names() -> list[str]:
    """Return the stored designs that passed their proof."""
    passed = []
    for path in sorted((ROOT / "tests" / "designs").glob("*.toml")):
        proof = tomllib.loads(path.read_text(encoding="utf-8"))["design"].get("proof", {})
        if proof.get("flights") and not proof.get("failed"):
            passed.append(path.stem)
    return passed


def box_study(name: str, odd: bool) -> Study:
    """Return the study of a design over its tolerances; ``odd``: with one engine off too."""
    file = ROOT / "tests" / "designs" / f"{name}.toml"
    study = design_study(file, "", 1, nominal_engine=True)
    if not odd:
        return study
    vehicle, _ = study.base().resolved_vehicle()
    levers = [abs(jet.position_m[1]) for jet in vehicle.jets[:6]]
    key = THRUST.format(levers.index(max(levers)) + 1)
    late = SETTLED * study.settings["command.0.width_s"]
    settings = [f"duration_s={study.settings['duration_s'] + late}", f"command.0.start_s={1.0 + late}", "monitor=false"]
    longer = design_study(file, "", 1, nominal_engine=True, settings=settings)
    table = longer.table() | {
        "vary": [*(v.text for v in longer.vary), f"{key}={1 - ENGINE_SPREAD:g}:{1 + ENGINE_SPREAD:g}"]
    }
    return Study.from_table(table, longer.folder, str(file))


def places(study: Study, points: Sequence[tuple[float, bool, float]]) -> Array:
    """Return points of gain, latest delay or none, and thrust as places of the box, -1 to 1 a key."""
    rows = []
    for gain, late, thrust in points:
        row = []
        for vary in study.vary:
            assert vary.range is not None
            low, high = vary.range
            if vary.key == DELAY:
                row.append(1.0 if late else -1.0)
            elif vary.scale == "log":  # an inertia: one over the gain
                row.append(2.0 * log(1.0 / gain / low) / log(high / low) - 1.0)
            else:
                row.append(2.0 * (thrust - low) / (high - low) - 1.0)
        rows.append(row)
    return np.clip(np.array(rows), -1.0, 1.0)


def fly_box(name: str, odd: bool, out: Path, workers: LocalWorkers, budget: int) -> Outcome:
    """Search a box, and fly the proof's points and all corners of it beside."""
    folder = out / (f"{name}-odd" if odd else name)
    study = box_study(name, odd)
    saved = run_worst(study, WorstPlan(within=None, budget=budget), folder, workers, resume=True)
    (case,) = saved.result.cases
    flown = saved.result.study
    prober = Prober(flown, saved.result.plan.seeds, 0.0, workers, Journal(folder / JOURNAL))
    margins = PlaceMargins(saved.result.plan, prober, NormalSpace(flown), case.controller)
    spread = 1.0 - ENGINE_SPREAD, 1.0 + ENGINE_SPREAD
    proved = [(1.0, False, 1.0), *((gain, late, 1.0) for gain in (0.7, 1.3) for late in (False, True))]
    proved += [(1.0, False, thrust) for thrust in spread] if odd else []
    corners = np.array(list(product((-1.0, 1.0), repeat=len(flown.vary))))
    points = margins.points(corners)
    found = Point.of(case.controller, case.values)
    return Outcome(
        float(margins(places(flown, proved)).min()),
        margins(corners),
        case,
        found in points,
        len(Journal(folder / JOURNAL).read()),
    )


def row(name: str, odd: bool, of: Outcome) -> list[str]:
    """Return the row of the table."""
    box = "gain, delay" + (", one engine's thrust" if odd else "")
    values = ", ".join(f"`{key.removeprefix('mismatch.')}` {value:.3g}" for key, value in of.case.values.items())
    where = f"{'a corner' if of.is_corner else 'no corner'}: {values}"
    if of.case.fails:
        where += f": {of.case.reason}; {int(np.sum(of.corners < 0.0))} of {len(of.corners)} corners fail"
    margins = [f"{margin:.2f}" for margin in (of.proved, float(of.corners.min()), of.case.margin)]
    return [name, box, *margins, f"{of.flights}", where]


def main() -> None:
    """Write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "worst-cases", metavar="DIR")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--only", nargs="+", choices=names(), metavar="NAME")
    given = parser.parse_args()
    rows = []
    with LocalWorkers(given.workers) as workers:
        for name in given.only or names():
            for odd in (False, True):
                rows.append(row(name, odd, fly_box(name, odd, given.out, workers, given.budget)))
                print(" | ".join(rows[-1]), flush=True)
    if not given.only:
        write_marks(PAGE, {"designs worst": table(TITLES, rows, 2)})


if __name__ == "__main__":
    main()
