"""A campaign on disk: whole at every moment, taken up after any end, and never written over."""

from __future__ import annotations

import errno
import json
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import campaign_tools as tools
import psutil
import pyarrow.dataset as ds
import pytest
from campaign_tools import NOTES, without_chance
from long_cases import long_after
from patience import FLIGHT_PATIENCE, PATIENCE
from places import TOOLS

from cosim.base.errors import FlightError, InputError
from cosim.campaign import folder as folder_module
from cosim.campaign import store as store_module
from cosim.campaign.folder import FLIGHTS, JOURNAL, SCENARIO, STUDY
from cosim.campaign.run import run_campaign
from cosim.campaign.store import Store, open_campaign
from cosim.campaign.study.plan import flights
from cosim.campaign.workers.flight_row import Row, failed_row, fly_one
from cosim.results.log.arrow import read_table

MASS, WIND = "vehicle.mass_kg=5.4:5.8", "environment.wind_ned_m_s.1=normal(0,1)"  # as campaign_tools has them


def made_up(store: Store, number: int) -> Row:
    """A row of a flight that nobody flew."""
    flight = store.flights[number]
    return failed_row(store.study, flight, f"as if {number}") | {"wall_s": 0.1 * number, "key": store.key(flight)}


def fill(store: Store, numbers: Any) -> None:
    for number in numbers:
        store.add(made_up(store, number))


def held(folder: Path) -> list[Any]:
    """The flights in the data set as anyone reads it."""
    table = ds.dataset(folder / FLIGHTS, format="parquet").to_table(columns=["flight"])
    return table.column("flight").to_pylist()


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_module, "PART_SIZE", 4)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "c"


def abandon(folder: Path, numbers: Any) -> Store:
    """A campaign with these rows, as the end of a process leaves it: closed files, and nothing else done."""
    store = Store.create(folder, tools.study())
    fill(store, numbers)
    store._journal.close()
    return store


def test_rows_are_in_the_journal_until_they_are_in_a_part(folder: Path, small_parts: None) -> None:
    parts = [folder / FLIGHTS / f"part-0000{n}.parquet" for n in range(2)]
    with Store.create(folder, tools.study()) as store:
        fill(store, [7, 3, 5])
        assert not list((folder / FLIGHTS).iterdir())
        assert [json.loads(line)["flight"] for line in (folder / JOURNAL).read_text().splitlines()] == [7, 3, 5]
        assert open_campaign(folder).columns["flight"] == [3, 5, 7]
        fill(store, [0])
        assert held(folder) == [7, 3, 5, 0]
        assert (folder / JOURNAL).read_bytes() == b""
        fill(store, [11, 2])
        store.flush()
        first = parts[0].read_bytes()
        assert held(folder) == [7, 3, 5, 0, 11, 2]
        fill(store, [1])
    assert held(folder) == [7, 3, 5, 0, 11, 2, 1]
    assert parts[0].read_bytes() == first  # full, and left alone
    assert sorted((folder / FLIGHTS).iterdir()) == parts


def test_every_value_survives_the_journal_and_a_part(folder: Path) -> None:
    study = tools.study(1)
    flight = flights(study)[0]
    row = fly_one(study, flight)
    assert None in row.values()
    with Store.create(folder, study) as store:
        store.add(row)
        journaled = open_campaign(folder).row(0)
        store.flush()
        assert journaled == open_campaign(folder).row(0) == row | {"key": store.key(flight)}


def test_columns_have_their_kind_though_a_part_has_none_of_it(folder: Path) -> None:
    """Metrics of flights that never flew are floats all the same: parts fit each other."""
    with Store.create(folder, tools.study()) as store:
        fill(store, [0])
    kinds = {str(field.name): str(field.type) for field in ds.dataset(folder / FLIGHTS).to_table().schema}
    expected = {"roll.rmse_rad": "double", "steps": "int64", "log_sha256": "string", "success": "bool"}
    assert expected.items() <= kinds.items()


@pytest.mark.parametrize("torn", [0, 1, 40])
def test_a_killed_campaign_is_taken_up(folder: Path, small_parts: None, torn: int) -> None:
    """With the last line of the journal whole, or a part of it."""
    abandon(folder, [0, 1, 2, 3, 4, 8])
    journal = (folder / JOURNAL).read_bytes()
    (folder / JOURNAL).write_bytes(journal[: len(journal) - torn])
    (folder / FLIGHTS / ".part-00001.parquet.77.tmp").write_bytes(b"half")
    finished = [0, 1, 2, 3, 4] + [8] * (torn == 0)
    assert open_campaign(folder).columns["flight"] == finished
    with Store.resume(folder, tools.study()) as again:
        assert [flight.number for flight in again.flights if again.key(flight) in again.done] == finished
        assert (len(again.done), again.tally.flights["smith"]) == (len(finished), sum(n % 2 == 0 for n in finished))
        fill(again, range(12))  # what is finished is left aside
    assert sorted(held(folder)) == list(range(12))
    assert sorted(path.name for path in (folder / FLIGHTS).iterdir()) == [f"part-{n:05d}.parquet" for n in range(3)]


@pytest.mark.parametrize("count", [3, 4, 6])
def test_a_kill_between_part_and_journal_doubles_nothing(folder: Path, small_parts: None, count: int) -> None:
    """The part is in place and the journal not yet emptied: the rows are in both."""
    with Store.create(folder, tools.study()) as store:
        fill(store, range(count))
        journal = "".join(json.dumps(made_up(store, number)) + "\n" for number in range(count))
    (folder / JOURNAL).write_text(journal)
    assert open_campaign(folder).columns["flight"] == list(range(count))
    Store.resume(folder).close()
    assert sorted(held(folder)) == list(range(count))


def test_a_campaign_that_was_killed_before_it_had_a_study_begins_anew(folder: Path) -> None:
    Store.create(folder, tools.study()).close()
    (folder / STUDY).unlink()
    (folder / FLIGHTS).rmdir()
    with pytest.raises(InputError, match="no campaign here"):
        Store.resume(folder)
    with Store.resume(folder, tools.study()) as store:
        assert len(store.done) == 0
    assert (folder / STUDY).is_file()


def test_the_study_is_written_last(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that has it can be looked at, whenever its process was killed."""
    beside, write = [], folder_module.write_whole

    def noted(path: Path, content: bytes) -> None:
        if path.name == STUDY:
            beside.extend(each.name for each in folder.iterdir())
        write(path, content)

    monkeypatch.setattr(folder_module, "write_whole", noted)
    Store.create(folder, tools.study()).close()
    assert {*beside, STUDY} == {path.name for path in folder.iterdir()}


def test_two_processes_do_not_fly_into_one_folder(folder: Path) -> None:
    with Store.create(folder, tools.study()):
        with pytest.raises(InputError, match=r"c: in use by another process"):
            Store.resume(folder, tools.study())
        assert len(open_campaign(folder)) == 0  # looking is allowed
    Store.resume(folder, tools.study()).close()


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize(
    ("options", "difference"),
    [
        ({"seed": 5}, "study.toml: seed is 1 there and 5 here"),
        ({"runs": 7}, "study.toml: runs is 6 there and 7 here"),
        (
            {"vary": ["vehicle.mass_kg=5.4:5.9", WIND]},
            "study.toml: vary.vehicle.mass_kg.range.1 is 5.8 there and 5.9 here",
        ),
        ({"vary": [MASS]}, "study.toml: vary.environment.wind_ned_m_s.1 is {.* there and not stated here"),
        ({"controllers": ["smith"]}, r"study.toml: controllers is \['smith', 'baseline'\] there and \['smith'\] here"),
        ({"duration": 0.4}, "scenario.toml: duration_s is 0.2 there and 0.4 here"),
        ({"fixed": ["vehicle.mass_kg=5.5"]}, "scenario.toml: vehicle.mass_kg is 5.525 there and 5.5 here"),
    ],
)
def test_the_folder_of_another_study_is_refused(folder: Path, options: dict[str, Any], difference: str) -> None:
    with Store.create(folder, tools.study()) as store:
        fill(store, [0, 5])
    before = contents(folder)
    with pytest.raises(InputError, match=f"c: holds another study; {difference}"):
        run_campaign(tools.study(**options), folder, 1, resume=True)
    with pytest.raises(InputError, match=r"c: already holds a campaign \(study.toml\); resume goes on with it"):
        run_campaign(tools.study(**options), folder, 1)
    assert contents(folder) == before


def test_a_folder_that_does_not_say_what_was_changed_goes_on(folder: Path) -> None:
    """What a scenario says of where its values are from is new: folders of before have the same values without it."""
    Store.create(folder, tools.study()).close()
    text = (folder / "scenario.toml").read_text(encoding="utf-8")
    before, told = re.subn(r"(?ms)^changed = \[.*?\]\n", "", text)
    assert told == 1
    (folder / "scenario.toml").write_text(before, encoding="utf-8")
    Store.resume(folder, tools.study()).close()


@pytest.mark.parametrize(
    "other", [[1], {}, {"flight": 0}, {"flight": "0", "controller": 0, "success": 0, "outcome": 0}, -1, 12]
)
def test_what_is_no_flight_of_the_study_is_left_where_it_is(folder: Path, other: Any) -> None:
    """In the journal: what is no row, and the row of a flight whose number the study has not."""
    store = abandon(folder, [1])
    line = made_up(store, 1) | {"flight": other} if isinstance(other, int) else other
    with open(folder / JOURNAL, "a") as journal:
        journal.write(json.dumps(line) + "\n")
    before = contents(folder)
    for look in (open_campaign, Store.resume):
        with pytest.raises(InputError, match=r"flights.jsonl: line 2 is no flight of this study"):
            look(folder)
    assert contents(folder) == before


@pytest.mark.parametrize("name", [STUDY, SCENARIO, JOURNAL, FLIGHTS, "report.html", "cases"])
def test_whatever_is_there_is_not_written_over(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match=f"already holds {name}; choose another folder"):
        Store.create(tmp_path, tools.study())
    assert contents(tmp_path) == {str(tmp_path / name): b"mine"}


def test_a_folder_that_cannot_be_written_to(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="file/c: Not a directory"):
        Store.create(tmp_path / "file" / "c", tools.study())


def test_a_scenario_that_cannot_fly_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="hover at throttle"):
        Store.create(tmp_path / "c", tools.study(fixed=["vehicle.mass_kg=50"], vary=["environment.ground_m=0:10"]))
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize("place", long_after(1, ["journal", "part"]))
def test_a_full_disk_is_told_and_loses_nothing(folder: Path, place: str) -> None:
    """In a process of its own no file may grow past a limit, as on a disk that fills."""
    # a row is 2 kB in the journal, and the head of a part is 15 kB
    limit, write_s, name, likely = {
        "journal": (15_000, 3600.0, JOURNAL, range(5, 11)),
        "part": (10_000, 0.0, f"{FLIGHTS}/part-00000.parquet", range(1, 2)),
    }[place]
    code = FULL.format(tests=str(TOOLS), folder=str(folder), limit=limit, write_s=write_s)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before = {row["flight"]: row for row in rows_of(folder)}
    said = f"{len(before)} of 12 flights are kept: hexjet sweep {folder} --resume goes on"
    assert done.stdout == f"{folder / name}: File too large; {said}\n"
    assert len(before) in likely
    assert len(run_campaign(None, folder, 1)) == 12
    after = {row["flight"]: row for row in rows_of(folder)}
    assert {number: after[number] for number in before} == before


FULL = """
import resource, signal, sys
sys.path.insert(0, {tests!r})
import campaign_tools as tools
from cosim.campaign import store
from cosim.campaign.run import run_campaign
from cosim.base.errors import FlightError
store.WRITE_INTERVAL_S = {write_s}
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
import cosim.campaign.workers.local as local
ready = local._Process.receive
def limited(self):
    message = ready(self)
    resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))
    return message
local._Process.receive = limited
try:
    run_campaign(tools.study(), {folder!r}, 1)
except FlightError as error:
    print(error)
"""


def rows_of(folder: Path) -> list[Row]:
    campaign = open_campaign(folder)
    return [campaign.row(int(number)) for number in campaign.columns["flight"]]  # type: ignore[arg-type]


class Reader(threading.Thread):
    """Reads the data set and the campaign over and over while others write it; what is wrong is in ``problems``."""

    def __init__(self, folder: Path) -> None:
        super().__init__(daemon=True)
        self.folder = folder
        self.finished: set[Any] = set()
        self.looks = 0
        self.problems: list[str] = []
        self.over = threading.Event()

    def run(self) -> None:
        while not self.over.wait(0.03):
            try:
                self._look()
            except Exception as error:
                self.problems.append(f"{type(error).__name__}: {error}")

    def _look(self) -> None:
        if not (self.folder / STUDY).exists():
            return
        anyone = held(self.folder) if any((self.folder / FLIGHTS).glob("*.parquet")) else []
        ours = open_campaign(self.folder).columns["flight"]
        for numbers in (anyone, ours):
            if len(set(numbers)) != len(numbers):
                self.problems.append(f"doubled: {numbers}")
        if not self.finished <= set(ours):
            self.problems.append(f"lost: {self.finished - set(ours)}")
        if not set(anyone) <= set(ours):
            self.problems.append(f"unseen: {set(anyone) - set(ours)}")
        self.finished = set(ours)
        self.looks += 1


KILLED = """
import sys
sys.path.insert(0, {tests!r})
import campaign_tools as tools
from cosim.campaign import store
from cosim.campaign.run import run_campaign
from cosim.campaign.workers.local import LocalWorkers
store.PART_SIZE, store.WRITE_INTERVAL_S = 50, 0.02
with LocalWorkers(2, fly=tools.noted) as workers:
    run_campaign(tools.study({runs}, 0.1), {folder!r}, workers, resume=True)
"""


def killed_one(random: Random, workers: list[psutil.Process]) -> bool:
    """Kill one of them; False if none was left to be killed."""
    for process in random.sample(workers, len(workers)):
        with suppress(psutil.NoSuchProcess):
            process.kill()
            return True
    return False


@pytest.mark.long
def test_ten_kills_at_random_moments_lose_nothing_and_double_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGKILL for the main process or one of its workers, between its first breath and its last flight."""
    notes, runs = tmp_path / "notes", 100
    notes.mkdir()
    monkeypatch.setenv(NOTES, str(notes))
    reader = Reader(folder)
    reader.start()
    random = Random(20)
    victims = ["main"] * 3 + ["worker"] * 7
    random.shuffle(victims)
    command = [sys.executable, "-c", KILLED.format(tests=str(TOOLS), folder=str(folder), runs=runs)]
    main = psutil.Popen(command)
    try:
        for victim in victims:
            # so many flights later, or at a moment that may be before the first
            goal = len(reader.finished) + random.choice([0, 0, 1, 3, 6, 12])
            until = time.monotonic() + (random.uniform(0.0, 0.8) if goal == len(reader.finished) else 0.0)
            while len(reader.finished) < goal or time.monotonic() < until:
                assert main.poll() is None
                time.sleep(random.uniform(0.0, 0.01))
            if victim == "worker" and killed_one(random, main.children()):
                continue
            main.kill()
            main.wait()
            assert not reader.problems
            main = psutil.Popen(command)
        assert main.wait(timeout=FLIGHT_PATIENCE) == 0
    finally:
        if main.poll() is None:
            main.kill()
            main.wait()
        reader.over.set()
        reader.join()
    assert not reader.problems
    assert reader.looks > 30
    assert sorted(held(folder)) == list(range(2 * runs))
    assert (folder / JOURNAL).read_bytes() == b""
    flown = sum(len(path.read_text().splitlines()) for path in notes.iterdir())
    # of each worker: the one under way, and one whose row was on its way
    assert 2 * runs <= flown <= 2 * runs + 2 * 2 * len(victims)
    campaign, planned = open_campaign(folder), flights(tools.study(runs, 0.1))
    for number in random.sample(range(2 * runs), 12):
        assert without_chance(campaign.row(number)) == without_chance(fly_one(campaign.study, planned[number]))


@pytest.mark.parametrize(("sent", "status"), long_after(1, [(signal.SIGINT, 130), (signal.SIGTERM, 143)]))
def test_ctrl_c_ends_it_at_once_and_says_how_to_go_on(tmp_path: Path, sent: signal.Signals, status: int) -> None:
    """And so does SIGTERM, as a batch system sends it."""
    command = [sys.executable, "-c", "from cosim.cli.main import main; main()", "sweep", "hover"]
    varied = "--vary", "vehicle.mass_kg=5.4:5.8", "--runs", "20000"
    process = psutil.Popen(
        [*command, *varied, "--workers", "2", "--out", "c", "--set", "duration_s=0.1"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while not (tmp_path / "c" / JOURNAL).exists() or not (tmp_path / "c" / JOURNAL).read_bytes():
        assert process.poll() is None
        time.sleep(0.01)
    workers = process.children()
    process.send_signal(sent)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == status
    assert out == ""
    kept = len(open_campaign(tmp_path / "c"))
    stopped = f"hexjet: stopped; {kept} of 20000 flights are kept: hexjet sweep c --resume goes on"
    assert err.splitlines() == [stopped]
    assert sorted(held(tmp_path / "c")) == open_campaign(tmp_path / "c").columns["flight"]
    assert not psutil.wait_procs(workers, timeout=PATIENCE)[1]


def test_a_flight_that_was_kept_when_ctrl_c_came_is_counted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[int] = []
    add = Store.add

    def interrupted(store: Store, row: Any) -> None:
        add(store, row)
        raise KeyboardInterrupt

    monkeypatch.setattr(Store, "add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_campaign(tools.study(), folder, 1, progress=lambda tally, done, of: told.append(done))
    assert told == [0, 1]
    assert len(open_campaign(folder)) == 1


def test_a_workers_error_that_ends_it_says_what_is_kept(folder: Path) -> None:
    class Broken:
        def fly(self, study: Any, planned: Any) -> Any:
            yield fly_one(study, next(iter(planned)))
            raise FlightError("the scheduler is gone")

    said = r"^the scheduler is gone; 1 of 12 flights are kept: hexjet sweep .*/c --resume"
    with pytest.raises(FlightError, match=said):
        run_campaign(tools.study(), folder, Broken())  # type: ignore[arg-type]
    assert read_table(folder / FLIGHTS / "part-00000.parquet", ["flight"]) == {"flight": [0]}


def test_a_folder_that_has_lost_its_study_is_left_alone(folder: Path) -> None:
    with Store.create(folder, tools.study()) as store:
        fill(store, [0])
    (folder / STUDY).unlink()
    before = contents(folder)
    with pytest.raises(InputError, match="c: no campaign here"):
        Store.resume(folder, tools.study())
    assert contents(folder) == before


def test_a_study_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, content: bytes) -> None:
        if path.name == STUDY:
            raise OSError(errno.ENOSPC, "No space left on device")
        path.write_bytes(content)

    monkeypatch.setattr("cosim.campaign.folder.write_whole", refuse)
    with pytest.raises(InputError, match="c: No space left on device"):
        Store.create(tmp_path / "c", tools.study())
    assert contents(tmp_path) == {}
    monkeypatch.undo()
    Store.create(tmp_path / "c", tools.study()).close()


def test_a_disk_that_fails_later_is_told_too(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was written is found not to be on the disk."""

    def refuse(file: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    store = Store.create(folder, tools.study())
    monkeypatch.setattr(store_module, "SYNC_INTERVAL_S", 0.0)
    monkeypatch.setattr("cosim.campaign.store.os.fsync", refuse)
    with pytest.raises(FlightError, match=f"{JOURNAL}: Input/output error"):
        fill(store, [0])
    monkeypatch.undo()
    store.close()
    assert held(folder) == [0]
