"""Jumps without end: flown round and round in bounded memory, and refused where nothing is flown on the way."""

from __future__ import annotations

import pytest

from cosim.base.errors import InputError
from cosim.control.autopilot.manoeuvres.mission import Mission, find_endless_jump
from cosim.control.autopilot.manoeuvres.mission_flight import MissionFlight
from cosim.control.autopilot.requests import MissionItem, MissionUpload, from_dict, to_dict

FLOWN = MissionItem("waypoint", 1.0, 2.0, 3.0)
SPEED = MissionItem("speed", speed=2.0)


def jump(target: int, repeat: int = -1) -> MissionItem:
    return MissionItem("jump", target=target, repeat=repeat)


def test_a_jump_for_ever_never_ends_and_keeps_no_count() -> None:
    mission = Mission()
    mission.load((FLOWN, FLOWN, jump(0), FLOWN))
    flown = [mission.current]
    for _ in range(9_999):
        mission.advance()
        flown.append(mission.current)
    assert flown == [0, 1] * 5_000
    assert not mission.done
    assert mission._jumps == {}


def test_what_is_behind_it_is_flown_where_somebody_goes_there() -> None:
    mission = Mission()
    mission.load((FLOWN, jump(0), FLOWN))
    mission.restart(2)
    assert mission.skip_jumps() == FLOWN
    assert mission.advance() is None
    assert mission.done


@pytest.mark.parametrize(
    ("items", "idle"),
    [
        ((FLOWN, jump(0)), None),
        ((FLOWN, jump(1)), 1),  # to itself
        ((SPEED, jump(0)), 0 + 1),
        ((jump(1), jump(0)), 0),
        ((FLOWN, jump(2), jump(1)), 1),
        ((SPEED, MissionItem("left_out"), jump(0)), 2),
        ((MissionItem("delay", hold_s=1.0), jump(0)), None),
        ((MissionItem("delay"), jump(0)), 1),
        ((FLOWN, jump(1, 3)), None),  # to itself, three times: over at once
        ((FLOWN, jump(3), FLOWN, SPEED), None),  # and then the mission is over
    ],
)
def test_a_jump_on_the_spot_is_found(items: tuple[MissionItem, ...], idle: int | None) -> None:
    assert find_endless_jump(items) == idle


def test_it_is_recorded_and_read_again() -> None:
    stated = {"request": "MissionUpload", "items": [to_dict_of(FLOWN), to_dict_of(jump(0))]}
    assert from_dict(stated).items[1] == jump(0)


def to_dict_of(item: MissionItem) -> dict[str, object]:
    made = to_dict(item)
    del made["request"]
    return made


def test_the_pilot_refuses_it_in_a_line() -> None:
    flight = object.__new__(MissionFlight)  # nothing of a flight is asked
    with pytest.raises(InputError, match="mission item 1 refused: it jumps for ever, and nothing is flown on the way"):
        flight.load(MissionUpload((FLOWN, jump(1))), None)
