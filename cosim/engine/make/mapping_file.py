"""A mapping file begun for an FMU: what is found of its ports, and what its author has to say."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.files import map_os_errors
from cosim.base.storage.toml import toml_text
from cosim.engine.fmu.archive import Archive, read_component
from cosim.engine.fmu.container import UnusableError, read_bytes
from cosim.engine.fmu.port_kinds import KINDS, NEEDED
from cosim.engine.fmu.ports import PortFinding, look_for_ports
from cosim.engine.fmu.variables import Variable
from cosim.engine.make.controller_fmu import is_controller

# Comment at the top of a mapping file.
_HEAD_COMMENT = """\
# Ports of {fmu}, begun by hexjet engine map. What follows "# OPEN" is to be stated; others hold until you change them.
# All that a mapping file may say: docs/own-engine.md. It takes the FMU's place: hexjet fly hover --engine {file}
"""


@dataclass(frozen=True)
class BegunMapping:
    """Draft of a mapping file: ``text`` for the file ``path``."""

    path: Path
    archive: Archive
    findings: tuple[PortFinding, ...]
    text: str

    @property
    def found(self) -> Mapping[str, str]:
        """Variable names of the ports that are ready, by port."""
        return {each.port: each.variable.name for each in self.findings if each.variable and not each.trouble}

    @property
    def open(self) -> Mapping[str, str]:
        """Reasons, by port, why other ports that an engine needs or the FMU seems to have are not ready."""
        return {each.port: each.trouble for each in self.findings if each.trouble}

    @property
    def is_complete(self) -> bool:
        """Whether all ports that an engine needs are ready."""
        return not any(port in NEEDED for port in self.open)


def begin_mapping(fmu: Path, out: Path | None = None) -> BegunMapping:
    """Return the draft of a mapping file for an engine's FMU, made without running the FMU.

    Raises InputError for what is no FMU of an engine.
    """
    suffix = fmu.suffix.lower()
    if suffix == ".toml":
        raise InputError(f"{fmu}: is a mapping file already; hexjet engine check {fmu} says what it lacks")
    if suffix != ".fmu" and not fmu.exists():
        raise InputError(f"{fmu}: is no file; hexjet engine map takes the FMU of an engine, FILE.fmu")
    try:
        archive = read_component(fmu, read_bytes(fmu))
    except UnusableError as reason:
        raise InputError(f"{fmu}: {reason}") from reason
    if is_controller(fmu):
        raise InputError(f"{fmu}: is the FMU of a controller, which needs no mapping file; give it as controller")
    path = fmu.with_suffix(".toml") if out is None else out
    if path.suffix.lower() != ".toml" or path.is_dir():
        path = path / f"{fmu.stem}.toml"
    findings = tuple(look_for_ports([*archive.inputs, *archive.outputs, *archive.parameters]))
    return BegunMapping(path, archive, findings, "".join(_make_lines(path, archive, findings)))


def write_mapping(begun: BegunMapping) -> Path:
    """Write a mapping file and return its path.  Raises InputError if it exists or cannot be written."""
    if begun.path.exists():
        raise InputError(f"{begun.path}: is there already; name another file as out, or remove it")
    with map_os_errors(InputError, begun.path):
        begun.path.parent.mkdir(parents=True, exist_ok=True)
        begun.path.write_text(begun.text, encoding="utf-8")
    return begun.path


def _make_lines(path: Path, archive: Archive, findings: Sequence[PortFinding]) -> Iterator[str]:
    fmu = os.path.relpath(archive.path, path.parent)
    yield _HEAD_COMMENT.format(fmu=archive.path.name, file=path.name)
    yield toml_text({"fmu": fmu, "title": archive.model})
    yield "\n[ports]\n"
    taken = {each.variable.name for each in findings if each.variable}
    for each in findings:
        yield from _port_lines(each, archive, taken)
    yield from _make_table(
        "units",
        [
            _format_open_line(f'{each.port} = "{KINDS[each.port].quantity.si}"', each.trouble)
            for each in findings
            if each.part == "units"
        ],
    )
    yield from _make_table(
        "range", [_format_open_line("throttle = [0.0, 1.0]", each.trouble) for each in findings if each.part == "range"]
    )
    for title, variables in (
        ("inputs", archive.inputs),  # without a line: the FMU's start value
        ("parameters", archive.parameters),
    ):
        free = [v for v in variables if v.name not in taken and v.type != "String"]
        yield from _make_table(title, [_add_comment(f"# {_key(v)} = {v.start or 0.0:g}", _describe(v)) for v in free])


def _make_table(title: str, lines: Sequence[str]) -> Sequence[str]:
    """Return the text lines of a table with these lines; empty without lines."""
    return [f"\n[{title}]\n", *lines] if lines else []


def _port_lines(each: PortFinding, archive: Archive, taken: set[str]) -> Iterator[str]:
    """Yield the line of a port; none for an optional port without a candidate."""
    if each.variable is not None:
        line = f"{each.port} = {_format_toml_string(each.variable.name)}"
        is_ready = not each.trouble or each.port in NEEDED
        about = "; ".join([_describe(each.variable), *each.notes])
        yield _add_comment(line, about) if is_ready else _add_comment(f"# {line}", each.trouble)
    elif each.trouble:
        yield _format_open_line(f'{each.port} = ""', each.trouble)
        free = [v for v in _select(archive, KINDS[each.port].causality) if v.name not in taken and each.port in NEEDED]
        yield from (f"#     {_format_toml_string(v.name)}: {_describe(v)}\n" for v in free)


def _select(archive: Archive, causality: str) -> Sequence[Variable]:
    """Return variables of an FMU by causality: inputs, outputs, or else parameters."""
    return {"input": archive.inputs, "output": archive.outputs}.get(causality, archive.parameters)


def _format_open_line(line: str, trouble: str) -> str:
    return f"# OPEN: {trouble}\n# {line}\n"


def _add_comment(line: str, comment: str, column: int = 32) -> str:
    return f"{line:{column - 1}} # {comment}\n"


def _describe(v: Variable) -> str:
    """Return a text of what an FMU declares of a variable: unit, range, start, description."""
    ends = [f"{value:g}" if value is not None else "" for value in (v.min, v.max)]
    parts = [
        f"[{v.unit}]" if v.unit else "no unit",
        f"{ends[0]} to {ends[1]}" if all(ends) else "no range",
        f"starts at {v.start:g}" if v.start is not None and v.causality != "output" else "",
        " ".join(v.description.split()),
    ]
    return ", ".join(part for part in parts if part)


def _format_toml_string(name: str) -> str:
    return toml_text({"x": name}).partition("=")[2].strip()


def _key(v: Variable) -> str:
    return _format_toml_string(v.name) if not v.name.replace("_", "").isalnum() or not v.name.isascii() else v.name
