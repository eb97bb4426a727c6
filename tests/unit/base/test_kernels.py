"""Which linear algebra a process of ours computes with: flights are to have the same bits on every processor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.base.runtime.kernels import REFERENCE, VARIABLE, can_use_reference, set_for_command

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or os.uname().machine != "x86_64", reason="kernels of x86 on Linux"
)
needs_reference = pytest.mark.skipif(not can_use_reference(), reason="a processor without AVX2 and FMA")
OTHER = "Nehalem"  # kernels that every processor with AVX2 can run too
FLY = (
    "from cosim import Scenario, fly; from cosim.results.log.digest import log_digest\n"
    "for name in ('fault-flame-out', 'hover-in-wind'):\n"
    "    run = fly(Scenario.load(name).replace(duration_s=3.0, expect=()), report=False)\n"
    "    print(log_digest(run.log), run.summary.blas_kernels)\n"
)


def told(folder: Path, flags: str) -> str:
    file = folder / "cpuinfo"
    file.write_text(f"processor\t: 0\nmodel name\t: any with avx2 fma in its name\nflags\t\t: fpu {flags} sse2\n\n")
    return str(file)


def ran(code: str, **more: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != VARIABLE} | more
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=240.0, check=True
    )


@pytest.mark.parametrize(("flags", "can"), [("avx2 fma avx512f", True), ("fma avx2", True), ("avx fma", False)])
def test_reference_kernels_need_what_processors_since_2013_have(flags: str, can: bool, tmp_path: Path) -> None:
    assert can_use_reference(told(tmp_path, flags)) is can


def test_a_system_that_does_not_tell_is_left_alone(tmp_path: Path) -> None:
    assert not can_use_reference(str(tmp_path / "none"))


@needs_reference
def test_the_command_asks_for_itself_and_its_children(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, OTHER)
    set_for_command()
    assert os.environ[VARIABLE] == OTHER
    monkeypatch.delenv(VARIABLE)
    try:
        set_for_command()
        assert os.environ[VARIABLE] == REFERENCE
    finally:
        os.environ.pop(VARIABLE, None)


@needs_reference
@pytest.mark.parametrize(
    "first",
    [
        "from cosim.base.errors import InputError",
        "import cosim; cosim.fly(cosim.Scenario.load('hover', ['duration_s=0.1']), report=False)",
    ],
)
def test_an_import_leaves_the_environment_as_it_was(first: str) -> None:
    code = (
        f"import os; before = dict(os.environ)\n{first}\nassert os.environ == before\n"
        "import numpy, scipy.linalg\nassert os.environ == before\n"
        "from cosim.base.runtime.kernels import find_kernels; print(find_kernels())"
    )
    assert ran(code).stdout.strip() == str({"numpy": REFERENCE, "scipy": REFERENCE})


@needs_reference
def test_a_flight_has_the_bits_of_the_reference_and_others_are_told_once() -> None:
    """A plan around a lost engine and a position: both in other last bits with other kernels."""
    named = ran(FLY, **{VARIABLE: REFERENCE})
    assert ran(FLY).stdout == named.stdout
    assert REFERENCE in named.stdout
    assert named.stderr == ""
    # numpy comes first with other kernels, which nobody has asked for where a flight begins
    late = f"import os, numpy, scipy.linalg\ndel os.environ['{VARIABLE}']\n{FLY}"
    other = ran(late, **{VARIABLE: OTHER})
    assert OTHER in other.stdout
    assert other.stderr.count("RuntimeWarning") == 1
    assert f"instead of {REFERENCE}" in other.stderr


@needs_reference
def test_kernels_that_the_environment_names_are_no_surprise() -> None:
    """They are in the summary, and nothing warns of them; of a name that changed nothing it does."""
    code = (
        "import cosim; run = cosim.fly(cosim.Scenario.load('hover', ['duration_s=0.1']), report=False)\n"
        "print(run.summary.blas_kernels)"
    )
    for first in ("", "import numpy\n"):
        named = ran(first + code, **{VARIABLE: OTHER})
        assert OTHER in named.stdout
        assert named.stderr == ""
    late = ran(f"import os, numpy\nos.environ['{VARIABLE}'] = 'Sandybridge'\n{code}", **{VARIABLE: OTHER})
    assert late.stderr.count("RuntimeWarning") == 1
