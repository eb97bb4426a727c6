"""The tables that the page draws its stability map from, for any two keys and any metric.

Cells are counted over all flights; only the single flights laid over them are a sample, with a fixed seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import isqrt

import numpy as np

from cosim.base.arrays import Array
from cosim.campaign.analysis.figures import Figure, group_medians, round_digits
from cosim.campaign.analysis.statistics import Counts
from cosim.campaign.analysis.summary import controller_indices
from cosim.campaign.analysis.table import KINDS, FlightTable, KeyColumn
from cosim.results.wording import Metric

# With fewer flights the interval of a cell's success rate is wider than 60 points.
MIN_PER_CELL = 5
MAX_MAP_KEYS = 6  # most influential keys that get maps
MAX_POINTS = 400  # points of successes, and of others


def map_tables(table: FlightTable, keys: Sequence[int], pair: tuple[int, int], colour: str) -> Figure:
    """Return the data of the stability map; ``keys`` and ``pair`` are indices, ``pair`` and ``colour`` are shown first.

    Of every pair of keys and every controller: the number of flights in each cell, of successes, and the median of each
    metric over those that completed, row by row upwards; None where there are fewer than ``least`` to take it of.
    """
    chosen = [table.keys[key] for key in keys]
    pairs = list(combinations(range(len(chosen)), 2))
    sides = [_divide_into_cells(table, key, max(len(pairs), 1)) for key in chosen]
    metrics = table.metrics[:6]
    fewest = 1 if table.grid else MIN_PER_CELL
    return {
        "grid": table.grid,
        "least": fewest,
        "pair": [keys.index(key) for key in pair],
        "colour": colour,
        "controllers": table.controllers,
        "keys": [
            {
                "title": key.title,
                "label": key.label,
                "log": key.log,
                "levels": key.levels,
                "edges": round_digits(edges, 6),
            }
            for key, (edges, _) in zip(chosen, sides, strict=True)
        ],
        "metrics": [_describe_metric(table, metric) for metric in metrics],
        "cells": {
            f"{x},{y}": [
                _summarise_cells(table, controller, sides[x], sides[y], metrics, fewest)
                for controller in controller_indices(table)
            ]
            for x, y in pairs
        },
        "points": [_sample_points(table, controller, chosen, metrics) for controller in controller_indices(table)],
    }


def _describe_metric(table: FlightTable, metric: Metric) -> Figure:
    values = metric.factor * table.values[metric.name]
    low, high = np.nanquantile(values, [0.02, 0.98])
    return {
        "name": metric.name,
        "label": metric.label,
        "unit": metric.unit,
        "range": round_digits(np.array([low, high])),
    }


def _divide_into_cells(table: FlightTable, key: KeyColumn, pairs: int) -> tuple[Array, Counts]:
    """Return the edges of a key's cells, levels or intervals of equal length, and the cell of each row, or -1."""
    finite = np.isfinite(key.numbers)
    if key.levels:
        return np.arange(-0.5, len(key.levels)), np.where(finite, key.numbers, -1).astype(np.intp)
    flights = max((int(np.sum(table.rows_of(controller))) for controller in controller_indices(table)), default=0)
    flights_per_cell = 15  # mean number of random draws in a cell
    # A page can hold this many cells over all pairs of keys, for one controller.
    max_cells = 6000
    count = int(np.clip(isqrt(flights // flights_per_cell), 3, max(16, min(40, isqrt(max_cells // pairs)))))
    numbers = np.where(finite, key.numbers, key.numbers[finite][0] if finite.any() else 1.0)
    levels = np.unique(numbers)
    scaled, back = (np.log(numbers), np.exp) if key.log else (numbers, np.array)
    if table.grid or 2 * levels.size <= 3 * count:
        edges: Array = _edges_around(np.unique(scaled))
    elif not key.log and np.all(levels % 1.0 == 0.0):  # equal number of integers in each cell
        wide = -(-(levels[-1] - levels[0] + 1.0) // count)
        edges = np.arange(levels[0] - 0.5, levels[-1] + wide, wide)
    else:
        edges = np.linspace(np.min(scaled), np.max(scaled), count + 1)
    cell = np.clip(np.searchsorted(edges, scaled, side="right") - 1, 0, edges.size - 2)
    return back(edges), np.where(finite, cell, -1).astype(np.intp)


def _edges_around(levels: Array) -> Array:
    """Return the edges of cells around levels: half way between levels, and as far outside of the outer ones."""
    if levels.size < 2:
        middle = float(levels[0]) if levels.size else 0.0
        return middle + np.array([-0.5, 0.5]) * (abs(middle) or 1.0)
    middles = 0.5 * (levels[1:] + levels[:-1])
    return np.concatenate(([2.0 * levels[0] - middles[0]], middles, [2.0 * levels[-1] - middles[-1]]))


def _summarise_cells(
    table: FlightTable,
    controller: int,
    across: tuple[Array, Counts],
    upwards: tuple[Array, Counts],
    metrics: Sequence[Metric],
    fewest: int,
) -> Figure:
    width, height = across[0].size - 1, upwards[0].size - 1
    rows = table.rows_of(controller) & (across[1] >= 0) & (upwards[1] >= 0)
    cell = (upwards[1] * width + across[1])[rows]
    total = width * height
    return {
        "n": np.bincount(cell, minlength=total).tolist(),
        "k": np.bincount(cell, table.success[rows], minlength=total).astype(int).tolist(),
        "m": [_cell_median(cell, metric.factor * table.values[metric.name][rows], total, fewest) for metric in metrics],
    }


def _cell_median(cell: Counts, values: Array, total: int, fewest: int) -> list[float | None]:
    finite = np.isfinite(values)
    cell, values = cell[finite], values[finite]
    counts = np.bincount(cell, minlength=total)
    present = np.flatnonzero(counts)
    medians = np.full(total, np.nan)
    _, numbered = np.unique(cell, return_inverse=True)
    medians[present] = group_medians(numbered, values)
    return round_digits(np.where(counts >= fewest, medians, np.nan))


def _sample_points(table: FlightTable, controller: int, keys: Sequence[KeyColumn], metrics: Sequence[Metric]) -> Figure:
    generator = np.random.default_rng(1)
    flown = table.rows_of(controller)
    samples = []
    for group in (flown & table.success, flown & ~table.success):
        rows = np.flatnonzero(group)
        samples.append(np.sort(generator.choice(rows, MAX_POINTS, replace=False)) if rows.size > MAX_POINTS else rows)
    rows = np.concatenate(samples)
    return {
        "shown": [int(sample.size) for sample in samples],
        "of": [int(np.sum(flown & table.success)), int(np.sum(flown & ~table.success))],
        "flight": table.flight[rows].tolist(),
        "kind": [KINDS[kind] for kind in table.kind[rows]],
        "keys": [round_digits(key.numbers[rows]) for key in keys],
        "m": [round_digits(metric.factor * table.values[metric.name][rows]) for metric in metrics],
    }
