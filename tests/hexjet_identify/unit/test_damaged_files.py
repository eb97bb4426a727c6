"""Damaged files of every kind: each is read, or refused in one line, in bounded time and memory, and nothing is left."""

import re
import struct
import warnings
import zipfile
from pathlib import Path

import damaged_files
import numpy as np
import pytest
from damaged_files import KINDS, try_files

from cosim.base.protocols import Column
from cosim.results.log.arrow import write_log
from hexjet_identify.logs import read_flight_log

SOME, MANY = 25, 400
DEAR = ("ulog", "mat", "summary", "rows", "stream")  # a process, or a table of a whole run, for each


@pytest.mark.parametrize("name", KINDS)
def test_a_damaged_file_is_read_or_refused(name: str) -> None:
    outcome = try_files(name, SOME // 5 if name in DEAR else SOME)
    assert outcome.faults == []


@pytest.mark.long
@pytest.mark.parametrize("name", KINDS)
def test_many_damaged_files_are_read_or_refused(name: str) -> None:
    outcome = try_files(name, MANY, seed=2)
    assert outcome.faults == []
    assert outcome.refused > 0
    assert outcome.read > 0


@pytest.mark.parametrize(
    ("pattern", "instead", "said"),
    [
        (rb'start="[^"]*"', b'start=""', "could not convert string to float"),
        (rb"<CoSimulation", b"<a:b/><CoSimulation", "unbound prefix"),
    ],
)
def test_what_was_found_in_descriptions(tmp_path: Path, pattern: bytes, instead: bytes, said: str) -> None:
    file = KINDS["description"].make(tmp_path)
    file.write_bytes(re.sub(pattern, instead, file.read_bytes()))
    refusal = damaged_files.attempt(KINDS["description"], file)
    assert refusal.startswith("=")
    assert said in refusal


def test_an_fmu_with_a_damaged_source_is_refused(tmp_path: Path) -> None:
    file = KINDS["fmu"].make(tmp_path)
    with zipfile.ZipFile(file) as archive:
        entry = archive.getinfo(next(name for name in archive.namelist() if name.endswith("delayed_lag.c")))
    content = bytearray(file.read_bytes())
    content[entry.header_offset + 30 + len(entry.filename) + entry.compress_size // 2] ^= 0xFF
    file.write_bytes(content)
    assert "is damaged or truncated" in damaged_files.attempt(KINDS["fmu"], file)


def test_a_nan_that_signals_is_a_nan(tmp_path: Path) -> None:
    """Arithmetic with it would warn."""
    file = KINDS["parquet"].make(tmp_path)
    signals = np.full(120, 0x7FF0000000000001, np.uint64).view(np.float64)
    write_log(
        file, [Column(name, "", "", "") for name in ("time", "u")], iter([{"time": np.arange(120.0), "u": signals}]), {}
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert damaged_files.attempt(KINDS["parquet"], file) == ""
        log = read_flight_log(file)
        assert np.isnan(log.signal("deg(u)").values).all()


def test_a_message_of_nothing_but_its_head_is_left_out(tmp_path: Path) -> None:
    """A format of no fields is possible, and its length is that of the head."""
    file = KINDS["dataflash"].make(tmp_path)
    nothing = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 9, 3, b"NONE", b"", b"") + b"\xa3\x95\x09" * 5
    file.write_bytes(file.read_bytes() + nothing)
    assert damaged_files.attempt(KINDS["dataflash"], file) == ""
