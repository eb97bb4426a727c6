"""The size of the project has limits that only go down: what would exceed one pays for it in the same change."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import ROOT

# Lines of Python by folder.  A change that makes a folder smaller lowers its limit to the new number of lines.
MAX_LINES = {
    "benchmarks": 3_403,
    "cosim": 64_721,
    "docs": 1_631,
    "tests": 66_489,
    "tools/hexjet_batch": 2_919,
    "tools/hexjet_design": 8_190,
    "tools/hexjet_export": 3_786,
    "tools/hexjet_gym": 443,
    "tools/hexjet_identify": 10_435,
    "tools/hexjet_laws": 586,
    "tools/hexjet_paper": 4_508,
    "tools/hexjet_prove": 6_464,
    "tools/hexjet_sitl": 3_339,
}
# Lines of the package and of the tools that begin with a name in capitals and have a number.
MAX_CONSTANTS = 266
# Words of README.md and the pages in docs/, and of the tables in docs/tables/.
MAX_PAGE_WORDS = 54_937
MAX_TABLE_WORDS = 19_689

_CONSTANT = re.compile(r"^[_A-Z][A-Z0-9_]* *(: *[^=]+)?= *-?[0-9.]")
_GENERATED = {"_messages.py"}


def sources(folder: str) -> Iterator[Path]:
    """The Python files of a folder that somebody wrote."""
    return (path for path in sorted((ROOT / folder).rglob("*.py")) if path.name not in _GENERATED)


@pytest.mark.parametrize("folder", MAX_LINES)
def test_a_folder_keeps_its_limit_of_lines(folder: str) -> None:
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in sources(folder))
    assert lines <= MAX_LINES[folder]


def test_every_tool_has_a_limit() -> None:
    tools = {f"tools/{path.name}" for path in (ROOT / "tools").iterdir() if (path / "__init__.py").is_file()}
    assert tools <= MAX_LINES.keys()


def test_numeric_constants_keep_their_limit() -> None:
    found = [
        line
        for folder in ("cosim", "tools")
        for path in sources(folder)
        for line in path.read_text(encoding="utf-8").splitlines()
        if _CONSTANT.match(line)
    ]
    assert len(found) <= MAX_CONSTANTS


def test_pages_and_tables_keep_their_limits_of_words() -> None:
    def count(paths: list[Path]) -> int:
        return sum(len(path.read_text(encoding="utf-8").split()) for path in paths)

    assert count([ROOT / "README.md", *(ROOT / "docs").glob("*.md")]) <= MAX_PAGE_WORDS
    assert count([*(ROOT / "docs" / "tables").glob("*.md")]) <= MAX_TABLE_WORDS
