"""The process that reads logs of somebody else: the same numbers as here, and a line for whatever goes wrong in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from file_kinds import KINDS
from scipy.io import savemat

from cosim.base.errors import InputError
from hexjet_identify.logs import FlightLog, read_flight_log, reader
from hexjet_identify.logs.table_columns import TableColumns

READERS = {
    "dataflash": "dataflash.read",
    "ulog": "ulog.read",
    "csv": "table_columns.read_text_table",
    "parquet": "table_columns.read_parquet",
    "mat": "table_columns.read_mat",
}
TIMES = np.arange(50) * 0.01


@pytest.mark.parametrize("kind", READERS)
def test_the_numbers_are_those_that_are_read_here(tmp_path: Path, kind: str) -> None:
    path = KINDS[kind].make(tmp_path)
    apart, here = reader.read_apart(READERS[kind], path), reader.read_here(READERS[kind], path)
    if isinstance(here, TableColumns):
        assert isinstance(apart, TableColumns)
        assert list(apart.names) == list(here.names)
        assert (apart.dates, apart.units, apart.remarks) == (here.dates, here.units, here.remarks)
        pairs = {name: (apart.numbers[name], values) for name, values in here.numbers.items()}
    else:
        assert isinstance(apart, FlightLog)
        assert isinstance(here, FlightLog)
        assert (apart.kind, apart.remarks) == (here.kind, here.remarks)
        pairs = {name: (apart.channels[name].values, channel.values) for name, channel in here.channels.items()}
        times = [id(channel.times) for channel in here.channels.values()]
        again = [id(channel.times) for channel in apart.channels.values()]
        assert [times.index(each) for each in times] == [again.index(each) for each in again]  # shared ones stay so
        for name, channel in here.channels.items():
            assert apart.channels[name].times.tobytes() == channel.times.tobytes()
            assert apart.channels[name].unit == channel.unit
    assert pairs
    for found, values in pairs.values():
        assert found.tobytes() == values.tobytes()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"columns": 5.0}, "without a flight of ours"),
        ({"columns": {"u": "text"}}, "u: is text; a flight of ours has columns of real numbers"),
        ({"columns": {"u": TIMES + 1j}}, "u: is complex numbers"),
        ({"columns": {"u": np.array([[], "a"], object)}}, "u: is objects"),
        ({"columns": {"u": np.eye(50)}}, "u: is 2-dimensional"),
        ({"columns": {"u": np.arange(4.0)}}, "u: has 4 rows, and the time has 50"),
        ({"time": -TIMES}, "row 2: the time must grow from row to row"),
        ({"names": {"u": 5.0}}, None),
    ],
)
def test_nonsense_of_matlab_is_refused_in_a_line(tmp_path: Path, changes: dict[str, Any], said: str | None) -> None:
    savemat(tmp_path / "x.mat", {"flight": {"time": TIMES, "columns": {"u": TIMES}} | changes})
    if said is None:  # a name is a word for a column, whatever it is
        assert list(read_flight_log(tmp_path / "x.mat").channels) == ["5.0"]
        return
    with pytest.raises(InputError, match=said) as refused:
        read_flight_log(tmp_path / "x.mat")
    assert "\n" not in str(refused.value)


def test_a_small_file_of_very_much_is_refused(tmp_path: Path) -> None:
    """A megabyte that asks for gigabytes: the reader may have one."""
    much = np.zeros(150_000_000, np.uint8)
    savemat(tmp_path / "x.mat", {"flight": {"time": much, "columns": {"u": much}}}, do_compression=True)
    assert (tmp_path / "x.mat").stat().st_size < 2**20
    with pytest.raises(InputError, match=r"asks for more than 10\d\d MB of memory$"):
        read_flight_log(tmp_path / "x.mat")


def test_a_reader_that_crashes_is_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "_READER_CODE", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    path = KINDS["csv"].make(tmp_path)
    with pytest.raises(
        InputError, match=r"bench\.csv: cannot be read: it is damaged; the process was ended by SIGSEGV$"
    ):
        read_flight_log(path)


def test_what_a_reader_raises_is_a_line(tmp_path: Path) -> None:
    path = KINDS["mat"].make(tmp_path)
    content = bytearray(path.read_bytes())
    content[300:] = bytes(len(content) - 300)
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"flight\.mat: ") as refused:
        read_flight_log(path)
    assert "\n" not in str(refused.value)
