"""The stopping rule of a study against exact sums over all of its ends, against drawn studies, and by hand."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator
from math import ceil, log

import numpy as np
import pytest
from scipy.stats import binomtest

from cosim.base.errors import InputError
from cosim.campaign.analysis.claim import format_percent
from cosim.campaign.study.sequential import ClaimTest, SequentialTest, StoppingRule, Verdict, parse_claim

CLAIMS = ("90%@95%", "50%@95%", "99%@90%")
RUNS = 200


def test_claims_are_read_as_probability_and_confidence() -> None:
    assert parse_claim("99.9%@95%")[:] == (pytest.approx(0.999), pytest.approx(0.95), None)
    assert parse_claim(" 99 % @ 90 % ")[:] == (0.99, 0.9, None)
    assert parse_claim("designs/a.toml>smith@95%")[:] == (0.5, 0.95, ("designs/a.toml", "smith"))


@pytest.mark.parametrize("text", ["99.9", "99.9%", "0.999@0.95", "100%@95%", "0%@95%", "99%@100%", "99%@49%", "9.9.9%@95%", "a>a@95%", ">a@95%", "nan%@95%"])  # fmt: skip
def test_a_wrong_claim_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"^until = .*"):
        parse_claim(text)


def test_without_a_failure_99_9_percent_takes_what_the_binomial_says() -> None:
    claim = parse_claim("99.9%@95%")
    assert claim.fewest == 2995  # the first n with 0.999^n <= 0.05
    test = SequentialTest(claim)
    while test.add(True) == "open":
        pass
    assert test.flights == ceil(log(0.025) / log(0.999)) == 3688
    short = SequentialTest(claim)
    for _ in range(2995):
        assert short.add(True) == "open"
    short.close()
    assert short.decision == "shown"
    assert short.lower_end() == pytest.approx(0.05 ** (1.0 / 2995), abs=1e-9)


def test_where_no_boundary_was_near_the_interval_is_clopper_and_pearsons() -> None:
    test = SequentialTest(parse_claim("99.99%@99.99%"))
    for success in (True,) * 9 + (False,) + (True,) * 10:
        assert test.add(success) == "open"
    assert test.interval() == pytest.approx(tuple(binomtest(19, 20).proportion_ci(0.95, "exact")), abs=1e-4)


def ends(test: SequentialTest) -> Iterator[tuple[SequentialTest, float]]:
    """Give every end of a study with the probability that it has at the claimed one."""
    going = [("open", RUNS, test._lowest + count, mass) for count, mass in enumerate(test._going)]
    stopped = [(kind, *end) for kind in ("shown", "refuted") for end in test._ends[kind]]
    for kind, flights, failures, probability in [*stopped, *going]:
        end = copy.copy(test)
        end.flights, end.failures = flights, failures
        end.decision = end._crossed = kind
        end._ends = {name: [each for each in known if each[0] <= flights] for name, known in test._ends.items()}
        end.close()
        yield end, float(probability)


@pytest.fixture(scope="module", params=CLAIMS)
def all_ends(request: pytest.FixtureRequest) -> tuple[float, float, list[tuple[Verdict, float]]]:
    """Every end of a study of 200 flights, the claimed probability of failure, and the error."""
    claim = parse_claim(request.param)
    test = SequentialTest(claim)
    for _ in range(RUNS):
        test._advance()
    found = [(of_course(end), probability) for end, probability in ends(test)]
    return 1.0 - claim.probability, claim.error, found


def of_course(course: SequentialTest) -> Verdict:
    """The verdict of flights that all have one."""
    test = ClaimTest(course.claim)
    test._worst = test._best = course
    test.flights, test.failures = course.flights, course.failures
    return test.verdict()


def weights(found: list[tuple[Verdict, float]], claimed: float, failing: float) -> list[float]:
    """Return the probability of each end when flights fail with ``failing``."""
    return [
        probability
        * (failing / claimed) ** verdict.failures
        * ((1.0 - failing) / (1.0 - claimed)) ** (verdict.flights - verdict.failures)
        for verdict, probability in found
    ]


@pytest.mark.parametrize("times", [0.2, 0.5, 1.0, 1.5, 1.9])
def test_ends_decisions_and_intervals_have_the_probabilities_that_they_state(
    all_ends: tuple[float, float, list[tuple[Verdict, float]]], times: float
) -> None:
    claimed, error, found = all_ends
    failing = claimed * times
    weight = weights(found, claimed, failing)
    assert sum(weight) == pytest.approx(1.0, abs=1e-9)
    decided = {
        kind: sum(each for (verdict, _), each in zip(found, weight, strict=True) if verdict.decision == kind)
        for kind in ("shown", "refuted")
    }
    if times >= 1.0:
        assert decided["shown"] <= error
    if times <= 1.0:
        assert decided["refuted"] <= error
    held = sum(
        each
        for (verdict, _), each in zip(found, weight, strict=True)
        if verdict.interval[0] - 1e-9 <= 1.0 - failing <= verdict.interval[1] + 1e-9
    )
    assert held >= 0.95
    bounded = sum(
        each
        for (verdict, _), each in zip(found, weight, strict=True)
        if (verdict.bound >= 1.0 - failing - 1e-9 if verdict.decision == "refuted" else verdict.bound <= 1.0 - failing + 1e-9)
    )  # fmt: skip
    assert bounded >= 1.0 - error  # whichever side the flights chose


def test_the_error_is_used_up(all_ends: tuple[float, float, list[tuple[Verdict, float]]]) -> None:
    claimed, error, found = all_ends
    weight = weights(found, claimed, claimed)
    shown = sum(each for (verdict, _), each in zip(found, weight, strict=True) if verdict.decision == "shown")
    if claimed > 0.05:  # of 99 % two hundred flights show nothing
        assert shown > 0.6 * error


@pytest.mark.long
def test_a_thousand_drawn_studies_are_held_by_their_intervals() -> None:
    random = np.random.default_rng(7)
    held = shown = 0
    for _ in range(1000):
        course = SequentialTest(parse_claim("90%@95%"))
        for success in random.random(400) >= 0.08:
            if course.add(bool(success)) != "open":
                break
        course.close()
        verdict = of_course(course)
        held += verdict.interval[0] <= 0.92 <= verdict.interval[1]
        shown += verdict.decision == "shown"
    assert held >= 935  # 950 less two standard deviations
    assert 50 < shown < 950  # both ends come


@pytest.mark.parametrize("order", [range(40), reversed(range(40))])
def test_flights_count_in_the_order_of_their_numbers(order: object) -> None:
    rule = StoppingRule(parse_claim("90%@95%"), ["smith"], 100)
    for number in list(order):
        rule.add(number, True)
    assert rule.is_finished
    assert rule.tests["smith"].flights == 36


def test_each_controller_has_a_test_and_the_study_ends_with_the_last() -> None:
    rule = StoppingRule(parse_claim("90%@95%"), ["smith", "baseline"], 100)
    draws = 0
    while not rule.is_finished:
        rule.add(2 * draws, True)
        rule.add(2 * draws + 1, draws % 2 == 0)
        draws += 1
    verdicts = {name: test.verdict().decision for name, test in rule.tests.items()}
    assert verdicts == {"smith": "shown", "baseline": "refuted"}
    assert draws == 36


def test_pairs_count_only_the_draws_that_differ() -> None:
    rule = StoppingRule(parse_claim("a>b@95%"), ["b", "a"], 1000)
    for draw in range(40):
        rule.add(2 * draw, draw % 4 > 0)  # b
        rule.add(2 * draw + 1, True)  # a
    verdict = rule.tests["a > b"].verdict()
    assert (verdict.decision, verdict.flights, verdict.failures) == ("shown", 6, 0)  # 0.5^6 < 0.025 < 0.5^5


def test_bounds_are_rounded_to_their_own_side() -> None:
    assert format_percent(0.99918804, up=False) == "99.918 %"
    assert format_percent(0.99918804, up=True) == "99.919 %"
    assert format_percent(1.0, up=True) == "100.0 %"
    assert format_percent(0.0, up=False) == "0.0 %"
    assert format_percent(0.4567, up=False) == "45.6 %"


def judge(text: str, verdicts: Iterable[bool | None], draws: int = 200) -> Verdict:
    """The verdict on one controller by these flights in turn, None: without a verdict, up to where it stops."""
    rule = StoppingRule(parse_claim(text), ["smith"], draws)
    for number, success in enumerate(verdicts):
        if rule.add(number, success):
            break
    assert rule.is_finished
    return rule.tests["smith"].verdict()


def test_flights_without_a_verdict_refute_nothing_and_show_nothing() -> None:
    never = judge("90%@95%", [None] * 200)
    assert (never.decision, never.failures, never.not_flown, never.interval) == ("open", 0, never.flights, (0.0, 1.0))
    assert judge("90%@95%", [False] * 200).decision == "refuted"
    half = judge("90%@95%", [True, None] * 100)  # half of them unknown: all others succeed
    assert half.decision == "open"
    assert half.bound < 0.9
    few = judge("90%@95%", [None, *[True] * 199])
    assert (few.decision, few.failures, few.not_flown, few.bound) == ("shown", 0, 1, 0.9)
    assert few.flights > judge("90%@95%", [True] * 200).flights  # it counts as a failure there
    bad = judge("90%@95%", [None, None, *[False] * 198])
    assert (bad.decision, bad.failures, bad.not_flown, bad.bound) == ("refuted", bad.flights - 2, 2, 0.9)


def test_a_pair_is_not_decided_by_draws_that_one_has_no_verdict_on() -> None:
    for a, b in ((None, False), (None, True), (False, None), (True, None), (None, None)):
        rule = StoppingRule(parse_claim("a>b@95%"), ["a", "b"], 100)
        for draw in range(100):
            rule.add(2 * draw, a)
            rule.add(2 * draw + 1, b)
        assert rule.tests["a > b"].decision == "open"


@pytest.mark.long
@pytest.mark.parametrize("unknown", [0.02, 0.1])
def test_no_claim_at_the_truth_is_decided_too_often_with_unknown_flights(unknown: float) -> None:
    """Whether the unknown ones would all have failed or all have succeeded, at the very probability of the claim."""
    random = np.random.default_rng(5)
    for truth, wrong in ((0.9 + unknown, "shown"), (0.9, "refuted")):  # of flights that are no failures
        decided = 0
        for _ in range(300):
            draws = random.random(150)
            flights = [None if x < unknown else bool(x < truth) for x in draws]
            decided += judge("90%@95%", flights, 150).decision == wrong
        assert decided <= 300 * 0.05 + 3.0 * (300 * 0.05 * 0.95) ** 0.5
