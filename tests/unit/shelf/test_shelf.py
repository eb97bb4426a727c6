"""docs/runs.md: the folder of runs as rows, and the page that lists them."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from command_tools import Hexjet
from places import TESTS
from shelves import shelf

from cosim.shelf import index
from cosim.shelf.index import CAMPAIGN, LOG, PAGE, RUN, UNFINISHED, list_entries, read_entry


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Six runs, a page, a flight that has no end yet, and a folder that is nothing of ours."""
    folder = shelf(tmp_path / "runs", 6)
    (folder / "drawn").mkdir()
    (folder / "drawn" / "drawing.html").write_text("<title>drawn</title>")
    (folder / "flying").mkdir()
    (folder / "flying" / "scenario.toml").write_text('name = "flying"\n')
    (folder / "other").mkdir()
    (folder / "other" / "note.txt").write_text("mine")
    return folder


def test_what_a_folder_holds(runs: Path) -> None:
    found = {entry.name: entry for entry in list_entries(runs)}
    kinds = {f"run-{k:05d}": RUN for k in range(6)} | {"drawn": PAGE, "flying": UNFINISHED}
    assert {name: entry.kind for name, entry in found.items()} == kinds
    third = found["run-00003"]
    assert third.details["controller"] == "smith"
    assert third.metrics == {"roll.rmse_rad": 0.003, "position.drift_m": 4.0, "own.jerk": 2.0, "duration_s": 20.0}
    assert (third.page, found["drawn"].page) == ("report.html", "drawing.html")


@pytest.mark.parametrize("content", ["[" * 100_000, '{"metrics": ', "pipe"])
def test_one_file_does_not_take_the_others_down(runs: Path, content: str) -> None:
    file = runs / "run-00003" / "summary.json"
    file.unlink()
    if content == "pipe":
        os.mkfifo(file)
    else:
        file.write_text(content)
    rows = [entry.name for entry in list_entries(runs) if entry.kind == RUN]
    assert sorted(rows) == [f"run-{k:05d}" for k in (0, 1, 2, 4, 5)]


def test_logs_of_other_controllers_lie_there_too(runs: Path) -> None:
    """By what stands in them, not by name."""
    (runs / "flight.bin").write_bytes(b"\xa3\x95\x80" + bytes(90))
    (runs / "firmware.bin").write_bytes(b"\x7fELF")
    assert {entry.name for entry in list_entries(runs) if entry.kind == LOG} == {"flight.bin"}


def test_what_a_mac_keeps_beside_a_page_is_none(tmp_path: Path) -> None:
    for name in ("._page.html", "page.html"):
        (tmp_path / name).write_text("")
    assert index.read_entry(tmp_path).page == "page.html"


def test_a_real_run_and_a_real_campaign() -> None:
    folder = next(path for path in sorted((TESTS / "older").iterdir()))
    run, campaign = index.read_entry(folder / "run"), index.read_entry(folder / "campaign")
    assert (run.kind, campaign.kind) == (RUN, CAMPAIGN)
    assert {"roll.rmse_rad", "altitude.rmse_m", "effort.saturated_percent"} <= set(run.metrics)
    assert run.details["verdict"] == "completed, nothing checked"  # recorded as planned, and nothing was expected


def test_a_campaign_has_the_name_of_the_scenario_that_lies_beside_it(tmp_path: Path) -> None:
    (tmp_path / "flights").mkdir()
    (tmp_path / "study.toml").write_text(
        'name = "mine"\nscenario = "scenario.toml"\n\n[[vary]]\nkey = "x"\ntitle = "no"\n'
    )
    facts = index.read_entry(tmp_path).details
    assert (facts["scenario"], facts.get("title")) == ("scenario.toml", None)  # it is not there
    (tmp_path / "scenario.toml").write_text('name = "roll-doublet"\ntitle = "A doublet"\n')
    facts = index.read_entry(tmp_path).details
    assert (facts["scenario"], facts["title"], "name" in facts) == ("roll-doublet", "A doublet", False)


def test_wrong_folders_and_ports(hexjet: Hexjet, tmp_path: Path) -> None:
    done = hexjet("open", "nowhere")
    assert (done.status, done.err.splitlines()) == (2, ["hexjet: nowhere: is no folder of runs"])
    done = hexjet("open", str(tmp_path), "--port", "0")
    assert (done.status, done.err.count("\n")) == (2, 1)
    assert "--port: the server of hexjet open left in version 0.3.0" in done.err
    (tmp_path / "index.html").write_text("<title>mine</title>")
    done = hexjet("open", str(tmp_path))
    assert (done.status, done.err.count("\n")) == (2, 1)
    assert "index.html: was not written by hexjet open" in done.err


def test_the_page_lists_every_entry_and_code_in_names_stays_text(
    hexjet: Hexjet, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    summary = json.loads((runs / "run-00001" / "summary.json").read_text())
    summary["title"], summary["metrics"]["roll"]["rmse_rad"] = "</script><script>alert(1)</script>", float("nan")
    (runs / "run-00001" / "summary.json").write_text(json.dumps(summary))
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    done = hexjet("open", str(runs))
    assert (done.status, opened) == (0, [(runs / "index.html").as_uri()])
    page = (runs / "index.html").read_text(encoding="utf-8")
    data = re.search(r'<script type="application/json" id="rows">(.*?)</script>', page, re.S)
    assert data
    rows = {row["name"]: row for row in json.loads(data[1])}
    assert set(rows) == {entry.name for entry in list_entries(runs)}
    assert rows["run-00001"]["details"]["title"] == summary["title"]
    assert "roll.rmse_rad" not in rows["run-00001"]["metrics"]  # it is no number
    assert rows["drawn"]["page"] == "drawn/drawing.html"
    assert hexjet("open", str(runs), "--no-browser").status == 0  # over its own page
    assert len(opened) == 1


@pytest.mark.parametrize(
    ("study", "scenario", "details"),
    [
        ('scenario = "hover"\ntitle = "of the study"\n[settings]\ntitle = "no"\n', "", ("of the study", "hover")),
        ("scenario = 'scenario.toml'\n", 'name = "mine"\ntitle = "Mine"\n[initial]\n', ("Mine", "mine")),
        (
            'scenario = "scenario.toml"\n',
            'name = "mine"\ntitle = "Mine"\nchanged = [\n  "seed = 2",\n]\n',
            (None, "mine"),
        ),
        (
            'description = """\n[not a table]\nchanged = [ "no" ]\n"""\nscenario = "scenario.toml"\n',
            'name = "mine"\ndescription = """\nchanged = [ "a word" ]\n"""\ntitle = "Mine"\n[vehicle]\n',
            ("Mine", "mine"),
        ),
        ("scenario = ", "", (None, None)),
    ],
)
def test_a_campaign_is_named_as_its_files_say(study: str, scenario: str, details: tuple, tmp_path: Path) -> None:
    (tmp_path / "flights").mkdir()
    (tmp_path / "study.toml").write_text(study)
    (tmp_path / "scenario.toml").write_text(scenario)
    row = read_entry(tmp_path)
    assert row.kind == CAMPAIGN
    assert (row.details.get("title"), row.details.get("scenario")) == details
