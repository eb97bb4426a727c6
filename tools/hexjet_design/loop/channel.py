"""A channel: everything between a command and what the controller measures of it, as it is flown.

For roll: share of thrust ``u`` -> engine -> moment -> rate -> gyro.  In steps of ``T`` with ``m`` JSBSim runs each,

    thrust   G_e(z) = b(z) / a(z) z^-d        the thrust of the step's end acts over the whole step
    rate     K T f z / (z - p)                    held over the step, exactly;  K = moment per command / inertia
    gyro     (1 - c) z / (z - c), then its latency
    angle    T / 2 (z + 1) / (z - 1) of the rate, without the gyro

What tilts pushes back, and rotors that are turned or sped up lead: :attr:`Channel.shape`.

``p = exp(-D T)`` with the damping ``D``, and ``f = (1 - p) / (D T)``.  With one or two runs a step JSBSim's method
shows: see :attr:`Channel.turning`.  The delay ledger lists the same elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, log

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.control.predictors.linear import delayed_response
from cosim.engine import EngineSpec
from cosim.simulation.axis_chain import (
    AxisPart,
    axis_gain,
    axis_moment,
    bank_reaction,
    discretise_rate,
    filter_pole,
    is_turned_by_throttle,
    list_hinged_parts,
    measurement_response,
    rate_response,
    thrust_momentum_lead,
)
from cosim.simulation.controllers.allocators import make_effectiveness
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import EngineLead, Hinge, RateModel, Sensors, Servo, Vehicle
from hexjet_design.loop.actuator import SERVO, THIS_STEP_ONLY, Actuator, make_hinge_actuator, servo_actuator
from hexjet_design.loop.dynamics import MIN_CARRIED_MISFIT

# A lag with a smaller pole in z settles within a 20th of a step, and is neglected.
MIN_POLE = 1e-9


@dataclass(frozen=True)
class Channel:
    """One axis or the height of a vehicle, with its actuators."""

    name: str  # "roll", "pitch", "yaw" or "altitude"
    unit: str  # unit of the command
    actuator: Actuator
    gain: float  # rad/s^2 per unit of command; height: 1
    damping_1_s: float
    step: float
    substeps: int
    # Range of the command at hover, either way; of a servo, what it follows without reaching its rate limit.
    room: float
    rate_filter_s: float = 0.0
    rate_latency: int = 0
    rate_hold: int = 1  # steps for which a measurement is held
    rate_noise: float = 0.0  # standard deviation of the measured rate
    angle_latency: int = 0
    angle_noise: float = 0.0
    angle_from_gyro: bool = False  # True: the angle integrates the gyro
    added_delay: int = 0
    # Weights of the actuator's responses in this and previous steps in the moment: tilts react, spinning leads.
    shape: tuple[float, ...] = THIS_STEP_ONLY
    hinged: tuple[AxisPart, ...] = ()  # actuator and weights per hinge
    identified: RateModel | None = None  # command to rate, replaces the chain

    @property
    def gyro_pole(self) -> float:
        """Pole in z of the gyro's low-pass."""
        return filter_pole(self.rate_filter_s, self.step)

    @property
    def rate_dynamics(self) -> tuple[tuple[float, ...], float]:
        """Weights of a moment and the rate's pole over one step, as in :func:`.axis_chain.discretise_rate`."""
        return discretise_rate(self.damping_1_s, self.step, self.substeps, self.shape)

    @property
    def transport_samples(self) -> float:
        """Pure delay from command to measured rate without hold and lags, to which delay tolerances refer."""
        if self.identified is not None:
            return self.identified.delay_samples + self.added_delay
        return self.actuator.model.delay_samples + self.added_delay + self.rate_latency + 0.5 * (self.substeps == 1)

    @property
    def lag_s(self) -> float:
        """Sum of the lags, including gyro and hold, s."""
        if self.identified is not None:
            return sum(-self.step / log(pole) for pole in self.identified.poles if 0.0 < pole < 0.998)
        acting = self.actuator.dynamics.lag_s - self.lead_s
        if len(self.hinged) > 1:  # one part per hinge, by its share
            late = sum([part.fraction * part.servos[0].lag_s for part in self.hinged])
            acting = late / sum([part.fraction for part in self.hinged]) - self.lead_s
        return acting + self.rate_filter_s + 0.5 * (self.rate_hold - 1) * self.step

    @property
    def lead_s(self) -> float:
        """Time by which the momentum of rotors on hinges acts before the hinges turn, s; 0 without hinges."""
        if not self.hinged:
            return 0.0
        return sum([part.lead_s for part in self.hinged]) / sum([part.fraction for part in self.hinged])

    @property
    def slowness_s(self) -> float:
        """Total delay at low frequency, s: half a step of hold, transport and lags; negative with large leads."""
        return (0.5 + self.transport_samples) * self.step + self.lag_s

    @cached_property
    def time_scale_s(self) -> float:
        """Return the time scale of a loop, s, above 0, by which searches are scaled.

        That is all delay at low frequency, where this is what a crossover meets.  It is not where a slow pole has a
        zero beside it: thrust that overshoots and comes back slowly leads at low frequency and is late all the same,
        and thrust that creeps up its last part is late at low frequency alone; nor where rotors lead.  There it is the
        time of the frequency at which the actuator that gives most has turned the phase by 1 rad, as a delay of one
        over it does.
        """
        turned = self._radian_lag_s() if self.identified is None else self.slowness_s
        # The low-frequency delay is the time scale if the two differ by less than this factor; a single lag has 0.64.
        min_ratio = 0.5
        return self.slowness_s if min_ratio < turned / max(self.slowness_s, MIN_POLE) < 1.0 / min_ratio else turned

    @property
    def gain_at_time_scale(self) -> float:
        """Return the plant's gain at the frequency 1 / time_scale_s, in the unit of the gain at rest.

        That is the gain at rest itself where the lags are all that is between the two.
        """
        if self.time_scale_s == self.slowness_s:
            return self.gain
        s, gain = 1j / self.time_scale_s, self.gain
        for pole in self.actuator.dynamics.poles:
            gain /= abs(1.0 - s / pole)
        for zero in self.actuator.dynamics.zeros:
            gain *= abs(1.0 - s / zero)
        return gain

    @property
    def longest_s(self) -> float:
        """Return the longest response time, s: of the slowest pole, or the time scale if longer."""
        if self.time_scale_s == self.slowness_s:
            return self.time_scale_s
        return max([self.time_scale_s, *(1.0 / abs(pole) for pole in self.actuator.dynamics.poles)])

    def _radian_lag_s(self) -> float:
        """Return 1 / w [s], w the lowest frequency at which command to rate, without its integral, lags by 1 rad."""
        dynamics = self.actuator.dynamics
        slowest = 1e-5  # rad/s, a day: start of the search
        points = 400  # frequencies of the search, 5 % apart
        # At the last frequency half a step of hold alone has turned the phase by 2 rad.
        omega = np.geomspace(slowest, 4.0 / self.step, points)
        late = (0.5 + self.transport_samples) * self.step + 0.5 * (self.rate_hold - 1) * self.step
        turned = late * omega + np.arctan(self.rate_filter_s * omega)
        for pole in dynamics.poles:
            turned += np.angle(1.0 - 1j * omega / pole)
        for zero in dynamics.zeros:
            turned -= np.angle(1.0 - 1j * omega / zero)
        first = int(np.argmax(turned > 1.0))
        part = slice(max(first - 1, 0), first + 1)
        return 1.0 / float(np.exp(np.interp(1.0, turned[part], np.log(omega[part]))))

    def model(self, source: str) -> RateModel:
        """Return the model from command to measured rate for a predictor, exact where the delay is whole samples.

        A delay that the controller adds itself is not in it: the flight adds that to the predictor's model.
        """
        if self.identified is not None:
            return self.identified
        body = self.actuator.model
        weights, pole = self.rate_dynamics
        first = next(weight for weight in weights if weight)
        gain = body.gain * self.gain * self.step * (1.0 - self.gyro_pole) * first
        zeros, poles, pairs = [*body.zeros], [*body.poles, pole], [*body.zero_pairs]
        if any(weights[1:]):
            acting = np.trim_zeros(weights, "b")
            poles += [0.0] * (len(acting) - 2)
            roots = np.roots(acting)
            zeros += [float(root.real) for root in roots if not root.imag]
            pairs += [(float(root.real), float(root.imag)) for root in roots if root.imag > 0.0]
        else:
            zeros.append(0.0)
        delay = body.delay_samples + self.rate_latency
        if self.gyro_pole:
            zeros.append(0.0)
            poles.append(self.gyro_pole)
        poles, zeros, more = remove_instant_dynamics(poles, zeros)
        delay += more
        return RateModel(
            gain=gain,
            zeros=zeros,
            zero_pairs=pairs,
            poles=sorted(poles, reverse=True),
            pole_pairs=body.pole_pairs,
            delay_samples=delay,
            sample_time_s=self.step,
            source=source,
        )

    def responses(self, z: Complex) -> tuple[Complex, Complex, Complex]:
        """Return the responses from command to measured rate, to measured angle, and to the angle itself."""
        integral = 0.5 * self.step * (z + 1.0) / (z - 1.0)
        late = z ** -float(self.added_delay)
        if self.identified is not None:
            rate = delayed_response(self.identified, z) * late
            return rate, rate * integral * z**-self.angle_latency, rate * integral
        weights, pole = self.rate_dynamics
        body = rate_response(z, weights, pole)
        rate = self.gain * self.step * delayed_response(self.actuator.model, z) * body * late
        measured = rate * self.measurement_response(z)
        angle = measured * integral if self.angle_from_gyro else rate * integral * z**-self.angle_latency
        return np.asarray(measured), np.asarray(angle), np.asarray(rate * integral)

    def measurement_response(self, z: Complex) -> Complex:
        """Return the response from rate to measured rate: low-pass, latency, and the mean effect of a hold."""
        return measurement_response(z, self.gyro_pole, self.rate_latency, self.rate_hold)

    def with_delay(self, samples: float) -> Channel:
        """Return the channel with another actuator delay, samples (total delay if identified as a whole)."""
        if self.identified is not None:
            return replace(self, identified=self.identified.model_copy(update={"delay_samples": samples}))
        return replace(self, actuator=self.actuator.with_delay(samples))

    def with_lags(self, factor: float) -> Channel:
        """Return the channel with actuator lags scaled; 0 reduces them to lags that are over within a step."""
        if self.identified is not None:
            raise InputError("a response given as a whole does not say which of its lags are the engine's")
        if not self.hinged:
            return replace(self, actuator=Actuator.of(self.actuator.name, self.actuator.dynamics.slower(factor)))
        actuator, shape = make_hinge_actuator(self.hinged, self.step, factor)
        dynamics = replace(actuator.dynamics, unsure=self.actuator.dynamics.unsure)
        actuator = replace(actuator, dynamics=dynamics).with_delay(self.actuator_delay)
        return replace(self, actuator=actuator, shape=shape)

    @property
    def is_by_servo(self) -> bool:
        """Whether the command tilts thrusts, whose size it leaves."""
        return self.actuator.name == SERVO

    @property
    def actuator_delay(self) -> float:
        """Delay that :meth:`with_delay` replaces, samples."""
        return (self.identified or self.actuator.model).delay_samples


def thrust_span(engine: EngineSpec) -> float:
    """Return the thrust that a command of 1 (a fraction of the engine's range) adds at rest, N."""
    return engine.curve.thrust[-1] - engine.curve.thrust[0]


def hover_fraction(vehicle: Vehicle, engine: EngineSpec) -> float:
    """Return the fraction of its range at which each engine carries its part of the weight."""
    thrust = vehicle.mass_kg * GRAVITY / len(vehicle.jets)
    return (thrust - engine.curve.thrust[0]) / thrust_span(engine)


def channels(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec, dynamics: Actuator) -> dict[str, Channel]:
    """Return the channels of roll, pitch, yaw and altitude at hover, with engines of these dynamics."""
    by_axis = {axis: _axis_channel(axis, scenario, vehicle, engine, dynamics) for axis in AXES}
    by_axis["altitude"] = _altitude_channel(scenario, vehicle, engine, dynamics)
    return by_axis


def _axis_channel(axis: str, scenario: Scenario, vehicle: Vehicle, engine: EngineSpec, dynamics: Actuator) -> Channel:
    index = AXES.index(axis)
    if vehicle.allocation == "effectiveness":
        return _by_effectiveness(axis, scenario, vehicle, engine, dynamics)
    inertia, span = vehicle.inertia_kg_m2[index], thrust_span(engine)
    thrusts, moment = is_turned_by_throttle(vehicle, index), axis_moment(vehicle, index, span)
    kick = bank_reaction(vehicle, index, moment, scenario.step_s)
    early = thrust_momentum_lead(vehicle, engine, index, scenario.step_s)
    room = _throttle_headroom(vehicle, engine) if thrusts else _servo_headroom(vehicle.servo)
    return Channel(
        axis,
        "share" if thrusts else "rad",
        dynamics if thrusts else servo_actuator(vehicle.servo, scenario.step_s),  # type: ignore[arg-type]
        axis_gain(vehicle, index, span),
        vehicle.aero.damping_n_m_s[index] / inertia,
        scenario.step_s,
        scenario.substeps,
        room,
        **_sensor_parameters(vehicle.sensors),  # type: ignore[arg-type]
        added_delay=scenario.added_delay_samples if axis == "roll" else 0,
        shape=(1.0 + early + kick, -early - 2.0 * kick, kick),
    )


def _by_effectiveness(
    axis: str, scenario: Scenario, vehicle: Vehicle, engine: EngineSpec, dynamics: Actuator
) -> Channel:
    """Return the channel of an angular acceleration, rad/s^2, with its main actuator in hover.

    What the other gives of it is carried as an uncertainty: :func:`_with_others`.
    """
    index = AXES.index(axis)
    allocator, step = make_effectiveness(scenario, vehicle, engine), scenario.step_s
    room = allocator.acceleration_limit(index)
    engines, *hinges = list_hinged_parts(vehicle, allocator, index, engine, step)
    hinged = tuple([part for part in hinges if any(part.compute_weights(step))])
    main, shape, others = dynamics, THIS_STEP_ONLY, hinged
    if sum([part.fraction for part in hinged]) > engines.fraction:
        main, shape = make_hinge_actuator(hinged, step)
        others = (engines,)
        # A step of the command must not exceed what the hinge's servo can follow.
        follows = [
            _servo_headroom(hinge) / abs(move)
            for part in hinged
            for hinge, move in zip(part.servos, part.moves, strict=True)
            if move
        ]
        room = min([room, *follows])
    return Channel(
        axis,
        "rad/s^2",
        _with_others(main, shape, others, dynamics, step),
        1.0,
        vehicle.aero.damping_n_m_s[index] / vehicle.inertia_kg_m2[index],
        step,
        scenario.substeps,
        room,
        **_sensor_parameters(vehicle.sensors),  # type: ignore[arg-type]
        added_delay=scenario.added_delay_samples if axis == "roll" else 0,
        shape=shape,
        hinged=() if main is dynamics else hinged,
    )


def _with_others(
    main: Actuator, shape: Sequence[float], others: Sequence[AxisPart], engine: Actuator, step: float
) -> Actuator:
    """Return an axis's main actuator, with the other actuators as an uncertainty.

    With ``W A`` of this one, by its ``shape``, and ``W_i A_i`` of ``others``, of shares ``w_i``, the axis is
    ``(1 - sum w_i) W A + sum W_i A_i``: at every frequency that is known, and so is how far ``W A`` alone is off it.  A
    design that stands all that are as far off stands this one.  ``engine`` answers where another has no servos.
    """
    # Frequencies 4 % apart; below the first one its misfit is assumed, which is more than there is.
    hertz = np.geomspace(1e-3, 0.49, 160) / step
    z = np.exp(2j * np.pi * hertz * step)
    main_response = np.polyval(shape[::-1], 1.0 / z) * delayed_response(main.model, z)
    deviation = np.full(len(z), -sum([part.fraction for part in others]), complex)
    for part in others:
        answer = servo_actuator(part.servos[0], step) if part.servos else engine
        deviation += (
            np.polyval(part.compute_weights(step)[::-1], 1.0 / z) * delayed_response(answer.model, z) / main_response
        )
    off = np.abs(deviation)
    if float(off.max()) < MIN_CARRIED_MISFIT:
        return main
    if main.dynamics.unsure:  # add the error of the model itself
        at, gap = np.array(main.dynamics.unsure).T
        off += np.interp(np.log(hertz), np.log(at), gap)
    unsure = tuple((float(f), float(gap_there)) for f, gap_there in zip(hertz, off, strict=True))
    return replace(main, dynamics=replace(main.dynamics, unsure=unsure))


def _sensor_parameters(sensors: Sensors) -> dict[str, float | int]:
    gyro, attitude = sensors.gyro, sensors.attitude
    return {
        "rate_filter_s": gyro.filter_s,
        "rate_latency": gyro.latency_samples,
        "rate_noise": gyro.noise_rad_s,
        "angle_latency": attitude.latency_samples,
        "angle_noise": attitude.noise_rad,
    }


def _throttle_headroom(vehicle: Vehicle, engine: EngineSpec) -> float:
    limits, thrust_fraction = vehicle.control.allocation, hover_fraction(vehicle, engine)
    return min(thrust_fraction - limits.throttle_min, limits.throttle_max - thrust_fraction)


def _servo_headroom(servo: Servo | Hinge | None) -> float:
    """Return the largest step, rad, that neither range nor rate limit cuts: a lag sets out at step / lag."""
    if servo is None:
        return inf
    if isinstance(servo, Hinge):
        least, most = servo.angle_limits
        reach = min(most - servo.rest_rad, servo.rest_rad - least)
    else:
        reach = servo.range_rad
    return min(reach, servo.rate_limit_rad_s * servo.lag_s) if servo.lag_s else reach


def _altitude_channel(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec, dynamics: Actuator) -> Channel:
    """Return the channel of vertical acceleration, by all engines, to climb rate (GNSS) and height (barometer)."""
    gnss, barometer = vehicle.sensors.gnss, vehicle.sensors.barometer
    authority = len(vehicle.jets) * thrust_span(engine) / vehicle.mass_kg  # m/s^2 per unit of share
    return Channel(
        "altitude",
        "m/s^2",
        dynamics,
        1.0,
        0.0,
        scenario.step_s,
        scenario.substeps,
        authority * _throttle_headroom(vehicle, engine),
        rate_latency=gnss.latency_samples,
        rate_hold=gnss.period_samples,
        rate_noise=gnss.velocity_noise_m_s,
        angle_latency=barometer.latency_samples,
        angle_noise=barometer.noise_m,
    )


def engine_lead(channel: Channel) -> EngineLead | None:
    """Return a lead for the engines' slowest lag, or for their slowest two poles; None where no engine answers.

    Its own poles are where the engine's are, for the search to move.
    """
    if channel.identified is not None or channel.is_by_servo:
        return None
    poles = sorted(channel.actuator.dynamics.poles, key=abs)
    # With a zero near an engine's pole, the lead skips poles slower than this times the channel's time scale.
    led_within = 3.0
    if channel.time_scale_s != channel.slowness_s:
        # A zero near a slow pole cancels it, so that nothing is left to lead.
        poles = [pole for pole in poles if abs(pole) * channel.time_scale_s * led_within >= 1.0]
    if not poles:
        return None
    slowest, *others = poles
    w = abs(slowest)
    # A slow lag beside an oscillatory pair stands alone. A lead takes a second pole up to this times the slowest.
    second_within = 5.0
    if others and (slowest.imag or (not others[0].imag and abs(others[0]) < second_within * w)):
        natural, damping = combine_poles(slowest, others[0])
        return EngineLead(natural_rad_s=natural, damping=damping, pole_rad_s=natural)
    return EngineLead(natural_rad_s=w, pole_rad_s=w)


def combine_poles(one: complex, two: complex) -> tuple[float, float]:
    """Return natural frequency, rad/s, and damping of two poles."""
    natural = float(np.sqrt(abs(one) * abs(two)))
    return natural, float(-(one + two).real / (2.0 * natural))


def angles(z: Complex) -> Array:
    """Return the frequency of points on the unit circle, rad per sample."""
    return np.asarray(np.angle(z), np.float64)


def remove_instant_dynamics(poles: Sequence[float], zeros: Sequence[float]) -> tuple[list[float], list[float], int]:
    """Return poles and zeros in z without lags that are over within a step, and the samples of delay that these leave.

    ``1 / (z - p)`` with ``p`` below :data:`MIN_POLE` is a delay of a sample to rounding, which a zero at 0 takes back.
    An observer would have such a state corrected by ``1 / p``, and double precision does not place its poles.
    """
    acting, remaining, delay = [pole for pole in poles if not 0.0 < pole < MIN_POLE], [*zeros], 0
    for _ in range(len(poles) - len(acting)):
        if 0.0 in remaining:
            remaining.remove(0.0)
        else:
            delay += 1
    return acting, remaining, delay
