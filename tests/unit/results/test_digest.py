"""One hash for a whole log, however its rows were cut and wherever they were kept."""

from __future__ import annotations

import struct
import tracemalloc
from hashlib import sha256

import numpy as np
import pytest
from flights import STEP, samples, scenario, setup
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.errors import InputError
from cosim.base.signals import Sample
from cosim.results.log.columns import NAMES
from cosim.results.log.digest import Digest, DigestSink, log_digest
from cosim.results.log.recorder import MemoryLog, MemorySink, Recorder
from cosim.results.metrics import columns, flight_metrics
from cosim.results.run import begin_run

NUMBERS = st.floats() | st.sampled_from([float("nan"), -float("nan"), 0.0, -0.0])


@pytest.fixture(scope="module")
def flight() -> list[Sample]:
    return list(samples(1100))


def spelled_out(names: tuple[str, ...], table: np.ndarray) -> str:
    """The digest as its description has it, number by number."""
    whole = b""
    for name, values in zip(names, table, strict=True):
        packed = [b"\0\0\0\0\0\0\xf8\x7f" if value != value else struct.pack("<d", value) for value in values.tolist()]
        whole += name.encode() + b"\0" + sha256(b"".join(packed)).digest()
    return sha256(whole).hexdigest()


@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=12), st.lists(st.integers(0, 12), max_size=5))
def test_the_digest_is_what_it_says_however_the_rows_are_cut(rows: list[tuple[float, float]], cuts: list[int]) -> None:
    names = ("roll_rad", "wider_than_ä")
    table = np.array(rows).reshape(-1, 2).T
    digest = Digest(names)
    for part in np.split(table, sorted(cut for cut in cuts if cut <= len(rows)), axis=1):
        digest.update(part)
    assert digest.hexdigest() == spelled_out(names, table)
    assert log_digest(MemoryLog([table], names)) == spelled_out(names, table)


def test_every_nan_is_the_same_and_every_other_bit_counts() -> None:
    def of(bits: int, name: str = "a") -> str:
        digest = Digest([name])
        digest.update(np.array([[bits]], dtype=np.uint64).view(np.float64))
        return digest.hexdigest()

    quiet = 0x7FF8000000000000
    assert {of(bits) for bits in (quiet, quiet | 1 << 63, quiet | 1, quiet | 0x123, 0x7FF0000000000001)} == {of(quiet)}
    bits = [0, 1 << 63, 1, 0x3FF0000000000000, 0x3FF0000000000001, 0x7FF0000000000000, 0xFFF0000000000000, quiet]
    assert len({of(each) for each in bits}) == len(bits)
    assert of(0, "b") != of(0)


def test_rows_that_change_places_or_columns_are_another_log() -> None:
    table = np.arange(6.0).reshape(2, 3)
    names = ("a", "b")
    cut = (table, table[::-1], table[:, ::-1], table[:, :2], table[:, 1:])
    assert len({log_digest(MemoryLog([each], names)) for each in cut}) == 5


def test_a_block_is_left_as_it_was() -> None:
    table = np.array([[-float("nan"), 1.0]])
    before = table.tobytes()
    Digest(["a"]).update(table)
    assert table.tobytes() == before


@settings(max_examples=6)
@given(st.lists(st.integers(1, 1099), max_size=4))
def test_one_digest_everywhere(flight: list[Sample], tmp_path_factory: pytest.TempPathFactory, cuts: list[int]) -> None:
    recording = begin_run(setup(), scenario(), tmp_path_factory.mktemp("runs") / "run")
    memory, passing = MemorySink(), DigestSink(columns())
    observers = [recording, Recorder(STEP, memory), Recorder(STEP, passing)]
    for k, sample in enumerate(flight):
        for observer in observers:
            observer.observe(sample)
        if k in cuts:
            observers[2].flush()
    for recorder in observers[1:]:
        recorder.flush()
    run = recording.finish("completed", "")
    assert log_digest(run.log) == log_digest(memory.log()) == passing.hexdigest()
    assert flight_metrics(passing.log(), STEP) == flight_metrics(run.log, STEP)


def test_only_what_was_asked_for_is_kept(flight: list[Sample]) -> None:
    names = ("altitude_m", "roll_rad")
    whole, sink = MemorySink(), DigestSink(names)
    for each in (whole, sink):
        recorder = Recorder(STEP, each)
        for sample in flight:
            recorder.observe(sample)
        recorder.flush()
    log = sink.log()
    assert log.columns == names
    assert len(log) == len(flight)
    for name in names:
        assert log[name].tobytes() == whole.log()[name].tobytes()
    (*_, block) = log.blocks(("roll_rad",))
    assert block["roll_rad"].tobytes() == whole.tables[-1][NAMES.index("roll_rad")].tobytes()
    with pytest.raises(InputError, match="no column 'time_s'"):
        log["time_s"]
    with pytest.raises(InputError, match="no column 'rol_rad'; did you mean 'roll_rad'"):
        DigestSink(["rol_rad"])


def test_all_columns_are_kept_by_their_names(flight: list[Sample]) -> None:
    """Metrics of the user's that name no columns read any; the others have to find theirs beside them."""
    whole, sink = MemorySink(), DigestSink(columns(), whole=True)
    for each in (whole, sink):
        recorder = Recorder(STEP, each)
        for sample in flight:
            recorder.observe(sample)
        recorder.flush()
    assert sink.log().columns == whole.log().columns
    assert flight_metrics(sink.log(), STEP) == flight_metrics(whole.log(), STEP)


def test_a_flight_of_nothing() -> None:
    sink = DigestSink(columns())
    assert sink.hexdigest() == log_digest(MemorySink().log()) == spelled_out(NAMES, np.empty((len(NAMES), 0)))
    assert len(sink.log()) == 0


def test_a_long_flight_in_memory_is_what_is_kept_of_it() -> None:
    rows = 150_000  # ten minutes
    sink = DigestSink(columns())
    block = np.random.default_rng(1).normal(size=(len(NAMES), 250))
    tracemalloc.start()
    try:
        for _ in range(rows // 250):
            sink.write(block)
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    kept = 8 * rows * len(columns())
    assert kept <= held < 1.05 * kept  # and a little for each block
    assert peak - held < 4 * block.nbytes
