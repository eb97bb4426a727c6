"""The page's data as plain JSON values: the flight once, its state many times a second.

Angles are in degrees here, temperatures in degrees Celsius, speeds of rotation in revolutions a minute; the page shows
what it gets.  None is "not known".  Attitude, height, rates and place are those that the vehicle itself goes by.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import degrees, isfinite, pi
from typing import Any

from cosim.base.frames import to_euler
from cosim.base.protocols import EngineState
from cosim.base.signals import Sample
from cosim.control.autopilot.modes import DIRECT, Home, Message, Mode
from cosim.control.autopilot.parameters import Parameters
from cosim.groundstation.exchange import FlightInfo, Snapshot
from cosim.results.log.columns import log_columns, logged_vehicle
from cosim.results.log.recorder import OneRow
from cosim.results.report.signals_data import describe_shape
from cosim.spec.scenario import controller_shown

Point = tuple[float | None, ...]  # t [s]; p, q, r and predicted [deg/s]


def describe_flight(info: FlightInfo) -> dict[str, Any]:
    """Return the constant data of a flight for the page."""
    scenario, vehicle = info.scenario, info.vehicle
    return {
        "type": "flight",
        "number": info.number,
        "scenario": scenario.name,
        "vehicle": vehicle.name,
        "controller": controller_shown(scenario),
        "engines": [{"name": spec.name, "most_N": _round_finite(spec.curve.thrust[-1])} for spec in info.stations],
        "watched": scenario.monitored,
        "takeoff_m": info.parameters["MIS_TAKEOFF_ALT"],
        "modes": [mode.value for mode in Mode if mode is not Mode.ORBIT],
        "direct": [mode.value for mode in Mode if mode in DIRECT],
        "shape": describe_shape(vehicle),
        "columns": [column[:4] for column in log_columns(logged_vehicle(vehicle), info.columns)],
    }


def describe_parameters(parameters: Parameters) -> list[dict[str, Any]]:
    """Return the vehicle's parameters for the page, without values, which are sent separately."""
    keys = ("name", "kind", "unit", "group", "text", "default", "least", "most", "values", "read_only")
    return [{key: getattr(line, key) for key in keys} for line in parameters]


class RowConverter:
    """Converts a sample to log columns, in the order of :func:`describe_flight`.

    ``digits``: of a number: a strip has a thousand pixels, a position 1 mm in 1 km.
    """

    def __init__(self, digits: int = 6) -> None:
        self.digits = digits
        self._flight = 0
        self._row = OneRow()

    def __call__(self, info: FlightInfo, sample: Sample | None) -> list[float | None]:
        """Return one number a column, rounded to what a screen shows; empty before the first step."""
        if sample is None:
            return []
        if info.number != self._flight:
            self._flight, self._row = info.number, OneRow(log_columns(logged_vehicle(info.vehicle), info.columns))
        return [
            float(f"{value:.{self.digits}g}") if isfinite(value) else None for (value,) in self._row(sample).tolist()
        ]


def describe_state(snapshot: Snapshot) -> dict[str, Any]:
    """Return what the page shows of a step, by the names of its script; numbers that are not finite are None."""
    status, pace, ending = snapshot.status, snapshot.pace, snapshot.ending
    estimate = status.seen or snapshot.measured
    sample = snapshot.sample
    return {
        "type": "state",
        "t": round(snapshot.time, 3),
        "mode": status.mode.value,
        "armed": status.armed,
        "landed": status.landed.value,
        "engines_do": status.engines.value,
        "ready": status.ready,
        "refusals": status.refusals,
        "failsafe": status.failsafe,
        "home": _list_coordinates(status.home),
        "target": _list_coordinates(status.target),
        "position": _round_list(status.fix.position),
        "velocity": _round_list((*status.fix.velocity, estimate.velocity[2])),
        "height": _round_finite(estimate.altitude),
        "height_asked": _round_finite(status.altitude),
        "attitude_deg": _to_degrees(to_euler(estimate.attitude)),
        "attitude_asked_deg": _to_degrees(sample.command.attitude) if sample and sample.command.rate is None else None,
        "remaining": _round_finite(status.remaining),
        "jets": [] if sample is None else describe_jets(snapshot.info, sample, status.engines is EngineState.OFF),
        "pace": {"asked": pace.factor, "reached": _round_finite(pace.reached_factor), "missed": pace.missed},
        "ending": None if ending is None else {"outcome": ending.outcome, "reason": ending.reason},
    }


def describe_jets(info: FlightInfo, sample: Sample, off: bool) -> list[dict[str, Any]]:
    """Return each engine's commanded and actual thrust [N] and its reports; ``off``: all are shut off.

    The thrust asked for is the steady one at the throttle asked for, from the engine's static curve.
    """
    out, jets = sample.engines, []
    for jet, spec in enumerate(info.stations):
        throttle = 0.0 if off else sample.actuation.throttle[jet]
        jets.append(
            {
                "throttle": _round_finite(throttle),
                "asked_N": 0.0 if off else _round_finite(spec.thrust_at(throttle)),
                "thrust_N": _round_finite(out.thrust[jet]),
                "rpm": _round_finite(out.spool_speed[jet] * (30.0 / pi)),
                "exhaust_C": _round_finite(out.exhaust_temperature[jet] - 273.15),
                "fuel_g_s": _round_finite(1e3 * out.fuel_flow[jet]) if spec.has_port("fuel_flow") else None,
                "health": _round_finite(sample.health[jet]),
                "fault": bool(sample.faults[jet]),
            }
        )
    return jets


def make_chart_point(sample: Sample) -> Point:
    """Return a point of the strip chart: time, measured rates, and rates fed to the rate loop [deg/s]."""
    rates = (*sample.measured.rate, *sample.control.rate_predicted)
    return (round(sample.time, 3), *(round(degrees(rate), 2) if isfinite(rate) else None for rate in rates))


def describe_messages(messages: Iterable[Message], step: float) -> list[dict[str, Any]]:
    """Return text messages for the page, with time in s from steps of ``step`` s."""
    return [
        {
            "number": message.number,
            "t": round(message.k * step, 3),
            "severity": message.severity.name,
            "text": message.text,
        }
        for message in messages
    ]


def _round_finite(value: float | None, decimals: int = 4) -> float | None:
    return None if value is None or not isfinite(value) else round(value, decimals)


def _round_list(values: Iterable[float]) -> list[float | None]:
    return [_round_finite(value) for value in values]


def _to_degrees(values: Iterable[float]) -> list[float | None]:
    return [_round_finite(degrees(value)) for value in values]


def _list_coordinates(home: Home | None) -> list[float | None] | None:
    return None if home is None else _round_list(home)
