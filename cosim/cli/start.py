"""The entry of the command: until all is read that it is made of, Ctrl-C ends it without a word, as nothing is begun."""

from __future__ import annotations

import signal


def main() -> None:
    """The command ``hexjet``."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    from cosim.cli.main import main as command

    signal.signal(signal.SIGINT, before)
    command()
