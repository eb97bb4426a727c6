"""A model out of a log: the truth where it is known, and a refusal where a log does not tell (docs/identification.md)."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from identification_record import SHARED
from known_logs import Flaws, Log, Truth, closed_loops, drawn
from scipy.signal import lfilter

from cosim import Scenario, fly
from cosim.base.errors import InputError, NotIdentifiedError
from hexjet_identify.fit.forms import Poles
from hexjet_identify.fit.problem import noise_basis
from hexjet_identify.logs import Channel, FlightLog, LogSignals, read_flight_log, signals_of
from hexjet_identify.prediction_error.identify_log import LogIdentification, _test_against, identify_log
from hexjet_identify.prediction_error.stretches import WORKING_STEP_S
from hexjet_identify.prediction_error.validate import StatedModel, read_model, validate

DATA = Path(__file__).parents[4] / "shared" / "data" / "flight-logs"
ENGINES = Path(__file__).parents[3] / "engines"
WANTED = LogSignals("u", "y", "r")
TRUTH = Truth()


def flight_log(log: Log, **changed: np.ndarray) -> FlightLog:
    """As it is read, or with some of its times, command and output as stated."""
    log = replace(log, **changed)
    signals = {"u": log.command, "y": log.output, "r": log.setpoint}
    return FlightLog(Path("known.csv"), "table", {name: Channel(log.times, each) for name, each in signals.items()})


def found(log: FlightLog, **choices: object) -> LogIdentification:
    return identify_log(log, "roll", WANTED, **choices)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def logs() -> list[Log]:
    return closed_loops(2, seconds=14.0, size=0.5)


def test_a_closed_loop_with_noise_jitter_and_lost_rows_gives_the_truth(logs: list[Log]) -> None:
    """Delay, gain and the sum of delay and lag within four standard deviations each; fewer would fail by chance."""
    chosen = found(flight_log(logs[0]), lags=1).chosen
    delay = TRUTH.delay_samples * TRUTH.step
    told = ((chosen.delay, chosen.deviation(0)), chosen.gain, chosen.total)
    for (value, deviation), true in zip(told, (delay, TRUTH.gain, delay + TRUTH.lags[0]), strict=True):
        assert abs(value - true) < 4.0 * deviation
    assert chosen.deviation(0) < TRUTH.step
    assert chosen.delay_bounds[0] < chosen.delay < chosen.delay_bounds[1]


def test_without_noise_the_truth_comes_out() -> None:
    """Exactly but for what the solution of the known loop itself is off, a fifth of a sample squared."""
    (log,) = closed_loops(1, seconds=8.0, size=0.5, flaws=Flaws(1e-7, 1e-6, 0.5, 0.0, 0.0, 0.0))
    chosen = found(flight_log(log), lags=1).chosen
    assert chosen.delay / TRUTH.step == pytest.approx(TRUTH.delay_samples, abs=0.02)
    assert chosen.x[2] == pytest.approx(TRUTH.lags[0], rel=0.01)
    assert chosen.gain[0] == pytest.approx(TRUTH.gain, rel=0.01)


def test_an_own_flights_engine_comes_out_of_its_run_and_its_ulog(hexjet: Hexjet, tmp_path: Path) -> None:
    """The thrust has no noise, so the pole too comes out as engines/edf-as-flown states it; the ULog is in microseconds
    and floats, from which a hundredth of a sample is asked.
    """
    assert hexjet("fly", "roll-doublet", "--set", "duration_s=4.5", "--out", "flown").status in (0, 1)
    assert hexjet("export", "flown", "--to", "ulog", "--out", "flown.ulg").status == 0
    stated = tomllib.loads((ENGINES / "edf-as-flown" / "engine.toml").read_text(encoding="utf-8"))["variables"]
    assert hexjet("export", "flown", "--to", "csv", "--out", "flown.csv").status == 0
    for name, near in (("flown", 1e-6), ("flown.csv", 1e-6), ("flown.ulg", 0.01)):
        log = read_flight_log(tmp_path / name)
        result = identify_log(log, "engine:1", signals_of(log, "engine:1"), longest_delay=0.2, lags=0)
        model = result.model(0.004)
        assert model.delay_samples == pytest.approx(stated["delay_samples"]["start"], abs=near)
        assert np.exp(-0.004 * result.chosen.x[1]) == pytest.approx(stated["pole"]["start"], abs=1e-3 * near)
        assert any("the log has no noise" in note for note in result.notes) == (name != "flown.ulg")


def test_an_own_flights_delay_and_lags_together_are_the_ledgers(tmp_path: Path) -> None:
    """A filter that runs once a step delays low frequencies as the ledger states, and spreads a step as a shorter lag
    does: of the sum a fit gives up to a fifth of a sample less to lags, and more to the delay.
    """
    late = {"sensors": {"gyro": {"latency_samples": 5}}}
    flown = fly(Scenario.load("yaw-doublet").replace(expect=[], sensor_noise=False, vehicle=late), tmp_path / "run")
    rows, log = [row for row in flown.summary.delay_ledger if row.axis == "yaw"], read_flight_log(tmp_path / "run")
    total, lags = sum(row.samples for row in rows) - 0.5, sum(row.samples for row in rows if row.kind == "lag")
    found = identify_log(log, "yaw", signals_of(log, "yaw"), longest_delay=0.3, lags=2).chosen
    assert found.total[0] / 0.004 == pytest.approx(total, abs=0.04)
    assert 0.1 < found.delay / 0.004 - (total - lags) < 0.2


def test_a_form_that_leaves_the_command_in_what_is_left_over_is_refused() -> None:
    """An echo of the thrust, which no lag makes; without it the same log passes."""
    truth = Truth(gain=46.03, rate=1.0 / 0.3286, lags=())
    flaws = Flaws(0.01, 0.0, jitter=0.0, lost=0.0)
    (log,) = closed_loops(1, 6.0, truth=truth, flaws=flaws, size=0.0, sweep=0.2, loop=False)
    late = 40
    for echo in (0.0, 0.3):
        output = log.output - echo * np.concatenate([np.zeros(late), log.output[:-late]])
        flight = flight_log(log, output=output)
        if echo:
            with pytest.raises(NotIdentifiedError, match=r"no model of this form fits: \d+ % of what is left over"):
                identify_log(flight, "engine:1", LogSignals("u", "y"), longest_delay=0.3, lags=0)
        else:
            identify_log(flight, "engine:1", LogSignals("u", "y"), longest_delay=0.3, lags=0)


@pytest.mark.long
def test_weak_doublets_in_turbulence_are_refused_for_the_disturbance_and_stronger_ones_answered() -> None:
    """The form is the truth: what is left over follows the command because the loop feeds the disturbance back.

    The manoeuvre that the refusal asks for is enough.
    """
    truth = Truth(gain=300.0, rate=0.5, lags=(0.05,), delay_samples=20.0)
    flaws = Flaws(gyro=0.01, turbulence=0.25, jitter=0.0, lost=0.0)

    def flown(size: float) -> list[Log]:
        return closed_loops(2, 20.0, 5, truth, flaws, p=0.015, attitude=1.2, size=size)

    signals = LogSignals("u", "y", "r")
    for log in flown(0.12):
        with pytest.raises(InputError, match="the disturbance is too large beside what the command does") as refused:
            identify_log(flight_log(log), "roll", signals, longest_delay=0.3)
        assert "lags" not in str(refused.value)
        asked = re.search(r"about (\d+) times as large", str(refused.value))
        assert asked
        assert int(asked.group(1)) == 2
    for log in flown(0.27):
        low, high = identify_log(flight_log(log), "roll", signals, longest_delay=0.3).delay_bounds
        assert low < 0.08 < high


@pytest.mark.long
def test_noise_that_the_controller_feeds_back_at_once_is_no_misfit() -> None:
    """The form is the truth and the manoeuvre is strong: what the controller makes of a sample's noise in that very
    step is in command and residual alike, and was taken for a form that does not fit.
    """
    rng = np.random.default_rng(0)
    truths, p, attitude = drawn(4, 14)
    logs = closed_loops(4, 14.0, 14, truths, Flaws(0.01, 0.02, jitter=0.0, lost=0.0), p, attitude, size=0.5)
    for log, truth in zip(logs, truths, strict=True):
        low, high = identify_log(flight_log(log), "roll", LogSignals("u", "y", "r")).delay_bounds
        assert low <= truth.delay_samples * truth.step <= high
    # and a command that holds nothing but fed-back noise has it at its own time, not before
    noise = rng.standard_normal(4000)
    command = 0.1 * rng.standard_normal(4000) - noise
    together, before = (_test_against("", noise, np.ones(4000, bool), command, 0.01, first) for first in (0, 1))
    assert together.failed
    assert together.share > 0.9
    assert not before.failed


def test_the_noises_model_is_as_long_as_delay_and_lags_and_the_gains_bounds_hold() -> None:
    """In rough air the command carries the noise of that long before; a shorter model gave it to the gain, which was
    2.23 standard deviations off here.
    """
    truths, p, attitude = drawn(10, 1)
    flaws = Flaws(0.01, 0.05, jitter=0.0, lost=0.0)
    log, truth = closed_loops(10, 14.0, 1, truths, flaws, p, attitude, size=0.5)[1], truths[1]
    chosen = found(flight_log(log), longest_delay=0.3).chosen
    order, (gain, deviation) = len(chosen.noise), chosen.gain
    assert order * WORKING_STEP_S >= 0.98 * chosen.total[0]
    assert abs(gain - truth.gain) < 1.96 * deviation
    covered = noise_basis(order)
    assert np.linalg.matrix_rank(covered) == covered.shape[1] < len(covered) == order


def test_a_slow_pole_at_its_end_leaves_the_gain_its_bounds() -> None:
    """Of an integrator the pole ends at 0: held there the gain looked surer than it is."""
    (log,) = closed_loops(1, 14.0, 2, Truth(rate=0.0), Flaws(jitter=0.0, lost=0.0), size=0.5)
    chosen = identify_log(flight_log(log), "roll", LogSignals("u", "y"), lags=1).chosen
    assert chosen.x[1] < 0.05
    assert chosen.deviation(1) > 0.0


def test_a_file_becomes_a_model_that_flies(hexjet: Hexjet, tmp_path: Path, logs: list[Log]) -> None:
    log = logs[1]
    rows = np.column_stack([1e3 * log.times, log.command, log.output, log.setpoint])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="ms,u,y,r", comments="")
    arguments = ["--axis", "roll", "--time", "ms", "--time-unit", "ms", "--command", "u", "--output", "y"]
    done = hexjet("identify", "log", "log.csv", *arguments, "--setpoint", "r", "--lags", "1", "--out", "model")
    assert done.status == 0
    assert "delay, ms" in done.out
    assert (tmp_path / "model" / "report.html").stat().st_size > 100_000
    flown = hexjet("fly", "hover", "--set", "duration_s=0.1", "--model", "model/model.toml", "--out", "flown")
    assert flown.status == 0


def test_the_bounds_allow_for_a_command_that_is_logged_more_seldom_than_it_moves(logs: list[Log]) -> None:
    """One row of five: the delay comes out half of 20 ms short, and its bounds alone would not hold the truth."""
    log = logs[0]
    seldom = flight_log(log)
    seldom.channels["u"] = Channel(log.times[::5], log.command[::5])
    result = found(seldom, lags=1)
    true, (low, high) = TRUTH.delay_samples * TRUTH.step, result.delay_bounds
    assert high - 0.02 < true < high
    assert low < result.chosen.delay < true
    total, deviation = result.chosen.total
    assert abs(total - true - TRUTH.lags[0]) < 1.96 * deviation
    assert any("has a row every 20 ms" in note and "their bounds allow for it" in note for note in result.notes)
    assert not any("has a row every" in note for note in found(flight_log(log), lags=1).notes)
    x = np.array([true, result.chosen.x[1], TRUTH.lags[0]])
    stated = StatedModel(Path("known"), "roll", WANTED, Poles(False, 1), x, result.chosen.gain[0])
    beside = validate(stated, seldom)
    assert abs(beside.again.delay) < beside.again.delay_half
    assert beside.judgement.verdict == "explained"


def refusal(log: FlightLog, **choices: object) -> str:
    with pytest.raises(InputError) as error:
        found(log, **choices)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_log_that_does_not_tell_is_refused(logs: list[Log]) -> None:
    log = logs[0]
    noise = np.random.default_rng(1).standard_normal(len(log.times))
    still = np.zeros(len(log.times))
    assert "the command never changes" in refusal(flight_log(log, command=still))
    assert "does not show the command" in refusal(flight_log(log, output=noise))
    assert "no stretch that can be used" in refusal(flight_log(log), begin=3.0, end=5.0)
    assert "have no time in common" in refusal(flight_log(log), begin=100.0)
    assert "a sample every 4e+03 s" in refusal(flight_log(log, times=1e6 * log.times))  # us that were ms
    assert "values that are numbers" in refusal(flight_log(log, output=still + np.nan))


def test_bounds_above_the_value_are_refused() -> None:
    """An engine of 3.3 s that is pushed up and down within 0.4 s: in noise its gain at rest is anybody's guess."""
    times = 0.004 * np.arange(1150)
    up_and_down = np.where(times < 0.2, 0.0, np.where((2.5 * times).astype(int) % 2, -1.0, 1.0))
    pole = np.exp(-0.004 / 3.3)
    thrust = lfilter([1.0 - pole], [1.0, -pole], np.concatenate([np.zeros(21), up_and_down])[: len(times)])
    noise = np.random.default_rng(0).standard_normal(len(times))
    for size, told in ((0.11, False), (0.003, True)):
        log = Log(times, up_and_down, thrust + size * noise, up_and_down)
        arguments = (flight_log(log), "engine:1", LogSignals("u", "y"))
        if told:
            chosen = identify_log(*arguments, longest_delay=0.12, lags=0).chosen
            assert abs(chosen.gain[0] - 1.0) < 3.0 * chosen.gain[1] < 1.0
        else:
            with pytest.raises(NotIdentifiedError, match=r"does not tell the gain.*: the 95 % bounds exceed the value"):
                identify_log(*arguments, longest_delay=0.12, lags=0)


def test_what_is_wrong_with_a_log_is_said(logs: list[Log]) -> None:
    log = logs[0]
    output, times = log.output.copy(), log.times.copy()
    output[100:103] = np.nan
    times[3000:] -= 5.0
    notes = " ".join(found(flight_log(log, output=output, times=times), lags=1).notes)
    assert "3 of " in notes
    assert "its clock goes back 1 times" in notes


def test_a_model_is_laid_beside_another_flight(hexjet: Hexjet, tmp_path: Path, logs: list[Log]) -> None:
    for n, log in enumerate(logs):
        rows = np.column_stack([log.times, log.command, log.output])
        np.savetxt(tmp_path / f"{n}.csv", rows, delimiter=",", header="t,u,y", comments="")
    told = ["--command", "u", "--output", "y", "--lags", "1"]
    assert hexjet("identify", "log", "0.csv", "--axis", "roll", *told, "--out", "model").status == 0
    done = hexjet("replay", "1.csv", "--model", "model", "--out", "beside", "--json")
    assert done.status == 0
    told_by = json.loads(done.out)
    assert told_by["fit_of_changes"] > 0.5
    assert 0.0 <= told_by["theil_u"] < 0.5
    assert told_by.keys() >= SHARED
    assert told_by["verdict"] == "explained"
    assert abs(told_by["gain_fitted_anew"] - 1.0) < 0.1
    assert abs(told_by["delay_fitted_anew_by_s"]) < told_by["delay_fitted_anew_bound_95_s"] + TRUTH.step
    assert (tmp_path / "beside" / "report.html").stat().st_size > 100_000
    stated, written = (read_model(tmp_path / "model" / name) for name in ("identification.json", "model.toml"))
    assert written.what == stated.what == "roll"
    assert written.x == pytest.approx(stated.x, rel=1e-9)
    assert written.gain == pytest.approx(stated.gain, rel=1e-9)
    text = (tmp_path / "model" / "model.toml").read_text(encoding="utf-8")
    (tmp_path / "other.toml").write_text(re.sub(r"zeros = \[[^]]*\]", "zeros = [-1.4538]", text), encoding="utf-8")
    for name, axis, said in (("model/model.toml", "yaw", "0 models of yaw"), ("other.toml", "roll", "no held model")):
        with pytest.raises(InputError, match=said):
            read_model(tmp_path / name, axis)
    other = replace(stated, gain=1.3 * stated.gain, signals=LogSignals("u", "y"))
    wrong = validate(other, flight_log(logs[1]))
    assert wrong.judgement.verdict == "not explained"
    assert wrong.again.gain == pytest.approx(told_by["gain_fitted_anew"] / 1.3, rel=0.01)
    assert wrong.refused
    assert wrong.to_dict()["found"] is False
    refused = hexjet("replay", "0.csv", "--model", "1.csv")
    assert refused.status == 2
    assert "1.csv: not JSON" in refused.err


@pytest.mark.long
def test_two_real_flights_of_one_vehicle_predict_each_other() -> None:
    """Motors squared to specific force: all agrees within its bounds, either model predicts the other's flight, as
    the page says.
    """
    if not DATA.is_dir():
        pytest.skip("the shared flight logs are not here")
    read = [read_flight_log(DATA / f"crazyflie-log{n}.cfusdlog") for n in (10, 16)]
    both = [identify_log(each, "engine:1", signals_of(each, "engine:1"), longest_delay=0.1, lags=0) for each in read]
    delays = [each.chosen.delay_bounds for each in both]
    gains, lags, sums = [], [], []
    for chosen in (each.chosen for each in both):
        lag = 1.0 / chosen.x[1]
        numbers = (chosen.gain, (lag, chosen.deviation(1) * lag**2), chosen.total)
        for ends, (value, one) in zip((gains, lags, sums), numbers, strict=True):
            ends.append((value - 1.96 * one, value + 1.96 * one))
    for (a, b), (c, d) in (delays, gains, lags, sums):
        assert max(a, c) <= min(b, d)
    page = (Path(__file__).parents[3] / "docs" / "identification.md").read_text(encoding="utf-8")
    for name, pairs, unit, form in (
        ("delay, ms", delays, 1e3, ".1f"), ("gain, 1e-10 g a count squared", gains, 1e10, ".3f"), ("lag, ms", lags, 1e3, ".0f"),
        ("delay and lag together, ms", sums, 1e3, ".1f"),
    ):  # fmt: skip
        cells = [" to ".join(format(unit * end, form) for end in pair) for pair in pairs]
        assert f"| {name} | {cells[0]} | {cells[1]} |" in page
    for model, other in ((both[0], read[1]), (both[1], read[0])):
        chosen = model.chosen
        stated = StatedModel(Path("model"), "engine:1", model.signals, Poles(True, 0), chosen.x, chosen.gain[0])
        assert validate(stated, other).fit > 0.75


@pytest.mark.long
def test_forty_logs_hold_the_truth_as_often_as_they_say() -> None:
    """Of 40 intervals of 95 % fewer than 34 hold the truth once in 300 (binomial); the page has more logs."""
    rows = []
    for batch in range(4):
        truth = Truth(lags=(0.0299, 0.009))
        for log in closed_loops(10, 14.0, seed=100 + batch, truth=truth, size=0.5, sweep=0.006):
            low, high = found(flight_log(log), longest_delay=0.3).delay_bounds
            rows.append(low <= truth.delay_samples * truth.step <= high)
    assert sum(rows) >= 34
