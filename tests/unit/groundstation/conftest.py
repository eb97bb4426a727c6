"""A vehicle on the bench, and a ground station that is connected to it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from mavlink_tools import Bench, Desk


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A vehicle without a flight."""
    made = Bench()
    yield made
    made.close()


@pytest.fixture
def desk(bench: Bench) -> Desk:
    """A station that has heard the vehicle."""
    desk = bench.station()
    bench.step()
    return desk
