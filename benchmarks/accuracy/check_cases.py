"""Five of NASA's atmospheric check cases, flown by :class:`cosim.vehicle.airframe.Airframe` at a flight's step.

Source: NASA/TM-2015-218675, "Check-Cases for Verification of 6-Degree-of-Freedom Flight Vehicle Simulations".  The
trajectories of NASA's simulators are those published with SimuPy-Flight (nasa/simupy-flight on GitHub), in files
``Atmos_<case>_sim_<simulator>.csv``.  The Earth is WGS 84, turns at 7.292115e-5 rad/s and has a gravity with J2; the
air is the US Standard Atmosphere 1976.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from math import cos, degrees, radians, sin
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim import InputError, Scenario, load_vehicle
from cosim.base.signals import ZERO3, Disturbance, Vector3
from cosim.spec.scenario import Environment, Initial
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.jsbsim_units import FOOT, POUND_FOOT, POUND_FORCE, SLUG, SLUG_FT2

EARTH_RATE = 7.292115e-5  # rad/s
DURATION_S, ROW_INTERVAL_S = 30.0, 0.1  # compared length, interval of rows
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A body and its start at latitude and longitude 0, in the units of the source."""

    title: str
    slug: float
    inertia_slug_ft2: Vector3
    height_ft: float = 30_000.0
    velocity_ned_ft_s: Vector3 = ZERO3  # over the ground
    yaw_deg: float = 0.0
    inertial_rate_deg_s: Vector3 | None = None  # None: at rest on the Earth
    wind_ned_ft_s: Vector3 = ZERO3
    drag_area_ft2: float = 0.0  # C_D S
    damping_ft4: Vector3 = ZERO3  # 0.25 S b^2, Clp = Cmq = Cnr = -1


_BRICK = 0.155404754, (0.001894220, 0.006211019, 0.007194665)
_SPHERE = 1.0, (3.6, 3.6, 3.6)
_DRAG_AREA_FT2 = 0.1 * 0.1963495
_TUMBLE_DEG_S = (10.0, 20.0, 30.0)
CASES = {
    "02": Case("tumbling brick", *_BRICK, inertial_rate_deg_s=_TUMBLE_DEG_S),
    "03": Case(
        "tumbling brick, damped",
        *_BRICK,
        inertial_rate_deg_s=_TUMBLE_DEG_S,
        damping_ft4=(0.25 * 0.22222 / 9.0, 0.25 * 0.22222 * 4.0 / 9.0, 0.25 * 0.22222 / 9.0),
    ),
    "06": Case("falling sphere", *_SPHERE, inertial_rate_deg_s=ZERO3, drag_area_ft2=_DRAG_AREA_FT2),
    "07": Case(
        "falling sphere, steady wind",
        *_SPHERE,
        inertial_rate_deg_s=ZERO3,
        drag_area_ft2=_DRAG_AREA_FT2,
        wind_ned_ft_s=(0.0, 20.0, 0.0),
    ),
    "09": Case(
        "sphere fired east and up",
        *_SPHERE,
        height_ft=0.0,
        velocity_ned_ft_s=(0.0, 1000.0, -1000.0),
        yaw_deg=90.0,
        drag_area_ft2=_DRAG_AREA_FT2,
    ),
}
QUANTITIES = (
    "feVelocity_ft_s_X",
    "feVelocity_ft_s_Y",
    "feVelocity_ft_s_Z",
    "altitudeMsl_ft",
    "longitude_deg",
    "latitude_deg",
    "eulerAngle_deg_Yaw",
    "eulerAngle_deg_Pitch",
    "eulerAngle_deg_Roll",
    "bodyAngularRateWrtEi_deg_s_Roll",
    "bodyAngularRateWrtEi_deg_s_Pitch",
    "bodyAngularRateWrtEi_deg_s_Yaw",
    "ambientPressure_lbf_ft2",
    "ambientTemperature_dgR",
    "aero_bodyForce_lbf_X",
    "aero_bodyForce_lbf_Y",
    "aero_bodyForce_lbf_Z",
)
# Rounding error of 30,000 runs in double precision on an Earth of 2e7 ft, less than what any simulator prints.
MIN_DIFFERENCE = 1e-9
NEAR_ROWS = 10  # rows of one second


def body(case: Case) -> Vehicle:
    """Return a case's body as a vehicle: jets without thrust, one contact on top, constants as in body.xml."""
    vehicle, _ = load_vehicle("hexjet")
    area = case.drag_area_ft2 * FOOT**2
    roll, pitch, yaw = (term * POUND_FOOT for term in case.damping_ft4)
    x, y, z = (moment * SLUG_FT2 for moment in case.inertia_slug_ft2)
    top = vehicle.contacts[0].model_copy(update={"name": "top", "kind": "hull", "position_m": (0.0, 0.0, -0.1)})
    return vehicle.model_copy(
        update={
            "name": "body",
            "model": "body.xml",
            "mass_kg": case.slug * SLUG,
            "inertia_kg_m2": (x, y, z),
            "contacts": [top],
            "jets": [jet.model_copy(update={"position_m": ZERO3}) for jet in vehicle.jets],
            "aero": vehicle.aero.model_copy(
                update={"span_m": FOOT, "drag_area_m2": (area,) * 3, "damping_n_m_s": (roll, pitch, yaw)}
            ),
        }
    )


def fly_case(case: Case, step: float | None = None, substeps: int | None = None) -> dict[str, Array]:
    """Return a case's trajectory by quantity, a row every 0.1 s; ``step``, ``substeps``: None for those of flights."""
    usual = Scenario(name="usual", duration_s=1.0)
    step, substeps = step or usual.step_s, substeps or usual.substeps
    yaw = radians(case.yaw_deg)
    rate = ZERO3
    if case.inertial_rate_deg_s is not None:
        # At latitude 0 the Earth turns about north.
        p, q, r = case.inertial_rate_deg_s
        rate = (p - degrees(EARTH_RATE * cos(yaw)), q + degrees(EARTH_RATE * sin(yaw)), r)
    n, e, d = (speed * FOOT for speed in case.velocity_ned_ft_s)
    initial = Initial(
        altitude_m=case.height_ft * FOOT,
        attitude_deg=(0.0, 0.0, case.yaw_deg),
        velocity_ned_m_s=(n, e, d),
        rate_deg_s=rate,
    )
    wn, we, wd = (speed * FOOT for speed in case.wind_ned_ft_s)
    vehicle, calm = body(case), Disturbance(wind=(wn, we, wd))
    environment = Environment(latitude_deg=0.0, longitude_deg=0.0)
    frame = Airframe(vehicle, Path(__file__).parent, environment, step, substeps, 1)
    off = [ZERO3] * len(vehicle.jets)
    rows = []
    try:
        state = frame.reset(initial, off, calm.wind)
        for row in range(round(DURATION_S / ROW_INTERVAL_S) + 1):
            if row:
                for _ in range(round(ROW_INTERVAL_S / step)):
                    state = frame.step(off, calm)
            latitude, longitude = frame.latitude_longitude_deg()
            pressure, temperature = frame.air()
            roll, pitch, heading = state.euler
            rows.append(
                [
                    *(speed / FOOT for speed in state.velocity),
                    state.altitude / FOOT,
                    longitude,
                    latitude,
                    *(degrees(angle) for angle in (heading, pitch, roll)),
                    *(degrees(turning) for turning in frame.inertial_rate()),
                    pressure / POUND_FORCE * FOOT**2,
                    temperature * 1.8,
                    *(felt * vehicle.mass_kg / POUND_FORCE for felt in state.specific_force),
                ]
            )
    finally:
        frame.close()
    return dict(zip(QUANTITIES, np.array(rows).T, strict=True))


def read_simulators(folder: Path, number: str) -> dict[str, dict[str, tuple[Array, Array]]]:
    """Return each simulator's values by quantity, with half a unit of the last digit printed.

    Raises InputError if there are none.
    """
    by_case: dict[str, dict[str, tuple[Array, Array]]] = {}
    for path in sorted(folder.glob(f"Atmos_{number}_sim_*.csv")):
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        by_case[path.stem[-2:]] = {
            name: (np.array([float(row[name]) for row in rows]), np.array([_half_digit(row[name]) for row in rows]))
            for name in QUANTITIES
            if name in rows[0]
        }
    if not by_case:
        raise InputError(f"{folder}: no files Atmos_{number}_sim_*.csv of the check cases")
    return by_case


def _half_digit(text: str) -> float:
    mantissa, _, exponent = text.upper().partition("E")
    return 0.5 * 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


@dataclass(frozen=True)
class Compared:
    """Comparison of one quantity of one case; differences are the greatest over the flight."""

    case: str
    quantity: str
    simulators: int
    spread: float  # of NASA's simulators
    nearest: float  # of ours to the nearest simulator
    beyond: float  # of ours outside all simulators
    inside: bool  # at every time


def compare(number: str, hexjet: dict[str, Array], others: dict[str, dict[str, tuple[Array, Array]]]) -> list[Compared]:
    """Compare our trajectory with NASA's simulators, time by time, where at least two of them have a quantity.

    A value is inside if it is no further from the nearest simulator than their greatest spread within a second, because
    their curves cross, and half a unit of the last printed digit.
    """
    comparisons = []
    for name in QUANTITIES:
        reference_columns = [columns[name] for columns in others.values() if name in columns]
        if len(reference_columns) < 2:
            continue
        values = np.array([value for value, _ in reference_columns])
        digits = np.max([digit for _, digit in reference_columns], axis=0) + MIN_DIFFERENCE
        own = hexjet[name]
        if name.startswith("eulerAngle"):
            values = own + (values - own + 180.0) % 360.0 - 180.0
        low, high = values.min(axis=0), values.max(axis=0)
        nearest = np.abs(values - own).min(axis=0)
        spread = high - low
        about = np.array([spread[max(0, row - NEAR_ROWS) : row + NEAR_ROWS + 1].max() for row in range(len(spread))])
        beyond = np.maximum(np.maximum(low - own, own - high), 0.0)
        comparisons.append(
            Compared(
                number,
                name,
                len(reference_columns),
                float(spread.max()),
                float(nearest.max()),
                float(beyond.max()),
                bool((nearest <= about + digits).all()),
            )
        )
    return comparisons
