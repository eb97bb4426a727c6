"""Work that is no flight of a study, in the processes that fly those."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from cosim.base.errors import FlightError
from cosim.campaign.workers.local import LocalWorkers

T = TypeVar("T")  # type of the tasks
R = TypeVar("R")  # type of the results


@dataclass(frozen=True)
class _NumberedTask:
    """An argument of a function, with its index."""

    number: int
    argument: Any


def as_finished(act: Callable[[T], R], arguments: Sequence[T], workers: int) -> Iterator[tuple[int, R]]:
    """Yield index and result of ``act`` for each argument, in the order of completion.

    The processes import ``act`` by its name.  Raises what ``act`` raises, and FlightError for an argument with which
    three processes were lost.
    """
    tasks: Any = [_NumberedTask(number, argument) for number, argument in enumerate(arguments)]
    study: Any = act
    limit_s = 86_400.0  # s, a day: the limit of every task
    with LocalWorkers(workers, limit_s, _run_task, _report_lost_task) as pool:
        for row in pool.fly(study, tasks):
            result: dict[str, Any] = dict(row)
            if "error" in result:
                raise result["error"]
            yield result["number"], result["value"]


def _run_task(act: Any, task: Any) -> dict[str, Any]:
    try:
        return {"number": task.number, "value": act(task.argument)}
    except Exception as error:
        return {"number": task.number, "error": error}


def _report_lost_task(act: Any, task: Any, reason: str) -> dict[str, Any]:
    return {"number": task.number, "error": FlightError(reason)}
