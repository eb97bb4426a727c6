"""Horizontal position and velocity from the GNSS receiver and the lean, NED."""

from __future__ import annotations

from cmath import rect
from math import hypot, inf
from typing import NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.frames import heading_of, rotate
from cosim.base.signals import Measured
from cosim.control.autopilot.estimation.kalman import Kalman
from cosim.control.autopilot.estimation.position_gains import settling_gains
from cosim.control.autopilot.geometry import Pair, lean_acceleration
from cosim.spec.vehicle import PositionGains, Sensors

# Random walk of the bias [m/s^2 per root s] of a MEMS accelerometer (0.15 mg/K) that warms by less than 1 K per second.
BIAS_WALK = 0.001
# Noise [m/s] of the velocity zero, which is used as a measurement while the vehicle stands.
STANDING_NOISE = 0.02


class Fix(NamedTuple):
    """The estimated horizontal position, velocity, and acceleration that attitude does not explain: m, m/s, m/s^2."""

    position: Pair
    velocity: Pair
    disturbance: Pair


def trusted_noise(
    sensors: Sensors, position: float = 0.1, velocity: float = 0.02, force: float = 0.05
) -> tuple[float, float, float]:
    """Return the assumed noise of GNSS position [m] and velocity [m/s] and of the accelerometer [m/s^2]."""
    gnss = sensors.gnss
    return (
        max(gnss.position_noise_m, position),
        max(gnss.velocity_noise_m_s, velocity),
        max(sensors.accelerometer.noise_m_s2, force),
    )


class PositionEstimator:
    """Kalman filter of position, velocity and unexplained acceleration, which dead-reckons between fixes.

    The acceleration is ``g tan(lean)`` of the measured attitude (thrust along the body's z axis that holds the weight),
    its bias the disturbance; so neither a limit of the lean nor a slow attitude loop winds anything up.  The gains are
    those of the receiver's stated noise, of ``acceleration_noise`` and ``disturbance_walk``, computed once.

    ``reckons``: a second filter, by the accelerometer, replaces a receiver that has nothing new, and says how sure its
    position is.  What the accelerometer feels has the drag in it, so that nothing learnt at one speed is wrong at
    another; its bias, and gravity through an attitude that is off, turn with the vehicle.  Without it the last
    disturbance stays, which contains the drag of the speed of then, and the velocity is soon wrong.
    ``noisy``: the receiver never repeats a fix, standing or not.
    """

    def __init__(
        self, gains: PositionGains, sensors: Sensors, step: float, noisy: bool = False, reckons: bool = False
    ) -> None:
        gnss = sensors.gnss
        self._step, self._noisy, self._reckons = step, noisy, reckons
        self._period, self._latency = gnss.period_samples, gnss.latency_samples
        self._gains, self._deviations = settling_gains(gains, gnss, step)
        position_noise, velocity_noise, force_noise = trusted_noise(sensors)
        self._position_noise, self._velocity_noise = position_noise**2, velocity_noise**2
        # White from step to step: the spectral density is the variance times the step.
        self._force_noise = step * (force_noise**2 + (GRAVITY * sensors.attitude.noise_rad) ** 2)
        self._lean = Kalman(step, self._latency, (0.0, 0.0, 0.0))
        # m/s^2: 10 mg of accelerometer bias and 1 degree of attitude error together.
        bias_at_start = 0.2
        self.reckoning = Kalman(step, self._latency, (position_noise, velocity_noise, bias_at_start))
        self.reset((0.0, 0.0))

    def reset(self, position: Pair) -> None:
        """Start at rest at ``position``, with the uncertainty of one fix."""
        self._epoch = 0
        self._last: tuple[float, ...] = ()
        # s since the last new fix
        self.silent = 0.0
        self._lean.reset(complex(*position), 0j)
        self.reckoning.reset(complex(*position), 0j)
        self._lean_variance = 0.0
        self._has_force = True

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of position [m] and velocity [m/s] per axis; infinite without prediction."""
        fix_deviation = self._deviations[min(self._epoch, len(self._deviations) - 1)]
        if self.silent == 0.0:
            return fix_deviation
        if not self._reckons:
            return inf, inf
        position_deviation, velocity_deviation = self.reckoning.deviation
        return hypot(fix_deviation[0], position_deviation), hypot(fix_deviation[1], velocity_deviation)

    @property
    def fix(self) -> Fix:
        """The estimate at the instant of the last update."""
        p, v, u = self._lean.p, self._lean.v, self._lean.u
        return Fix((p.real, p.imag), (v.real, v.imag), (u.real, u.imag))

    def update(
        self, k: int, measured: Measured, still: bool, lean_deviation: float = 0.0, is_pushed: bool = False
    ) -> Fix:
        """Return the estimate at ``t_k``; ``still``: the vehicle stands, without velocity or push.

        ``lean_deviation``: of the attitude beyond its sensor's noise, rad; ``is_pushed``: by its own thrust, so that
        the estimated disturbance stays as it is.
        """
        acceleration = complex(*lean_acceleration(measured.attitude)) + self._lean.u
        if self._reckons:
            self._dead_reckon(measured, acceleration)
        self._lean.predict(acceleration, still)
        if k > self._latency and (k - self._latency) % self._period == 0:
            # A receiver without a new fix repeats the last one to the last bit.
            fix = (*measured.position, *measured.velocity[:2])
            fresh = fix != self._last or (still and not self._noisy)
            self.silent = 0.0 if fresh else self.silent + self._period * self._step
            self._last = fix
            p, v = complex(*measured.position[:2]), complex(*measured.velocity[:2])
            if self._reckons:
                self._correct_reckoning(p, v, fresh, still, lean_deviation)
            if fresh:
                self._correct(p, v, still, is_pushed)
            elif self._reckons:
                self._correct(*self.reckoning.delayed, still, is_pushed)
        return self.fix

    def _correct(self, p: complex, v: complex, still: bool, is_pushed: bool) -> None:
        """Correct the estimate by a position and a velocity that are ``latency`` samples old."""
        gains = self._gains
        gain = gains[self._epoch] if self._epoch < len(gains) else gains[-1]
        self._epoch += 1
        then_p, then_v = self._lean.delayed
        off_p, off_v = p - then_p, v - then_v
        dp = gain[0][0] * off_p + gain[0][1] * off_v
        dv = 0j if still else gain[1][0] * off_p + gain[1][1] * off_v
        du = 0j if still or is_pushed else gain[2][0] * off_p + gain[2][1] * off_v
        self._lean.shift(dp, dv, du, self._latency * self._step)

    def _dead_reckon(self, measured: Measured, by_lean: complex) -> None:
        """Predict position and velocity one step ahead by the accelerometer, or without one by the lean."""
        force, reckoning = measured.specific_force, self.reckoning
        self._has_force = force[0] == force[0] and force[1] == force[1] and force[2] == force[2]
        if self._has_force:
            north, east, _ = rotate(measured.attitude, force)
            reckoning.turn = rect(1.0, heading_of(measured.attitude))
            by_lean = complex(north, east) + reckoning.turn * reckoning.u
        reckoning.predict(by_lean)

    def _correct_reckoning(
        self, p: complex, v: complex, fresh: bool, still: bool, lean_deviation: float, unsensed: float = 0.5
    ) -> None:
        """Propagate the covariance of dead reckoning over the time between two fixes, and correct it by the new one.

        ``unsensed``: the acceleration that the lean does not explain, where none is sensed, m/s^2 over a second.
        """
        reckoning, T, lean_variance = self.reckoning, self._period * self._step, lean_deviation**2
        turn, noise = (reckoning.turn, self._force_noise) if self._has_force else (0j, unsensed**2)
        reckoning.spread(T, turn, noise, BIAS_WALK**2 * T + GRAVITY**2 * max(0.0, lean_variance - self._lean_variance))
        self._lean_variance = lean_variance
        if still:
            reckoning.correct(1, -reckoning.v, STANDING_NOISE**2, 0.0)
        if fresh:
            latency = self._latency * self._step
            reckoning.correct(1, v - reckoning.delayed[1], self._velocity_noise, latency)
            reckoning.correct(0, p - reckoning.delayed[0], self._position_noise, latency)
