"""Files that are written into folders which somebody else may have made."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Thread

import pytest
from patience import PATIENCE

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import open_without_links, replace_on_success, write_whole
from cosim.campaign.search.probe import Journal
from cosim.results.autopilot.request_log import RequestLog


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    """A file elsewhere, to which links lead."""
    path = tmp_path / "elsewhere"
    path.write_text("theirs")
    return path


def test_a_temporary_file_is_never_one_that_a_link_leads_to(theirs: Path, tmp_path: Path) -> None:
    """Its name can be guessed: a folder may hold links by the names that all processes would take."""
    folder = tmp_path / "folder"
    folder.mkdir()
    for name in ("report.html", f".report.html.{os.getpid()}.tmp"):
        (folder / name).symlink_to(theirs)
    write_whole(folder / "report.html", "ours")
    assert theirs.read_text() == "theirs"
    assert (folder / "report.html").read_text() == "ours"
    assert not (folder / "report.html").is_symlink()
    assert [path.name for path in folder.iterdir()] == ["report.html"]


def test_what_stands_there_stays_where_the_new_file_fails(theirs: Path, tmp_path: Path) -> None:
    def fail() -> None:
        with replace_on_success(theirs) as temporary:
            temporary.write_text("half")
            raise OSError("no more")

    with pytest.raises(OSError, match="no more"):
        fail()
    assert theirs.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [theirs]


def test_journals_are_not_written_through_a_link(theirs: Path, tmp_path: Path) -> None:
    link = tmp_path / "journal.jsonl"
    link.symlink_to(theirs)
    with pytest.raises(OSError, match="symbolic links"):
        open_without_links(link, os.O_WRONLY | os.O_APPEND)
    with pytest.raises(InputError, match="symbolic links"):
        RequestLog(link)
    with pytest.raises(FlightError, match="symbolic links"):
        Journal(link).read()
    assert theirs.read_text() == "theirs"


def test_a_pipe_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    """A device likewise: as root a file would take its place, for every program of the machine."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    write_whole(pipe, "through it")
    reader.join(PATIENCE)
    assert read == ["through it"]
    assert pipe.is_fifo()


def test_a_link_to_a_device_is_refused_and_stays(tmp_path: Path) -> None:
    link = tmp_path / "report.html"
    link.symlink_to(os.devnull)
    with pytest.raises(InputError, match=r"report\.html: is a link to a device or a pipe; name an ordinary file$"):
        write_whole(link, "ours", InputError)
    assert link.is_symlink()
