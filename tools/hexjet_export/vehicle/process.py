"""The process behind an exported vehicle: it flies, and exchanges values with the importer once a communication step.

Its standard input is a socket; the other end is ``process.c`` in the FMU.  Frames of native doubles: it gets what to do
(0 start, 1 step), how many control steps, and every parameter and input; it answers 0 and every output, or -1 and a
line that says why not.  Its first word, a 0, says that it is ready.  It ends when the importer does.
"""

from __future__ import annotations

import os
import struct
import sys
from pathlib import Path
from typing import Any, NoReturn

from cosim.base.storage.files import write_all

MANIFEST = "vehicle.json"  # description of the vehicle in the FMU
FLIGHT = "flight"  # folder of the scenario and its files
ANY_VERSION = "HEXJET_ANY_VERSION"  # variable that allows other versions


class _RestartError(Exception):
    """Raised when the importer starts the flight again."""


class _DisconnectedError(Exception):
    """Raised when the importer has closed the connection."""


class _ImporterSocket:
    def __init__(self) -> None:
        self._file = os.dup(0)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)  # not inherited by child processes
        os.close(nothing)

    def receive(self, frame: struct.Struct) -> tuple[float, ...]:
        data = b""
        while len(data) < frame.size:
            more = os.read(self._file, frame.size - len(data))
            if not more:
                raise _DisconnectedError
            data += more
        values: tuple[float, ...] = frame.unpack(data)
        return values

    def send(self, data: bytes) -> None:
        try:
            write_all(self._file, data)
        except OSError:
            raise _DisconnectedError from None

    def refuse(self, error: object) -> None:
        line = " ".join(str(error).split())
        self.send(struct.pack("=d", -1.0) + line.encode("utf-8", "replace")[:1000] + b"\n")


def describe_version_differences(manifest: dict[str, str], here: dict[str, str]) -> str:
    """Describe the versions that differ from those that made the FMU; empty if none does."""
    differences = [
        f"{name} {here.get(name, 'missing')} in place of {text}"
        for name, text in manifest.items()
        if here.get(name) != text
    ]
    return ", ".join(differences)


class _Server:
    """Server that flies the vehicle, step by step as the importer requests, until it disconnects."""

    def __init__(self, socket: _ImporterSocket, folder: Path) -> None:
        from cosim import InputError, Scenario, versions
        from cosim.base.storage.files import read_json
        from cosim.base.trust import trust
        from hexjet_export.vehicle.ports import VehicleContents

        self._socket = socket
        manifest: dict[str, Any] = read_json(folder / MANIFEST)
        differences = describe_version_differences(manifest["versions"], versions())
        if differences and not os.environ.get(ANY_VERSION):
            raise InputError(
                f"this vehicle was made with other versions: {differences}; export it anew, or set {ANY_VERSION}=1 to "
                "fly it all the same"
            )
        self._contents = VehicleContents(manifest["engines_inside"], manifest["controller_inside"])
        trust(folder)  # the importer decided to run this code
        self._scenario = Scenario.read(folder / FLIGHT / "scenario.toml")
        self._flight = self._build_flight(self._scenario.seed)
        inputs = [variable.name for variable in self._flight.inputs]
        outputs = [variable.name for variable in self._flight.outputs]
        if (inputs, outputs) != (manifest["inputs"], manifest["outputs"]):
            raise InputError("this vehicle was made with other inputs and outputs; export it anew")
        self._inputs = inputs
        self._in = struct.Struct(f"={3 + len(inputs)}d")
        self._out = struct.Struct(f"={1 + len(outputs)}d")
        self._steps_left = 0  # control steps until the next exchange
        self._answer_due = False

    def _build_flight(self, seed: int) -> Any:
        from hexjet_export.vehicle.ports import ExportedFlight

        self._seed = seed
        return ExportedFlight(self._scenario.replace(seed=seed), self._contents, self._exchange)

    def _exchange(self) -> None:
        if self._steps_left > 1:
            self._steps_left -= 1
            return
        if self._answer_due:
            self._socket.send(self._out.pack(0.0, *self._flight.read_outputs()))
        self._listen()

    def _listen(self) -> None:
        """Read the importer's next request.  Raises _RestartError if it is a start."""
        request, count, seed, *input_values = self._socket.receive(self._in)
        self._answer_due = True
        self._flight.input_values.update(zip(self._inputs, input_values, strict=True))
        self._steps_left = round(count)
        if not request:  # 0.0: start, 1.0: step
            self._requested_seed, self._steps_left = round(seed), 0
            raise _RestartError

    def _start(self) -> None:
        """Reset the flight to ``t = 0`` with the current inputs and seed."""
        if self._requested_seed != self._seed:
            input_values = self._flight.input_values
            self._flight.close()
            self._flight = self._build_flight(self._requested_seed)
            self._flight.input_values.update(input_values)
        self._flight.simulation.reset()

    def _fly(self) -> NoReturn:
        """Start the flight and step it as requested.  Raises FlightError when it is over."""
        from cosim import FlightError

        self._start()
        simulation = self._flight.simulation
        while True:
            try:
                simulation.step()
            except FlightError as error:
                raise FlightError(f"{error} at step {simulation.k} ({simulation.k * simulation.dt:.3f} s)") from error
            ending = simulation.termination.check(simulation.state, simulation.k * simulation.dt)
            if ending:
                raise FlightError(f"the flight is over: {ending.outcome}, {ending.reason}")

    def serve(self) -> None:
        """Answer requests until the importer disconnects."""
        from cosim import EngineError, FlightError, InputError

        flying = False
        while True:
            try:
                if flying:
                    self._fly()
                self._listen()
            except _RestartError:
                flying = True
                continue
            except _DisconnectedError:
                self._flight.close()
                return
            except (EngineError, FlightError, InputError) as error:
                self._socket.refuse(error)
                flying = False
                continue
            self._socket.refuse("the flight is over; start it anew")


def main(folder: str) -> int:
    """Fly the vehicle in ``folder`` for the importer at standard input; return the exit status."""
    socket = _ImporterSocket()
    try:
        server = _Server(socket, Path(folder))
    except _DisconnectedError:
        return 0
    except Exception as error:
        socket.refuse(error)
        return 1
    socket.send(struct.pack("=d", 0.0))
    try:
        server.serve()
    except _DisconnectedError:
        pass
    except Exception as error:
        socket.refuse(f"{type(error).__name__}: {error}")
        raise
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
