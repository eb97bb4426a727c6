"""Each engine's page begins with what it rests on, and with how far it is from the real engine that was recorded."""

import re

import pytest
from places import DOCS, ROOT

PAGES = {path.parent.name: path.read_text(encoding="utf-8") for path in sorted((ROOT / "engines").glob("*/README.md"))}
TABLE = (DOCS / "tables" / "real-engine.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", PAGES)
def test_it_says_what_it_rests_on_before_anything_else(name: str) -> None:
    title, first, *_ = PAGES[name].split("\n\n")
    assert title.startswith("# ")
    assert re.match(r"\*\*(Identified|From physics)\b", first)
    assert re.search(r"\[[Cc]ompared[^]]*\]\(../../docs/real-engine.md\)", first)


@pytest.mark.parametrize("name", [name for name in PAGES if f"`{name}`" in TABLE and name != "jetcat-p300"])
def test_it_says_how_far_it_is_from_the_recorded_one(name: str) -> None:
    off = [float(text) for text in re.findall(rf"^\| \| `{name}` \| ([\d.]+) \|", TABLE, re.MULTILINE)]
    assert len(off) == 10
    assert f"off by {min(off):g} to {max(off):g} % of its range (rms)" in PAGES[name].split("\n\n")[1]
