"""Position control: the set-point's kinematics, the estimator, the linear loop's margins."""

from __future__ import annotations

from math import cos, hypot, pi, sin, sqrt

import control as ct
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from cosim.base.constants import GRAVITY
from cosim.base.frames import IDENTITY, from_euler, rotate
from cosim.base.signals import Measured
from cosim.control.autopilot.estimation.position import Fix, PositionEstimator
from cosim.control.autopilot.estimation.position_gains import settling_gains
from cosim.control.autopilot.geometry import lean_acceleration, lean_from_acceleration, wrap
from cosim.control.autopilot.guidance.position_control import PositionController
from cosim.control.autopilot.guidance.tracker import Track, Tracker
from cosim.control.lead import lead_polynomials
from cosim.control.predictors.smith import polynomial
from cosim.spec.vehicle import EngineLead, Vehicle, load_vehicle

DT = 0.004
VEHICLE, _ = load_vehicle("hexjet")
GAINS = VEHICLE.control.position
assert GAINS is not None
SENSORS = VEHICLE.sensors
SENSOR = SENSORS.gnss


def fly(tracker: Tracker, target: tuple[float, float], speed: float, most: int = 100_000) -> list[Track]:
    """The set-points until they rest at the target."""
    tracks = []
    for _ in range(most):
        tracks.append(tracker.towards(target, speed))
        if hypot(tracks[-1].position[0] - target[0], tracks[-1].position[1] - target[1]) < 1e-9:
            return tracks
    raise AssertionError(f"not at {target} after {most} steps: {tracks[-1]}")


@pytest.mark.parametrize(("distance", "speed", "a", "jerk"), [(30.0, 4.0, 1.5, 1.5), (8.0, 2.0, 1.0, 4.0)])
def test_time_to_reach_is_that_of_the_closed_form(distance: float, speed: float, a: float, jerk: float) -> None:
    """d/v + v/2a + v/2b + a/j, b = 0.75 a, to the few steps by which its parts are not whole numbers of steps."""
    tracker = Tracker(a, jerk, DT)
    tracks = fly(tracker, (distance * 0.6, -distance * 0.8), speed)
    expected = distance / speed + speed / (2 * a) + speed / (1.5 * a) + a / jerk
    assert len(tracks) * DT == pytest.approx(expected, abs=4 * DT)
    v = np.array([track.velocity for track in tracks])
    assert np.max(np.hypot(*v.T)) == pytest.approx(speed, rel=1e-9)
    # a straight line, and never past its end
    p = np.array([track.position for track in tracks])
    assert np.max(np.abs(p @ [0.8, 0.6])) < 1e-9
    assert np.max(p @ [0.6, -0.8]) <= distance + 1e-9


def test_a_distance_too_short_for_the_speed_peaks_below_it() -> None:
    """v_peak^2 (1/2a + 1/2b) = d before the mean; the mean of a triangle over w lowers its peak by less than a w / 2."""
    a, b, d = 1.5, 1.125, 2.0
    tracks = fly(Tracker(a, 15.0, DT), (d, 0.0), 50.0)
    peak = sqrt(d / (0.5 / a + 0.5 / b))
    assert peak - 0.5 * a * 0.1 < max(track.velocity[0] for track in tracks) < peak + a * DT
    assert len(tracks) * DT == pytest.approx(peak / a + peak / b + 0.1, abs=4 * DT)


place = st.tuples(st.floats(-50, 50), st.floats(-50, 50))


@settings(max_examples=25)
@given(place, place, st.integers(1, 3000), st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
@example((50.0, 0.0), (0.0, 0.0), 1500, (5.0, 5.0))
def test_limits_hold_for_any_change_of_target(first: tuple, second: tuple, when: int, start: tuple) -> None:
    """Speed, acceleration and jerk stay within their limits, whatever is asked for and when, and it arrives."""
    a, jerk, speed = 1.5, 3.0, 4.0
    tracker = Tracker(a, jerk, DT)
    tracker.start((0.0, 0.0), start)
    tracks = [Track((0.0, 0.0), start, (0.0, 0.0)), *(tracker.towards(first, speed) for _ in range(when))]
    tracks += fly(tracker, second, speed)
    p, v, acc = (np.array([getattr(t, name) for t in tracks]) for name in ("position", "velocity", "acceleration"))
    assert np.max(np.hypot(*v.T)) <= max(speed, hypot(*start)) + 1e-9
    assert np.max(np.hypot(*acc.T)) <= a * (1 + 1e-9)
    # the mean's window is a whole number of steps, at least a / jerk long; the change of a vector of length a is up to 2 a
    assert np.max(np.hypot(*np.diff(acc, axis=0).T)) / DT <= 2 * jerk * (1 + 1e-9)
    # position, velocity and acceleration are one motion
    np.testing.assert_allclose(np.diff(p, axis=0) / DT, v[1:], atol=1e-9)
    np.testing.assert_allclose(np.diff(v, axis=0) / DT, acc[1:], atol=1e-9)


def test_a_stop_stays_where_it_stops() -> None:
    tracker = Tracker(1.5, 1.5, DT)
    tracker.start((3.0, 4.0), (2.0, 0.0))
    for _ in range(2000):
        track = tracker.at_velocity((0.0, 0.0))
    assert track.velocity == pytest.approx((0.0, 0.0), abs=1e-12)
    # v^2 / 2 a of braking, and v times half the mean's window before that
    assert track.position == pytest.approx((3.0 + 4.0 / 3.0 + 0.5 * 2.0, 4.0), abs=2 * 2.0 * DT)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-pi, pi))
def test_lean_and_acceleration_are_inverse(north: float, east: float, yaw: float) -> None:
    roll, pitch = lean_from_acceleration((north, east), yaw)
    q = from_euler(roll, pitch, yaw)
    assert lean_acceleration(q) == pytest.approx((north, east), abs=1e-9)
    # thrust along -z that carries the weight pushes just so
    x, y, z = rotate(q, (0.0, 0.0, -1.0))
    assert (x * GRAVITY / -z, y * GRAVITY / -z) == pytest.approx((north, east), abs=1e-9)


@pytest.mark.parametrize(
    ("angle", "wrapped"), [(pi, -pi), (-pi, -pi), (3.0, 3.0), (7.0, 7.0 - 2 * pi), (-7.0, 2 * pi - 7)]
)
def test_angles_are_wrapped_to_half_a_turn(angle: float, wrapped: float) -> None:
    assert wrap(angle) == pytest.approx(wrapped, abs=1e-15)


def test_gains_settle_at_the_steady_kalman_filter() -> None:
    """Against scipy's discrete Riccati equation, with the noise integrals by another route (Van Loan's exponential)."""
    from scipy.linalg import expm

    T = SENSOR.period_samples * DT
    A = np.diag([1.0, 1.0], 1)
    W = np.diag([0.0, GAINS.acceleration_noise_m_s15**2, GAINS.disturbance_walk_m_s25**2])
    block = expm(np.block([[-A, W], [np.zeros((3, 3)), A.T]]) * T)
    F = block[3:, 3:].T
    Q = F @ block[:3, 3:]
    H = np.eye(2, 3)
    R = np.diag([SENSOR.position_noise_m**2, SENSOR.velocity_noise_m_s**2])
    P = solve_discrete_are(F.T, H.T, Q, R)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    gains = settling_gains(GAINS, SENSOR, DT)[0]
    # position is averaged longest: after a minute its weight is within a thousandth of where it goes
    np.testing.assert_allclose(gains[-1], K, rtol=1e-3)
    # the first fix is one of two: what was known at the start weighs as much
    assert gains[0][0][0] == pytest.approx(0.5, abs=0.01)


def measured(position: tuple[float, float], velocity: tuple[float, float], lean: tuple[float, float]) -> Measured:
    q = from_euler(*lean_from_acceleration(lean, 0.7), 0.7)
    return Measured((0.0, 0.0, 0.0), q, (*position, -10.0), (*velocity, 0.0), 10.0)


def test_a_known_acceleration_is_followed_without_delay() -> None:
    """Constant lean from rest, no noise: the estimate is the present motion although every fix is 0.1 s old."""
    a = (1.2, -0.6)
    estimator = PositionEstimator(GAINS, SENSORS, DT)
    late, period = SENSOR.latency_samples, SENSOR.period_samples
    for k in range(1, 1500):
        t = max(0, (k - late) // period * period) * DT
        fix = estimator.update(k, measured((0.5 * a[0] * t * t, 0.5 * a[1] * t * t), (a[0] * t, a[1] * t), a), False)
        now = k * DT
        assert fix.velocity == pytest.approx((a[0] * now, a[1] * now), abs=1e-9)
        assert fix.position == pytest.approx((0.5 * a[0] * now**2, 0.5 * a[1] * now**2), abs=1e-9)
    assert fix.disturbance == pytest.approx((0.0, 0.0), abs=1e-9)


def test_late_fixes_count_as_if_they_had_come_in_time() -> None:
    """Against the plain filter at the instants of the fixes, run ahead over the latency: whatever the fixes say."""
    rng = np.random.default_rng(5)
    period = SENSOR.period_samples
    sensor = SENSOR.model_copy(update={"latency_samples": 60})  # more than two fixes on their way
    for one in (SENSOR, sensor):
        late = one.latency_samples
        estimator = PositionEstimator(GAINS, SENSORS.model_copy(update={"gnss": one}), DT)
        gains = np.array(settling_gains(GAINS, one, DT)[0])

        def ahead(x: NDArray[np.float64], steps: int) -> NDArray[np.float64]:
            t = steps * DT
            return np.array([[1.0, t, t * t / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]]) @ x

        x, at, z = np.zeros(3), 0, np.zeros(2)
        for k in range(1, 800):
            if k > late and (k - late) % period == 0:
                z = rng.normal(0.0, 1.0, 2)
                x = ahead(x, k - late - at)
                x = x + gains[(k - late) // period - 1] @ (z - x[:2])
                at = k - late
            fix = estimator.update(k, measured((z[0], 0.0), (z[1], 0.0), (0.0, 0.0)), still=False)
            assert (fix.position[0], fix.velocity[0], fix.disturbance[0]) == pytest.approx(ahead(x, k - at), abs=1e-9)


def test_an_unknown_push_is_found() -> None:
    """Level, yet accelerating: the disturbance estimate goes there, and position and velocity stay right."""
    push = 0.36  # m/s^2: wind of 8 m/s on this body
    estimator = PositionEstimator(GAINS, SENSORS, DT)
    late, period = SENSOR.latency_samples, SENSOR.period_samples
    for k in range(1, 10_000):
        t = max(0, (k - late) // period * period) * DT
        fix = estimator.update(k, measured((0.5 * push * t * t, 0.0), (push * t, 0.0), (0.0, 0.0)), still=False)
    # 40 s, six time constants of its slowest pole
    assert fix.disturbance[0] == pytest.approx(push, rel=0.01)
    assert fix.velocity[0] == pytest.approx(push * k * DT, abs=0.01)


def test_a_push_of_its_own_is_not_taken_for_wind() -> None:
    """Pushed for 3 s, and only then: the disturbance stays that of the wind, and the velocity is right all the same."""
    wind, own = 0.36, 2.0  # m/s^2
    late, period = SENSOR.latency_samples, SENSOR.period_samples
    begin, end = 10_000, 10_000 + round(3.0 / DT)
    for told in (True, False):
        estimator = PositionEstimator(GAINS, SENSORS, DT)
        z = (0.0, 0.0)
        p = v = 0.0
        past = [(0.0, 0.0)] * (late + 1)
        for k in range(1, end + 1):
            pushed = begin < k <= end
            a = wind + own * pushed
            p, v = p + DT * v + 0.5 * DT * DT * a, v + DT * a
            past = [*past[1:], (p, v)]
            if k > late and (k - late) % period == 0:
                z = past[0]
            fix = estimator.update(k, measured((z[0], 0.0), (z[1], 0.0), (0.0, 0.0)), False, is_pushed=told and pushed)
        if told:
            assert fix.disturbance[0] == pytest.approx(wind, rel=0.01)
            assert fix.velocity[0] == pytest.approx(v, abs=1.0)
        else:
            assert fix.disturbance[0] > 2.0 * wind


def test_standing_averages_the_position_and_feels_no_push() -> None:
    estimator = PositionEstimator(GAINS, SENSORS, DT)
    rng = np.random.default_rng(3)
    z = (0.0, 0.0)
    estimates = []
    for k in range(1, 5000):
        if (k - SENSOR.latency_samples) % SENSOR.period_samples == 0:
            z = (float(rng.normal(0.0, 0.3)), float(rng.normal(0.0, 0.3)))
        fix = estimator.update(k, Measured((0.0, 0.0, 0.0), IDENTITY, (*z, 0.0), (0.01, 0.02, 0.0), 0.1), still=True)
        assert fix.velocity == fix.disturbance == (0.0, 0.0)
        estimates.append(fix.position[0])
    # 200 fixes of 0.3 m; the filter forgets, so that not all of them count: three times the settled deviation
    assert abs(estimates[-1]) < 3 * 0.3 * sqrt(settling_gains(GAINS, SENSOR, DT)[0][-1][0][0])


def test_the_law_and_its_limits() -> None:
    law = PositionController(GAINS, DT)
    track = Track((1.0, 0.0), (0.5, 0.0), (0.25, 0.0))
    kp, kv = GAINS.position_1_s, GAINS.velocity_1_s
    north, east = law.update(track, Fix((0.5, 0.2), (0.1, 0.0), (0.05, -0.02)))
    assert north == pytest.approx(0.25 + kv * (0.5 + kp * 0.5 - 0.1) - 0.05, abs=1e-12)
    assert east == pytest.approx(kv * (-kp * 0.2) + 0.02, abs=1e-12)
    # far away the speed asked for is limited; against a storm the lean is
    north, _ = law.update(
        Track((1e4, 0.0), (0.0, 0.0), (0.0, 0.0)), Fix((0.0, 0.0), (GAINS.catch_up_m_s, 0.0), (0.0, 0.0))
    )
    assert north == pytest.approx(0.0, abs=1e-12)
    most = GRAVITY * sin(GAINS.lean_rad) / cos(GAINS.lean_rad)
    assert hypot(*law.update(track, Fix((0.0, 0.0), (0.0, 0.0), (30.0, 40.0)))) == pytest.approx(most)


def test_new_gains_do_not_bump() -> None:
    law = PositionController(GAINS, DT)
    track, fix = Track((1.0, -2.0), (0.0, 0.5), (0.0, 0.0)), Fix((0.0, 0.0), (0.3, 0.0), (0.1, 0.1))
    before = law.update(track, fix)
    law.retune(0.7, 1.8, 0.2)
    assert law.update(track, fix) == pytest.approx(before, abs=1e-12)
    previous, jumps = before, []
    for _ in range(2000):
        now = law.update(track, fix)
        jumps.append(hypot(now[0] - previous[0], now[1] - previous[1]))
        previous = now
    fresh = PositionController(GAINS.model_copy(update={"position_1_s": 0.7, "velocity_1_s": 1.8, "lean_rad": 0.2}), DT)
    after = fresh.update(track, fix)
    assert previous == pytest.approx(after, abs=1e-6)
    # an exponential of 0.5 s: its first step is the largest
    size = hypot(after[0] - before[0], after[1] - before[1])
    assert max(jumps) <= size * DT / 0.5


Complex = NDArray[np.complex128]


def roll_answer(delay: int = 25, gain: float = 1.0) -> ct.TransferFunction:
    """Roll set-point to roll: rate PI and attitude P on the identified model with Smith's predictor.
    ``delay`` and ``gain`` are the plant's; the predictor keeps to the model's 25 samples and gain."""
    model, law = VEHICLE.identified["edf-as-flown"]["roll"], VEHICLE.control.rate.roll
    G = ct.tf([model.gain * c for c in polynomial(model.zeros)], polynomial(model.poles), DT)
    C = ct.tf([law.p + law.i * DT, -law.p], [1, -1], DT)
    late = ct.tf([1], [1] + [0] * 25, DT)
    P = gain * G * ct.tf([1], [1] + [0] * delay, DT)
    # u = C (r - y^), y^ = y + G (1 - z^-25) u
    inner = ct.minreal(ct.feedback(C, G * (1 - late)), verbose=False)
    rate = ct.feedback(inner * P, 1)
    attitude = VEHICLE.control.attitude.gain_1_s[0] * rate * ct.tf([DT / 2, DT / 2], [1, -1], DT)
    return ct.feedback(attitude, 1)


def loops(vehicle: Vehicle, answer: Complex, w: NDArray[np.float64]) -> tuple[Complex, Complex]:
    """The open loop at the lean command, and at the acceleration that the true lean gives.
    The estimator with its settled gains, spread evenly over the steps between two fixes: exact at frequencies far
    below that of the fixes (63 rad/s), and the loop crosses at 1."""
    gains, sensor = vehicle.control.position, vehicle.sensors.gnss
    L = np.array(settling_gains(gains, sensor, DT)[0][-1]) / sensor.period_samples
    late = sensor.latency_samples
    F = np.array([[1.0, DT, DT * DT / 2], [0.0, 1.0, DT], [0.0, 0.0, 1.0]])
    B = np.array([DT * DT / 2, DT, 0.0])
    keep = np.eye(3) - L @ np.eye(2, 3)
    carry = np.linalg.matrix_power(F, late)
    K = np.array([gains.velocity_1_s * gains.position_1_s, gains.velocity_1_s, 1.0])
    at_command, at_plant = [], []
    for z, lean in zip(np.exp(1j * w * DT), answer, strict=True):
        true = np.linalg.solve(z * np.eye(2) - F[:2, :2], B[:2])
        inverse = np.linalg.inv(np.eye(3) - keep @ F / z)
        by_fix = K @ carry @ inverse @ L @ true * z**-late
        run = sum((np.linalg.matrix_power(F, j) @ B * z ** -(1 + j) for j in range(late)), np.zeros(3, complex))
        by_lean = K @ (carry @ inverse @ keep @ B / z * z**-late + run)
        at_command.append(lean * (by_fix + by_lean))
        at_plant.append(lean * by_fix / (1 + lean * by_lean))
    return np.array(at_command), np.array(at_plant)


def test_the_attitude_loop_below_is_as_fast_as_the_gains_assume() -> None:
    """Bandwidth and the delay that it adds to the loops above, from which the position gains are chosen."""
    w = np.geomspace(0.1, 30.0, 600)
    answer = roll_answer()
    assert np.max(np.abs(answer.poles())) < 1.0
    response = answer(np.exp(1j * w * DT))
    bandwidth = w[np.argmax(np.abs(response) < sqrt(0.5))]
    assert 6.0 < bandwidth < 9.0  # rad/s
    assert -np.angle(response[np.searchsorted(w, 0.5)]) / 0.5 == pytest.approx(0.28, abs=0.02)  # s


def closed_loop(lean_gain: float, extra: int, start: float, steps: int = 25_000) -> NDArray[np.float64]:
    """The real blocks around the linear attitude loop: position after a start at ``start`` m, without noise.
    ``lean_gain``: true acceleration per acceleration that the measured lean stands for; ``extra`` samples more delay.
    """
    answer = ct.ss(roll_answer())
    A, B, C = np.asarray(answer.A), np.asarray(answer.B)[:, 0], np.asarray(answer.C)[0]
    estimator, law = PositionEstimator(GAINS, SENSORS, DT), PositionController(GAINS, DT)
    estimator.reset((start, 0.0))
    hold = Track((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    x, p, v, fix = np.zeros(len(A)), start, 0.0, (start, 0.0)
    line, fixes = [0.0] * extra, [fix] * (SENSOR.latency_samples + 1)
    track = np.empty(steps)
    for k in range(1, steps + 1):
        lean = float(C @ x)
        a = lean_gain * lean
        p, v = p + DT * (v + 0.5 * DT * a), v + DT * a
        if k % SENSOR.period_samples == 0:
            fix = (p, v)
        fixes = [*fixes[1:], fix]
        (zp, zv), track[k - 1] = fixes[0], p
        line.append(law.update(hold, estimator.update(k, measured((zp, 0.0), (zv, 0.0), (lean, 0.0)), False))[0])
        x = A @ x + B * line.pop(0)
    return track


@pytest.mark.parametrize(("lean_gain", "extra"), [(1.0, 0), (1.5, 0), (0.5, 0), (1.0, 100)])
def test_the_loop_of_the_real_blocks_is_stable(lean_gain: float, extra: int) -> None:
    """The margins again, by another route: gain 50 % off, or 0.4 s more delay in the lean, still comes to rest."""
    steps = 10_000
    track = closed_loop(lean_gain, extra, 1.0, steps)
    early, last = np.max(np.abs(track[: steps // 4])), np.max(np.abs(track[-steps // 4 :]))
    assert early < 1.5
    assert last < 0.25 * early


def led_roll_answer(vehicle: Vehicle, engine: str, z: Complex) -> Complex:
    """Roll set-point to roll of a vehicle that flies with a lead and no predictor, at the points ``z``."""
    model, law, leads = vehicle.identified[engine]["roll"], vehicle.control.rate.roll, vehicle.control.lead
    assert isinstance(leads.roll, EngineLead)
    over, under = lead_polynomials(leads.roll, DT)
    plant = model.gain * np.polyval(np.poly(model.all_zeros), z) / np.polyval(np.poly(model.all_poles), z)
    led = plant * np.polyval(over, z) / np.polyval(under, z) * z**-model.delay_samples
    share = DT / (law.d_filter_s + DT)
    pi = law.p + law.i * DT * z / (z - 1.0)
    d = law.d / DT * share * (z - 1.0) / (z - (1.0 - share))
    rate = pi * led / (1.0 + (pi + d) * led)
    attitude = vehicle.control.attitude.gain_1_s[0] * rate * DT / 2.0 * (z + 1.0) / (z - 1.0)
    return np.asarray(attitude / (1.0 + attitude))


@pytest.mark.parametrize(
    ("aircraft", "lowest", "gains_db", "peaks"),
    [("hexjet", 0.02, (10.0, 8.0), (1.5, 1.7)), ("hexjet-p220", 0.01, (16.0, 11.0), (1.3, 1.5))],
)
def test_margins_of_the_position_loop(aircraft: str, lowest: float, gains_db: tuple, peaks: tuple) -> None:
    """Stated in the aircraft's README, as are 54 degrees at the command and 42 at the plant."""
    vehicle, _ = load_vehicle(aircraft)
    w = np.geomspace(lowest, 30.0, 900)
    z = np.exp(1j * w * DT)
    answer = roll_answer()(z) if aircraft == "hexjet" else led_roll_answer(vehicle, "p220", z)
    for loop, phase, gain, peak in zip(loops(vehicle, answer, w), (54.0, 42.0), gains_db, peaks, strict=True):
        gm, pm, _, _, _, _ = ct.stability_margins(ct.frd(loop, w, smooth=True))
        assert 20 * np.log10(gm) > gain
        assert pm > phase
        assert np.max(np.abs(1 / (1 + loop))) < peak
