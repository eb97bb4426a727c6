"""Measurements of the C with this machine's compiler: same bits, single-precision deviation, stack and cycles."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from cosim import InputError
from cosim.files import temporary

CFLAGS = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wdouble-promotion", "-ffp-contract=off")
_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?\\n(\d+) bytes')  # stack size of a function, from GCC
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')  # call of a function, from GCC
_TEST = re.compile(  # result of the test program
    r"(\d+) numbers differ in their bits; greatest deviation: "
    r"(?:throttle|collective) (\S+), (?:tilt|torque) (\S+)(?: rad)?$",
    re.M,
)
_CYCLES = re.compile(r"worst step (\d+), mean (\d+)")  # cycle counts of the test program


@dataclass(frozen=True)
class Measurements:
    """Measurements of the compiled C; None for what the compiler does not report."""

    compiler: str  # first line of its --version
    same: bool  # same bits as the flight, in double
    float_throttle: float
    float_tilt: float  # rad, largest error in single precision
    float_passes: bool  # within half a step of a 12-bit command
    stack: int | None  # bytes, the deeper of reset and step
    cycles: tuple[int, int] | None  # of the worst step, and mean
    code: int | None  # bytes of machine code and constants
    state: int | None  # bytes of the state's struct


def find_compiler() -> str | None:
    """Return the path of this machine's C compiler, ``CC`` or else ``cc``; None if there is none."""
    return shutil.which((os.environ.get("CC") or "cc").split()[0])


def measure_compiled(folder: Path, name: str) -> Measurements | None:
    """Compile an exported controller and measure it on its test vectors; None without a compiler.

    Raises InputError, with what the compiler complained of first, if it refuses.
    """
    cc = find_compiler()
    if cc is None:
        return None
    version_lines = _run_tool([cc, "--version"]).stdout.splitlines()
    with temporary("export-") as output:
        double = _run_test_program(cc, folder, name, Path(output, "double"))
        single = _run_test_program(cc, folder, name, Path(output, "single"), f"-D{name.upper()}_FLOAT")
        stack, code = _measure_static(cc, folder, name, Path(output))
    difference_count, _, _ = _parse_test_result(double.stdout)
    _, throttle, tilt = _parse_test_result(single.stdout)
    cycles = _CYCLES.search(double.stdout)
    state = re.search(r"state (\d+) bytes", double.stdout)
    return Measurements(
        version_lines[0] if version_lines else cc,
        double.returncode == 0 and difference_count == 0,
        throttle,
        tilt,
        single.returncode == 0,
        stack,
        (int(cycles[1]), int(cycles[2])) if cycles else None,
        code,
        int(state[1]) if state else None,
    )


def list_sources(name: str) -> list[str]:
    """Return the names of the C files that the test program is compiled from."""
    return [f"test_{name}.c", f"{name}.c", f"{name}_parameters.c", f"{name}_vectors.c"]


def _run_test_program(cc: str, folder: Path, name: str, program: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    files = [str(folder / source) for source in list_sources(name)]
    result = _run_tool([cc, *CFLAGS, "-O2", *flags, "-o", str(program), *files, "-lm"])
    if result.returncode != 0:
        complaints = [*result.stderr.splitlines(), "no word"]
        first = next((line for line in complaints if "error" in line), complaints[0])
        raise InputError(f"{folder}: the C compiler {cc} refuses: {first}")
    return _run_tool([str(program), "time"])


def _run_tool(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=300.0, check=False)


def _parse_test_result(text: str) -> tuple[int, float, float]:
    match = _TEST.search(text)
    if match is None:
        raise InputError(f"the test program does not say what it found: {text[:200]!r}")
    return int(match[1]), float(match[2]), float(match[3])


def _measure_static(cc: str, folder: Path, name: str, output: Path) -> tuple[int | None, int | None]:
    """Return stack bytes by gcc's call graph, and code and constants by ``size``; None if missing."""
    target = output / f"{name}.o"
    result = _run_tool([cc, *CFLAGS, "-O2", "-fcallgraph-info=su", "-c", "-o", str(target), str(folder / f"{name}.c")])
    if result.returncode != 0:
        return None, None
    graph = target.with_suffix(".ci")
    stack = _greatest_stack(graph.read_text(encoding="utf-8")) if graph.is_file() else None
    size = shutil.which("size")
    size_lines = _run_tool([size, str(target)]).stdout.splitlines() if size else []
    return stack, int(size_lines[1].split()[0]) if len(size_lines) > 1 else None


def _greatest_stack(graph: str) -> int | None:
    """Return the greatest stack [bytes] of any path through gcc's call graph, which lacks the mathematics library."""
    stacks = {node: int(size) for node, size in _NODE.findall(graph)}
    calls: dict[str, set[str]] = {}
    for source, target in _EDGE.findall(graph):
        calls.setdefault(source, set()).add(target)

    def stack_bytes(node: str) -> int:
        return stacks.get(node, 0) + max((stack_bytes(called) for called in calls.get(node, ())), default=0)

    return max((stack_bytes(node) for node in stacks), default=None)
