"""Tables of other tools: separators, decimal marks, encodings, heads, units, dates, and which column is the time."""

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import InputError
from hexjet_identify.logs import FlightLog, read_flight_log

pytestmark = pytest.mark.usefixtures("logs_read_here")

ROWS = 60
TIMES = 0.01 * np.arange(ROWS)
WAVE = np.round(np.sin(10.0 * TIMES), 6)


def read(tmp_path: Path, content: str | bytes, name: str = "x.csv", **told: str) -> FlightLog:
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return read_flight_log(tmp_path / name, **told)


def lines(head: str, form: Callable[[int], str], *, rows: int = ROWS) -> str:
    return "\n".join([head, *(form(n) for n in range(rows))]) + "\n"


PLAIN = lines("time,u,y", lambda n: f"{TIMES[n]:.3f},{WAVE[n]:.6f},{2 * WAVE[n]:.6f}")


def same(log: FlightLog, unit: str = "") -> None:
    assert set(log.channels) == {"u", "y"}
    np.testing.assert_allclose(log.channels["u"].times, TIMES, atol=5e-7)  # of seconds since 1970 a double has 2.4e-7
    np.testing.assert_allclose(log.channels["u"].values, WAVE, atol=1e-12)
    np.testing.assert_allclose(log.channels["y"].values, 2.0 * WAVE, atol=1e-12)
    assert log.channels["u"].unit == unit


@pytest.mark.parametrize("separator", [",", ";", "\t", "|", " ", "   "])
@pytest.mark.parametrize("mark", [".", ","])
def test_any_separator_and_decimal_mark(tmp_path: Path, separator: str, mark: str) -> None:
    if separator == mark:  # in quotes, as spreadsheets write it
        form = lambda n: ",".join(f'"{x:.6f}"'.replace(".", ",") for x in (TIMES[n], WAVE[n], 2 * WAVE[n]))  # noqa: E731
        same(read(tmp_path, lines("time,u,y", form)))
        return
    same(read(tmp_path, PLAIN.replace(",", separator).replace(".", mark)))


@pytest.mark.parametrize("codec", ["utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_any_encoding_and_end_of_line(tmp_path: Path, codec: str, end: str) -> None:
    log = read(tmp_path, PLAIN.replace("u,y", "Stärke,y").replace("\n", end).encode(codec))
    np.testing.assert_allclose(log.channels["Stärke"].values, WAVE, atol=1e-12)


@pytest.mark.parametrize("name", ["x.txt", "x.tsv", "x.log", "x", "x.bin", "x.parquet"])
def test_a_table_is_one_whatever_it_is_called(tmp_path: Path, name: str) -> None:
    same(read(tmp_path, PLAIN, name))


@pytest.mark.parametrize(
    ("content", "remark"),
    [
        ("# made by a bench\n# 3 March\n" + PLAIN, "2 lines before the head"),
        ("Logger;v2\n\nSerial;7;a;b\n" + PLAIN.replace(",", ";"), "3 lines before the head"),
        ("\n\n" + PLAIN.replace(",", ", "), ""),
        ("sep=;\n" + PLAIN.replace(",", ";"), ""),
        (PLAIN.replace("time,u,y\n", "# time,u,y\n"), ""),
        (PLAIN.replace("\n", ",\n"), ""),
        (PLAIN[:-15], "1 rows have not a cell for each column"),
        (PLAIN.replace(",2", ",NaN,2", 0), ""),
    ],
)
def test_what_stands_around_the_rows(tmp_path: Path, content: str, remark: str) -> None:
    log = read(tmp_path, content)
    assert set(log.channels) == {"u", "y"}
    assert len(log.channels["u"].values) >= ROWS - 1
    np.testing.assert_allclose(log.channels["y"].values, 2.0 * WAVE[: len(log.channels["y"].values)], atol=1e-12)
    assert any(remark in text for text in log.remarks) or not remark
    assert not log.remarks or remark


def test_units_in_a_line_of_their_own_or_in_the_name(tmp_path: Path) -> None:
    form = lambda n: f"{1000 * TIMES[n]:.3f};{WAVE[n]:.6f};{2 * WAVE[n]:.6f}"  # noqa: E731
    same(read(tmp_path, lines("time;u;y\n[ms];rad;-", form)), "rad")
    for title in ("time (ms)", "Time [ms]", "time_ms", "t_ms", "Timestamp [msec]"):
        log = read(tmp_path, lines(f"{title};u;y", form))
        same(log)
        assert f"{title} is taken for the time, in ms" in log.remarks
    same(read(tmp_path, lines("time (us);u;y", form), time="time (us)", time_unit="ms"))


@pytest.mark.parametrize(
    "stamp",
    [
        lambda s: f"2026-11-25T23:59:59.{s}Z",
        lambda s: f"2026-11-25 12:00:00.{s}",
        lambda s: f"25.11.2026 12:00:00,{s}",
        lambda s: f"11/25/2026 12:00:00.{s}",
        lambda s: f"12:00:00.{s}",
    ],
)
def test_dates_and_times_of_day_are_times(tmp_path: Path, stamp: Callable[[str], str]) -> None:
    log = read(
        tmp_path,
        lines("when;u;y", lambda n: f"{stamp(f'{round(1000 * TIMES[n]):03d}')};{WAVE[n]:.6f};{2 * WAVE[n]:.6f}"),
    )
    same(log)
    assert any("counts from its first row" in remark for remark in log.remarks)


def test_a_time_of_day_passes_midnight(tmp_path: Path) -> None:
    log = read(tmp_path, lines("Time;u;y", lambda n: f"{'23:59:59' if n < 30 else '00:00:00'}.{n % 30:02d};{n};{n}"))
    steps = np.diff(log.channels["u"].times)
    np.testing.assert_allclose(np.delete(steps, 29), 0.01, atol=1e-6)
    assert steps[29] == pytest.approx(0.71, abs=1e-6)


def test_the_time_is_the_column_that_runs(tmp_path: Path) -> None:
    log = read(tmp_path, lines("time,t,u,y", lambda n: f"0,{TIMES[n]:.3f},{WAVE[n]:.6f},{2 * WAVE[n]:.6f}"))
    np.testing.assert_allclose(log.channels["u"].times, TIMES, atol=1e-12)
    with pytest.raises(InputError, match=r"no column of time; allowed: time_s, time, t, in seconds; 'tick' grow"):
        read(tmp_path, lines("tick,u,y", lambda n: f"{n},{WAVE[n]},{2 * WAVE[n]}"))


def test_cells_that_are_no_numbers_are_missing(tmp_path: Path) -> None:
    """A column is one of numbers although some of its cells are damaged; further down than a reader looks at first, too."""
    content = lines(
        "time,u,y", lambda n: f"{n},{'x?' if n == 40_000 else n},{'1.5' if n == 41_000 else '3'}", rows=42_000
    )
    log = read(tmp_path, content)
    assert np.flatnonzero(np.isnan(log.channels["u"].values)).tolist() == [40_000]
    assert log.channels["y"].values[41_000] == 1.5
    assert log.remarks == ("u: 1 of 42000 cells are no numbers; left out",)


def test_blackbox_decodes_table_is_read(tmp_path: Path) -> None:
    """A blank behind each comma, units in brackets."""
    content = lines(
        "loopIteration, time (us), axisP[0], gyroADC[0] (deg/s)",
        lambda n: f"{n:3d}, {10_000_000 + 500 * n}, {n % 7:3d}, {n / 8:.2f}",
    )
    log = read(tmp_path, content)
    assert list(log.channels) == ["loopIteration", "axisP[0]", "gyroADC[0] (deg/s)"]
    np.testing.assert_allclose(log.channels["axisP[0]"].times, 10.0 + 5e-4 * np.arange(ROWS), atol=1e-9)
    np.testing.assert_allclose(
        log.signal("deg('gyroADC[0] (deg/s)')").values, np.radians(np.round(np.arange(ROWS) / 8, 2)), atol=1e-4
    )
    assert log.channels["gyroADC[0] (deg/s)"].unit == "deg/s"
    told = read(tmp_path, content, time="time (us)", time_unit="us")
    np.testing.assert_array_equal(told.channels["axisP[0]"].times, log.channels["axisP[0]"].times)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (gzip.compress(PLAIN.encode()), "gzip"),
        (b"PK\x03\x04" + bytes(40), "zip archive"),
        (b"<!DOCTYPE html><html>", "HTML"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS"),
        (b"\n\nArduCopter V3.1\n\nFMT, 128, 89, FMT, BBnNZ, Type\n", "ArduPilot's log as text"),
        (bytes(range(256)) * 4, "begins with 00 01 02"),
        (b"one\ntwo\nthree\n", "no separator"),
        (b"\n\n\n", "no rows"),
    ],
)
def test_a_refusal_says_what_the_file_is(tmp_path: Path, content: bytes, word: str) -> None:
    with pytest.raises(InputError) as refused:
        read(tmp_path, content, "x.csv")
    assert word in str(refused.value)
    assert "\n" not in str(refused.value)
