"""Flies the shipped studies and searches and writes their tables into docs/campaigns.md and docs/tables/campaigns.md.

    OPENBLAS_CORETYPE=Haswell python docs/studies.py [--out runs/studies] [--workers 2] [--only full-scale]

What is finished in the folder is taken up and not flown again: after a change of the program take another folder.  The
kernels are those that the command hexjet takes: numpy is loaded before they could be chosen.
"""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Sequence
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from cosim.campaign import open_campaign
from cosim.campaign.analysis.summary import (
    SUCCESS,
    controller_indices,
    rank_keys,
    success_fractions,
)
from cosim.campaign.analysis.table import (
    KINDS,
    FlightTable,
    Mask,
    read_flight_table,
)
from cosim.cli.main import main as hexjet
from cosim.results.report.marks import check_marks, table, write_marks

PAGE = Path(__file__).parent / "campaigns.md"
DELAY, STEP_S = "engine_parameters.delay_samples", 0.004  # s, the control step that a sample is of
LOAD, LEVER, SIDE_GUST = "disturbance.0.mass_kg", "disturbance.0.offset_m.1", "disturbance.1.velocity_ned_m_s.1"
LATE = (12.0, 20.0, 25.0, 30.0, 37.0)  # samples, edges of the classes; the model has 25
ECU_SAMPLES = (15.0, 25.0)  # up to 60 and 100 ms late, and later: the full-scale flights are counted so
HEAVY_M_S = 10.0  # up to here every gust is held with the heaviest load that is named

ROLL = '--success "roll.max_abs_error_rad<=0.1745" --success "roll.oscillation_rad<=0.01745"'
HELD = f'{ROLL} --success "roll.final_error_rad<=0.0349" --success "altitude.max_abs_error_m<=3"'
FULL = "--set duration_s=14 --set monitor=false --set vehicle.fuel.mass_kg=1.5"
INERTIA = '--vary "vehicle.inertia_kg_m2.0*=1:2"'
# Name of the mark, and what is searched.
SEARCHES = {
    "full-scale-together": "hexjet search full-scale-gust --vary vehicle.mass_kg=40:61.97 "
    f"{INERTIA} --vary engine_parameters.delay_samples=0:30 {FULL} {HELD}",
    "full-scale-inertia": f"hexjet search full-scale-gust {INERTIA} --over vehicle.mass_kg=46,54,61.97 {FULL} {HELD}",
}
PARTS = {
    "predictor-robustness": ("robustness", "robustness-drives", "robustness-delay", "robustness-missed"),
    "payload-and-gust": ("envelope", "envelope-lever"),
    "full-scale": ("full-scale", "full-scale-drives"),
    "searches": tuple(SEARCHES),
}


def run(command: str, folder: Path, workers: int) -> None:
    """A command of hexjet into a folder, or on with what is there.  Raises SystemExit if it did not come to its end."""
    words = [*shlex.split(command)[1:], "--out", str(folder), "--workers", str(workers)]
    try:
        hexjet([*words, "--resume"] if folder.is_dir() else words)
    except SystemExit as end:
        if end.code:
            raise


def flown_of(name: str, out: Path, workers: int) -> FlightTable:
    """A study's flights, flown as far as they are not there yet."""
    run(f"hexjet sweep {name}", out / name, workers)
    return read_flight_table(open_campaign(out / name))


def percent(part: Mask, of: Mask) -> str:
    """The share of ``of`` that is ``part`` too."""
    if not np.any(of):
        return "-"
    return f"{100.0 * np.count_nonzero(part & of) / np.count_nonzero(of):.0f} %"


def lost(flown: FlightTable) -> Mask:
    return np.greater(flown.kind, KINDS.index("missed"))


def shared(flown: FlightTable) -> str:
    """How often each controller succeeds, and how many flights it loses."""
    rows = []
    for place, found in zip(controller_indices(flown), success_fractions(flown), strict=True):
        low, high = found.wilson
        gone = np.count_nonzero(lost(flown) & flown.rows_of(place))
        share = f"{100.0 * (found.value or 0.0):.1f} %"
        rows.append([flown.controllers[place], share, f"{100.0 * low:.0f} to {100.0 * high:.0f} %", f"{gone}"])
    return table(["controller", "succeeds", "95 %", f"lost, of {found.of}"], rows)


def drives(flown: FlightTable) -> str:
    """First-order index and partial rank correlation of every key with success; of those within chance the latter."""
    found = [rank_keys(flown, place, SUCCESS) for place in controller_indices(flown)]
    rows = []
    for key in flown.keys:
        cells = []
        for ranking in found:
            (effect,) = [each for each in ranking.effects if each.key == key.path] if ranking else [None]
            share = f"{100.0 * effect.index:.0f} %" if effect and effect.real else "within chance"
            cells.append("-" if effect is None else f"{share}, {effect.partial or 0.0:+.2f}")
        rows.append([f"`{key.path}`", *cells])
    return code(table(["key", *flown.controllers], rows))


def code(text: str) -> str:
    """A table in which names stand between backquotes."""
    return text.replace("\\`", "`").replace("\\_", "_")


def by_delay(flown: FlightTable) -> str:
    """The share of successes by the true delay."""
    (late,) = [key.numbers for key in flown.keys if key.path == DELAY]
    classes = [np.greater(late, low) & np.less_equal(late, high) for low, high in pairwise(LATE)]
    titles = [f"{low + 1:.0f} to {high:.0f}" for low, high in pairwise(LATE)]
    rows = [
        [name, *(percent(flown.success, each & flown.rows_of(place)) for each in classes)]
        for place, name in enumerate(flown.controllers)
    ]
    return table(["samples", *titles], rows)


def missed(flown: FlightTable, limits: dict[str, float]) -> str:
    """What the flights that do not succeed are beyond; one may be beyond several."""
    rows = []
    for place, name in enumerate(flown.controllers):
        none = flown.rows_of(place) & ~flown.success
        above = [np.greater(np.nan_to_num(flown.values[key]), most) for key, most in limits.items()]
        counts = [np.count_nonzero(none & each) for each in (none, lost(flown), *above)]
        rows.append([name, *map(str, counts)])
    return table(["controller", "no success", "lost", *(f"`{key}`" for key in limits)], rows).replace("\\", "")


def envelope(flown: FlightTable) -> str:
    """Shares of the grid, and the heaviest load off to one side that is held in every gust up to HEAVY_M_S."""
    load, lever, gust = (_numbers(flown, key) for key in (LOAD, LEVER, SIDE_GUST))
    middle, off = np.equal(lever, 0.0), np.equal(lever, lever.min())
    rows = []
    for place, name in enumerate(flown.controllers):
        mine = flown.rows_of(place)
        some = mine & off & np.less_equal(gust, HEAVY_M_S)
        loads = np.unique(load)
        # as long as no lighter load is missed
        held = list(takewhile(lambda each, some=some: bool(np.all(flown.success[some & np.equal(load, each)])), loads))
        heaviest = f"{held[-1]:g} kg" if held else "none"
        rows.append([name, percent(flown.success, mine), percent(flown.success, mine & middle), heaviest])
    side = f"{-100.0 * lever.min():g} cm off: heaviest load held in gusts up to {HEAVY_M_S:g} m/s"
    return table(["controller", "whole envelope", "load in the middle", side], rows)


def by_lever(flown: FlightTable) -> str:
    """In how many gusts each controller succeeds, by load times lever."""
    product = np.round(_numbers(flown, LOAD) * np.abs(_numbers(flown, LEVER)), 4)
    rows = []
    for each in np.unique(product):
        here = np.equal(product, each)
        cells = []
        for place in controller_indices(flown):
            mine = here & flown.rows_of(place)
            cells.append(f"{np.count_nonzero(mine & flown.success)} of {np.count_nonzero(mine)}")
        rows.append([f"{each:g} kg m", *cells])
    return table(["load times lever", *flown.controllers], rows)


def _numbers(flown: FlightTable, path: str) -> Any:
    (found,) = [key.numbers for key in flown.keys if key.path == path]
    return found


def full(flown: FlightTable) -> str:
    """How often, and how often with an ECU that is so late."""
    late, everything = _numbers(flown, DELAY), np.ones(flown.flight.size, dtype=bool)
    (found,) = success_fractions(flown)
    low, high = found.wilson
    gone = np.count_nonzero(lost(flown))
    cells = [f"{found.of}", percent(flown.success, everything), f"{100.0 * low:.0f} to {100.0 * high:.0f} %", f"{gone}"]
    soon, later = (np.less_equal(late, edge) for edge in ECU_SAMPLES)
    cells += [percent(flown.success, each) for each in (soon, later & ~soon, ~later)]
    edges = [f"{1e3 * STEP_S * edge:.0f}" for edge in ECU_SAMPLES]
    titles = ["flights", "succeed", "95 %", "lost", f"up to {edges[0]} ms late", f"to {edges[1]} ms", "later"]
    return table(titles, [cells], left=0)


def searched(name: str, out: Path, workers: int) -> str:
    """The command, and where it breaks."""
    run(SEARCHES[name], out / name, workers)
    found = json.loads((out / name / "search.json").read_text(encoding="utf-8"))
    rows = []
    for edge in found["alone"]:
        at = [] if edge["level"] is None else [f"{edge['level']:g}"]
        breaks = "none" if edge["breaks"] is None else f"{edge['breaks']:.4g}"
        holds = edge["end"] if edge["breaks"] is None else edge["holds"]
        start = f"{edge['start']:.4g}"
        rows.append([f"`{edge['key']}`", *at, start, "-" if holds is None else f"{holds:.4g}", breaks, edge["reason"]])
    over = ["at"] if found["alone"][0]["level"] is not None else []
    said = code(table(["key", *over, "from", "holds to", "breaks at", "then"], rows))
    return f"```\n{SEARCHES[name]}\n```\n\n{said}"


def made(only: Sequence[str], out: Path, workers: int) -> dict[str, str]:
    """The page's parts by their marks."""
    parts: dict[str, str] = {}
    if "predictor-robustness" in only:
        flown = flown_of("predictor-robustness", out, workers)
        limits = open_campaign(out / "predictor-robustness").study.success
        most = {key: each.max for key, each in limits.items() if each.max is not None}
        parts |= {"robustness": shared(flown), "robustness-drives": drives(flown)}
        parts |= {"robustness-delay": by_delay(flown), "robustness-missed": missed(flown, most)}
    if "payload-and-gust" in only:
        flown = flown_of("payload-and-gust", out, workers)
        parts |= {"envelope": envelope(flown), "envelope-lever": by_lever(flown)}
    if "full-scale" in only:
        flown = flown_of("full-scale", out, workers)
        parts |= {"full-scale": full(flown), "full-scale-drives": drives(flown)}
    if "searches" in only:
        parts |= {name: searched(name, out, workers) for name in SEARCHES}
    return parts


def main() -> None:
    """Fly everything into the folder and write the tables into the two pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/studies"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="studies")
    given = parser.parse_args()
    check_marks(PAGE, [mark for name in given.only for mark in PARTS[name]])
    write_marks(PAGE, made(given.only, given.out, given.workers))


if __name__ == "__main__":
    main()
