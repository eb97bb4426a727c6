"""What every test runs under."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from cosim.scratch import scratch


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is remembered about engines is remembered for these tests alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        scratch()  # now, so that a test which looks for temporary files finds all others
        yield
