"""The size of the project has limits that only go down: what would exceed one pays for it in the same change."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import ROOT

# Lines of Python by folder.  A change that makes a folder smaller lowers its limit to the new number of lines.
MAX_LINES = {
    "benchmarks": 3_450,
    "cosim": 64_800,
    "docs": 1_634,
    "tests": 71_150,
    "tools/hexjet_batch": 3_075,
    "tools/hexjet_design": 8_198,
    "tools/hexjet_export": 3_790,
    "tools/hexjet_gym": 310,
    "tools/hexjet_identify": 10_510,
    "tools/hexjet_laws": 590,
    "tools/hexjet_paper": 4_515,
    "tools/hexjet_prove": 6_501,
    "tools/hexjet_sitl": 3_345,
}
# Lines of the package and of the tools that begin with a name in capitals and have a number.
MAX_CONSTANTS = 278
# Words of README.md and the pages in docs/, and of the tables in docs/tables/.
MAX_PAGE_WORDS = 54_947
MAX_TABLE_WORDS = 19_696

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


def test_comments_behind_code_are_short() -> None:
    """A comment of more than 40 characters is to be a sentence above the line."""
    found = []
    for path in (*sources("cosim"), *sources("tools")):
        for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
            long = token.type == tokenize.COMMENT and len(token.string) > len("# ") + 40
            if (
                long
                and token.line[: token.start[1]].strip()
                and not re.match("# (noqa|type: ignore|fmt:)", token.string)
            ):
                found.append(f"{path.relative_to(ROOT)}:{token.start[0]}")
    assert found == []
