"""Where a command writes: ``--out`` names a file or a folder as its ending says, for all commands alike."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from cosim.base.errors import InputError

# Endings of files that these commands write or read; any other name, such as runs/v1.2, is a folder's.
FILES = frozenset(
    f".{ending}"
    for ending in (
        *("bin", "c", "csv", "fmu", "h", "htm", "html", "jpg", "json", "jsonl", "log", "mat", "mcap", "md", "parquet"),
        *("pdf", "png", "py", "ssp", "svg", "tlog", "toml", "txt", "ulg", "ulog", "yaml", "zip"),
    )
)


class Out(click.Path):
    """The value of ``--out``: a folder, or a file with one of the endings that the command writes.

    An ending of another kind of file is refused, unless a folder of that name is there.
    """

    def __init__(self, *endings: str) -> None:
        super().__init__(path_type=Path)
        self.endings = endings

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path.  Raises InputError for the ending of a file that the command does not write."""
        path = Path(str(super().convert(value, param, ctx)))
        ending = path.suffix.lower()
        if path.is_file() and ending not in self.endings:
            raise InputError(f"--out {path}: is a file; {self._allowed(ctx)}")
        if ending in FILES and ending not in self.endings and not path.is_dir():
            raise InputError(f"--out {path}: names a file by its ending; {self._allowed(ctx)}")
        return path

    def is_file(self, path: Path) -> bool:
        """Return whether the path names a file that the command writes; a folder that is there stays one."""
        return path.suffix.lower() in self.endings and not path.is_dir()

    def _allowed(self, ctx: click.Context | None) -> str:
        command = "the command" if ctx is None else ctx.command_path.replace("cli", "hexjet", 1)
        if not self.endings:
            return f"{command} writes a folder: name one without such an ending"
        return f"{command} writes a folder, or a file that ends in {' or '.join(self.endings)}"
