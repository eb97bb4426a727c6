"""What a fresh process needs: time from the command to the first step and of whole commands."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree

from benchmarks.timing import Spread
from cosim import FlightError
from cosim.base.runtime.host import python_command

# Python code of `hexjet fly` that stops before its first step and prints the times since its start.
_FIRST_STEP = """
import sys, time
python = time.time()
import cosim.cli.console, cosim.flight, cosim.results.run, cosim.simulation.build
from cosim.cli.main import main
imported = time.time()
record = cosim.flight.record
def begun(*arguments, **options):
    recording = record(*arguments, **options)
    print(python, imported, time.time(), flush=True)
    sys.exit(0)
cosim.flight.record = begun
main()
"""
# Processes of a user's, by what is typed; and the one that they are compared with.
UNIT = "import numpy, pydantic"
HELP, IMPORT, FLY = "hexjet --help", "from cosim import fly", "hexjet fly roll-doublet, with its page"
COMMAND = "from cosim.cli.start import main; main()"


@dataclass(frozen=True)
class Startup:
    """Seconds from the start of ``hexjet fly hover`` to its first step, split into Python, imports and building.

    ``commands``: whole processes, by what is typed.
    """

    first_step_s: Spread
    python_s: Spread
    imports_s: Spread
    build_s: Spread
    commands: dict[str, CommandCost]


@dataclass(frozen=True)
class CommandCost:
    """Processor seconds of a whole process, and their ratio to those of ``UNIT`` in the same round."""

    cpu_s: Spread
    units: Spread


def measure_startup(times: int, folder: Path, on_start: Callable[[], object]) -> Startup:
    """Start ``times`` processes, after one that warms the file cache.  Raises FlightError for one that fails."""
    rows = []
    for number in range(times + 1):
        arguments = ["fly", "hover", "--out", str(folder / f"start-{number}")]
        started = time.time()
        child = subprocess.run(python_command(_FIRST_STEP, *arguments), stdout=subprocess.PIPE, text=True, check=False)
        if child.returncode:
            raise FlightError(f"the flight to its first step ended with status {child.returncode}")
        begun, imported, stepped = (float(word) for word in child.stdout.split())
        if number:
            rows.append((stepped - started, begun - started, imported - begun, stepped - imported))
        on_start()
    commands = measure_commands(times, folder, on_start)
    first_step, python, imports, build = (Spread.of(column) for column in zip(*rows, strict=True))
    return Startup(first_step, python, imports, build, commands)


def measure_commands(times: int, folder: Path, on_round: Callable[[], object]) -> dict[str, CommandCost]:
    """Run users' commands ``times`` times in turn, after a round that warms up; return their cost.

    Raises FlightError if a command fails.
    """
    rounds: list[dict[str, float]] = []
    for number in range(times + 1):
        out = folder / f"command-{number}"
        seconds = {
            UNIT: processor_seconds(UNIT),
            HELP: processor_seconds(COMMAND, "--help"),
            IMPORT: processor_seconds(IMPORT),
            FLY: processor_seconds(COMMAND, "fly", "roll-doublet", "--out", str(out)),
        }
        rmtree(out)
        if number:
            rounds.append(seconds)
        on_round()
    return {
        name: CommandCost(
            cpu_s=Spread.of([seconds[name] for seconds in rounds]),
            units=Spread.of([seconds[name] / seconds[UNIT] for seconds in rounds]),
        )
        for name in rounds[0]
    }


def processor_seconds(code: str, *arguments: str) -> float:
    """Return the processor time of ``code`` as a Python process with cached bytecode.  Raises FlightError."""
    import resource

    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run(python_command(code, *arguments), stdout=subprocess.DEVNULL, env=environment, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if ended.returncode:
        raise FlightError(f"{code} {' '.join(arguments)} ended with status {ended.returncode}")
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
