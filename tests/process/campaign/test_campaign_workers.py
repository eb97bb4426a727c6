"""Flights in processes of this machine: the rows they give, and processes that are killed, hang, or do not start."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import campaign_tools as tools
import psutil
import pytest
from campaign_tools import NOTES, TROUBLED, without_chance
from patience import PATIENCE, stretched
from places import TOOLS

from cosim import fly
from cosim.base.errors import FlightError, InputError
from cosim.campaign.study.plan import Flight, flights, scenario_of
from cosim.campaign.study.study import Study
from cosim.campaign.workers import local
from cosim.campaign.workers.flight_row import Row, fly_one, kinds
from cosim.campaign.workers.local import LocalWorkers
from cosim.campaign.workers.tasks import as_finished
from cosim.results.log.digest import log_digest


@pytest.fixture(scope="module")
def study() -> Study:
    return tools.study()


@pytest.fixture(scope="module")
def rows(study: Study) -> list[Row]:
    """The rows of all flights, flown here."""
    return [fly_one(study, flight) for flight in flights(study)]


@pytest.fixture
def notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(NOTES, str(tmp_path))
    return tmp_path


def by_number(rows: Iterator[Row]) -> list[Row]:
    return sorted(map(without_chance, rows), key=lambda row: row["flight"])  # type: ignore[arg-type, return-value]


NEEDLESS = ("scipy.stats", "scipy.optimize", "pandas", "hexjet_sitl.prepare")


@pytest.mark.parametrize(
    "code",
    [
        "import cosim.campaign.workers.local",  # what a process does before its first flight
        "from cosim.cli.main import run; run(['sweep', 'hover', '--vary', 'vehicle.mass_kg*=0.9:1.1', '--runs', '2', "
        "'--set', 'duration_s=0.1', '--workers', '1', '--out', {out!r}])",
    ],
)
def test_a_campaign_loads_nothing_that_takes_long_and_that_it_does_not_use(code: str, tmp_path: Path) -> None:
    code = f"{code.format(out=str(tmp_path / 'out'))}; import sys; print([n for n in {NEEDLESS} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_flights_are_numbered_and_those_of_a_draw_are_neighbours(study: Study) -> None:
    planned = flights(study)
    numbered = [(flight.number, flight.controller) for flight in planned]
    assert numbered == [(number, ("smith", "baseline")[number % 2]) for number in range(12)]
    for one, other in zip(planned[::2], planned[1::2], strict=True):
        assert (one.draw, one.seed, one.values) == (other.draw, other.seed, other.values)
    assert len({flight.seed for flight in planned}) == 6
    assert planned[-1] == planned[11]
    assert planned[2:4] == [planned[2], planned[3]]
    with pytest.raises(IndexError):
        planned[12]


def test_a_flight_is_its_scenario_with_what_was_drawn(study: Study) -> None:
    flight = flights(study)[3]
    scenario = scenario_of(study, flight)
    assert (scenario.controller, scenario.seed, scenario.expect) == ("baseline", flight.seed, [])
    assert scenario.vehicle["mass_kg"] == flight.values["vehicle.mass_kg"]
    assert scenario.environment.wind_ned_m_s == (0.0, flight.values["environment.wind_ned_m_s.1"], 0.0)


def test_a_row_says_what_a_flight_alone_says(study: Study, rows: list[Row]) -> None:
    """Every column, against a flight with all of its log."""
    flight, row = flights(study)[0], rows[0]
    run = fly(scenario_of(study, flight))
    assert list(row) == list(kinds(study))
    assert all(type(row[name]) is kind for name, kind in kinds(study).items() if row[name] is not None)
    told = run.summary.flat_metrics | dict(flight.values)
    told |= {"outcome": "completed", "reason": "flew 50 steps", "success": True, "steps": 50, "duration_s": 0.2}
    told |= {"flight": 0, "draw": 0, "controller": "smith", "seed": flight.seed, "log_sha256": log_digest(run.log)}
    assert {name: row[name] for name in told} == told
    assert len({row["log_sha256"] for row in rows}) == 12


def test_success_is_what_the_study_says() -> None:
    strict = tools.study(success=["altitude.rmse_m<=0"])
    row = fly_one(strict, flights(strict)[0])
    assert (row["outcome"], row["success"]) == ("completed", False)


def test_a_crash_is_a_row_and_no_success() -> None:
    study = tools.study(None, 2.0, vary=["initial.altitude_m=0.3,0.4"], fixed=["initial.rate_deg_s=[300,0,0]"])
    row = fly_one(study, flights(study)[0])
    assert row["outcome"] in ("crashed", "diverged")
    assert row["success"] is False
    assert row["steps"] < 500  # type: ignore[operator]


def test_what_cannot_be_built_is_a_row_with_the_reason() -> None:
    study = tools.study(None, vary=["vehicle.mass_kg=5.4,50"])
    rows = [fly_one(study, flight) for flight in flights(study)]
    assert [row["outcome"] for row in rows] == ["completed", "completed", "failed", "failed"]
    assert "hover at throttle" in str(rows[2]["reason"])
    assert (rows[2]["log_sha256"], rows[2]["steps"], rows[2]["success"]) == (None, None, False)


def test_what_nobody_thought_of_is_a_row_too(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_off(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of nothing\nby nothing")

    monkeypatch.setattr("cosim.campaign.workers.flight_row.fly", break_off)
    row = fly_one(study, flights(study)[0])
    assert (row["outcome"], row["reason"]) == ("failed", "ZeroDivisionError: of nothing")


def test_a_full_disk_is_not_the_flights_fault(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """Though whoever met it calls it by another name."""

    def full(*_: object, **__: object) -> None:
        try:
            raise OSError(errno.ENOSPC, "No space left on device")
        except OSError as error:
            raise InputError("edf.fmu: is damaged") from error

    monkeypatch.setattr("cosim.campaign.workers.flight_row.fly", full)
    with pytest.raises(FlightError, match=f":{os.getpid()}: No space left on device"):
        fly_one(study, flights(study)[0])


def test_a_machine_in_trouble_ends_it(study: Study) -> None:
    with LocalWorkers(1, fly=tools.in_trouble) as workers, pytest.raises(FlightError, match="no room"):
        list(workers.fly(study, flights(study)))


def test_who_interrupts_a_flight_interrupts_it_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """In its middle, when the first second is recorded."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cosim.results.log.digest.DigestSink.write", interrupt)
    study = tools.study(1, 2.0)
    with pytest.raises(KeyboardInterrupt):
        fly_one(study, flights(study)[0])


def test_rows_do_not_depend_on_the_workers(study: Study, rows: list[Row]) -> None:
    """Two of them, against this process."""
    with LocalWorkers(2) as workers:
        found = list(workers.fly(study, flights(study)))
    assert by_number(iter(found)) == [without_chance(row) for row in rows]
    assert len({row["worker"] for row in found}) in (1, 2)
    assert str(rows[0]["worker"]).endswith(f":{os.getpid()}")


def test_workers_stay_for_another_study_and_leave_when_closed(study: Study, rows: list[Row]) -> None:
    workers = LocalWorkers(2)
    first = {row["worker"] for row in workers.fly(study, flights(study))}
    other = tools.study(3, controllers=["state"])
    found = list(workers.fly(other, flights(other)))
    assert [row["controller"] for row in found] == ["state"] * 3
    assert {row["worker"] for row in found} <= first
    assert children()
    workers.close()
    workers.close()
    assert all_gone()


def test_flights_are_taken_as_they_are_flown(study: Study) -> None:
    """A study of millions does not wait in a list."""
    taken = []

    def endless() -> Iterator[Flight]:
        while True:
            flight = flights(study)[len(taken) % 12]
            taken.append(flight)
            yield flight

    with LocalWorkers(2) as workers:
        found = workers.fly(study, endless())
        for _ in range(30):
            next(found)
        assert 30 <= len(taken) <= 30 + 2 * 10  # one under way and at most eight waiting in each, one to look ahead
        found.close()  # type: ignore[attr-defined]
        assert not any(process.queued for process in workers._processes)  # one that had just answered waits for more
    assert all_gone()


def test_flights_that_nobody_waits_for_are_not_another_studys(study: Study, rows: list[Row]) -> None:
    with LocalWorkers(1) as workers:
        left = workers.fly(study, flights(study)[6:])
        next(left)
        assert by_number(workers.fly(study, flights(study)[:2])) == [without_chance(row) for row in rows[:2]]


def test_no_more_workers_than_flights(study: Study) -> None:
    with LocalWorkers(8) as workers:
        assert len(list(workers.fly(study, flights(study)[:2]))) == 2
        assert len(children()) <= 2


@pytest.mark.parametrize(
    ("count", "mark"), [(2, "lost"), (1, "cleared"), pytest.param(2, "cleared", marks=pytest.mark.long)]
)
def test_the_flight_of_a_worker_that_is_lost_is_flown_again(
    study: Study, rows: list[Row], notes: Path, count: int, mark: str
) -> None:
    """Killed, or its folder cleared away."""
    with LocalWorkers(count, fly={"lost": tools.lost_once, "cleared": tools.cleared}[mark]) as workers:
        found = by_number(workers.fly(study, flights(study)))
    assert (notes / mark).exists()
    assert found == [without_chance(row) for row in rows]


def test_no_room_for_a_workers_folder(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(**_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    with LocalWorkers(1) as workers:
        monkeypatch.setattr("tempfile.mkdtemp", full)
        with pytest.raises(FlightError, match=r"no process could be started: /.*: No space left on device"):
            list(workers.fly(study, flights(study)))


def test_a_flight_that_takes_its_process_along_is_given_up(study: Study, rows: list[Row]) -> None:
    with LocalWorkers(2, fly=tools.lost) as workers:
        found = by_number(workers.fly(study, flights(study)))
    lost = found.pop(TROUBLED)
    assert lost["outcome"] == "failed"
    assert lost["reason"] == "the process was lost in this flight 3 times; the last was ended by SIGSEGV"
    assert lost["vehicle.mass_kg"] == rows[TROUBLED]["vehicle.mass_kg"]
    assert found == [without_chance(row) for row in rows if row["flight"] != TROUBLED]


@pytest.mark.long
def test_a_flight_that_does_not_end_is_ended(study: Study, rows: list[Row], notes: Path) -> None:
    # twenty times what a flight here takes on a machine with nothing else to do, and twice that at least
    limit = round(stretched(2.0))
    with LocalWorkers(2, time_limit_s=limit, fly=tools.hanging) as workers:
        found = by_number(workers.fly(study, flights(study)))
    assert found[TROUBLED]["reason"] == f"not finished within the time limit of {limit} s"
    assert not psutil.pid_exists(int((notes / "hangs").read_text()))
    assert len(found) == 12


@pytest.mark.parametrize(
    ("fly", "limits", "said"),
    [
        (
            tools.Deadly(),
            {"MAX_FAILED_STARTS": 3},
            "3 processes in a row ended before they could fly; the last ended with",
        ),
        # they have neither left nor closed anything: the machine has too much to do
        (
            fly_one,
            {"MAX_START_S": 0.0, "CHECK_INTERVAL_S": 0.0, "MAX_FAILED_STARTS": 2},
            "the last was not ready after 0 s",
        ),
    ],
    ids=["ended", "slow"],
)
def test_processes_that_do_not_start_end_it(
    study: Study, monkeypatch: pytest.MonkeyPatch, fly: Any, limits: dict[str, float], said: str
) -> None:
    for name, value in limits.items():
        monkeypatch.setattr(local, name, value)
    with LocalWorkers(2, fly=fly) as workers:
        with pytest.raises(FlightError, match=said):
            list(workers.fly(study, flights(study)))
        assert all_gone()


@pytest.mark.parametrize(("arguments", "message"), [((0,), "workers = 0"), ((1, 0.0), "time limit = 0 s")])
def test_workers_that_cannot_be(arguments: tuple[int, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        LocalWorkers(*arguments)


ORPHANS = """
import sys
import time
sys.path.insert(0, {tests!r})
import campaign_tools as tools
from cosim.campaign.workers.local import LocalWorkers
from cosim.campaign.study.plan import flights
study = tools.study(500)
for row in LocalWorkers(3, time_limit_s={limit}, fly=tools.hanging).fly(study, flights(study)):
    print(row["flight"], flush=True)
"""


def test_workers_go_when_their_parent_is_killed(notes: Path) -> None:
    """The one at work, the one that waits, and the one that hangs in C code; this one at its limit if nothing else."""
    scratch = notes / "scratch"
    scratch.mkdir()
    parent = subprocess.Popen(
        [sys.executable, "-c", ORPHANS.format(tests=str(TOOLS), limit=600.0 if sys.platform == "linux" else 3.0)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"TMPDIR": str(scratch)},
    )
    assert parent.stdout is not None
    while not (notes / "hangs").exists():
        assert parent.stdout.readline()
    workers = psutil.Process(parent.pid).children()
    assert len(workers) == 3
    parent.kill()
    parent.wait()
    parent.stdout.close()
    _, alive = psutil.wait_procs(workers, timeout=PATIENCE)
    for process in alive:
        process.kill()
    assert not alive
    # the one that hung had no chance to clean up
    assert len(list(scratch.glob("hexjet-scratch-*/worker-*"))) <= 1


def all_gone() -> bool:
    """Whether every process of ours ends; one that was told to may take its time on a busy machine."""
    return not psutil.wait_procs(children(), timeout=PATIENCE)[1]


def children() -> list[psutil.Process]:
    """Workers of this process: other tests leave helpers of multiprocessing behind, which do not count here."""
    found = []
    for each in psutil.Process().children():
        with suppress(psutil.NoSuchProcess, psutil.ZombieProcess):
            if any("cosim.campaign.workers.local" in part for part in each.cmdline()):
                found.append(each)
    return found


def slow_square(value: float) -> float:
    time.sleep(0.2 if value == 0.0 else 0.0)
    return value * value


def refuse(value: float) -> float:
    raise InputError(f"{value:g} is refused")


def die(value: float) -> float:
    os.kill(os.getpid(), signal.SIGKILL)
    return value


def test_other_work_is_answered_with_its_place_and_its_errors_come_through() -> None:
    assert dict(as_finished(slow_square, [0.0, 1.0, 2.0, 3.0], 2)) == {0: 0.0, 1: 1.0, 2: 4.0, 3: 9.0}
    with pytest.raises(InputError, match="2 is refused"):
        list(as_finished(refuse, [2.0], 2))
    with pytest.raises(FlightError, match="the process was lost in this flight 3 times; the last was ended by SIGKILL"):
        list(as_finished(die, [1.0], 2))
