"""A user's JSBSim model file: read with the files that it names, without the parts that act beside the flight.

JSBSim's language has parts that write files, send to hosts and open ports.  None of them is a part of what flies: of
a model only :data:`FLOWN_PARTS` is handed on, and what else stands in it is left out with a note.
"""

from __future__ import annotations

import copy
import posixpath
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Final
from xml.parsers import expat

from cosim.base.errors import InputError, notify
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.files import read_file

# Parts that JSBSim builds the flown model from, in the order in which it reads them.
FLOWN_PARTS: Final = (
    "fileheader", "planet", "metrics", "mass_balance", "ground_reactions", "external_reactions", "buoyant_forces",
    "propulsion", "system", "autopilot", "flight_control", "aerodynamics",
)  # fmt: skip
# Properties that act when written: the first three write files, others end or disturb a run.
ACTING_PROPERTIES: Final = tuple(
    f"simulation/{name}"
    for name in (
        "write-state-file", "do_linearization", "force-output", "do_simple_trim", "reset", "terminate", "pause",
        "jsbsim-debug",
    )
)  # fmt: skip
# Largest size of one file; the largest of JSBSim's own aircraft has 0.4 MB.
MAX_MB: Final = 64.0
_EMPTY_MODEL: Final = b"<fdm_config/>"  # JSBSim model without content
# Text of a file that may refer to other files, or has an encoding or definitions that hide this.
_MAY_REFER: Final = re.compile(rb"\sfile\s*=|\0|<!DOCTYPE")
_names_others: RecentCache[bool] = RecentCache(64)
_cache: RecentCache[bytes] = RecentCache(64)  # contents of files that name no others


def read_model(model: Path | None) -> bytes:
    """Return a model with its included files merged; without a model an empty one.

    What JSBSim would act on beside the flight is left out with a :class:`~cosim.base.errors.Notice`.  Raises InputError
    for a file that cannot be read and for a model that writes a property that acts.
    """
    if model is None:
        return _EMPTY_MODEL
    text = read_file(model, MAX_MB)
    if _names_others.get(text, lambda: _MAY_REFER.search(text) is not None):
        return _strip_model(model, text)
    return _cache.get((model, text), lambda: _strip_model(model, text))


def parse(path: Path, text: bytes) -> ET.Element:
    """Return the root of an XML file.  Raises InputError with its path."""
    try:
        return ET.fromstring(text)
    except (ET.ParseError, ValueError, LookupError) as error:  # the last two: unknown encodings
        raise InputError(f"{path}: not valid XML: {error}") from error


def find_line(model: Path, name: str) -> str:
    """Return where a word is in a model or its files, as ``path, line N``; else the model's path."""
    for path in [model, *_list_included_files(model)]:
        numbers = _find_lines(read_file(path, MAX_MB), lambda text: name in _split_words(text))
        if numbers:
            return f"{path}, line {numbers[0]}"
    return str(model)


def _strip_model(model: Path, text: bytes) -> bytes:
    """Return a model without parts that do not fly, unchanged if there are none."""
    root = parse(model, text)
    if root.tag != "fdm_config":
        return text  # refused when it is to fly
    foreign = [part for part in root if part.tag not in FLOWN_PARTS]
    references = [part for part in root if "file" in part.attrib and part not in foreign]
    if any(part.tag == "child" for part in foreign):
        raise InputError(f"{model}, {_place_of(text, 'child')}: child: one vehicle flies here; leave it out")
    for part in foreign:
        root.remove(part)
    for part in references:
        root[list(root).index(part)] = _merge_file(_find_file(model, part), part, model)
    _refuse_acting_properties(root, model)
    if foreign:
        parts = "; ".join(f"<{tag}> ({_place_of(text, tag)})" for tag in dict.fromkeys(part.tag for part in foreign))
        notify(f"{model}: left out, as no part of what flies: {parts}")
    if not foreign and not references:
        return text
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _find_file(model: Path, part: ET.Element) -> Path:
    """Return the included file, beside the model or in ``Systems`` as in JSBSim."""
    name = part.attrib["file"]
    folders = ("", "Systems", "systems")
    candidates = [model.parent / folder / f"{name}{ending}" for folder in folders for ending in ("", ".xml")]
    for file in candidates:
        if "\0" not in name and file.exists() and not file.is_dir():
            return file
    raise InputError(f"{model}: {part.tag} file={name!r}: {candidates[0]}: no such file")


def _merge_file(file: Path, part: ET.Element, model: Path) -> ET.Element:
    """Return a part with its file's contents appended; its own properties take precedence."""
    other = parse(file, read_file(file, MAX_MB))
    if other.tag != part.tag:
        raise InputError(f"{file}: is a {other.tag}, where {model.name} takes a {part.tag} from it")
    if "file" in other.attrib:
        raise InputError(f"{file}: {other.tag} file={other.get('file')!r}: a part's file names no other; state it here")
    merged = ET.Element(part.tag, {**other.attrib, **part.attrib})
    del merged.attrib["file"]
    own_names = {(element.text or "").strip() for element in part.findall("property")}
    merged.text = other.text
    merged.extend(copy.deepcopy(list(part)))
    merged.extend(
        element for element in other if element.tag != "property" or (element.text or "").strip() not in own_names
    )
    return merged


def _list_included_files(model: Path) -> list[Path]:
    root = parse(model, read_file(model, MAX_MB))
    return [_find_file(model, part) for part in root if "file" in part.attrib and part.tag in FLOWN_PARTS]


def _refuse_acting_properties(root: ET.Element, model: Path) -> None:
    """Raise InputError for a property that makes JSBSim write a file, or end, hold or restart a run."""
    for element in root.iter():
        for text in (element.text, *element.attrib.values()):
            name = find_acting_property(text or "")
            if name:
                where = find_line(model, (text or "").strip())
                raise InputError(f"{where}: {name}: JSBSim does something when it is written; a model here may not")


def find_acting_property(text: str) -> str:
    """Return the first of :data:`ACTING_PROPERTIES` in a text, by any path in JSBSim's tree; else ""."""
    if "simulation" not in text:
        return ""
    path = posixpath.normpath(re.sub(r"\[0*\]", "", text.strip().removeprefix("-")))
    return next((name for name in ACTING_PROPERTIES if path == name or path.endswith(f"/{name}")), "")


def _split_words(text: str) -> list[str]:
    """Return the words of a text without the sign that a property may have, and the text as a whole."""
    return [text.strip(), *(word.removeprefix("-") for word in re.split(r"[\s,]+", text))]


def _place_of(text: bytes, tag: str) -> str:
    """Return the lines at which the parts with this tag begin in a model, as text."""
    return "line " + ", ".join(map(str, _find_lines(text, lambda text: False, tag)))


def _find_lines(text: bytes, matches: Callable[[str], bool], tag: str = "") -> list[int]:
    """Return the numbers of the lines with matching text or attributes, or with a ``tag`` under the root."""
    numbers: list[int] = []
    depth = 0
    reader = expat.ParserCreate()

    def record_match(words: str) -> None:
        if matches(words):
            numbers.append(reader.CurrentLineNumber)

    def enter(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth == 2 and name == tag:
            numbers.append(reader.CurrentLineNumber)
        for value in attributes.values():
            record_match(value)

    def leave(name: str) -> None:
        nonlocal depth
        depth -= 1

    reader.StartElementHandler, reader.EndElementHandler, reader.CharacterDataHandler = enter, leave, record_match
    reader.Parse(text, True)
    return numbers
