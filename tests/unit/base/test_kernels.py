"""Which linear algebra a process of ours computes with: flights are to have the same bits on every processor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.base.runtime.kernels import same_kernels

NAME = "OPENBLAS_CORETYPE"

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or os.uname().machine != "x86_64", reason="kernels of x86 on Linux"
)


def told(folder: Path, flags: str) -> str:
    file = folder / "cpuinfo"
    file.write_text(f"processor\t: 0\nmodel name\t: any with avx2 fma in its name\nflags\t\t: fpu {flags} sse2\n\n")
    return str(file)


@pytest.mark.parametrize(
    ("flags", "named", "asked"),
    [
        ("avx2 fma avx512f", None, "Haswell"),
        ("fma avx2", None, "Haswell"),
        ("avx fma", None, None),
        ("avx2", None, None),
        ("avx2 fma", "SkylakeX", "SkylakeX"),
    ],
)
def test_kernels_that_all_processors_have_are_asked_for(
    flags: str, named: str | None, asked: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(NAME, raising=False)
    if named is not None:
        monkeypatch.setenv(NAME, named)
    try:
        same_kernels(told(tmp_path, flags))
        assert os.environ.get(NAME) == asked
    finally:
        os.environ.pop(NAME, None)  # monkeypatch gives back what was there


def test_a_system_that_does_not_tell_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(NAME, raising=False)
    same_kernels(str(tmp_path / "none"))
    assert NAME not in os.environ


def test_a_flight_is_the_same_as_with_those_kernels_named() -> None:
    """A plan around a lost engine and a position: both in other last bits on a processor with AVX-512 otherwise."""
    code = (
        "from cosim import Scenario, fly; from cosim.results.digest import log_digest\n"
        "for name in ('fault-flame-out', 'hover-in-wind'):\n"
        "    print(log_digest(fly(Scenario.load(name).replace(duration_s=3.0, expect=()), report=False).log))"
    )
    environment = {key: value for key, value in os.environ.items() if key != NAME}
    if not {"avx2", "fma"} <= set(Path("/proc/cpuinfo").read_text().split("\n\n")[0].split()):
        pytest.skip("a processor without AVX2 and FMA")
    flown = [
        subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=120.0, check=True)
        for env in (environment, environment | {NAME: "Haswell"})
    ]
    first, second = (done.stdout.split() for done in flown)
    assert len(first) == 2
    assert first == second
