"""Control laws against closed forms and scipy."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from cosim.base import frames
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.protocols import Predictor
from cosim.base.signals import Command, Measured, Unallocated
from cosim.control.allocation.allocation import TiltAllocator
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.predictors.smith import DelayLine, NoPredictor, SmithPredictor, rate_model
from cosim.control.rate import RateAxis
from cosim.spec.vehicle import AltitudeGains, AttitudeGains, Jet, RateGains, RateModel, load_vehicle

STEP = 0.004
VEHICLE, _ = load_vehicle("hexjet")
ROLL = VEHICLE.identified["edf-as-flown"]["roll"]
LIMITS = VEHICLE.control.allocation
HOVER = 0.45


def measured(attitude: tuple[float, float, float, float], height: float = 0.0, climb: float = 0.0) -> Measured:
    return Measured((0.0, 0.0, 0.0), attitude, (0.0, 0.0, -height), (0.0, 0.0, -climb), height)


def with_delay(model: RateModel, samples: int) -> RateModel:
    return model.model_copy(update={"delay_samples": samples})


angles = st.floats(-3.0, 3.0)
tilts = st.floats(-1.5, 1.5)


@given(angles, tilts, angles, angles, tilts, angles)
def test_attitude_error_is_the_rotation_between(r: float, p: float, y: float, a: float, b: float, c: float) -> None:
    """Against the axis and angle of the relative rotation: 2 sin(angle / 2) about the axis, the short way."""
    controller = AttitudeController(AttitudeGains(gain_1_s=(1.0, 1.0, 1.0), rate_limit_rad_s=(9.0, 9.0, 9.0)))
    now, wanted = frames.from_euler(r, p, y), frames.from_euler(a, b, c)
    w, *axis = frames.multiply(frames.conjugate(now), wanted)
    expected = 2.0 * np.array(axis) * (1.0 if w >= 0 else -1.0)
    ours = controller.update(Command((a, b, c), 0.0), measured(now))
    if abs(w) > 1e-9:  # at half a turn both ways are the short one
        assert ours == pytest.approx(expected, abs=1e-12)


def test_attitude_gain_and_limit_per_axis() -> None:
    controller = AttitudeController(AttitudeGains(gain_1_s=(2.0, 3.0, 4.0), rate_limit_rad_s=(0.5, 9.0, 9.0)))
    small, here = 1e-4, measured(frames.IDENTITY)
    rates = controller.update(Command((0.0, small, 0.0), 0.0), here)
    assert rates == pytest.approx((0.0, 3.0 * small, 0.0), rel=1e-6)
    assert controller.update(Command((-1.0, 0.0, 0.0), 0.0), here)[0] == -0.5
    assert controller.update(Command((1.0, 0.0, 0.0), 0.0, rate=(0.1, 0.2, 0.3)), here) == (0.1, 0.2, 0.3)


@given(angles, tilts, angles)
def test_attitude_loop_comes_to_rest_at_the_setpoint(r: float, p: float, y: float) -> None:
    """With ideal rates the error angle decays, from anywhere short of half a turn."""
    controller = AttitudeController(AttitudeGains(gain_1_s=(3.0, 3.0, 3.0), rate_limit_rad_s=(9.0, 9.0, 9.0)))
    q = frames.from_euler(r, p, y)
    command = Command((0.3, -0.2, 0.1), 0.0)
    for _ in range(2000):
        wx, wy, wz = controller.update(command, measured(q))
        q = frames.normalize(frames.multiply(q, (1.0, 0.5 * STEP * wx, 0.5 * STEP * wy, 0.5 * STEP * wz)))
    assert frames.to_euler(q) == pytest.approx(command.attitude, abs=1e-6)


def axis(
    p: float = 0.0, i: float = 0.0, d: float = 0.0, predictor: Predictor | None = None, limit: float = 10.0
) -> RateAxis:
    gains = RateGains(p=p, i=i, d=d, d_filter_s=0.02, integral_limit=limit)
    return RateAxis(gains, predictor or NoPredictor(), STEP)


def test_pid_is_the_difference_equation() -> None:
    """Against scipy's filters for each of the three terms."""
    rng = np.random.default_rng(1)
    setpoint, rate = rng.standard_normal((2, 300))
    share = STEP / (0.02 + STEP)
    error = setpoint - rate
    slope = lfilter([share / STEP, -share / STEP], [1.0, share - 1.0], rate - rate[0])
    expected = 0.7 * error + 0.3 * STEP * np.cumsum(error) - 0.05 * slope
    block = axis(0.7, 0.3, 0.05)
    ours = [block.update(float(s), float(y), 0.0) for s, y in zip(setpoint, rate, strict=True)]
    assert ours == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_integral_stops_against_a_refusal_and_runs_away_from_it() -> None:
    block = axis(i=1.0)
    for _ in range(10):
        block.update(1.0, 0.0, 0.0)
    held = block.update(1.0, 0.0, 0.5)
    assert held == block.update(1.0, 0.0, 0.5)
    assert block.update(-1.0, 0.0, 0.5) < held


def test_integral_is_limited() -> None:
    block = axis(i=100.0, limit=0.2)
    assert [block.update(1.0, 0.0, 0.0) for _ in range(10)][-1] == 0.2


@given(st.integers(0, 60), st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=200))
def test_delay_line_shifts_by_whole_samples(samples: int, values: list[float]) -> None:
    line = DelayLine(samples)
    assert [line.update(v) for v in values] == ([0.0] * samples + values)[: len(values)]
    line.reset()
    assert line.update(1.0) == (0.0 if samples else 1.0)


def test_model_is_the_papers_transfer_function() -> None:
    """Against scipy's filter of 0.0689 (z + 1.4538) / ((z - 0.9999)(z - 0.9024)), delay left out."""
    u = np.random.default_rng(2).standard_normal(500)
    expected = lfilter(0.0689 * np.array([0.0, 1.0, 1.4538]), np.convolve([1.0, -0.9999], [1.0, -0.9024]), u)
    model = rate_model(ROLL)
    model.update(0.0)
    # our update takes u_k-1 and gives y_k
    ours = [model.update(float(v)) for v in u]
    assert ours[:-1] == pytest.approx(expected[1:], rel=1e-11, abs=1e-12)


class Plant:
    """The identified roll response as a plant: command in, rate out, ``samples`` late, gain scaled."""

    def __init__(self, samples: int, gain: float = 1.0) -> None:
        self._model = rate_model(ROLL.model_copy(update={"gain": ROLL.gain * gain}))
        self._line = DelayLine(samples)

    def update(self, command: float) -> float:
        return self._line.update(self._model.update(command))


def closed_loop(
    predictor: Predictor, samples: int, steps: int, p: float = 0.02, gain: float = 1.0
) -> tuple[list[float], list[float], list[float]]:
    """Set-point 1 rad/s from rest: command, rate, and the rate fed back."""
    plant, block = Plant(samples, gain), axis(p, 0.02, predictor=predictor)
    rate, commands, rates, fed = 0.0, [], [], []
    for _ in range(steps):
        command = block.update(1.0, rate, 0.0)
        fed.append(block.predicted)
        commands.append(command)
        rates.append(rate)
        rate = plant.update(command)
    return commands, rates, fed


@pytest.mark.parametrize("samples", [1, 7, 25, 60])
def test_smith_feeds_back_the_delay_free_plant(samples: int) -> None:
    """Perfect model: the loop is the delay-free one, to 1e-12, and the true rate follows ``samples`` later."""
    commands, rates, fed = closed_loop(SmithPredictor(with_delay(ROLL, samples)), samples, 1500)
    free_commands, free_rates, _ = closed_loop(NoPredictor(), 0, 1500)
    assert fed == pytest.approx(free_rates, abs=1e-12)
    assert commands == pytest.approx(free_commands, abs=1e-12)
    assert rates[samples:] == pytest.approx(free_rates[:-samples], abs=1e-12)


def test_smith_without_delay_is_the_baseline_bit_for_bit() -> None:
    assert closed_loop(SmithPredictor(with_delay(ROLL, 0)), 0, 1500) == closed_loop(NoPredictor(), 0, 1500)


def test_smith_predicts_from_the_command_that_was_applied() -> None:
    """A command that saturates: the fed-back rate is the delay-free plant's under what was applied, not what was asked."""
    samples, most = 25, 0.01
    plant, free = Plant(samples), rate_model(ROLL)
    block = axis(0.02, 0.02, predictor=SmithPredictor(with_delay(ROLL, samples)))
    rate = refused = last = 0.0
    for _ in range(600):
        command = block.update(1.0, rate, refused)
        assert block.predicted == pytest.approx(free.update(last), abs=1e-12)
        last = max(-most, min(most, command))
        refused = command - last
        rate = plant.update(last)
    assert block.predicted > 0.5


def loop_poles(model_delay: int, plant_delay: int, p: float, i: float, gain: float) -> np.ndarray:
    """Closed-loop poles with PI and a Smith predictor whose delay or gain is wrong.
    The roots of ``D + C N (gain z^-n + 1 - z^-h)``, the paper's characteristic equation before its perfect-model
    cancellation, over the common power of z."""
    denominator = np.convolve([1.0, -0.9999], [1.0, -0.9024])
    numerator = 0.0689 * np.array([1.0, 1.4538])
    shift = max(plant_delay, model_delay)
    mismatch = np.zeros(shift + 1)
    mismatch[0] += 1.0
    mismatch[model_delay] -= 1.0
    mismatch[plant_delay] += gain
    with_integrator = np.convolve([1.0, -1.0], denominator)
    pi_numerator = np.array([p + i * STEP, -p])
    delayed = np.convolve(with_integrator, [1.0] + [0.0] * shift)
    return np.roots(np.polyadd(delayed, np.convolve(np.convolve(pi_numerator, numerator), mismatch)))


@pytest.mark.parametrize(
    ("plant_delay", "gain"), [(25, 1.0), (30, 1.0), (20, 1.0), (45, 1.0), (60, 1.0), (25, 1.8), (2, 1.0)]
)
def test_a_wrong_model_degrades_as_the_poles_say(plant_delay: int, gain: float) -> None:
    """The growth or decay of the loop over many seconds is that of its largest pole."""
    p, i = 0.02, 0.02
    poles = loop_poles(25, plant_delay, p, i, gain)
    largest = float(max(abs(poles)))
    n = 6000
    _, rates, _ = closed_loop(SmithPredictor(ROLL), plant_delay, n, p, gain)
    deviation = np.abs(np.array(rates) - 1.0)
    early, late = deviation[1500:2500].max(), deviation[-1000:].max()
    if largest > 1.0:
        assert late > early
        assert (late / early) ** (1 / (n - 2500)) == pytest.approx(largest, rel=1e-3)
    else:
        assert late < early or late < 1e-6


ALLOCATOR = TiltAllocator(VEHICLE.jets, LIMITS, VEHICLE.servo.range_rad, HOVER)


@given(st.floats(-2.0, 3.0), st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_allocation_stays_inside_and_accounts_for_all(collective: float, roll: float, pitch: float, yaw: float) -> None:
    throttle, tilt, refused = ALLOCATOR.allocate(collective, (roll, pitch, yaw))[:3]
    assert all(LIMITS.throttle_min - 1e-15 <= t <= LIMITS.throttle_max + 1e-15 for t in throttle)
    assert all(abs(t) <= VEHICLE.servo.range_rad * (1 + 1e-15) for t in tilt)
    left, right = throttle[1], throttle[0]
    mean = 0.5 * (left + right)
    share = max(0.25, mean / HOVER)
    # achieved plus refused is what was asked; pitch up tilts back, for the jets stand above the centre of gravity
    assert mean + refused.collective == pytest.approx(collective, abs=1e-12)
    assert 0.5 * (left - right) + refused.roll == pytest.approx(roll, abs=1e-12)
    assert -0.5 * (tilt[0] + tilt[1]) * share + refused.pitch == pytest.approx(pitch, abs=1e-12)
    assert 0.5 * (tilt[0] - tilt[1]) * share + refused.yaw == pytest.approx(yaw, abs=1e-12)


def test_what_fits_is_not_refused_at_all() -> None:
    for roll, pitch, yaw in ((0.1, 0.05, -0.03), (-0.2, 0.1, 0.1)):
        assert ALLOCATOR.allocate(HOVER, (roll, pitch, yaw)).unallocated == Unallocated()


def test_attitude_before_collective() -> None:
    """Full climb and a roll: the roll is given whole, the collective gives way."""
    throttle, _, refused = ALLOCATOR.allocate(1.0, (0.2, 0.0, 0.0))[:3]
    assert refused == Unallocated(0.0, 0.0, 0.0, pytest.approx(0.2))
    assert throttle[1] == 1.0
    assert throttle[0] == pytest.approx(0.6)
    assert ALLOCATOR.allocate(0.0, (0.2, 0.0, 0.0)).unallocated.roll == 0.0


def test_pitch_is_allocated_before_yaw() -> None:
    limit = VEHICLE.servo.range_rad
    _, tilt, refused = ALLOCATOR.allocate(HOVER, (0.0, 2 * limit, 0.1))[:3]
    assert tilt == pytest.approx((-limit, -limit))
    assert refused.pitch == pytest.approx(limit)
    assert refused.yaw == 0.1


def test_torque_commands_turn_the_right_way() -> None:
    """Signs against r x F: positive roll is right side down, positive pitch nose up, positive yaw nose right."""
    for axis_index, torque in enumerate(((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))):
        throttle, (left, right) = ALLOCATOR.allocate(HOVER, torque)[:2]
        moment = np.zeros(3)
        for jet, t in zip(VEHICLE.jets, throttle, strict=True):
            a = left if jet.servo == "left" else right
            moment += np.cross(jet.position_m, t * np.array([sin(a), 0.0, -cos(a)]))
        assert moment[axis_index] > 0.0
        assert np.abs(np.delete(moment, axis_index)).max() < 1e-9


def test_banks_on_the_wrong_side_are_refused() -> None:
    jets = [Jet(position_m=(0.0, 0.1, -0.1), servo="left"), *VEHICLE.jets[1:]]
    with pytest.raises(InputError, match="not on its side"):
        TiltAllocator(jets, LIMITS, 0.5, HOVER)
    flat = [Jet(position_m=(j.position_m[0], j.position_m[1], 0.0), servo=j.servo) for j in VEHICLE.jets]
    with pytest.raises(InputError, match="no pitch"):
        TiltAllocator(flat, LIMITS, 0.5, HOVER)


def altitude(integral: float = 0.0) -> AltitudeController:
    limits = {"climb_limit_m_s": 2.0, "descent_limit_m_s": 1.0, "integral_limit_m_s2": 3.0}
    gains = AltitudeGains(position_1_s=1.0, velocity_1_s=2.0, integral_1_s2=integral, **limits)
    return AltitudeController(gains, 5.0, lambda thrust: thrust / 100.0, STEP)


@pytest.mark.parametrize(
    ("target", "lean", "expected"),
    [
        (10.0, 0.0, 5.0 * GRAVITY / 100),  # hover: the weight
        (10.0, 0.5, 5.0 * GRAVITY / 100 / cos(0.5)),  # over the lean
        (10.0, pi, 5.0 * GRAVITY / 100 / 0.5),  # upside down
        (1000.0, 0.0, 5.0 * (GRAVITY + 4.0) / 100),  # climb and descent are limited
        (-1000.0, 0.0, 5.0 * (GRAVITY - 2.0) / 100),
    ],
)
def test_thrust_is_that_of_weight_lean_and_climb(target: float, lean: float, expected: float) -> None:
    command, here = Command((0.0, 0.0, 0.0), target), measured(frames.from_euler(lean, 0.0, 0.0), 10.0)
    assert altitude().update(command, here, Unallocated()) == pytest.approx(expected)
    assert altitude().update(command._replace(collective=0.33), here, Unallocated()) == 0.33


def test_altitude_integral_stops_when_the_collective_is_refused() -> None:
    block, command = altitude(integral=1.0), Command((0.0, 0.0, 0.0), 11.0)
    before = block.update(command, measured(frames.IDENTITY, 10.0), Unallocated(collective=0.1))
    assert block.update(command, measured(frames.IDENTITY, 10.0), Unallocated(collective=0.1)) == before
    assert block.update(command, measured(frames.IDENTITY, 10.0), Unallocated()) > before


def test_burnt_fuel_need_not_be_carried() -> None:
    block, command = altitude(), Command((0.0, 0.0, 0.0), 10.0)
    ours = block.update(command, measured(frames.IDENTITY, 10.0), Unallocated(), burnt=2.0)
    assert ours == pytest.approx((5.0 - 2.0) * GRAVITY / 100)
