"""The entry of the command: until what it is made of is read, Ctrl-C ends it without a word: nothing is begun yet."""

from __future__ import annotations

import signal


def main() -> None:
    """The command ``hexjet``."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    from cosim.cli.main import main as command

    signal.signal(signal.SIGINT, before)
    command()
