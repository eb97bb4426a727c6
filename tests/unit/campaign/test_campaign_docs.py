"""What docs/campaigns.md and docs/tables/campaigns.md say can be typed: commands, their options, a study's file, and the Python."""

from __future__ import annotations

import ast
import re
import shlex
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

from cosim.campaign import folder
from cosim.campaign.study.options import open_study
from cosim.campaign.study.study import Study
from cosim.cli import table
from hexjet_prove.proof.design_study import design_study, find_design
from hexjet_prove.search import folder as searches
from hexjet_prove.search.worst_folder import resolve_worst

PAGE, TABLES = ((ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("campaigns.md", "tables/campaigns.md"))
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", PAGE + TABLES, re.MULTILINE | re.DOTALL)
COMMANDS = [
    shlex.split(line, comments=True)[1:]
    for language, text in BLOCKS
    if not language
    for line in text.splitlines()
    if line.startswith("hexjet ")
]
PYTHON = [text for language, text in BLOCKS if language == "python"]
OF_A_SWEEP = ("vary", "correlate", "success", "settings", "controllers", "design", "runs", "repeats", "seed", "until")


def parsed(words: list[str]) -> dict[str, Any]:
    """The arguments of the command that these words are, not run."""
    name, rest = table.find(words)
    return table.load(name).read(rest)


def test_there_is_something_to_read() -> None:
    assert len(COMMANDS) > 12
    assert len(PYTHON) > 3
    assert {words[0] for words in COMMANDS} == {"show", "sweep", "fly", "search", "prove", "batch"}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_a_command_is_one(words: list[str]) -> None:
    """Its options exist, and what it asks for can be flown; folders and files of the reader's own are left alone."""
    options = parsed(words)
    name = str(options.get("name", ""))
    flown = words[0] == "sweep" and "--keys" not in words
    if flown and not name.startswith("runs/") and not {"mine.toml", "fitted/engine.toml"} & set(words):
        open_study(name, **{option: options[option] for option in OF_A_SWEEP if options.get(option)})
    if words[0] == "search" and "--rare" not in words:
        asked = {option: value for option, value in options.items() if option not in ("name", "worst", "likely")}
        if options.get("worst") or options.get("likely"):
            designed = find_design(ROOT / name)
            study = name if designed is None else design_study(designed, "", 1)
            resolve_worst(study, likely=options.get("likely", False), **asked)
        else:
            searches.resolve_search(name, **asked)


def test_the_study_on_the_page_is_one(tmp_path: Path) -> None:
    (text,) = [text for language, text in BLOCKS if language == "toml"]
    (tmp_path / "mine.toml").write_text(text.replace(', "designed.toml"', ""))
    study = Study.load(tmp_path / "mine.toml")
    unsaid = set(Study.model_fields) - set(study.table())
    optional = {"autopilot", "batch", "case", "description", "nominal_engine", "repeats", "until"}
    assert unsaid <= optional, "the page leaves out a key of a study's file"
    assert all(f"`{key} = " in PAGE or f"`{key}`" in PAGE or f"[{key}]" in PAGE for key in unsaid - {"description"})
    for key in unsaid:
        assert key in PAGE


def test_the_python_on_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of the page, on two flights of a second instead of 2,000 of ten."""
    whole = Study.load
    small: dict[str, Any] = {"runs": 2, "controllers": ["smith"]}

    def load(name: str) -> Study:
        settings = {**whole(name).settings, "duration_s": 1.0}
        return whole(name).changed(settings=settings, **small)

    monkeypatch.setattr(Study, "load", staticmethod(load))
    monkeypatch.setattr(folder, "load", lambda path: whole(Path(path).absolute() / folder.STUDY))
    monkeypatch.chdir(tmp_path)
    said: dict[str, Any] = {}
    for block in PYTHON:
        code = compile(block, "docs/campaigns.md", "exec")
        wanted = [
            name.name for node in ast.walk(ast.parse(block)) if isinstance(node, ast.Import) for name in node.names
        ]
        # What JAX differentiates is run by a test of flights on arrays.
        if all(find_spec(name.split(".")[0]) for name in wanted) and "with_jax" not in block:
            exec(code, said)
    assert len(said["campaign"]) == 2
    assert 0.0 <= said["share"] <= 1.0
    assert len(said["lost"]) == said["columns"]["outcome"].count("diverged") + said["columns"]["outcome"].count(
        "failed"
    )
    assert said["smith"].shape == (2,)
