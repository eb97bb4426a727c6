"""What the autopilot flies with when sensors fail: against exact motion, against scipy's filter, against chance."""

from __future__ import annotations

from math import cos, radians, sin, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from cosim.base.constants import GRAVITY
from cosim.base.frames import conjugate, from_euler, multiply
from cosim.base.signals import Measured, Quaternion, Vector3
from cosim.control.autopilot.estimation.estimator import Estimator
from cosim.spec.vehicle import Sensors, load_vehicle

STEP = 0.004
LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)
VEHICLE = load_vehicle("hexjet")[0]
STATED = VEHICLE.sensors
PERIOD = STATED.gnss.period_samples


def sensors(**changes: dict[str, Any]) -> Sensors:
    data = STATED.model_dump()
    for name, values in changes.items():
        data[name] |= values
    return Sensors.model_validate(data)


def estimator(
    stated: Sensors = STATED, height: float = 0.0, rate: float = 0.0, attitude: Quaternion = LEVEL
) -> Estimator:
    one = Estimator(stated, VEHICLE.control.position, STEP, 3.5, True)
    one.reset(Measured((0.0,) * 3, attitude, (0.0,) * 3, (0.0, 0.0, -rate), height, (0.0, 0.0, -GRAVITY)))
    return one


def motion(one: Estimator) -> tuple[float, float]:
    """Height and climb rate."""
    return one.altitude, -one.now.velocity[2]


class Vertical:
    """A body that moves up and down, and the sensors that see it exactly unless told otherwise."""

    def __init__(self, stated: Sensors = STATED, height: float = 10.0) -> None:
        self.one = estimator(stated, height)
        self.h, self.v, self.k = height, 0.0, 0
        self.late = stated.gnss.latency_samples
        self.past = [(height, 0.0)] * (self.late + 1)
        self.fix = (height, 0.0)
        self.dither = 0.0  # so that a working sensor never says the same twice

    def fly(self, seconds: float, acceleration: float = 0.0, **said: Any) -> None:
        """``said``: what a sensor says instead: altitude, fix, force (None: as it is), and bias on the force."""
        for _ in range(round(seconds / STEP)):
            self.h += STEP * self.v + 0.5 * STEP * STEP * acceleration
            self.v += STEP * acceleration
            self.k += 1
            self.dither = 1e-9 * (self.k % 7)
            self.past = [*self.past[1:], (self.h, self.v)]
            if (self.k - self.late) % PERIOD == 0:
                self.fix = (self.past[0][0] + self.dither, self.past[0][1])
            height, rate = said.get("fix") or self.fix
            lift = acceleration + GRAVITY + said.get("bias", 0.0) + self.dither
            force = said.get("force") or (0.0, 0.0, -lift)
            altitude = said["altitude"] if "altitude" in said else self.h + self.dither + said.get("off", 0.0)
            measured = Measured((0.0, 0.0, 0.0), LEVEL, (0.0, 0.0, -height), (0.0, 0.0, -rate), altitude, force)
            self.one.update(self.k, measured, still=False, has_contact=said.get("contact", False))


@pytest.fixture
def w() -> Vertical:
    return Vertical()


def test_exact_sensors_give_the_exact_motion(w: Vertical) -> None:
    """Held acceleration is what the model integrates exactly, up and down, through the receiver's latency."""
    for acceleration in (1.0, -2.0, 0.5):
        w.fly(1.0, acceleration)
        assert motion(w.one) == pytest.approx((w.h, w.v), abs=1e-6)


@pytest.mark.parametrize("receiver", [False, True])
def test_the_gains_settle_where_the_riccati_equation_does(receiver: bool) -> None:
    """scipy's solution of the same problem, with the barometer alone and with a receiver at every step."""
    one = estimator(sensors(gnss={"latency_samples": 0, "period_samples": 1}), 10.0)
    for k in range(1, 9001):
        news = 1e-9 * (k % 7)
        said = news if receiver else 0.0
        fix = (0.0, 0.0, -10.0 + said), (0.0, 0.0, said)
        measured = Measured((0.0, 0.0, 0.0), LEVEL, *fix, 10.0 + news, (0.0, 0.0, -GRAVITY - news))
        one.update(k, measured, still=False)
    F = np.array([[1.0, STEP, 0.5 * STEP**2], [0.0, 1.0, STEP], [0.0, 0.0, 1.0]])
    G = np.array([[0.5 * STEP**2], [STEP], [0.0]])
    Q = G @ G.T * 0.05**2 + np.diag([0.0, 0.0, 0.001**2 * STEP])
    H = np.eye(2, 3) if receiver else np.eye(1, 3)
    R = np.diag([0.01**2, 0.02**2])[: len(H), : len(H)]
    prior = solve_discrete_are(F.T, H.T, Q, R)
    K = prior @ H.T @ np.linalg.inv(H @ prior @ H.T + R)
    f = one.vertical
    P = np.array([[f.pp, f.pv, f.pu], [f.pv, f.vv, f.vu], [f.pu, f.vu, f.uu]])
    assert pytest.approx((np.eye(3) - K @ H) @ prior, rel=1e-4) == P


def test_the_bias_of_the_accelerometer_is_found(w: Vertical) -> None:
    w.fly(20.0, bias=0.2)
    assert -w.one.vertical.u.real == pytest.approx(0.2, abs=0.002)
    assert motion(w.one) == pytest.approx((w.h, w.v), abs=0.005)


def test_a_barometer_that_stops_is_noticed_and_left_out(w: Vertical) -> None:
    """The receiver holds the height; its 0.3 m are what the height is then known to."""
    w.fly(35.0)
    w.fly(0.2, altitude=w.h)
    assert not w.one.has_height
    frozen = w.h
    w.fly(2.0, -0.5, altitude=frozen)
    w.fly(3.0, altitude=frozen)
    assert motion(w.one) == pytest.approx((w.h, w.v), abs=0.02)
    assert w.h < frozen - 3.0
    assert w.one.vertical.deviation[1] < 0.03
    w.fly(0.5)
    assert w.one.has_height


def test_a_receiver_that_stops_changes_nothing_while_the_barometer_works(w: Vertical) -> None:
    """What crashed vehicles: the climb rate of a receiver that repeats itself."""
    w.fly(5.0)
    w.fly(1.2, -0.5, fix=w.fix)
    assert not w.one.has_fix
    w.fly(5.0, fix=w.fix)
    assert motion(w.one) == pytest.approx((w.h, w.v), abs=0.01)
    assert w.one.vertical.deviation[1] < 0.01


def test_with_neither_the_accelerometer_carries_on_and_says_how_sure_it_is(w: Vertical) -> None:
    w.fly(35.0)
    sure = w.one.vertical.deviation
    w.fly(30.0, -0.03, altitude=w.h, fix=w.fix)
    assert motion(w.one) == pytest.approx((w.h, w.v), abs=0.2)
    assert w.one.vertical.deviation[0] > 0.5 > 10.0 * sure[0]
    assert 0.05 < w.one.vertical.deviation[1] < 0.3


def test_an_accelerometer_that_stops_is_not_believed(w: Vertical) -> None:
    w.fly(5.0)
    w.fly(0.2, force=(0.0, 0.0, -GRAVITY))
    assert not w.one.has_force
    w.fly(1.0, -0.5, force=(0.0, 0.0, -GRAVITY))
    w.fly(3.0, force=(0.0, 0.0, -GRAVITY))
    assert motion(w.one) == pytest.approx((w.h, w.v), abs=0.05)
    assert w.one.vertical.deviation[1] > 0.015


def test_a_barometer_that_jumps_is_not_believed_until_it_is_right_again(w: Vertical) -> None:
    w.fly(35.0)
    w.fly(0.6, off=1.0)
    assert not w.one.has_height
    w.fly(3.0, off=1.0)
    assert w.one.altitude == pytest.approx(w.h, abs=0.05)
    w.fly(1.1)
    assert w.one.has_height


def test_the_force_of_a_contact_does_not_outweigh_the_barometer() -> None:
    """Legs that chatter at hover thrust are sampled 0.7 m/s^2 too light, and a sound barometer was called lost."""
    stated = sensors(barometer={"noise_m": 0.01})
    air, ground = Vertical(stated), Vertical(stated)
    for body in (air, ground):
        # Until the bias is known well.
        body.fly(20.0)
        body.fly(1.5, bias=-0.7, contact=body is ground)
    assert not air.one.has_height
    assert ground.one.has_height
    assert ground.one.altitude == pytest.approx(10.0, abs=0.01)
    assert -ground.one.now.velocity[2] == pytest.approx(0.0, abs=0.15)


def test_the_deviation_is_the_errors_own() -> None:
    """A hundred flights with the stated noise, two seconds of which without barometer and receiver.
    The standard deviation of a hundred errors is within 25 % of the true one in 999 of 1000 cases."""
    errors, stated = [], []
    for seed in range(100):
        random = np.random.default_rng(seed)
        w = estimator(STATED, 10.0 + 0.01 * random.standard_normal(), 0.02 * random.standard_normal())
        bias = 0.05 * random.standard_normal()
        last = 10.0
        for k in range(1, 1251):
            force = (0.0, 0.0, -GRAVITY - bias + 0.05 * random.standard_normal())
            if k <= 750:
                last = 10.0 + 0.01 * random.standard_normal()
            measured = Measured((0.0, 0.0, 0.0), LEVEL, (0.0, 0.0, -10.0), (0.0, 0.0, 0.0), last, force)
            w.update(k, measured, still=False)
        height, rate = motion(w)
        errors.append((height - 10.0, rate))
        stated.append(w.vertical.deviation)
    for column in (0, 1):
        found = sqrt(float(np.mean(np.square([error[column] for error in errors]))))
        assert found == pytest.approx(float(np.mean([each[column] for each in stated])), rel=0.25)


class Turning:
    """A body that rolls, and exact sensors: the gyro through its own filter, as the suite has it."""

    def __init__(self) -> None:
        self.one = estimator()
        self.angle = self.rate = self.filtered = 0.0
        self.k = 0
        self.seen: tuple[Quaternion, Vector3] = (LEVEL, (0.0, 0.0, 0.0))

    def turn(self, seconds: float, bias: float = 0.0, off: float = 0.0, **said: Any) -> None:
        share = 1.0 - np.exp(-STEP / STATED.gyro.filter_s)
        for _ in range(round(seconds / STEP)):
            self.k += 1
            before, self.rate = self.rate, 0.5 * sin(3.0 * self.k * STEP)
            self.angle += 0.5 * STEP * (before + self.rate)
            self.filtered += float(share) * (self.rate - self.filtered)
            true = from_euler(self.angle + off, 1e-9 * (self.k % 5), 0.0)
            rate = (self.filtered + bias, 1e-9 * (self.k % 7), 0.0)
            measured = Measured(said.get("gyro") or rate, said.get("attitude") or true, (0.0,) * 3, (0.0,) * 3, 0.0)
            seen = self.one.update(self.k, measured, still=False)
            self.seen = seen.attitude, seen.rate

    def error(self) -> float:
        """rad about x, of the attitude that it flies with."""
        return 2.0 * multiply(conjugate(from_euler(self.angle, 0.0, 0.0)), self.seen[0])[1]


@pytest.fixture
def t() -> Turning:
    turning = Turning()
    turning.turn(5.0)
    return turning


def test_an_attitude_that_stops_goes_on_by_the_gyro(t: Turning) -> None:
    """Exactly so: the gyro's filter is undone, and the rate between two samples is their mean."""
    t.turn(20.0, attitude=from_euler(t.angle, 0.0, 0.0))
    assert not t.one.has_attitude
    assert t.error() == pytest.approx(0.0, abs=2e-4)
    t.turn(1.0)
    assert t.one.has_attitude


def test_a_gyro_that_becomes_biased_is_found_and_corrected(t: Turning) -> None:
    bias = radians(3.0)
    t.turn(1.5, bias=bias)
    assert t.one.is_biased
    assert t.one.gyro_bias[0] == pytest.approx(bias, abs=0.002)
    assert t.seen[1][0] == pytest.approx(t.filtered, abs=0.002)
    assert t.one.has_attitude
    # and a lost attitude is then carried on without it
    t.turn(5.0, bias=bias)
    t.turn(10.0, attitude=from_euler(t.angle, 0.0, 0.0), bias=bias)
    assert t.error() == pytest.approx(0.0, abs=0.01)


def test_an_attitude_that_jumps_is_not_believed_and_no_bias_is_made_of_it(t: Turning) -> None:
    t.turn(2.0, off=radians(3.0))
    assert not t.one.has_attitude
    assert t.error() == pytest.approx(0.0, abs=1e-3)
    assert max(map(abs, t.one.gyro_bias)) < 1e-3
    t.turn(0.1)
    assert t.one.has_attitude


def test_without_a_gyro_the_rate_is_that_of_the_attitude(t: Turning) -> None:
    """Late by a few hundredths of a second: half a radian a second at 3 rad/s changes by 0.015 in a hundredth."""
    t.turn(5.0, gyro=(0.1, 0.0, 0.0))
    assert not t.one.has_rate
    assert t.seen[1][0] == pytest.approx(t.rate, abs=0.1)
    assert t.seen[0] != LEVEL
    t.turn(1.0)
    assert t.one.has_rate
    assert t.seen[1][0] == pytest.approx(t.filtered, abs=0.01)


def test_nothing_is_wrong_where_nothing_moves() -> None:
    """Without noise, standing: every sensor repeats itself, and none has failed."""
    one = estimator()
    rest = Measured((0.0, 0.0, 0.0), LEVEL, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.125, (0.0, 0.0, -GRAVITY))
    one.reset(rest)
    for k in range(1, 1000):
        seen = one.update(k, rest, still=k % 2 == 0)
        assert one.failures == ()
    assert (seen.altitude, seen.velocity[2]) == pytest.approx((0.125, 0.0), abs=1e-3)
    assert one.lift == pytest.approx(1.0, abs=1e-6)


def test_a_lean_does_not_climb() -> None:
    """Specific force along the body, turned upright: thrust that holds the weight at a lean of 30 deg."""
    lean = radians(30.0)
    attitude = from_euler(lean, 0.0, 0.0)
    one = estimator(height=10.0, attitude=attitude)
    for k in range(1, 500):
        news = 1e-9 * (k % 7)
        force = (0.0, 0.0, -GRAVITY / cos(lean) + news)
        one.update(k, Measured((0.0,) * 3, attitude, (0.0, 0.0, -10.0), (0.0,) * 3, 10.0 + news, force), False)
    assert one.lift == pytest.approx(1.0, abs=1e-6)
    assert one.now.velocity[2] == pytest.approx(0.0, abs=1e-6)
