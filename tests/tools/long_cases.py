"""The cases of a parametrised test of which ``make test`` runs the first ones only."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def long_after(count: int, cases: Iterable[Any]) -> list[Any]:
    """Return the cases in their order, with those behind the first ``count`` marked as long."""
    listed = list(cases)
    return [*listed[:count], *(long_case(case) for case in listed[count:])]


def long_case(case: Any) -> Any:
    """Return a case, a value or a tuple of values, that is marked as long."""
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.long)
