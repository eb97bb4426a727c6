"""Numeric libraries that keep to one thread.

They would each start a thread a core.  Matrices here are small, so threads cost more than they bring: ten times the
processor's time in ``hexjet design``, and more where other work shares the machine.
"""

from __future__ import annotations

import os

ONE_THREAD = dict.fromkeys(  # environment for one thread of maths
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)


def one_thread() -> None:
    """Limit numpy's libraries to one thread unless the environment sets a number; call before importing numpy."""
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
