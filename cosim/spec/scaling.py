"""Scaling of an aircraft to another mass by Froude's law, at equal density and equal thrust-to-weight ratio.

With ``L = (mass / mass_0)^(1/3)`` lengths grow by L, times by sqrt(L), masses and forces by L^3; gravity and angles
stay.  Everything else follows from its unit, so that the scaled aircraft flies the same paths, L times as large and
sqrt(L) times as slowly, wherever its engines do so too.  Real engines do not: gains that come from here are a first
guess.

Sensors are not scaled, and identified models are left out because they belong to an engine.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Exponents of L. A torque command in throttle or tilt gives an angular acceleration that falls with L.
_LENGTH, _TIME, _MASS = 1.0, 0.5, 3.0
_RATE, _SPEED = -_TIME, _LENGTH - _TIME  # 1/s, m/s
_P, _I, _D = _LENGTH - _TIME, _LENGTH - 2 * _TIME, _LENGTH  # command per rad/s, rad, rad/s^2

_LEAD = {"natural_rad_s": _RATE, "pole_rad_s": _RATE}  # exponents of L for a lead
_AIR = {"kg_s": _MASS - _TIME, "at_thrust_n": _MASS, "intake_m": _LENGTH, "exhaust_m": _LENGTH}  # of L for airflow
_PID = {"p": _P, "i": _I, "d": _D, "d_filter_s": _TIME}  # exponents of L for a PID's gains
_VEHICLE_EXPONENTS: dict[str, Any] = {  # exponents of L by key
    "inertia_kg_m2": _MASS + 2 * _LENGTH,
    "products_kg_m2": _MASS + 2 * _LENGTH,
    "jets": {"position_m": _LENGTH, "reaction_m": _LENGTH, "airflow": _AIR},
    "fuel": {"mass_kg": _MASS, "position_m": _LENGTH},
    "panels": {"corners_m": _LENGTH},
    "contacts": {"position_m": _LENGTH, "spring_n_m": _MASS - 2 * _TIME, "damping_n_s_m": _MASS - _TIME},
    "servo": {
        "lag_s": _TIME,
        "rate_limit_rad_s": _RATE,
        "bank_inertia_kg_m2": _MASS + 2 * _LENGTH,
        "bank_imbalance_kg_m": _MASS + _LENGTH,
    },
    "airflow": _AIR,
    "ground_effect": {"planform_m": _LENGTH, "jet_m": _LENGTH, "planform_z_m": _LENGTH, "hot_gas_height_m": _LENGTH},
    "aero": {
        "span_m": _LENGTH,
        "drag_area_m2": 2 * _LENGTH,
        "centre_m": _LENGTH,
        "damping_n_m_s": _MASS + 2 * _LENGTH - _TIME,
    },
    "control": {
        "attitude": {"gain_1_s": _RATE, "rate_limit_rad_s": _RATE},
        "rate": {"roll": _PID, "pitch": _PID, "yaw": _PID},
        "altitude": {
            "position_1_s": _RATE,
            "climb_limit_m_s": _SPEED,
            "descent_limit_m_s": _SPEED,
            "velocity_1_s": _RATE,
            "integral_1_s2": 2 * _RATE,
        },
        "lead": {"roll": _LEAD, "pitch": _LEAD, "yaw": _LEAD, "altitude": _LEAD},
        "schedule": {"filter_s": _TIME, "level": {"roll": _LEAD, "altitude": _LEAD}},
        "position": {
            "position_1_s": _RATE,
            "velocity_1_s": _RATE,
            "catch_up_m_s": _SPEED,
            "acceleration_noise_m_s15": _LENGTH - 1.5 * _TIME,
            "disturbance_walk_m_s25": _LENGTH - 2.5 * _TIME,
        },
        "pilot": {
            "speed_m_s": _SPEED,
            "jerk_m_s3": _LENGTH - 3 * _TIME,
            "climb_m_s": _SPEED,
            "descent_m_s": _SPEED,
            "land_m_s": _SPEED,
            "yaw_rate_rad_s": _RATE,
            "takeoff_height_m": _LENGTH,
            "return_height_m": _LENGTH,
            "spool_s": _TIME,
        },
        "predictor": {
            "filter_s": _TIME,
            "observer_rad_s": _RATE,
            "model_observer_rad_s": _RATE,
            "disturbance_observer_rad_s": _RATE,
        },
    },
    "limits": {"rate_deg_s": _RATE, "touchdown_m_s": _SPEED},
}


def length_scale(mass: float, original: float) -> float:
    """Return the length scale L of an aircraft of ``mass`` relative to the ``original`` mass, both in kg."""
    return float((mass / original) ** (1.0 / 3.0))


def scale_vehicle(tables: Mapping[str, Any], mass: float) -> dict[str, Any]:
    """Return the tables of a ``vehicle.toml`` scaled to ``mass`` [kg]; keys that have no exponent stay as they are."""
    data: dict[str, Any] = _scale_value(tables, _VEHICLE_EXPONENTS, length_scale(mass, tables["mass_kg"]))
    return data | {"mass_kg": mass, "identified": {}}


def _scale_value(value: Any, law: Any, scale: float) -> Any:
    if isinstance(value, list):
        return [_scale_value(item, law, scale) for item in value]
    if value is False:
        return value
    if not isinstance(law, dict):
        return value * scale**law
    return {key: _scale_value(item, law[key], scale) if key in law else item for key, item in value.items()}
