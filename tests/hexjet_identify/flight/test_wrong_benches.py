"""Bench logs with something wrong in them: told in a line, or read as they are meant."""

from pathlib import Path

import numpy as np
import pytest
from known_benches import Truth, bench_log

from cosim.base.errors import InputError
from cosim.engine import load_engine, make_bank
from hexjet_identify.bench import Columns, identify_bench, read_records
from hexjet_identify.bench.identify import throttle_limits

TRUTH = Truth()  # 0.1 s of delay, a lag of 0.4 s


def write(path: Path, times: np.ndarray, command: np.ndarray, thrust: np.ndarray) -> Path:
    np.savetxt(
        path, np.column_stack([times, command, thrust]), "%.12g", ",", header="time,throttle,thrust_N", comments=""
    )
    return path


@pytest.mark.parametrize("stamp", [1.0, 0.5, 0.1])
def test_rows_that_share_the_stamp_of_a_whole_second_are_refused(tmp_path: Path, stamp: float) -> None:
    """All but one row of each would be left out, and the command would move up to a stamp later than it does."""
    times, command, thrust, _ = bench_log("stairs of 5 s", 50.0, TRUTH)
    path = write(tmp_path / "bench.csv", stamp * np.floor((times + 0.3) / stamp + 1e-9), command, thrust)
    shared = len(times) - len(np.unique(np.floor((times + 0.3) / stamp + 1e-9)))
    with pytest.raises(
        InputError, match=rf"bench.csv: {shared} of 3000 rows of thrust_N have the time of the row before"
    ):
        read_records([path])


def test_rows_that_are_not_in_order_and_a_few_of_another_test_cost_nothing(tmp_path: Path) -> None:
    """As public logs of thrust stands have them: rows of several threads, and the last ones of the test before."""
    times, command, thrust, _ = bench_log("stairs of 5 s", 20.0, TRUTH)
    order = np.arange(len(times))
    order[100:1000:9], order[101:1000:9] = order[101:1000:9].copy(), order[100:1000:9].copy()
    rows = np.concatenate([[len(times) - 2, len(times) - 1], order])
    (record,) = read_records([write(tmp_path / "bench.csv", *(one[rows] for one in (times, command, thrust)))])
    assert np.array_equal(record.times, times)
    np.testing.assert_allclose(record.output, thrust, rtol=1e-10)
    assert "100 rows are not in the order of time, by up to 0.05 s; sorted" in record.notes
    assert "2 rows stand where the time begins again; left out" in record.notes


def test_frames_that_are_written_twice_are_no_rows_within_a_stamp(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("ramp", 20.0, TRUTH)
    (record,) = read_records([write(tmp_path / "bench.csv", *(np.repeat(one, 2) for one in (times, command, thrust)))])
    assert np.array_equal(record.times, np.unique(times))


def test_a_time_in_days_is_asked_for_and_can_be_said(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 20.0, TRUTH)
    log = write(tmp_path / "bench.csv", 45382.5 + times / 86400.0, command, thrust)
    with pytest.raises(
        InputError, match=r"bench.csv: 5.8e-07 s from row to row; allowed: 1e-05 s or more.*time.unit d"
    ):
        read_records([log])
    found = identify_bench(read_records([log], Columns(time_unit="d")))
    assert found.is_explained
    assert found.chosen.delay_bounds[0] <= 0.1 <= found.chosen.delay_bounds[1]


def test_a_column_that_is_left_out_is_named_where_it_may_be_the_one_that_is_missing(tmp_path: Path) -> None:
    log = tmp_path / "bench.csv"
    log.write_text("time,throttle,thrust_N\n" + "".join(f'{n},0.{n % 2},"1,{n:03d}.5"\n' for n in range(40)))
    with pytest.raises(InputError, match="one of: throttle; left out, being no numbers: thrust_N"):
        read_records([log])


@pytest.mark.parametrize(
    ("head", "low", "high", "words"),
    [
        ("throttle [%]", 1000.0, 2000.0, "goes from 1100 to 1900"),  # a servo's pulse
        ("throttle [deg]", 0.0, 90.0, "goes from 9 to 81"),  # a lever
        ("throttle [V]", 0.0, 1.0, "goes from 0.1 to 0.9"),
        ("throttle", -1.0, 1.0, "goes from -0.8 to 0.8"),
    ],
)
def test_a_throttle_in_a_unit_that_is_none_leaves_no_engine(
    tmp_path: Path, head: str, low: float, high: float, words: str
) -> None:
    log = tmp_path / "bench.csv"
    rows = [f"{0.1 * n:.1f},{low + (high - low) * (0.1 if n < 20 else 0.9):g},{n % 3}" for n in range(40)]
    log.write_text(f"time,{head},thrust_N\n" + "\n".join(rows) + "\n")
    notes: list[str] = []
    limits, is_known = throttle_limits(read_records([log]), None, notes)
    assert not is_known
    assert limits == pytest.approx((low + 0.1 * (high - low), low + 0.9 * (high - low)))
    assert f"what throttle 0 and 1 are is not known ({head} {words})" in notes[0]


def test_a_range_in_another_unit_than_the_throttle_is_refused(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 20.0, TRUTH)
    records = read_records([write(tmp_path / "bench.csv", times, 1000.0 + 1000.0 * command, thrust)])
    assert (
        throttle_limits(records, None, []) == throttle_limits(records, (1000.0, 2000.0), []) == ((1000.0, 2000.0), True)
    )
    for wrong in ((0.0, 1.0), (0.0, 100.0), (2500.0, 3500.0)):
        with pytest.raises(InputError, match=r"throttle_range .*: throttle goes from 1.* to .*; allowed: 5 % of"):
            throttle_limits(records, wrong, [])


def test_a_bank_that_follows_throttles_answers_as_one_that_is_stepped() -> None:
    spec = load_engine("fitted", {"gain": 200.0, "lag": 0.4, "rise": 0.5, "fall": 0.5, "delay_samples": 7.0}, 0.004)
    throttles = [0.2] * 300 + [0.8] * 300 + np.linspace(0.8, 0.1, 500).tolist()
    with make_bank([spec], 0.004) as bank:
        bank.reset(0.2)
        stepped = [bank.step(k, (throttle,)).thrust[0] for k, throttle in enumerate(throttles)]
    with make_bank([spec], 0.004) as bank:
        bank.reset(0.2)
        assert bank.follow(0, throttles) == stepped


@pytest.mark.parametrize("kind", ["step", "stairs of 5 s", "prbs"])
def test_an_output_that_moves_before_its_command_is_not_explained(tmp_path: Path, kind: str) -> None:
    times, command, thrust, _ = bench_log(kind, 20.0, TRUTH)
    ahead = np.interp(times + 0.5, times, thrust)  # 0.4 s before the command: the delay is 0.1 s
    assert not identify_bench(read_records([write(tmp_path / "bench.csv", times, command, ahead)])).is_explained


def test_columns_that_are_swapped_leave_no_engine(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 20.0, TRUTH)
    noise = np.random.default_rng(0).normal(0.0, 1.0, len(times))
    swapped = write(tmp_path / "bench.csv", times, thrust / 200.0, 200.0 * command + noise)
    assert identify_bench(read_records([swapped])).refused


@pytest.mark.parametrize("kind", ["step", "stairs of 5 s"])
def test_an_engine_without_a_delay_is_explained_and_doubted(tmp_path: Path, kind: str) -> None:
    times, command, thrust, _ = bench_log(kind, 20.0, Truth(delay=0.0))
    found = identify_bench(read_records([write(tmp_path / "bench.csv", times, command, thrust)]))
    assert found.chosen.delay_bounds[0] == 0.0
    assert found.is_explained
    assert any("an output that moves before its command, as where columns are swapped" in note for note in found.notes)
