"""The rows of the log as the C code reads them: every bit, against the records' own names, and nothing wrong let in."""

from __future__ import annotations

import gc
import sys
import weakref
from collections.abc import Iterator
from itertools import product
from math import nan
from typing import Any

import numpy as np
import pytest
from flights import STEP, samples
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base import signals as sg
from cosim.base.errors import InputError
from cosim.base.frames import to_euler
from cosim.base.protocols import Column
from cosim.results._rows import Rows
from cosim.results.log.columns import COLUMNS, NAMES, LoggedVehicle, log_columns
from cosim.results.log.recorder import MemorySink, Recorder
from cosim.results.log.row_program import program

NUMBERS = st.one_of(st.floats(), st.sampled_from([nan, -nan, -0.0, 5e-324]), st.integers(-9, 9), st.booleans())


def tuples(size: int, values: st.SearchStrategy[Any] = NUMBERS) -> st.SearchStrategy[Any]:
    return st.tuples(*[values] * size)


@st.composite
def any_sample(draw: st.DrawFn, jets: int) -> sg.Sample:
    """Any numbers at all on the wires of a vehicle of so many jets."""
    vector, number, every_jet = tuples(3), NUMBERS, tuples(jets)
    added = tuples(3, st.floats(allow_nan=False, min_value=0.0))  # never -0, as what disturbs never is
    names = {"command": sg.Command, "state": sg.State, "measured": sg.Measured}
    fields: dict[str, list[st.SearchStrategy[Any]]] = {
        "command": [vector, number, st.none() | vector, st.none() | number, st.none() | tuples(2)],
        "state": [vector, vector, tuples(4), vector, vector, vector, number, vector, number, number, number, vector],
        "measured": [vector, tuples(4, st.floats(-1.0, 1.0)), vector, vector, number, vector],
    }
    made = {name: record(*draw(st.tuples(*fields[name]))) for name, record in names.items()}
    return sg.Sample(
        k=draw(st.integers()),
        time=draw(number),
        control=sg.ControlSignals(draw(vector), draw(vector), draw(vector), draw(number), draw(number)),
        actuation=sg.Actuation(draw(every_jet), draw(tuples(2)), sg.Unallocated(*draw(tuples(4)))),
        tilt=draw(tuples(2)),
        engines=sg.EngineOutput(*draw(st.tuples(*[every_jet] * 4))),
        disturbance=sg.Disturbance(
            draw(vector), draw(vector), draw(added), payload=draw(tuples(4)), torque_output=draw(added)
        ),
        fuel=draw(number),
        spool_moment=draw(vector),
        faults=draw(tuples(12)),
        health=draw(tuples(jets) | tuples(sg.JETS)),
        **made,
    )  # fmt: skip


def euler_angles(quaternions: np.ndarray) -> np.ndarray:
    """Roll, pitch and yaw (rad), shape (3, n), of unit quaternions w, x, y, z, shape (4, n): all of it by numpy."""
    w, x, y, z = quaternions
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.stack((roll, pitch, yaw))


def expected(sample: sg.Sample, source: str) -> float:
    """Return what a column of this source has in the row of a sample, read through the records' names."""
    source, _, instead = source.partition(" unless ")
    if not source or (instead and place_of(sample, instead) is not None):
        return nan
    angle, _, quaternion = source.partition(" of ")
    if quaternion:
        attitude = np.array(place_of(sample, quaternion), dtype=float)
        return float(euler_angles(attitude[:, None])[sg.AXES.index(angle), 0])
    values = [place_of(sample, place) for place in source.split(" + ")]
    return nan if None in values else float(sum(values[1:], values[0]))


def place_of(sample: sg.Sample, place: str) -> Any:
    """Return what stands at a place like ``state.euler.0``, or None if a field on the way to it is None."""
    value: Any = sample
    for name in place.split("."):
        value = value if value is None else value[int(name)] if name.isdigit() else getattr(value, name)
    return value


def table_of(flight: list[sg.Sample], columns: tuple[Column, ...] = COLUMNS) -> np.ndarray:
    sink = MemorySink()
    recorder = Recorder(STEP, sink, columns)
    for sample in flight:
        recorder.observe(sample)
    recorder.flush()
    return np.concatenate(sink.tables, axis=1)


def good() -> sg.Sample:
    (sample,) = samples(1)
    return sample


def rows_of(capacity: int, patience: float, hand_on: Any) -> Rows:
    run = program(COLUMNS)
    return Rows(capacity, patience, hand_on, run.width, run.nodes, run.reads)


@settings(max_examples=60)
@given(st.integers(1, sg.JETS).flatmap(lambda jets: st.lists(any_sample(jets), min_size=1, max_size=3)))
def test_every_bit_ends_in_the_column_that_bears_its_name(flight: list[sg.Sample]) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        columns = log_columns(LoggedVehicle(len(flight[0].actuation.throttle)))
        table = table_of(flight, columns)
        for row, column in zip(table, columns, strict=True):
            values = np.array([expected(sample, column.source) for sample in flight])
            np.testing.assert_array_equal(row.view(np.uint64), values.view(np.uint64), err_msg=column.name)


@pytest.mark.parametrize("rows", [1, 2, 7, 8, 9, 250])
def test_angles_of_the_measured_quaternion(rows: int) -> None:
    """The bits of numpy for blocks of any length, and the angles of the scalar code."""
    random = np.random.default_rng(3)
    turned = random.normal(size=(4, 1000))
    turned /= np.linalg.norm(turned, axis=0)
    turned[:, :4] = np.array([[1, 0, 1, 0], [1, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]).T  # up, down, ahead, back
    turned[:, :2] *= 0.5**0.5 * (1.0 + 1e-15)  # a sine past 1
    sample, sink = good(), MemorySink()
    recorder = Recorder(rows**-1.0, sink)
    for quaternion in turned.T.tolist():
        recorder.observe(sample._replace(measured=sample.measured._replace(attitude=tuple(quaternion))))
    recorder.flush()
    first = NAMES.index("roll_measured_rad")
    angles = np.concatenate([table[first : first + 3] for table in sink.tables], axis=1)
    assert angles.tobytes() == euler_angles(turned).tobytes()
    scalar = np.array([to_euler((w, x, y, z)) for w, x, y, z in turned.T.tolist()]).T
    # numpy and math may differ by a rounding of the same formula; asin turns it into sqrt(eps) only at +-90 deg
    np.testing.assert_allclose(angles[:, 2:], scalar[:, 2:], rtol=0, atol=1e-13)


IN_THE_LOG = [
    place.split(".")
    for column in COLUMNS
    for place in column.source.partition(" unless ")[0].rpartition(" of ")[2].split(" + ")
]


def unseen() -> Iterator[tuple[str, ...]]:
    """The fields of a sample and of its records that are in no column, or only where they put another one out."""
    sample = good()
    for field in sample._fields:
        for path in [(field, name) for name in getattr(getattr(sample, field), "_fields", ())] or [(field,)]:
            if not any(tuple(place[: len(path)]) == path for place in IN_THE_LOG):
                yield path


UNSEEN = set(unseen())


class Unwilling(float):
    """A float of a subclass is read as any float is, whatever it says of itself."""

    def __float__(self) -> float:
        raise ZeroDivisionError


class Raising:
    def __float__(self) -> float:
        raise ZeroDivisionError("no number today")


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every record, tuple and number of a sample."""
    yield path
    if isinstance(value, tuple):
        for name, part in zip(getattr(value, "_fields", range(len(value))), value, strict=True):
            yield from places(part, (*path, name))


def replaced(value: Any, path: tuple[Any, ...], part: Any) -> Any:
    if not path:
        return part
    first, rest = path[0], path[1:]
    if isinstance(first, int):
        return (*value[:first], replaced(value[first], rest, part), *value[first + 1 :])
    return value._replace(**{first: replaced(getattr(value, first), rest, part)})


WRONG = [None, "text", b"", object(), [1.0, 2.0, 3.0], (), (None,) * 3, (1.0,) * 30, 2 + 1j, float, Raising()]


def test_what_is_no_sample_is_refused_and_leaves_no_trace() -> None:
    sample = good()
    sink = MemorySink()
    recorder = Recorder(STEP, sink)
    recorder.observe(sample)
    tried = 0
    for path, part in product(places(sample), WRONG):
        if path[:1] in UNSEEN or path[:2] in UNSEEN:
            continue
        if path == ("command", "place") and part is None:  # none is asked for
            continue
        if path == ("health",) and part == (1.0,) * 30:  # more than enough
            continue
        if path[:1] == ("health",) and len(path) > 1 and int(path[1]) >= 6:  # of engines that this vehicle has not
            continue
        with pytest.raises((TypeError, ZeroDivisionError)):
            recorder.observe(replaced(sample, path, part))
        tried += 1
    assert tried > 1500
    assert recorder.steps == 1
    recorder.observe(sample)
    recorder.flush()
    (table,) = sink.tables
    assert table[:, 0].tobytes() == table[:, 1].tobytes()


@pytest.mark.parametrize("path", sorted(UNSEEN))
def test_what_is_not_in_the_log_does_not_matter(path: tuple[str, ...]) -> None:
    strange = replaced(good(), path, object())
    table = table_of([good()])
    different = {NAMES[i] for i in np.flatnonzero(table[:, 0].view("u8") != table_of([strange])[:, 0].view("u8"))}
    assert different == {column.name for column in COLUMNS if column.source.endswith(f" unless {'.'.join(path)}")}


def test_what_a_sample_lacks_is_named() -> None:
    recorder = Recorder(STEP, MemorySink())
    with pytest.raises(TypeError, match=r"^sample: engines\.spool_speed is not a tuple of 6$"):
        recorder.observe(replaced(good(), ("engines", "spool_speed"), (1.0,)))
    with pytest.raises(TypeError, match=r"^sample: it is not a tuple of 15$"):
        recorder.observe("sample")


def test_other_kinds_of_numbers_are_numbers() -> None:
    sample = replaced(good(), ("state", "position"), (np.float64(1.5), True, 7))
    table = table_of([replaced(sample, ("fuel",), Unwilling(2.5))])
    assert [table[NAMES.index(name), 0] for name in ("north_m", "east_m", "down_m", "fuel_kg")] == [1.5, 1.0, 7.0, 2.5]


def test_rows_that_cannot_be_handed_on_stay() -> None:
    class Stubborn:
        def __init__(self) -> None:
            self.calls = 0
            self.tables: list[np.ndarray] = []

        def write(self, table: np.ndarray) -> None:
            self.calls += 1
            if self.calls <= 2:
                raise OSError("not now")
            self.tables.append(table.copy())

    sink = Stubborn()
    recorder = Recorder(0.5, sink)  # two rows a second
    first, second, third = samples(3)
    recorder.observe(first)
    with pytest.raises(OSError, match="not now"):
        recorder.observe(second)
    assert recorder.steps == 2
    with pytest.raises(OSError, match="not now"):
        recorder.observe(third)  # there is no room for it
    assert recorder.steps == 2
    recorder.observe(third)
    assert recorder.steps == 3
    recorder.flush()
    assert np.concatenate(sink.tables, axis=1)[0].tolist() == [0.0, STEP, 2 * STEP]


def test_rows_that_nobody_clears_are_not_overrun() -> None:
    calls = []
    rows = rows_of(2, 1000.0, calls.append)
    for _ in range(2):
        rows.add(good())
    for _ in range(3):
        with pytest.raises(BufferError):
            rows.add(good())
    assert len(rows) == 2
    assert calls == [rows] * 4


def test_a_block_belongs_to_who_gets_it() -> None:
    """A sink in another thread may still read a block while the next rows come in."""
    sink = MemorySink()
    recorder = Recorder(STEP, sink)
    flight = list(samples(1000))
    copies = []
    for sample in flight:
        before = len(sink.tables)
        recorder.observe(sample)
        if len(sink.tables) > before:
            copies.append(sink.tables[-1].copy())
    assert len(copies) == 4
    assert all(a.tobytes() == b.tobytes() for a, b in zip(sink.tables, copies, strict=True))
    assert all(table.flags.c_contiguous and table.base is None for table in sink.tables)


@pytest.mark.parametrize("capacity", [1, 2, 7, 8, 9, 16, 19])
def test_the_columns_are_there_after_any_number_of_rows(capacity: int) -> None:
    """However often they are looked at, and again after the rows were cleared."""
    rows, flight = rows_of(capacity, 1000.0, len), list(samples(capacity))
    for _ in range(2):
        for count, sample in enumerate(flight[:-1], 1):
            rows.add(sample)
            columns = np.asarray(rows)
            assert columns.shape == (len(COLUMNS) + 4, capacity)  # and the measured quaternion
            assert columns[0, :count].tolist() == [each.time for each in flight[:count]]
            fuel = np.array([each.fuel for each in flight[:count]])
            assert columns[NAMES.index("fuel_kg"), :count].tobytes() == fuel.tobytes()
        rows.clear()


def test_rows_are_made_once_and_for_at_least_one() -> None:
    for capacity in (0, -1, sys.maxsize):
        with pytest.raises(ValueError, match="at least one"):
            rows_of(capacity, 1.0, len)
    rows = rows_of(1, 1.0, len)
    run = program(COLUMNS)
    with pytest.raises(ValueError, match="once"):
        rows.__init__(1, 1.0, len, run.width, run.nodes, run.reads)
    bare = Rows.__new__(Rows)
    with pytest.raises(ValueError, match="not initialised"):
        bare.add(good())
    assert len(bare) == 0


@pytest.mark.parametrize(
    ("width", "nodes", "reads"),
    [
        (0, [("it", -1, 0, 15, False)], []),
        (5000, [("it", -1, 0, 15, False)], []),
        (9, [], []),
        (9, [("it", -1, 0, 15, False)] * 65, []),
        (9, [("it", -1, 0, 15, False), ("state", 1, 3, 12, False)], []),  # in itself
        (9, [("it", -1, 0, 15, False), ("state", 0, 15, 12, False)], []),  # behind the end
        *[
            (9, [("it", -1, 0, 15, False), ("place", 0, 2, 5, True)], [read])
            for read in [
                (2, 0, 1, 0, -1, 0, False), (0, 14, 2, 0, -1, 0, False), (0, 0, 1, 9, -1, 0, False),
                (0, 0, 1, 0, 2, 0, False), (0, 0, 1, 0, 0, 15, False),
            ]
        ],
    ],
)  # fmt: skip
def test_a_program_that_would_read_what_is_not_there_is_refused(width: int, nodes: list[Any], reads: list[Any]) -> None:
    with pytest.raises(ValueError, match="no program that holds together"):
        Rows(1, 1.0, len, width, nodes, reads)


@pytest.mark.parametrize(
    ("source", "complaint"),
    [
        ("state.eular.0", "the record 'state' has no column 'eular'; did you mean 'euler'"),
        ("speed", "the record '' has no column 'speed'"),
        ("state.euler.x", "column 'lean': no place of a sample: 'state.euler.x'"),
        ("bank of measured.attitude", "column 'lean': no angle 'bank'; allowed: roll, pitch, yaw"),
    ],
)
def test_a_source_that_no_sample_has_is_refused(source: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        program([*COLUMNS, Column("lean", "rad", "body", "leaning", source)])


def test_a_vehicle_of_eight_engines_has_eight_columns_of_each() -> None:
    columns = log_columns(LoggedVehicle(8))
    eight = tuple(float(jet) for jet in range(1, 9))
    engines, actuation = sg.EngineOutput(*[eight] * 4), sg.Actuation(eight, (0.0, 0.0), sg.Unallocated())
    sample = good()._replace(actuation=actuation, engines=engines, health=eight, faults=(0.0,) * 14)
    row = dict(zip([column.name for column in columns], table_of([sample], columns)[:, 0].tolist(), strict=True))
    for name in ("throttle_{}", "thrust_{}_N", "spool_speed_{}_rad_s", "health_{}"):
        assert [row[name.format(jet)] for jet in range(1, 9)] == list(eight)
    assert {"fault_jet_8", "fault_barometer"} <= set(row)


def test_nothing_is_kept_of_a_sample() -> None:
    sample = good()
    parts = [sample, sample.state, sample.state.position, sample.fuel, sample.engines.thrust]
    recorder = Recorder(STEP, MemorySink())
    before = [sys.getrefcount(part) for part in parts]
    for _ in range(600):
        recorder.observe(sample)
    recorder.flush()
    assert [sys.getrefcount(part) for part in parts] == before


def test_nothing_is_kept_of_who_takes_the_rows() -> None:
    answer, seen = object(), []

    def take(rows: Rows) -> object:
        seen.append(rows)
        rows.clear()
        return answer

    before = sys.getrefcount(answer), sys.getrefcount(take)
    rows = rows_of(1, 1000.0, take)
    for _ in range(50):
        rows.add(good())
    assert len(seen) == 50
    seen.clear()
    assert sys.getrefcount(rows) == 2  # this name, and the argument
    del rows
    assert (sys.getrefcount(answer), sys.getrefcount(take)) == before


def test_a_recorder_goes_with_its_last_name() -> None:
    """No ring of references keeps a flight's rows until the collector comes by."""
    sink = MemorySink()
    recorder = Recorder(STEP, sink)
    recorder.observe(good())
    recorder.flush()
    gone = weakref.ref(sink)
    gc.disable()
    try:
        del recorder, sink
        assert gone() is None
    finally:
        gc.enable()
