"""What is done with a change of the parameters that tunes a loop, and what is said of those that are kept.

A change is judged in a thread of its own, so that no step waits for it, and is put to the flight when its verdict is
there: the step at which it acts is the one that is recorded.  In the air a change that makes a stable loop unstable is
refused, unless HJ_FORCE is 1; on the ground, and where nothing can be computed, every change is taken.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Protocol

from cosim.base.errors import InputError
from cosim.control.autopilot.modes import Severity
from cosim.control.autopilot.parameters import Caution, Parameters
from cosim.control.autopilot.requests import Answer, Result, SetParameter
from cosim.groundstation.exchange import Waiting
from cosim.groundstation.parameter_store import ParameterStore

FORCE = "HJ_FORCE"
MOST_HELD = 200  # changes that wait; chosen by us: twice a whole set, and the first verdict may take seconds
TOLD = 8  # parameters that are named where they differ from their defaults; more are counted


class Judge(Protocol):
    """Who knows what parameters do to the loops; asked from a thread of its own."""

    def concerns(self, name: str) -> bool:
        """Return whether a parameter tunes a loop that can be computed."""

    def cautions(self, before: Mapping[str, float], after: Mapping[str, float]) -> list[Caution]:
        """Return what is to be said of every loop that a change makes worse."""


class ParameterGuard:
    """Changes that wait for their verdict, one after the other, in the order in which they came."""

    def __init__(self, judge: Judge | None = None) -> None:
        self.judge = judge
        self._held: deque[Waiting] = deque()
        self._verdict: Future[list[Caution]] | None = None
        self._thread: ThreadPoolExecutor | None = None

    def holds(self, waiting: Waiting) -> bool:
        """Keep a change of a loop until :meth:`judged` gives it back; False: it is nothing of the kind."""
        request = waiting.request
        if self.judge is None or not isinstance(request, SetParameter) or not self.judge.concerns(request.name):
            return False
        if len(self._held) >= MOST_HELD:
            waiting.answer(Answer(False, Result.TEMPORARILY_REJECTED, "too many parameters at once"))
        else:
            self._held.append(waiting)
        return True

    def judged(self, values: Mapping[str, float]) -> tuple[Waiting, list[Caution]] | None:
        """Return the next change with its verdict, where that is there; ``values``: the parameters as they are."""
        if not self._held:
            return None
        if self._verdict is None:
            request, before = self._held[0].request, dict(values)
            assert self.judge is not None
            assert isinstance(request, SetParameter)
            self._thread = self._thread or ThreadPoolExecutor(1, "parameters")
            after = {**before, request.name: request.value} if request.name in before else before
            self._verdict = self._thread.submit(self.judge.cautions, before, after)
        if not self._verdict.done():
            return None
        verdict, self._verdict = self._verdict, None
        return self._held.popleft(), verdict.result()

    def left(self) -> list[Waiting]:
        """Return the changes whose verdict nobody waits for any more."""
        left = list(self._held)
        self._held.clear()
        self._verdict = None
        return left

    def close(self) -> None:
        """End the thread."""
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)
            self._thread = None


def refusal(request: SetParameter, cautions: list[Caution], in_air: bool, values: Mapping[str, float]) -> str:
    """Return why a change is not taken; empty where it is."""
    lost = [caution for caution in cautions if caution.loses]
    if not lost or not in_air or values.get(FORCE):
        return ""
    return f"{_said(request.name, request.value)} refused in the air: {lost[0].text}; {FORCE} 1 takes it all the same"


def warnings_of(request: SetParameter, cautions: list[Caution]) -> list[str]:
    """Return a line for each loop that a change makes worse."""
    return [f"{_said(request.name, request.value)}: {caution.text}" for caution in cautions]


def differing(parameters: Parameters, values: Mapping[str, float]) -> list[str]:
    """Return what differs from the defaults, each as ``NAME 0 (default 0.02)``; a count in place of the last ones."""
    known = {name: value for name, value in values.items() if name in parameters.table}
    said = [
        f"{_said(name, value)} (default {parameters.table[name].default:g})"
        for name, value in known.items()
        if value != parameters.table[name].default
    ]
    return said if len(said) <= TOLD else [*said[:TOLD], f"and {len(said) - TOLD} more"]


def kept_cautions(judge: Judge | None, parameters: Parameters, values: Mapping[str, float]) -> list[Caution]:
    """Return what the values that are kept make worse of the loops than the defaults have it."""
    default = {line.name: line.default for line in parameters}
    after = {**default, **{name: value for name, value in values.items() if name in default}}
    if judge is None or not any(judge.concerns(name) for name in after if after[name] != default[name]):
        return []
    return judge.cautions(default, after)


def tell(
    say: Callable[[Severity, str], None], judge: Judge | None, parameters: Parameters, values: Mapping[str, float]
) -> None:
    """Say at the beginning of a flight which parameters differ from their defaults, and what they make worse."""
    for text in differing(parameters, values):
        say(Severity.NOTICE, f"not the default: {text}")
    for caution in kept_cautions(judge, parameters, values):
        say(Severity.CRITICAL if caution.unstable else Severity.WARNING, f"parameters: {caution.text}")


def _said(name: str, value: float) -> str:
    return f"{name} {value:g}"


class ParameterWriter:
    """Writes parameters to their file in a thread of its own: a disk may take longer than a step.

    ``path`` None: they are kept for the session alone.  Raises InputError for a file that cannot be used.
    """

    def __init__(self, path: Path | None, vehicle: str, complain: Callable[[str], None]) -> None:
        self.path = path
        self._store = None if path is None else ParameterStore(path, vehicle)
        self._complain = complain
        self._values = self._store.load() if self._store else {}
        self._first = True
        self._work: Queue[dict[str, float] | None] = Queue()
        self._thread: Thread | None = None

    def restore(self, put: Callable[[str, float], None]) -> None:
        """Hand what is kept to a new flight."""
        if self._store is not None and self._first:
            for text in self._store.restore(put):
                self._complain(text)
        else:
            for name, value in self._values.items():
                put(name, value)
        self._first = False

    @property
    def values(self) -> Mapping[str, float]:
        """Those that are kept now."""
        return self._values

    def keep(self, values: dict[str, float]) -> None:
        """These from now on."""
        self._values = values
        if self._store is None:
            return
        if self._thread is None:
            self._thread = Thread(target=self._write, name="parameters")
            self._thread.start()
        self._work.put(values)

    def close(self) -> None:
        """Everything is written."""
        if self._thread is not None:
            self._work.put(None)
            self._thread.join()
            self._thread = None

    def _write(self) -> None:
        assert self._store is not None
        while (values := self._work.get()) is not None:
            try:
                self._store.save(values)
            except InputError as error:
                self._complain(f"parameters not saved: {error}")
