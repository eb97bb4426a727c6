"""The trips of docs/design.md: every function that they name is there, and their lengths are what the page says."""

from __future__ import annotations

import re

import pytest
from places import ROOT
from stated_figures import defined

# Functions on the same way in commit 2f44bdb, records that are only handed on left out.
BEFORE = {"throttle": 22, "thrust": 17, "MAVLink command": 22, "study's key": 13, "requirement": 9}
SECTION = (ROOT / "docs" / "design.md").read_text(encoding="utf-8").split("## Five trips")[1].split("\n## ")[0]
STOP = re.compile(r"^(\d+)\. `([\w/]+\.(?:py|c)):([\w.]+)`$", re.MULTILINE)
TRIPS = {part.split("**")[0]: part for part in re.split(r"^\*\*", SECTION, flags=re.MULTILINE)[1:]}


def test_there_are_five() -> None:
    assert len(TRIPS) == 5


@pytest.mark.parametrize("trip", TRIPS)
def test_every_stop_exists(trip: str) -> None:
    stops = STOP.findall(TRIPS[trip])
    assert [int(number) for number, _, _ in stops] == list(range(1, len(stops) + 1))
    assert len(stops) == len(re.findall(r"^\d+\.", TRIPS[trip], re.MULTILINE)), "a line is no `file:function`"
    missing = [f"{file}:{name}" for _, file, name in stops if name not in defined(ROOT / file)]
    assert not missing
    assert len({stop[1:] for stop in stops}) == len(stops)


@pytest.mark.parametrize("way", BEFORE)
def test_the_lengths_are_what_is_said(way: str) -> None:
    (trip,) = [part for title, part in TRIPS.items() if way in title.split(" to ")[0]]
    now, before = (int(figure) for figure in re.search(r"(\d+) stops, (?:as many as before|before (\d+))", trip).groups(
        default=str(BEFORE[way])))  # fmt: skip
    assert (now, before) == (len(STOP.findall(trip)), BEFORE[way])
    assert now <= before
