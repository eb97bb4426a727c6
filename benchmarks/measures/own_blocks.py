"""What blocks of somebody else's cost a step more than ours: controllers from outside, and engines in a process.

Each stands for a way in and does as little as that way allows, so that what is measured is the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.measures.speed import Flights, collect, differences
from benchmarks.timing import Cost
from cosim import Scenario, trust
from cosim.base.constants import GRAVITY
from cosim.base.protocols import Applied
from cosim.base.signals import Command, Measured, Vector3
from cosim.control.belief import Belief
from hexjet_export.controller.export import export_controller

SUBSTEPS = 1  # what they cost is the same with more
BASELINE = "ours: no predictor, engines in this process"
PREDICTOR, RATE, CONTROLLER = "a predictor, as a class", "a rate loop, as a class", "a whole controller, as a class"
PROCESS, FMU, ISOLATED = (
    "a rate loop, as a process",
    "a whole controller, as an FMU",
    "engines in a process of their own",
)
CLASSES = (PREDICTOR, RATE, CONTROLLER)
PROCESSES = (PROCESS, ISOLATED, FMU)
_HERE = "benchmarks.measures.own_blocks"

# the proportional part of the vehicle's rate loop: what a program in Python needs at least
_PROGRAM = """import json
import struct
import sys

read, write = sys.stdin.buffer, sys.stdout.buffer
write.write(json.dumps({"level": "rate"}).encode() + b"\\n")
write.flush()
line = read.readline()
told = json.loads(line) if line else sys.exit()
asked = struct.Struct(f"<{1 + len(told['inputs'])}d")
answer = struct.Struct(f"<{1 + len(told['outputs'])}d")
gains = told["vehicle"]["control"]["rate"]
a, b, c = (gains[axis]["p"] for axis in ("roll", "pitch", "yaw"))
while len(frame := read.read(asked.size)) == asked.size:
    k, p, q, r, x, y, z = asked.unpack(frame)[:7]
    write.write(answer.pack(k, a * (p - x), b * (q - y), c * (r - z)))
    write.flush()
"""


class Predictor:
    """Predicts nothing."""

    level = "predictor"

    def reset(self) -> None:
        """Nothing to forget."""

    def update(self, measured: float, applied: float) -> float:
        return measured


class Rate:
    """The proportional part of the vehicle's rate loop."""

    level = "rate"

    def prepare(self, belief: Belief) -> None:
        gains = belief.vehicle.control.rate
        self._gains = gains.roll.p, gains.pitch.p, gains.yaw.p

    def reset(self) -> None:
        """Nothing to forget."""

    def update(self, setpoint: Vector3, measured: Vector3, applied: Vector3) -> Vector3:
        a, b, c = self._gains
        p, q, r = setpoint
        x, y, z = measured
        return (a * (p - x), b * (q - y), c * (r - z))


class WholeController:
    """The proportional parts of the vehicle's loops, for small angles; it holds the height and does not turn."""

    level = "controller"

    def prepare(self, belief: Belief) -> None:
        vehicle, control = belief.vehicle, belief.vehicle.control
        self._left = tuple([jet.servo == "left" for jet in vehicle.jets])
        self._gains = control.rate.roll.p, control.rate.pitch.p, control.rate.yaw.p
        self._angle = control.attitude.gain_1_s
        self._hover, self._forward = belief.hover, 1.0 if sum(jet.position_m[2] for jet in vehicle.jets) > 0.0 else -1.0
        # of the height, through the climb rate to the acceleration, as a share of what holds the vehicle up
        self._height, self._climb = control.altitude.position_1_s, control.altitude.velocity_1_s / GRAVITY

    def reset(self) -> None:
        """Nothing to forget."""

    def update(self, command: Command, measured: Measured, applied: Applied) -> Any:
        a, b, c = self._gains
        d, e, f = self._angle
        _, x, y, z = measured.attitude
        p, q, r = measured.rate
        roll, pitch, yaw = a * (-2.0 * d * x - p), self._forward * b * (-2.0 * e * y - q), c * (-2.0 * f * z - r)
        climb = self._height * (command.altitude - measured.altitude)
        up = self._hover * (1.0 + self._climb * (climb + measured.velocity[2]))
        return [up + roll if left else up - roll for left in self._left], (pitch + yaw, pitch - yaw)


def flights(seconds: float, substeps: int, folder: Path, fmu: bool = True) -> dict[str, Scenario]:
    """Return the hover with each of the blocks in it, and without; files are made in ``folder``.

    Raises FlightError and InputError as exporting a controller does; without a C compiler there is no FMU.
    """
    folder.mkdir(parents=True, exist_ok=True)
    hover = Scenario.load("hover").replace(
        controller="baseline", substeps=substeps, duration_s=seconds, expect=[], controller_limit_s=60.0
    )
    program = folder / "rate_loop.py"
    program.write_text(_PROGRAM, encoding="utf-8")
    trust(folder)
    scenarios = {
        BASELINE: hover,
        PREDICTOR: hover.replace(controller=f"{_HERE}:Predictor"),
        RATE: hover.replace(controller=f"{_HERE}:Rate"),
        CONTROLLER: hover.replace(controller=f"{_HERE}:WholeController"),
        PROCESS: hover.replace(controller=f"process:{program}"),
        ISOLATED: hover.replace(engine_isolated=True),
    }
    if not fmu:
        return scenarios
    exported = export_controller(hover.replace(duration_s=0.1), folder / "exported", name="cascade")
    archives = [name for name in exported.files if name.endswith(".fmu")]
    if archives:
        scenarios[FMU] = hover.replace(controller=str(folder / "exported" / archives[0]))
    return scenarios


@dataclass(frozen=True)
class OwnBlocks:
    """What a recorded step costs more than with ours, round by round.

    ``ours``: what is not JSBSim of the step with ours.  A process that is waited for asleep takes no processor time of
    the thread that flies: its cost is in the wall time.
    """

    ours: Cost
    more: dict[str, Cost]
    missing: str | None  # why there is no controller's FMU


def measure_own_blocks(seconds: float, rounds: int, folder: Path, on_round: Callable[[], object]) -> OwnBlocks:
    """Fly with each of them, recorded in full, between two timings of the unit."""
    with Flights(250, folder) as timed:
        scenarios = flights(seconds, SUBSTEPS, folder / "made")
        jobs = [timed.fly(scenario).recorded(name) for name, scenario in scenarios.items()]
        pairs = {name: cost for (_, name), cost in collect(jobs, timed.units(), rounds, on_round).items()}
    built_in = pairs.pop(BASELINE)
    more = {name: Cost.of(differences(cost, built_in)) for name, cost in pairs.items()}
    return OwnBlocks(Cost.of(built_in, less=SUBSTEPS), more, None if FMU in more else "it needs a C compiler")
