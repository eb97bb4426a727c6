"""An autopilot for a flight, from its name and what it is to be told: what ``hexjet sitl`` and campaigns share."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.autopilots import ardupilot, betaflight, px4
from cosim.autopilots.lockstep import LOCAL, Autopilot, stated_program
from cosim.autopilots.parameters import ardupilot_parameters, parameter_file, px4_parameters
from cosim.autopilots.run import Flown, fly_autopilot
from cosim.base.errors import FlightError, InputError
from cosim.base.geodesy import Geodesy
from cosim.spec.scenario import Scenario

LOCKS = 32_760  # the first of the ports that stand for a number; chosen by us, nobody's
MOST = 250  # numbers: as many instances as hexjet sitl takes
APART = 20  # ports of Betaflight from one instance to the next: fourteen are one's


@dataclass(frozen=True)
class Ready:
    """An autopilot that has not begun, its program, and what a run says of it."""

    name: str
    autopilot: Autopilot
    program: Path
    told: Mapping[str, Any]

    def fly(self, scenario: Scenario, folder: Path, page: bool = True) -> Flown:
        """See :func:`cosim.autopilots.run.fly_autopilot`."""
        theirs = {"betaflight": betaflight, "px4": px4, "ardupilot": ardupilot}[self.name]
        return fly_autopilot(
            scenario,
            self.autopilot,
            self.name,
            folder,
            before=theirs.BEFORE_S,
            lean_deg=theirs.ANGLE_LIMIT_DEG,
            turn_deg_s=theirs.YAW_RATE_DEG_S,
            files=[self.program],
            told=dict(self.told),
            page=page,
        )


@contextmanager
def own_instance() -> Iterator[int]:
    """A number from 1 to :data:`MOST`, this process's until the end; 0 is left to ``hexjet sitl``.

    It is held by a bound port, so that it is free again whatever becomes of the process.  Raises FlightError where all
    are taken.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
        for number in range(1, MOST + 1):
            try:
                held.bind((LOCAL, LOCKS + number))
            except OSError:
                continue
            yield number
            return
    raise FlightError(f"{MOST} autopilots fly on this machine already")


def program_of(name: str, binary: Path | None) -> Path:
    """The program that is stated, that the environment names, or that is installed.  Raises InputError for none."""
    if name == "betaflight":
        return betaflight.program(binary)
    variable = f"{name.upper()}_SITL"
    found = stated_program(binary, variable)
    if found is None:
        raise InputError(f"{name}: no program is named; allowed: binary in the table [autopilot], or {variable}")
    return found


def make_ready(
    name: str,
    scenario: Scenario,
    folder: Path,
    binary: Path | None,
    instance: int,
    gains: str = "vehicle",
    lines: Sequence[str] = (),
    parameters: Mapping[str, float] | None = None,
    limit: float = 5.0,
) -> Ready:
    """An autopilot of its own ports, of ``instance``, for the scenario's vehicle; its files go into ``folder``.

    ``gains``, ``lines``, ``parameters``: as the options of ``hexjet sitl``; ``limit``: for an answer [s].  Raises
    InputError.
    """
    program, step, place = program_of(name, binary), scenario.step_s, folder / name
    vehicle, _ = scenario.resolved_vehicle()
    where = Geodesy(
        scenario.environment.latitude_deg, scenario.environment.longitude_deg, scenario.environment.ground_m
    )
    if name == "betaflight":
        told = [*([] if gains == "stock" else betaflight.gains_of(vehicle)), *lines]
        port = betaflight.PORT + APART * instance
        flown = betaflight.Betaflight(program, place, vehicle, step, told, port, limit, where.ground)
        return Ready(name, flown, program, {"gains": gains, "console": flown.settings})
    if name == "px4":
        values = px4_parameters(vehicle) | dict(parameters or {})
        return Ready(
            name,
            px4.Px4(program, place, vehicle, step, where, values, instance, limit),
            program,
            {"parameters": values},
        )
    defaults = place / "hexjet.parm"
    place.mkdir(parents=True, exist_ok=True)
    defaults.write_text(parameter_file("ardupilot", ardupilot_parameters(vehicle, step)))
    made = ardupilot.ArduPilot(program, place, vehicle, step, where, defaults, instance, limit)
    return Ready(name, made, program, {"defaults": str(defaults)})
