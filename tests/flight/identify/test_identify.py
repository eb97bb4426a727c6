"""Identification: exact answers on difference equations, other implementations, the shipped engines, the Hex-Jet."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_tools import Hexjet
from engine_tools import BOTH, FAULT_THROTTLE, FAULTS, NEWTON_PER_KGF, PAPER, build_faulty
from identification_record import SHARED
from scipy import signal

from cosim.base.arrays import Array
from cosim.base.errors import InputError, Notice
from cosim.control.predictors.smith import DelayedModel
from cosim.engine import load_engine
from cosim.identify.sweep import (
    Identification,
    Model,
    Record,
    Sweep,
    estimate,
    fit,
    identify_axis,
    identify_engine,
    write,
)
from cosim.identify.sweep import axis as sweeping
from cosim.identify.sweep.fit import point_weights
from cosim.identify.sweep.response import FrequencyResponse
from cosim.identify.sweep.result import (
    MAX_MISFIT,
    equation,
    fit_rows,
    low_frequency_delay,
    note_off_ledger,
    rate_response,
    why_refused,
)
from cosim.simulation.controllers.models import find_models
from cosim.simulation.script.command_script import make_sweep
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import RateModel, load_vehicle, read_models
from hexjet_identify.prediction_error.validate import read_model

STEP = 0.004

# The paper's roll response as the zero-order-hold model it equals: 433.1 / ((s + 0.025) (0.03895 s + 1)), 25 samples
# and another 0.41 ms.
PAPER_ROLL = Model(433.1, 0.025, (0.03895,), 25.0 + 0.41e-3 / STEP, STEP)
PAPER_G = RateModel(
    gain=0.0689, zeros=[-1.4538], poles=[0.9999, 0.9024], delay_samples=25.0, sample_time_s=STEP, source="paper"
)


def chirp(low: float, high: float, seconds: float, rest: float, amplitude: float = 1.0) -> Array:
    lead, length = 20, round(seconds / STEP)
    wave = make_sweep(STEP, lead, length, amplitude, low, high)
    return np.array([wave(k) for k in range(lead + length + round(rest / STEP))])


def through(model: Model, command: Array) -> Record:
    """A record of the difference equation that the predictors run, from rest."""
    plant = DelayedModel(model.discrete("test"))
    return Record(command, command, np.array([0.0, *(plant.update(u) for u in command[:-1])]), STEP)


# --- models: against scipy, python-control's convention and the predictors' difference equations ---------------------


@pytest.mark.parametrize("lags", [(), (0.0389,), (0.0299, 0.009)], ids=str)
def test_the_discrete_form_is_scipys_zero_order_hold(lags: tuple[float, ...]) -> None:
    model = Model(433.1, 0.025, lags, 7.0, STEP)
    denominator = np.array([1.0, 0.025])
    for lag in lags:
        denominator = np.polymul(denominator, [lag, 1.0])
    over, under, _ = signal.cont2discrete(([433.1], denominator), STEP, "zoh")
    discrete = model.discrete("test")
    # partial fractions of poles that lie close together cost digits: 1e-6 is far below any identification's
    np.testing.assert_allclose(discrete.gain * np.poly(discrete.zeros), np.trim_zeros(over[0], "f"), rtol=1e-6)
    np.testing.assert_allclose(np.poly(discrete.poles), under, rtol=1e-12)
    hertz = np.array([0.1, 1.0, 10.0, 100.0])
    z = np.exp(2j * np.pi * hertz * STEP)
    expected = np.polyval(over[0], z) / np.polyval(under, z) * z**-7
    np.testing.assert_allclose(model.response(hertz), expected, rtol=1e-6)


def test_the_papers_discrete_model_is_the_continuous_one_with_a_fraction_of_a_sample() -> None:
    """What the paper prints, to its four digits, from 0.1 to 10 Hz: two ways of writing one delay."""
    hertz = np.geomspace(0.1, 10.0, 30)
    np.testing.assert_allclose(PAPER_ROLL.response(hertz), rate_response(PAPER_G, hertz), rtol=2e-3)


@pytest.mark.parametrize("delay", [0.0, 3.0, 25.1, 25.5, 25.999])
@pytest.mark.parametrize(("rate", "lags"), [(0.4, (0.03,)), (33.4, ()), (0.1, (0.03, 0.009))], ids=str)
def test_a_swept_difference_equation_comes_back_exactly(delay: float, rate: float, lags: tuple[float, ...]) -> None:
    """The predictors' own equations as the plant, delay whole or not: to 1e-3 of a sample and of a number.

    The record ends 10 time constants after the sweep but for the slow integrators, whose sweep sums to nothing.
    """
    record = through(Model(433.0, rate, lags, delay, STEP), chirp(0.2, 9.0, 80.0, 12.0 / rate if rate < 1.0 else 3.0))
    found = fit(estimate(record, 0.3, 7.0), len(lags), "first")
    found = fit(estimate(record, 0.3, 7.0, found.model.response), len(lags), "second")
    assert found.model.delay_samples == pytest.approx(delay, abs=2e-3)
    assert found.model.gain == pytest.approx(433.0, rel=1e-3)
    assert found.model.rate == pytest.approx(rate, rel=1e-2, abs=1e-3)
    assert sum(found.model.lags) == pytest.approx(sum(lags), rel=2e-3)
    assert found.misfit < 1e-3


def test_a_negative_gain_comes_back_with_its_sign() -> None:
    record = through(Model(-100.0, 5.0, (0.02,), 4.0, STEP), chirp(0.2, 9.0, 80.0, 5.0))
    found = fit(estimate(record, 0.3, 7.0), 1, "one lag")
    assert found.model.gain == pytest.approx(-100.0, rel=1e-3)
    assert found.bounds["gain"][0] <= found.bounds["gain"][1] < 0.0


# --- the response: against scipy's, in noise and in a loop ------------------------------------------------------------


def test_response_and_coherence_are_scipys() -> None:
    """White noise through a lag, with noise on the output: Welch's estimate and ours agree within their scatter."""
    random = np.random.default_rng(5)
    command = np.concatenate([random.standard_normal(100_000), np.zeros(500)])
    clean = signal.lfilter([0.0, 0.2], [1.0, -0.8], command)
    output = clean + 0.2 * np.concatenate([random.standard_normal(100_000), np.zeros(500)])
    ours = estimate(Record(command, command, output, STEP), 2.0, 30.0)
    options = {"fs": 1.0 / STEP, "nperseg": 1024}
    hertz, cross = signal.csd(command, output, **options)
    _, power = signal.welch(command, **options)
    _, coherence = signal.coherence(command, output, **options)
    welch = np.interp(ours.hertz, hertz, cross.real / power) + 1j * np.interp(ours.hertz, hertz, cross.imag / power)
    wide = ours.hertz > 5.0  # above, our groups hold hundreds of bins and both scatter little
    np.testing.assert_allclose(ours.value[wide], welch[wide], rtol=0.15)
    assert np.mean(np.abs(ours.value[wide] / welch[wide] - 1.0)) < 0.05
    assert np.mean(ours.coherence[wide] - np.interp(ours.hertz[wide], hertz, coherence)) == pytest.approx(0.0, abs=0.02)
    # and our own spread is the scatter about the truth
    z = np.exp(2j * np.pi * ours.hertz * STEP)
    off = np.abs(ours.value * (z - 0.8) / 0.2 - 1.0) / ours.spread
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.4


def test_the_spread_of_small_groups_is_the_scatter() -> None:
    """Groups of nine bins, three unknowns each: the square of scatter over spread has the mean of F(2, 12), 1.2.

    Over some 55 groups that is 0.2 either way; with the unknowns not paid for it would be 1.8.
    """
    random = np.random.default_rng(1)
    command = np.concatenate([random.standard_normal(100_000), np.zeros(500)])
    output = signal.lfilter([0.0, 0.2], [1.0, -0.8], command) + np.pad(random.standard_normal(100_000), (0, 500))
    ours = estimate(Record(command, command, output, STEP), 2.0, 3.3)
    z = np.exp(2j * np.pi * ours.hertz * STEP)
    off = np.abs(ours.value - 0.2 / (z - 0.8)) / (ours.spread * np.abs(ours.value))
    assert len(off) > 50
    assert 0.8 < np.mean(off**2) < 1.55
    # what does not answer has no coherence, on the whole
    deaf = estimate(Record(command, command, random.standard_normal(100_500), STEP), 2.0, 3.3)
    assert np.median(deaf.coherence) < 0.2


def test_noise_that_returns_through_the_loop_does_not_bias() -> None:
    """The command carries the fed-back noise; with what was injected as instrument that averages out."""
    random = np.random.default_rng(3)
    injected = chirp(0.5, 14.0, 160.0, 5.0, amplitude=0.2)
    model = Model(20.0, 0.5, (), 5.0, STEP)
    plant, measured = DelayedModel(model.discrete("test")), 0.0
    commands, outputs = [], []
    for push in injected:
        command = push - 0.8 * measured
        commands.append(command)
        outputs.append(measured)
        measured = plant.update(command) + 0.3 * float(random.standard_normal())
    command, output = np.array(commands), np.array(outputs)
    ours = estimate(Record(injected, command, output, STEP), 1.0, 10.0)
    direct = estimate(Record(command, command, output, STEP), 1.0, 10.0)
    truth = model.response(ours.hertz)
    use = ours.hertz > 6.0  # where the noise outweighs the sweep
    assert abs(np.mean(ours.value[use] / truth[use]) - 1.0) < 0.1
    assert abs(np.mean(direct.value[use] / truth[use]) - 1.0) > 0.25


def test_bounds_hold_the_truth_nineteen_times_of_twenty() -> None:
    """With errors as the bounds suppose them.  Of 60 draws 57 are expected; fewer than 51 has a chance of 0.3 %."""
    random = np.random.default_rng(11)
    hertz = np.geomspace(0.3, 6.0, 30)
    truth = PAPER_ROLL.response(hertz)
    one = np.ones(30)
    inside = {"gain": 0, "lag_s": 0, "delay_samples": 0}
    for _ in range(60):
        noise = 0.02 * (random.standard_normal(30) + 1j * random.standard_normal(30))
        found = fit(FrequencyResponse(hertz, truth * np.exp(noise), one, 0.02 * one, STEP), 1, "one lag")
        for name, value in (("gain", 433.1), ("lag_s", 0.03895), ("delay_samples", PAPER_ROLL.delay_samples)):
            low, high = found.bounds[name]
            inside[name] += low <= value <= high
    assert min(inside.values()) >= 51
    assert max(inside.values()) < 60 or sum(inside.values()) < 180  # bounds that never miss are too wide


def test_a_delay_is_not_taken_for_one_that_looks_the_same() -> None:
    """At points a third of a hertz apart a delay of 3 s more has the same phase; a delay below 0 must not become that."""
    hertz = 1.0 + np.arange(16) / 3.0
    early = PAPER_ROLL.response(hertz) * np.exp(2j * np.pi * hertz * STEP * 25.6)
    one = np.ones(16)
    assert fit(FrequencyResponse(hertz, early, one, 0.01 * one, STEP), 1, "one lag").model.delay_samples < 1.0


def test_points_without_coherence_do_not_count() -> None:
    hertz = np.geomspace(0.3, 6.0, 30)
    value = PAPER_ROLL.response(hertz)
    coherence = np.where(hertz > 3.0, 0.3, 1.0)
    value[hertz > 3.0] *= 5.0
    response = FrequencyResponse(hertz, value, coherence, np.zeros(30), STEP)
    assert (point_weights(response)[hertz > 3.0] == 0.0).all()
    assert fit(response, 1, "one lag").model.delay_samples == pytest.approx(PAPER_ROLL.delay_samples, abs=1e-3)


# --- engines ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "fmi"), BOTH)
def test_every_engine_comes_back_as_the_paper_prints_it(name: str, fmi: int) -> None:
    """Far inside the promised 1 %: nothing but rounding stands between the FMU's equation and the fit."""
    gain, pole, delay = PAPER[name]
    found = identify_engine(name if fmi == 3 else f"{name}-fmi2")
    assert found.model.poles == pytest.approx([pole], rel=1e-6)
    assert found.model.gain / NEWTON_PER_KGF == pytest.approx(gain, rel=1e-6)
    assert found.model.delay_samples == delay
    free = found.fits[1]
    assert (free.label, free.model.delay_samples) == ("all free", pytest.approx(delay, abs=1e-4))
    assert found.response.coherence.min() > 0.9999
    assert found.notes == ()


@pytest.mark.parametrize("delay", [1, 7, 60])
def test_a_changed_delay_is_found(delay: int) -> None:
    found = identify_engine("edf-as-flown", {"delay_samples": float(delay)})
    assert found.model.delay_samples == delay
    assert found.model.poles == pytest.approx([PAPER["edf"][1]], rel=1e-6)


def test_another_operating_point_band_and_sample_time() -> None:
    found = identify_engine("edf", step=0.008, throttle=0.3, amplitude=0.05, from_hz=0.8, to_hz=20.0, duration=40.0)
    assert found.model.poles == pytest.approx([PAPER["edf"][1] ** 2], rel=1e-6)  # two internal steps in one
    assert found.sweep.amplitude == 0.05


def test_a_form_that_does_not_follow_the_engine_is_refused() -> None:
    """A turbine whose acceleration is limited is no pole with a delay; a tenth off is the most that is taken."""
    found = identify_engine("turbine-20", duration=60.0, from_hz=0.3, to_hz=7.0)
    assert found.fits[0].misfit > MAX_MISFIT
    assert f"the form is {100 * found.fits[0].misfit:.0f} % off the response, 10 % at most" in found.refused[0]
    assert not why_refused(replace(found.fits[0], misfit=MAX_MISFIT), engine=True)


def response_of(model: Model, low: float, high: float, count: int, noise: float) -> FrequencyResponse:
    """A response without a flight: the model's at these frequencies, with errors of this relative size."""
    random = np.random.default_rng(8)
    hertz, one = np.geomspace(low, high, count), np.ones(count)
    errors = noise * (random.standard_normal(count) + 1j * random.standard_normal(count))
    return FrequencyResponse(hertz, model.response(hertz) * np.exp(errors), one, noise * one, STEP)


def test_bounds_above_the_value_are_refused_and_not_printed(tmp_path: Path) -> None:
    """A lag of 2 s, swept from 5 Hz, is not told from an integrator: no number, no model file, and an old one goes."""
    response = response_of(Model(100.0, 3.0, (2.0,), 10.0, STEP), 5.0, 9.0, 20, 0.05)
    found = fit(response, 1, "1 lag")
    assert max(high - low for low, high in found.bounds.values()) > 1e3  # what was printed as a number before
    axis = replace(AN_AXIS, response=response, fits=(found,))
    (refused,) = axis.refused
    assert "not determined by this sweep" in refused
    cells = {row[0]: row[1] for row in fit_rows(axis)}
    names = ("gain, rad/s^2 per throttle", "lag, ms", "all delay, samples")
    assert [cells[name] for name in names] == ["not determined"] * 3
    (tmp_path / "model.toml").write_text("left by an earlier call")
    (tmp_path / "identification.json").write_text("{}")  # by which it is known as one
    paths = write(axis, tmp_path)
    assert "model" not in paths
    assert not (tmp_path / "model.toml").exists()
    assert json.loads(paths["json"].read_text())["found"] is False
    assert "no model: not determined" in paths["report"].read_text()


def test_a_sum_that_is_not_the_ledgers_is_noted() -> None:
    """By a tenth of the ledger or a sample, whichever is more: the two stand in neighbouring lines."""
    found = fit(response_of(Model(100.0, 0.2, (0.04,), 9.0, STEP), 0.3, 6.0, 30, 0.001), 1, "1 lag")
    total = low_frequency_delay(found)
    assert total == pytest.approx(19.5, abs=0.1)
    assert note_off_ledger(found, total / 1.09, 0.3) == note_off_ledger(found, total + 0.9, 0.3) == []
    assert note_off_ledger(found, None, 0.3) == []
    (said,) = note_off_ledger(found, total / 1.12, 0.3)
    assert said.startswith(f"all delay of the model is {total:.2f} samples, of the delay ledger {total / 1.12:.2f}: ")
    assert "must not be mixed" in said
    refused = fit(response_of(Model(100.0, 3.0, (2.0,), 10.0, STEP), 5.0, 9.0, 20, 0.05), 1, "1 lag")
    assert note_off_ledger(refused, 30.0, 5.0) == []


def test_a_lag_that_is_not_there_is_none() -> None:
    """Of an integrator with a delay the fit makes a lag of microseconds: to seven digits, and it is nothing."""
    response = response_of(Model(1.0, 0.2, (1e-6,), 2.0, STEP), 0.3, 6.0, 30, 0.01)
    axis = replace(AN_AXIS, response=response, fits=(fit(response, 1, "1 lag"),))
    assert axis.refused == []
    assert {row[0]: row[1] for row in fit_rows(axis)}["lag, ms"] == "none"


AN_AXIS = Identification(
    kind="axis",
    subject="one",
    engine="edf",
    channel="roll",
    command_unit="throttle",
    output_unit="rad/s",
    sweep=Sweep(0.3, 6.0, 0.02, 60.0),
    response=response_of(PAPER_ROLL, 0.3, 6.0, 30, 0.0),
    fits=(),
    source="test",
    ledger_samples=None,
    reference=None,
    notes=(),
)


def test_the_printed_form_is_the_papers() -> None:
    turbojet = RateModel(
        gain=0.01866 * NEWTON_PER_KGF, zeros=[], poles=[0.9879], delay_samples=25, sample_time_s=STEP, source=""
    )
    assert equation(turbojet, NEWTON_PER_KGF) == "0.01866 / (z - 0.9879) z^-25"
    assert equation(PAPER_G) == "0.0689 (z + 1.4538) / ((z - 0.9999) (z - 0.9024)) z^-25"


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Mapping[int, Path]:
    return build_faulty(tmp_path_factory.mktemp("faulty"))


def refusal(call: Callable[..., object], *given: object, **choices: object) -> str:
    with pytest.raises(InputError) as error:
        call(*given, **choices)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"amplitude": 0.6}, "saturates; above 0 and at most 0.5|it saturates"),
        ({"throttle": 1.0}, "between 0 and 1"),
        ({"from_hz": 3.0, "to_hz": 2.0}, "from a lower to a higher"),
        ({"to_hz": 125.0}, "must be below 125 Hz"),
        ({"from_hz": 0.5, "duration": 5.0}, "too short for 0.5 Hz; it takes 32 s"),
        ({"hold": {"lag_s": 1.0}}, "hold lag_s: not a parameter of this form; allowed: gain, rate_1_s, delay_samples"),
        ({"step": 0.003}, "not a whole multiple"),
        ({"from_hz": 20.0, "to_hz": 20.2, "duration": 2.0}, "too few"),
    ],
    ids=str,
)
def test_engine_input_that_cannot_serve(choices: dict[str, object], said: str) -> None:
    assert re.search(said, refusal(identify_engine, "edf", **choices))


@pytest.mark.parametrize("fmi", [2, pytest.param(3, marks=pytest.mark.long)])
def test_an_engine_that_fails_in_the_sweep(faulty: Mapping[int, Path], fmi: int) -> None:
    """Names the engine and what it said; wrong input, for there is nothing to identify."""
    said = refusal(identify_engine, str(faulty[fmi]), {"fault": FAULTS["error"]}, throttle=FAULT_THROTTLE)
    assert re.search(r"sweep of .*engine 1 \(faulty.*flame out", said)


# --- the Hex-Jet's roll axis ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["noise", "no noise"])
def roll(request: pytest.FixtureRequest) -> Identification:
    return identify_axis("roll", settings=() if request.param == "noise" else ("sensor_noise=false",))


def test_roll_is_the_papers(roll: Identification) -> None:
    """433 rad/s^2 per unit throttle within 5 % whichever form is fitted, 1 % where the delay is free; a lag of 38.9 ms.

    The lag is within 5 % as the sum of the two that are there, within 6 % as one behind the paper's 25 samples: one lag
    turns the phase less at high frequency than two of the same sum, and behind a delay that is held it gives way by 2 ms.
    With the lag held instead the delay is the paper's, within a quarter of a sample.  The response is within 1 dB and
    6 deg from 0.3 to 6 Hz, as the simulation's own test has it to 4 Hz.
    """
    _, held, two = roll.fits
    assert [found.model.gain for found in roll.fits] == pytest.approx([433.1] * 3, rel=0.05)
    assert roll.chosen.model.gain == pytest.approx(433.1, rel=0.01)
    assert (held.model.delay_samples, held.model.lags[0]) == (25.0, pytest.approx(0.0389, rel=0.06))
    # the larger is the engine's own
    assert (sum(two.model.lags), max(two.model.lags)) == pytest.approx((0.0389, 0.0299), rel=0.05)
    found = fit(roll.response, 1, "the paper's lag", {"lag_s": PAPER_ROLL.lags[0]})
    assert found.model.delay_samples == pytest.approx(PAPER_ROLL.delay_samples, abs=0.25)
    decibels, degrees, *_ = roll.reference_deviation() or (9.0, 9.0)
    assert decibels < 1.0
    assert degrees < 6.0


def test_all_delay_is_the_ledgers(roll: Identification) -> None:
    """Lags, delay and hold add up to what the blocks state, to a tenth of a sample (0.02 without noise)."""
    assert roll.ledger_samples is not None
    assert low_frequency_delay(roll.fits[2]) == pytest.approx(roll.ledger_samples, abs=0.1)


def test_the_chosen_model_follows_the_response(roll: Identification) -> None:
    """One lag for two, so not exactly: within 0.3 dB and 1 deg, and bounds are of that order."""
    assert roll.chosen.worst_db < 0.3
    assert roll.chosen.worst_deg < 1.0
    assert roll.chosen.model.delay_samples == pytest.approx(25.9, abs=0.2)  # the second lag goes into the delay
    low, high = roll.chosen.bounds["delay_samples"]
    assert 0.02 < high - low < 0.5


UNSTABLE = ("vehicle.control.rate.roll.p=0.08",)


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"from_hz": 2.0, "to_hz": 1.0}, "from a lower to a higher"),
        ({"duration": 5.0}, "too short for 0.3 Hz"),
        ({"amplitude": 1000.0}, "amplitude 1000: at most 1 throttle"),
        ({"settings": ("duration_s",)}, "KEY=VALUE"),
        (
            {"settings": UNSTABLE, "from_hz": 1.0, "duration": 16.0, "controller": "baseline"},
            "the loop is not stable .*less gain",
        ),
    ],
    ids=str,
)
def test_roll_input_that_cannot_serve(choices: dict[str, object], said: str) -> None:
    assert re.search(said, refusal(identify_axis, "roll", **choices))


def test_a_sweep_that_is_lost_in_noise_is_not_found(hexjet: Hexjet, tmp_path: Path) -> None:
    """A given amplitude is kept: status 1, one line, no file."""
    status, out, err = hexjet(
        *["identify", "roll", "--amplitude", "1e-6", "--from-hz", "1", "--duration", "16", "--out", "lost"]
    )
    assert (status, out, len(err.splitlines())) == (1, "", 1)
    assert "does not answer the sweep: coherence" in err
    assert not (tmp_path / "lost").exists()


def test_the_band_follows_the_engine_that_turns_the_axis() -> None:
    """A turbine of 0.8 s is not asked at 6 Hz, where it does not answer: roll is found, and so is its lag."""
    found = identify_axis("roll", "octojet")
    assert found.sweep.to_hz < 1.0
    assert found.refused == []
    assert 0.5 < sum(found.chosen.model.lags) < 1.0
    assert 0.02 < found.chosen.misfit < MAX_MISFIT


def test_a_sweep_that_saturates_says_what_would_fit() -> None:
    """And that then does."""
    band = {"from_hz": 1.5, "to_hz": 6.0, "duration": 14.0}
    said = re.search(r"amplitude 0\.5 .*; ([0-9.e-]+) fits", refusal(identify_axis, "roll", amplitude=0.5, **band))
    assert said
    assert identify_axis("roll", amplitude=float(said[1]), **band).sweep.amplitude == float(said[1])


def test_an_amplitude_that_noise_alone_brings_to_a_limit_goes_down_quicker(monkeypatch: pytest.MonkeyPatch) -> None:
    """What fits all but a hair each time, and only at a sixth of where it begins, is no loop that is not stable."""
    flown: list[float] = []

    def fly(base: Scenario, axis: str, sweep: Sweep) -> object:
        flown.append(sweep.amplitude)
        part = 1.0 if sweep.amplitude <= 0.65 else 0.999
        ending = SimpleNamespace(outcome="completed", reason="")
        engine = SimpleNamespace(name="some")
        return SimpleNamespace(sweep=sweep, is_usable=part == 1.0, fitting_fraction=part, ending=ending, engine=engine)

    monkeypatch.setattr(sweeping, "_fly_sweep", fly)
    found = sweeping._fly_unsaturated(Scenario.load("hover"), "yaw", Sweep(0.3, 6.0, 4.0, 67.0), True)
    assert found.sweep.amplitude == flown[-1] > 0.3
    assert flown[:5] == [4.0, 3.2, 2.6, 2.1, 1.7]
    assert len(flown) <= 7


def test_an_added_delay_is_outside_what_is_identified() -> None:
    """The controller adds it itself, and its predictor knows; the vehicle's own delay stays what it was."""
    band = {"from_hz": 1.0, "to_hz": 6.0, "duration": 20.0}
    plain = identify_axis("roll", settings=("sensor_noise=false",), **band)
    late = identify_axis("roll", settings=("sensor_noise=false", "added_delay_samples=10"), **band)
    assert late.chosen.model.delay_samples == pytest.approx(plain.chosen.model.delay_samples, abs=0.05)
    assert late.ledger_samples == pytest.approx(plain.ledger_samples)


# --- files and the command --------------------------------------------------------------------------------------------


def test_the_model_file_flies(hexjet: Hexjet, tmp_path: Path) -> None:
    """Identified, written, and flown with: the resolved scenario carries the model."""
    asked = "identify roll --engine edf --from-hz 1 --duration 20 --out found --json"
    told = json.loads(hexjet(*asked.split()).told)
    assert told.keys() >= SHARED
    assert (told["engine"], told["verdict"], told["fits"]) == ("edf", "explained", told["estimates"])
    found = tmp_path / "found"
    assert {path.name for path in found.iterdir()} == {
        "identification.json", "model.toml", "report.html", "response.csv",
    }  # fmt: skip
    assert json.loads((found / "identification.json").read_text()) == told
    model = tomllib.loads((found / "model.toml").read_text())["identified"]["edf"]["roll"]
    assert model == told["fits"][0]["discrete"]
    assert read_model(found).gain == pytest.approx(read_model(found / "model.toml").gain)
    page = (found / "report.html").read_text()
    assert 'data-figure="response"' in page
    assert re.search(r'<p class="verdict">1 lag.*: gain [\d.]+ ±', page[: page.index("</header>")])
    assert "http" not in page.split("<script>")[0].replace("http-equiv", "")
    rows = (found / "response.csv").read_text().splitlines()
    assert rows[0] == "frequency_hz,magnitude_db,phase_deg,coherence,relative_spread"
    assert len(rows) == told["points"] + 1
    assert hexjet(*["fly", "roll-doublet", "--engine", "edf", "--model", "found/model.toml", "--out", "flown"]).told
    flown = tomllib.loads((tmp_path / "flown" / "scenario.toml").read_text())["vehicle"]["identified"]
    assert flown["edf"]["roll"] == model
    assert "edf-as-flown" in flown  # written over, not instead


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[identified.edf.roll]\ngain = 1.0\n", "zeros is missing"),
        ("[vehicle]\nmass_kg = 5.0\n", "identified"),
        (None, "No such file"),
    ],
)
def test_a_file_that_is_not_a_model(hexjet: Hexjet, tmp_path: Path, text: str | None, said: str) -> None:
    if text is not None:
        (tmp_path / "wrong.toml").write_text(text)
    assert said in hexjet("fly", "hover", "--model", "wrong.toml").refusal


def test_the_command_prints_the_papers_turbojet(hexjet: Hexjet, tmp_path: Path) -> None:
    told = hexjet("engine", "identify", "turbojet").told
    assert "G(z) = 0.01866 / (z - 0.9879) z^-25  [kgf per throttle]" in told
    made = {path.name for path in (tmp_path / "runs" / "identify-turbojet-001").iterdir()}
    assert "report.html" in made
    assert "model.toml" not in made


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("engine identify edf --set delay", "settings delay: write it as NAME=NUMBER"),
        ("engine identify edf --amplitude nan", "--amplitude: nan is not a finite number"),
        ("identify roll --hold lag_s=much", "--hold lag_s=much: must be NAME=VALUE"),
        ("identify roll --aircraft nope", "unknown aircraft 'nope'"),
    ],
)
def test_one_line_for_wrong_input(hexjet: Hexjet, arguments: str, said: str) -> None:
    assert said in hexjet(*arguments.split()).refusal


def test_the_written_model_reads_back(tmp_path: Path) -> None:
    found = identify_engine("edf", from_hz=1.0, to_hz=20.0)
    axis = replace(found, kind="axis", channel="roll", engine="some.fmu")
    paths = write(axis, tmp_path / "out")
    assert read_models(paths["model"]) == {"some.fmu": {"roll": found.model}}


def test_a_model_is_not_inherited_by_another_file_of_the_same_name(tmp_path: Path) -> None:
    """Filed under name and hash: another kestrel.toml has none, and a model without a hash is taken with a note."""
    files = [tmp_path / name / "kestrel.toml" for name in ("one", "two")]
    for file in files:
        file.parent.mkdir()
        file.write_text(f"fmu = 'edf.fmu'\ntitle = '{file.parent.name}'\n")
    kestrel, other = (replace(load_engine("edf", {}, STEP), library=False, mapping=file) for file in files)
    found = replace(AN_AXIS, engine=kestrel.family, fits=(fit(AN_AXIS.response, 1, "1 lag"),))
    found = replace(found, engine_sha256=kestrel.fingerprint)
    vehicle, _ = load_vehicle("hexjet", {"identified": found.model_table()["identified"]}, "test")
    assert kestrel.family == other.family == "kestrel.toml"
    assert find_models(vehicle, kestrel)["roll"].engine_sha256 == kestrel.fingerprint
    with pytest.warns(Notice, match="is of another kestrel.toml .*: left out"):
        assert find_models(vehicle, other) == {}
    old = replace(found, engine_sha256="").model_table()["identified"]
    assert "engine_sha256" not in old["kestrel.toml"]["roll"]
    with pytest.warns(Notice, match="states no hash: .* is not verified"):
        assert set(find_models(load_vehicle("hexjet", {"identified": old}, "test")[0], other)) == {"roll"}
