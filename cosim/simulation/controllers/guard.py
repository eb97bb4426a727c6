"""Blocks of the user's as the flight sees them: every answer is looked at, and what is wrong names the controller.

Numpy arrays and lists are taken for tuples.  Whatever a block raises or gives back wrongly ends the flight as a
:class:`FlightError`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

from cosim.base.constants import GRAVITY
from cosim.base.errors import FlightError, InputError, describe_error
from cosim.base.limits import clamp, clip
from cosim.base.protocols import Applied, Column, Diagnostics, EngineState
from cosim.base.signals import (
    ALL_HEALTHY,
    AXES,
    NO_JETS,
    UNKNOWN3,
    ZERO3,
    Actuation,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    Measured,
    PerJet,
    PerServo,
    Unallocated,
    Vector3,
)
from cosim.control.belief import Belief

_ANSWER_NAMES: Final = tuple([f"the answer for {axis}" for axis in AXES])  # names of answers in errors
_TILT_NAMES: Final = ("the tilt of the left servo", "the tilt of the right servo")  # names of tilts in errors
_FLY: Final = EngineState.FLY  # direct access in compiled code


@dataclass(frozen=True)
class CallGuard:
    """Calls methods of a user's block, and names the block in errors."""

    label: str
    kind: str = "controller"

    def make_error(self, text: str) -> FlightError:
        return FlightError(f"{self.kind} {self.label}: {text}")

    def call(self, what: str, method: Callable[..., Any], *arguments: Any) -> Any:
        """Call a user's method.  Raises FlightError for any exception.

        An InputError that a controller raises is passed on as it is.
        """
        try:
            return method(*arguments)
        except FlightError as error:
            raise self.make_error(str(error)) from error
        except Exception as error:
            if self.kind == "controller" and isinstance(error, InputError):
                raise
            raise self.make_error(f"{what} raised {describe_error(error)}") from error

    def check_numbers(self, answer: Any, names: Sequence[str], what: str = "update") -> tuple[float, ...]:
        """Return an answer as finite numbers, one per name.  Raises FlightError."""
        try:
            values = tuple([float(value) for value in answer])
        except (TypeError, ValueError):
            raise self.make_error(f"{what} gave {_shorten_repr(answer)}: must be {len(names)} numbers") from None
        if len(values) != len(names):
            raise self.make_error(f"{what} gave {len(values)} numbers: must be {len(names)}")
        for value, name in zip(values, names, strict=True):
            if not isfinite(value):
                raise self.make_error(f"{name} = {value}: must be finite")
        return values

    def read_shown(self, block: Any, columns: Sequence[Column]) -> tuple[float, ...]:
        """Return the values that a block shows, one number for each column.  Raises FlightError."""
        try:
            return tuple([float(value) for value in block.shown])
        except Exception as error:
            raise self.make_error(f"shown raised {describe_error(error)}") from error


def _shorten_repr(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def read_columns_of(block: Any) -> tuple[Column, ...]:
    """Return the log columns that a block declares, each as a Column or as four texts."""
    return tuple([Column(*column) for column in getattr(block, "columns", ())])


class Guarded:
    """User's ``block`` with guarded calls and logged columns."""

    def __init__(self, block: Any, guard: CallGuard) -> None:
        self.block, self._guard = block, guard
        self.columns = read_columns_of(block)

    @property
    def shown(self) -> tuple[float, ...]:
        return self._guard.read_shown(self.block, self.columns)


class GuardedPredictor(Guarded):
    """A user's predictor on one axis."""

    def __init__(self, block: Any, guard: CallGuard, axis: str) -> None:
        super().__init__(block, guard)
        self._answer = (f"the rate of {axis}",)

    def reset(self) -> None:
        self._guard.call("reset", self.block.reset)

    def update(self, measured: float, applied: float) -> float:
        answer = self._guard.call("update", self.block.update, measured, applied)
        if type(answer) is float and isfinite(answer):
            return answer
        return self._guard.check_numbers((answer,) if not isinstance(answer, (list, tuple)) else answer, self._answer)[
            0
        ]

    @property
    def diagnostics(self) -> Diagnostics:
        diagnostics = getattr(self.block, "diagnostics", UNKNOWN3)
        return (float(diagnostics[0]), float(diagnostics[1]), float(diagnostics[2]))


class GuardedRate(Guarded):
    """User's rate loop as a :class:`cosim.control.phases.law.CustomRate`."""

    def __init__(self, block: Any, guard: CallGuard) -> None:
        super().__init__(block, guard)
        self._torque = ZERO3
        self.predicted: Vector3 = UNKNOWN3

    def reset(self) -> None:
        self._torque, self.predicted = ZERO3, UNKNOWN3
        self._guard.call("reset", self.block.reset)

    def update(self, setpoint: Vector3, measured: Vector3, unallocated: Unallocated) -> Vector3:
        roll, pitch, yaw = self._torque
        applied = (roll - unallocated.roll, pitch - unallocated.pitch, yaw - unallocated.yaw)
        answer = self._guard.call("update", self.block.update, setpoint, measured, applied)
        roll, pitch, yaw = self._guard.check_numbers(answer, _ANSWER_NAMES)
        self._torque = (roll, pitch, yaw)
        predicted = getattr(self.block, "predicted", None)
        if predicted is not None:
            x, y, z = predicted
            self.predicted = (float(x), float(y), float(z))
        return self._torque

    def add_to_command(self, added: Vector3) -> None:
        x, y, z = self._torque
        self._torque = (x + added[0], y + added[1], z + added[2])


class GuardedAttitude(Guarded):
    """User's attitude loop as a :class:`cosim.base.protocols.AttitudeLoop`."""

    def reset(self) -> None:
        self._guard.call("reset", self.block.reset)

    def update(self, command: Command, measured: Measured) -> Vector3:
        x, y, z = self._guard.check_numbers(
            self._guard.call("update", self.block.update, command, measured),
            ("the rate of roll", "the rate of pitch", "the rate of yaw"),
        )
        return (x, y, z)


class GuardedController(Guarded):
    """User's whole controller as a :class:`cosim.base.protocols.Controller`."""

    def __init__(self, block: Any, guard: CallGuard, belief: Belief) -> None:
        super().__init__(block, guard)
        vehicle, jets = belief.vehicle, len(belief.vehicle.jets)
        low = vehicle.control.allocation.throttle_min
        self._idle = belief.thrust_map.throttle((low,) * jets)
        self._mass, self._thrust_map, self._hover = vehicle.mass_kg, belief.thrust_map, belief.hover
        self._tilt_limit = vehicle.servo.range_rad if vehicle.servo else 0.0
        ranges: list[tuple[float, float]] = [] if vehicle.servo else list(vehicle.ranges)
        self._ranges = ranges  # ranges of hinges and surfaces, if any
        self._servos = tuple([f"the servo {name}" for name in vehicle.actuators]) if ranges else _TILT_NAMES
        self._rest: PerServo = vehicle.rest
        self._names = tuple([f"throttle {number}" for number in range(1, jets + 1)])
        self._all_jets = frozenset(range(jets))
        self._flying = True
        # Throttles, tilts and engine output of the previous step, for the next update.
        self._throttle, self._tilt = self._idle, self._rest
        self._engines, self._burnt = EngineOutput((), (), (), ()), 0.0
        self.signals = self._control_signals(self._idle)

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        """Return the throttles that hold the vehicle up, or idle; see :class:`cosim.base.protocols.Controller`."""
        jets, hover = len(self._names), self._hover
        if burnt:
            hover = self._thrust_map.fraction((self._mass - burnt) * GRAVITY / jets)
        throttle = self._idle if on_ground else self._thrust_map.throttle((hover,) * jets)
        unknown = (float("nan"),) * len(throttle)
        self._throttle, self._tilt = throttle, self._rest
        self._engines, self._burnt = EngineOutput(unknown, unknown, unknown, unknown), burnt
        self._flying = True
        self._guard.call("reset", self.block.reset)
        self.signals = self._control_signals(throttle)
        return throttle

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        """Return the block's checked answer; while the engines do not fly, idle throttle without calling the block."""
        if engines is not _FLY:
            self._flying = False
            off = self._all_jets if engines is EngineState.OFF else NO_JETS
            return self._store(Actuation(self._idle, self._rest, Unallocated(), off))
        if not self._flying:
            self._guard.call("reset", self.block.reset)
            self._flying = True
        applied = Applied(self._throttle, self._tilt, self._engines, self._burnt)
        return self._store(self._check(self._guard.call("update", self.block.update, command, measured, applied)))

    def _store(self, answer: Actuation) -> Actuation:
        self._throttle, self._tilt = answer.throttle, answer.tilt
        self.signals = self._control_signals(answer.throttle)
        return answer

    def _control_signals(self, throttle: PerJet) -> ControlSignals:
        """Return the signals of a block that is a cascade; of any other controller only its mean throttle is known."""
        signals = getattr(self.block, "signals", None)
        if isinstance(signals, ControlSignals):
            return signals
        mean = sum(throttle) / len(throttle)
        return ControlSignals(UNKNOWN3, UNKNOWN3, UNKNOWN3, mean, mean)

    def _check(self, answer: Any) -> Actuation:
        """Return the block's answer as an actuation within all limits.  Raises FlightError."""
        guard = self._guard
        is_actuation = isinstance(answer, Actuation)
        if is_actuation:
            throttles, tilts = answer.throttle, answer.tilt
        else:
            try:
                throttles, tilts = answer if self._tilt_limit or self._ranges else (answer, (0.0, 0.0))
            except (TypeError, ValueError):
                raise guard.make_error(f"update gave {_shorten_repr(answer)}: must be throttles and tilts") from None
        throttle = self._round_to_limits(throttles)
        tilt: PerServo
        if self._ranges:
            asked = guard.check_numbers(tilts, self._servos, "tilts: update")
            tilt = tuple([clip(asked[i], least, most) for i, (least, most) in enumerate(self._ranges)])
        else:
            left, right = guard.check_numbers(tilts, _TILT_NAMES, "tilts: update")
            tilt = (clamp(left, self._tilt_limit), clamp(right, self._tilt_limit))
        return Actuation(
            throttle,
            tilt,
            answer.unallocated if is_actuation else Unallocated(0.0, 0.0, 0.0, 0.0),
            answer.off if is_actuation else NO_JETS,
        )

    def _round_to_limits(self, throttles: Any) -> PerJet:
        """Return the throttles clipped to 0 to 1.  Raises FlightError for one that is outside by more than rounding."""
        throttle = self._guard.check_numbers(throttles, self._names, "throttles: update")
        for name, value in zip(self._names, throttle, strict=True):
            # An excess of 1e-9 is rounding in the user's arithmetic.
            if not -1e-9 <= value <= 1.0 + 1e-9:
                raise self._guard.make_error(f"{name} = {value:g}: must be from 0 to 1")
        return tuple([clip(value, 0.0, 1.0) for value in throttle])

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        """Store the engines' output and the fuel burnt [kg] for the next update; no engine is reported as failed."""
        self._engines, self._burnt = engines, burnt
        return ALL_HEALTHY

    def forgive(self) -> None:
        """Do nothing, because engines are not monitored."""

    @property
    def lost(self) -> tuple[int, ...]:
        """Failed engines: none, as engines are not monitored."""
        return ()

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        """Predictor signals: unknown, as there are no predictors."""
        return (UNKNOWN3, UNKNOWN3, UNKNOWN3)
