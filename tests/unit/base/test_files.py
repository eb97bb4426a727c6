"""Files that are written into folders which somebody else may have made."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from threading import Thread

import pytest
from patience import PATIENCE

from cosim.base.errors import InputError
from cosim.base.storage import files
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
    files.write_whole(folder / "report.html", "ours")
    assert theirs.read_text() == "theirs"
    assert (folder / "report.html").read_text() == "ours"
    assert not (folder / "report.html").is_symlink()
    assert [path.name for path in folder.iterdir()] == ["report.html"]


def test_what_stands_there_stays_where_the_new_file_fails(theirs: Path, tmp_path: Path) -> None:
    def fail() -> None:
        with files.replace_on_success(theirs) as temporary:
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
        files.open_without_links(link, os.O_WRONLY | os.O_APPEND)
    with pytest.raises(InputError, match="symbolic links"):
        RequestLog(link)
    assert theirs.read_text() == "theirs"


def test_a_pipe_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    """A device likewise: as root a file would take its place, for every program of the machine."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    files.write_whole(pipe, "through it")
    reader.join(PATIENCE)
    assert read == ["through it"]
    assert pipe.is_fifo()


def test_a_link_to_a_device_is_refused_and_stays(tmp_path: Path) -> None:
    link = tmp_path / "report.html"
    link.symlink_to(os.devnull)
    with pytest.raises(InputError, match=r"report\.html: is a link to a device or a pipe; name an ordinary file$"):
        files.write_whole(link, "ours", InputError)
    assert link.is_symlink()


def _readers() -> dict[str, Callable[[Path], object]]:
    """What reads a file that a scenario, a command line or a folder names."""
    from cosim.base.plugins.execute import execute_file
    from cosim.base.storage.toml import read_toml
    from cosim.groundstation.mavlink.wire.signing import read_key
    from cosim.results.autopilot.request_log import read_requests
    from cosim.simulation.controllers.recorded import read_commands
    from cosim.simulation.script.command_script import read_columns
    from cosim.spec.scenario.parameter_file import read_whole
    from cosim.vehicle.model_file import read_model as read_airframe
    from hexjet_identify.logs import read_flight_log
    from hexjet_identify.prediction_error.validate import read_model
    from hexjet_sitl.parameters import read_parameters

    return {
        "mapping": read_toml,
        "python": lambda path: execute_file(path, "controller"),
        "wind": lambda path: read_columns(path, ("north_m_s",), "wind"),
        "commands": lambda path: read_commands(path, "controller"),
        "requests": read_requests,
        "parameter file": lambda path: read_whole(path, "parameters"),
        "autopilot's parameters": read_parameters,
        "key": read_key,
        "model": read_model,
        "airframe": read_airframe,
        "log": read_flight_log,
        "json": files.read_json,
    }


@pytest.mark.parametrize("name", _readers())
@pytest.mark.parametrize("what", ["pipe", "device", "huge", "missing"])
def test_what_is_no_ordinary_file_is_refused_at_once(tmp_path: Path, name: str, what: str) -> None:
    path = tmp_path / "file"
    if what == "pipe":
        os.mkfifo(path)
    elif what == "device":
        path.symlink_to("/dev/zero")
    elif what == "huge":
        with path.open("wb") as file:
            file.truncate(20 * 2**30)
    with pytest.raises(InputError) as refused:
        _readers()[name](path)
    said = {"pipe": "a device or a pipe", "device": "a device or a pipe", "huge": "20480 MB", "missing": ""}[what]
    assert said in str(refused.value)
    assert str(path) in str(refused.value)
    # Whoever reads the sources of the modules that are loaded would wait for such a pipe for ever.
    assert not [module for module in sys.modules.values() if getattr(module, "__file__", None) == str(path)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"[" * 100_000, "nested too deep"),
        (b'{"a": NaN}', "NaN is no number of JSON"),
        (b"[-Infinity]", "-Infinity is no number of JSON"),
        (b"[1e999]", "1e999 is no number of JSON"),
        (b'{"a": 1', "not JSON"),
        (b"\xff\xfe", "not JSON"),
    ],
)
def test_json_is_finite_and_not_deep(tmp_path: Path, text: bytes, said: str) -> None:
    path = tmp_path / "summary.json"
    path.write_bytes(text)
    with pytest.raises(InputError, match=said) as refused:
        files.read_json(path)
    assert str(refused.value).startswith(f"{path}: ")


def test_json_of_rows_may_have_what_is_missing(tmp_path: Path) -> None:
    assert files.parse_json('{"a": [1.5, null]}', "row", finite=False) == {"a": [1.5, None]}
    assert files.parse_json("[NaN]", "row", finite=False)[0] != 0.0
    assert files.read_file(Path(__file__), first=3) == b'"""'
