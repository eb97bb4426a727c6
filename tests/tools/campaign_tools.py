"""Short studies, and flights that go wrong in ways that only a process can: its functions are imported in workers."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import Flight
from cosim.campaign.study.study import Study
from cosim.campaign.workers import local
from cosim.campaign.workers.flight_row import Row, failed_row, fly_one

NOTES = "HEXJET_TEST_NOTES"  # a folder for what workers leave, by environment
TROUBLED = 2  # the number of the flight that goes wrong

local.BACKSTOP_S = 0.3


def study(runs: int | None = 6, duration: float = 0.2, fixed: Sequence[str] = (), **options: Any) -> Study:
    """A few short hovers with payload and wind drawn, with and without a predictor."""
    given = {
        "vary": ["vehicle.mass_kg=5.4:5.8", "environment.wind_ned_m_s.1=normal(0,1)"],
        "settings": [f"duration_s={duration}", *fixed],
        "controllers": ["smith", "baseline"],
        "runs": runs,
    }
    return open_study("hover", **(given | options))


class Here:
    """Workers in this process, so that what a test plants is there too; ``loses``: first flights of chunks lost."""

    def __init__(self, *loses: int) -> None:
        self.loses = loses

    def fly(self, study: Study, asked: Iterable[Flight]) -> Iterator[Row]:
        for flight in asked:
            is_lost = study.batch and flight.number in self.loses
            yield failed_row(study, flight, "the process was lost") if is_lost else fly_one(study, flight)


def without_chance(row: Row) -> Row:
    """What does not depend on where and when a flight was flown, nor on whether a store has given it its key."""
    return {name: value for name, value in row.items() if name not in ("wall_s", "worker", "key")}


def noted(study: Study, flight: Flight) -> Row:
    """Fly, take a while, and leave a note of it when it is done."""
    row = fly_one(study, flight)
    time.sleep(0.02)
    with open(Path(os.environ[NOTES]) / str(os.getpid()), "a") as file:
        file.write(f"{flight.number}\n")
    return row


def light(study: Study, flight: Flight) -> Row:
    """A flight of known truth, which is not flown: a success where the mass is above 5.42 kg, of 5.4 to 5.8."""
    row = failed_row(study, flight, "too heavy")
    mass = flight.values["vehicle.mass_kg"]
    assert isinstance(mass, float)
    return row | {"success": mass > 5.42, "outcome": "completed"}


def windy(study: Study, flight: Flight) -> Row:
    """A flight of known margin, which is not flown: 2.5 less the wind from the west, of a standard normal distribution."""
    wind = flight.values["environment.wind_ned_m_s.1"]
    assert isinstance(wind, float)
    row = failed_row(study, flight, "too windy")
    return row | {"success": wind <= 2.5, "outcome": "completed", "steps": 50, "margin": 2.5 - wind}


def lost_once(study: Study, flight: Flight) -> Row:
    """The process is killed in one flight, the first time."""
    mark = Path(os.environ[NOTES]) / "lost"
    if flight.number == TROUBLED and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return fly_one(study, flight)


def lost(study: Study, flight: Flight) -> Row:
    """The process is killed in one flight, every time."""
    if flight.number == TROUBLED:
        os.kill(os.getpid(), signal.SIGSEGV)
    return fly_one(study, flight)


def cleared(study: Study, flight: Flight) -> Row:
    """Somebody clears up temporary files before one flight, the first time."""
    mark = Path(os.environ[NOTES]) / "cleared"
    if flight.number == TROUBLED and not mark.exists():
        mark.touch()
        shutil.rmtree(tempfile.gettempdir())
    return fly_one(study, flight)


def hanging(study: Study, flight: Flight) -> Row:
    """One flight does not end, in C code that does not let Python have a say."""
    if flight.number == TROUBLED:
        (Path(os.environ[NOTES]) / "hangs").write_text(str(os.getpid()))
        ctypes.PyDLL(None).sleep(600)
    return fly_one(study, flight)


def in_trouble(study: Study, flight: Flight) -> Row:
    """The machine fails, not the flight."""
    raise FlightError("no room")


class Deadly:
    """What ends the process that receives it, before it is ready."""

    def __reduce__(self) -> Any:
        return os._exit, (3,)
