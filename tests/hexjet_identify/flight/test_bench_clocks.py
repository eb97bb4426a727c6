"""Bench logs whose clocks are wrong: two in one file, one that wobbles, late stamps; bounds that hold the truth, or a line."""

from pathlib import Path

import numpy as np
import pytest
from known_benches import Truth, bench_log, excite, thrust

from cosim.base.errors import InputError
from hexjet_identify.bench import BenchIdentification, Columns, identify_bench, read_records
from hexjet_identify.bench.grey_box import fit_engine
from hexjet_identify.bench.grey_model import GreyChoices

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
    with pytest.raises(
        InputError, match=r"time_1_s and time_2_s are not one clock.*time_column \(--time\) takes one for all"
    ):
        read_records([path])
    assert read_records([path], Columns(time="time_1_s"))[0].clock_deviation == 0.0


def test_one_clock_in_two_units_is_not_split(tmp_path: Path) -> None:
    columns = two_clocks(1)
    columns["b"] = 1e3 * columns["a"]
    (record,) = read_records([write(tmp_path / "one.csv", named(columns, "a:time_s,throttle,b:t_ms,force:thrust_N"))])
    assert record.clock_deviation == 0.0


def wobbling(path: Path, kind: str, wobble: tuple[float, float]) -> Path:
    """Rows at 20 Hz whose thrust is off by ``amplitude sin(2 pi t / period)`` in time against its command."""
    times, command, straight = excite(kind, 20.0)
    off = wobble[0] * np.sin(2.0 * np.pi * times / wobble[1] + 1.0)
    fine = np.arange(0.0, times[-1], 0.005)
    at = np.maximum(np.searchsorted(times, fine + 1e-9, side="right") - 1, 0)
    newtons = thrust(TRUTH, fine, np.interp(fine, times, command) if straight else command[at], straight)
    newtons = np.interp(times - off, fine, newtons) + 0.5 * np.random.default_rng([0, 11]).standard_normal(len(times))
    return write(path, {"time_s": times, "throttle": command, "thrust_N": newtons})


def holds(result: BenchIdentification) -> bool:
    """Whether the bounds hold delay, delay and lag together, and the gain; each a little wider, for one log of many."""
    low, high = result.chosen.delay_bounds
    total, deviation = result.chosen.total
    gain = 3.0 * result.chosen.deviation(len(result.chosen.x))
    return (
        low <= TRUTH.delay <= high and abs(total - 0.5037) < 3.0 * deviation and abs(result.chosen.gain - 100.0) < gain
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_host_whose_stamps_are_late_by_chance_changes_no_verdict(tmp_path: Path, seed: int) -> None:
    """By 6 ms in the mean, as over USB, so that some rows share a stamp; what is seen at 40 Hz is explained."""
    times, command, newtons, _ = bench_log("stairs of 2 s", 40.0, TRUTH, seed)
    stamps = np.maximum.accumulate(times + np.random.default_rng(seed).exponential(0.006, len(times)))
    columns = {"time_s": np.round(stamps, 3), "throttle": command, "thrust_N": newtons}
    result = identify_bench(read_records([write(tmp_path / "usb.csv", columns)]))
    assert result.is_explained
    assert holds(result)


@pytest.mark.parametrize("kind", ["stairs of 2 s", "stairs of 5 s", "prbs"])
def test_lost_rows_in_which_a_held_command_moves_are_in_the_bounds(tmp_path: Path, kind: str) -> None:
    times, command, newtons, _ = bench_log(kind, 10.0, TRUTH, 1)
    keep = np.random.default_rng(3).random(len(times)) >= 0.07
    columns = {"time_s": times[keep], "throttle": command[keep], "thrust_N": newtons[keep]}
    result = identify_bench(read_records([write(tmp_path / "lost.csv", columns)]))
    assert result.is_explained
    assert holds(result)


def test_an_output_whose_clock_wobbles_against_the_commands_has_the_spread_in_its_bounds(tmp_path: Path) -> None:
    """By lags and by an engine that is simulated alike."""
    wobble = 0.03
    records = read_records([wobbling(tmp_path / "hidden.csv", "stairs of 2 s", (wobble, 60.0))])
    result = identify_bench(records)
    assert result.is_explained
    assert any("ms apart, by more than noise: a clock that wobbles" in note for note in result.notes)
    assert holds(result)
    low, high = result.chosen.delay_bounds
    assert 0.05 < high - low < 0.15
    engine = fit_engine(records, GreyChoices("fitted", ("gain", "lag"), {"gain": 90.0, "offset": 5.0, "lag": 0.5}))
    assert any("ms apart, by more than noise: a clock that wobbles" in note for note in engine.notes)
    assert abs(engine.values[0] - TRUTH.delay) <= 1.96 * engine.deviations[0]
    assert 0.8 * wobble / np.sqrt(2.0) <= engine.deviations[0] <= 1.5 * wobble


def test_what_is_large_and_as_slow_as_the_answer_is_no_noise(tmp_path: Path) -> None:
    """A second to and fro: noise that remembers itself for 10 s would explain all, with a gain of 60 for 100."""
    result = identify_bench(read_records([wobbling(tmp_path / "hidden.csv", "stairs of 5 s", (1.0, 60.0))]))
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
