"""Bench logs whose clocks are wrong: two in one file, one that wobbles; bounds that hold the truth, or a line."""

from pathlib import Path

import numpy as np
import pytest
from known_benches import Truth, bench_log, excite, thrust

from cosim.base.errors import InputError
from cosim.identify.bench import BenchIdentification, Columns, identify_bench, read_records
from cosim.identify.bench.clocks import find_even_rows

TRUTH = Truth(delay=0.1037)


def write(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """Columns of different lengths beside each other, the shorter ones with empty cells behind them."""
    rows = max(map(len, columns.values()))
    cells = [[f"{value:.9g}" for value in one] + [""] * (rows - len(one)) for one in columns.values()]
    path.write_text("\n".join([",".join(columns), *map(",".join, zip(*cells, strict=True))]) + "\n", encoding="utf-8")
    return path


def two_clocks(every: int = 5) -> dict[str, np.ndarray]:
    """An ECU's rows at 10 Hz and a load cell's at 50 Hz, 37 s ahead, that runs 300 ppm fast."""
    times, command, newtons, _ = bench_log("stairs of 5 s", 50.0, TRUTH, noise=0.0)
    rng = np.random.default_rng(3)
    rows = np.arange(0, len(times), every)
    rpm = 33000.0 + 650.0 * (newtons - 5.0) + 30.0 * rng.standard_normal(len(times))
    force = newtons + 0.3 * rng.standard_normal(len(times))
    return {"a": times[rows], "throttle": command[rows], "rpm": rpm[rows], "b": 1.0003 * times + 37.0, "force": force}


def named(columns: dict[str, np.ndarray], names: str) -> dict[str, np.ndarray]:
    """The columns in this order, by these names: ``key:name``."""
    return {name or key: columns[key] for key, _, name in (one.partition(":") for one in names.split(","))}


@pytest.mark.parametrize("every", [5, 1])
@pytest.mark.parametrize(
    "names",
    [
        "a:time_s,throttle,rpm,b:t [s],force:F (N)",
        "a:ecu_time_s,b:cell_time_s,force:cell_force_N,throttle:ecu_throttle,rpm:ecu_rpm",
    ],
)
def test_two_clocks_in_one_file_are_split_and_laid_over_each_other(tmp_path: Path, every: int, names: str) -> None:
    """By the columns' order or by their names; the alignment's error is in the delay's bounds."""
    (record,) = read_records([write(tmp_path / "both.csv", named(two_clocks(every), names))])
    assert record.clock_deviation > 0.005
    (words,) = (note for note in record.notes if note.startswith("two clocks: the output's is -37.0"))
    drift = float(words.split(" drifts by ")[1].split()[0])
    assert drift == pytest.approx(-300.0, abs=50.0)
    low, high = identify_bench([record]).chosen.delay_bounds
    assert low <= TRUTH.delay <= high
    assert high - low >= 2 * 1.96 * record.clock_deviation


def test_two_clocks_of_which_nothing_tells_which_signal_is_whose_are_asked_about(tmp_path: Path) -> None:
    columns = named(two_clocks(1), "a:time_1_s,b:time_2_s,throttle,rpm,force:thrust_N")
    path = write(tmp_path / "both.csv", columns)
    with pytest.raises(InputError, match=r"time_1_s and time_2_s are not one clock.*--time NAME takes one for all"):
        read_records([path])
    assert read_records([path], Columns(time="time_1_s"))[0].clock_deviation == 0.0


def test_one_clock_in_two_units_is_not_split(tmp_path: Path) -> None:
    columns = two_clocks(1)
    columns["b"] = 1e3 * columns["a"]
    (record,) = read_records([write(tmp_path / "one.csv", named(columns, "a:time_s,throttle,b:t_ms,force:thrust_N"))])
    assert record.clock_deviation == 0.0


def wobbling(path: Path, kind: str, wobble: tuple[float, float], hidden: bool, seed: int = 0) -> BenchIdentification:
    """Rows at 20 Hz whose stamps, or whose thrust against its command, are off by ``amplitude sin(2 pi t / period)``."""
    times, command, straight = excite(kind, 20.0)
    off = wobble[0] * np.sin(2.0 * np.pi * times / wobble[1] + 1.0)
    fine = np.arange(0.0, times[-1], 0.005)
    at = np.maximum(np.searchsorted(times, fine + 1e-9, side="right") - 1, 0)
    newtons = thrust(TRUTH, fine, np.interp(fine, times, command) if straight else command[at], straight)
    newtons = np.interp(times - off if hidden else times, fine, newtons)
    newtons += 0.5 * np.random.default_rng([seed, 11]).standard_normal(len(times))
    stamps = times if hidden else times + off
    return identify_bench(read_records([write(path, {"time_s": stamps, "throttle": command, "thrust_N": newtons})]))


def holds(result: BenchIdentification) -> bool:
    """Whether the bounds hold delay, delay and lag together, and the gain; each a little wider, for one log of many."""
    low, high = result.chosen.delay_bounds
    total, deviation = result.chosen.total
    gain = 3.0 * result.chosen.deviation(len(result.chosen.x))
    return (
        low <= TRUTH.delay <= high and abs(total - 0.5037) < 3.0 * deviation and abs(result.chosen.gain - 100.0) < gain
    )


@pytest.mark.parametrize("wobble", [(0.1, 10.0), (1.0, 60.0)])
def test_stamps_that_run_slow_then_quick_are_told_by_their_rows(tmp_path: Path, wobble: tuple[float, float]) -> None:
    result = wobbling(tmp_path / "slow.csv", "stairs of 5 s", wobble, hidden=False)
    (note,) = (note for note in result.notes if note.startswith("the time stamps wander by "))
    assert float(note.split()[5]) == pytest.approx(2.0 * wobble[0], rel=0.15)
    assert result.is_explained
    assert holds(result)


def test_stamps_with_jitter_or_lost_rows_do_not_wander() -> None:
    times, rng = np.arange(1200) / 20.0, np.random.default_rng(1)
    assert find_even_rows(times + 0.01 * rng.standard_normal(len(times))) is None
    assert find_even_rows(times[rng.random(len(times)) > 0.2]) is None
    assert find_even_rows(np.round(times / 0.6, 2)) is None
    found = find_even_rows(times + 0.1 * np.sin(times))
    assert found is not None
    np.testing.assert_allclose(found.on_rows(found.stamps), times, atol=0.02)


def test_an_output_whose_clock_wobbles_against_the_commands_has_the_spread_in_its_bounds(tmp_path: Path) -> None:
    result = wobbling(tmp_path / "hidden.csv", "stairs of 2 s", (0.03, 60.0), hidden=True)
    assert result.is_explained
    assert any("ms apart, by more than noise: a clock that wobbles" in note for note in result.notes)
    assert holds(result)
    low, high = result.chosen.delay_bounds
    assert 0.05 < high - low < 0.15


def test_what_is_large_and_as_slow_as_the_answer_is_no_noise(tmp_path: Path) -> None:
    """A second to and fro: noise that remembers itself for 10 s would explain all, with a gain of 60 for 100."""
    result = wobbling(tmp_path / "hidden.csv", "stairs of 5 s", (1.0, 60.0), hidden=True)
    assert not result.is_explained
    assert any("moves as slowly as the answer: a clock that wobbles" in note for note in result.notes)


def test_a_command_with_noise_may_be_held_between_its_rows(tmp_path: Path) -> None:
    """Half a row of delay, which nothing tells: the bounds hold both."""
    times, command, newtons, _ = bench_log("stairs of 5 s", 20.0, TRUTH)
    noisy = command + 0.003 * np.random.default_rng(0).standard_normal(len(times))
    path = write(tmp_path / "noisy.csv", {"time_s": times, "throttle": noisy, "thrust_N": newtons})
    result = identify_bench(read_records([path]))
    assert any("taken for straight between rows" in note for note in result.notes)
    assert holds(result)


def test_rows_of_two_engines_in_turn_are_no_noise(tmp_path: Path) -> None:
    times, command, first, _ = bench_log("stairs of 5 s", 20.0)
    second = bench_log("stairs of 5 s", 20.0, Truth(delay=0.2, lags=(0.7,), gain=130.0))[2]
    mixed = np.where(np.arange(len(times)) % 2 == 0, first, second)
    path = write(tmp_path / "mixed.csv", {"time_s": times, "throttle": command, "thrust_N": mixed})
    result = identify_bench(read_records([path]))
    assert not result.is_explained
    assert any("alternates from row to row: rows of two engines" in note for note in result.notes)
