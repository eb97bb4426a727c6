"""Arrow on disk: the stream is byte for byte what pyarrow writes, and tables come back as they were."""

from __future__ import annotations

import os
import subprocess
import sys
from math import isnan, nan
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cosim.base.errors import FlightError, InputError
from cosim.results.log import arrow as arrow_module
from cosim.results.log.arrow import ParquetLog, StreamSink, Value, read_table, stream_to_parquet, write_table
from cosim.results.log.columns import COLUMNS, NAMES


def tables(sizes: list[int], seed: int = 1) -> list[np.ndarray]:
    """Blocks of a log in which any bits may be, NaN of every kind included."""
    random = np.random.default_rng(seed)
    return [random.integers(0, 2**64, (len(NAMES), size), dtype=np.uint64).view(np.float64) for size in sizes]


def as_pyarrow_writes(path: Path, blocks: list[np.ndarray], note: str) -> bytes:
    """The stream by pyarrow's own writer, its schema stated from the columns once more."""
    fields = []
    for column in COLUMNS:
        metadata = {"unit": column.unit, "frame": column.frame, "meaning": column.meaning}
        fields.append(pa.field(column.name, pa.float64(), nullable=False, metadata=metadata))
    schema = pa.schema(fields, metadata={"note": note})
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, schema) as writer:
        for block in blocks:
            writer.write_batch(pa.RecordBatch.from_arrays([pa.array(column) for column in block], schema=schema))
    return path.read_bytes()


def streamed(path: Path, blocks: list[np.ndarray], note: str = "a note") -> bytes:
    sink = StreamSink(path, note)
    for block in blocks:
        sink.write(block)
    sink.end()
    sink.close()
    return path.read_bytes()


WITHOUT_PANDAS = """
import importlib.abc, sys
from pathlib import Path

class Watch(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "pandas":
            raise AssertionError("pandas was asked for")

sys.meta_path.insert(0, Watch())
from cosim import Scenario, fly, open_run

out = Path(sys.argv[1])
fly(Scenario.load("hover").replace(duration_s=0.1, expect=[]), out=out)
log = open_run(out).log
print(len(log), len(log["roll_rad"]), [len(block["roll_rad"]) for block in log.blocks(("roll_rad",))])
print((out / "report.html").stat().st_size > 10_000, {"plotly.graph_objs", "plotly.io"} & sys.modules.keys())
"""


def test_a_recorded_flight_does_without_pandas_and_its_page_without_plotly(tmp_path: Path) -> None:
    """Many have them installed; pyarrow then imports pandas for little."""
    command = [sys.executable, "-c", WITHOUT_PANDAS, str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("25 25 [25]\nTrue set()\n", 0), done.stderr


@settings(max_examples=15)
@given(st.lists(st.integers(0, 70), max_size=6), st.text(max_size=40))
@example([*[250] * 3, 17], "as they come in flight")
@example([400, 1], "")
def test_the_stream_is_bit_for_bit_pyarrows(tmp_path_factory: pytest.TempPathFactory, sizes: list, note: str) -> None:
    folder = tmp_path_factory.mktemp("stream")
    blocks = tables(sizes)
    assert streamed(folder / "ours", blocks, note) == as_pyarrow_writes(folder / "theirs", blocks, note)


def test_a_block_that_does_not_lie_in_one_piece(tmp_path: Path) -> None:
    (block,) = tables([40])
    apart = np.asfortranarray(block)[:, ::2]
    assert streamed(tmp_path / "ours", [apart]) == streamed(tmp_path / "again", [apart.copy()])


def test_a_system_that_writes_a_little_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = tables([30, 20])
    whole = streamed(tmp_path / "whole", blocks)
    write = os.write
    monkeypatch.setattr(arrow_module.os, "writev", lambda file, parts: write(file, b"".join(parts)[:1000]))
    monkeypatch.setattr(arrow_module.os, "write", lambda file, part: write(file, part[:7777]))
    assert streamed(tmp_path / "little", blocks) == whole


def test_half_a_block_does_not_hide_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, third = tables([30, 20, 10])
    sink = StreamSink(tmp_path / "stream", "")
    sink.write(first)

    def full(file: int, part: bytes) -> int:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        write = os.write
        patch.setattr(arrow_module.os, "writev", lambda file, parts: write(file, b"".join(parts)[:5000]))
        patch.setattr(arrow_module.os, "write", full)
        with pytest.raises(FlightError, match=r"stream: No space left on device$"):
            sink.write(second)
    sink.write(third)
    sink.end()
    sink.close()
    assert (tmp_path / "stream").read_bytes() == streamed(tmp_path / "without", [first, third], "")


def test_every_bit_of_a_block_arrives_in_parquet(tmp_path: Path) -> None:
    blocks = tables([30, 1, 20])
    streamed(tmp_path / "stream", blocks)
    assert stream_to_parquet(tmp_path / "stream", tmp_path / "log.parquet") == 51
    log = ParquetLog(tmp_path / "log.parquet")
    whole = np.concatenate(blocks, axis=1)
    assert all(log[name].tobytes() == whole[index].tobytes() for index, name in enumerate(NAMES))


def test_a_log_that_is_kept_open_is_opened_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = tables([30, 1, 20])
    streamed(tmp_path / "stream", blocks)
    stream_to_parquet(tmp_path / "stream", tmp_path / "log.parquet")
    log = ParquetLog(tmp_path / "log.parquet")
    opened = []
    open_parquet = arrow_module._open_parquet
    monkeypatch.setattr(arrow_module, "_open_parquet", lambda path: opened.append(path) or open_parquet(path))
    alone = {name: log[name].tobytes() for name in NAMES}
    assert len(opened) == len(NAMES)
    with log.keep_open(), log.keep_open():
        assert {name: log[name].tobytes() for name in NAMES} == alone
    assert len(opened) == len(NAMES) + 1
    assert log[NAMES[0]].tobytes() == alone[NAMES[0]]
    with pytest.raises(OSError, match="of somebody else"), log.keep_open():
        raise OSError("of somebody else")  # is no fault of the log


MANY: dict[str, list[Value]] = {
    "flight": [0, 1, 2],
    "gain": [1.5, None, nan],
    "delay": [1, 2.5, None],
    "nothing": [None, None, None],
    "success": [True, None, False],
    "reason": ["fell", None, "größer"],
    "odd name, with = signs": [-0.0, 5e-324, 1e308],
}


def same(one: list[Value], other: list[Value]) -> bool:
    """NaN is NaN, and the kinds are the same."""
    return len(one) == len(other) and all(
        type(a) is type(b) and (a == b or (isinstance(a, float) and isnan(a) and isnan(b)))
        for a, b in zip(one, other, strict=True)
    )


def test_a_table_comes_back_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "table.parquet"
    write_table(path, MANY, {"study": "robustness", "ü": "="})
    found = read_table(path)
    assert list(found) == list(MANY)
    for name, values in (MANY | {"delay": [1.0, 2.5, None]}).items():
        assert same(found[name], values), name
    assert pq.read_schema(path).metadata == {b"study": b"robustness", "ü".encode(): b"="}
    types = [str(field.type) for field in pq.read_schema(path)]
    assert types == ["int64", "double", "double", "double", "bool", "string", "double"]
    assert os.listdir(tmp_path) == ["table.parquet"]


VALUES = {
    float: st.floats(allow_nan=False),
    int: st.integers(-(2**63), 2**63 - 1),
    bool: st.booleans(),
    str: st.text(st.characters(exclude_categories=["Cs"])),
}


@settings(max_examples=30)
@given(st.data(), st.integers(0, 20))
def test_any_columns_come_back(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, rows: int) -> None:
    path = tmp_path_factory.mktemp("table") / "t"
    kinds = data.draw(st.dictionaries(VALUES[str].filter(bool), st.sampled_from(list(VALUES)), max_size=5))
    columns = {n: data.draw(st.lists(st.none() | VALUES[k], min_size=rows, max_size=rows)) for n, k in kinds.items()}
    write_table(path, columns, kinds=kinds)
    assert read_table(path) == columns
    assert not pq.read_schema(path).metadata


def test_stated_kinds_make_the_parts_of_a_data_set_fit(tmp_path: Path) -> None:
    kinds = {"x": float, "n": int, "s": str, "b": bool}
    write_table(tmp_path / "a.parquet", {"x": [1], "n": [None], "s": [None], "b": [None]}, kinds=kinds)
    write_table(tmp_path / "b.parquet", {"x": [None], "n": [3], "s": ["text"], "b": [True]}, kinds=kinds)
    whole = pq.read_table(tmp_path)  # by whoever reads the folder with other tools
    assert whole.to_pydict() == {"x": [1.0, None], "n": [None, 3], "s": [None, "text"], "b": [None, True]}
    assert read_table([tmp_path / "a.parquet", tmp_path / "b.parquet"]) == whole.to_pydict()


def test_files_with_different_columns_one_after_the_other(tmp_path: Path) -> None:
    write_table(tmp_path / "a", {"flight": [0, 1], "gain": [0.5, 0.6]})
    write_table(tmp_path / "b", {"late": [True], "flight": [2]})
    files = [tmp_path / "a", tmp_path / "b"]
    assert read_table(files) == {"flight": [0, 1, 2], "gain": [0.5, 0.6, None], "late": [None, None, True]}
    assert read_table(files, ["late", "flight"]) == {"late": [None, None, True], "flight": [0, 1, 2]}
    assert read_table([]) == {}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([1, "a"], "int, str"),
        ([True, 1], "bool, int"),
        ([0.5, "a", None], "float, str"),
        ([b"a"], "bytes"),
        ([[1.0]], "list"),
        ([2**70], "too large"),
    ],
)
def test_what_is_no_column_is_one_line(tmp_path: Path, values: list[Value], message: str) -> None:
    with pytest.raises(InputError, match=rf"^column 'odd': .*{message}"):
        write_table(tmp_path / "t", {"fine": [1.0] * len(values), "odd": values})
    assert not any(tmp_path.iterdir())


def test_a_value_that_is_not_of_the_stated_kind(tmp_path: Path) -> None:
    for value, kind in (("a", float), (1.5, int), (1, str), (2, bool)):
        message = rf"^column 'odd': {type(value).__name__}; allowed: {kind.__name__} or None$"
        with pytest.raises(InputError, match=message):
            write_table(tmp_path / "t", {"odd": [value]}, kinds={"odd": kind})


def test_a_table_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FlightError, match=r"nowhere/t: No such file or directory$"):
        write_table(tmp_path / "nowhere" / "t", {"a": [1]})
    write_table(tmp_path / "t", {"a": [1]})

    def full(table: pa.Table, path: Path, **_: object) -> None:
        path.write_bytes(b"PAR1 and half of the rest")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    with pytest.raises(FlightError, match=r"t: No space left on device$"):
        write_table(tmp_path / "t", {"a": [2]})
    assert read_table(tmp_path / "t") == {"a": [1]}
    assert os.listdir(tmp_path) == ["t"]


def test_a_file_that_is_no_table_is_one_line(tmp_path: Path) -> None:
    write_table(tmp_path / "t", {"a": [1] * 1000})
    whole = (tmp_path / "t").read_bytes()
    for content in (b"", b"PAR1 or not", whole[:-9], whole[:200] + whole[300:]):
        (tmp_path / "t").write_bytes(content)
        with pytest.raises(InputError, match="cannot be read as Parquet"):
            read_table(tmp_path / "t")
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_table(tmp_path / "nowhere")


def test_a_column_that_is_not_there_is_named(tmp_path: Path) -> None:
    write_table(tmp_path / "t", {"flight": [1], "gain": [0.5]})
    with pytest.raises(InputError, match="the table has no column 'gian'; did you mean 'gain'"):
        read_table(tmp_path / "t", ["flight", "gian"])
