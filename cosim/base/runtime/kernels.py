"""The same linear algebra on every processor.

OpenBLAS, which numpy and scipy bring, takes the newest instructions that the processor has, and sums in another order
with each: a Kalman gain or a plan around a lost engine then differs in its last bit, and so does every flight with it.
"""

from __future__ import annotations

import os
import sys

_NAME, _KERNELS = "OPENBLAS_CORETYPE", "Haswell"
_NEEDED = {b"avx2", b"fma"}  # by those kernels; x86 processors have had both since 2013
_ENOUGH = 8192  # bytes, with all of the first processor


def same_kernels(told: str = "/proc/cpuinfo") -> None:
    """Ask for the kernels that every x86 processor since 2013 can run; before numpy is imported.

    Leaves alone what the environment says, a processor without AVX2 and FMA, other processors, and systems that do not
    tell which they have: there a flight is the same again on the same kind of processor.
    """
    if _NAME in os.environ or not sys.platform.startswith("linux") or os.uname().machine != "x86_64":
        return
    try:
        with open(told, "rb") as file:
            first = file.read(_ENOUGH)
    except OSError:
        return
    flags = next((line for line in first.splitlines() if line.startswith(b"flags")), b"")
    if set(flags.split()) >= _NEEDED:
        os.environ[_NAME] = _KERNELS
