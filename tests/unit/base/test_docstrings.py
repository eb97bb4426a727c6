"""Public functions, classes and protocols are documented in numpydoc's form: every parameter, what is given back, what is raised."""

from __future__ import annotations

import ast
import doctest
import inspect
import json
import re
import runpy
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE
from places import DOCS, ROOT

import cosim
from cosim import campaign
from cosim.base import protocols, signals

# Blocks of a flight that nobody writes from outside: a sentence a method says units and order.
BLOCKS = ("Allocator", "Controller", "Engines", "Pilot", "Sensors")


def documented() -> Iterator[tuple[str, Any]]:
    """What a user calls or writes: exports of the package with their methods, and the protocols'."""
    own = {name: CALLED(name) for name in cosim.__all__}
    own |= {
        name: each
        for name, each in vars(protocols).items()
        if getattr(each, "_is_protocol", False) and name not in {"Protocol", *BLOCKS}
    }
    for name, each in own.items():
        yield name, each
        if inspect.isclass(each):
            for member, value in vars(each).items():
                if not member.startswith("_") and member != "model_config":
                    found = value.__func__ if isinstance(value, classmethod) else value
                    if isinstance(found, property) or (
                        inspect.isfunction(found) and found.__module__.startswith(("cosim", "hexjet_"))
                    ):
                        yield f"{name}.{member}", found


CALLED = runpy.run_path(str(DOCS / "api.py"))["read_export"]
EACH = dict(documented())
EXAMPLES = [p for d in ("cosim", "tools") for p in sorted((ROOT / d).rglob("*.py")) if ">>> " in p.read_text()]


def sections(doc: str) -> dict[str, str]:
    """The parts of a docstring in numpydoc's form, by their titles."""
    found = re.split(r"^(\w+)\n-{3,}\n", inspect.cleandoc(doc), flags=re.MULTILINE)
    return dict(zip(found[1::2], found[2::2], strict=True))


@pytest.mark.parametrize("name", EACH)
def test_a_docstring_has_every_parameter(name: str) -> None:
    """In order and each with a type and a sentence; likewise what is given back, if no summary says what it returns."""
    found = EACH[name]
    doc = inspect.getdoc(found)
    if name == "Columns.columns":
        return  # the class says it
    assert doc, name
    if not inspect.isfunction(found):
        return
    signature = inspect.signature(found)
    stated = [
        {inspect.Parameter.VAR_KEYWORD: "**", inspect.Parameter.VAR_POSITIONAL: "*"}.get(each.kind, "") + each.name
        for each in signature.parameters.values()
        if each.name not in ("self", "cls")
    ]
    parts = sections(doc)
    lines = re.findall(
        r"^(\S+) : (\S.*)\n((?:    \S.*\n?)+)", parts.get("Parameters", "").replace("\n\n", "\n"), re.MULTILINE
    )
    assert [each for each, *_ in lines] == stated
    gives = signature.return_annotation not in ("None", None, inspect.Signature.empty)
    if stated:
        summary = doc.partition("\n")[0]
        assert ("Returns" in parts or bool(re.search(r"^Return | and return ", summary))) == gives
    assert "Raises " not in doc.replace("Raises\n", "")  # in a section of its own


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    """The site's pages, by a process that runs from source: what is compiled has no docstrings."""
    command = [sys.executable, str(DOCS / "api.py")]
    pages: dict[str, str] = json.loads(subprocess.check_output(command, text=True, timeout=PATIENCE))
    return pages


def test_the_reference_is_made_of_them(made: dict[str, str]) -> None:
    for name in (each for each in EACH if "." not in each):
        assert f"## `{name}`" in "".join(made.values()), name
    for record in (signals.Measured, signals.Command, signals.Sample, protocols.Applied, protocols.Parameter):
        assert all(f"| `{field}` | `" in made["python-records.md"] for field in record._fields)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_examples_of_a_module_are_right(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removeprefix("tools.")
    known = {n: CALLED(n) for n in cosim.__all__} | {n: getattr(campaign, n) for n in campaign.__all__}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (doc := ast.get_docstring(node)):
            test = doctest.DocTestParser().get_doctest(doc, known | vars(import_module(name)), name, str(path), 0)
            assert doctest.DocTestRunner().run(test).failed == 0


PUBLIC = runpy.run_path(str(DOCS / "api.py"))["MODULES"]


@pytest.mark.parametrize("module", PUBLIC)
def test_a_public_module_says_what_each_of_its_names_is(made: dict[str, str], module: str) -> None:
    found, shown = import_module(f"cosim.{module}"), made[f"python-{module}.md"]
    assert inspect.getdoc(found)
    for name in found.__all__:
        assert f"`{name}" in shown, name
        each = getattr(found, name)
        if inspect.isclass(each) or inspect.isroutine(each):
            text = shown.partition(f"## `{name}`\n")[2] or shown.partition(f"```python\n{name}(")[2].partition("```")[2]
            assert text.partition("\n## ")[0].strip(), name


def test_what_tools_may_import_has_a_docstring() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        contracts = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    (tools,) = [each for each in contracts if each["name"] == "the tools import what is public"]
    allowed = {line.partition(" -> ")[2] for line in tools["ignore_imports"]}
    assert {"cosim", "cosim.base.protocols", *(f"cosim.{name}" for name in PUBLIC)} <= allowed
    others = allowed - {f"cosim.{name}" for name in PUBLIC}  # of public ones the page has them
    for path in sorted((ROOT / "tools").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module in others:
                written, module = docstrings(node.module), import_module(node.module)
                assert written[""], node.module
                for name in node.names:
                    each = getattr(module, name.name)
                    if inspect.isclass(each) or inspect.isroutine(each):
                        of_source = written if name.name in written else docstrings(each.__module__)
                        assert of_source.get(name.name) or inspect.getdoc(each), f"{node.module}.{name.name}"


@cache
def docstrings(module: str) -> dict[str, str | None]:
    """The docstrings in a module's source, by name, its own without one; what is compiled has none where it runs."""
    path = (ROOT if module.startswith("cosim") else ROOT / "tools").joinpath(*module.split("."))
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    tree = ast.parse(source.read_text(encoding="utf-8"))
    members = [each for each in tree.body if isinstance(each, ast.ClassDef | ast.FunctionDef)]
    return {"": ast.get_docstring(tree)} | {each.name: ast.get_docstring(each) for each in members}
