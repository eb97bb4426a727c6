"""Any request that a ground station may make, for Hypothesis."""

from __future__ import annotations

from typing import Any, get_args

from hypothesis import strategies as st

from cosim.control.autopilot import requests as rq

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
