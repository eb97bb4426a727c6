"""Text that a terminal can show: nothing in it that a terminal would obey, and no longer than a line is read."""

from __future__ import annotations

import re

# Characters that control a terminal or change the writing direction; line ends and tabs are not included.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
_QUOTED = re.compile(r"(?<!\w)(['\"])(.*?)\1(?!\w)", re.DOTALL)  # a quoted value in a message
# A word longer than any file name is an unquoted value, not a part of a path.
_LONG_WORD = re.compile(r"[^\s/]{256,}")
_options: dict[str, str] = {}  # by argument of the running command


def printable(text: str) -> str:
    """Return a text with control characters written as Python escapes."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def printable_line(text: str, max_echo: int = 80, max_line: int = 2000) -> str:
    """Return a message as one printable line of ``max_line`` characters, each quoted value cut to ``max_echo``."""

    def shorten_quoted(found: re.Match[str]) -> str:
        value = found[2] if len(found[2]) <= max_echo else f"{found[2][:max_echo]}..."
        return f"{found[1]}{value}{found[1]}"

    line = _QUOTED.sub(shorten_quoted, printable(text).replace("\n", "\\n"))
    line = _LONG_WORD.sub(lambda found: f"{found[0][:max_echo]}...", line)
    return line if len(line) <= max_line else f"{line[:max_line]}..."


def name_options(options: dict[str, str]) -> None:
    """Keep the options of the command that runs for :func:`spell`, by the names of its arguments."""
    _options.clear()
    _options.update(options)


def spell(text: str) -> str:
    """Return a message with the running command's arguments as the options that are typed for them."""
    # Keys of files stay: in lists of them, and before an equals sign.
    names = r"(?:allowed|missing|unknown|wrong)(?: too)?: [^;]*|(?<![\w.\"'/-])\w+_\w+(?![\w.=(/]| =)"
    return re.sub(names, lambda found: _options.get(found[0], found[0]), text)
