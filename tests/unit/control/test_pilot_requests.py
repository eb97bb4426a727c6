"""What a ground station may ask: exact JSON round trip, and every number checked."""

from __future__ import annotations

import json
from typing import Any

import pytest
from any_request import ANY, REST
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import InputError
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.requests import from_dict, to_dict


@given(st.one_of(*ANY.values(), *(st.just(kind()) for kind in REST)))
def test_round_trip_through_json_is_exact(request: rq.Request) -> None:
    """To the last bit: ``repr`` tells 0.0 from -0.0 and every float from its neighbours."""
    again = from_dict(json.loads(json.dumps(to_dict(request), allow_nan=False)))
    assert type(again) is type(request)
    assert repr(again) == repr(request)


def test_whole_numbers_become_floats_once() -> None:
    """1 and 1.0 are one request, so that a log written from either reads back the same."""
    assert repr(rq.Goto(1, 2)) == repr(rq.Goto(1.0, 2.0)) == repr(from_dict({"request": "Goto", "north": 1, "east": 2}))


def test_requests_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        rq.Takeoff(3.0).altitude_m = 4.0


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: rq.Goto(float("nan"), 0.0), "Goto.north = nan: must be a finite number"),
        (lambda: rq.Goto(altitude=1e9), "Goto.altitude = 1000000000.0: must be from -100000 to 100000"),
        (lambda: rq.Takeoff(True), "Takeoff.altitude_m = True: must be a number"),
        (lambda: rq.Arm(1), "Arm.force = 1: must be true or false"),
        (lambda: rq.SetMode(3), "SetMode.mode = 3: must be a text"),
        (lambda: rq.Sticks(1.1, 0, 0, 0), "Sticks.roll = 1.1: must be from -1 to 1"),
        (lambda: rq.OffboardVelocity(0, 0, 0, 1.0, 1.0), "OffboardVelocity: give yaw or yaw_rate, not both"),
        (lambda: rq.OffboardAttitude(), "OffboardAttitude: give either quaternion or rates"),
        (lambda: rq.OffboardAttitude((0.1, 0, 0, 0)), "OffboardAttitude.quaternion = [0.1, 0.0, 0.0, 0.0]: must be of length 1"),
        (lambda: rq.OffboardAttitude((1, 0, 0)), "OffboardAttitude.quaternion: 3 values, 4 are needed"),
        (lambda: rq.MissionItem("hover"), "MissionItem.kind = 'hover': must be one of waypoint, takeoff, land, return, speed, delay, jump"),
        (lambda: rq.MissionItem("waypoint", 1, 2), "MissionItem waypoint: altitude is missing"),
        (lambda: rq.MissionItem("land", 1), "MissionItem land: give north and east, or neither"),
        (lambda: rq.MissionItem("jump", target=1.5), "MissionItem.target = 1.5: must be a whole number"),
        (lambda: rq.MissionUpload([rq.MissionItem("jump", target=1)]), "MissionUpload.items[0].target = 1: there are items 0 to 0"),
        (lambda: rq.MissionUpload([rq.MissionItem("return")] * 1001), "MissionUpload.items: 1001 items, at most 1000 are allowed"),
        (lambda: rq.MissionUpload(3), "MissionUpload.items = 3: must be a list"),
        (lambda: rq.SetParameter("X", 10**400), "SetParameter.value = "),
        (lambda: from_dict({"request": "Fly"}), "request = 'Fly': must be one of Arm, Disarm"),
        (lambda: from_dict({}), "request = None: must be one of"),
        (lambda: from_dict({"request": "Arm", "now": 1}), "Arm: unknown key 'now'; it has force"),
        (lambda: from_dict({"request": "SetMode"}), "SetMode: not complete; absent: mode"),
        (lambda: from_dict({"request": "MissionUpload", "items": [3]}), "MissionUpload.items[0] = 3: must be a table"),
    ],
)  # fmt: skip
def test_what_is_not_a_request_is_refused_in_one_line(make: Any, complaint: str) -> None:
    with pytest.raises(InputError) as refusal:
        make()
    text = str(refusal.value)
    assert text.startswith(complaint)
    assert "\n" not in text
