"""docs/runs.md: the folder of runs as rows, and the server that shows it: what is read, kept, deleted, and who may ask for it."""

from __future__ import annotations

import http.client
import json
import re
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from command_tools import Hexjet
from patience import PATIENCE
from places import TESTS
from shelves import shelf
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from cosim.base.errors import InputError
from cosim.groundstation.web.loopback import WRONG_TOKEN
from cosim.shelf import index
from cosim.shelf.index import CAMPAIGN, INDEX, LOG, PAGE, RUN, UNFINISHED, Shelf, read_entry
from cosim.shelf.server import ALLOWED, ShelfServer


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


# --- rows -------------------------------------------------------------------------------------------------------------


def test_what_a_folder_holds(runs: Path) -> None:
    found = {entry.name: entry for entry in Shelf(runs).entries()}
    assert {name: entry.kind for name, entry in found.items()} == {
        **{f"run-{k:05d}": RUN for k in range(6)},
        "drawn": PAGE,
        "flying": UNFINISHED,
    }
    third = found["run-00003"]
    assert third.details["controller"] == "smith"
    assert third.metrics == {"roll.rmse_rad": 0.003, "position.drift_m": 4.0, "own.jerk": 2.0, "duration_s": 20.0}
    assert (third.page, found["drawn"].page) == ("report.html", "drawing.html")


def test_logs_of_other_controllers_lie_there_too(runs: Path) -> None:
    """By what stands in them, not by name; they have no tags, and are deleted alone."""
    (runs / "flight.bin").write_bytes(b"\xa3\x95\x80" + bytes(90))
    (runs / "firmware.bin").write_bytes(b"\x7fELF")
    place = Shelf(runs)
    assert {entry.name for entry in place.entries() if entry.kind == LOG} == {"flight.bin"}
    with pytest.raises(InputError, match="tags are kept in folders"):
        place.tag(["flight.bin"], ["mine"])
    place.delete("flight.bin")
    assert not (runs / "flight.bin").exists()
    assert len(place.entries()) == 8


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


def test_what_has_not_changed_is_not_read_again(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = Shelf(runs).entries()
    read: list[str] = []
    real = index.read_entry
    monkeypatch.setattr(index, "read_entry", lambda folder: read.append(folder.name) or real(folder))
    assert Shelf(runs).entries() == before
    assert read == ["other"]  # what is nothing of ours is not kept
    changed = json.loads((runs / "run-00002" / "summary.json").read_text())
    (runs / "run-00002" / "summary.json").unlink()
    (runs / "run-00002" / "summary.json").write_text(json.dumps(changed | {"controller": "state"}))
    later = {entry.name: entry for entry in Shelf(runs).entries()}
    assert later["run-00002"].details["controller"] == "state"
    assert sorted(read) == ["other", "other", "run-00002"]


@pytest.mark.parametrize("kept", ["", "{", "[]", '{"form": 0}', '{"form": 1, "rows": [[1]]}'])
def test_a_damaged_index_is_made_anew(runs: Path, kept: str) -> None:
    before = Shelf(runs).entries()
    (runs / INDEX).write_text(kept)
    assert Shelf(runs).entries() == before


def test_tags_stay_with_the_run(runs: Path) -> None:
    place = Shelf(runs)
    place.entries()
    place.tag(["run-00001", "run-00002"], add=["good", "x1"])
    place.tag(["run-00002"], remove=["good"])
    tags = {entry.name: entry.tags for entry in Shelf(runs).entries() if entry.tags}
    assert tags == {"run-00001": ["good", "x1"], "run-00002": ["x1"]}
    with pytest.raises(InputError, match="'a b' is no tag"):
        place.tag(["run-00001"], add=["a b"])


def test_only_what_is_here_and_has_an_end_is_deleted(runs: Path, tmp_path: Path) -> None:
    outside = shelf(tmp_path / "outside", 1) / "run-00000"
    (runs / "linked").symlink_to(outside)
    place = Shelf(runs)
    place.entries()
    place.delete("run-00004")
    assert not (runs / "run-00004").exists()
    assert not list(runs.glob(".deleted*"))
    for name in ("other", "linked", "..", "../outside", "run-00004", ""):
        with pytest.raises(InputError, match="is not here"):
            place.delete(name)
    with pytest.raises(InputError, match="has no end yet"):
        place.delete("flying")
    assert outside.exists()
    assert (runs / "other" / "note.txt").exists()


def test_wrong_folders_and_ports(hexjet: Hexjet, tmp_path: Path) -> None:
    done = hexjet("open", "nowhere")
    assert (done.status, done.err.splitlines()) == (2, ["hexjet: nowhere: is no folder of runs; nothing is there"])
    assert hexjet("open", str(tmp_path), "--port", "70000").status == 2


# --- the server -------------------------------------------------------------------------------------------------------


@pytest.fixture
def server(runs: Path) -> Iterator[ShelfServer]:
    def compare(folders: Sequence[Path]) -> Path:
        if len(folders) < 2:
            raise InputError("compare: 1 chosen")
        page = runs / "comparison-001" / "comparison.html"
        page.parent.mkdir()
        page.write_text(" ".join(folder.name for folder in folders))
        return page

    found = ShelfServer(Shelf(runs), 0, compare)
    found.open()
    thread = threading.Thread(target=found.run, daemon=True)
    thread.start()
    yield found
    found.close()
    thread.join()


def get(server: ShelfServer, path: str, **headers: str) -> http.client.HTTPResponse:
    line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
    line.request("GET", path, headers=headers)
    answer = line.getresponse()
    answer.text = answer.read().decode()  # type: ignore[attr-defined]
    line.close()
    return answer


def token(server: ShelfServer) -> str:
    """Of the printed address."""
    return server.url.partition("?token=")[2]


def home(server: ShelfServer) -> http.client.HTTPResponse:
    """The page, by the printed address."""
    return get(server, f"/?token={token(server)}")


def below(server: ShelfServer, path: str = "") -> str:
    """A path of the runs' files, as the page has it."""
    return str(re.search(r'const address = row => "([^"]+)', home(server).text)[1]) + path  # type: ignore[attr-defined, index]


def asked(server: ShelfServer, *questions: dict[str, Any]) -> list[dict[str, Any]]:
    """What the page would be told: rows first, then of each question an answer and rows."""
    with connect(f"ws://127.0.0.1:{server.port}/live", origin=f"http://127.0.0.1:{server.port}") as line:  # type: ignore[arg-type]
        line.send(json.dumps({"token": token(server)}))
        told = [json.loads(line.recv(60))]
        for question in questions:
            line.send(json.dumps(question))
            told += [json.loads(line.recv(60)), json.loads(line.recv(60))]
    return told


def test_the_page_asks_nobody_else(server: ShelfServer) -> None:
    answer = home(server)
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert "@" not in policy
    page = answer.text  # type: ignore[attr-defined]
    assert "@TOKEN@" not in page
    assert "@NONCE@" not in page
    assert "http://" not in page
    assert "https://" not in page


def test_a_runs_page_is_shown_without_an_origin(server: ShelfServer) -> None:
    """In a frame, whose policy keeps it there, and with one of its own by which it loads nothing from elsewhere."""
    place = below(server, "run-00001/report.html")
    around, itself = get(server, place), get(server, f"{place}?page")
    hosts = f"http://127.0.0.1:{server.port}", f"http://localhost:{server.port}"
    only = " ".join(f"{host}{below(server)}" for host in hosts)
    rules = [
        dict(rule.split(maxsplit=1) for rule in answer.headers["Content-Security-Policy"].split("; "))
        for answer in (around, itself)
    ]
    assert (around.status, itself.status) == (200, 200)
    assert rules[0]["default-src"] == rules[1]["default-src"] == "'none'"
    assert rules[0]["frame-src"] == rules[1]["frame-src"] == only
    assert rules[1]["sandbox"] == ALLOWED == "allow-scripts allow-downloads"
    assert f'sandbox="{ALLOWED}"' in around.text  # type: ignore[attr-defined]
    assert "connect-src" not in rules[1]
    assert rules[1]["frame-ancestors"] == " ".join(hosts)
    assert get(server, f"{place}?page", **{"Sec-Fetch-Dest": "document"}).text == around.text  # type: ignore[attr-defined]
    assert get(server, place, **{"Sec-Fetch-Dest": "iframe"}).text == itself.text  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/?token=",
        "/?token=guessed",
        "/run/run-00001/report.html",
        "/run/guessed/run-00001/report.html",
        "/nothing",
        "/run/",
    ],
)
def test_without_the_printed_address_there_is_nothing(server: ShelfServer, path: str) -> None:
    """Another account of the machine reaches the port as well as this one."""
    answer = get(server, path)
    assert answer.status == 403
    assert (
        answer.text
        == "Open the address that hexjet has printed, with its token: this page is for those who were told it.\n"
    )  # type: ignore[attr-defined]


def test_a_runs_page_does_not_have_what_commands(server: ShelfServer) -> None:
    """It sees the key in its own address, which opens neither the page nor the socket."""
    key = below(server).split("/")[2]
    assert key != token(server)
    assert get(server, f"/?token={key}").status == 403
    assert key not in server.url


@pytest.mark.parametrize(
    "path",
    ["../secret.html", "%2e%2e/secret.html", "/etc/passwd", "run-00001/", "other/note.txt",
     ".index.json", "linked/summary.json", "run-00001/%00.html", "nothing"],
)  # fmt: skip
def test_no_other_file_is_given_out(server: ShelfServer, runs: Path, path: str) -> None:
    (runs.parent / "secret.html").write_text("secret")
    (runs.parent / "away").mkdir()
    (runs.parent / "away" / "summary.json").write_text("secret")
    (runs / "linked").symlink_to(runs.parent / "away")
    assert get(server, below(server, path)).status == 404


def test_another_name_of_this_machine_gets_nothing(server: ShelfServer) -> None:
    assert get(server, "/", Host="evil.example").status == 421


def test_another_page_can_ask_for_nothing(server: ShelfServer, runs: Path) -> None:
    with pytest.raises(InvalidStatus), connect(f"ws://127.0.0.1:{server.port}/live", origin="http://evil.example"):  # type: ignore[arg-type]
        pass
    ours = f"http://127.0.0.1:{server.port}"
    with connect(f"ws://127.0.0.1:{server.port}/live", origin=ours) as line:  # type: ignore[arg-type]
        line.send(json.dumps({"token": "guessed", "do": "delete", "names": ["run-00001"]}))
        with pytest.raises(ConnectionClosed) as end:
            line.recv(60)
    assert end.value.rcvd is not None
    assert end.value.rcvd.code == WRONG_TOKEN
    assert (runs / "run-00001").exists()


def test_what_the_page_asks_for_is_done(server: ShelfServer, runs: Path) -> None:
    first, deleted, rows, tagged, _, compared, _, wrong, last = asked(
        server,
        {"do": "delete", "names": ["run-00000", "run-00001"]},
        {"do": "tag", "names": ["run-00002"], "add": ["kept"]},
        {"do": "compare", "names": ["run-00002", "run-00003"]},
        {"do": "delete", "names": ["../outside"]},
    )
    assert "roll.rmse_rad" in first["metrics"]
    assert len(first["rows"]) - len(rows["rows"]) == 2
    assert deleted == {"said": "2 deleted"}
    assert tagged == {"said": "1 tagged"}
    assert compared["open"] == below(server, "comparison-001/comparison.html")
    assert wrong == {"said": "../outside: is not here", "failed": True}
    assert {row[0]: row[3] for row in last["rows"]}["run-00002"] == ["kept"]
    assert get(server, compared["open"] + "?page").text == "run-00002 run-00003"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "question", [{}, {"do": "burn"}, {"do": "delete"}, {"do": "delete", "names": [1, None]}, {"names": 3}]
)
def test_what_makes_no_sense_does_nothing(server: ShelfServer, question: dict[str, Any]) -> None:
    first, answer, rows = asked(server, question)
    assert not answer.get("failed")
    assert rows == first


def test_the_browser_is_told_the_way_by_a_file_that_nobody_else_may_read(
    hexjet: Hexjet, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What stands on its command line every account of the machine can read."""
    told: list[str] = []
    serve = ShelfServer.run

    def serve_shortly(self: ShelfServer) -> None:
        thread = threading.Thread(target=serve, args=(self,))
        thread.start()
        self.close()
        thread.join()

    monkeypatch.setattr("webbrowser.open", told.append)
    monkeypatch.setattr(ShelfServer, "run", serve_shortly)
    done = hexjet("open", str(runs), "--browser", "--port", "0")
    printed = re.search(r"http://127.0.0.1:\d+/\?token=(\S+)", done.err)
    assert printed
    (address,) = told
    assert address.startswith("file:///")
    assert printed[1] not in address
    page = Path(address.removeprefix("file://"))
    assert f"url={printed[0]}" in page.read_text()
    assert page.parent.stat().st_mode & 0o077 == 0


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
def test_a_campaign_is_named_as_its_files_say(
    study: str, scenario: str, details: tuple[str | None, str | None], tmp_path: Path
) -> None:
    (tmp_path / "flights").mkdir()
    (tmp_path / "study.toml").write_text(study)
    (tmp_path / "scenario.toml").write_text(scenario)
    row = read_entry(tmp_path)
    assert row.kind == CAMPAIGN
    assert (row.details.get("title"), row.details.get("scenario")) == details
