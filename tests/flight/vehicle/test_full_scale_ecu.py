"""docs/full-scale.md, tables/full-scale-ecu.md, real-engine.md's next test: cells flown again, changes of the vehicle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import script

from cosim.engine import load_engine
from cosim.results.report.marks import parts_of
from cosim.simulation.controllers.controller_file import NOISE_SHARE, read_controller
from cosim.spec.vehicle import load_vehicle

ecu, steps = script("full_scale_ecu"), script("small_steps")


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
    designed = ecu.tried(ecu.REAL, {}, ecu.gains(ecu.DESIGNED, tmp_path), {})
    assert f"| {ecu.said(designed)} |" in row_of("real ecu", ecu.REAL, "0.16 s, as fitted")
    vanes = ecu.tried(ecu.REAL, {}, ecu.gains(ecu.VANES, tmp_path), {})
    assert ecu.flies(vanes)
    assert f"| {ecu.said(shipped)} |" in row_of("real ecu", ecu.REAL, "0.16 s, as fitted")
    assert f"| {ecu.said(vanes)} |" in row_of("real ecu", ecu.REAL, "0.16 s, as fitted")


def test_the_design_is_of_this_engine_and_with_an_eighth_of_the_noise() -> None:
    made = read_controller(ecu.DESIGN).design
    assert (made.engine, made.aircraft) == (ecu.REAL, ecu.AIRCRAFT)
    assert load_engine(ecu.REAL, {}, ecu.STEP).matches_model(made.engine_sha256)
    assert made.requirements.noise_share == 0.01 == pytest.approx(NOISE_SHARE / 8.0, rel=0.05)


def test_a_search_prefers_what_flies_and_what_flies_longer() -> None:
    hover = {"outcome": "completed", "swing_deg": 1.0}
    doublet = {"outcome": "completed", "overshoot": 10.0, "settling": 4.5}
    good = {"hover": hover, "roll-doublet": doublet, "gust": {"outcome": "completed", "lean_deg": 5.0}}
    assert ecu.badness(good) == 2.5
    assert ecu.badness(good | {"roll-doublet": doublet | {"settling": None}}) == 4.5
    assert ecu.badness(good | {"roll-doublet": {"outcome": "diverged"}, "gust": {"outcome": "diverged"}}) == 10.5
    lost = [{"hover": {"outcome": "diverged", "at_s": seconds}} for seconds in (3.0, 20.0)]
    assert ecu.badness(lost[0]) > ecu.badness(lost[1]) > 50.0


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
