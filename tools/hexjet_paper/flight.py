"""The paper's experiments in six degrees of freedom: the same experiments, flown by the co-simulation.

The quadrotor and the Hex-Jet fly as their ``vehicle.toml`` states them, with the calibrated roll gains written over it.
The payload is a point mass on the vehicle, not a change of the plant's gain: what it does to the roll axis follows.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim import Run, Scenario, fly, load_vehicle
from hexjet_paper import numbers
from hexjet_paper.experiments import PAYLOAD_POSITION_M, Experiment, Fidelity, Result, result
from hexjet_paper.frozen import Calibration


def flight(calibration: Calibration, noisy: bool = True) -> Fidelity:
    """Return a function that flies experiments in six degrees of freedom; it raises InputError as :func:`fly`."""

    def fly_one(experiment: Experiment) -> Result:
        return read(experiment, calibration, fly(scenario(experiment, calibration, noisy)))

    return fly_one


def read(experiment: Experiment, calibration: Calibration, run: Run) -> Result:
    """Return metrics and series of an experiment from its flight."""
    log = run.log
    return result(
        experiment,
        calibration,
        log["roll_setpoint_rad"].tolist(),
        log["roll_rad"].tolist(),
        log["rate_p_rad_s"].tolist(),
        log["torque_roll"].tolist(),
    )


def scenario(experiment: Experiment, calibration: Calibration, noisy: bool = True) -> Scenario:
    """Return an experiment as a scenario, which a user can fly and change."""
    hexjet = experiment.kind == "hexjet-doublet"
    table = (_make_hexjet_table if hexjet else _make_quadrotor_table)(experiment, calibration)
    data: dict[str, Any] = {
        "name": experiment.name,
        "title": f"{experiment.kind}, {experiment.delay_samples} samples, {experiment.controller}",
        "controller": experiment.controller,
        "duration_s": experiment.run,
        "sensor_noise": noisy,
        "step_s": experiment.step,
        **table,
    }
    if experiment.kind == "disturbance":
        # A scenario's edges fall on steps, so the calibrated length is rounded to whole steps.
        width = round(experiment.half_length(calibration) / experiment.step) * experiment.step
        data["disturbance"] = [
            *table.get("disturbance", []),
            {
                "kind": "torque_command",
                "axis": "roll",
                "shape": "doublet",
                "start_s": experiment.start,
                "duration_s": 2.0 * width,
                "amplitude": experiment.amplitude,
                "at": "controller",
                "seen": calibration.predictor_sees_disturbance and not experiment.unseen,
            },
        ]
    else:
        data["command"] = [
            {
                "kind": "doublet",
                "signal": "roll_deg",
                "start_s": experiment.start,
                "amplitude": numbers.value("hexjet.amplitude" if hexjet else "step.amplitude"),
                "width_s": experiment.half_length(calibration),
            }
        ]
    return Scenario.from_table(data, Path(), f"experiment {experiment.name}")


def _make_quadrotor_table(experiment: Experiment, calibration: Calibration) -> dict[str, Any]:
    vehicle, _ = load_vehicle("quadrotor")
    attitude = vehicle.control.attitude
    roll = {
        "p": calibration.p,
        "i": calibration.i,
        "d": calibration.d,
        "d_filter_s": calibration.d_filter_s,
        "integral_limit": 1.0,
    }
    data: dict[str, Any] = {
        "aircraft": "quadrotor",
        "engine": "motor",
        "added_delay_samples": experiment.delay_samples,
        "vehicle": {
            "sensors": {"gyro": {"noise_rad_s": calibration.gyro_noise_rad_s}},
            "control": {
                "rate": {"roll": roll},
                "attitude": {
                    "gain_1_s": [calibration.attitude_gain_1_s, *attitude.gain_1_s[1:]],
                    # The paper states no rate limit, and its steps command more than usual limits allow.
                    "rate_limit_rad_s": [100.0, *attitude.rate_limit_rad_s[1:]],
                },
                "predictor": {
                    "filter_s": calibration.filter_s,
                    "observer_rad_s": calibration.observer_rad_s,
                    "model_observer_rad_s": calibration.model_observer_rad_s,
                    "disturbance_observer_rad_s": calibration.disturbance_observer_rad_s,
                },
            },
        },
    }
    if experiment.payload:
        mass = numbers.value("quadrotor.payload")
        data["disturbance"] = [{"kind": "payload", "start_s": 0.0, "mass_kg": mass, "offset_m": PAYLOAD_POSITION_M}]
        # The vehicle takes off with the load, so its height loop must be able to add the throttle for it.
        data["vehicle"]["control"]["altitude"] = {"integral_limit_m_s2": 6.0}
    return data


def _make_hexjet_table(experiment: Experiment, calibration: Calibration) -> dict[str, Any]:
    data: dict[str, Any] = {"aircraft": "hexjet", "engine": "edf-as-flown"}
    if experiment.gains == "calibrated":
        vehicle, _ = load_vehicle("hexjet")
        control = vehicle.control
        integral_ratio = control.rate.roll.i / control.rate.roll.p
        gains = [calibration.hexjet_attitude_gain_1_s, *control.attitude.gain_1_s[1:]]
        data["vehicle"] = {
            "control": {
                "rate": {"roll": {"p": calibration.hexjet_p, "i": integral_ratio * calibration.hexjet_p}},
                "attitude": {"gain_1_s": gains},
            }
        }
    return data
