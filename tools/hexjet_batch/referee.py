"""JSBSim as the referee of a campaign on arrays: some of its flights flown again, and what differs.

Of each controller these are the flights nearest to a limit and a random hundredth of the others.  The verdicts of
JSBSim count in place of those of the batch.  Where the random ones differ, so may flights that were not flown again:
the upper end of the exact interval of how often is taken off the interval of successes, or added to it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.errors import FlightError
from cosim.base.storage.files import write_whole
from cosim.results.wording import DIGITS
from cosim.spec.controller_name import short_name
from cosim.studies import REFEREE, Campaign, Row, Workers, flight_of, metric, metric_names, open_campaign, proportion

# Chosen by us: an honest batch stays within 0.5 % in half of the flights and within 2 % in nine of ten of them.
HALF_WITHIN, MOST_WITHIN = 0.005, 0.02


class Off(NamedTuple):
    """How far the batch is from JSBSim in one metric, over the flights that both flew to a value."""

    name: str
    largest: float  # SI
    flight: int  # the flight of the largest
    half: float  # half of them are within this share
    most: float  # nine of ten are

    @property
    def is_another(self) -> bool:
        """Whether the metric differs by more than the same flights can."""
        return self.half > HALF_WITHIN or self.most > MOST_WITHIN

    @property
    def cells(self) -> list[str]:
        """The difference as texts, a row of a table."""
        of, shares = metric(self.name), [f"{100.0 * share:.2g}" for share in (self.half, self.most)]
        another = "another flight" if self.is_another else ""
        return [of.label, f"{of.factor * self.largest:.3g}", of.unit, str(self.flight), *shares, another]


def judge(folder: Path, workers: Workers, nearest: int = 10, share: float = 0.01) -> None:
    """Fly some flights of a campaign's folder again by JSBSim, and write into it what differs.

    ``nearest``: flights of each controller with the least margins, by size; ``share``: of the others, at random.
    """
    (folder / REFEREE).unlink(missing_ok=True)  # a check of fewer flights
    campaign = open_campaign(folder)
    chosen, random = choose(campaign, nearest, share)
    rows = {number: campaign.row(number) for number in chosen}
    study = campaign.study.changed(batch=False)
    flown = workers.fly(study, [flight_of(study, row) for row in rows.values()])
    again = {int(row["flight"] or 0): row for row in flown}
    table = compare(campaign, rows, again, random)
    write_whole(campaign.folder / REFEREE, json.dumps(table, indent=1, allow_nan=False) + "\n", FlightError)


def choose(campaign: Campaign, nearest: int, share: float) -> tuple[list[int], set[int]]:
    """Return the numbers of the flights to be flown again, and which of them are a random choice."""
    columns = campaign.columns
    numbers, controllers = np.array(columns["flight"]), np.array(columns["controller"])
    margins = np.array([np.inf if margin is None else abs(float(margin)) for margin in columns["margin"]])
    of_batch = np.array([by == "batch" for by in columns["by"]], dtype=np.bool_)
    chosen: list[int] = []
    random: set[int] = set()
    for controller in dict.fromkeys(controllers.tolist()):
        own = np.flatnonzero((controllers == controller) & of_batch)
        order = own[np.argsort(margins[own], kind="stable")]
        rest = np.sort(order[nearest:])
        draws = np.random.default_rng([campaign.study.seed, rest.size])
        drawn = draws.choice(rest, ceil(share * rest.size), replace=False)
        random |= {int(number) for number in numbers[drawn]}
        chosen += [int(number) for number in numbers[np.concatenate((order[:nearest], drawn)).astype(np.intp)]]
    return sorted(chosen), random


def compare(campaign: Campaign, rows: Mapping[int, Row], again: Mapping[int, Row], random: set[int]) -> dict[str, Any]:
    """Return what JSBSim says of flights of a batch, as a table: lines, verdicts that differ, metrics, rates."""
    otherwise = [number for number in rows if rows[number]["success"] != again[number]["success"]]
    off = [found for name in metric_names() if (found := _compare_metric(name, rows, again)) is not None]
    others = [found for found in off if found.is_another]
    by_controller: dict[str, list[int]] = {}
    for number in rows:
        by_controller.setdefault(str(rows[number]["controller"]), []).append(number)
    widening = {name: rates([number for number in flown if number in random], rows, again)
             for name, flown in by_controller.items()}  # fmt: skip
    return {
        "flights": len(campaign),
        "confirmed": not otherwise and not others,
        "says": list(_summarise_comparison(campaign, rows, random, otherwise, others)),
        "metrics": [found.cells for found in sorted(off, key=lambda found: -found.half)],
        "verdicts": [
            [str(number), short_name(str(rows[number]["controller"])), _verdict(rows[number]), _verdict(again[number]),
             f"{rows[number]['margin']:.3g}", f"{again[number]['margin']:.3g}"]
            for number in otherwise
        ],
        "success": {str(number): bool(again[number]["success"]) for number in otherwise},
        "rates": {short_name(name): rate for name, rate in widening.items()},
    }  # fmt: skip


def _compare_metric(name: str, rows: Mapping[int, Row], again: Mapping[int, Row]) -> Off | None:
    """Return how far a metric is off; what one has and the other has not is off by its whole size.

    A tenth of the last digit that a page prints is nothing.
    """
    pairs = [(number, rows[number][name], again[number][name]) for number in rows]
    kept = [(number, here, there) for number, here, there in pairs if here is not None or there is not None]
    if not kept:
        return None
    here, there = (np.array([np.nan if pair[i] is None else pair[i] for pair in kept], dtype=float) for i in (1, 2))
    size = np.fmax(np.fmax(np.abs(here), np.abs(there)), np.nanmedian(np.abs(np.append(here, there))))
    apart = np.where(np.isfinite(here - there), np.abs(here - there), size)
    least = 0.1 * 10.0 ** -DIGITS.get(name, 2) / metric(name).factor
    shares = np.where(apart > least, apart / np.maximum(size, 1e-12), 0.0)
    worst = int(np.argmax(apart))
    half, most = (float(value) for value in np.quantile(shares, [0.5, 0.9], method="higher"))
    return Off(name, float(apart[worst]), kept[worst][0], half, most)


def rates(numbers: Sequence[int], rows: Mapping[int, Row], again: Mapping[int, Row]) -> list[float]:
    """Return at most how many of the other successes are none by JSBSim, and how many failures are some: shares."""
    ends = []
    for success in (True, False):
        wrong = sum(rows[n]["success"] is success and again[n]["success"] is not success for n in numbers)
        ends.append(proportion(wrong, len(numbers)).exact[1] if wrong else 0.0)
    return ends


def _summarise_comparison(
    campaign: Campaign, rows: Mapping[int, Row], random: set[int], otherwise: Sequence[int], others: Sequence[Off]
) -> list[str]:
    flown = (
        f"JSBSim flew {len(rows):,} of {len(campaign):,} flights again, the {len(rows) - len(random):,} nearest to "
        f"a limit and {len(random):,} at random"
    )
    covered = sum(by == "batch" for by in campaign.columns["by"])
    alone = f"; {len(campaign) - covered:,} were flown by JSBSim alone" if covered < len(campaign) else ""
    if not otherwise and not others:
        bound = 100.0 * proportion(0, len(random)).exact[1]
        unseen = f"; of the others at most {bound:.2g} % can differ (95 %)" if random else ""
        return [f"{flown}: every verdict is the same, and every metric{unseen}{alone}"]
    lines = []
    if otherwise:
        many = "verdict differs" if len(otherwise) == 1 else "verdicts differ"
        lines.append(f"JSBSim does not confirm this: {len(otherwise):,} {many}; the shares and intervals count it")
    if others:
        named = ", ".join(f"{metric(found.name).label} by {100.0 * found.most:.2g} %" for found in others[:3])
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        lines.append(f"JSBSim does not fly the same flights: a tenth of them is off in {named}{more}")
    return [*lines, f"{flown}{alone}"]


def _verdict(row: Row) -> str:
    return f"{'success' if row['success'] else 'no success'}, {row['reason']}"
