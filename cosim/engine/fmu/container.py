"""Safe opening of ``.fmu`` archives: harmful or damaged content is refused before anything else reads it."""

from __future__ import annotations

import io
import stat
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import IO, NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

from cosim.base.removed import describe_removed

DAMAGE_ERRORS = (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError)  # raised by zipfile
DESCRIPTION = "modelDescription.xml"  # file names in an FMU
BUILD_DESCRIPTION = "sources/buildDescription.xml"


class ArchiveLimits(NamedTuple):
    """Limits of the contents of an archive."""

    # Sizes chosen by us: an engine is a library of a few MB with perhaps some tables; a hundred times that is accepted.
    max_packed_bytes: int = 512 * 2**20  # size of the archive
    max_unpacked_bytes: int = 1024 * 2**20  # total size of the unpacked files
    max_files: int = 10_000
    # Largest ratio of unpacked to packed size: tables of numbers reach 10, zeros 1000.
    max_inflation: int = 100
    # Archives smaller than this when unpacked are not tested for the ratio.
    inflation_from_bytes: int = 16 * 2**20
    max_xml_bytes: int = 16 * 2**20  # bytes
    # Largest depth of nested XML elements; FMI needs fewer than ten.
    max_xml_depth: int = 64
    # Longest part of a path; file systems allow at most 255 bytes.
    max_name_bytes: int = 250


LIMITS = ArchiveLimits()  # limits of an archive


# Encodings that both readers of the description, expat and FMPy's libxml2, read alike.
ENCODINGS = {"utf-8", "us-ascii", "iso-8859-1"}
SYSTEM_FILES = {".ds_store", "thumbs.db", "desktop.ini"}  # left by file managers, ignored
COMPRESSION_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # methods that FMI allows
# Refused FMI interfaces. Model exchange would leave the integration to us: CVode, restarted at each throttle change,
# takes 2.5 ms (1e-5) to 5.3 ms (1e-10) for six engines of two states, as long as a control step; without restarts it is
# wrong by 1 % of full thrust, or fails.
REFUSED_INTERFACES = {"ModelExchange": "model exchange", "ScheduledExecution": "scheduled execution"}


class UnusableError(Exception):
    """Error with the reason why an archive cannot be used; the caller adds its path."""


def to_one_line(error: object) -> str:
    """Return an error's text without line breaks and other control characters."""
    return "".join(c if c.isprintable() else " " for c in " ".join(str(error).split()))


class Zip(zipfile.ZipFile):
    """Zip archive whose contents are read in the same way on each operating system.

    System files (:func:`is_system_file`) are left out, and the backslashes of some Windows programs become ``/``.
    """

    def __init__(self, file: Path | IO[bytes]) -> None:
        super().__init__(file)
        for entry in self.filelist:
            entry.filename = entry.filename.replace("\\", "/")
        self.filelist = [entry for entry in self.filelist if not is_system_file(entry.filename)]
        self.NameToInfo = {entry.filename: entry for entry in self.filelist}


def is_system_file(name: str) -> bool:
    """Return whether an archive's entry is a system file that macOS or Windows adds beside the user's files."""
    *folders, last = PurePosixPath(name).parts or ("",)
    return "__MACOSX" in (*folders, last) or last.startswith("._") or last.lower() in SYSTEM_FILES


def note_unusual_names(path: Path) -> list[str]:
    """Return notes on unusual but accepted names in an archive."""
    with Zip(path) as archive:
        names = [entry.orig_filename for entry in archive.filelist if "\\" in entry.orig_filename]
    if not names:
        return []
    shown = to_one_line(names[0])[:120]
    return [f"packed with backslashes ({shown}), where FMI has /: other programs may not find its files"]


def read_bytes(path: Path) -> bytes:
    """Return a file's contents; raise UnusableError if it is missing, not a regular file or too large."""
    if removed := describe_removed(path.suffix.lower()):
        raise UnusableError(removed)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise UnusableError("is a folder; an .fmu archive is needed")
        if not stat.S_ISREG(status.st_mode):
            raise UnusableError("is not an ordinary file; an .fmu archive is needed")
        if status.st_size > LIMITS.max_packed_bytes:
            raise UnusableError(
                f"is {_size(status.st_size)} large; an engine may have {_size(LIMITS.max_packed_bytes)}"
            )
        if path.suffix.lower() == ".py":
            raise UnusableError("is Python code, not an FMU: pythonfmu3 build -f makes one of it")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise UnusableError("no such file") from error
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        raise UnusableError(getattr(error, "strerror", None) or str(error)) from error


def open_archive(data: bytes, main: str = DESCRIPTION, kind: str = "FMU") -> tuple[list[str], bytes]:
    """Return the names of an archive's files and the content of ``main``, after everything was found harmless.

    Raises UnusableError for another kind of file, and for what could do harm when unpacked or parsed: paths that lead
    out of the folder, links, duplicate names, encryption, unusual compression, sizes beyond the limits above, document
    types and entities in XML.
    """
    if not data:
        raise UnusableError("is empty")
    if not data.startswith(b"PK"):
        raise UnusableError(f"is not an {kind}: not a zip archive")
    try:
        with Zip(io.BytesIO(data)) as fmu:
            entries = fmu.infolist()
            _check_sizes(entries, len(data))
            _check_entries(entries)
            names = [entry.filename for entry in entries]
            if main not in names:
                raise UnusableError(f"is not an {kind}: it has no {main}{_hint_at_folder(main, names)}")
            for name in (main, BUILD_DESCRIPTION, *(name for name in names if name.lower().endswith(".ssv"))):
                if name in names:
                    if fmu.getinfo(name).file_size > LIMITS.max_xml_bytes:
                        raise UnusableError(f"{name} is larger than {_size(LIMITS.max_xml_bytes)}")
                    check_xml(name, fmu.read(name))
            return names, fmu.read(main)
    except DAMAGE_ERRORS as error:
        raise UnusableError(f"is damaged or truncated: {to_one_line(error)}") from error
    except NotImplementedError as error:  # a version of zip unknown to Python
        raise UnusableError(f"is a zip archive of a strange kind: {to_one_line(error)}") from error


def parse_xml(xml: bytes) -> ElementTree.Element:
    """Parse a model description that ``open_archive`` returned, and return its root element.

    Raises UnusableError if it is no model description.
    """
    root = ElementTree.fromstring(xml)
    if root.tag != "fmiModelDescription":
        raise UnusableError(f"{DESCRIPTION} describes a {to_one_line(root.tag)[:80]}, not an FMU")
    return root


def read_fmi_version(root: ElementTree.Element) -> int:
    """Return the FMI version, 2 or 3.  Raises UnusableError for others or without co-simulation."""
    version = root.get("fmiVersion", "none stated")
    if version != "2.0" and not version.startswith("3.0"):
        raise UnusableError(f"FMI version {version} is not supported; allowed: 2.0, 3.0")
    if root.find("CoSimulation") is None:
        other = [words for tag, words in REFUSED_INTERFACES.items() if root.find(tag) is not None]
        more = "; export it with a solver inside, for co-simulation" if root.find("ModelExchange") is not None else ""
        raise UnusableError(f"has no co-simulation interface (it has: {', '.join(other) or 'none'}){more}")
    return int(version[0])


def has_sources(names: Iterable[str]) -> bool:
    """Return whether an archive with files of these names contains C sources."""
    return any(name.startswith("sources/") and not name.endswith("/") for name in names)


def _hint_at_folder(main: str, names: Iterable[str]) -> str:
    """Return a hint if the archive has a folder with ``main`` in place of the folder's contents, else ""."""
    nested = [name for name in names if name.endswith(f"/{main}")]
    return f", but {to_one_line(nested[0])}: pack what is in that folder, not the folder" if nested else ""


def _size(count: int) -> str:
    """Return a number of bytes as text, in MB if it is large."""
    return f"{count / 2**20:.0f} MB" if count >= 2**20 else f"{count} bytes"


def _check_sizes(entries: list[zipfile.ZipInfo], packed: int) -> None:
    # zipfile never reads more of an entry than the size that is checked here.
    if len(entries) > LIMITS.max_files:
        raise UnusableError(f"has {len(entries)} files inside; an engine may have {LIMITS.max_files}")
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > LIMITS.max_unpacked_bytes:
        raise UnusableError(f"would unpack to {_size(unpacked)}; an engine may have {_size(LIMITS.max_unpacked_bytes)}")
    if unpacked > max(LIMITS.inflation_from_bytes, LIMITS.max_inflation * packed):
        raise UnusableError(
            f"would unpack to {_size(unpacked)}, {unpacked / packed:.0f} times its size: a zip bomb "
            f"(at most {LIMITS.max_inflation} times)"
        )


def _check_entries(entries: list[zipfile.ZipInfo]) -> None:
    seen = set()
    for entry in entries:
        name = entry.filename
        path = PurePosixPath(name)
        # zipfile cuts a name at a NUL; the full name is in orig_filename.
        shown = to_one_line(repr(entry.orig_filename))[:120]
        strange = ":" in name or "\0" in entry.orig_filename
        if strange or path.is_absolute() or ".." in path.parts or not path.parts:
            raise UnusableError(f"has an unsafe path inside: {shown}")
        if max(len(part.encode(errors="replace")) for part in path.parts) > LIMITS.max_name_bytes:
            raise UnusableError(f"has a name of more than {LIMITS.max_name_bytes} bytes inside")
        if path in seen:
            raise UnusableError(f"has {shown} inside more than once")
        seen.add(path)
        kind = stat.S_IFMT(entry.external_attr >> 16)
        if kind == stat.S_IFLNK:
            raise UnusableError(f"has a link inside: {shown}")
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise UnusableError(f"has a special file inside: {shown}")
        if entry.flag_bits & 0x1:
            raise UnusableError(f"is encrypted: {shown}")
        if entry.compress_type not in COMPRESSION_METHODS:
            method = entry.compress_type
            raise UnusableError(
                f"is packed by method {method}, which FMI does not know: {shown}; allowed: 0, 8 (deflate)"
            )


def check_xml(name: str, xml: bytes) -> None:
    """Raise UnusableError for XML that FMI does not need: document types, deep nesting, unusual encodings."""
    depth = 0

    def check_encoding(version: str, encoding: str | None, standalone: int) -> None:
        if encoding is not None and encoding.lower() not in ENCODINGS:
            raise UnusableError(f"{name} is in {to_one_line(encoding)}; allowed: {', '.join(sorted(ENCODINGS))}")

    def refuse_doctype(*_: object) -> None:
        raise UnusableError(f"{name} declares a document type or entities; FMI uses neither, and they can do harm")

    def enter_element(*_: object) -> None:
        nonlocal depth
        depth += 1
        if depth > LIMITS.max_xml_depth:
            raise UnusableError(f"{name} nests elements more than {LIMITS.max_xml_depth} deep")

    def leave_element(*_: object) -> None:
        nonlocal depth
        depth -= 1

    if xml.startswith((b"\xfe\xff", b"\xff\xfe")) or b"\0" in xml[:4]:
        raise UnusableError(f"{name} is in UTF-16 or UTF-32; allowed: {', '.join(sorted(ENCODINGS))}")
    parser = expat.ParserCreate(namespace_separator="}")  # also rejects unbound prefixes
    parser.XmlDeclHandler = check_encoding
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler = enter_element
    parser.EndElementHandler = leave_element
    try:
        parser.Parse(xml, True)
    except expat.ExpatError as error:
        raise UnusableError(f"{name} is not valid XML: {error}") from error
