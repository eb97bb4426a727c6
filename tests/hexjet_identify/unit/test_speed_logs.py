"""Logs of an engine's speed: columns called otherwise, and what an engine keeps of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.engine.fmu.uncertainty import Uncertainty
from hexjet_identify.bench.engine_form import EngineChoices, make_form
from hexjet_identify.bench.engine_table import own_engine_table
from hexjet_identify.bench.identification import Identification
from hexjet_identify.bench.identify import as_log, make_problem
from hexjet_identify.bench.record import BenchRecord, Columns, read_records
from hexjet_identify.fit.estimate import Estimate
from hexjet_identify.fit.evidence import Verdict
from hexjet_identify.logs.flight_log import unit_of

ROW_S = 0.1


def governed() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Off for 10 s, a start of 26 s, and a step from 33 to 60 krpm at 80 s."""
    times = np.arange(0.0, 120.0, ROW_S)
    asked = np.select([times < 10.0, times < 80.0], [0.0, 33e3], 60e3)
    return times, asked, np.interp(times, [10.0, 36.0, 80.0, 86.0], [0.0, 33e3, 33e3, 60e3])


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
    times, asked, speed = governed()
    head = "time,RPM (setpoint),RPM (setpoint %),RPM (actual),RPM (actual %)"
    path = write(tmp_path / "ecu.csv", head, times, asked, asked / 1e3, speed, speed / 1e3)
    (record,) = read_records([path], Columns("RPM (setpoint)", "RPM (actual)"))
    assert (record.command_unit, record.output_unit) == ("rpm", "rpm")
    assert 36.0 <= record.times[0] < 42.0
    assert any(note.startswith("off, start or stop of the engine: 0.0 to ") for note in record.notes)


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
    settings = {} if "fuel_integral" in fitted else {"fuel_response": 0.0007}
    times, count = np.arange(0.0, 10.0, ROW_S), 1 + len(fitted)
    record = BenchRecord(Path("b.csv"), "a", "b", "rpm", "rpm", times, times, times, times, ROW_S, 0.0)
    form = make_form([record], EngineChoices("jetcat-p300", fitted, settings), 2.0)
    problem = make_problem([as_log(record, (0.0, 1.0), False)], 2.0)
    values, residual = np.full(count, 0.1), np.zeros(len(times))
    none, covariance = np.zeros(0), 1e-4 * np.eye(count)
    estimate = Estimate(form, values, none, covariance, residual, none, 1.0, 1, 0.0, count, 1.0, (), (0.08, 0.12))
    found = Identification((record,), problem, (0.0, 1.0), True, (estimate,), 1.0, Verdict(0.0, 0, 0), ())
    told, spec = Uncertainty.model_validate(own_engine_table(found, form)["uncertainty"]), form.spec
    assert told.parameters == ["delay_samples", *fitted, *kept]
    stated = spec.uncertainty
    assert stated is not None
    rows = [stated.parameters.index(name) for name in kept]
    assert told.deviation[count:] == pytest.approx([stated.deviation[row] for row in rows])
    np.testing.assert_allclose(
        np.array(told.correlations)[count:, count:], np.array(stated.correlations)[np.ix_(rows, rows)], atol=1e-4
    )
    assert not np.any(np.array(told.correlations)[:count, count:])
