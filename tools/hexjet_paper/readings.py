"""Readings of the paper's section II-D, each flown: what stands behind the printed roll response G(z).

The text says that ``G_turbo(z) / G_EDF(z)`` was put into the scaled model before it was identified.  The printed G(z)
has no pole of the turbojet.  The reading that this project flies by default is *delay only*: the 25 samples were put in
and the fans' lag stayed.  Under the other two the plant has the turbojet's dynamics, and the printed gain is taken for
the corrected model's or for the fans'.  A reading is a change of the shipped aircraft and nothing else.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from scipy import constants

from cosim import Scenario, fly, load_vehicle
from cosim.loops import RateModel
from hexjet_paper import numbers
from hexjet_paper.experiments import Experiment, Metrics, Result, hexjet_axis, linear_run
from hexjet_paper.extensions import integrating_gain
from hexjet_paper.flight import read, scenario
from hexjet_paper.frozen import Calibration, load
from hexjet_paper.linear import Axis, Plant
from hexjet_paper.loops import unstable_poles
from hexjet_paper.numbers import Record

# Factor of raised to fitted gains: 8 % past the baseline's limit, as the gains of vehicle.toml are for "delay only".
RAISED_GAINS = 1.35
COMPARED = ("baseline", "smith")  # controllers of these flights


@dataclass(frozen=True)
class Reading:
    """One reading of the paper: what its printed model means for engine and gain of the Hex-Jet's roll axis.

    ``gain``: slope of the rate per command over that of the printed G(z).
    """

    key: str
    title: str
    engine: str
    gain: float

    @property
    def corrected(self) -> bool:
        """Whether the turbojet's dynamics are in the plant."""
        return self.engine == "turbojet"

    @property
    def thrust_kgf(self) -> float:
        """Thrust at rest per unit throttle [kgf]."""
        return thrust_at_rest("turbojet" if self.corrected else "edf")

    @property
    def inertia(self) -> float:
        """``J_xx = 6 L_y T / K`` [kg m^2] from thrust ``T`` and slope ``K`` of this reading."""
        vehicle, _ = load_vehicle("hexjet")
        return vehicle.inertia_kg_m2[0] * self.thrust_kgf / thrust_at_rest("edf") / self.gain

    @property
    def model(self) -> RateModel:
        """Model of the predictor: the printed G(z), or its product with ``G_turbo(z) / G_EDF(z)``."""
        printed = numbers.roll_model()
        if not self.corrected:
            return printed
        ratio = thrust_at_rest("turbojet") / thrust_at_rest("edf")
        numerators = numbers.value("turbojet.gain") / numbers.value("edf.gain")
        return printed.model_copy(
            update={
                "gain": printed.gain * numerators * self.gain / ratio,
                "zeros": [*printed.zeros, numbers.value("edf.pole")],
                "poles": [*printed.poles, numbers.value("turbojet.pole")],
                "source": "paper, G(z) G_turbo(z) / G_EDF(z)",
            }
        )

    def vehicle(self) -> dict[str, Any]:
        """Return changes of the shipped aircraft: inertia, damping and model; none for "delay only"."""
        if not self.corrected:
            return {}
        shipped, _ = load_vehicle("hexjet")
        ratio = self.inertia / shipped.inertia_kg_m2[0]
        return {
            "inertia_kg_m2": [self.inertia, *shipped.inertia_kg_m2[1:]],
            "aero": {"damping_n_m_s": [ratio * shipped.aero.damping_n_m_s[0], *shipped.aero.damping_n_m_s[1:]]},
            "identified": {self.engine: {"roll": self.model.model_dump()}},
        }


def thrust_at_rest(engine: str) -> float:
    """Return the gain at rest of a printed engine (``edf``, ``turbojet``) [kgf per unit throttle]."""
    return numbers.value(f"{engine}.gain") / (1.0 - numbers.value(f"{engine}.pole"))


DELAY_ONLY = Reading("delay", "delay only", "edf-as-flown", 1.0)  # the printed model has only the delay
READINGS: dict[str, Reading] = {  # by key
    reading.key: reading
    for reading in (
        DELAY_ONLY,
        Reading("corrected", "corrected, the printed gain the turbojets'", "turbojet", 1.0),
        Reading(
            "corrected-fans",
            "corrected, the printed gain the fans'",
            "turbojet",
            thrust_at_rest("turbojet") / thrust_at_rest("edf"),
        ),
    )
}


class Gains(Record):
    """Pair of rate and attitude gain that a reading is flown with."""

    name: str  # "shipped", "fitted" or "raised"
    p: float  # command per rad/s
    attitude_gain_1_s: float


def gain_pairs(reading: Reading, calibration: Calibration) -> Iterator[Gains]:
    """Yield the pairs of gains of a reading: of ``vehicle.toml``, fitted to the printed ratios, and raised.

    On "delay only" the raised ones are those of ``vehicle.toml``.
    """
    control = load_vehicle("hexjet")[0].control
    shipped = Gains(name="shipped", p=control.rate.roll.p, attitude_gain_1_s=control.attitude.gain_1_s[0])
    yield shipped
    if not reading.corrected:
        yield Gains(name="fitted", p=calibration.hexjet_p, attitude_gain_1_s=calibration.hexjet_attitude_gain_1_s)
        return
    p, attitude = calibration.corrected_p / reading.gain, calibration.corrected_attitude_gain_1_s
    yield Gains(name="fitted", p=p, attitude_gain_1_s=attitude)
    yield Gains(name="raised", p=RAISED_GAINS * p, attitude_gain_1_s=RAISED_GAINS * attitude)


def largest_gains(reading: Reading, controller: str, calibration: Calibration) -> float:
    """Return the factor [to 0.01] on both fitted gains at which the linear plant's loop becomes unstable."""
    fitted = next(pair for pair in gain_pairs(reading, calibration) if pair.name == "fitted")

    def is_unstable(percent: int) -> bool:
        factor = 0.01 * percent
        gains = Gains(name="", p=factor * fitted.p, attitude_gain_1_s=factor * fitted.attitude_gain_1_s)
        return unstable_poles(reading_axis(reading, gains, controller, calibration, noisy=False)) > 0

    return 0.01 * bisect_left(range(1000), True, lo=100, key=is_unstable)


def doublet_of(reading: Reading, gains: Gains, controller: str) -> Experiment:
    """Return the roll doublet of a reading: the paper's, four times as long where the plant is slower."""
    return Experiment(
        "hexjet-doublet",
        controller,
        25,
        gains="calibrated" if gains.name == "fitted" else "vehicle",
        stretch=4.0 if reading.corrected else 1.0,
    )


def reading_axis(reading: Reading, gains: Gains, controller: str, calibration: Calibration, noisy: bool = True) -> Axis:
    """Return a reading's roll loop on the linear plant; the integral gain stays in proportion to ``p``."""
    axis = hexjet_axis(calibration, controller, "vehicle", noisy)
    rate = axis.gains.model_copy(update={"p": gains.p, "i": axis.gains.i / axis.gains.p * gains.p})
    model = reading.model
    return replace(axis, plant=Plant(model), model=model, gains=rate, attitude_gain=gains.attitude_gain_1_s)


def reading_scenario(
    reading: Reading, gains: Gains, controller: str, calibration: Calibration, noisy: bool = True
) -> Scenario:
    """Return a reading's doublet as a scenario: the shipped aircraft with the changes of the reading."""
    control = load_vehicle("hexjet")[0].control
    rate = control.rate.roll
    base = scenario(doublet_of(reading, gains, controller), calibration, noisy)
    return base.replace(
        name=f"reading-{reading.key}-{gains.name}.{controller}",
        engine=reading.engine,
        vehicle=reading.vehicle()
        | {
            "control": {
                "rate": {"roll": {"p": gains.p, "i": rate.i / rate.p * gains.p}},
                "attitude": {"gain_1_s": [gains.attitude_gain_1_s, *control.attitude.gain_1_s[1:]]},
            }
        },
    )


class Trial(Record):
    """One doublet of a reading in both fidelities."""

    gains: Gains
    controller: str
    each_s: float  # s, either half of the doublet
    linear: Metrics
    flight: Metrics
    lost_s: float | None  # s, time of the flight's failure


class ReadingResult(Record):
    """All doublets of a reading, and its vehicle."""

    key: str
    title: str
    engine: str
    thrust_n: float
    inertia_kg_m2: float
    slope: float  # rad/s^2 per unit throttle
    fast_pole: float  # pole of the model's slowest lag
    largest_gains: dict[str, float]  # by controller
    trials: list[Trial]

    def trial(self, gains: str, controller: str) -> Trial:
        """Return the doublet with named gains; "delay only" has those of ``vehicle.toml`` for raised ones."""
        raised = gains == "raised" and not any(trial.gains.name == "raised" for trial in self.trials)
        name = "shipped" if raised else gains
        return next(t for t in self.trials if (t.gains.name, t.controller) == (name, controller))


def fly_reading(key: str) -> ReadingResult:
    """Fly all doublets of a reading, on the linear plant and in six degrees of freedom."""
    reading, calibration = READINGS[key], load().parameters
    trials = []
    for gains in gain_pairs(reading, calibration):
        for controller in COMPARED:
            experiment = doublet_of(reading, gains, controller)
            axis = reading_axis(reading, gains, controller, calibration)
            result = read(experiment, calibration, fly(reading_scenario(reading, gains, controller, calibration)))
            trials.append(
                Trial(
                    gains=gains,
                    controller=controller,
                    each_s=experiment.half_length(calibration),
                    linear=linear_run(experiment, axis, calibration).metrics,
                    flight=result.metrics,
                    lost_s=_find_failure_time(result),
                )
            )
    return ReadingResult(
        key=key,
        title=reading.title,
        engine=reading.engine,
        thrust_n=reading.thrust_kgf * constants.g,
        inertia_kg_m2=reading.inertia,
        slope=reading.gain * integrating_gain(numbers.roll_model()),
        fast_pole=max(pole for pole in reading.model.poles if pole != numbers.value("roll.pole_slow")),
        largest_gains={c: largest_gains(reading, c, calibration) for c in COMPARED},
        trials=trials,
    )


def _find_failure_time(result: Result) -> float | None:
    seconds = len(result.time) * result.experiment.step
    return seconds if seconds < result.experiment.record - 0.5 * result.experiment.step else None


# Errors of the predictor's model that are flown: delay [samples], and factor on the printed gain.
DELAY_ERRORS, GAIN_FACTORS = (-10, 0, 10), (0.7, 1.0, 1.3)


class ModelError(Record):
    """Roll doublet with a predictor whose model differs from the vehicle's in delay and gain."""

    delay_error: int  # samples, added to the model's 25
    gain_factor: float  # factor on the model's gain
    stable: bool
    overshoot_percent: float | None
    settling_s: float | None
    rmse: float  # rad


def fly_model_errors() -> list[ModelError]:
    """Fly Smith's predictor at the gains of ``vehicle.toml`` with wrong models."""
    calibration = load().parameters
    experiment = Experiment("hexjet-doublet", "smith", 25, gains="vehicle")
    printed = numbers.roll_model()
    rows = []
    for delay in DELAY_ERRORS:
        for factor in GAIN_FACTORS:
            model = {"gain": factor * printed.gain, "delay_samples": printed.delay_samples + delay}
            vehicle = {"identified": {DELAY_ONLY.engine: {"roll": model}}}
            result = read(experiment, calibration, fly(scenario(experiment, calibration).replace(vehicle=vehicle)))
            m = result.metrics
            rows.append(
                ModelError(
                    delay_error=delay,
                    gain_factor=factor,
                    stable=m.stable,
                    overshoot_percent=m.overshoot_percent,
                    settling_s=m.settling_s,
                    rmse=m.rmse,
                )
            )
    return rows
