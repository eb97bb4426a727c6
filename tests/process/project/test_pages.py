"""Every command and snippet of README.md and docs/, in the order of its page, by a reader who has flown nothing.

`pages.toml` says what each must come to.  A page runs in a folder of its own, which holds the files of `files`.
"""

from __future__ import annotations

import html
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from command_tools import Hexjet
from foreign_engines import IGNITION, force, foreign, lever
from known_benches import Truth, bench_log
from places import DESIGNS, DOCS, ROOT, TESTS, of_page

from cosim.base import trust
from cosim.cli import table

LONG = "minutes"
SHORTER = {
    "DESIGN": f"--start {DESIGNS}/turbojet.toml --no-proof",
    "FEW": "--runs 2 --workers 1",
    "PLAIN": f"--no-proof --no-lead --start {DESIGNS}/turbojet.toml",
    "QUICK": "--periods 3",
    "SEARCH": "--tolerance 30 --workers 1 --set duration_s=2.0",
    "TRY": "--claim 50%@50% --budget 5 --search 0 --no-limit --workers 1",
    "TWENTY": "--runs 4 --workers 1",
}
COMMAND = re.compile(
    r"(?:\$ )?(?:\.venv/bin/)?((?:hexjet (?!goes)|make |python |pip |sed |cd |patch |dask |sudo |mavproxy\.py |fgfs ).*)"
)
BLOCK = re.compile(r"(?:<!-- ([^>\n]*) -->\n)?^```(\w*)\n(.*?)^```|((?:^ {4}\S[^\n]*\n)+)", re.MULTILINE | re.DOTALL)


class Row(NamedTuple):
    """A row of pages.toml, which says what each field is."""

    words: str = ""
    says: str = ""
    status: int = 0
    more: str = ""
    file: str = ""
    then: str = ""
    change: Sequence[str] = ("", "")
    why: str = ""
    first: str = ""


TABLE = tomllib.loads(Path(__file__).with_name("pages.toml").read_text(encoding="utf-8"))
PAGES = {page: [Row(**row) for row in rows] for page, rows in TABLE.items()}


class Item(NamedTuple):
    kind: str
    mark: str
    text: str


def find_items(page: str) -> Iterator[Item]:
    path = ROOT / "README.md" if page == "README" else DOCS / f"{page}.md"
    for mark, kind, fenced, indented in BLOCK.findall(path.read_text(encoding="utf-8")):
        if kind in ("python", "toml", "c", "xml"):
            yield Item(kind, mark, fenced)
        elif kind in ("", "sh"):
            for line in re.sub(r" *\\\n *", " ", fenced or indented).splitlines():
                if found := COMMAND.match(line.strip()):
                    yield Item("command", mark, re.split(r" {3,}(?!-)| +# | > ", found[1])[0])


def call_shell(line: str) -> tuple[int, str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "ROOT": str(ROOT), "DESIGNS": str(DESIGNS)}
    done = subprocess.run(line, shell=True, env=environment, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def call(line: str, hexjet: Hexjet) -> tuple[int, str]:
    if not line.startswith("hexjet ") or " && " in line:
        return call_shell(line)
    done = hexjet(*shlex.split(line)[1:])
    return done.status, done.out + done.err


def use_snippet(item: Item, row: Row, hexjet: Hexjet, names: dict[str, object]) -> tuple[int, str]:
    if file := row.file or (item.mark.removeprefix("file: ") if item.mark.startswith("file: ") else ""):
        with Path(file).open("a", encoding="utf-8") as target:
            target.write(item.text)
        return call(row.then, hexjet) if row.then else (0, "")
    assert row.change[0] in item.text
    exec(item.text.replace(*row.change), names)
    return 0, ""


def read_command(line: str) -> None:
    """Let the command line read a command with its options, and not run it."""
    for part in line.split(" && "):
        if part.startswith("hexjet "):
            name, words = table.find(shlex.split(part)[1:])
            table.load(name).read(words)


def run_page(page: str, hexjet: Hexjet, long: bool) -> None:
    """Run what can be run, and compare it with its row; say what every one printed that differs."""
    rows = [row for row in PAGES[page] if not row.first]
    names: dict[str, object] = {}
    for row in PAGES[page]:
        if row.first:
            call(row.first, hexjet)
    wrong = []
    for item, row in zip(find_items(page), rows, strict=True):
        assert row.words in item.text, f"{page}: {item.text!r} is not the row of {row.words!r}"
        if row.why and not (long and row.why == LONG):
            read_command(item.text if item.kind == "command" else "")
            continue
        if item.kind == "command":
            status, said = call(" ".join([item.text, *(SHORTER.get(word, word) for word in row.more.split())]), hexjet)
        else:
            status, said = use_snippet(item, row, hexjet, names)
        said = " ".join(said.split())
        if status != row.status or not re.search(row.says, said):
            wrong.append(f"{item.text} {row.more}\nstatus {status}: {said[-2000:]}")
    assert not wrong, "\n".join(wrong)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a reader has: FMUs, a bench log, a design, and the files that the page on controllers shows."""
    folder = tmp_path_factory.mktemp("files")
    for name in ("mine", "my", "their"):
        foreign(
            folder,
            name,
            "lag=0.15,delay=0.04",
            [lever(), force(), IGNITION, ("gain", "gain", "parameter", 'start="1"')],
        )
    truth = Truth(delay=0.06, lags=(0.05,), gain=20.0, offset=1.0)
    times, command, thrust, _ = bench_log("chirp", 100.0, truth, noise=0.1)
    rows = np.column_stack([times, 1000.0 * times, command, thrust])
    np.savetxt(folder / "bench.csv", rows, "%.9g", ",", header="time_s,t_ms,throttle,thrust_N", comments="")
    shutil.copy(DESIGNS / "turbojet.toml", folder)
    pieces = [of_page(name, folder / f"{name}.py").read_text(encoding="utf-8") for name in ("predictor", "blocks")]
    (folder / "mine.py").write_text("".join(pieces), encoding="utf-8")
    (folder / "gusts.csv").write_text("time_s,north_m_s,east_m_s,down_m_s\n0,0,0,0\n2,3,1,0\n", encoding="utf-8")
    return folder


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, hexjet: Hexjet, files: Path) -> Hexjet:
    """The command of a reader, who has set no variable and has trusted nothing."""
    for name in (trust.ENV_VAR, "PX4_SITL", "ARDUPILOT_SITL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    return hexjet


@pytest.mark.parametrize("long", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs_as_it_is_written(page: str, long: bool, reader: Hexjet) -> None:
    run_page(page, reader, long)


def test_every_page_and_every_test_that_the_table_names_is_there() -> None:
    assert {"README", *(path.stem for path in DOCS.glob("*.md") if any(find_items(path.stem)))} - set(PAGES) == set()
    named = {row.why for rows in PAGES.values() for row in rows if row.why.startswith("test_")}
    assert [name for name in sorted(named) if not list(TESTS.rglob(name))] == []


@pytest.mark.long
def test_from_a_bench_log_to_a_proven_design_in_one_line(
    tmp_path: Path, reader: Hexjet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twice the same engine, logged well and badly: another log is another verdict, and no number is typed."""
    *_, (_, _, line) = find_items("tutorial")
    truth = Truth(delay=0.06, lags=(0.05,), gain=20.0, offset=1.0)
    kept = {}
    for name, rate, noise in (("well", 100.0, 0.1), ("badly", 12.5, 0.4)):
        folder = tmp_path / name
        folder.mkdir()
        monkeypatch.chdir(folder)
        times, command, thrust, _ = bench_log("stairs of 2 s", rate, truth, noise=noise, seconds=40.0)
        rows = np.column_stack([times, command, thrust])
        np.savetxt(folder / "bench.csv", rows, "%.9g", ",", header="time_s,throttle,thrust_N", comments="")
        status, printed = call_shell(line)
        said = " ".join(printed.split())
        assert status == 0, said
        assert "22 of 22 flights kept what was promised" in said
        page = html.unescape((folder / "my-design.html").read_text(encoding="utf-8"))
        assert "engine's uncertainty, 3 standard deviations of its parameters: " in page
        assert "; source: bench.csv: 39.9" in page
        (share,) = re.findall(r"my-design: (\S+) % of 10 ", said)
        kept[name] = float(share)
    assert kept["well"] == 100.0
    assert kept["badly"] < 50.0
