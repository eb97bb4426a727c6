"""docs/full-scale.md and tables/full-scale-ecu.md: what it says of the real one's ECU, flown again for two cells, and the changes of the vehicle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import script

from cosim.results.report.marks import parts_of
from cosim.spec.vehicle import load_vehicle

ecu = script("full_scale_ecu")


def row_of(part: str, *first: str) -> str:
    """The row of a part that begins with these cells."""
    page = ecu.page_of(part)
    rows = parts_of(page.read_text(encoding="utf-8"), page)[part].splitlines()
    (found,) = [row for row in rows if row.startswith(f"| {' | '.join(first)} |")]
    return found


def test_the_vehicle_as_shipped_is_lost_and_with_vanes_flies(tmp_path: Path) -> None:
    shipped = ecu.tried(ecu.REAL, {}, ecu.gains(ecu.SHIPPED, tmp_path), {})
    assert shipped["hover"]["outcome"] == "diverged"
    assert not ecu.flies(shipped)
    tuned = ecu.tried(ecu.REAL, {}, ecu.gains(ecu.TUNED, tmp_path), {})
    assert f"| {ecu.said(tuned)} |" in row_of("real ecu", ecu.REAL, "0.16 s, as fitted")
    vanes = ecu.tried(ecu.REAL, {}, ecu.gains(ecu.VANES, tmp_path), {})
    assert ecu.flies(vanes)
    assert f"| {ecu.said(shipped)} |" in row_of("real ecu", ecu.REAL, "0.16 s, as fitted")
    assert f"| {ecu.said(vanes)} |" in row_of("real ecu", ecu.REAL, "0.16 s, as fitted")


def test_one_engine_out_is_held_with_the_opposite_shut_off(tmp_path: Path) -> None:
    """As the page's row of jet 5; a flight that ends, but leans, is lost."""
    held = ecu.lost_engine(5, ecu.gains(ecu.VANES_SHUT, tmp_path))
    assert row_of("real ecu, one out", "jet 5").endswith(f"| {ecu.said_of_loss(held)} |")
    assert ecu.said_of_loss(held).startswith("held")
    assert ecu.said_of_loss(held | {"end_deg": 10.1}).startswith("lost")
    assert ecu.said_of_loss(held | {"outcome": "diverged"}).startswith("lost")


def test_a_flight_that_swings_or_leans_too_far_does_not_count() -> None:
    hover, gust = {"outcome": "completed", "swing_deg": 1.0}, {"outcome": "completed", "lean_deg": 9.0}
    found = {"hover": hover, "roll-doublet": {"outcome": "completed", "settling": 2.0}, "gust": gust}
    assert ecu.flies(found)
    for name, worse in (
        ("hover", {"swing_deg": 2.1}),
        ("roll-doublet", {"settling": None}),
        ("gust", {"lean_deg": 10.1}),
    ):
        assert not ecu.flies(found | {name: found[name] | worse})
    assert not ecu.flies(found | {"gust": gust | {"outcome": "diverged"}})


@pytest.mark.parametrize("grows", [False, True])
def test_longer_levers_keep_the_loop_of_roll(grows: bool) -> None:
    """Throttle to angular acceleration goes with lever over inertia; gain times that stays."""
    plain, changed = ecu.tuned(), ecu.longer(1.5, grows)
    vehicle, _ = load_vehicle("hexjet-p220", changed, "a test")
    shipped, _ = load_vehicle("hexjet-p220")
    gains = [each["control"]["rate"]["roll"]["p"] for each in (plain, changed)]
    plant = [each.jets[0].position_m[1] / each.inertia_kg_m2[0] for each in (shipped, vehicle)]
    np.testing.assert_allclose(gains[1] * plant[1], gains[0] * plant[0], rtol=1e-12)
    assert (vehicle.inertia_kg_m2[0] > shipped.inertia_kg_m2[0]) is grows


def test_six_engines_differ_and_are_drawn_again_alike() -> None:
    first, again, other = ecu.six(1), ecu.six(1), ecu.six(2)
    assert first == again != other
    late = [first[number]["delay_samples"] for number in "123456"]
    assert len(set(late)) > 3
    assert 0 <= min(late) < max(late) < 40 + 3 * 19  # steps of 4 ms; nominal and deviation
