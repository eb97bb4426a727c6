"""What may fail under the autopilot, and the requests with which it is called."""

from __future__ import annotations

from math import radians
from typing import NamedTuple

from cosim.control.autopilot.requests import (
    Goto,
    InjectFault,
    LinkLost,
    OffboardVelocity,
    Request,
    SetMode,
    SetParameter,
    Sticks,
)
from cosim.spec.vehicle import Vehicle

GYRO_BIAS = radians(3.0)  # rad/s, of an uncalibrated MEMS gyro


class Case(NamedTuple):
    """One failsafe: initial requests, and the requests that trigger it."""

    name: str
    first_requests: tuple[Request, ...]
    failing_requests: tuple[Request, ...]
    holds: bool = False  # True: ends in HOLD, not on the ground
    moving: bool = False  # position is lost, also while moving
    waits: bool = False  # waits for low fuel, without a request


def cases(vehicle: Vehicle, airborne: bool = False) -> list[Case]:
    """Return every failsafe, sensors singly and the GNSS with each; without the fuel's if begun in the air."""
    allowed = (SetParameter("SYS_FAILURE_EN", 1.0),)
    gnss = InjectFault("sensor_dropout", sensor="gnss")
    others = (
        ("barometer lost", InjectFault("sensor_dropout", sensor="barometer")),
        ("attitude lost", InjectFault("sensor_dropout", sensor="attitude")),
        ("gyro biased", InjectFault("sensor_bias", sensor="gyro", vector=(GYRO_BIAS, 0.0, 0.0))),
        ("gyro lost", InjectFault("sensor_dropout", sensor="gyro")),
    )
    jets = range(1, len(vehicle.jets) + 1)
    return [
        Case("GNSS lost", allowed, (gnss,), moving=True),
        *(Case(name, allowed, (fault,)) for name, fault in others),
        *(Case(f"GNSS and {name}", allowed, (gnss, fault), moving=True) for name, fault in others),
        *(Case(f"engine {jet} out", allowed, (InjectFault("flame_out", (jet,)),)) for jet in jets),
        Case("ground station lost", (), (LinkLost(),)),
        *([] if airborne else [Case("fuel runs down", (), (), waits=True)]),
        Case("fence passed", (Goto(8.0, 0.0),), (SetParameter("HJ_FENCE_RAD", 1.0),)),
        Case("sticks lost", (), (Sticks(0.0, 0.0, 0.0, 0.5), SetMode("POSCTL")), True),
        Case("set-points lost", (), (OffboardVelocity(0.0, 0.0, 0.0), SetMode("OFFBOARD")), True),
    ]
