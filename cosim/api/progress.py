"""What a call says while it works: notes, and how far it is."""

from __future__ import annotations

import warnings
from pathlib import Path

from cosim.base.errors import Notice


class Progress:
    """Hears what a call is doing; a subclass says what becomes of it, this one makes warnings of the notes."""

    def begin(self, folder: Path) -> None:
        """Hear of the folder that everything goes into, before the first flight.

        Parameters
        ----------
        folder : Path
            The folder.
        """

    def note(self, text: str) -> None:
        """Hear of something that is taken otherwise than one may think.

        Parameters
        ----------
        text : str
            One line; it becomes a warning, ``cosim.base.errors.Notice``.
        """
        warnings.warn(text, Notice, stacklevel=3)

    def update(self, part: str, done: int, of: int) -> None:
        """Hear how far the call is.

        Parameters
        ----------
        part : str
            What is being done, or what became of the flights so far.
        done : int
            Parts that are done.
        of : int
            All parts; 0 where that is not known.
        """
