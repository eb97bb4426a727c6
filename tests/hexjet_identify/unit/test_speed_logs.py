"""Logs of an engine's speed: columns called otherwise, a set-point that is not followed, a log that begins in motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.engine import load_engine
from cosim.engine.fmu.uncertainty import Uncertainty
from hexjet_identify.bench.evidence import Misfit
from hexjet_identify.bench.fit import Part
from hexjet_identify.bench.grey_box import NOT_AT_REST, GreyChoices, GreyIdentification, describe_beginning
from hexjet_identify.bench.grey_box_result import engine_table
from hexjet_identify.bench.record import BenchRecord, Columns, read_records
from hexjet_identify.logs.flight_log import unit_of

ROW_S = 0.1
LAG_S = 2.0


def governed(seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Off for 10 s, a start of 30 s, then steps of 40 s each between 33 and 100 krpm with a lag."""
    times = np.arange(0.0, seconds, ROW_S)
    levels = np.array([33e3, 60e3, 100e3, 60e3, 33e3])
    running = levels[np.clip(((times - 40.0) // 40.0).astype(int), 0, len(levels) - 1)]
    asked = np.where(times < 10.0, 0.0, np.where(times < 40.0, 31e3, running))
    speed = np.interp(times, [10.0, 36.0, 60.0], [0.0, 33e3, 33e3])
    for k in range(1, len(times)):
        if times[k] >= 40.0:
            speed[k] = speed[k - 1] + ROW_S / LAG_S * (asked[k] - speed[k - 1])
    noise = 20.0 * np.random.default_rng(3).standard_normal(len(times))
    return times, asked, np.where(times < 10.0, 0.0, speed + noise)


def write(path: Path, head: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=head, comments="")
    return path


@pytest.mark.parametrize(
    ("name", "in_brackets", "unit"),
    [
        ("RPM (actual)", "actual", "rpm"), ("RPM (setpoint %)", "setpoint %", "percent"), ("n [RPM]", "RPM", "rpm"),
        ("RPM", "", "rpm"), ("Rotor RPM", "", "rpm"), ("n [1/min]", "1/min", "rpm"), ("n (kRPM)", "kRPM", "krpm"),
        ("thrust_N (filtered)", "filtered", "N"), ("F [N]", "N", "N"), ("fan N", "", ""), ("t_us", "", "us"),
    ],
)  # fmt: skip
def test_a_unit_is_told_from_a_word_that_says_which(name: str, in_brackets: str, unit: str) -> None:
    assert unit_of(name, in_brackets) == unit


def test_a_start_is_left_out_of_a_log_that_has_its_speed_in_percent_too(tmp_path: Path) -> None:
    times, asked, speed = governed(240.0)
    head = "time,RPM (setpoint),RPM (setpoint %),RPM (actual),RPM (actual %)"
    path = write(tmp_path / "ecu.csv", head, times, asked, asked / 1e3, speed, speed / 1e3)
    (record,) = read_records([path], Columns("RPM (setpoint)", "RPM (actual)"))
    assert (record.command_unit, record.output_unit) == ("rpm", "rpm")
    assert 36.0 <= record.times[0] < 42.0
    assert any(note.startswith("off, start or stop of the engine: 0.0 to ") for note in record.notes)


@pytest.mark.parametrize(
    ("begin", "words"),
    [
        (None, ""),
        (120.0, "rpm does not come to setpoint_rpm, which has long stood: 119.9 to 159.9 s, at its end 30000 rpm off"),
        (150.0, "rpm does not come to setpoint_rpm, which has long stood: 149.9 to 159.9 s, at its end 30000 rpm off"),
        (159.6, ""),  # a few wrong frames
    ],
)
def test_a_speed_that_its_fuel_does_not_let_follow_is_said_with_its_seconds(
    tmp_path: Path, begin: float | None, words: str
) -> None:
    """Starved on the way to 100 krpm: it hangs at 70; where it follows, or not for long, nothing is said."""
    times, asked, speed = governed(240.0)
    if begin is not None:
        held = (times >= begin) & (times < min(begin + 40.0, 160.0))
        speed[held] -= np.maximum(speed[held] - 70e3, 0.0)
    (record,) = read_records([write(tmp_path / "run.csv", "time_s,setpoint_rpm,rpm", times, asked, speed)])
    (*said,) = (note for note in record.notes if "does not come to" in note)
    assert len(said) == (1 if words else 0)
    assert all(one.startswith(words) for one in said)


def test_a_log_that_begins_on_its_way_is_named() -> None:
    times = np.arange(0.0, 10.0, ROW_S)
    part = Part(times, times, times, times, ROW_S, False)
    record = BenchRecord(Path("cut.csv"), "setpoint_rpm", "rpm", "rpm", "rpm", times, times, times, times, ROW_S, 0.0)
    off = 30.0 * np.exp(-times / LAG_S)
    rest = replace(record, path=Path("rest.csv"))
    (line,) = describe_beginning([rest, record], [part, part], np.concatenate([0.0 * off, off]), 100.0)
    assert line.startswith("cut.csv begins 27 % of the output's range from where the engine rests")
    assert not describe_beginning([record], [part], NOT_AT_REST * off, 100.0)


@pytest.mark.parametrize(
    ("fitted", "kept"),
    [
        (("fuel_integral", "fuel_fall"), ["fuel_response", "fuel_ramp", "pump_time_constant"]),
        (("rotor_inertia",), ["fuel_integral", "fuel_ramp", "fuel_fall", "pump_time_constant"]),
    ],
)
def test_what_is_not_fitted_stays_as_uncertain_as_the_engine_states_it(
    fitted: tuple[str, ...], kept: list[str]
) -> None:
    """Its deviations and the correlation between them; a parameter that is set is known."""
    spec = load_engine("jetcat-p300", {}, 0.004)
    settings = {} if "fuel_integral" in fitted else {"fuel_response": 0.0007}
    count = 1 + len(fitted)
    result = GreyIdentification(
        (BenchRecord(Path("b.csv"), "a", "b", "rpm", "rpm", *np.zeros((4, 2)), ROW_S, 0.0),),
        GreyChoices("jetcat-p300", fitted, settings), spec, np.full(count, 0.1), 1e-4 * np.eye(count), np.zeros(2), (),
        Misfit(False, 1.0, 0.0, 0.0), None, (),
    )  # fmt: skip
    told = Uncertainty.model_validate(engine_table(result)["uncertainty"])
    assert told.parameters == ["delay_samples", *fitted, *kept]
    stated = spec.uncertainty
    assert stated is not None
    rows = [stated.parameters.index(name) for name in kept]
    assert told.deviation[count:] == pytest.approx([stated.deviation[row] for row in rows])
    np.testing.assert_allclose(
        np.array(told.correlations)[count:, count:], np.array(stated.correlations)[np.ix_(rows, rows)], atol=1e-4
    )
    assert not np.any(np.array(told.correlations)[:count, count:])
