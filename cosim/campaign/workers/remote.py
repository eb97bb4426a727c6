"""What a worker on a cluster does with a few flights of a study that came to it by its contents.

They are flown in a process of their own beside the worker, as on one machine: an engine that crashes or hangs takes no
worker with it, and threads of one worker share nothing but the machine.
"""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from pathlib import Path
from threading import Lock, Timer
from typing import TYPE_CHECKING

from cosim.base.storage.cache import RecentCache
from cosim.base.trust import trust
from cosim.campaign.folder import STUDY, FrozenStudy, load
from cosim.campaign.workers.flight_row import Row
from cosim.campaign.workers.local import LocalWorkers

if TYPE_CHECKING:
    from cosim.campaign.study.plan import Flight
    from cosim.campaign.study.study import Study

_studies: RecentCache[Study] = RecentCache(4)
_unpacking = Lock()


class _IdleProcesses:
    """Idle processes; each is used by one thread at a time."""

    def __init__(self) -> None:
        self._idle: dict[LocalWorkers, tuple[float, Timer]] = {}  # idle workers by their time limit
        self._lock = Lock()

    def take(self, limit: float) -> LocalWorkers:
        """Return idle workers with this time limit, or new ones."""
        with self._lock:
            idle = next((workers for workers, (its_limit, _) in self._idle.items() if its_limit == limit), None)
            if idle is None:
                return LocalWorkers(1, limit)
            _, timer = self._idle.pop(idle)
        timer.cancel()
        return idle

    def give_back(self, workers: LocalWorkers, limit: float) -> None:
        """Keep workers for the next task, and end them after a minute without one."""
        idle_s = 60.0  # s until an idle process ends
        timer = Timer(idle_s, self._close_idle, (workers,))
        timer.daemon = True
        with self._lock:
            self._idle[workers] = limit, timer
        timer.start()

    def end_idle(self) -> None:
        with self._lock:
            idle, self._idle = self._idle, {}
        for workers, (_, timer) in idle.items():
            timer.cancel()
            workers.close()

    def _close_idle(self, workers: LocalWorkers) -> None:
        with self._lock:
            if self._idle.pop(workers, None) is None:
                return  # another thread took it already
        workers.close()


_processes = _IdleProcesses()
atexit.register(_processes.end_idle)


def fly_together(frozen: FrozenStudy, digest: str, flights: Sequence[Flight], limit: float, folder: Path) -> list[Row]:
    """Fly some flights of the study with this digest; ``folder`` is deleted with the worker."""
    with _unpacking:  # worker threads may unpack concurrently
        _unpack(frozen, folder / digest)
        # Whoever sends a study to a cluster has accepted its code.
        trust(folder / digest)
        study = _studies.get((digest, folder), lambda: load(folder / digest))
    workers = _processes.take(limit)
    try:
        rows = list(workers.fly(study, flights))
    except BaseException:
        workers.close()
        raise
    _processes.give_back(workers, limit)
    return rows


def end_idle() -> None:
    """End the processes of this worker that wait for flights."""
    _processes.end_idle()


def _unpack(frozen: FrozenStudy, folder: Path) -> None:
    """Write the study's files into a folder, unless they are there."""
    if not (folder / STUDY).is_file():  # the study file is written last
        folder.mkdir(parents=True, exist_ok=True)
        frozen.write(folder)
