"""A flight as a page carries it: the samples of every column, what happened, and the vehicle to draw.

Of a flight of more than ``MAX_ROWS`` steps a column has the least and the greatest of each few steps, in the order in
which they come (:func:`extremes`): no peak is lost, and an instant is off by less than those steps.

A column is rounded to whole multiples of a power of two (whole numbers exactly): at most 2^-16 of the range between its
first and last percentile or, where it is rougher than that, 2^-5 of its roughness, the first quartile of its second
differences, so that noise is not carried to bits that nobody can see; then differenced, split into bytes and deflated,
as the browser's DecompressionStream undoes.
A page decodes a column when it is looked at.  What is exact to the last bit is in the log.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Mapping, Sequence
from math import ceil, floor, log2
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import FlightError, InputError
from cosim.base.layout import UP
from cosim.base.protocols import Column
from cosim.results.events import Event, Phase, row_spans, time_spans
from cosim.results.log.recorder import Log
from cosim.results.log.tables import TIME
from cosim.results.metrics import REFUSED, Reach, saturation_in_flight
from cosim.results.run import Run
from cosim.spec.vehicle import Vehicle

# Bits for a column's noise, chosen by us: half a quantisation step is 1/64 of the noise.
NOISE_BITS = 5
# Largest number of quantisation steps from zero: second differences of such numbers have 32 bits.
_MAX_MULTIPLE = 2.0**28
# Rows of a column on a page, chosen by us: ten minutes at 250 Hz, which are some 9 MB.
MAX_ROWS = 150_000
# Intervals of saturation on a page, chosen by us: more than a screen has pixels for.
MAX_INTERVALS = 2000
REST_THRUST_NOTE = "where the engine would settle if its throttle were held; from its static curve, not in the log"


class Packed(NamedTuple):
    """A column as it goes into a page: ``base + step * n`` of whole numbers n, differenced ``order`` times."""

    base: float
    step: float
    order: int
    planes: int  # bytes of each number, lowest first
    gaps: bool  # True: a byte a row marks missing numbers
    data: str  # deflated, base64; empty: all ``base``


def pack(values: Array) -> Packed | None:
    """Pack a column; return None where it has no number at all."""
    finite = np.isfinite(values)
    if not finite.any():
        return None
    gaps = not finite.all()
    values_filled = values if not gaps else _fill_gaps(values, finite)
    low, high = float(values_filled.min()), float(values_filled.max())
    if low == high and not gaps:
        return Packed(low, 1.0, 0, 0, False, "")
    step = quantisation_step(values_filled, low, high)
    base = 0.0 if max(abs(low), abs(high)) / step < _MAX_MULTIPLE else step * floor(low / step)
    numbers = np.rint((values_filled - base) / step).astype(np.int64)
    middle = max(0, numbers.size // 2 - 10_000)
    tried = numbers[middle : middle + 20_000]
    order = min(range(3), key=lambda order: _count_bits(_difference_repeatedly(tried, order)))
    best = _difference_repeatedly(numbers, order)
    zigzag = ((best << 1) ^ (best >> 63)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T
    bytes_used = max((n + 1 for n in range(4) if planes[n].any()), default=0)
    raw = planes[:bytes_used].tobytes() + ((~finite).astype(np.uint8).tobytes() if gaps else b"")
    return Packed(base, step, order, bytes_used, gaps, base64.b64encode(zlib.compress(raw)).decode())


def quantisation_step(values: Array, low: float, high: float) -> float:
    """Return the power of two that a column of numbers between ``low`` and ``high`` is rounded to."""
    if max(abs(low), abs(high)) < _MAX_MULTIPLE and np.array_equal(values, np.rint(values)):
        return 1.0
    if max(abs(low), abs(high)) > 1e300:
        return 2.0**1000  # differences would overflow
    first, last = _select_ranks(values, ceil(0.01 * (values.size - 1)), floor(0.99 * (values.size - 1)))
    usual = abs(last - first) or (high - low) or abs(high) or 1.0
    rough = _select_ranks(np.abs(np.diff(values, 2)), (values.size - 3) // 4)[0] if values.size > 2 else 0.0
    # 16 bits of the usual range are sixteen times finer than a screen of 4000 pixels.
    finest = max(log2(usual) - 16, log2(max(rough, 1e-300)) - NOISE_BITS)
    return float(2.0 ** floor(max(finest, log2(max(high - low, 1e-300)) - log2(_MAX_MULTIPLE) + 1.0, -1000.0)))


def _select_ranks(values: Array, *ranks: int) -> list[float]:
    """Return the values of these ranks, 0 for the smallest; faster than percentiles, which interpolate."""
    ordered = np.partition(values, ranks)
    return [float(ordered[rank]) for rank in ranks]


def _fill_gaps(values: Array, finite: NDArray[np.bool_]) -> Array:
    """Return the values with gaps filled by the last number before them, or the first of all."""
    rows = np.maximum.accumulate(np.where(finite, np.arange(values.size), -1))
    rows[rows < 0] = int(np.argmax(finite))
    filled: Array = values[rows]
    return filled


def _difference_repeatedly(numbers: NDArray[np.int64], order: int) -> NDArray[np.int64]:
    for _ in range(order):
        numbers = np.diff(numbers, prepend=np.int64(0))
    return numbers


def _count_bits(numbers: NDArray[np.int64]) -> float:
    return float(np.log2(np.abs(numbers[2:]) + 1.0).sum())


class FlightData(NamedTuple):
    """Data of a flight that a page draws."""

    log: Log
    label: str
    colour: str
    step_s: float
    events: Sequence[Event] = ()
    vehicle: Vehicle | None = None
    jets_m: Sequence[Sequence[float]] = ()  # of jets, if the vehicle is unknown
    times: Array | None = None  # None: 0, step_s, ...
    derived: Mapping[str, Callable[[], Array]] = MappingProxyType({})  # columns computed for the page
    made: Sequence[Column] = ()  # meanings of some derived columns
    upsets: Sequence[tuple[float, float]] = ()  # intervals of disturbance
    phases: Sequence[Phase] = ()  # drawn behind the lines
    reach: Reach | None = None  # as used by the flight's metrics


def describe_run(run: Run, label: str, colour: str, events: Sequence[Event]) -> FlightData:
    summary, vehicle = run.summary, read_vehicle(run)
    return FlightData(
        run.log, label, colour, summary.step_s, events, vehicle, jets_m=summary.jets_m, reach=summary.reach
    )


def run_data(flight: FlightData) -> tuple[dict[str, Any], dict[str, str]]:
    """Return a run's table for a page, ready for JSON, and the packed data of its columns by name."""
    log = flight.log
    group = group_length(len(log)) if flight.times is None else 1
    columns, data, empty = _pack_columns(flight, group)
    described = {
        "label": flight.label,
        "colour": flight.colour,
        "rows": len(log) if group == 1 else 2 * ceil(len(log) / group),
        "step": flight.step_s if group == 1 else 0.5 * group * flight.step_s,
        "group": group,
        "thinned": _describe_thinning(flight.label, len(log), group, flight.step_s),
        "uniform": flight.times is None,
        "columns": columns,
        "empty": empty,
        "events": [
            {"t": event.time_s, "end": event.end_s, "kind": event.kind, "text": event.text, "banded": _is_banded(event),
             "lasts": event.lasts, "severity": event.severity}
            for event in flight.events
        ],
        "upsets": flight.upsets,
        "phases": [list(phase) for phase in flight.phases],
        "saturated": _saturation_times(log, flight.reach, flight.step_s) if len(log) and flight.times is None else [],
        "vehicle": describe_shape(flight.vehicle) if flight.vehicle is not None else _jets_only(flight.jets_m),
    }  # fmt: skip
    return described, data


def group_length(steps: int) -> int:
    """Return how many steps a page sums up by their least and greatest value; 1: it has every step."""
    return 1 if steps <= MAX_ROWS else 2 * ceil(steps / MAX_ROWS)


def extremes(values: Array, group: int) -> Array:
    """Return the least and the greatest of each ``group`` rows, two values each, in the order of the rows.

    What is no number is left out of a group that has one.
    """
    table = np.concatenate([values, np.full(-len(values) % group, values[-1])]).reshape(-1, group)
    known = np.isfinite(table)
    low = np.argmin(np.where(known, table, np.inf), axis=1)
    high = np.argmax(np.where(known, table, -np.inf), axis=1)
    rows = np.arange(len(table))
    return np.stack([table[rows, np.minimum(low, high)], table[rows, np.maximum(low, high)]], axis=1).ravel()


def _describe_thinning(label: str, steps: int, group: int, step_s: float) -> str:
    """Describe the steps of a flight that a page leaves out; an empty string if it leaves out none."""
    if group == 1:
        return ""
    return (
        f"{label}: strips and replay have the least and the greatest of each {group} of the {steps:,} steps, so no "
        f"peak is lost and an instant is off by less than {group * step_s:.3g} s. Metrics, events and bands are of "
        "every step, and so is the log."
    )


def _pack_columns(flight: FlightData, group: int) -> tuple[list[dict[str, Any]], dict[str, str], list[str]]:
    """Return the columns' descriptions, the packed data of those that differ, and the names of empty columns."""
    columns: list[dict[str, Any]] = []
    data: dict[str, str] = {}
    empty: list[str] = []
    first_of: dict[str, str] = {}  # first column with the same data
    log, derived = flight.log, flight.derived
    described = {column.name: column for column in (*log.described, *flight.made)}
    for name in (*log.columns, *derived):
        if name == TIME and flight.times is None:
            continue
        values = np.asarray(derived[name]() if name in derived else log[name], dtype=np.float64)
        column = pack(values if group == 1 else extremes(values, group))
        if column is None:
            empty.append(name)
            continue
        about = described.get(name)
        first = first_of.setdefault(column.data, name) if column.data else name
        columns.append(
            {
                "name": name,
                "unit": about.unit if about else "",
                "frame": about.frame if about else "",
                "meaning": about.meaning if about else REST_THRUST_NOTE if name in derived else "",
                **{key: value for key, value in column._asdict().items() if key != "data"},
                "data": first,
            }
        )
        if column.data and first == name:
            data[name] = column.data
    return columns, data, empty


def _is_banded(event: Event) -> bool:
    """Return whether an event is drawn as a band: faults, gusts and changes of the wind."""
    wind = event.kind == "disturbance" and event.text.startswith(("gust", "wind"))
    return event.banded and (event.kind == "fault" or wind)


def read_vehicle(run: Run) -> Vehicle | None:
    """Return the vehicle of a run; None where its scenario is of another version, or gone."""
    try:
        vehicle: Vehicle = run.scenario.resolved_vehicle()[0]
    except (InputError, FlightError, OSError):
        return None
    return vehicle


def describe_shape(vehicle: Vehicle) -> dict[str, Any]:
    """Return the shape of a vehicle for the replay, m and rad in the body frame: from ``vehicle.toml``.

    A jet has its place and its thrust's direction, both with all hinges at zero, and what turns it from the body
    outwards: the column of the angle, a point of the axis, the axis, and whether it turns the thrust alone.  A panel
    turns about its first edge by ``turn`` times its column.
    """
    layout = vehicle.layout()
    angles = [f"tilt_{name}_rad" for name in vehicle.actuators[: len(layout.turns)]]
    jets = [
        {
            "position": station.position,
            "axis": station.axis,
            "turns": [
                {
                    "column": angles[number],
                    "point": layout.turns[number].point,
                    "axis": layout.turns[number].axis,
                    "effect": effect,
                    "deflects": jet in layout.turns[number].deflects,
                }
                for number, effect in reversed(layout.chains[jet])  # innermost factor of the product first
            ],
        }
        for jet, station in enumerate(layout.stations)
    ]
    return {
        "name": vehicle.name,
        "title": vehicle.title,
        "mass": vehicle.mass_kg,
        "jets": jets,
        "contacts": [{"kind": contact.kind, "position": contact.position_m} for contact in vehicle.contacts],
        "panels": [
            {
                "corners": panel.corners_m,
                "column": None if panel.surface is None else f"deflection_{panel.surface}",
                "turn": panel.turn_rad,
            }
            for panel in vehicle.panels
        ],
    }


def _jets_only(jets_m: Sequence[Sequence[float]]) -> dict[str, Any]:
    """Return the shape of a vehicle of which only the positions of the jets are known."""
    jets = [{"position": list(position), "axis": UP, "turns": []} for position in jets_m]
    return {"name": "", "title": "", "mass": None, "jets": jets, "contacts": [], "panels": []}


def _saturation_times(log: Log, reach: Reach | None, step_s: float) -> list[tuple[float, float | None]]:
    """Return the intervals [s] of saturation, as the metric counts it.

    Where that changes more than ``MAX_INTERVALS`` times, the shortest gaps are closed.
    """
    if not {"on_ground", "hull_contact", *REFUSED}.issubset(log.columns):  # the log is another tool's
        return []
    rows = saturation_in_flight(log, reach)
    starts, ends = row_spans(rows)
    if starts.size > MAX_INTERVALS:
        apart = np.sort(np.argsort(starts[1:] - ends[:-1], kind="stable")[1 - MAX_INTERVALS :])
        starts, ends = np.append(starts[:1], starts[apart + 1]), np.append(ends[apart], ends[-1:])
    return time_spans(starts, ends, rows.size, step_s)
