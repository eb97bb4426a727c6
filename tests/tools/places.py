"""Where the project's files are, for the tests."""

import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

TESTS = Path(__file__).resolve().parents[1]
TOOLS = TESTS / "tools"  # what tests share; on the path of every test
DESIGNS = TESTS / "designs"  # what ``hexjet design`` made for each engine of the library
ROOT = TESTS.parent
DOCS = ROOT / "docs"
DATA = ROOT.parent / "shared" / "data"  # measurements of others, where they are at hand


def of_page(name: str, where: Path, page: str = "own-controller") -> Path:
    """The file that a reader copies from docs/PAGE.md."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"<!-- {name} -->\n```\w*\n(.*?)```\n<!-- /{name} -->", text, re.DOTALL)
    where.write_text(found, encoding="utf-8")
    return where


def script(name: str) -> ModuleType:
    """docs/NAME.py, which is no module of the package, with those that it imports from beside it."""
    beside = str(DOCS)
    sys.path.append(beside)
    try:
        return import_module(name)
    finally:
        sys.path.remove(beside)
