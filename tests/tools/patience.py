"""How long tests wait: bounds that only a failure meets, whatever else the machine has to do.

A test never measures time.  It waits for what must come, and a bound is there only so that a failure ends.  What is
about time itself, such as the time-outs of a ground station, is written down as on a machine with nothing else to do,
and :func:`stretched` by how busy this one is.
"""

from __future__ import annotations

import os
import time

import psutil

PATIENCE = 120.0  # s, for what must come
FLIGHT_PATIENCE = 300.0  # s, for what must be flown first, with the clock or as slowly as a busy machine flies
_MOST = 40.0  # times, at most


def stretched(seconds: float) -> float:
    """``seconds`` of an idle machine on this one as it is now: four times the processes that wait for each core.

    Four, because the load is a mean over the last minute and comes late.
    """
    busy = os.getloadavg()[0] / (os.cpu_count() or 1)
    return seconds * min(_MOST, max(2.0, 4.0 * busy))


def is_ended(number: int) -> bool:
    """Wait until a process is gone, or dead and not yet reaped: one that is killed takes a moment to end."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            if psutil.Process(number).status() == psutil.STATUS_ZOMBIE:
                return True
        except psutil.NoSuchProcess:
            return True
        time.sleep(0.01)
    return False
