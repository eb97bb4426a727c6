"""Comparison of identified models with their vehicle: gain, delay and lag.

What a predictor believes is a response that was identified once, of a vehicle of one mass and inertia with one engine.
The vehicle and the engine say the same otherwise: the gain at rest is a lever times thrust over a moment of inertia,
and what is late is the engine, stepped by a little at the throttle of hover, the servos' lags, and the gyro.  Both are
frequency responses ``G(z)`` from command to measured rate, and their ratio ``R = G_model / G_vehicle`` is taken at half
the frequency at which the vehicle's, less the integral from moment to rate, is 1 rad late: there a loop closes.

    gain   |R|                                        times that of the vehicle
    delay  -arg(R) / (omega T)                        samples more than the vehicle's
    lag    |R(2 omega) / (|R| exp(2j arg R)) - 1|     what gain and delay do not explain, at twice the frequency

Compared is what the controller knows, without any mismatch, disturbance or delay that it adds itself.

The limits.  A design bears 30 % of gain and of delay either way (``Requirements`` of a controller file); half of that
is left for what is not known of the vehicle, and more than the other half, 15 %, is noted.  Below 2 samples of delay
nothing is: so far may a fit and the engine be apart.  Unfit is a model with which a loop does not do its work: the
Hex-Jet's roll doublet settles with inertia up to 1.5 times what its model has, and not at 1.75; with an engine 10
samples later than the model's, and not with 15, that is 28 % and 43 % of all its delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import inf, log

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.constants import GRAVITY
from cosim.base.signals import AXES
from cosim.control.predictors.linear import delayed_response
from cosim.control.predictors.registry import PREDICTORS
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
from cosim.simulation.engine_reference import measure_small_steps
from cosim.spec.scenario import PayloadDisturbance, Scenario
from cosim.spec.vehicle import RateModel, Vehicle

# Frequencies [rad/s], and the response of thrust to command there, relative to the static gain.
Response = tuple[Array, Complex]

MIN_REPORTED = 0.15  # relative error of gain, delay or lag


@dataclass(frozen=True)
class ModelAgreement:
    """Comparison of one identified model with the vehicle and its engine."""

    engine: str  # engine family of the model
    axis: str
    unit: str  # unit of the gains
    state: str  # "" as built, or "fuel" or "payload"
    hertz: float  # frequency of the comparison
    model_gain: float  # gain of the model
    vehicle_gain: float  # gain of vehicle and engine
    model_delay: float  # total delay of the model, samples
    vehicle_delay: float  # total delay of the vehicle, samples
    lag_misfit: float
    is_opposite: bool = False  # True: gains have opposite signs

    @property
    def ratio(self) -> float:
        """The model's gain over that of the vehicle."""
        return self.model_gain / self.vehicle_gain

    @property
    def is_noteworthy(self) -> bool:
        """Whether model and vehicle differ by more than the threshold of a note."""
        return self.distance > 1.0

    @property
    def is_unfit(self) -> bool:
        """Whether gain, delay or lag are too wrong for a predictor with this model."""
        return self._relative_misfit(1.5, 1.0 / 3.0, 0.5) > 1.0

    @property
    def distance(self) -> float:
        """Difference of model and vehicle over the threshold of a note."""
        return self._relative_misfit(1.0 + MIN_REPORTED, MIN_REPORTED, MIN_REPORTED)

    def _relative_misfit(self, gain: float, delay: float, lag: float, least_samples: float = 2.0) -> float:
        """Return the largest of the errors of gain, delay and lag, each over its limit; infinite for the other sign.

        ``gain``: ratio, either way; ``delay``: of all delay of the vehicle, ``least_samples`` at least.
        """
        if self.is_opposite:
            return inf
        samples = max(least_samples, delay * self.vehicle_delay)
        return max(
            abs(log(self.ratio)) / log(gain),
            abs(self.model_delay - self.vehicle_delay) / samples,
            self.lag_misfit / lag,
        )

    @property
    def numbers(self) -> str:
        """Text with gain and delay of model and vehicle, and the error of the lag."""
        if self.is_opposite:
            return f"it turns the other way than the vehicle, which has {self.vehicle_gain:.4g} {self.unit}"
        said = (
            f"gain {self.model_gain:.4g} {self.unit}, and {self.vehicle_gain:.4g} by geometry, inertia and engine "
            f"({self.ratio:.2f} times); all delay {self.model_delay:.1f} samples, and "
            f"{self.vehicle_delay:.1f} by engine, servos and gyro (at {self.hertz:.2g} Hz)"
        )
        if self.lag_misfit > MIN_REPORTED:
            said += f"; {100.0 * self.lag_misfit:.0f} % off at twice that frequency, as lags of another length are"
        return said

    @property
    def note(self) -> str:
        where = f" {self.state}" if self.state else ""
        return f"{self.axis}: the identified model with {self.engine} is not that of the vehicle{where}: {self.numbers}"


def compare_flown_models(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> list[ModelAgreement]:
    """Compare the models given to a flight's controller with the vehicle, per axis and state.

    The vehicle is taken as it starts: with that fuel, and without and with the payloads of the scenario.  Empty where
    the controller needs no model; one from outside is told of all.  Raises EngineError if the engine fails.
    """
    if scenario.controller in PREDICTORS and not PREDICTORS[scenario.controller].needs_model:
        return []
    return [
        agreement
        for state, there in _loading_states(scenario, vehicle)
        for agreement in compare_models(scenario, there, engine, state)
    ]


def list_model_notes(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> list[str]:
    """Return a note for each axis whose model differs too much from the vehicle, for the first such loading."""
    notes: dict[str, str] = {}
    for agreement in compare_flown_models(scenario, vehicle, engine):
        if agreement.is_noteworthy:
            notes.setdefault(agreement.axis, agreement.note)
    return list(notes.values())


def compare_models(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec, state: str = "") -> list[ModelAgreement]:
    """Compare the identified models of a vehicle with this engine, an axis each, with vehicle and engine.

    Models of another sample time than the scenario's step are left out: no flight takes them; and all of an engine
    that does not answer a small step.  ``state``: what is to be said of the vehicle.  Raises EngineError.
    """
    models = {
        axis: model
        for axis, model in engine.models_in(vehicle.identified).items()
        if abs(model.sample_time_s - scenario.step_s) <= 1e-9
    }
    response = _engine_response(vehicle, engine, scenario.step_s) if models else None
    if response is None:
        return []
    return [_compare_model(scenario, vehicle, engine, response, axis, model, state) for axis, model in models.items()]


def _loading_states(scenario: Scenario, vehicle: Vehicle) -> list[tuple[str, Vehicle]]:
    """Return the vehicle at the start, and with each payload, with descriptions."""
    begun, state = vehicle, ""
    if vehicle.fuel is not None and scenario.initial.fuel < 1.0:
        begun = vehicle.with_fuel(scenario.initial.fuel)
        state = f"with {100.0 * scenario.initial.fuel:.3g} % of its fuel"
    loads = [entry for entry in scenario.disturbance if isinstance(entry, PayloadDisturbance)]
    return [(state, begun)] + [
        (f"with the payload of {load.mass_kg:g} kg", begun.with_point_mass(load.mass_kg, load.offset_m))
        for load in loads
    ]


def _compare_model(
    scenario: Scenario,
    vehicle: Vehicle,
    engine: EngineSpec,
    response: Response,
    axis: str,
    model: RateModel,
    state: str,
) -> ModelAgreement:
    index, step = AXES.index(axis), scenario.step_s
    span = engine.curve.thrust[-1] - engine.curve.thrust[0]
    gain = axis_gain(vehicle, index, span)
    damping = vehicle.aero.damping_n_m_s[index] / vehicle.inertia_kg_m2[index]
    parts = _parts(scenario, vehicle, engine, index, span)
    omega, thrust = response
    z = np.exp(1j * omega * step)
    own = gain * _actuator_response(parts, thrust, z, step) * _airframe_response(scenario, vehicle, damping, z)
    # Phase lag without the integral, which is 1 / (j omega + damping).
    late = -np.unwrap(np.angle(own * (1j * omega + damping)))
    at = 0.5 * _one_radian_frequency(late, omega)
    ratio = delayed_response(model, z) / own
    size, phase = np.log(np.abs(ratio)), np.unwrap(np.angle(ratio))
    (g, g2), (p, p2) = (np.interp([at, 2.0 * at], omega, values) for values in (size, phase))
    more = -float(p) / (at * step)
    turned = float(np.interp(at, omega, late)) / (at * step)
    return ModelAgreement(
        engine.family,
        axis,
        _gain_unit(vehicle, index),
        state,
        at / (2.0 * np.pi),
        gain * float(np.exp(g)),
        gain,
        turned + more,
        turned,
        float(abs(np.exp((g2 - g) + 1j * (p2 - 2.0 * p)) - 1.0)),
        bool(np.cos(phase[0]) < 0.0),
    )


def _one_radian_frequency(late: Array, omega: Array) -> float:
    """Return the lowest frequency, rad/s, with more than 1 rad of lag, or the highest one."""
    first = int(np.argmax(late > 1.0))
    if not late[first] > 1.0:
        return float(omega[-1])
    part = slice(max(first - 1, 0), first + 1)
    return float(np.interp(1.0, late[part], omega[part]))


def _gain_unit(vehicle: Vehicle, index: int) -> str:
    if vehicle.allocation == "effectiveness":
        return "rad/s^2 per rad/s^2"
    return "rad/s^2 per throttle" if is_turned_by_throttle(vehicle, index) else "rad/s^2 per rad"


def _parts(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec, index: int, span: float) -> Sequence[AxisPart]:
    """Return the actuators that make an axis's moment, by lag."""
    step = scenario.step_s
    if vehicle.allocation == "effectiveness":
        return list_hinged_parts(vehicle, make_effectiveness(scenario, vehicle, engine), index, engine, step)
    if is_turned_by_throttle(vehicle, index) or vehicle.servo is None:
        return [AxisPart((), (), 1.0, lead_s=thrust_momentum_lead(vehicle, engine, index, step) * step)]
    kick = bank_reaction(vehicle, index, axis_moment(vehicle, index, span), step) * step * step
    return [AxisPart((vehicle.servo,), (1.0,), 1.0, kick)]


def _actuator_response(parts: Sequence[AxisPart], engine: Complex, z: Complex, step: float) -> Complex:
    """Return the response of moment to command over its static gain: engines and servos, with their reactions."""
    total = np.zeros_like(z)
    for part in parts:
        answer = engine
        if part.servos:
            pole = filter_pole(part.servos[0].lag_s, step)
            answer = (1.0 - pole) / (z - pole)
        now, before, earlier = part.compute_weights(step)
        total += (now + (before + earlier / z) / z) * answer
    return total


def _airframe_response(scenario: Scenario, vehicle: Vehicle, damping: float, z: Complex) -> Complex:
    """Return the response of measured rate to angular acceleration."""
    gyro = vehicle.sensors.gyro
    shares, pole = discretise_rate(damping, scenario.step_s, scenario.substeps)
    body = scenario.step_s * rate_response(z, shares, pole)
    return np.asarray(body * measurement_response(z, filter_pole(gyro.filter_s, scenario.step_s), gyro.latency_samples))


def _engine_response(vehicle: Vehicle, engine: EngineSpec, step: float) -> Response | None:
    """Return the engine's response to small throttle steps, or None.

    One of the library is taken where it hovers.  One that states a pole answers alike everywhere; any other at the
    nearest throttle of a grid, so that many vehicles share it, and by steps that its trembling does not hide.
    """
    rising = engine.rising_curve
    hover = float(np.interp(vehicle.mass_kg * GRAVITY / len(vehicle.jets), rising.thrust, rising.throttle))
    if engine.pole is not None:
        around = measure_small_steps(engine, 0.5, step)
    elif engine.library:
        around = measure_small_steps(engine, hover, step)
    else:
        around = measure_small_steps(engine, round(hover / 0.05) * 0.05, step, (0.05,))
    return _transform_step(around.response, step) if around.response else None


@lru_cache(64)
def _transform_step(course: tuple[float, ...], step: float, points: int = 96) -> Response:
    """Return the frequency response that belongs to a step response, from 0.02 rad/s on."""
    omega = np.geomspace(0.02, 0.8 * np.pi / step, points)
    # The thrust at a step's end acts over the whole step, whose command is known one sample before its end.
    back, value = np.exp(-1j * omega * step), np.zeros(points, complex)
    for push in np.diff(np.array(course), prepend=0.0)[::-1]:
        value = (value + push) * back
    return omega, value
