"""Checks of parameter changes that tune a loop, warnings about saved ones, and their saving.

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
from typing import Protocol, TypeVar

from cosim.base.errors import InputError
from cosim.control.autopilot.modes import Severity
from cosim.control.autopilot.parameters import Caution, Parameters
from cosim.control.autopilot.requests import Answer, Result, SetParameter
from cosim.groundstation.exchange import GroundRequest, PendingRequest
from cosim.groundstation.parameter_store import FORCE_NAME, ParameterStore

T = TypeVar("T")  # result type of a task


class StabilityChecker(Protocol):
    """Predictor of parameter changes' effect on the loops' stability; called in a separate thread."""

    def prepare(self) -> None:
        """Prepare the computation, so that the first result is as fast as later ones."""

    def tunes_loop(self, name: str) -> bool:
        """Return whether a parameter tunes a loop that can be computed."""

    def find_cautions(self, before: Mapping[str, float], after: Mapping[str, float]) -> list[Caution]:
        """Return a caution for each loop whose stability a change reduces."""


class ParameterGuard:
    """Queue of parameter changes that wait, in order, for their check of stability.

    ``max_deferred``: changes that wait at most: twice a whole set, as the first verdict may take seconds.
    ``batch_size``: changes that are checked together and act at one step: as many as a step takes requests.
    """

    def __init__(self, checker: StabilityChecker | None = None, max_deferred: int = 200, batch_size: int = 8) -> None:
        self.batch_size = batch_size
        self.max_deferred = max_deferred
        self.checker = checker
        self._deferred: deque[PendingRequest] = deque()
        self._batch: list[PendingRequest] = []  # changes that are being checked
        self._verdict: Future[list[list[Caution]]] | None = None
        self._thread: ThreadPoolExecutor | None = None

    def prepare(self) -> None:
        """Start the checker's preparation in its thread; returns at once."""
        if self.checker is not None:
            self._submit_to_thread(self.checker.prepare)

    def defer(self, waiting: PendingRequest) -> bool:
        """Queue a change that affects a loop for :meth:`take_verdicts`; return False if it affects none."""
        request = waiting.request
        if self.checker is None or not isinstance(request, SetParameter) or not self.checker.tunes_loop(request.name):
            return False
        if len(self._deferred) >= self.max_deferred:
            waiting.answer(Answer(False, Result.TEMPORARILY_REJECTED, "too many parameters at once"))
        else:
            self._deferred.append(waiting)
        return True

    def take_verdicts(self, parameters: Parameters, now: float) -> list[tuple[PendingRequest, list[Caution] | None]]:
        """Return the next checked changes with their cautions, None for changes that are too late.

        ``now`` [s] is of the clock of :attr:`PendingRequest.deadline`.
        """
        if late := [waiting for waiting in self._deferred if now > waiting.deadline]:
            self._deferred = deque(waiting for waiting in self._deferred if now <= waiting.deadline)
            # Discard the running check: it assumed that the late changes would be made.
            if any(now > waiting.deadline for waiting in self._batch):
                self._batch, self._verdict = [], None
            return [(waiting, None) for waiting in late]
        if self._verdict is None and self._deferred:
            self._batch = list(self._deferred)[: self.batch_size]
            steps = _to_steps(parameters, [waiting.request for waiting in self._batch])
            self._verdict = self._submit_to_thread(lambda: self._find_batch_cautions(steps))
        if self._verdict is None or not self._verdict.done():
            return []
        verdicts = self._verdict.result()
        answered: list[tuple[PendingRequest, list[Caution] | None]] = list(zip(self._batch, verdicts, strict=False))
        self._batch, self._verdict = [], None
        for _ in answered:
            self._deferred.popleft()
        return answered

    def take_remaining(self) -> list[PendingRequest]:
        """Remove and return the changes that still wait for a verdict."""
        remaining = list(self._deferred)
        self._deferred.clear()
        self._batch, self._verdict = [], None
        return remaining

    def close(self) -> None:
        """Refuse the changes that are still deferred, and end the thread."""
        for waiting in self.take_remaining():
            waiting.answer(Answer(False, Result.TEMPORARILY_REJECTED, "the session is over"))
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)
            self._thread = None

    def _submit_to_thread(self, task: Callable[[], T]) -> Future[T]:
        self._thread = self._thread or ThreadPoolExecutor(1, "parameters")
        return self._thread.submit(task)

    def _find_batch_cautions(self, steps: list[tuple[dict[str, float], dict[str, float]]]) -> list[list[Caution]]:
        """Return each change's cautions, up to the first change that may be refused, as later ones depend on it."""
        assert self.checker is not None
        verdicts: list[list[Caution]] = []
        for before, after in steps:
            verdicts.append(self.checker.find_cautions(before, after))
            if any(caution.was_stable for caution in verdicts[-1]):
                break
        return verdicts


def _to_steps(parameters: Parameters, requests: list[GroundRequest]) -> list[tuple[dict[str, float], dict[str, float]]]:
    """Return all values before and after each change; equal if a change is not allowed."""
    steps, before = [], dict(parameters.values)
    for request in requests:
        assert isinstance(request, SetParameter)
        after = {**before, **split_allowed(parameters, {request.name: request.value})[0]}
        steps.append((before, after))
        before = after
    return steps


def split_allowed(parameters: Parameters, values: Mapping[str, float]) -> tuple[dict[str, float], list[str]]:
    """Return the allowed values as the vehicle stores them, and a line for each refused value."""
    accepted: dict[str, float] = {}
    refused = []
    for name, value in values.items():
        try:
            accepted[name] = parameters.check(name, value)
        except InputError as error:
            refused.append(f"refused: {error}")
    return accepted, refused


def find_refusal(
    request: SetParameter, cautions: list[Caution] | None, in_air: bool, values: Mapping[str, float]
) -> str:
    """Return why a change is refused, empty if it is accepted; ``cautions`` None: the check is late."""
    if cautions is None:
        return f"{_format_value(request.name, request.value)} not taken: no verdict in time, ask again"
    losing = [caution for caution in cautions if caution.was_stable]
    if not losing or not in_air or values.get(FORCE_NAME):
        return ""
    change = _format_value(request.name, request.value)
    return f"{change} refused in the air: {losing[0].text}; {FORCE_NAME} 1 takes it all the same"


def report_cautions(
    say: Callable[[Severity, str, int], None], request: SetParameter, cautions: list[Caution] | None, k: int
) -> None:
    """Report a warning at step ``k`` for each loop whose stability a change reduces."""
    for caution in cautions or ():
        say(Severity.WARNING, f"{_format_value(request.name, request.value)}: {caution.text}", k)


def list_changes(parameters: Parameters, values: Mapping[str, float]) -> list[str]:
    """List changes from defaults as ``NAME 0 (default 0.02)``, at most eight and then a count.

    What the vehicle refuses comes after these, each with the reason.
    """
    accepted, refused = split_allowed(parameters, values)
    changes = [
        f"{_format_value(name, value)} (default {parameters.table[name].default:g})"
        for name, value in accepted.items()
        if value != parameters.table[name].default
    ]
    return [*_truncate_list(changes), *_truncate_list(refused)]


def _truncate_list(lines: list[str], max_named: int = 8) -> list[str]:
    return lines if len(lines) <= max_named else [*lines[:max_named], f"and {len(lines) - max_named} more"]


def find_saved_cautions(
    checker: StabilityChecker | None, parameters: Parameters, values: Mapping[str, float]
) -> list[Caution]:
    """Return cautions for loops that saved values make less stable than the defaults."""
    default = {line.name: line.default for line in parameters}
    after = {**default, **split_allowed(parameters, values)[0]}
    if checker is None or not any(checker.tunes_loop(name) for name in after if after[name] != default[name]):
        return []
    return checker.find_cautions(default, after)


def describe_saved(checker: StabilityChecker | None, parameters: Parameters, values: Mapping[str, float]) -> list[str]:
    """Describe saved values: changes from the defaults, refused values, and their effect on stability."""
    cautions = find_saved_cautions(checker, parameters, values)
    return [*list_changes(parameters, values), *(caution.text for caution in cautions)]


def report_saved(
    say: Callable[[Severity, str], None],
    checker: StabilityChecker | None,
    parameters: Parameters,
    values: Mapping[str, float],
) -> None:
    """Report changed parameters and their effect on stability, at the start of a flight."""
    for text in list_changes(parameters, values):
        say(Severity.NOTICE, f"not the default: {text}")
    for caution in find_saved_cautions(checker, parameters, values):
        say(Severity.CRITICAL if caution.unstable else Severity.WARNING, f"parameters: {caution.text}")


def _format_value(name: str, value: float) -> str:
    return f"{name} {value:g}"


class ParameterWriter:
    """Writer of parameters to their file in another thread, because a disk may be slower than a step.

    ``path`` None: they are kept for the session alone.  Raises InputError for a file that cannot be used.
    """

    def __init__(self, path: Path | None, vehicle: str, complain: Callable[[str], None]) -> None:
        self.path = path
        self._store = None if path is None else ParameterStore(path, vehicle)
        self._complain = complain
        self._values: dict[str, float] = self._store.load() if self._store else {}
        self._first = True
        self._work: Queue[dict[str, float] | None] = Queue()
        self._thread: Thread | None = None

    def restore(self, apply: Callable[[str, float], None]) -> None:
        """Set the saved parameters in a new flight."""
        if self._store is not None and self._first:
            for text in self._store.restore(apply):
                self._complain(text)
        else:
            for name, value in self._values.items():
                apply(name, value)
        self._first = False

    @property
    def values(self) -> Mapping[str, float]:
        return self._values

    def save(self, values: dict[str, float]) -> None:
        """Save these parameters, except HJ_FORCE, which holds for one flight."""
        self._values = {name: value for name, value in values.items() if name != FORCE_NAME}
        if self._store is None:
            return
        if self._thread is None:
            self._thread = Thread(target=self._write_queued, name="parameters")
            self._thread.start()
        self._work.put(self._values)

    def close(self) -> None:
        """Write everything and end the thread."""
        if self._thread is not None:
            self._work.put(None)
            self._thread.join()
            self._thread = None

    def _write_queued(self) -> None:
        assert self._store is not None
        while (values := self._work.get()) is not None:
            try:
                self._store.save(values)
            except InputError as error:
                self._complain(f"parameters not saved: {error}")
