"""What every unit test runs under: who raises an error says it in one line, whoever reads it."""

from __future__ import annotations

from typing import Any

from cosim.base.errors import FlightError, InputError


def _check_lines(kind: type[Exception]) -> None:
    made: Any = kind.__init__

    def init(self: Exception, *arguments: object) -> None:
        made(self, *arguments)
        assert "\n" not in str(self), f"more than one line: {self}"

    kind.__init__ = init


_check_lines(InputError)
_check_lines(FlightError)
