"""Flights on a Dask cluster: a real scheduler and real workers, started as anybody would start them."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
from campaign_tools import study, without_chance
from command_tools import Hexjet
from patience import PATIENCE

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.paths import data_folder
from cosim.campaign.folder import freeze, load
from cosim.campaign.installed import FILES, installed_versions
from cosim.campaign.store import Store
from cosim.campaign.study.plan import Flight, flights
from cosim.campaign.study.study import Study
from cosim.campaign.workers import cluster, remote
from cosim.campaign.workers.cluster import DaskWorkers
from cosim.campaign.workers.flight_row import Row
from cosim.campaign.workers.local import LocalWorkers
from cosim.engine import build_engines

MASS = {"key": "vehicle.mass_kg", "range": [5.0, 6.0]}


class Processes:
    """A scheduler and its workers on this machine."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / "scheduler.json"
        self.all: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start("scheduler", "--port", "0", "--scheduler-file", str(self.file))
        wait_for(self.file.is_file)
        self.workers = [self.worker() for _ in range(2)]

    def worker(self) -> psutil.Process:
        started = self._start("worker", "--scheduler-file", str(self.file), "--no-nanny", "--nthreads", "1")
        return psutil.Process(started.pid)

    @property
    def whole(self) -> bool:
        """Whether all are there that nobody has killed on purpose."""
        return self.scheduler.poll() is None and all(worker.is_running() for worker in self.workers)

    def _start(self, *command: str) -> subprocess.Popen[bytes]:
        here = self.folder / str(len(self.all))
        here.mkdir()
        common = ["--host", "127.0.0.1", "--no-dashboard"]
        environment = os.environ | {"TMPDIR": str(here), "DASK_TEMPORARY_DIRECTORY": str(here)}
        with open(here / "log", "wb") as log:
            dask = [sys.executable, "-m", "dask", *command, *common]
            self.all.append(subprocess.Popen(dask, cwd=here, env=environment, stdout=log, stderr=log))
        return self.all[-1]

    def end(self) -> None:
        for process in self.all:
            process.kill()
        for process in self.all:
            process.wait()


def wait_for(what: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture(scope="module")
def started() -> Iterator[list[Processes]]:
    clusters: list[Processes] = []
    yield clusters
    for each in clusters:
        each.end()


@pytest.fixture
def processes(started: list[Processes], tmp_path_factory: pytest.TempPathFactory) -> Processes:
    """A scheduler and a worker at least: those of the test before, if it left them."""
    if not started or not started[-1].whole:
        started.append(Processes(tmp_path_factory.mktemp("cluster")))
    return started[-1]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A study with an engine that is not of the library, commands from a file, and a metric and a wind of the user's."""
    folder = tmp_path_factory.mktemp("study")
    build_engines(["edf"])
    shutil.copy(data_folder("fmus") / "edf.fmu", folder / "theirs.fmu")
    (folder / "lean.csv").write_text("time_s,roll_deg\n0.0,0.0\n0.1,5.0\n")
    (folder / "mine.py").write_text(
        "def furthest_m(log, step_s):\n    return abs(log['north_m']).max()\n\n"
        "class Blows:\n    def velocity(self, time, north, east, height):\n        return (20.0, 0.0, 0.0)\n"
    )
    (folder / "lean.toml").write_text(
        'name = "lean"\nduration_s = 0.2\nengine = "theirs.fmu"\ncontroller = "baseline"\n'
        'metrics = ["mine.py:furthest_m"]\nwind = "mine.py:Blows"\n'
        '[[command]]\nkind = "table"\nfile = "lean.csv"\n'
    )
    table = {"name": "lean", "scenario": "lean.toml", "design": "random", "runs": 12}
    vary = [MASS, {"key": "engine_parameters.pole", "values": [0.87, 0.88]}]
    given = Study.from_table(table | {"vary": vary}, folder, "test")
    frozen = folder / "frozen"
    frozen.mkdir()
    freeze(given).write(frozen)
    return load(frozen)


def in_order(rows: Iterable[Row]) -> list[Row]:
    return sorted(map(without_chance, rows), key=lambda row: int(row["flight"] or 0))


def test_the_rows_are_those_of_this_machine_though_no_file_is_shared(processes: Processes, foreign: Study) -> None:
    with LocalWorkers(1) as workers:
        here = list(workers.fly(foreign, flights(foreign)))
    assert {row["outcome"] for row in here} == {"completed"}
    blown = [row["own.furthest_m"] for row in here]
    assert len({*blown}) == len(blown)  # each has a mass of its own
    assert min(map(float, blown)) > 1e-3  # type: ignore[arg-type]  # in still air it is a hundredth of that
    assert len({row["brought_sha256"] for row in here}) == 1
    there = []
    with DaskWorkers(str(processes.file)) as workers:
        flying = workers.fly(foreign, flights(foreign))
        there.append(next(flying))
        shutil.rmtree(foreign.folder)
        there += flying
        again = list(workers.fly(foreign, [flights(foreign)[3]]))
    assert in_order(there) == in_order(here)
    assert in_order(again) == in_order(here)[3:4]
    wait_for(lambda: not any(each.children() for each in processes.workers))  # at once, and not after a minute


def test_a_worker_unpacks_a_study_again_after_somebody_cleared_up(tmp_path: Path) -> None:
    asked = study(runs=1)
    frozen, here = freeze(asked), tmp_path / "worker"
    first = remote.fly_together(frozen, "digest", list(flights(asked)), 60.0, here)
    shutil.rmtree(here)
    again = remote.fly_together(frozen, "digest", list(flights(asked)), 60.0, here)
    remote.end_idle()
    assert first[0]["outcome"] == "completed"
    assert in_order(again) == in_order(first)


def test_threads_of_this_process_do_the_same(capfd: pytest.CaptureFixture[str]) -> None:
    asked = study(runs=6)
    with LocalWorkers(2) as workers:
        here = list(workers.fly(asked, flights(asked)))
    with DaskWorkers(None, 2) as workers:
        open_ = [each.laddr for each in psutil.Process().net_connections("inet") if each.status == psutil.CONN_LISTEN]
        assert open_  # the pages of the scheduler and of the worker
        assert {address.ip for address in open_} == {"127.0.0.1"}
        there = list(workers.fly(asked, flights(asked)))
    assert in_order(there) == in_order(here)
    assert len({row["worker"] for row in there}) == 2
    assert not remote._processes._idle
    assert capfd.readouterr() == ("", "")


def test_another_installation_is_told_before_a_flight(processes: Processes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(installed_versions(), "jsbsim", "0.9")
    monkeypatch.setitem(installed_versions(), FILES, "of another day")
    with pytest.raises(InputError) as refused:
        DaskWorkers(str(processes.file))
    said = str(refused.value)
    assert "\n" not in said
    assert [each for each in ("jsbsim", "(here 0.9)", f"other {FILES}") if each not in said] == []


def test_a_worker_is_no_scheduler(processes: Processes) -> None:
    with DaskWorkers(str(processes.file)) as workers:
        address = next(iter(workers._threads.query_scheduler()))
    with pytest.raises(InputError, match="is a Worker, not a scheduler"):
        DaskWorkers(address)


def test_a_worker_is_killed(processes: Processes, capfd: pytest.CaptureFixture[str]) -> None:
    """In the middle of a flight: what it had is flown by the other, and nothing is there twice."""
    asked = study(runs=40, duration=0.4)
    if len(processes.workers) < 2:
        processes.workers.append(processes.worker())
    lost = processes.workers.pop()
    beside: list[psutil.Process] = []
    rows: list[Row] = []
    with DaskWorkers(str(processes.file)) as workers:
        for row in workers.fly(asked, flights(asked)):
            rows.append(row)
            if not beside and (beside := lost.children()):
                lost.send_signal(signal.SIGKILL)
    assert len(beside) == 1
    assert sorted(int(row["flight"] or 0) for row in rows) == list(range(80))
    assert {row["outcome"] for row in rows} == {"completed"}
    with LocalWorkers(1) as workers:
        assert in_order(workers.fly(asked, flights(asked)[70:])) == in_order(rows)[70:]
    wait_for(lambda: not beside[0].is_running() or beside[0].status() == psutil.STATUS_ZOMBIE)
    assert capfd.readouterr() == ("", "")


def test_the_scheduler_is_lost(processes: Processes, tmp_path: Path) -> None:
    """In a sweep as a program: what is finished is kept, one line says how to go on, and somebody else goes on."""
    out = tmp_path / "out"
    sweep = f"sweep hover --vary vehicle.mass_kg=5.4:5.8 --set duration_s=2 --runs 2000 --json --out {out}"
    script = "from cosim.campaign.workers import cluster; cluster.MAX_CONNECT_S = 5.0; from cosim.cli.main import main; main()"
    command = [sys.executable, "-c", script, *sweep.split(), "--cluster", str(processes.file)]
    flying = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def begun() -> bool:
        assert flying.poll() is None, flying.communicate()
        return (out / "flights.jsonl").is_file() and (out / "flights.jsonl").read_text().count("\n") > 4

    wait_for(begun)
    processes.scheduler.kill()
    told = flying.communicate(timeout=PATIENCE)[0].rstrip("\n")
    line = r"hexjet: .*: the scheduler is lost; (\d+) of 2000 flights are kept: .* --resume goes on"
    found = re.fullmatch(line, told)
    assert found, told
    assert flying.returncode == 1
    with Store.resume(out) as store:
        assert len(store.done) == int(found[1]) >= 5
        left = [flight for flight in store.flights if store.key(flight) not in store.done][:4]
        assert len(left) == 4
        with LocalWorkers(1) as workers:
            assert {row["outcome"] for row in workers.fly(store.study, left)} == {"completed"}


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("tcp://127.0.0.1:NOBODY", "no scheduler answers within 0.5 s; one is started with: dask"),
        ("tcp://127.0.0.1:SILENT", "no scheduler answers within 0.5 s"),  # a server that is none of Dask's
        ("nonsense", "missing port number in address 'nonsense'; an address looks like tcp://HOST:8786"),
        ("http://127.0.0.1:1", "unknown address scheme 'http'"),
        ("notes.json", "no scheduler file"),
        ("none.json", "no scheduler file"),
    ],
)
def test_what_cannot_be_reached_is_told_in_a_line(
    where: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hexjet: Hexjet
) -> None:
    monkeypatch.setattr(cluster, "MAX_CONNECT_S", 0.5)
    (tmp_path / "notes.json").write_text("[]")
    with socket.create_server(("127.0.0.1", 0)) as gone, socket.create_server(("127.0.0.1", 0)) as silent:
        where = where.replace("SILENT", str(silent.getsockname()[1])).replace("NOBODY", str(gone.getsockname()[1]))
        gone.close()
        sweep = f"sweep hover --vary vehicle.mass_kg=5:6 --runs 4 --cluster {where} --out out"
        said = hexjet(*sweep.split()).refusal
    assert said.startswith(f"hexjet: cluster {where}: ")
    assert words in said
    assert not (tmp_path / "out").exists()


def test_a_scheduler_without_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "MAX_FIRST_WORKER_S", 0.2)
    monkeypatch.setattr(cluster._Threads, "query_scheduler", lambda threads: {})
    with pytest.raises(InputError, match=r"has no workers; one is started with: dask worker"):
        DaskWorkers(None, 1)


def test_dask_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"cluster needs Dask, which is not installed.*pip install distributed"):
        DaskWorkers("tcp://127.0.0.1:1")


def test_workers_are_counted_where_they_are_made() -> None:
    with pytest.raises(InputError, match="workers 3: a cluster has the workers that it has"):
        DaskWorkers("tcp://127.0.0.1:1", 3)


class Told:
    """A future of :class:`Obedient`."""

    def __init__(self, key: str, call: Callable[[], Any], size: int = 0) -> None:
        self.key, self.call, self.status, self.size = key, call, "pending", size
        self.error: Exception | None = None
        self.done: Callable[[Any], None] = lambda _: None

    def add_done_callback(self, done: Callable[[Any], None]) -> None:
        self.done = done

    def result(self, timeout: float) -> Any:
        if self.error is not None:
            raise self.error
        return self.call()

    def end(self, status: str = "finished", error: Exception | None = None) -> None:
        self.status, self.error = status, error
        self.done(self)


class Obedient:
    """A client whose tasks end when they are told to; a flight takes ``seconds``."""

    def __init__(self, seconds: float = 0.1) -> None:
        self.status, self.seconds = "running", seconds
        self.studies: list[str] = []
        self.tasks: list[Told] = []

    @property
    def sizes(self) -> list[int]:
        """How many flights were in each task."""
        return [each.size for each in self.tasks]

    def submit(self, call: Any, *given: Any, key: str, pure: bool = True) -> Told:
        if call is cluster._identity_task:
            self.studies.append(key)
            return Told(key, lambda: given[0])
        rows = [{"flight": flight.number, "wall_s": self.seconds} for flight in given[3]]
        self.tasks.append(Told(key, lambda: rows, len(rows)))
        return self.tasks[-1]

    def cancel(self, futures: list[Told], force: bool) -> None:
        for future in futures:
            future.status = "cancelled"


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> Study:
    monkeypatch.setattr(cluster, "CHECK_INTERVAL_S", 0.0)
    return study(runs=40)


def tasks_of(few: Study, client: Obedient, taken: list[int] | None = None) -> cluster._Tasks:
    def taking() -> Iterator[Flight]:
        for flight in flights(few):
            if taken is not None:
                taken.append(flight.number)
            yield flight

    return cluster._Tasks(client, few, freeze(few), taking(), 60.0)


def test_flights_are_taken_as_they_can_be_flown(few: Study) -> None:
    """Four tasks at a time and no more; of one flight at first, then of half a second, and fewer towards the end."""
    client, taken = Obedient(), []
    tasks = tasks_of(few, client, taken)
    tasks.hand_out(4)
    assert len(taken) <= 2 * 4
    tasks.hand_out(4)
    assert client.sizes == [1, 1, 1, 1]
    client.tasks[2].end()
    assert [row["flight"] for row in tasks.collect()] == [2]
    tasks.hand_out(4)
    assert client.sizes[4:] == [5]
    assert len(taken) <= 9 + 4 * 5
    tasks.hand_out(6)  # a worker has come
    assert client.sizes[5:] == [5, 5]
    assert len(taken) <= 19 + 6 * 5
    tasks.hand_out(2)  # and gone with another
    assert len(client.tasks) == 7
    rows = 1
    while not tasks.is_done:
        for each in client.tasks:
            if each.status == "pending":
                each.end()
        rows += len(list(tasks.collect()))
        tasks.hand_out(4)
    assert rows == 80
    assert (client.sizes[7:15], client.sizes[-4:]) == ([5] * 8, [1, 1, 1, 1])
    assert len(client.studies) == 1


def test_what_is_under_way_is_taken_back(few: Study) -> None:
    client = Obedient()
    tasks = tasks_of(few, client)
    tasks.hand_out(4)
    client.tasks[0].end()
    list(tasks.collect())
    tasks.cancel()
    assert [each.status for each in client.tasks] == ["finished", *["cancelled"] * 3]


@pytest.mark.parametrize(("seconds", "size"), [(3.0, 1), (0.25, 2), (0.0001, cluster.MAX_IN_TASK)])
def test_long_flights_travel_alone_and_short_ones_in_limits(few: Study, seconds: float, size: int) -> None:
    client = Obedient(seconds)
    tasks = tasks_of(few, client)
    tasks.hand_out(1)
    client.tasks[0].end()
    list(tasks.collect())
    tasks.hand_out(1)
    assert client.sizes == [1, size]


def test_what_is_cancelled_is_flown_again_with_the_study(few: Study) -> None:
    """As when the scheduler was lost for a moment: it has forgotten everything."""
    client, taken = Obedient(), []
    tasks = tasks_of(few, client, taken)
    tasks.hand_out(2)
    client.tasks[0].end("cancelled")
    client.tasks[1].end("lost")
    assert list(tasks.collect()) == []
    assert not tasks.is_done
    tasks.hand_out(2)
    assert len(client.studies) == 2
    for each in client.tasks[2:]:
        each.end()
    assert sorted(int(row["flight"] or 0) for row in tasks.collect()) == [0, 1]
    assert len(taken) == len(set(taken))


def test_flights_that_lose_worker_after_worker(few: Study) -> None:
    """Those of a task are tried alone; one that goes on with it is a row."""
    killed = pytest.importorskip("distributed").KilledWorker("task", SimpleNamespace(address="tcp://far:1"), 3)
    client = Obedient()
    tasks = tasks_of(few, client)
    tasks.hand_out(1)
    client.tasks[0].end()
    list(tasks.collect())
    tasks.hand_out(1)
    client.tasks[1].end("error", killed)
    assert list(tasks.collect()) == []
    tasks.hand_out(5)
    assert client.sizes == [1, 5, 1, 1, 1, 1, 1]
    client.tasks[4].end("error", killed)
    for each in (2, 3, 5, 6):
        client.tasks[each].end()
    rows = {int(row["flight"] or 0): row for row in tasks.collect()}
    assert sorted(rows) == [1, 2, 3, 4, 5]
    reason = "the worker was lost in this flight 4 times; the last was tcp://far:1"
    assert (rows[3]["outcome"], rows[3]["reason"]) == ("failed", reason)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ModuleNotFoundError("No module named 'cosim'", name="cosim"), "hexjet-cosim is not installed there"),
        (ValueError("first\nsecond"), "a worker cannot fly: ValueError: first$"),
        (FlightError("worker tcp://far:1 has numpy 1.0"), "^worker tcp://far:1 has numpy 1.0$"),
    ],
)
def test_what_a_worker_cannot_do_ends_the_flying(few: Study, error: Exception, words: str) -> None:
    client = Obedient()
    tasks = tasks_of(few, client)
    tasks.hand_out(1)
    client.tasks[0].end("error", error)
    with pytest.raises(FlightError, match=words):
        list(tasks.collect())
