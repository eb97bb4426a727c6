"""Each engine's page begins with what it rests on."""

import re

import pytest
from places import ROOT

PAGES = {path.parent.name: path.read_text(encoding="utf-8") for path in sorted((ROOT / "engines").glob("*/README.md"))}


@pytest.mark.parametrize("name", PAGES)
def test_it_says_what_it_rests_on_before_anything_else(name: str) -> None:
    title, first, *_ = PAGES[name].split("\n\n")
    assert title.startswith("# ")
    assert re.match(r"\*\*(Identified|From physics)\b", first)
    assert re.search(r"\[[Cc]ompared[^]]*\]\(../../docs/real-engine.md\)", first)
