"""Templates of the package are compiled once, and what runs comes from the package's own folder alone."""

from __future__ import annotations

import sys
from pathlib import Path
from types import CodeType

import pytest
from jinja2 import Environment, FileSystemLoader
from jinja2.bccache import Bucket

from cosim.results.report import compiled_templates
from cosim.results.report.compiled_templates import CompiledTemplates
from cosim.results.report.page import TEMPLATES


@pytest.fixture
def compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The templates that Jinja compiles from here on, with nothing kept before."""
    monkeypatch.setattr(compiled_templates, "FOLDER", tmp_path / "kept")
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    (tmp_path / "kept").mkdir()
    names: list[str] = []
    compile_one = Environment.compile

    def note(self: Environment, source: str, name: str, filename: str) -> CodeType:
        names.append(name)
        return compile_one(self, source, name, filename)

    monkeypatch.setattr(Environment, "compile", note)
    return names


def render(folder: Path, name: str) -> str:
    environment = Environment(loader=FileSystemLoader(folder), bytecode_cache=CompiledTemplates())
    return environment.get_template(name).render(notes=["a", "b"])


def test_a_template_of_the_package_is_compiled_once(
    compiled: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled_templates, "PACKAGE", tmp_path)
    template = tmp_path / "page.html"
    template.write_text("{{ notes | join }}")
    assert render(tmp_path, "page.html") == render(tmp_path, "page.html") == "ab"
    assert compiled == ["page.html"]
    template.write_text("{{ notes | length }}")
    assert render(tmp_path, "page.html") == "2"
    monkeypatch.setattr(compiled_templates, "version", lambda name: "another of Jinja")
    assert render(tmp_path, "page.html") == "2"
    assert compiled == ["page.html"] * 3
    assert len(list((tmp_path / "kept").iterdir())) == 1


def test_a_template_of_others_is_not_kept(compiled: list[str], tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("{{ notes | join }}")
    assert render(tmp_path, "page.html") == render(tmp_path, "page.html") == "ab"
    assert compiled == ["page.html"] * 2
    assert not list((tmp_path / "kept").iterdir())


def test_a_folder_that_cannot_be_written_to_costs_time_alone(
    compiled: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled_templates, "FOLDER", tmp_path / "nowhere")
    monkeypatch.setattr(compiled_templates, "PACKAGE", tmp_path)
    (tmp_path / "page.html").write_text("{{ notes | join }}")
    assert render(tmp_path, "page.html") == "ab"


def test_what_is_kept_lies_with_the_modules_bytecode() -> None:
    environment = Environment(loader=FileSystemLoader(TEMPLATES))
    kept = CompiledTemplates()
    key = kept.get_cache_key("table.html", str(TEMPLATES / "table.html"))
    place = Path(kept._get_cache_filename(Bucket(environment, key, "")))
    package = Path(compiled_templates.__file__).parent
    assert place.parent == package / "__pycache__"
    assert place.name.endswith(f"{sys.implementation.cache_tag}.pyc")
