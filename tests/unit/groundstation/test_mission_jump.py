"""A mission's jump: how often it may be stated, and what is said of what is no such number."""

from __future__ import annotations

from math import nan

import pytest

from cosim.base.geodesy import Geodesy
from cosim.groundstation.mavlink.services.items import Item, ItemError, to_mission_item

MISSION, JUMP = 2, 177  # MAV_FRAME_MISSION, MAV_CMD_DO_JUMP


def jump(target: float, repeat: float) -> int | None:
    item = Item(MISSION, JUMP, (target, repeat, 0.0, nan), 0, 0, 0.0)
    return to_mission_item(item, Geodesy(22.35, 113.59), 0.0).repeat


@pytest.mark.parametrize("repeat", [-1, 0, 3])
def test_so_often_it_may_jump(repeat: int) -> None:
    assert jump(0.0, float(repeat)) == repeat


@pytest.mark.parametrize("repeat", [-2.0, 0.5])
def test_what_is_no_number_of_jumps_is_refused_with_what_is(repeat: float) -> None:
    said = f"^number of jumps {repeat:g}: must be a whole number, 0 or more, or -1 for ever$"
    with pytest.raises(ItemError, match=said):
        jump(0.0, repeat)


def test_the_item_to_jump_to_has_no_for_ever() -> None:
    with pytest.raises(ItemError, match=r"^item to jump to -1: must be a whole number, 0 or more$"):
        jump(-1.0, 1.0)
