"""Engines that are no lag: the truth within the bounds, or a refusal, and never a narrow wrong number (docs/bench.md)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from known_benches import Truth, bench_log

from hexjet_identify.bench import BenchIdentification, identify_bench, read_records
from hexjet_identify.bench.beyond_lags import fit_beyond_lags
from hexjet_identify.bench.evidence import describe_lack
from hexjet_identify.bench.fit import Part

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


def test_limits_of_acceleration_come_out(tmp_path: Path) -> None:
    """Within three standard deviations each."""
    known = {"delay_s": 0.1, "gain": 100.0, "lag": 0.2, "rise": 0.3, "fall": 0.2}
    fitted = fit_beyond_lags(found(tmp_path, "stairs of 5 s", SLEWING), 2.0)
    assert fitted is not None
    values = dict(zip(fitted.names, zip(fitted.values, fitted.deviations, strict=True), strict=True))
    assert set(values) == {*known, "offset"}
    for name, true in known.items():
        value, deviation = values[name]
        assert abs(value - true) < 3.0 * deviation
        assert deviation < 0.1 * true


def test_a_lag_by_the_thrust_is_not_explained_by_a_staircase(tmp_path: Path) -> None:
    result = found(tmp_path, "stairs of 5 s", LEVELS)
    assert not result.is_explained
    assert any("lag and gain that change with the level" in note for note in result.notes)
    assert fit_beyond_lags(result, 2.0) is None


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


def test_the_command_leaves_such_an_engine(hexjet: Hexjet, tmp_path: Path) -> None:
    from cosim.engine import load_engine

    log(tmp_path, "stairs of 5 s", SLEWING)
    done = hexjet("identify", "bench", str(tmp_path / "bench.csv"), "--out", str(tmp_path / "mine"))
    assert done.status == 0
    engine = load_engine(str(tmp_path / "mine" / "engine.toml"), {}, 0.004)
    assert engine.parameters["rise"] == pytest.approx(0.3, abs=0.02)
    assert engine.uncertainty is not None
    assert "rise" in engine.uncertainty.parameters
