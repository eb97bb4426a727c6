"""docs/paper.md, readings of section II-D: what each makes of the Hex-Jet, and its flights."""

from __future__ import annotations

import numpy as np
import pytest

from cosim import fly
from cosim.base.constants import GRAVITY
from cosim.control.predictors.linear import model_response
from cosim.spec.vehicle import load_vehicle
from hexjet_paper import numbers, readings
from hexjet_paper.claims import CLAIMS, CONSISTENCY, Evidence, claim_rows
from hexjet_paper.experiments import Experiment
from hexjet_paper.flight import scenario
from hexjet_paper.frozen import load
from hexjet_paper.readings import READINGS, Gains, ReadingResult, gain_pairs, reading_scenario
from hexjet_paper.report.readings import DEPENDENT, judge_reading, model_errors_in_words

FOUND = load().parameters
STEP = numbers.value("hexjet.step")
DELAY, CORRECTED, FANS = READINGS["delay"], READINGS["corrected"], READINGS["corrected-fans"]


def pairs(key: str) -> dict[str, Gains]:
    return {gains.name: gains for gains in gain_pairs(READINGS[key], FOUND)}


@pytest.fixture(scope="module")
def results() -> list[ReadingResult]:
    return [readings.fly_reading(key) for key in READINGS]


def test_a_corrected_model_is_the_printed_one_times_both_engines() -> None:
    """G(z) G_turbo(z) / G_EDF(z) point by point, with the fans' gain; up to a factor with the turbojet's."""
    z = np.exp(2j * np.pi * np.geomspace(0.05, 50.0, 40) * STEP)
    turbojet = numbers.value("turbojet.gain") / (z - numbers.value("turbojet.pole"))
    edf = numbers.value("edf.gain") / (z - numbers.value("edf.pole"))
    product = model_response(numbers.roll_model(), z) * turbojet / edf
    assert model_response(FANS.model, z) == pytest.approx(product, rel=1e-12)
    assert model_response(CORRECTED.model, z) == pytest.approx(product / FANS.gain, rel=1e-12)
    assert DELAY.model == numbers.roll_model()


def test_inertia_follows_from_thrust_and_gain() -> None:
    """``J_xx = 6 L_y T / K`` with the slope K of each reading, and the roll damping keeps the slow pole where it was."""
    vehicle, _ = load_vehicle("hexjet")
    for reading in READINGS.values():
        assert 6.0 * 0.15 * GRAVITY * reading.thrust_kgf / (433.1 * reading.gain) == pytest.approx(
            reading.inertia, rel=1e-3
        )
        changed = reading.vehicle()
        if reading is DELAY:
            assert changed == {}  # what ships, to the bit
        else:
            assert changed["inertia_kg_m2"][0] == reading.inertia
            pole = vehicle.aero.damping_n_m_s[0] / vehicle.inertia_kg_m2[0]
            assert changed["aero"]["damping_n_m_s"][0] / reading.inertia == pytest.approx(pole)


def test_raised_gains_are_as_far_past_the_limit_as_the_shipped_ones() -> None:
    """8 % past the largest gains with which the linear baseline is stable; Smith's limit lies beyond."""
    shipped, fitted = pairs("delay")["shipped"], pairs("delay")["fitted"]
    limit = readings.largest_gains(DELAY, "baseline", FOUND)
    assert shipped.p / fitted.p / limit == pytest.approx(1.08, abs=0.01)
    for reading in (CORRECTED, FANS):
        assert readings.RAISED_GAINS / readings.largest_gains(reading, "baseline", FOUND) == pytest.approx(
            1.08, abs=0.01
        )
        assert readings.largest_gains(reading, "smith", FOUND) > readings.RAISED_GAINS


def test_the_readings_of_the_gain_are_one_loop() -> None:
    """What one takes in the plant the other has in the rate gain."""
    a, b = (pairs(key)["fitted"] for key in ("corrected", "corrected-fans"))
    assert a.p == pytest.approx(FANS.gain * b.p)
    assert a.attitude_gain_1_s == b.attitude_gain_1_s


def test_the_reading_that_ships_flies_as_the_experiments_do() -> None:
    """The same bits: a reading adds nothing where it changes nothing."""
    gains = pairs("delay")["shipped"]
    ours = fly(reading_scenario(DELAY, gains, "smith", FOUND).replace(duration_s=2.0))
    paper = fly(scenario(Experiment("hexjet-doublet", "smith", 25, gains="vehicle"), FOUND).replace(duration_s=2.0))
    assert np.array_equal(ours.log["roll_rad"], paper.log["roll_rad"])


def test_each_reading_has_gains_at_which_the_claims_hold_and_others_at_which_none_does(
    results: list[ReadingResult],
) -> None:
    delay, *others = results
    assert delay.trial("shipped", "smith").flight.stable
    for result in others:
        assert result.trial("shipped", "smith").lost_s is not None
    for result in results:
        verdicts = {row.key: (row.linear.verdict, row.flight and row.flight.verdict) for row in judge_reading(result)}
        assert verdicts.keys() == set(DEPENDENT)
        assert verdicts["hexjet-smith"] == ("holds", "holds")
        for key in set(DEPENDENT) - {"hexjet-smith"}:
            assert verdicts[key] == ("by construction", "by construction")
    times = [trial.flight.settling_s or 0.0 for trial in (r.trial("fitted", "baseline") for r in results)]
    assert times[1] == pytest.approx(times[2], rel=1e-3)


def test_a_slow_swing_is_no_stability(results: list[ReadingResult]) -> None:
    """Its period is longer than a second: the windows of judgement are as much longer as the doublet is."""
    raised = results[1].trial("raised", "baseline")
    assert not raised.linear.stable
    assert not raised.flight.stable


def test_smith_holds_with_models_that_are_off() -> None:
    errors = readings.fly_model_errors()
    assert len(errors) == 9
    assert all(error.stable for error in errors)
    assert "8 of 8 flights settle" in model_errors_in_words(errors)
    lost = errors[0].model_copy(update={"stable": False})
    assert "7 of 8 flights settle" in model_errors_in_words([lost, *errors[1:]])


def test_questions_of_ours_are_no_claims_of_the_paper() -> None:
    assert {claim.key for claim in CONSISTENCY} == {"tracking-numbers", "hexjet-both"}
    assert not {claim.key for claim in CLAIMS} & {claim.key for claim in CONSISTENCY}


@pytest.mark.parametrize(("factor", "verdict"), [(0.9, "holds"), (1.1, "does not hold")])
def test_tracking_in_manual_flight_is_judged_by_the_printed_errors(factor: float, verdict: str) -> None:
    printed = {key: factor * row.value for key, row in numbers.PRINTED.items() if key.startswith("hexjet-manual.")}
    flight = Evidence(metrics={}, margins={}, gain_at_low_end={}, gain_at_8_hz={}, tracking=printed)
    linear = Evidence(metrics={}, margins={}, gain_at_low_end={}, gain_at_8_hz={})
    rows = {row.key: row for row in claim_rows(linear, flight)}
    for key in ("manual-roll", "manual-pitch-yaw"):
        assert rows[key].linear.verdict == "not flown"
        judged = rows[key].flight
        assert judged is not None
        assert judged.verdict == verdict
        assert judged.basis == "follows from a choice"
