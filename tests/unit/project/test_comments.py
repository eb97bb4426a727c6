"""A comment behind code has at most 40 characters: what is longer is a sentence above the line."""

from __future__ import annotations

import io
import tokenize
from collections import defaultdict

from places import ROOT
from test_size import sources

MAX_CHARACTERS = 40
# Longer comments that a folder still has; the others have none.  A number only goes down.
MAX_LONG = {
    "cosim/api": 8,
    "cosim/campaign": 102,
    "cosim/cli": 11,
    "cosim/identify": 22,
    "tools/hexjet_design": 163,
    "tools/hexjet_identify": 179,
    "tools/hexjet_prove": 117,
}


def test_comments_behind_code_are_short() -> None:
    found = defaultdict(list)
    for path in (*sources("cosim"), *sources("tools")):
        name = path.relative_to(ROOT)
        for kind, text, (row, column), _, line in tokenize.generate_tokens(
            io.StringIO(path.read_text("utf-8")).readline
        ):
            long = kind == tokenize.COMMENT and len(text.removeprefix("# ")) > MAX_CHARACTERS
            if long and line[:column].strip() and not text.startswith(("# noqa", "# type: ignore", "# fmt:")):
                found["/".join(name.parts[:2])].append(f"{name}:{row}")
    assert {folder: lines for folder, lines in found.items() if len(lines) > MAX_LONG.get(folder, 0)} == {}
