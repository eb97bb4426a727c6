"""Betaflight's blackbox is read as it was written, damaged or not; another test has a file of Betaflight's own."""

from pathlib import Path

import numpy as np
import pytest
from blackbox_writer import END, FIELDS, SLOW, TAG2_3, TAG2_3V, TAG8_4, Field, Writer, beside
from known_logs import Truth, closed_loops

from cosim.base.errors import InputError
from hexjet_identify.logs import FlightLog, read_flight_log, signals_of
from hexjet_identify.prediction_error.identify_log import identify_log

pytestmark = pytest.mark.usefixtures("logs_read_here")

ROWS = 400


@pytest.fixture(scope="module")
def table() -> dict[str, np.ndarray]:
    """Numbers of every size that each encoding has."""
    rng = np.random.default_rng(1)
    made = {"loopIteration": 2 * np.arange(ROWS), "time": 10**6 + 500 * np.arange(ROWS) + rng.integers(-3, 4, ROWS)}
    for f in FIELDS[2:]:
        most = {TAG8_4: 4.5, TAG2_3: 6.5, TAG2_3V: 6.5}.get(f.p[1], 4.0)
        steps = np.trunc(10 ** rng.uniform(0.0, most, ROWS)) * rng.integers(-1, 2, ROWS)
        values = np.cumsum(steps)
        if f.p[1] == TAG8_4:
            values = np.clip(values, -16000, 16000)
        made[f.name] = (values if f.signed else np.abs(values) % 3000).astype(np.int64)
    return made | {"vbatLatest": 1500 + made["vbatLatest"] % 100}


def read(tmp_path: Path, content: bytes, number: str = "") -> FlightLog:
    (tmp_path / "LOG00001.BFL").write_bytes(content)
    return read_flight_log(tmp_path / f"LOG00001.BFL{number}")


def whole(table: dict[str, np.ndarray], writer: Writer) -> bytes:
    return writer.head() + b"".join(writer.frames(table)) + END


@pytest.mark.parametrize("writer", [Writer(of=2), Writer(every=64, of=2), Writer(every=8, of=8)])
def test_every_encoding_is_read_as_written(tmp_path: Path, table: dict[str, np.ndarray], writer: Writer) -> None:
    """All differences against one and two frames before; frames of home, place, slow things and events between."""
    step = max(1, writer.of // 2)
    kept = {name: values[::step] for name, values in table.items()}
    frames = writer.frames(kept)
    log = read(tmp_path, writer.head() + SLOW + b"".join(frames[:40]) + beside(5) + b"".join(frames[40:]) + END)
    assert not log.remarks
    assert log.kind == "Betaflight blackbox"
    for name, values in kept.items():
        if name != "time":
            np.testing.assert_array_equal(log.channels[name].values, values, err_msg=name)
    times = log.channels["motor[0]"].times
    np.testing.assert_allclose(times, 1e-6 * kept["time"], atol=1e-9)
    sums = sum(kept[f"axis{part}[1]"] for part in "PIF")
    np.testing.assert_array_equal(log.channels["axisSum[1]"].values, sums)
    assert log.channels["GPS_coord[1]"].values.tolist() == [85455000 - 70]
    assert log.channels["GPS_numSat"].times == pytest.approx([times[39] + 5e-6])
    assert log.channels["rxSignalReceived"].values.tolist() == [1.0]


def test_high_resolution_and_older_counts_become_degrees(tmp_path: Path, table: dict[str, np.ndarray]) -> None:
    coarse, fine = (read(tmp_path, whole(table, Writer(of=2, fine=fine))) for fine in (False, True))
    for name in ("gyroADC[0]", "setpoint[2]"):
        np.testing.assert_allclose(10.0 * fine.channels[name].values, coarse.channels[name].values, rtol=1e-12)
    np.testing.assert_array_equal(fine.channels["setpoint[3]"].values, coarse.channels["setpoint[3]"].values)
    older = read(tmp_path, whole(table, Writer(of=2)).replace(b"gyro_scale:0x3f800000", b"gyro_scale:0x3d79f06f"))
    np.testing.assert_allclose(older.channels["gyroADC[1]"].values, table["gyroADC[1]"] * 0.0610203, rtol=1e-5)


def test_one_log_of_several_is_chosen(tmp_path: Path, table: dict[str, np.ndarray]) -> None:
    """The longest, or the one that is named; what fills a memory chip behind the end is none of it."""
    short = {name: values[:40] for name, values in table.items()}
    content = whole(short, Writer(of=2)) + b"\xff" * 500 + whole(table, Writer(of=2)) + whole(short, Writer(of=2))
    log = read(tmp_path, content)
    assert len(log.channels["motor[0]"].values) == ROWS
    assert log.remarks == ("the file holds 3 logs; number 2 is read, the longest; FILE:N reads another",)
    assert len(read(tmp_path, content, ":3").channels["motor[0]"].values) == 40
    with pytest.raises(InputError, match="it holds 3 logs; 4 is none of them"):
        read(tmp_path, content, ":4")
    (tmp_path / "log.csv").write_text("t,u\n0,1\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match="holds one log"):
        read_flight_log(tmp_path / "log.csv:1")


def test_damage_is_passed_over_and_counted(tmp_path: Path, table: dict[str, np.ndarray]) -> None:
    """What is left is right: a frame that builds on a damaged one is not used, up to the next whole one."""
    writer = Writer(of=2)
    frames = writer.frames(table)
    at = len(writer.head()) + sum(map(len, frames[:100]))
    content = bytearray(whole(table, writer))
    content[at + 3 : at + 60] = b"\xa5" * 57
    log = read(tmp_path, bytes(content))
    counts = log.channels["loopIteration"].values.astype(int) // 2
    assert set(range(ROWS)) - set(counts.tolist()) == set(range(100, 112))  # up to the I frame of 224 loops
    for name in ("gyroADC[2]", "axisI[0]", "motor[3]", "axisF[1]"):
        np.testing.assert_array_equal(log.channels[name].values, table[name][counts])
    assert any(remark.startswith("1 frames are damaged and were passed over, with ") for remark in log.remarks)


def test_a_pause_and_a_clock_that_rolls_over_are_followed(tmp_path: Path, table: dict[str, np.ndarray]) -> None:
    writer = Writer(of=2)
    late = table | {"time": (table["time"] + 2**32 - 1_100_000) & 0xFFFFFFFF}
    times = read(tmp_path, whole(late, writer)).channels["motor[0]"].times
    np.testing.assert_allclose(np.diff(times), 1e-6 * np.diff(table["time"]), atol=1e-7)
    jumped = table | {
        name: table[name] + np.where(np.arange(ROWS) < 200, 0, more)
        for name, more in (("loopIteration", 64_000), ("time", 16_000_000))
    }
    jumped_log = read(tmp_path, whole(jumped, writer)).channels["loopIteration"].values
    assert set(jumped["loopIteration"].tolist()) - set(jumped_log.tolist()) == set(range(64_400, 64_448, 2))


@pytest.mark.parametrize("cut", [10, 70, 300, 900])
def test_hardly_anything_is_no_log(tmp_path: Path, table: dict[str, np.ndarray], cut: int) -> None:
    with pytest.raises(InputError) as refusal:
        read(tmp_path, whole(table, Writer())[:cut])
    assert "\n" not in str(refusal.value)


def test_a_log_that_is_cut_short_says_so(tmp_path: Path, table: dict[str, np.ndarray]) -> None:
    content = whole(table, Writer(of=2))
    log = read(tmp_path, content[: len(content) * 2 // 3])
    assert any("the log has no end" in remark for remark in log.remarks)
    assert 100 < len(log.channels["motor[0]"].values) < ROWS


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("I encoding:1,1", "I encoding:1", "I frames have no encoding each"),
        ("P encoding:9", "P encoding:5", "encoding 5 of P frames is not known"),
        ("I predictor:0,0", "I predictor:0,2", "predictor 2 of I frames is not known"),
        ("Data version:2", "Data version:1", "data version 1; allowed: 2"),
        ("H Field I name", "H Field X name", "names no fields"),
    ],
)
def test_a_head_that_is_wrong_is_refused(
    tmp_path: Path, table: dict[str, np.ndarray], old: str, new: str, said: str
) -> None:
    content = whole(table, Writer())
    assert old.encode() in content
    with pytest.raises(InputError, match=said):
        read(tmp_path, content.replace(old.encode(), new.encode()))


def test_a_flight_of_known_truth_comes_out_of_the_format(tmp_path: Path) -> None:
    """Whole degrees a second, whole counts, microseconds, lost rows: delay within its bounds, as Betaflight logs it."""
    truth = Truth(lags=(0.0299,))
    (log,) = closed_loops(1, 14.0, seed=3, truth=truth, size=0.5, sweep=0.006)
    kept = np.round(log.times / truth.step).astype(int)
    rows = {
        "loopIteration": kept, "time": np.rint(1e6 * log.times), "axisP[0]": np.rint(1e5 * log.command),
        "gyroADC[0]": np.rint(10.0 * np.degrees(log.output)), "setpoint[0]": np.rint(10.0 * np.degrees(log.setpoint)),
    }  # fmt: skip
    fields = [f for f in FIELDS if f.name in rows or f.name.startswith(("axis", "motor", "setpoint"))]
    assert all(isinstance(f, Field) for f in fields)
    writer = Writer(fields=fields, every=1, of=1, fine=True)  # rows are lost: only whole frames can be put one by one
    found = read(tmp_path, whole(rows, writer))
    chosen = signals_of(found, "roll")
    assert (chosen.command, chosen.setpoint) == ("axisSum[0]", "deg(setpoint[0])")
    result = identify_log(found, "roll", chosen, longest_delay=0.3, lags=1)
    low, high = result.delay_bounds
    assert low < truth.delay_samples * truth.step < high
    assert high - low < 2.5 * truth.step
    assert result.chosen.gain[0] * 1e5 == pytest.approx(truth.gain, rel=0.05)
