"""Which modules run unasked: installed ones, and none that Python only happens to find."""

from __future__ import annotations

import importlib.util
import json
import py_compile
import sys
import zipfile
from collections.abc import Iterator
from importlib._bootstrap_external import _code_to_hash_pyc  # type: ignore[import-not-found]
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from cosim.base import trust
from cosim.base.errors import InputError
from cosim.base.plugins import execute
from cosim.base.plugins.entry_points import load_entry
from cosim.base.plugins.execute import import_installed
from cosim.base.storage.user import settings_folder
from cosim.simulation.controllers.source import find_controller_source, list_installed

REFUSED = "has code that has not been run before"


@pytest.fixture(autouse=True)
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A user who has flown nothing so far; Python looks for modules in the current folder first, as in a notebook."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(trust.ENV_VAR, raising=False)
    monkeypatch.setattr(trust, "_decision", trust.TrustDecision(by_program=False))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.syspath_prepend(str(tmp_path / "here"))
    before = dict(sys.modules)
    yield
    for name in sys.modules.keys() - before.keys():
        del sys.modules[name]
    sys.modules.update(before)


@pytest.fixture
def mark(tmp_path: Path) -> Path:
    """Where code leaves a mark when it runs."""
    return tmp_path / "ran"


def write(path: str, mark: Path) -> Path:
    file = Path(path).absolute()
    file.parent.mkdir(parents=True, exist_ok=True)
    marks = f"with open({str(mark)!r}, 'a') as file:\n    file.write('ran ')\n"
    file.write_text(f"# {path}\n{marks}\n\nclass Mine:\n    pass\n")
    return file


def state(folder: Path, name: str, **files: str) -> Path:
    """The metadata of a package that is developed in the current folder."""
    facts = folder / f"{name}-1.dist-info"
    facts.mkdir(parents=True)
    place = {"url": Path().absolute().as_uri(), "dir_info": {"editable": True}}
    files = {"METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n"} | files
    for file, text in (files | {"direct_url.json": json.dumps(place)}).items():
        (facts / file).write_text(text)
    return facts


def refused(module: str) -> None:
    with pytest.raises(trust.CodeRefusedError, match=REFUSED) as error:
        import_installed(module, "test")
    assert f"test: {Path().absolute()} ({module.partition('.')[0]}" in str(error.value)


def test_a_folder_without_init_is_asked_for(mark: Path) -> None:
    evil, other = write("box/evil.py", mark), write("box/deep/other.py", mark)
    refused("box.evil")
    refused("box.deep.other")
    trust.trust("box")  # Python looks into the folder above, whatever these import
    refused("box.evil")
    assert not mark.exists()
    trust.trust(".")
    assert import_installed("box.evil", "test")[1] == evil
    assert import_installed("box.deep.other", "test")[1] == other
    known = (settings_folder() / trust.TRUSTED_LIST).read_text()
    assert known[64:] == f"  {Path().absolute()}\n"
    assert mark.read_text() == "ran ran "


def test_a_name_that_is_installed_elsewhere_is_asked_for(mark: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is run is what is found first, whoever else has a package of this name."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "tomli_w"]:
        monkeypatch.delitem(sys.modules, name)
    write("tomli_w/__init__.py", mark)
    refused("tomli_w")
    assert not mark.exists()


def test_metadata_beside_it_are_not_believed(mark: Path) -> None:
    write("theirs/__init__.py", mark)
    facts = state(Path(), "theirs", RECORD="theirs/__init__.py,,\n", **{"top_level.txt": "theirs\n"})
    refused("theirs")
    with pytest.raises(trust.CodeRefusedError, match=REFUSED):
        load_entry(EntryPoint("theirs", "theirs:Mine", "hexjet.controllers"))
    (facts / "entry_points.txt").write_text("[hexjet.controllers]\nstrange = theirs:Mine\n")
    said = "theirs:Mine (not where packages are installed, and not run to look at it)"
    assert dict(list_installed())["strange"] == said
    assert not mark.exists()


def test_a_package_of_compiled_files_is_asked_for(mark: Path) -> None:
    source = write("binary/__init__.py", mark)
    py_compile.compile(str(source), str(source.with_suffix(".pyc")), doraise=True)
    source.unlink()
    refused("binary")
    library = Path("native", "__init__.abi3.so").absolute()
    library.parent.mkdir()
    library.write_bytes(b"no library")
    refused("native")
    assert not mark.exists()


def test_what_has_no_file_to_look_at_is_refused(mark: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with zipfile.ZipFile(tmp_path / "packed.zip", "w") as archive:
        archive.writestr("packed.py", write("source.py", mark).read_text())
    monkeypatch.syspath_prepend(str(tmp_path / "packed.zip"))
    with pytest.raises(InputError, match="test: packed: is not installed, and no file of it can be looked at"):
        import_installed("packed", "test")
    assert not mark.exists()


def test_a_folder_is_no_module_with_a_class(tmp_path: Path) -> None:
    Path("empty").mkdir()
    with pytest.raises(InputError, match="controller empty:Mine: "):
        find_controller_source("empty:Mine", tmp_path, "test")


def test_a_module_in_a_package_that_is_loaded_is_asked_for(mark: Path) -> None:
    Path("ours").mkdir()
    __import__("ours")
    write("ours/evil.py", mark)
    refused("ours.evil")
    assert not mark.exists()


def test_finding_a_module_does_not_run_its_package(mark: Path) -> None:
    write("outer/__init__.py", mark)
    write("outer/inner.py", mark)
    refused("outer.inner")
    assert not mark.exists()


def test_installed_modules_run_and_so_do_named_ones(mark: Path) -> None:
    for name in ("sys", "xml.dom.minidom", "zipapp", "cosim.control.predictors.registry"):
        assert import_installed(name, "test")[0].__name__ == name
    assert not settings_folder().exists()
    law = write("law/__init__.py", mark)
    with trust.command_trust_scope(None, ["fly", "hover", "--controller", "law:Mine"]):
        import_installed("law", "test")
    assert mark.exists()
    assert not Path("law/__pycache__").exists()
    del sys.modules["law"]
    compiled = Path(importlib.util.cache_from_source(str(law)))
    compiled.parent.mkdir()
    text = compile(f"open({str(mark)!r}, 'a').write('compiled')", str(law), "exec")
    compiled.write_bytes(_code_to_hash_pyc(text, importlib.util.source_hash(law.read_bytes()), False))
    import_installed("law", "test")  # the same folder is remembered, and nothing compiled is read in it
    assert mark.read_text() == "ran ran "


def test_a_package_that_is_developed_in_place_is_installed(
    mark: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the installer has noted it, and nothing else that lies there."""
    state(tmp_path / "site", "developed")
    monkeypatch.setattr(execute, "_installed_folders", lambda: frozenset([tmp_path / "site"]))
    execute._editable_folders.cache_clear()
    try:
        write("developed/__init__.py", mark)
        write("download/developed.py", mark)
        refused("download.developed")
        write("other.py", mark)
        refused("other")
        assert not mark.exists()
        import_installed("developed", "test")
        assert mark.exists()
    finally:
        execute._editable_folders.cache_clear()
