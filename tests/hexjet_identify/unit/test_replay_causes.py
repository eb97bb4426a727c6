"""One cause or two of a misfit, on residuals that are straight in the numbers: what is there is named, and no more."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.signal import lfilter

from cosim.base.frames import from_euler, multiply, rotate, to_euler
from hexjet_identify.replay import Choices
from hexjet_identify.replay.candidates import Cause, Exchange, Hypothesis, combine
from hexjet_identify.replay.causes import Causes, search_causes
from hexjet_identify.replay.flown import Change
from hexjet_identify.replay.gyro import euler_rates
from hexjet_identify.replay.measures import LEVEL, ChannelMeasures, Envelope, measure_bands, theil
from hexjet_identify.replay.misfit import Fitted, Part
from hexjet_identify.replay.replay import are_beyond, is_foreign
from hexjet_identify.replay.wind import level_part

WINDOWS, ROWS, CHANNELS = 8, 60, 2
NAMES = ("first", "second", "third", "fourth")
SWAPPED = Exchange("swapped", Change(order=(1, 0)))


def cause(name: str) -> Cause:
    return Cause(name, "", 1.0, 0.2, 5.0, 0.05, lambda value: Change(parameters={name: value}))


class Straight:
    """Residuals of unit noise, (w, n, c), that grow with what each number, or an exchange, is off by."""

    def __init__(self, seed: int, truth: dict[str, float], swapped: bool = False, other: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        shape = (WINDOWS, ROWS, CHANNELS)
        self._shapes = {name: 30.0 * rng.standard_normal(shape) for name in NAMES}
        self._swap = 5.0 * rng.standard_normal(shape)
        self._truth, self._swapped = truth, swapped
        self._rest = rng.standard_normal(shape) + other * rng.standard_normal(shape)
        self.floor = np.full(CHANNELS, float(ROWS))

    def movement(self) -> np.ndarray:
        return 30.0 * sum(self._shapes.values())

    def of(self, hypothesis: Hypothesis, values: Sequence[float] = ()) -> np.ndarray:
        parameters = hypothesis.change(values).parameters
        off = {name: self._truth.get(name, 1.0) - parameters.get(name, 1.0) for name in NAMES}
        left = self._rest + sum(off[name] * self._shapes[name] for name in NAMES)
        return left + (self._swap if self._swapped != (hypothesis.exchange is not None) else 0.0)


def searched(residuals: Straight) -> Causes:
    nominal = residuals.of(Hypothesis())
    told = np.ones(CHANNELS, bool)
    numbers = [cause(name) for name in NAMES]
    return search_causes(residuals, nominal, told, numbers, [SWAPPED], float(np.mean(nominal**2)))


@pytest.mark.parametrize("truth", [{"first": 1.3, "third": 0.8}, {"second": 1.2, "fourth": 1.1}])
def test_two_numbers_that_are_wrong_are_both_named(truth: dict[str, float]) -> None:
    for seed in range(3):
        (named,) = searched(Straight(seed, truth)).named
        assert {part.name for part in named.parts} == set(truth)
        for part in named.parts:
            assert part.value == pytest.approx(truth[part.name], abs=0.01)
            assert part.bound is not None
            assert part.bound < 0.01


def test_an_exchange_and_a_number_are_both_named() -> None:
    for seed in range(3):
        (named,) = searched(Straight(seed, {"second": 1.2}, swapped=True)).named
        assert [part.name for part in named.parts] == ["swapped", "second"]
        assert named.parts[1].value == pytest.approx(1.2, abs=0.01)


def test_one_cause_stays_one_though_more_is_left() -> None:
    """What no cause makes is left over; a second number would fit a part of it, and no window that is held back."""
    for seed in range(10):
        (named,) = searched(Straight(seed, {"first": 1.3}, other=2.0)).named
        assert named.name == "first"
        assert named.value == pytest.approx(1.3, abs=0.02)


def test_what_no_cause_makes_is_laid_on_none() -> None:
    for seed in range(10):
        result = searched(Straight(seed, {}, other=5.0))
        assert not result.named
        assert result.reason


def test_a_number_that_divides_is_found_in_one_step() -> None:
    """A step of Gauss and Newton in the inverse is exact where the motion goes with it; a large one ends at a bound."""
    inertia = Cause("inertia", "", 1.0, 0.2, 5.0, 0.05, lambda value: Change(), divides=True)
    for begin, truth in ((1.0, 0.7), (1.0, 1.3), (0.6, 2.0)):
        left, slope = 1.0 / truth - 1.0 / begin, 1.0 / begin**2  # of the residual: true less modelled
        assert inertia.moved(begin, -left / slope) == pytest.approx(truth)
    assert inertia.moved(1.0, 1.5) == inertia.high
    assert inertia.moved(1.0, -30.0) == inertia.low


def test_a_named_cause_beyond_the_tolerances_is_not_explained() -> None:
    """Though every channel is inside the envelope, which engines that are hardly known make wide."""

    def named(*parts: Part) -> Causes:
        return Causes(7.0, tuple(Fitted((part,), 1.0, np.zeros(3), np.zeros(3), 9.0, 0.0) for part in parts), (), "")

    usual = Choices()
    inertia = Part("moment of inertia about z", "", 0.7, 0.01, 1.0)
    little = Part("moment of inertia about z", "", 0.95, 0.01, 1.0)
    lag = Part("lag of the engines", "s", 0.12, 0.01, 0.1)
    assert are_beyond(named(inertia), usual, True)
    assert are_beyond(named(inertia), usual, False)
    assert not are_beyond(named(little), usual, False)
    assert are_beyond(named(lag), usual, False)
    assert not are_beyond(named(lag), usual, True)
    assert not are_beyond(named(inertia, lag), usual, True)
    assert are_beyond(named(Part("engines 1 and 2 swapped", "")), usual, True)
    assert not are_beyond(named(), usual, True)


def test_what_no_command_moves_is_foreign() -> None:
    """Not a model that is alike but too small, nor a thrust over mass that is off."""
    rng = np.random.default_rng(1)
    blown, flown = (x - x.mean(axis=1, keepdims=True) for x in rng.standard_normal((2, 20, 100)).cumsum(axis=2))

    def channel(measured: np.ndarray, modelled: np.ndarray, name: str = "rate_p") -> ChannelMeasures:
        bands = measure_bands(measured, modelled, 0.004, 0.01, np.zeros(3))
        return ChannelMeasures(name, "rad/s", 0.1, 1.0, 1.0, 0.01, theil(measured, modelled), bands, True)

    assert is_foreign(channel(blown, 0.01 * flown))
    assert not is_foreign(channel(blown, 0.4 * blown))
    assert not is_foreign(channel(blown, -0.4 * blown))
    assert not is_foreign(channel(blown, 0.01 * flown + 100.0, LEVEL))


def test_forces_are_turned_as_an_attitude_turns_them() -> None:
    rng = np.random.default_rng(1)
    for angles, force in zip(rng.uniform(-1.0, 1.0, (5, 3)), rng.standard_normal((5, 3)), strict=True):
        assert level_part(force, angles) == pytest.approx(rotate(from_euler(*angles), tuple(force))[:2])


def test_a_turn_is_the_sum_of_its_euler_rates() -> None:
    """The change of an attitude by a small turn about each body axis."""
    angles, small = np.array([0.3, -0.4, 0.9]), 1e-6
    for axis in np.eye(3):
        turned = multiply(from_euler(*angles), (1.0, *(0.5 * small * axis)))
        change = (np.array(to_euler(turned)) - angles) / small
        np.testing.assert_allclose(euler_rates(angles) @ axis, change, atol=1e-5)


def test_the_numbers_of_two_causes_multiply_and_add() -> None:
    one = Change(inertia=(1.1, 1.0, 1.0), thrust=2.0, jets={0: 2.0}, delay_s=0.01, parameters={"lag": 0.2})
    other = Change(inertia=(2.0, 3.0, 1.0), jets={0: 0.5, 1: 3.0}, delay_s=0.02, order=(1, 0), damping=0.5)
    both = combine([one, other])
    assert both.inertia == pytest.approx((2.2, 3.0, 1.0))
    assert (both.thrust, both.mass, both.damping, both.order) == (2.0, 1.0, 0.5, (1, 0))
    assert both.jets == {0: 1.0, 1: 3.0}
    assert both.delay_s == pytest.approx(0.03)
    assert both.parameters == {"lag": 0.2}
    assert combine([]) == Change()


def test_a_band_is_judged_by_its_own_envelope() -> None:
    """What is off at 15 Hz alone is outside there, and inside below 8 Hz; noise alone is inside 95 % of the time."""
    step, rows, noise = 0.004, 250, np.array([1.0])
    times = step * np.arange(rows)[None, :, None]
    rng = np.random.default_rng(1)
    measured = rng.standard_normal((40, rows, 1)) + 20.0 * np.sin(2.0 * np.pi * 15.0 * times)
    envelope = Envelope(np.zeros_like(measured), step, noise, np.zeros(1))
    _, low, middle, high = envelope.within(measured)[:, 0]
    assert low > 0.95  # without its line there is less of it
    assert middle == pytest.approx(0.954, abs=0.02)
    assert high < 0.2
    envelope.include(measured - 0.01)
    envelope.include(measured + 0.01)
    assert envelope.within(measured).min() == 1.0
    lag = 0.02
    slow = lfilter([1.0 - np.exp(-step / lag)], [1.0, -np.exp(-step / lag)], rng.standard_normal((80, rows)), axis=1)
    envelope = Envelope(np.zeros((80, rows, 1)), step, np.array([slow[:, 50:].std()]), np.array([lag]))
    np.testing.assert_allclose(envelope.within(slow[:, :, None])[2:, 0], 0.954, atol=0.02)
