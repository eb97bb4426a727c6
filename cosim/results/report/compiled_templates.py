"""The package's templates as Jinja compiled them, kept as Python keeps its modules, in ``__pycache__``.

Nothing that runs is read from anywhere else than where the package's own code is; what is kept is of one version of
Python, of Jinja and of the template.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

from jinja2.bccache import Bucket, FileSystemBytecodeCache

from cosim.base.compiled import PACKAGE

FOLDER = Path(__file__).resolve().parent / "__pycache__"


class CompiledTemplates(FileSystemBytecodeCache):
    """What Jinja makes of the templates below ``PACKAGE``; those of others are compiled each time."""

    def __init__(self) -> None:
        super().__init__(str(FOLDER), f"%s.{sys.implementation.cache_tag}.pyc")
        self._kept: set[str] = set()  # keys of the package's templates

    def get_cache_key(self, name: str, filename: str | None = None) -> str:
        """Return the key of a template, the hash of its name and its path."""
        key = super().get_cache_key(name, filename)
        if filename is not None and Path(filename).resolve().is_relative_to(PACKAGE):
            self._kept.add(key)
        return key

    def get_source_checksum(self, source: str) -> str:
        """Return what must be the same again for compiled code to be taken: the text, and Jinja's version."""
        return sha256(f"{version('jinja2')}\n{source}".encode()).hexdigest()

    def load_bytecode(self, bucket: Bucket) -> None:
        """Read what was kept of a template of the package."""
        if bucket.key in self._kept:
            super().load_bytecode(bucket)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep a template of the package where modules are kept too, as far as the folder can be written to."""
        if bucket.key in self._kept and not sys.dont_write_bytecode:
            with suppress(OSError):
                super().dump_bytecode(bucket)
