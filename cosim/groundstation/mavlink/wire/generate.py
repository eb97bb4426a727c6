"""Generation of the module of MAVLink messages from ``hexjet.xml`` and pymavlink's bundled definitions.

The build runs it; by hand: ``python cosim/groundstation/mavlink/wire/generate.py``.  It imports nothing of the
package, because the build's environment holds pymavlink and not what ``import cosim`` may need.
"""

from __future__ import annotations

import contextlib
import io
import py_compile
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

DIALECT_FILE = Path(__file__).with_name("hexjet.xml")  # MAVLink dialect of this project
MODULE_NAME = "_messages.py"  # generated module
INCLUDED_DIALECTS = ("development", "common", "standard", "minimal")  # dialects included by hexjet.xml
# First lines of the generated module.
_HEAD = "# mypy: ignore-errors\n# ruff: noqa\n# Made by cosim/groundstation/mavlink/wire/generate.py from hexjet.xml\n"


class GenerateError(RuntimeError):
    """Raised if the message module cannot be generated."""


def generate(folder: Path) -> Path:
    """Generate the module of MAVLink messages into ``folder`` and return its path.  Raises GenerateError."""
    try:
        import pymavlink
        from pymavlink.generator import mavgen
    except ImportError as error:
        raise GenerateError(f"the MAVLink messages cannot be made: {error}") from error
    bundled = Path(pymavlink.__file__).parent / "dialects" / "v20"
    output = io.StringIO()
    with tempfile.TemporaryDirectory(prefix="hexjet-messages-") as name:
        work = Path(name)
        for source in (*(bundled / f"{name}.xml" for name in INCLUDED_DIALECTS), DIALECT_FILE):
            _strip_descriptions(source, work / source.name)
        output_file = work / MODULE_NAME
        options = mavgen.Opts(str(output_file), wire_protocol="2.0", language="Python3", validate=False)
        try:
            with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
                done = mavgen.mavgen(options, [str(work / DIALECT_FILE.name)])
        except SystemExit as error:  # mavgen calls exit() on errors
            raise GenerateError(f"mavgen ended with {error.code}: {output.getvalue()[-300:]}") from error
        if not done or not output_file.exists():
            raise GenerateError(f"mavgen refused {DIALECT_FILE.name}: {output.getvalue()[-300:]}")
        text = output_file.read_text(encoding="utf-8")
    target = folder / MODULE_NAME
    target.write_text(_HEAD + text, encoding="utf-8")
    return target


def _strip_descriptions(source: Path, target: Path) -> None:
    """Copy a definition without descriptions, which take three quarters of module size and loading time."""
    tree = ET.parse(source)
    for element in tree.iter():
        if element.tag in ("description", "param", "field", "deprecated", "superseded"):
            element.text = ""
    tree.write(target, encoding="utf-8", xml_declaration=True)


if __name__ == "__main__":
    module = generate(Path(__file__).parent)
    # Compile now, because the first flight would otherwise wait a second for it.
    py_compile.compile(str(module), doraise=True)
    print(module)
