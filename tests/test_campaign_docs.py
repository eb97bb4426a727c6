"""What docs/campaigns.md says can be typed: commands, their options, a study's file, and the Python."""

from __future__ import annotations

import ast
import re
import shlex
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import pytest

from cosim.campaign import folder, keys
from cosim.campaign import search_folder as searches
from cosim.campaign.options import open_study
from cosim.campaign.study import Study
from cosim.cli import cli

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "campaigns.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
COMMANDS = [
    shlex.split(line, comments=True)[1:]
    for language, text in BLOCKS
    if not language
    for line in text.splitlines()
    if line.startswith("hexjet ")
]
PYTHON = [text for language, text in BLOCKS if language == "python"]
OF_A_SWEEP = ("vary", "correlate", "success", "settings", "controllers", "design", "runs", "repeats", "seed")


def parsed(words: list[str]) -> click.Context:
    """The command that these words are, not run."""
    name, command, rest = cli.resolve_command(click.Context(cli), list(words))
    assert command is not None
    return command.make_context(name, list(rest))


def test_there_is_something_to_read() -> None:
    assert len(COMMANDS) > 12
    assert len(PYTHON) > 4
    assert {words[0] for words in COMMANDS} == {"list", "sweep", "fly", "report", "search"}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_a_command_is_one(words: list[str]) -> None:
    """Its options exist, and what it asks for can be flown; folders and files of the reader's own are left alone."""
    options = parsed(words).params
    name = str(options.get("name", ""))
    flown = words[0] == "sweep" and "--keys" not in words
    if flown and not name.startswith("runs/") and name != "mine.toml":
        open_study(name, **{option: options[option] for option in OF_A_SWEEP if options[option]})
    if words[0] == "search":
        elsewhere = ("workers", "cluster", "time_limit", "out", "resume", "as_json", "name")
        searches.opened(name, **{option: value for option, value in options.items() if option not in elsewhere})


@pytest.mark.parametrize("command", ["sweep", "search"])
def test_every_option_is_on_the_page(command: str) -> None:
    own = [option for parameter in cli.commands[command].params for option in parameter.opts if option.startswith("--")]
    assert len(own) > 8
    assert [option for option in own if option not in PAGE] == []


def test_the_study_on_the_page_is_one(tmp_path: Path) -> None:
    (text,) = [text for language, text in BLOCKS if language == "toml"]
    (tmp_path / "mine.toml").write_text(text.replace(', "designed.toml"', ""))
    study = Study.load(tmp_path / "mine.toml")
    unsaid = set(Study.model_fields) - set(study.table())
    assert unsaid <= {"description", "repeats"}, "the page leaves out a key of a study's file"
    for key in unsaid:
        assert key in PAGE


def test_the_keys_on_the_page_exist() -> None:
    """Those that are whole: with a place where the page has a star."""
    named = {
        match.replace(".*", ".0")
        for match in re.findall(r"`((?:vehicle|mismatch|engine_parameters|environment|disturbance|fault|stations)\.[\w.*]+)`", PAGE)
        if not match.endswith(".toml")
    }  # fmt: skip
    fault = {"kind": "slow_spool", "start_s": 0.0, "jet": [1], "lag_s": 0.1}
    scenario = open_study("payload-drop", vary=["vehicle.mass_kg=5:6"], runs=2).base().replace(fault=[fault])
    known = {key.path for key in keys.all_keys(scenario)}
    tables = {"vehicle.identified.0", "environment.0", "vehicle.aero.0", "vehicle.sensors.0"}
    assert len(named) > 12
    assert named - known - tables == set()


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
        # only the first campaign of the page is flown here
        if all(find_spec(name.split(".")[0]) for name in wanted) and "runs/envelope" not in block:
            exec(code, said)
    assert len(said["campaign"]) == 2
    assert 0.0 <= said["share"] <= 1.0
    assert len(said["lost"]) == said["columns"]["outcome"].count("diverged") + said["columns"]["outcome"].count(
        "failed"
    )
    assert said["smith"].shape == (2,)
