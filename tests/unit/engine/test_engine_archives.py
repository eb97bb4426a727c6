"""Archives as other machines and other tools make them."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import fmpy
import pytest
from engine_tools import STEP
from foreign_engines import foreign

from cosim import Scenario, fly
from cosim.base.errors import InputError
from cosim.engine import EngineBank, EngineSpec, check_fmu, load_engine
from cosim.engine.check import note_harmless_violations
from cosim.engine.fmu.container import Zip, is_system_file
from cosim.engine.fmu.description import pack_descriptions
from cosim.engine.fmu.unpacked import unpack

APPLE = b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X        "  # how such a file of a Mac begins


def load(path: Path) -> EngineSpec:
    return load_engine(str(path), {}, STEP, unchecked=True)


@pytest.mark.parametrize(
    ("name", "is_one"),
    [
        ("__MACOSX/resources/._p.ssv", True),
        ("__MACOSX/", True),
        ("resources/._table.csv", True),
        ("resources/.DS_Store", True),
        ("Thumbs.db", True),
        ("binaries/win64/Desktop.ini", True),
        ("resources/table.csv", False),
        ("resources/.hidden", False),
        ("modelDescription.xml", False),
        ("resources/", False),
    ],
)
def test_what_a_system_keeps_for_itself(name: str, is_one: bool) -> None:
    assert is_system_file(name) == is_one


def with_system_files(path: Path) -> Path:
    """The archive as a Mac's Finder and Windows' Explorer leave it, with a file of each kind."""
    with zipfile.ZipFile(path, "a") as archive:
        for name in ("__MACOSX/._modelDescription.xml", "__MACOSX/resources/._p.ssv", "resources/.DS_Store",
                     "resources/Thumbs.db", "resources/desktop.ini", f"binaries/{fmpy.platform}/._foreign.so"):  # fmt: skip
            archive.writestr(name, APPLE)
    return path


def with_backslashes(path: Path) -> Path:
    """The archive as some programs on Windows pack it."""
    with zipfile.ZipFile(path) as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in held.items():
            archive.writestr(name.replace("/", "\\"), data)
    with zipfile.ZipFile(path) as archive:
        assert any("\\" in name for name in archive.namelist())
    return path


PACKED = [with_system_files, with_backslashes]


def told_of_names(notes: Sequence[str], packed: Callable[[Path], Path]) -> bool:
    """Whether the notes say of backslashes, once, what there is to say, and of a Mac's files nothing."""
    said = [note for note in notes if "backslash" in note or "._" in note]
    return len(said) == (packed is with_backslashes)


@pytest.mark.parametrize("packed", PACKED)
def test_an_fmu_of_another_system_flies(packed: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Checked as a flight has it checked, in a child, which validates it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = packed(foreign(tmp_path, "other", "lag=0.1"))
    report = check_fmu(str(path))
    assert report.problems == []
    assert told_of_names(report.notes, packed)
    hover = Scenario.load("hover").replace(engine=str(path), controller="baseline", duration_s=0.1, expect=[])
    assert fly(hover, report=False).outcome == "completed"


def test_a_description_is_found_behind_backslashes(tmp_path: Path) -> None:
    """What an FMU of FMI 3.0 says of its sources too."""
    path = with_backslashes(foreign(tmp_path, "other", "lag=0.1"))
    build = b'<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="x"/></fmiBuildDescription>'
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("sources\\buildDescription.xml", build)
    with zipfile.ZipFile(pack_descriptions(path.read_bytes())) as archive:
        assert archive.read("sources/buildDescription.xml") == build


def test_what_a_system_keeps_for_itself_is_not_unpacked(tmp_path: Path) -> None:
    spec = load(with_system_files(foreign(tmp_path, "mac", "lag=0.1")))
    with unpack(spec.archive) as folder:
        assert [path.name for path in folder.rglob("*") if path.is_file()] == [f"foreign{fmpy.sharedLibraryExtension}"]


def test_a_folder_that_was_packed_in_place_of_its_contents_is_told(tmp_path: Path) -> None:
    path = foreign(tmp_path, "mine", "lag=0.1")
    with zipfile.ZipFile(path) as archive:
        held = {f"mine/{name}": archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in held.items():
            archive.writestr(name, data)
    with pytest.raises(InputError, match=r"no modelDescription.xml, but mine/modelDescription.xml: pack what is in"):
        load(path)


def test_names_are_read_as_written_elsewhere(tmp_path: Path) -> None:
    with Zip(with_backslashes(foreign(tmp_path, "other", "lag=0.1"))) as archive:
        assert f"binaries/{fmpy.platform}/foreign{fmpy.sharedLibraryExtension}" in archive.namelist()
        assert archive.testzip() is None


def stating(folder: Path, attributes: str, name: str = "odd") -> Path:
    """An engine with one parameter more."""
    more = f'<ScalarVariable name="v_min" valueReference="40" {attributes}><Real start="1"/></ScalarVariable>\n'
    return foreign(folder, name, "lag=0.1", change=("</ModelVariables>", f"{more}</ModelVariables>"))


@pytest.mark.parametrize(
    ("attributes", "settable"),
    [
        ('causality="parameter" variability="constant"', False),
        ('causality="parameter" variability="continuous"', True),
        ('causality="parameter" variability="discrete"', True),
        ('causality="parameter"', True),
        ('causality="calculatedParameter" variability="constant"', False),
        ('causality="local" variability="constant"', False),
    ],
)
def test_a_variability_that_fmi_forbids_is_read_over_and_told(attributes: str, settable: bool, tmp_path: Path) -> None:
    spec = load(stating(tmp_path, attributes))
    assert [v.name for v in spec.archive.parameters] == (["v_min"] if settable else [])
    if "local" not in attributes:
        assert any(
            "v_min" in note and "of no effect on stepping" in note for note in note_harmless_violations(spec.archive)
        )
    with EngineBank(spec, 1, STEP) as bank:
        assert bank.reset(1.0).thrust[0] == pytest.approx(20.0)


def test_a_constant_is_no_parameter_that_can_be_set(tmp_path: Path) -> None:
    path = stating(tmp_path, 'causality="parameter" variability="constant"')
    with pytest.raises(InputError, match="v_min"):
        load_engine(str(path), {"v_min": 2.0}, STEP, unchecked=True)


@pytest.mark.parametrize(
    ("held", "said"),
    [
        ({}, "(it has: no binary at all)"),
        ({"win64/x.dll": b"x"}, "(it has: win64)"),
        ({f"{fmpy.platform}/": b""}, f"(folder {fmpy.platform} is empty)"),
        ({f"{fmpy.platform}/": b"", "win64/x.dll": b"x"}, f"(folder {fmpy.platform} is empty)"),
        ({f"{fmpy.platform}/other.so": b"x", "win64/x.dll": b"x"}, f"(folder {fmpy.platform} holds other.so)"),
    ],
)
def test_what_is_there_in_place_of_the_library_is_told(held: dict[str, bytes], said: str, tmp_path: Path) -> None:
    path = foreign(tmp_path, "without", "lag=0.1")
    with zipfile.ZipFile(path) as archive:
        description = archive.read("modelDescription.xml")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        for name, data in held.items():
            archive.writestr(f"binaries/{name}", data)
    with pytest.raises(InputError, match="has no binary for this machine") as refused:
        load(path)
    assert str(refused.value).endswith(said)
