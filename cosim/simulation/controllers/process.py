"""A controller that is a process of its own and steps in lockstep, and an FMU, which such a process of ours runs.

The process says on its standard output one line of JSON, what it is; reads one from its standard input, what it may
believe and the names of the numbers to come; and then answers frames with frames (:mod:`cosim.base.controller_wire`)
until its input ends.  What it prints for people goes to standard error.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

from cosim.base import controller_wire as wire
from cosim.base.errors import FlightError, InputError
from cosim.base.plugins.execute import bytecode_folder
from cosim.base.protocols import Column
from cosim.base.runtime.host import Host
from cosim.base.signals import ControlSignals
from cosim.base.storage.scratch import scratch
from cosim.control.belief import Belief

# Time until a process describes itself, chosen by us: an interpreter on a busy machine takes seconds.
MAX_START_S = 60.0
MAX_END_S = 1.0  # time to end after its input was closed
_MAX_LINE_BYTES = 1_000_000  # length of a description
_STEP_HEADER = wire.frame_layout(0)  # step number at the start of a frame

Command = Callable[[], Sequence[str]]


def request_description(command: Command, folder: Path, label: str) -> dict[str, Any]:
    """Start a controller process, and return the description that it prints of itself.  Raises InputError."""
    # Discards the error output of a program that is ended right after its description.
    with tempfile.TemporaryFile() as errors:
        host = _start_process(command, folder, label, errors)
        try:
            return _receive_description(host, label)
        except InputError as error:
            host.end(MAX_END_S)
            errors.seek(0)
            last_line = errors.read().decode(errors="replace").strip().rpartition("\n")[2]
            raise InputError(f"{error}: {last_line}" if last_line else str(error)) from error
        finally:
            host.end(MAX_END_S)


def _start_process(command: Command, folder: Path, label: str, errors: IO[bytes] | None = None) -> Host:
    # Python programs neither read nor write compiled files beside their source.
    environ = dict(os.environ) | {"PYTHONPYCACHEPREFIX": bytecode_folder()}
    try:
        return Host.open(command(), environ, stderr=errors, cwd=folder)
    except InputError as error:
        raise InputError(f"controller {label}: {error}") from error
    except OSError as error:
        raise InputError(f"controller {label}: cannot be started: {error.strerror or error}") from error


def _receive_description(host: Host, label: str) -> dict[str, Any]:
    try:
        line = host.read_line(_MAX_LINE_BYTES, MAX_START_S)
        description = json.loads(line)
    except FlightError as error:
        raise InputError(f"controller {label}: {error} before it had said what it is") from error
    except ValueError:
        raise InputError(f"controller {label}: its first line is no JSON: {line[:60]!r}") from None
    if not isinstance(description, dict):
        raise InputError(f"controller {label}: its first line is no JSON object: {line[:60]!r}")
    if "error" in description:
        raise InputError(f"controller {label}: {description['error']}")
    return description


class ProcessBlock:
    """User's block in a process of its own, which answers a frame per step within ``limit`` seconds."""

    # Number of frames recorded to check that answers repeat: 200 s at 4 ms.
    max_frames = 50_000
    shown: tuple[float, ...] = ()

    def __init__(
        self, command: Command, folder: Path, label: str, level: str, columns: Sequence[Column], extras: Sequence[str]
    ) -> None:
        self._extras = extras
        self.signals: ControlSignals | None = None
        self._limit = 10.0
        self._command, self._folder, self._label = command, folder, label
        self._level = level
        self.columns = tuple(columns)
        self._host: Host | None = None
        self._belief = b""
        self._frames_sent: list[bytes] = []
        self._frames_received: list[bytes] = []
        self._k = 0

    def set_limit(self, seconds: float) -> None:
        """Set the time limit for an answer, s."""
        self._limit = seconds

    def prepare(self, belief: Belief) -> None:
        """Start the process and send it the models."""
        vehicle, jets = belief.vehicle, len(belief.vehicle.jets)
        moved = vehicle.actuators if vehicle.ranges else ()
        self._jets, self._servos, self._ahead = jets, len(moved), vehicle.control.wing is not None
        inputs = wire.input_names(self._level, jets, vehicle.actuators, self._ahead)
        outputs = wire.output_names(self._level, jets, moved, self._extras)
        self._outputs = len(outputs)
        answered = len(outputs) + len(self.columns)
        self._in, self._out, self._answer = (
            wire.frame_layout(len(inputs)),
            wire.frame_layout(answered),
            wire.layout(answered),
        )
        belief_table = {
            "protocol": wire.PROTOCOL,
            "version": wire.VERSION,
            "inputs": inputs,
            "outputs": [*outputs, *(column.name for column in self.columns)],
            "servos": moved,
            "step_s": belief.step_s,
            "axis": belief.axis,
            "parameters": dict(belief.parameters),
            "hover": belief.hover,
            "on_ground": belief.on_ground,
            "models": {axis: model.model_dump(mode="json") for axis, model in belief.models.items()},
            "engines": [engine._asdict() for engine in belief.engines],
            "vehicle": belief.vehicle.model_dump(mode="json"),
        }
        self._belief = json.dumps(belief_table).encode() + b"\n"
        self._host = self._start_host()

    def _start_host(self) -> Host:
        host = _start_process(self._command, self._folder, self._label)
        try:
            _receive_description(host, self._label)
            host.send(self._belief, MAX_START_S)
        except FlightError as error:
            host.end(MAX_END_S)
            raise InputError(f"controller {self._label}: {error}") from error
        except BaseException:
            host.end(MAX_END_S)
            raise
        return host

    def reset(self) -> None:
        """Restart the numbering of frames at 0."""
        self._k = 0

    def update(self, *arguments: Any) -> Any:
        """Send one frame and return the process's answer.  Raises FlightError."""
        assert self._host is not None
        frame = self._in.pack(float(self._k), *wire.numbers(arguments, self._level, self._ahead))
        answer = self._exchange_frame(self._host, frame, self._k)
        if len(self._frames_sent) < self.max_frames:
            self._frames_sent.append(frame)
            self._frames_received.append(answer)
        self._k += 1
        values = self._answer.unpack_from(answer, _STEP_HEADER.size)
        if self.columns:
            self.shown = values[self._outputs :]
            values = values[: self._outputs]
        if self._level == "predictor":
            return values[0]
        if self._level != "controller":
            return values
        actuation, self.signals = wire.parse_answer(values, self._jets, self._servos, self._extras)
        return actuation

    def _exchange_frame(self, host: Host, frame: bytes, k: int) -> bytes:
        answer = host.exchange(frame, self._out.size, self._limit)
        (number,) = _STEP_HEADER.unpack_from(answer)
        if number == -1.0:
            raise FlightError(host.read_line(_MAX_LINE_BYTES, self._limit).decode(errors="replace"))
        if number != k:
            raise FlightError(f"its answer begins with {number:g} and not with the step; does it print to its output?")
        return answer

    def check_repeatable(self) -> bool:
        """Return whether another process of the program gives the same answers, bit for bit."""
        try:
            host = self._start_host()
        except (InputError, FlightError):
            return False
        try:
            for frame, answer in zip(self._frames_sent, self._frames_received, strict=True):
                if self._exchange_frame(host, frame, int(_STEP_HEADER.unpack_from(frame)[0])) != answer:
                    return False
        except FlightError:
            return False
        finally:
            host.end(MAX_END_S)
        return True

    def close(self) -> None:
        """End the process; may be called twice."""
        if self._host is not None:
            self._host.end(MAX_END_S)
            self._host = None


def make_program_command(path: Path, arguments: str) -> Command:
    """Return the command that runs a file: Python by this interpreter, others as programs."""
    words = arguments.split()

    def list_words() -> Sequence[str]:
        if path.suffix == ".py":
            return [sys.executable, str(path), *words]
        if os.access(path, os.X_OK):
            return [str(path), *words]
        # A copy in a run's folder may lack the permission to execute.
        folder = Path(tempfile.mkdtemp(prefix="controller-", dir=scratch()))
        copied = folder / path.name
        shutil.copyfile(path, copied)
        copied.chmod(0o700)
        return [str(copied), *words]

    return list_words
