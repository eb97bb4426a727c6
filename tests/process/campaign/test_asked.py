"""A folder goes on with what its first flight was asked for, or not at all: every command that resumes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from command_tools import Done, Hexjet
from places import TESTS

from cosim.campaign import installed, open_campaign
from cosim.campaign.folder import ASKED

STUDY = """
name = "short"
scenario = "hover"
controllers = ["smith"]
design = "random"
runs = 20
until = "70%@90%"

[settings]
duration_s = 0.02

[[vary]]
key = "vehicle.mass_kg"
normal = { mean = 5.525, sd = 0.05, min = 5.4, max = 5.7 }

[success]
"roll.max_abs_error_rad" = { max = 0.0305 }
"""
DRAWN = ["hover", "--vary", "vehicle.mass_kg=normal(5.525,0.05,5.4,5.7)"]
HOVER = ["--set", "duration_s=0.02", "--success", "roll.max_abs_error_rad<=0.0305"]
BUDGET = ["--budget", "800", "--target", "0.5", "--same-seed"]
ALONE = ["--search", "0", "--no-limit"]
# Of each: the command, how it is resumed, and where its study is.
COMMANDS: dict[str, tuple[list[str], list[str], str]] = {
    "sweep": (["sweep", "short.toml"], ["sweep", "out"], ""),
    "prove": (["prove", "short.toml", *ALONE], ["prove", "out", *ALONE], "campaign"),
    "search": (["search", "hover", "--vary", "vehicle.mass_kg=5.5:5.6:3", *HOVER], [], ""),
    "likely": (["search", *DRAWN, "--likely", "--budget", "20", *HOVER], [], ""),
    "rare": (["search", "--rare", *DRAWN, *BUDGET, *HOVER], [], ""),
}


@pytest.fixture(params=COMMANDS)
def flown(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hexjet: Hexjet
) -> tuple[Path, Callable[[], Done]]:
    """The folder of a study that a command flew, and what resumes it."""
    monkeypatch.chdir(tmp_path)
    Path("short.toml").write_text(STUDY)
    first, again, folder = COMMANDS[request.param]
    done = hexjet(*first, "--out", "out", "--workers", "1")
    assert done.status in (0, 1), done.err
    resume = [*again, "--resume"] if again else [*first, "--out", "out", "--resume"]
    return Path("out", folder), lambda: hexjet(*resume, "--workers", "1")


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))


def test_an_edited_folder_is_refused_by_the_key_that_changed(
    flown: tuple[Path, Callable[[], Done]], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, resume = flown
    assert resume().status in (0, 1)
    for file, old, new, key in (
        ("study.toml", "0.0305", "0.5", "success.roll.max_abs_error_rad.max was 0.0305 and is 0.5"),
        ("scenario.toml", "mass_kg = 5.525", "mass_kg = 5.0", "vehicle.mass_kg was 5.525 and is 5.0"),
    ):
        edit(folder / file, old, new)
        assert resume() == (2, "", f"hexjet: {folder}: changed since its first flight; {file}: {key}\n")
        edit(folder / file, new, old)
    with monkeypatch.context() as other:
        other.setitem(installed.installed_versions(), "jsbsim", "0.9")
        line = resume().refusal
    assert line.startswith(f"hexjet: {folder}: what is installed changed since its first flight: jsbsim was ")
    assert line.endswith(" and is 0.9\n")
    edit(folder / ASKED, "[installed]", "[other]")
    line = f"hexjet: {folder / ASKED}: has no table [installed]; it is not as it was at the first flight\n"
    assert resume() == (2, "", line)
    (folder / ASKED).unlink()
    missing = f"hexjet: {folder}: asked.toml is missing, as in folders of version 0.2.0"
    assert resume().refusal.startswith(missing)


def test_a_campaign_of_version_0_2_0_is_read_and_goes_on_there_alone(tmp_path: Path, hexjet: Hexjet) -> None:
    folder = tmp_path / "c"
    shutil.copytree(TESTS / "older" / "0.2.0-a" / "campaign", folder)
    assert len(open_campaign(folder)) > 0
    assert hexjet("show", str(folder), "--page").status == 0
    line = hexjet("sweep", str(folder), "--resume").refusal
    assert "as in folders of version 0.2.0; it can be looked at, that version goes on with it" in line


@pytest.mark.parametrize("command", [["show", "--page"], ["sweep", "--resume"], ["fly", "--flight", "0"]])
def test_a_search_of_version_0_2_0_is_refused_by_the_version(
    tmp_path: Path, hexjet: Hexjet, command: list[str]
) -> None:
    (tmp_path / "search.toml").touch()
    line = f"hexjet: {tmp_path}: is a search of version 0.2.0; its page shows it, and that version goes on with it\n"
    assert hexjet(command[0], str(tmp_path), *command[1:]) == (2, "", line)


def test_a_longer_study_is_what_is_asked_from_then_on(tmp_path: Path, hexjet: Hexjet) -> None:
    folder = str(tmp_path / "out")
    assert hexjet("sweep", *DRAWN, "--runs", "3", *HOVER, "--sampling", "random", "--out", folder).status == 0
    for runs in ("5", "7"):
        assert hexjet("sweep", folder, "--resume", "--runs", runs).status == 0
    assert len(open_campaign(folder)) == 7


def test_the_program_is_all_code_that_a_flight_s_numbers_come_from() -> None:
    names = {name for name, _ in installed._list_files()}
    code = {"cosim/engine/_bank.c", "cosim/simulation/step.py", "hexjet_laws/mpc.py", "hexjet_sitl/px4.py"}
    data = {"aircraft/hexjet/vehicle.toml", "engines/turbojet/engine.toml"}
    assert code | data <= names
