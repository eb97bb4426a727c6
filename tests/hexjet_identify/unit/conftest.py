"""What tests of readers of logs share."""

import file_kinds
import pytest

from hexjet_identify.logs import read


@pytest.fixture
def logs_read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Logs are read in this process, which has the same numbers (test_reader_process.py) and takes less time."""
    monkeypatch.setattr(read, "read_apart", file_kinds.read_here)
