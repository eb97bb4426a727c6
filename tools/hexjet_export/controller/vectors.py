"""Test vectors for another implementation of a controller: its inputs and outputs at every step of a flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from cosim import InputError
from cosim.base.constants import SERVOS
from cosim.base.protocols import Controller, Diagnostics, EngineState
from cosim.base.signals import (
    AXES,
    ZERO3,
    Actuation,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    Measured,
    PerJet,
)
from cosim.blocks import Simulation
from hexjet_export.controller.quantity import Quantity

ENGINE_NUMBERS = {EngineState.FLY: 0.0, EngineState.IDLE: 1.0, EngineState.OFF: 2.0}  # number of each engine state in C
INPUT_QUANTITIES = (  # inputs of the exported controller
    *(Quantity(f"{axis}_setpoint", "rad", f"Commanded attitude: {axis}") for axis in AXES),
    Quantity("altitude_setpoint", "m", "Commanded height above the ground"),
    *(
        Quantity(f"{axis}_rate_setpoint", "rad/s", f"Commanded body rate where rates_commanded: {axis}")
        for axis in AXES
    ),
    Quantity("collective_setpoint", "1", "Commanded mean throttle where collective_commanded"),
    Quantity("rates_commanded", "1", "1: body rates are commanded instead of an attitude"),
    Quantity("collective_commanded", "1", "1: a mean throttle is commanded instead of a height"),
    Quantity("engines", "1", "0: as the loops ask; 1: idle; 2: off"),
    *(Quantity(f"{axis}_rate", "rad/s", f"Measured body rate: {axis}") for axis in AXES),
    Quantity("attitude_w", "1", "Measured attitude, quaternion body to NED: w", 1.0),  # starts upright
    *(Quantity(f"attitude_{part}", "1", f"Measured attitude, quaternion body to NED: {part}") for part in "xyz"),
    Quantity("velocity_down", "m/s", "Measured velocity downwards"),
    Quantity("altitude", "m", "Measured height above the ground"),
    Quantity("fuel_burnt", "kg", "Fuel burnt since the full tank"),
)
INPUTS = tuple(quantity.name for quantity in INPUT_QUANTITIES)
# Inputs if the loops are exported without the allocation: also what it could not realise in the step before.
LOOP_INPUTS = (*INPUTS, *(f"unallocated_{name}" for name in (*AXES, "collective")))
LOOP_OUTPUTS = (  # outputs without the allocation
    *(f"shown_torque_{axis}" for axis in AXES),
    "shown_collective",
    *(f"shown_{what}_{axis}" for what in ("rate_setpoint", "predicted") for axis in AXES),
)


def list_outputs(jets: int, servos: Sequence[str] = SERVOS) -> list[tuple[Quantity, str]]:
    """Return the controller's outputs in the order of a row, each with its expression in C."""
    asked, shown = "Asked for less given: {}", "To look at: {}"
    per_axis = (
        ("rate_setpoint", "rate_setpoint", "rad/s"),
        ("predicted", "rate_predicted", "rad/s"),
        ("torque", "torque", "1"),
    )
    rows = [
        *((f"throttle_{n + 1}", "1", f"Throttle of jet {n + 1}", f"throttle[{n}]") for n in range(jets)),
        *((f"tilt_{s}", "rad", f"Tilt, positive forward: servo {s}", f"tilt[{n}]") for n, s in enumerate(servos)),
        *((f"unallocated_{a}", "1", asked.format(a), f"unallocated[{n}]") for n, a in enumerate((*AXES, "collective"))),
        *(
            (f"shown_{name}_{axis}", unit, shown.format(f"{name.replace('_', ' ')} {axis}"), f"{field}[{n}]")
            for name, field, unit in per_axis
            for n, axis in enumerate(AXES)
        ),
        *((f"shown_{name}", "1", shown.format(name), name) for name in ("collective", "allocated")),
        *(
            (f"off_{n + 1}", "1", f"1 where shut off on purpose: jet {n + 1}", f"off[{n}] ? 1.0 : 0.0")
            for n in range(jets)
        ),
    ]
    return [(Quantity(name, unit, text), f"output.{field}") for name, unit, text, field in rows]


def list_output_names(jets: int, servos: Sequence[str] = SERVOS) -> tuple[str, ...]:
    """Return the names of the controller's outputs in the order of a row."""
    return tuple(quantity.name for quantity, _ in list_outputs(jets, servos))


@dataclass
class RecordedFlight:
    """A flight recorded for test vectors: its start, then one row per step, inputs before outputs."""

    on_ground: bool = False
    burnt: float = 0.0  # kg of fuel burnt at the start
    start: PerJet = ()  # throttles before the first step
    rows: list[tuple[float, ...]] = field(default_factory=list)


def make_loop_rows(vectors: RecordedFlight, jets: int, servos: Sequence[str]) -> list[tuple[float, ...]]:
    """Return a flight's rows for the loops alone; what the step before left unallocated is an input."""
    names = list_output_names(jets, servos)
    left = [len(INPUTS) + names.index(name) for name in LOOP_INPUTS[len(INPUTS) :]]
    given = [len(INPUTS) + names.index(name) for name in LOOP_OUTPUTS]
    before = (0.0,) * len(left)
    rows = []
    for row in vectors.rows:
        rows.append((*row[: len(INPUTS)], *before, *(row[place] for place in given)))
        before = tuple(row[place] for place in left)
    return rows


class RecordingController:
    """Controller that records another one's inputs and outputs."""

    def __init__(self, inner: Controller, vectors: RecordedFlight) -> None:
        self._inner, self._vectors = inner, vectors
        self._burnt = 0.0

    @property
    def signals(self) -> ControlSignals:
        return self._inner.signals

    @property
    def lost(self) -> tuple[int, ...]:
        return self._inner.lost

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        return self._inner.diagnostics

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        vectors, self._burnt = self._vectors, burnt
        vectors.on_ground, vectors.burnt = on_ground, burnt
        vectors.rows.clear()
        vectors.start = self._inner.reset(on_ground, burnt)
        return vectors.start

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        if (injected.torque_command, injected.torque_output) != (ZERO3, ZERO3):
            raise InputError("the flight adds a signal to the controller's own; choose a scenario without one")
        if command.ahead is not None:
            raise InputError("the flight commands a speed ahead, flown by the wing's law, which is not exported")
        actuation = self._inner.update(command, measured, injected, engines)
        if self._inner.lost or (actuation.off and engines is not EngineState.OFF):
            raise InputError("the flight loses an engine, and allocation with a failed engine is not exported")
        row = (
            *command.attitude,
            command.altitude,
            *(command.rate or ZERO3),
            command.collective or 0.0,
            0.0 if command.rate is None else 1.0,
            0.0 if command.collective is None else 1.0,
            ENGINE_NUMBERS[engines],
            *measured.rate,
            *measured.attitude,
            measured.velocity[2],
            measured.altitude,
            self._burnt,
        )
        signals = self._inner.signals
        outputs = (
            *actuation.throttle,
            *actuation.tilt,
            *actuation.unallocated,
            *signals.rate_setpoint,
            *signals.rate_predicted,
            *signals.torque,
            signals.collective,
            signals.allocated,
            *(1.0 if jet in actuation.off else 0.0 for jet in range(len(actuation.throttle))),
        )
        self._vectors.rows.append((*row, *outputs))
        return actuation

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        self._burnt = burnt
        return self._inner.watch(engines, burnt)

    def forgive(self) -> None:
        self._inner.forgive()


def record_vectors(simulation: Simulation) -> RecordedFlight:
    """Fly a simulation to its end and return its controller's inputs and outputs of every step.

    Raises InputError for a flight that loses an engine, adds signals to the controller's or fails.
    """
    vectors = RecordedFlight()
    simulation.controller = RecordingController(simulation.controller, vectors)
    simulation.reset()
    ending = simulation.run()
    if ending.outcome == "failed":
        raise InputError(f"the flight for the test vectors {ending.outcome}: {ending.reason}")
    return vectors
