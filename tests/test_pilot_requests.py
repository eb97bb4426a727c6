"""What a ground station may ask: exact JSON round trip, and every number checked."""

from __future__ import annotations

import json
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import InputError
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.requests import from_dict, to_dict

REQUESTS = get_args(rq.Request)


def number(least: float, most: float) -> st.SearchStrategy[float]:
    return st.floats(least, most, allow_nan=False, allow_infinity=False)


metres, angle, share, stick = number(-1e5, 1e5), number(-6.28, 6.28), number(0, 1), number(-1, 1)


def maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | strategy


@st.composite
def items(draw: st.DrawFn) -> rq.MissionItem:
    """Any mission item that may be in a list of three."""
    kind = draw(st.sampled_from(list(rq.ItemKind)))
    there = kind in (rq.ItemKind.WAYPOINT, rq.ItemKind.CIRCLE, rq.ItemKind.STAY) or draw(st.booleans())
    return rq.MissionItem(
        kind,
        draw(metres) if there else None,
        draw(metres) if there else None,
        draw(metres),
        draw(maybe(angle)),
        draw(number(0, 1e5)),
        draw(number(0, 1e3)),
        draw(number(0.1, 1e3)),
        draw(st.integers(0, 2)),
        draw(st.integers(0, 1000)),
        draw(number(1, 1e4)),
        draw(st.booleans()),
        draw(number(0, 1e4)),
    )


vector = st.tuples(metres, metres, metres)
place = st.tuples(metres, metres)
POLYGONS, CIRCLES = list(rq.ZoneKind)[:2], list(rq.ZoneKind)[2:]
ANY: dict[type[Any], st.SearchStrategy[Any]] = {
    rq.Arm: st.builds(rq.Arm, st.booleans()),
    rq.Disarm: st.builds(rq.Disarm, st.booleans()),
    rq.Kill: st.builds(rq.Kill, st.booleans()),
    rq.SetMode: st.builds(rq.SetMode, st.text()),
    rq.Takeoff: st.builds(rq.Takeoff, maybe(metres)),
    rq.Goto: st.builds(rq.Goto, maybe(metres), maybe(metres), maybe(metres), maybe(angle), maybe(number(0, 1e3))),
    rq.Orbit: st.builds(
        rq.Orbit,
        number(1, 1e4),
        st.booleans(),
        maybe(number(0, 1e3)),
        metres,
        metres,
        maybe(metres),
        st.sampled_from(rq.OrbitYaw),
        number(0, 1e4),
    ),
    rq.SetSpeed: st.builds(rq.SetSpeed, number(0, 1e3)),
    rq.SetHome: st.builds(rq.SetHome, maybe(metres), maybe(metres), maybe(metres)),
    rq.Sticks: st.builds(rq.Sticks, stick, stick, stick, share),
    rq.OffboardAttitude: st.builds(rq.OffboardAttitude, st.just((0.5, -0.5, 0.5, 0.5)), st.none(), share)
    | st.builds(rq.OffboardAttitude, st.none(), st.tuples(angle, angle, angle), share),
    rq.OffboardVelocity: st.builds(rq.OffboardVelocity, angle, angle, angle, maybe(angle)),
    rq.OffboardPosition: st.builds(rq.OffboardPosition, metres, metres, metres, maybe(angle)),
    rq.MissionUpload: st.builds(rq.MissionUpload, st.tuples(items(), items(), items())),
    rq.MissionSetCurrent: st.builds(rq.MissionSetCurrent, st.integers(0, 10_000)),
    rq.FenceUpload: st.builds(
        rq.FenceUpload,
        st.lists(
            st.builds(rq.FenceZone, st.sampled_from(POLYGONS), st.lists(place, min_size=3, max_size=6).map(tuple))
            | st.builds(rq.FenceZone, st.sampled_from(CIRCLES), st.tuples(place), number(1e-3, 1e5)),
            max_size=3,
        ).map(tuple),
    ),
    rq.RallyUpload: st.builds(
        rq.RallyUpload, st.lists(st.builds(rq.RallyPoint, metres, metres, metres), max_size=3).map(tuple)
    ),
    rq.SetParameter: st.builds(rq.SetParameter, st.text(), metres),
    rq.InjectFault: st.builds(
        rq.InjectFault,
        st.text(),
        st.lists(st.integers(0, 6)).map(tuple),
        maybe(st.text()),
        maybe(st.text()),
        maybe(metres),
        maybe(vector),
        maybe(number(0, 1e5)),
    ),
}
REST = [kind for kind in REQUESTS if kind not in ANY]


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
        rq.Takeoff(3.0).altitude_m = 4.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: rq.Goto(float("nan"), 0.0), "Goto.north = nan: must be a finite number"),
        (lambda: rq.Goto(0.0, float("inf")), "Goto.east = inf: must be a finite number"),
        (lambda: rq.Goto(altitude=1e9), "Goto.altitude = 1000000000.0: must be from -100000 to 100000"),
        (lambda: rq.Takeoff(True), "Takeoff.altitude_m = True: must be a number"),
        (lambda: rq.Takeoff("10"), "Takeoff.altitude_m = '10': must be a number"),
        (lambda: rq.Arm(1), "Arm.force = 1: must be true or false"),
        (lambda: rq.SetMode(3), "SetMode.mode = 3: must be a text"),
        (lambda: rq.Sticks(1.1, 0, 0, 0), "Sticks.roll = 1.1: must be from -1 to 1"),
        (lambda: rq.Sticks(0, 0, 0, -0.1), "Sticks.throttle = -0.1: must be from 0 to 1"),
        (lambda: rq.SetSpeed(-1), "SetSpeed.m_s = -1.0: must be from 0 to 1000"),
        (lambda: rq.OffboardVelocity(0, float("nan"), 0), "OffboardVelocity.east = nan: must be a finite number"),
        (lambda: rq.OffboardVelocity(0, 0, 0, 1.0, 1.0), "OffboardVelocity: give yaw or yaw_rate, not both"),
        (lambda: rq.OffboardAttitude(), "OffboardAttitude: give either quaternion or rates"),
        (lambda: rq.OffboardAttitude((0.1, 0, 0, 0)), "OffboardAttitude.quaternion = [0.1, 0.0, 0.0, 0.0]: must be of length 1"),
        (lambda: rq.OffboardAttitude((1, 0, 0)), "OffboardAttitude.quaternion: 3 values, 4 are needed"),
        (lambda: rq.OffboardAttitude(None, (0, 0, float("nan"))), "OffboardAttitude.rates[2] = nan: must be a finite number"),
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
