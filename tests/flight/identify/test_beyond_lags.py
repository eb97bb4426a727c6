"""Engines that are no lag: the truth within the bounds, or a refusal, and never a narrow wrong number (docs/bench.md)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from known_benches import Truth, bench_log

from cosim.identify.bench import BenchIdentification, identify_bench, read_records
from cosim.identify.bench.beyond_lags import fit_beyond_lags
from cosim.identify.bench.command import make_command
from cosim.identify.bench.evidence import describe_lack
from cosim.identify.bench.fit import Part

LEVELS = Truth(lags=(0.8,), full_lag=0.3)
SLEWING = Truth(lags=(0.2,), slew=(30.0, 20.0))


def log(folder: Path, kind: str, truth: Truth) -> Path:
    times, command, thrust, _ = bench_log(kind, 50.0, truth)
    path = folder / "bench.csv"
    rows = np.column_stack([times, command, thrust])
    np.savetxt(path, rows, "%.9g", ",", header="time_s,throttle,thrust_N", comments="")
    return path


def found(folder: Path, kind: str, truth: Truth) -> BenchIdentification:
    return identify_bench(read_records([log(folder, kind, truth)]))


@pytest.mark.parametrize(
    ("kind", "truth", "known"),
    [
        pytest.param(
            "chirp", LEVELS, {"delay_s": 0.1, "gain": 100.0, "lag": 0.8, "lag_full": 0.3}, marks=pytest.mark.long
        ),
        ("stairs of 5 s", SLEWING, {"delay_s": 0.1, "gain": 100.0, "lag": 0.2, "rise": 0.3, "fall": 0.2}),
    ],
)
def test_a_lag_by_the_thrust_and_limits_of_acceleration_come_out(
    tmp_path: Path, kind: str, truth: Truth, known: dict[str, float]
) -> None:
    """Within three standard deviations each; the other form of the two is not taken.

    The chirp's lags leave less than is refused, and more than chance.
    """
    fitted = fit_beyond_lags(found(tmp_path, kind, truth), 2.0)
    assert fitted is not None
    values = dict(zip(fitted.names, zip(fitted.values, fitted.deviations, strict=True), strict=True))
    assert set(values) == {*known, "offset"}
    for name, true in known.items():
        value, deviation = values[name]
        assert abs(value - true) < 3.0 * deviation
        assert deviation < 0.1 * true


def test_a_staircase_tells_a_lag_by_the_thrust(tmp_path: Path) -> None:
    result = found(tmp_path, "stairs of 5 s", LEVELS)
    chosen = result.chosen
    assert result.is_explained
    assert chosen.form.label == "delay and a lag by the level"
    for i, true in enumerate((0.1, 0.8, 0.3)):
        assert abs(chosen.x[i] - true) < 3.0 * chosen.deviation(i)
        assert chosen.deviation(i) < 0.05 * true
    assert chosen.delay_bounds[0] <= 0.1 <= chosen.delay_bounds[1]
    assert chosen.total[0] == pytest.approx(0.1 + 0.55, abs=4.0 * chosen.total[1])


def test_a_lag_by_the_level_is_solved_and_averaged_exactly() -> None:
    """Of ``(a + b y) y' = u - y`` the left side of ``a y + b y^2 / 2 = integral of u - y`` has to come out, and means."""
    times, values = np.arange(0.0, 10.0, 0.5), np.random.default_rng(0).random(20)
    command, (a, full) = make_command(times, values, False), (0.8, 0.2)
    at = np.linspace(-1.0, 12.0, 400)
    answer = command.lagged_by_level((a, full), at)
    missing = command.lagged_by_level_means((a, full), np.full(399, at[0]), at[1:]) * (at[1:] - at[0])
    asked = command.lagged_means(1e-9, np.full(399, at[0]), at[1:]) * (at[1:] - at[0])
    momentum = a * answer + 0.5 * (full - a) * answer**2
    np.testing.assert_allclose(asked - missing, momentum[1:] - momentum[0], atol=1e-7)
    np.testing.assert_allclose(command.lagged_by_level((0.4, 0.4), at), command.lagged(0.4, at), atol=1e-6)
    fine = np.linspace(2.9, 3.2, 3001)
    each = command.lagged_by_level((a, full), fine)
    mean = command.lagged_by_level_means((a, full), np.array([2.9]), np.array([3.2]))
    assert mean[0] == pytest.approx(np.mean(0.5 * (each[1:] + each[:-1])), abs=1e-7)


@pytest.mark.parametrize("rate", [5.0, 50.0])
def test_a_single_step_does_not_tell_a_lag_by_the_thrust_from_two_and_its_bounds_know(
    tmp_path: Path, rate: float
) -> None:
    """The delay of two lags alone is too short; no narrow wrong one is given, and what to do next is said."""
    for seed in range(3):
        times, command, thrust, _ = bench_log("step", rate, LEVELS, seed)
        rows = np.column_stack([times, command, thrust])
        np.savetxt(tmp_path / "step.csv", rows, "%.9g", ",", header="time_s,throttle,thrust_N", comments="")
        result = identify_bench(read_records([tmp_path / "step.csv"]))
        low, high = result.chosen.delay_bounds
        assert low <= 0.1 <= high
        assert not result.chosen.form.by_level
        assert any("whether gain and lag are the same at all levels" in line for line in result.untold)


def test_what_a_model_lacks_is_said_by_direction_level_and_side() -> None:
    """A ramp up to 100 and one down, and a rest: the engine is 2 ahead of the model on the lower half of the way up."""
    times = np.linspace(0.0, 30.0, 3001)
    model = np.interp(times, [0.0, 10.0, 20.0, 30.0], [0.0, 100.0, 0.0, 0.0])
    residual = np.where((times < 5.0) & (times > 0.0), 2.0, 0.0)
    part = Part(times, model / 100.0, times, model + residual, 0.01, True)
    assert describe_lack([part], residual).endswith(
        "on the way up in the lower half of the range the engine is ahead of the model by 2 % of the range in the mean, "
        "2 % rms (100 %)"
    )
    down = np.where((times > 10.0) & (times < 15.0), 2.0, 0.0)
    words = describe_lack([replace(part, output=model + down)], down)
    assert "on the way down in the upper half of the range the engine is behind the model by 2 %" in words
    rest = np.where(times > 20.0, 3.0 * np.sign(np.sin(20.0 * times)), 0.0)
    words = describe_lack([replace(part, output=model + rest)], rest)
    assert "while the model stands still the engine is off by 2.9 % of the range, rms (100 %)" in words


@pytest.mark.long
def test_a_dead_band_is_refused(tmp_path: Path) -> None:
    result = found(tmp_path, "chirp", Truth(dead_band=0.04))
    assert not result.is_explained
    assert fit_beyond_lags(result, 2.0) is None


def test_a_single_step_does_not_tell_limits_and_no_engine_is_left(tmp_path: Path) -> None:
    result = found(tmp_path, "step", SLEWING)
    assert not result.is_explained
    assert any("what the model lacks" in note and "on the way up" in note for note in result.notes)
    assert fit_beyond_lags(result, 2.0) is None


def test_an_ecu_that_reads_ten_times_a_second_is_a_longer_delay(tmp_path: Path) -> None:
    """The time from a step to its reading, 70 ms here, is in the delay; a chirp shows the mean of all, half an interval."""
    stairs = found(tmp_path, "stairs of 5 s", Truth(interval=0.1))
    assert stairs.is_explained
    assert stairs.chosen.delay_bounds[0] <= 0.17 <= stairs.chosen.delay_bounds[1]
    value, deviation = found(tmp_path, "chirp", Truth(interval=0.1)).chosen.total
    assert abs(value - 0.55) < 4.0 * deviation


def test_the_command_leaves_such_an_engine(hexjet: Hexjet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from cosim.engine import load_engine

    monkeypatch.setenv("COLUMNS", "120")  # on a narrower terminal the table breaks its names into lines
    log(tmp_path, "stairs of 5 s", LEVELS)
    done = hexjet("identify", "bench", str(tmp_path / "bench.csv"), "--out", str(tmp_path / "mine"))
    assert done.status == 0
    assert "lag at full throttle, ms" in done.out
    engine = load_engine(str(tmp_path / "mine" / "engine.toml"), {}, 0.004)
    assert engine.parameters["lag_full"] == pytest.approx(0.3, abs=0.02)
    assert engine.uncertainty is not None
    assert "lag_full" in engine.uncertainty.parameters
