"""What the paper did not try, on the linear plant: robustness maps, offsets, delay, noise, and the true turbojet.

Nothing here is calibrated to these questions; the quadrotor's loop is the calibrated one, the Hex-Jet's is what its
``vehicle.toml`` flies.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, inf, log, pi

import numpy as np

from cosim.loops import PredictorTuning, RateModel, grid, model_response
from hexjet_paper import numbers
from hexjet_paper.experiments import hexjet_axis, quadrotor_axis
from hexjet_paper.frozen import Calibration
from hexjet_paper.linear import STATE_AS_PRINTED, Axis, Complex, Plant, doublet, predictor, simulate
from hexjet_paper.loops import LoopMap, controllers_response, predictor_response
from hexjet_paper.numbers import Record

# Controllers whose loops are compared.
QUADROTOR = ("baseline", "smith", "filtered-smith", "state", STATE_AS_PRINTED, "state-model", "state-disturbance")
HEXJET = ("baseline", "smith", "filtered-smith", "state", "state-model", "state-disturbance")
# Largest peak sensitivity M_s that a careful designer allows.
MAX_SENSITIVITY = 1.7
_POINTS = 1200  # frequencies of a map's responses


class RobustnessMap(Record):
    """Peak sensitivity of one controller over delay error (samples) and gain error (factor): one row per gain.

    ``sensitivity`` is the peak sensitivity, None where the closed loop has a pole outside the unit circle.
    """

    vehicle: str
    controller: str
    nominal_delay: int
    delay_errors: list[int]
    gains: list[float]
    sensitivity: list[list[float | None]]

    @property
    def stable_share(self) -> float:
        """Fraction of the map's cells that are stable."""
        cells = [cell for row in self.sensitivity for cell in row]
        return sum(cell is not None for cell in cells) / len(cells)

    def at(self, gain: float, delay_error: int) -> float | None:
        """Return the peak sensitivity of the nearest cell; None if unstable."""
        row = min(range(len(self.gains)), key=lambda n: abs(log(self.gains[n] / gain)))
        return self.sensitivity[row][self.delay_errors.index(delay_error)]


def loops(calibration: Calibration) -> dict[tuple[str, str], Axis]:
    """Return the nominal loops without noise, by vehicle and controller."""
    # Ten added samples are chosen because the paper's controllers differ visibly there.
    axes = {("quadrotor", c): quadrotor_axis(calibration, c, 10, noisy=False) for c in QUADROTOR}
    axes |= {("hexjet", c): hexjet_axis(calibration, c, "vehicle", noisy=False) for c in HEXJET}
    return axes


def robustness_maps(calibration: Calibration) -> list[RobustnessMap]:
    """Return the robustness map of every controller of both vehicles."""
    gains = [round(float(g), 4) for g in np.geomspace(0.25, 4.0, 25)]
    errors = {"quadrotor": list(range(-10, 21, 2)), "hexjet": list(range(-25, 26, 2))}
    maps = []
    for (vehicle, controller), axis in loops(calibration).items():
        loop = LoopMap(axis, _POINTS)
        delays = [error if vehicle == "quadrotor" else error + 1 for error in errors[vehicle]]  # includes 0
        cells = [[_find_sensitivity(loop, gain, axis.delay_samples + error) for error in delays] for gain in gains]
        maps.append(
            RobustnessMap(
                vehicle=vehicle,
                controller=controller,
                nominal_delay=axis.delay_samples,
                delay_errors=delays,
                gains=gains,
                sensitivity=cells,
            )
        )
    return maps


def _find_sensitivity(loop: LoopMap, gain: float, delay: int) -> float | None:
    return None if loop.unstable_poles(gain, delay) else loop.peak_sensitivity(gain, delay)


class DelayPoint(Record):
    """Result of a controller that knows the delay, on a plant with that delay."""

    delay: int  # samples
    stable: bool
    sensitivity: float | None  # None: unstable
    rmse: float | None  # rad, of the doublet; None: unstable


def delay_sweep(calibration: Calibration, longest: int = 60, every: int = 3) -> dict[tuple[str, str], list[DelayPoint]]:
    """Return results for 0 to ``longest`` samples of added delay that the predictor knows, at unchanged gains."""
    amplitude = {"quadrotor": numbers.value("step.amplitude"), "hexjet": numbers.value("hexjet.amplitude")}
    doublet_s, seconds = {"quadrotor": 0.5, "hexjet": 3.0}, {"quadrotor": 2.0, "hexjet": 8.0}
    by_loop: dict[tuple[str, str], list[DelayPoint]] = {}
    for (vehicle, controller), axis in loops(calibration).items():
        points = []
        for delay in range(0, longest + 1, every):
            loop = axis.with_delay(delay)
            sensitivity = _find_sensitivity(LoopMap(loop, _POINTS), 1.0, delay)
            rmse = None
            if sensitivity is not None:
                signal = doublet(np.radians(amplitude[vehicle]), 0.2, doublet_s[vehicle], loop.step)
                record = simulate(loop, round(seconds[vehicle] / loop.step), setpoint=signal)
                rmse = float(np.sqrt(np.mean((np.array(record.setpoint) - np.array(record.angle)) ** 2)))
            points.append(DelayPoint(delay=delay, stable=sensitivity is not None, sensitivity=sensitivity, rmse=rmse))
        by_loop[vehicle, controller] = points
    return by_loop


class Offset(Record):
    """Roll angle that remains under a constant disturbance of the roll command."""

    controller: str
    peak: float  # rad
    early: float  # rad, mean over 1 s, 10 s after onset
    late: float  # rad, mean over 1 s, 60 s after onset
    time: list[float]  # s after the onset, each 0.1 s
    angle: list[float]  # rad


def constant_disturbance(calibration: Calibration, disturbance: float = 0.01) -> list[Offset]:
    """Simulate an off-centre payload on the Hex-Jet: an unknown constant added to the roll command."""
    offsets = []
    for controller in ("baseline", *HEXJET[1:]):
        axis = hexjet_axis(calibration, controller, "vehicle", noisy=False)
        if LoopMap(axis, _POINTS).unstable_poles(1.0, axis.delay_samples):
            continue
        record = simulate(axis, round(61.0 / axis.step), disturbance=lambda k: disturbance)
        angle = np.array(record.angle)
        second, tenth = round(1.0 / axis.step), round(0.1 / axis.step)
        offsets.append(
            Offset(
                controller=controller,
                peak=float(angle[np.argmax(np.abs(angle))]),
                early=float(np.mean(angle[10 * second : 11 * second])),
                late=float(np.mean(angle[60 * second :])),
                time=[round(0.1 * n, 1) for n in range(201)],
                angle=angle[: 200 * tenth + 1 : tenth].tolist(),
            )
        )
    return offsets


def smith_offset(calibration: Calibration, disturbance: float = 0.01) -> float:
    """Return the classic Smith predictor's roll offset [rad] in closed form, before the slow pole decays.

    At rest the command is ``-d``, which leaves ``y^ = -K h T d`` while ``y = 0``, ``K`` the plant's gain as an
    integrator (rad/s^2 per command); the integral settles at ``r = y^``, so ``K_att phi = K h T d``.
    """
    axis = hexjet_axis(calibration, "smith", "vehicle", noisy=False)
    model = axis.model
    k = integrating_gain(model)
    return k * model.delay_samples * model.sample_time_s * disturbance / axis.attitude_gain


def integrating_gain(model: RateModel) -> float:
    """Return the rate's slope per command [rad/s^2] after the fast modes: residue of the slowest pole over ``T``."""
    slow = max(model.poles)
    others = [pole for pole in model.poles if pole != slow]
    value = model.gain
    for zero in model.zeros:
        value *= slow - zero
    for pole in others:
        value /= slow - pole
    return value / model.sample_time_s


def noise_gain(axis: Axis, points: int = 6000) -> float:
    """Return the command's standard deviation per that of white gyro noise, by Parseval's theorem.

    ``u / n = -C P_y / (1 + C G* + C_e K I G z^-d)``: the gyro's noise reaches the rate loop, not the angle.
    Raises ValueError where the loop is unstable.
    """
    loop = LoopMap(axis, points)
    if loop.unstable_poles(1.0, axis.delay_samples):
        raise ValueError(f"{axis.controller}: an unstable loop has no noise gain")
    z = grid(points)
    of_rate, _ = predictor_response(axis.controller, axis.model, axis.tuning)(z)
    error, slope = controllers_response(axis, z)
    size = np.abs((error + slope) * of_rate / loop.characteristic(1.0, axis.delay_samples)) ** 2
    angles = np.angle(z)
    return float(np.sqrt(np.trapezoid(size, angles) / pi))


def noise_gains(calibration: Calibration) -> dict[tuple[str, str], float | None]:
    """Return every loop's noise gain, None if unstable; the quadrotor's with 5 samples, where most are stable."""
    gains: dict[tuple[str, str], float | None] = {}
    for (vehicle, controller), axis in loops(calibration).items():
        loop = axis.with_delay(5) if vehicle == "quadrotor" else axis
        try:
            gains[vehicle, controller] = noise_gain(loop)
        except ValueError:
            gains[vehicle, controller] = None
    return gains


class Reach(Record):
    """Fastest attitude loop of a controller whose peak sensitivity is at most :data:`MAX_SENSITIVITY`."""

    engine: str
    controller: str
    bandwidth: float | None  # Hz, at -3 dB; None if no loop qualifies
    sensitivity: float | None
    p: float | None
    d: float | None
    attitude_gain: float | None
    tuning: PredictorTuning | None
    overshoot_percent: float | None
    noise_gain: float | None  # command per rad/s


def turbojet_plant() -> tuple[RateModel, RateModel]:
    """Return the Hex-Jet's roll plant on true turbojets, and the second-order model of its predictor.

    Gain: that of G(z), times the ratio of turbojet to EDF thrust per throttle at rest.  Lags: the turbojet's and the
    9 ms that the identified roll lag has more than the EDF.  The model has one lag, the sum of both.
    """
    step = numbers.value("hexjet.step")
    thrust = {
        name: numbers.value(f"{name}.gain") / (1.0 - numbers.value(f"{name}.pole")) for name in ("turbojet", "edf")
    }
    edf, jet = (-step / log(numbers.value(f"{name}.pole")) for name in ("edf", "turbojet"))
    remaining_lag = -step / log(numbers.value("roll.pole_fast")) - edf
    slow = -log(numbers.value("roll.pole_slow")) / step
    at_rest = model_response(numbers.roll_model(), np.ones(1, dtype=np.complex128))[0].real
    gain = float(at_rest) * slow * thrust["turbojet"] / thrust["edf"]
    truth = _discretise(gain, slow, [jet, remaining_lag], step, "true turbojet and gyro filter")
    model = _discretise(gain, slow, [jet + remaining_lag], step, "true turbojet, one lag")
    return truth, model


def _discretise(gain: float, slow: float, lags: list[float], step: float, source: str) -> RateModel:
    """Return ``gain / ((s + slow) prod(lag s + 1))`` with the turbojet's delay behind a zero-order hold."""
    rates = [slow, *(1.0 / lag for lag in lags)]
    poles = [exp(-rate * step) for rate in rates]
    top = gain * float(np.prod([1.0 / lag for lag in lags]))
    numerator = np.zeros(len(rates))
    for i, rate in enumerate(rates):
        others = [other for j, other in enumerate(rates) if j != i]
        residue = top / float(np.prod([other - rate for other in others]))
        weight = residue * (1.0 - poles[i]) / rate
        numerator = numerator + weight * np.poly([pole for j, pole in enumerate(poles) if j != i])
    zeros = np.roots(numerator)
    return RateModel(
        gain=float(numerator[0]),
        zeros=[float(zero.real) for zero in zeros],
        poles=poles,
        delay_samples=numbers.value("hexjet.delay"),
        sample_time_s=step,
        source=source,
    )


def turbojet(calibration: Calibration) -> list[Reach]:
    """Search for each controller's largest attitude bandwidth, with the delayed fans and with true turbojets.

    The search covers rate gain, derivative in time constants of the engine, attitude gain and the predictor's tuning;
    there is no integral, which costs every controller the same.
    """
    truth, model = turbojet_plant()
    edf = numbers.roll_model()
    designs = []
    for engine, plant, believed, lag in (("edf-as-flown", edf, edf, 0.039), ("turbojet", truth, model, 0.338)):
        for controller in HEXJET:
            base = hexjet_axis(calibration, controller, "vehicle", noisy=False)
            axis = replace(base, plant=Plant(plant), model=believed, rate_limit=inf)
            designs.append(_search_bandwidth(engine, axis, lag))
    return designs


def _list_tunings(axis: Axis) -> list[PredictorTuning]:
    """Return tunings with the predictor's parameters at a third, once and three times those of ``vehicle.toml``."""
    if not predictor(axis.controller).parameters:
        return [axis.tuning]
    t = axis.tuning
    return [
        PredictorTuning(
            filter_s=t.filter_s / factor,
            observer_rad_s=t.observer_rad_s * factor,
            model_observer_rad_s=t.model_observer_rad_s * factor,
            disturbance_observer_rad_s=t.disturbance_observer_rad_s * factor,
        )
        for factor in (1.0 / 3.0, 1.0, 3.0)
    ]


def _search_bandwidth(engine: str, axis: Axis, lag: float) -> Reach:
    """Search for the largest bandwidth of a controller on a coarse grid, then on finer ones around the best."""
    z = grid(500, lowest=1e-3)
    # p is in units of the gain that makes the rate loop as fast as the lag.
    unit = 1.0 / integrating_gain(axis.model) / lag

    def make_candidate(tuned: Axis, p: float, d: float, gain: float) -> Axis:
        gains = axis.gains.model_copy(update={"p": p * unit, "i": 0.0, "d": d * lag * p * unit})
        return replace(tuned, gains=gains, attitude_gain=gain)

    best, at = 0.0, (1.0, 0.0, 1.0)
    chosen: Axis | None = None
    for tuning in _list_tunings(axis):
        tuned = replace(axis, tuning=tuning)
        responses = (z, *predictor_response(tuned.controller, tuned.model, tuning)(z))
        points = [
            (float(p), d, float(gain))
            for d in (0.0, 0.5, 1.0)
            for p in np.geomspace(0.05, 30.0, 14)
            for gain in np.geomspace(0.1, 8.0, 14)
        ]
        for width in (0.0, 1.25, 1.1, 1.03):
            if width:  # around the best point so far
                if chosen is None or chosen.tuning != tuning:
                    break
                factors = (1.0 / width, 1.0, width)
                p, d, gain = at
                shapes = {max(0.0, d + shift * (width - 1.0)) for shift in (-0.5, 0.0, 0.5)}
                points = [(p * a, shape, gain * b) for shape in sorted(shapes) for a in factors for b in factors]
            for point in points:
                trial = make_candidate(tuned, *point)
                bandwidth = _find_bandwidth(trial, responses, best)
                if bandwidth is not None:
                    best, at, chosen = bandwidth, point, trial
    if chosen is None:
        return Reach(
            engine=engine, controller=axis.controller, bandwidth=None, sensitivity=None, p=None, d=None,
            attitude_gain=None, tuning=None, overshoot_percent=None, noise_gain=None,
        )  # fmt: skip
    record = simulate(replace(chosen, command_limit=inf), round(12.0 / chosen.step), setpoint=lambda k: 0.01)
    return Reach(
        engine=engine,
        controller=chosen.controller,
        bandwidth=best,
        sensitivity=LoopMap(chosen).peak_sensitivity(1.0, chosen.delay_samples),
        p=chosen.gains.p,
        d=chosen.gains.d,
        attitude_gain=chosen.attitude_gain,
        tuning=chosen.tuning,
        overshoot_percent=max(0.0, 100.0 * (max(record.angle) / 0.01 - 1.0)),
        noise_gain=noise_gain(chosen),
    )


def _find_bandwidth(axis: Axis, responses: tuple[Complex, Complex, Complex], beat: float) -> float | None:
    """Return the -3 dB bandwidth of roll [Hz] if above ``beat``, stable and at most of MAX_SENSITIVITY; else None."""
    z = responses[0]
    loop = LoopMap(axis, known=responses)
    error, _ = controllers_response(axis, z)
    angle = 0.5 * axis.step * (z + 1.0) / (z - 1.0) * loop.plant(1.0, axis.delay_samples)
    closed = np.abs(axis.attitude_gain * error * angle / loop.characteristic(1.0, axis.delay_samples))
    level = 10.0 ** (-3.0 / 20.0)
    below = np.flatnonzero(closed < level)
    if not below.size or below[0] == 0:
        return None
    k = below[0]
    fraction = (closed[k - 1] - level) / (closed[k - 1] - closed[k])
    turn = float(np.angle(z[k - 1]) + fraction * (np.angle(z[k]) - np.angle(z[k - 1])))
    bandwidth = turn / (2.0 * pi * axis.step)
    if bandwidth <= beat or loop.peak_sensitivity(1.0, axis.delay_samples) > MAX_SENSITIVITY:
        return None
    return None if loop.unstable_poles(1.0, axis.delay_samples) else bandwidth
