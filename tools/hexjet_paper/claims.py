"""Every statement of the paper of an order, a stability or a quality, and whether it follows.

A claim is judged from evidence alone: the metrics of experiments and the margins of loops, of one fidelity at a time.
The paper's state predictor is judged twice: with G_n(z) realised, and run with the matrices as printed; a claim that
follows only in the second case holds *under a condition*.  Where neither does, :mod:`hexjet_paper.conditions`
says what would.

A claim that we fitted or chose our way to is no evidence for the paper: where it holds, it holds *by construction* and
is counted apart.  What every claim rests on is its *basis* (:data:`hexjet_paper.numbers.Basis`).

Two questions are ours: whether numbers that the paper prints can belong to one experiment.  They are judged in the same
way as :data:`CONSISTENCY`, and no count of the paper's claims has them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from hexjet_paper import numbers
from hexjet_paper.experiments import Metrics, hexjet_ratios
from hexjet_paper.linear import STATE_AS_PRINTED
from hexjet_paper.loops import LOW_END_HZ, Margins
from hexjet_paper.numbers import Basis, Record

Verdict = Literal["holds", "under a condition", "by construction", "does not hold", "not flown"]
NO_EVIDENCE: tuple[Basis, ...] = ("calibrated", "chosen by us")  # agreement with these is no evidence

# Chosen by us, in percent: spread or growth of numbers that count as similar, and an overshoot that is not distinct.
MAX_SPREAD = 15.0
MAX_OVERSHOOT = 10.0
# Conditions under which a claim holds, or what it depends on, as the report prints them.
PRINTED_MATRICES = "holds for the state predictor run with the printed matrices, not with G_n(z) realised"
WAITING = "holds if the wait itself is left out: the answer comes 20 samples later and is otherwise no worse"
SEEN_BY_PREDICTOR = "holds where the disturbance enters before the predictor's tap, so that the predictor is told of it"
FITTED_ORDER_NOTE = (
    "the numbers of baseline, Smith and the printed matrices with 5 samples are eight of the nine to which attitude "
    "gain, length of the disturbance, observer and payload are fitted"
)
ATTITUDE_CLOSED_NOTE = (
    "with the attitude loop closed round it, which the paper does not say of this rate experiment; see which delay "
    "breaks the rate loop alone"
)
PAYLOAD_SIGN_NOTE = (
    "on the linear plant the payload raises the gain, as the state predictor's printed errors ask for; in six degrees "
    "of freedom the same mass lowers it: opposite signs"
)
HEXJET_GAINS_NOTE = (
    "the gains are not printed; those of vehicle.toml were chosen so that the baseline is lost in the doublet"
)
STICKS_NOTE = (
    "the pilot's sticks and the gains are not printed: ours are calm, there is no wind, and the printed errors are "
    "taken for what was expected"
)
HEXJET_FIT = "two gains are fitted to these two numbers on the linear plant; the flight repeats it at the same gains"


@dataclass(frozen=True)
class Evidence:
    """Results of one fidelity: metrics by experiment, margins and gains [dB] of C G* by controller."""

    metrics: Mapping[str, Metrics]
    margins: Mapping[str, Margins]
    gain_at_low_end: Mapping[str, float]
    gain_at_8_hz: Mapping[str, float]
    tracking: Mapping[str, float] = field(default_factory=dict)  # of the manual flight, by printed key

    def stable(self, name: str) -> bool:
        return self.metrics[name].stable

    def rmse(self, name: str) -> float:
        return self.metrics[name].rmse

    def max(self, name: str) -> float:
        return self.metrics[name].max


class Judgement(Record):
    """Verdict on a claim in one fidelity, with the numbers."""

    verdict: Verdict
    evidence: str
    condition: str = ""
    basis: Basis = "predicted"


class ClaimRow(Record):
    """Row of the claims table: a claim, and its judgement in each fidelity."""

    key: str
    claim: str
    place: str
    how: str
    linear: Judgement
    flight: Judgement | None = None
    rests_on: str = ""


Answer = tuple[bool, str]
Test = Callable[[Evidence, str], Answer]  # evidence, name of the state predictor


@dataclass(frozen=True)
class Claim:
    """Claim of the paper; ``condition_test``, if any, tests it under ``condition``.

    ``basis``: what the linear plant's answer depends on, and the flight's unless ``flight_basis`` is stated;
    ``rests_on`` is the reason.
    """

    key: str
    claim: str
    place: str
    how: str
    test: Test
    about_state: bool = False
    condition: str = ""
    condition_test: Test | None = None
    basis: Basis = "predicted"
    flight_basis: Basis | None = None
    rests_on: str = ""

    def judge(self, evidence: Evidence, in_flight: bool = False) -> Judgement:
        """Return the judgement of the claim in one fidelity; missing experiments leave it open."""
        basis = (self.flight_basis if in_flight else None) or self.basis
        judged = self._judge_by_tests(evidence)
        if judged.verdict in ("holds", "under a condition") and basis in NO_EVIDENCE:
            return judged.model_copy(update={"verdict": "by construction", "basis": basis})
        return judged.model_copy(update={"basis": basis})

    def _judge_by_tests(self, evidence: Evidence) -> Judgement:
        try:
            holds, detail = self.test(evidence, "state")
        except KeyError as missing:
            return Judgement(verdict="not flown", evidence=f"no {missing.args[0]}")
        if holds:
            return Judgement(verdict="holds", evidence=detail)
        other = self.condition_test or (self.test if self.about_state else None)
        condition = self.condition or (PRINTED_MATRICES if self.about_state else "")
        if other:
            try:
                holds, also = other(evidence, STATE_AS_PRINTED)
            except KeyError:
                holds, also = False, ""
            if also and also != detail:
                detail = f"{detail}; under the condition: {also}"
            if holds:
                return Judgement(verdict="under a condition", evidence=detail, condition=condition)
        return Judgement(verdict="does not hold", evidence=detail)


def growth_percent(new: float, old: float) -> float:
    """Return by how many percent ``new`` is above ``old``."""
    return 100.0 * (new / old - 1.0)


def _is_stable(name: str, expected: bool) -> Test:
    """Return a test that an experiment is stable, or unstable if that is expected."""

    def test_stability(e: Evidence, state: str) -> Answer:
        experiment = name.format(state=state)
        stable = e.stable(experiment)
        return stable == expected, f"{experiment} {'stable' if stable else 'unstable'}, RMSE {e.rmse(experiment):.3g}"

    return test_stability


def _is_below(quantity: str, lower: str, higher: str, by: float = 0.0) -> Test:
    """Return a test that ``lower`` is more than ``by`` percent below ``higher``, or ``higher`` is unstable."""

    def test_order(e: Evidence, state: str) -> Answer:
        a, b = lower.format(state=state), higher.format(state=state)
        x, y = float(getattr(e.metrics[a], quantity)), float(getattr(e.metrics[b], quantity))
        detail = f"{a} {quantity} {x:.4g}, {b} {y:.4g} ({growth_percent(x, y):+.1f} %)"
        if not e.stable(a):
            return False, f"{detail}, {a} unstable"
        return (x < y * (1.0 - 0.01 * by) or not e.stable(b)), detail

    return test_order


def _grows(quantity: str, new: str, old: str, most: float, least: float = -100.0) -> Test:
    """Return a test that ``new`` is above ``old`` by ``least`` to ``most`` percent."""

    def test_growth(e: Evidence, state: str) -> Answer:
        a, b = new.format(state=state), old.format(state=state)
        if not e.stable(a):
            return most == np.inf, f"{a} unstable"
        x, y = float(getattr(e.metrics[a], quantity)), float(getattr(e.metrics[b], quantity))
        growth = growth_percent(x, y)
        return least <= growth <= most, f"{quantity} {y:.4g} -> {x:.4g} ({growth:+.1f} %)"

    return test_growth


def _all_hold(*tests: Test) -> Test:
    """Return a test that all of the tests hold."""

    def test_all(e: Evidence, state: str) -> Answer:
        results = [claim(e, state) for claim in tests]
        return all(holds for holds, _ in results), "; ".join(detail for _, detail in results)

    return test_all


def _tracking_is_similar(e: Evidence, state: str) -> Answer:
    rmse = {c: e.metrics[f"step-5.{c}"].rmse for c in ("baseline", "smith", state)}
    spread = growth_percent(max(rmse.values()), min(rmse.values()))
    return spread < MAX_SPREAD, ", ".join(f"{c} {v:.4f}" for c, v in rmse.items()) + f" rad, spread {spread:.1f} %"


def _overshoots_are_small(e: Evidence, state: str) -> Answer:
    overshoot = {c: e.metrics[f"step-5.{c}"].overshoot_percent or 0.0 for c in ("baseline", "smith", state)}
    return max(overshoot.values()) < MAX_OVERSHOOT, ", ".join(f"{c} {v:.1f} %" for c, v in overshoot.items())


def _rise_times_agree(e: Evidence, state: str) -> Answer:
    constants = {c: e.metrics[f"step-5.{c}"].time_constant_s or np.inf for c in ("baseline", "smith", state)}
    spread = growth_percent(max(constants.values()), min(constants.values()))
    return spread < MAX_SPREAD, ", ".join(f"{c} {v:.4f} s" for c, v in constants.items()) + f", spread {spread:.1f} %"


def _predictors_overshoot_less(e: Evidence, state: str) -> Answer:
    overshoot = {c: e.metrics[f"step-5.{c}"].overshoot_percent or 0.0 for c in ("baseline", "smith", state)}
    detail = "overshoot " + ", ".join(f"{c} {v:.2f} %" for c, v in overshoot.items())
    return overshoot[state] <= overshoot["smith"] < overshoot["baseline"], detail


def _printed_error_is_consistent(e: Evidence, state: str) -> Answer:
    a, tau = np.radians(numbers.value("step.amplitude")), numbers.value("step.time_constant")
    least = float(a * np.sqrt(3.0 * tau / numbers.value("step.record")))
    printed = numbers.value("step-5.baseline.rmse")
    detail = f"an exponential of 0.1161 s on 15 deg either way has {least:.4f} rad over 2 s, printed {printed:.4f} rad"
    return abs(growth_percent(printed, least)) < MAX_SPREAD, detail


def _half_amplitude_fits(e: Evidence, state: str) -> Answer:
    """Test whether 15 deg from peak to peak, half the amplitude, gives the printed errors, as in a linear loop."""
    names = ["step-5.baseline", "step-5.smith", "step-10.smith", "step-25.smith"]
    pairs = [(0.5 * e.rmse(n), numbers.value(n + ".rmse")) for n in names]
    worst = max(abs(growth_percent(computed, paper)) for computed, paper in pairs)
    detail = ", ".join(f"{n} {computed:.4f} ({paper:.4f})" for n, (computed, paper) in zip(names, pairs, strict=True))
    return worst < MAX_SPREAD, f"{detail}, worst {worst:.1f} %"


def _smith_costs_only_waiting(e: Evidence, state: str) -> Answer:
    five, late = e.metrics["step-5.smith"], e.metrics["step-25.smith"]
    if not late.stable or five.late_rmse is None:
        return False, "step-25.smith unstable"
    grown, waited = growth_percent(late.rmse, five.rmse), growth_percent(five.late_rmse, five.rmse)
    return grown <= waited, (
        f"RMSE {five.rmse:.4f} -> {late.rmse:.4f} rad ({grown:+.1f} %, paper +11 %); "
        f"the 5-sample answer 20 samples later would have {waited:+.1f} %"
    )


def _predictors_raise_phase(e: Evidence, state: str) -> Answer:
    phase = {c: e.margins[c].phase_margin or 0.0 for c in ("baseline", state, "smith")}
    detail = ", ".join(f"{c} {v:.1f} deg" for c, v in phase.items())
    return phase["baseline"] < phase[state] and phase["baseline"] < phase["smith"], detail


def _smith_has_most_phase(e: Evidence, state: str) -> Answer:
    a, b = e.margins["smith"].phase_margin or 0.0, e.margins[state].phase_margin or 0.0
    return a > b, f"smith {a:.1f} deg, {state} {b:.1f} deg"


def _cutoffs_are_in_order(e: Evidence, state: str) -> Answer:
    cutoff = {c: e.margins[c].cutoff or 0.0 for c in ("baseline", state, "smith")}
    detail = ", ".join(f"{c} {v:.2f} Hz" for c, v in cutoff.items())
    return cutoff["baseline"] > cutoff[state] * 1.005 and cutoff[state] > cutoff["smith"] * 1.005, detail


def _gain_margins_are_in_order(e: Evidence, state: str) -> Answer:
    margin = {c: e.margins[c].gain_margin or 0.0 for c in (state, "baseline", "smith")}
    detail = ", ".join(f"{c} {v:.2f} dB" for c, v in margin.items())
    return margin[state] > margin["baseline"] > margin["smith"], detail


def _state_predictor_deviates(e: Evidence, state: str) -> Answer:
    base, smith, other = e.gain_at_8_hz["baseline"], e.gain_at_8_hz["smith"], e.gain_at_8_hz[state]
    detail = f"at 8 Hz against baseline: smith {smith - base:+.2f} dB, {state} {other - base:+.2f} dB"
    return abs(other - base) > 1.0 > abs(smith - base), detail


def _matches_printed_ratio(key: str) -> Test:
    """Return a test that Smith's ratio to the baseline is within 10 points of the printed percentage."""

    def test_ratio(e: Evidence, state: str) -> Answer:
        a, b = e.metrics["hexjet-doublet-calibrated.baseline"], e.metrics["hexjet-doublet-calibrated.smith"]
        ratio = hexjet_ratios(a.overshoot_percent, b.overshoot_percent, a.settling_s, b.settling_s)[key]
        paper = numbers.value(key)
        detail = (
            f"{ratio:.1f} % (paper {paper:g} %): overshoot {a.overshoot_percent or 0:.1f} -> "
            f"{b.overshoot_percent or 0:.1f} %, settling {a.settling_s or np.inf:.2f} -> {b.settling_s or np.inf:.2f} s"
        )
        return a.stable and b.stable and abs(ratio - paper) < 10.0, detail

    return test_ratio


def _tracks_as_printed(*axes: str) -> Test:
    """Return a test that the manual flight's errors in angle and rate are at most the printed ones."""

    def test_tracking(e: Evidence, state: str) -> Answer:
        keys = [f"hexjet-manual.{axis}.{quantity}" for axis in axes for quantity in ("rmse", "rate_rmse")]
        pairs = [(key, e.tracking[key], numbers.PRINTED[key]) for key in keys]
        detail = ", ".join(f"{key} {v:.4f} (paper {printed.value:g}) {printed.unit}" for key, v, printed in pairs)
        return all(v <= printed.value for _, v, printed in pairs), detail

    return test_tracking


def _low_end_gains_agree(e: Evidence, state: str) -> Answer:
    gains = {c: e.gain_at_low_end[c] for c in ("baseline", "smith", state)}
    spread = max(gains.values()) - min(gains.values())
    return spread < 1.0, ", ".join(f"{c} {v:.2f} dB" for c, v in gains.items()) + f", spread {spread:.2f} dB"


_UNSEEN_DISTURBANCE_GROWTH = _all_hold(  # the predictor is not told of it
    _grows("rmse", "disturbance-10-unseen.smith", "disturbance-5-unseen.smith", MAX_SPREAD),
    _grows("max", "disturbance-10-unseen.smith", "disturbance-5-unseen.smith", MAX_SPREAD),
)
_SEEN_DISTURBANCE_GROWTH = _all_hold(  # the predictor is told of it
    _grows("rmse", "disturbance-10.smith", "disturbance-5.smith", MAX_SPREAD),
    _grows("max", "disturbance-10.smith", "disturbance-5.smith", MAX_SPREAD),
)

CLAIMS: list[Claim] = [  # claims of the paper, in its order
    Claim("tracking-similar", "with 5 samples the three controllers track alike", numbers.TRACKING,
          f"spread of the RMSE below {MAX_SPREAD:g} %", _tracking_is_similar, about_state=True),
    Claim("tracking-no-overshoot", "with 5 samples none overshoots distinctly", numbers.TRACKING,
          f"overshoot below {MAX_OVERSHOOT:g} %", _overshoots_are_small, about_state=True),
    Claim("tracking-same-speed", "a predictor does not make the attitude loop faster: one time constant for all",
          numbers.TRACKING, f"spread of the 63 % time below {MAX_SPREAD:g} %", _rise_times_agree, about_state=True),
    Claim("tracking-oscillation", "with 5 samples the baseline swings a little, Smith less, the state predictor not",
          numbers.TRACKING, "order of the overshoot", _predictors_overshoot_less, about_state=True),
    Claim("baseline-10", "the baseline loses stability at 10 samples", numbers.TRACKING,
          "step with 10 samples", _is_stable("step-10.baseline", False),
          rests_on="rate gains fitted at 5 samples; rate and attitude loop together, as in the experiment"),
    Claim("baseline-5", "the baseline is stable at 5 samples", numbers.TRACKING,
          "step with 5 samples", _is_stable("step-5.baseline", True),
          basis="calibrated", rests_on="the rate gains are fitted to this loop's printed margins, all positive"),
    Claim("predictors-10", "both predictors stay stable at 10 samples", numbers.TRACKING, "step with 10 samples",
          _all_hold(_is_stable("step-10.smith", True), _is_stable("step-10.{state}", True)), about_state=True),
    Claim("smith-25", "Smith's predictor stays stable at 25 samples", numbers.TRACKING, "step with 25 samples",
          _is_stable("step-25.smith", True)),
    Claim("smith-25-little", "Smith's tracking error grows by only 11 % from 5 to 25 samples", numbers.TRACKING,
          f"growth of the RMSE below {MAX_SPREAD:g} %", _grows("rmse", "step-25.smith", "step-5.smith", MAX_SPREAD),
          condition=WAITING, condition_test=_smith_costs_only_waiting),
    Claim("state-25", "the state predictor fails at 25 samples", numbers.TRACKING, "step with 25 samples",
          _is_stable("step-25.{state}", False), about_state=True),
    Claim("phase-up", "predictors raise the phase margin", numbers.FREQUENCY, "margins of C G*, 5 samples",
          _predictors_raise_phase, about_state=True,
          rests_on="the baseline's margins are fitted, those of the predictors are not"),
    Claim("phase-smith", "Smith has a larger phase margin than the state predictor", numbers.FREQUENCY,
          "margins of C G*, 5 samples", _smith_has_most_phase, about_state=True),
    Claim("cutoff-order", "cut-off: baseline above state predictor above Smith", numbers.FREQUENCY,
          "margins of C G*, 5 samples", _cutoffs_are_in_order, about_state=True),
    Claim("gain-margin-order", "gain margin: state predictor above baseline above Smith", numbers.FREQUENCY,
          "margins of C G*, 5 samples", _gain_margins_are_in_order, about_state=True),
    Claim("low-end-same", "at the low end all controllers' open loops have the same gain", numbers.FREQUENCY,
          f"gain at {LOW_END_HZ:g} Hz, within 1 dB", _low_end_gains_agree, about_state=True),
    Claim("state-deviates", "above 5 Hz the state predictor's open loop leaves the other two", numbers.FREQUENCY,
          "gain at 8 Hz, more than 1 dB away", _state_predictor_deviates, about_state=True),
    Claim("disturbance-predictors-rmse", "with 5 samples both predictors have less RMSE than the baseline",
          numbers.DISTURBANCE, "disturbance with 5 samples",
          _all_hold(_is_below("rmse", "disturbance-5.smith", "disturbance-5.baseline"),
                    _is_below("rmse", "disturbance-5.{state}", "disturbance-5.baseline")), about_state=True,
          basis="calibrated", rests_on=FITTED_ORDER_NOTE),
    Claim("disturbance-predictors-max", "with 5 samples both predictors have a smaller largest error than the baseline",
          numbers.DISTURBANCE, "disturbance with 5 samples",
          _all_hold(_is_below("max", "disturbance-5.smith", "disturbance-5.baseline"),
                    _is_below("max", "disturbance-5.{state}", "disturbance-5.baseline")), about_state=True,
          basis="calibrated", rests_on=FITTED_ORDER_NOTE),
    Claim("disturbance-smith-5", "with 5 samples Smith rejects disturbances better than the state predictor",
          numbers.DISTURBANCE, "RMSE and largest error",
          _all_hold(_is_below("rmse", "disturbance-5.smith", "disturbance-5.{state}"),
                    _is_below("max", "disturbance-5.smith", "disturbance-5.{state}")), about_state=True,
          basis="calibrated", rests_on=FITTED_ORDER_NOTE),
    Claim("disturbance-smith-10", "with 10 samples Smith rejects disturbances better than the state predictor",
          numbers.DISTURBANCE, "RMSE and largest error",
          _all_hold(_is_below("rmse", "disturbance-10.smith", "disturbance-10.{state}"),
                    _is_below("max", "disturbance-10.smith", "disturbance-10.{state}")), about_state=True),
    Claim("disturbance-baseline-10", "with 10 samples the disturbed baseline is unstable", numbers.DISTURBANCE,
          "disturbance with 10 samples", _is_stable("disturbance-10.baseline", False),
          rests_on=ATTITUDE_CLOSED_NOTE),
    Claim("disturbance-smith-growth", "from 5 to 10 samples Smith's errors grow by only 2.9 % and 0.2 %",
          numbers.DISTURBANCE, f"growth below {MAX_SPREAD:g} %, disturbance unknown to the predictor",
          _UNSEEN_DISTURBANCE_GROWTH, condition=SEEN_BY_PREDICTOR, condition_test=_SEEN_DISTURBANCE_GROWTH),
    Claim("disturbance-state-growth", "from 5 to 10 samples the state predictor's errors grow much (41.3 % and 22.4 %)",
          numbers.DISTURBANCE, "growth of RMSE above 20 % and of the largest error above 0",
          _all_hold(_grows("rmse", "disturbance-10.{state}", "disturbance-5.{state}", np.inf, 20.0),
                    _grows("max", "disturbance-10.{state}", "disturbance-5.{state}", np.inf, 0.0)), about_state=True),
    Claim("payload-5", "with payload and 5 samples both predictors track as before", numbers.PAYLOAD,
          f"stable, RMSE within {MAX_SPREAD:g} %",
          _all_hold(_is_stable("step-5-payload.smith", True), _is_stable("step-5-payload.{state}", True),
                    _grows("rmse", "step-5-payload.smith", "step-5.smith", MAX_SPREAD, -MAX_SPREAD),
                    _grows("rmse", "step-5-payload.{state}", "step-5.{state}", MAX_SPREAD, -MAX_SPREAD)),
          about_state=True, rests_on=PAYLOAD_SIGN_NOTE),
    Claim("payload-10-smith", "with payload and 10 samples Smith still tracks", numbers.PAYLOAD,
          f"stable, RMSE within {MAX_SPREAD:g} %",
          _all_hold(_is_stable("step-10-payload.smith", True),
                    _grows("rmse", "step-10-payload.smith", "step-10.smith", MAX_SPREAD, -MAX_SPREAD)),
          rests_on=PAYLOAD_SIGN_NOTE),
    Claim("payload-10-state", "with payload and 10 samples the state predictor becomes unstable", numbers.PAYLOAD,
          "step with payload and 10 samples", _is_stable("step-10-payload.{state}", False), about_state=True,
          basis="calibrated", flight_basis="predicted", rests_on=PAYLOAD_SIGN_NOTE),
    Claim("payload-smith-growth", "with payload Smith's disturbance errors grow by only 2.2 % and 8.7 %",
          numbers.PAYLOAD, f"growth below {MAX_SPREAD:g} %",
          _all_hold(_grows("rmse", "disturbance-5-payload.smith", "disturbance-5.smith", MAX_SPREAD),
                    _grows("max", "disturbance-5-payload.smith", "disturbance-5.smith", MAX_SPREAD)),
          rests_on=PAYLOAD_SIGN_NOTE),
    Claim("payload-state-growth", "with payload the state predictor's disturbance errors grow more than Smith's",
          numbers.PAYLOAD, "growth of RMSE against Smith's",
          lambda e, state: _payload_costs_state_more(e, state), about_state=True,
          basis="calibrated", flight_basis="predicted", rests_on=PAYLOAD_SIGN_NOTE),
    Claim("hexjet-baseline", "the baseline cannot hold the Hex-Jet with 25 samples", numbers.FLIGHT,
          "roll doublet at the gains of vehicle.toml", _is_stable("hexjet-doublet.baseline", False),
          basis="chosen by us", rests_on=HEXJET_GAINS_NOTE),
    Claim("hexjet-smith", "Smith's predictor holds the Hex-Jet with the same gains", numbers.FLIGHT,
          "roll doublet at the gains of vehicle.toml", _is_stable("hexjet-doublet.smith", True),
          basis="follows from a choice", rests_on=HEXJET_GAINS_NOTE),
    Claim("hexjet-overshoot", "on the Hex-Jet Smith has 42.6 % less overshoot", numbers.FLIGHT,
          "roll doublet at calibrated gains, within 10 points", _matches_printed_ratio("hexjet.less_overshoot"),
          basis="calibrated", rests_on=HEXJET_FIT),
    Claim("hexjet-settling", "on the Hex-Jet Smith settles 64.3 % faster", numbers.FLIGHT,
          "roll doublet at calibrated gains, within 10 points", _matches_printed_ratio("hexjet.faster_settling"),
          basis="calibrated", rests_on=HEXJET_FIT),
    Claim("manual-roll", "in manual flight roll angle and rate track well in spite of the delay", numbers.FLIGHT,
          "RMSE of angle and rate at most as printed", _tracks_as_printed("roll"),
          basis="follows from a choice", rests_on=STICKS_NOTE),
    Claim("manual-pitch-yaw", "in manual flight pitch and yaw track as expected, in angle and rate", numbers.FLIGHT,
          "RMSE of angle and rate at most as printed", _tracks_as_printed("pitch", "yaw"),
          basis="follows from a choice", rests_on=STICKS_NOTE),
]  # fmt: skip

# Questions of ours, not the paper's: can printed numbers belong to one record?
CONSISTENCY: list[Claim] = [
    Claim("tracking-numbers", "15 deg, a time constant of 0.1161 s and an RMSE of 0.075 rad belong to one record",
          numbers.TRACKING, "an exponential's error, and our runs", _printed_error_is_consistent,
          condition="holds if the doublet is 15 deg from peak to peak", condition_test=_half_amplitude_fits),
    Claim("hexjet-both", "the baseline that has an overshoot and a settling time is the one that failed to stabilise",
          numbers.FLIGHT, "the baseline unstable at the gains that give both ratios",
          _is_stable("hexjet-doublet-calibrated.baseline", False),
          condition="holds for two different pairs of gains: those of vehicle.toml and the calibrated ones",
          condition_test=_is_stable("hexjet-doublet.baseline", False),
          basis="follows from a choice", rests_on=HEXJET_GAINS_NOTE),
]  # fmt: skip


def _payload_costs_state_more(e: Evidence, state: str) -> Answer:
    smith = growth_percent(e.rmse("disturbance-5-payload.smith"), e.rmse("disturbance-5.smith"))
    other = growth_percent(e.rmse(f"disturbance-5-payload.{state}"), e.rmse(f"disturbance-5.{state}"))
    return other > smith, f"smith {smith:+.1f} %, {state} {other:+.1f} %"


def claim_rows(linear: Evidence, flight: Evidence | None = None, claims: Sequence[Claim] = CLAIMS) -> list[ClaimRow]:
    """Return the judgement of every claim in each fidelity; also for :data:`CONSISTENCY`."""
    return [
        ClaimRow(
            key=c.key,
            claim=c.claim,
            place=c.place,
            how=c.how,
            linear=c.judge(linear),
            flight=c.judge(flight, in_flight=True) if flight else None,
            rests_on=c.rests_on,
        )
        for c in claims
    ]
