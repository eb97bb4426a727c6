"""python comments.py FOLDER ...: print every comment behind code of more than 40 characters; status 1 if there is one.

What is longer is a sentence of its own and stands above the line. Of a directive to a tool, its reason is the comment.
"""

from __future__ import annotations

import re
import sys
import tokenize
from pathlib import Path

# Generated from MAVLink's message definitions.
GENERATED = {"_messages.py"}
DIRECTIVE = re.compile(r"^# (noqa|type: ignore|fmt)\S*( [A-Z]+\d+)?(  #| -)?")


def main(folders: list[str], max_characters: int = 40) -> int:
    """Print the comments that are too long; return the status."""
    found = 0
    for path in sorted(path for folder in folders for path in Path(folder).rglob("*.py")):
        if path.name in GENERATED:
            continue
        with tokenize.open(path) as file:
            for token in tokenize.generate_tokens(file.readline):
                behind = token.type == tokenize.COMMENT and token.line[: token.start[1]].strip()
                if behind and len(DIRECTIVE.sub("#", token.string)) > max_characters + len("# "):
                    print(f"{path}:{token.start[0]}: put this comment above the line, as a sentence: {token.string}")
                    found += 1
    return min(found, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
