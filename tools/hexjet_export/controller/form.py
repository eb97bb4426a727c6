"""The constants of every block of a flight's cascade, as plain numbers from which the C of a controller is written.

Numbers are Python's own and are printed so that a C compiler reads the same bits.  What a block computes with is asked
of the block that flies, not computed anew.
"""

from __future__ import annotations

from math import exp

from cosim import InputError
from cosim.base.signals import AXES
from cosim.blocks import (
    PREDICTORS,
    SCHEDULE_RESOLUTION,
    Cascade,
    EffectivenessAllocator,
    Inverse,
    Lead,
    RateLaw,
    RotorAllocator,
    Simulation,
    ThrustMap,
    TiltAllocator,
    command_to_torque,
)
from cosim.spec.vehicle import EngineLead, RateGains, Vehicle
from hexjet_export.controller.hinged import make_hinged_form
from hexjet_export.controller.predictor_form import Form, make_predictor_form

LAWS = ("pid", "pid-smith", "pid-filtered-smith", "pid-state", "pid-state-disturbance", "optimal")  # laws with a C form


def make_form(simulation: Simulation, loops: bool = False) -> Form:
    """Return the constants of a simulation's control cascade, by block, for the C templates.

    ``loops``: only the control loops, without the allocation to engines and servos.

    Raises InputError for a controller, predictor or allocator that has no C form.
    """
    law = _law_axes(simulation)
    cascade, vehicle, step = simulation.cascade, simulation.vehicle, simulation.dt
    schedule = _make_schedule_form(vehicle, step)
    if schedule is not None and law is not None:
        raise InputError(f"controller {simulation.scenario.controller} has no C form where gains follow the thrust")
    leads = [_make_lead_form(getattr(vehicle.control.lead, axis, None), step) for axis in AXES]
    rate = vehicle.control.rate
    predictors = cascade.rate.predictors
    axes = [
        {
            "name": axis,
            "gains": _make_gains_form(gains, step),
            "predictor": make_predictor_form(predictor, axis),
            "lead": lead,
            "scheduled": schedule is not None and axis == "roll",
        }
        for axis, gains, predictor, lead in zip(AXES, (rate.roll, rate.pitch, rate.yaw), predictors, leads, strict=True)
    ]
    height = vehicle.control.altitude
    return {
        "law": law is not None,
        "jets": len(vehicle.jets),
        "step": step,
        "mass": vehicle.mass_kg,
        "attitude": {
            "gain": list(vehicle.control.attitude.gain_1_s),
            "limit": list(vehicle.control.attitude.rate_limit_rad_s),
        },
        "axes": law or axes,
        "altitude": {
            "position": height.position_1_s,
            "up": height.climb_limit_m_s,
            "down": -height.descent_limit_m_s,
            "velocity": height.velocity_1_s,
            "integral": height.integral_1_s2 * step,
            "limit": height.integral_limit_m_s2,
            "lead": _make_lead_form(getattr(vehicle.control.lead, "altitude", None), step),
        },
        "schedule": schedule,
        "allocation": _make_throttle_form(cascade, vehicle) if loops else _make_allocation_form(cascade, vehicle),
        "servos": list(vehicle.actuators),
        "loops": loops,
        "accelerations": vehicle.allocation == "effectiveness",
        "thrust": _make_thrust_form(cascade.thrust_map, loops),
        "delay": 0 if loops else simulation.scenario.added_delay_samples,
    }


def _law_axes(simulation: Simulation) -> list[Form] | None:
    """Return the constants by axis of a rate law that is a PID with a predictor; None for the built-in loops.

    Raises InputError for any other controller from outside.
    """
    source, step = simulation.controller_source, simulation.dt
    if source is None:
        return None
    law = getattr(simulation.cascade.loops.custom_rate, "block", None) if source.level == "rate" else None
    axes = law.pid_axes if isinstance(law, RateLaw) else None
    if axes is None:
        allowed = ", ".join([*PREDICTORS, *LAWS])
        raise InputError(f"controller {source.label} has no C form; allowed: {allowed}, or a design's file")
    return [
        {
            "name": name,
            "gains": _make_gains_form(axis.gains, step),
            "scale": scale,
            "predictor": make_predictor_form(axis.predictor, name),
            "lead": None,
            "scheduled": False,
        }
        for name, (axis, scale) in zip(AXES, axes, strict=True)
    ]


def _make_gains_form(gains: RateGains, step: float) -> Form:
    return {
        "p": gains.p,
        "i": gains.i * step,
        "d": gains.d,
        "limit": gains.integral_limit,
        "share": step / (gains.d_filter_s + step),
    }


def _make_lead_form(spec: EngineLead | bool | None, step: float) -> Form | None:
    if not isinstance(spec, EngineLead):
        return None
    names = ("most", "p", "q", "c1", "c2")
    constants = dict(zip(names, Lead(spec, step).constants, strict=True))
    return {"order": 1 if spec.damping is None else 2, "constants": constants}


def _make_schedule_form(vehicle: Vehicle, step: float) -> Form | None:
    spec = vehicle.control.schedule
    if not spec:
        return None
    shares = [level.share for level in spec.level]
    keys = ("angle", "p", "i", "d", "natural_rad_s", "damping", "pole_rad_s")
    return {
        "share": shares,
        "follow": 1.0 - exp(-step / spec.filter_s),
        "fine": SCHEDULE_RESOLUTION * (shares[-1] - shares[0]),
        "levels": {
            name: [[getattr(getattr(level, name), key) or 0.0 for key in keys] for level in spec.level]
            for name in ("roll", "altitude")
        },
    }


def _make_throttle_form(cascade: Cascade, vehicle: Vehicle) -> Form:
    limits = vehicle.control.allocation
    return {"kind": "none", "low": limits.throttle_min, "high": limits.throttle_max, "hover": cascade.allocator.hover}


def _make_allocation_form(cascade: Cascade, vehicle: Vehicle) -> Form:
    allocator, limits_form = cascade.allocator, _make_throttle_form(cascade, vehicle)
    if isinstance(allocator, TiltAllocator) and vehicle.servo is not None:
        return limits_form | {
            "kind": "tilt",
            "idle": cascade.thrust_map.idle,
            "range": vehicle.servo.range_rad,
            "pitch_sign": allocator.pitch_sign,
            "hover_thrust": allocator.hover + cascade.thrust_map.idle,
            "left": list(allocator.left),
            "inverse": command_to_torque(len(vehicle.jets), allocator),
        }
    if isinstance(allocator, RotorAllocator):
        signs = [list(signs) for signs in allocator.signs]
        return limits_form | {
            "kind": "rotor",
            "signs": signs,
            "inverse": command_to_torque(len(vehicle.jets), allocator),
        }
    if isinstance(allocator, EffectivenessAllocator):
        return limits_form | make_hinged_form(allocator, vehicle)
    raise InputError(
        f"{type(allocator).__name__}: has no C form; those of banks, rotors and hinges have; hexjet export vehicle "
        "writes the whole vehicle as an FMU"
    )


def _make_thrust_form(thrust_map: ThrustMap, loops: bool) -> Form:
    curves: list[Inverse] = []

    def number_curve(curve: Inverse | None) -> int | None:
        if curve is None:
            return None
        if not any(curve is other for other in curves):
            curves.append(curve)
        return next(i for i, other in enumerate(curves) if other is curve)

    reference = number_curve(thrust_map.inverse)
    stations = [] if loops else [number_curve(curve) for curve in thrust_map.stations]
    return {
        "identity": thrust_map.identity,
        "low": thrust_map.low,
        "span": thrust_map.span,
        "reference": reference,
        "mapped": [
            {"jet": jet, "curve": curve, "points": len(curves[curve].thrusts)}
            for jet, curve in enumerate(stations)
            if curve is not None
        ],
        "curves": [{"throttle": list(c.throttles), "thrust": list(c.thrusts), "slope": list(c.slopes)} for c in curves],
    }
