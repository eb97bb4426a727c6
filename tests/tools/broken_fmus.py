"""Engines that are broken on purpose, each in one way, and the words with which it is turned away."""

from __future__ import annotations

import inspect
import io
import random
import re
import shutil
import stat
import struct
import subprocess
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import fmpy
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

SOURCE = Path(__file__).with_name("broken_engine.c")
BINARY = {
    2: f"binaries/{fmpy.platform}/broken{fmpy.sharedLibraryExtension}",
    3: f"binaries/{fmpy.platform_tuple}/broken{fmpy.sharedLibraryExtension}",
}
XML = "modelDescription.xml"
UNFIT, UNUSABLE = 1, 2  # what hexjet engine check leaves with

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}" modelName="broken" {token}="broken:{fault}">
"""
DESCRIPTION = {
    2: _HEAD.replace("{version}", "2.0").replace("{token}", "guid")
    + """<CoSimulation modelIdentifier="broken" canHandleVariableCommunicationStepSize="true"
    canGetAndSetFMUstate="true" canSerializeFMUstate="true"/>
<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit><Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>
<ModelVariables>
<ScalarVariable name="throttle" valueReference="1" causality="input" variability="continuous">
  <Real min="0" max="1" start="0"/></ScalarVariable>
<ScalarVariable name="thrust" valueReference="2" causality="output" variability="continuous">
  <Real unit="N"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs><InitialUnknowns><Unknown index="2"/></InitialUnknowns></ModelStructure>
</fmiModelDescription>
""",
    3: _HEAD.replace("{version}", "3.0").replace("{token}", "instantiationToken")
    + """<CoSimulation modelIdentifier="broken" canHandleVariableCommunicationStepSize="true"/>
<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit></UnitDefinitions>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Float64 name="throttle" valueReference="1" causality="input" variability="continuous" min="0" max="1" start="0"/>
<Float64 name="thrust" valueReference="2" causality="output" variability="continuous" unit="N"/>
</ModelVariables>
<ModelStructure><Output valueReference="2"/><InitialUnknown valueReference="2"/></ModelStructure>
</fmiModelDescription>
""",
}
LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
BOMB = f'<!DOCTYPE x [<!ENTITY l0 "ha">{LAUGHS}]>'

Contents = dict[str, bytes]


class Broken(NamedTuple):
    """One engine: how it is made, and what must be said of it."""

    name: str
    words: str  # a regular expression that the line must contain
    status: int
    make: Callable[[Kit], bytes]


class Kit:
    """Compiled libraries, and archives made of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        variants = {
            "plain": (2, []),
            "plain3": (3, []),
            "no-step": (2, ["-DWITHOUT_STEP"]),
            "crash-load": (2, ["-DCRASH_ON_LOAD"]),
            "hang-load": (2, ["-DHANG_ON_LOAD"]),
            "crash-exit": (2, ["-DCRASH_AT_EXIT"]),
        }
        with ThreadPoolExecutor(2) as pool:
            made = pool.map(lambda item: self._compile(item[0], *item[1]), variants.items())
            self.library = dict(zip(variants, made, strict=True))

    def _compile(self, name: str, fmi: int, options: list[str]) -> bytes:
        """The library; every function that FMPy asks for and the source does not have is a stub that fails."""
        defined = set(re.findall(r"^(?:int|void|void \*)\s*\*?(fmi\d\w+)\(", SOURCE.read_text(), re.MULTILINE))
        kind = FMU2Slave if fmi == 2 else FMU3Slave
        needed = {each for each, _ in inspect.getmembers(kind) if each.startswith(f"fmi{fmi}")}
        stubs = self.folder / f"{name}.c"
        missing = sorted(needed - defined)
        stubs.write_text(
            "\n".join([f'#include "{SOURCE}"', *(f"int {each}(void) {{ return 3; }}" for each in missing)])
        )
        target = self.folder / f"{name}{fmpy.sharedLibraryExtension}"
        compiler = shutil.which("cc") or "gcc"
        command = [compiler, "-shared", "-fPIC", "-O1", "-w", f"-DFMI={fmi}", *options, str(stubs), "-o", str(target)]
        subprocess.run([*command, "-lm"], check=True, capture_output=True)
        return target.read_bytes()

    def contents(self, fault: str = "", fmi: int = 2, library: str = "plain") -> Contents:
        """A sound archive but for the fault of the library."""
        library = library + "3" if fmi == 3 else library
        return {XML: DESCRIPTION[fmi].replace("{fault}", fault).encode(), BINARY[fmi]: self.library[library]}


def packed(contents: Contents) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in contents.items():
            archive.writestr(name, data)
    return stream.getvalue()


def fault(name: str, words: str, fmi: int = 2, library: str = "plain", label: str = "") -> Broken:
    """The library misbehaves."""
    return Broken(label or name, words, UNFIT, lambda kit: packed(kit.contents(name, fmi, library)))


def described(
    name: str, words: str, *changes: tuple[str, str], status: int = UNUSABLE, fmi: int = 2, fault: str = ""
) -> Broken:
    """Something else in the model description: old text, new text."""

    def make(kit: Kit) -> bytes:
        contents = kit.contents(fault, fmi)
        text = contents[XML].decode()
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new)
        return packed(contents | {XML: text.encode()})

    return Broken(name, words, status, make)


def with_entry(
    name: str, words: str, entry: zipfile.ZipInfo | str, data: bytes = b"x", status: int = UNUSABLE
) -> Broken:
    """One more file in a sound archive."""

    def make(kit: Kit) -> bytes:
        stream = io.BytesIO(packed(kit.contents()))
        with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(entry, data)
        return stream.getvalue()

    return Broken(name, words, status, make)


def of_kind(kind: int, name: str = "resources/thing") -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)
    entry.create_system = 3
    entry.external_attr = (kind | 0o777) << 16
    return entry


def changed(
    name: str, words: str, change: Callable[[Contents], object], fault: str = "", status: int = UNUSABLE
) -> Broken:
    def make(kit: Kit) -> bytes:
        contents = kit.contents(fault)
        change(contents)
        return packed(contents)

    return Broken(name, words, status, make)


def _patched(kit: Kit, offset: int, value: int) -> bytes:
    """A 16-bit field of the first entry in the central directory and, 2 bytes earlier there, in its local header."""
    data = bytearray(packed(kit.contents()))
    central = data.index(b"PK\x01\x02")
    for place in (central + offset, offset - 2):
        data[place : place + 2] = struct.pack("<H", value)
    return bytes(data)


def _twice(kit: Kit) -> bytes:
    stream = io.BytesIO(packed(kit.contents()))
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("resources/./a.txt", "1")
        archive.writestr("resources/a.txt", "2")
    return stream.getvalue()


def _damaged(kit: Kit) -> bytes:
    """One byte of the library is not what it was when it was packed."""
    stream = io.BytesIO()
    contents = kit.contents()
    with zipfile.ZipFile(stream, "w") as archive:  # stored, so that only the checksum can tell
        for name, data in contents.items():
            archive.writestr(name, data)
    data = bytearray(stream.getvalue())
    data[data.index(b"\x7fELF" if b"\x7fELF" in data else contents[BINARY[2]][:4]) + 200] ^= 0xFF
    return bytes(data)


def _only_text(contents: Contents) -> None:
    contents[BINARY[2]] = b"this is no library\n"


TRAVERSAL = "has an unsafe path inside"
DTD = "declares a document type or entities"

ARCHIVES = [
    Broken("empty", "is empty", UNUSABLE, lambda kit: b""),
    Broken("not-a-zip", "not a zip archive", UNUSABLE, lambda kit: b"MZ" + bytes(1000)),
    Broken("truncated", "is damaged or truncated", UNUSABLE, lambda kit: packed(kit.contents())[:-300]),
    Broken("damaged-library", "damaged", UNUSABLE, _damaged),
    Broken("encrypted", "is encrypted", UNUSABLE, lambda kit: _patched(kit, 8, 1)),
    Broken("strange-packing", "is packed by method 97", UNUSABLE, lambda kit: _patched(kit, 10, 97)),
    Broken("same-name-twice", "more than once", UNUSABLE, _twice),
    with_entry("path-traversal", TRAVERSAL, "../../evil.txt"),
    with_entry("path-traversal-inside", TRAVERSAL, "resources/../../evil.txt"),
    with_entry("absolute-path", TRAVERSAL, "/tmp/evil.txt"),
    with_entry("drive-path", TRAVERSAL, "C:/evil.txt"),
    with_entry("backslash", TRAVERSAL, "resources\\..\\..\\evil.txt"),
    with_entry("link", "has a link inside", of_kind(stat.S_IFLNK), b"/etc/passwd"),
    with_entry("device", "has a special file inside", of_kind(stat.S_IFIFO)),
    with_entry("zip-bomb", "zip bomb", "resources/zeros", bytes(32 * 2**20)),
    changed("too-many-files", "has 10003 files inside", lambda c: c.update({f"resources/{k}": b"" for k in range(10_001)})),
    changed("no-description", f"has no {XML}", lambda c: c.pop(XML)),
    changed("text-library", "its shared library does not load", _only_text, status=UNFIT),
    changed("library-of-zeros", "its shared library does not load", lambda c: c.update({BINARY[2]: bytes(9000)}), status=UNFIT),
]  # fmt: skip

ROOT = "<fmiModelDescription"

DESCRIPTIONS = [
    described("bad-xml", "is not valid XML", ("</ModelVariables>", "</ModelVariable>")),
    changed("no-xml", "is not valid XML", lambda c: c.update({XML: b"\x01\x02"})),
    described("utf-7", "is in UTF-7; allowed:", ("UTF-8", "UTF-7")),
    changed("utf-16", "is in UTF-16", lambda c: c.update({XML: c[XML].decode().replace("UTF-8", "UTF-16").encode("utf-16")})),
    described("xml-bomb", DTD, (ROOT, BOMB + ROOT)),
    described("external-entity", DTD, (ROOT, f'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>{ROOT}')),
    described("deep-xml", "nests elements more than 64 deep", ("<ModelVariables>", "<a>" * 5000 + "</a>" * 5000 + "<ModelVariables>")),
    changed("huge-xml", "is larger than 16 MB", lambda c: c.update({XML: c[XML] + b" " * 2**24, "x": random.randbytes(2**19)})),
    changed("bomb-in-build-description", DTD, lambda c: c.update({"sources/buildDescription.xml": f"{BOMB}<a/>".encode()})),
    described("wrong-root", "describes a model, not an FMU", ("fmiModelDescription", "model")),
    described("fmi-1", "FMI version 1.0 is not supported", ('fmiVersion="2.0"', 'fmiVersion="1.0"')),
    described("no-co-simulation", "has no co-simulation interface", ("<CoSimulation", "<Nothing")),
    described("no-range", "is no range", ('max="1"', 'max="0"')),
    described("step-that-does-not-fit", "is not a whole multiple of the engine's internal step 0.003 s", ("<CoSimulation ", '<CoSimulation fixedInternalStepSize="0.003" '), fmi=3),
    described("wrong-token", "cannot be instantiated: the token is not mine", ("broken:", "brokem:"), status=UNFIT),
    described("needs-its-tool", "cannot be instantiated: cannot reach the simulation tool", ("<CoSimulation ", '<CoSimulation needsExecutionTool="true" '), status=UNFIT, fault="needs-tool"),
]  # fmt: skip

LOADED, MEASURED = "when it was loaded", "while its thrust was measured"
SEGV = "the process was ended by SIGSEGV"
HANG = "the process did not answer within [0-9.e+]+ s"
LIBRARIES = [
    fault("missing-symbol", "does not load: .*fmi2DoStep", library="no-step"),
    fault("crash-load", f"{SEGV} {LOADED}", library="crash-load"),
    fault("crash-step", f"{SEGV} {MEASURED}"),
    fault("crash-exit", f"{SEGV} {LOADED}", library="crash-exit"),
    fault("abort-step", f"the process was ended by SIGABRT {MEASURED}"),
    fault("exit-instantiate", f"the process ended with status 3 {LOADED}"),
    fault("leave-later", f"the process ended with status 0 {MEASURED}"),
    fault("hang-load", f"{HANG} {LOADED}", library="hang-load"),
    fault("hang-step", f"{HANG} {MEASURED}"),
    fault("refuse", "cannot be instantiated"),
    fault("error-init", "returned error: no oil pressure"),
    fault("error", f"doStep returned error {MEASURED}: compressor surge"),
    fault("discard", f"doStep returned discard {MEASURED}: no time for that"),
    fault("grid", "doStep returned error .*my step is 0.003 s"),
    fault("terminate", "it asked to end the simulation", fmi=3),
    fault("early", "returned early from doStep", fmi=3),
    fault("nan", "thrust is not finite"),
    fault("nan-later", f"thrust is not finite {MEASURED}"),
    fault("constant", "thrust does not answer the throttle"),
    fault("restless", "thrust does not settle"),
    fault("hump", "thrust does not rise with the throttle"),
    fault("negative", "thrust is negative: -5 N at throttle 0"),
    fault("process", "two processes with the same throttle differ"),
    fault("single", "cannot be instantiated"),
    fault("hungry", f"the process takes \\d+ MB of memory, 1024 MB at most {LOADED}"),
    fault("close", f"the process (ended with status .|closed its output) {LOADED}"),
]  # fmt: skip

BROKEN = [*ARCHIVES, *DESCRIPTIONS, *LIBRARIES]
