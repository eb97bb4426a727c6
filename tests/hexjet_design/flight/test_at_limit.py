"""A design of the law at the limit: what it is computed with is what flies, and it keeps what was asked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml, toml_text
from cosim.campaign.study.keys import with_values
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import Requirements, apply_controller
from cosim.spec.scenario import Scenario
from hexjet_design import design as designs
from hexjet_design.assessment import AxisDesign, assess, predictor_model, shipped_tuning
from hexjet_design.controller_table import make_controller_table
from hexjet_design.design import Design, add_limits
from hexjet_design.loop import at_limit
from hexjet_design.loop.at_limit import tune_at_limit
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid, steps_by_response
from hexjet_design.loop.criteria import excesses
from hexjet_design.loop.optimal import Optimal
from hexjet_design.loop.tuning import Tuning
from hexjet_design.measured.computed import compute_margins
from hexjet_design.result import answer_lines, detail_lines, to_dict
from hexjet_export.controller.form import make_form

pytest.importorskip("clarabel", reason="Clarabel is not installed")

DEFAULTS = {parameter.name: parameter.default for parameter in Optimal.parameters}


@cache
def designed() -> Design:
    """The Hex-Jet with its engine: roll by a search that is short, the other axes with the gains that ship."""
    axis_of = designs._tune

    def axis(channel: Channel, inputs: Any, roll: Tuning | None) -> AxisDesign:
        if channel.name == "roll":
            return axis_of(channel, inputs, roll)
        shipped = assess(channel, shipped_tuning(channel, inputs.vehicle, inputs.spec), inputs.need)
        return AxisDesign(channel, shipped, {shipped.controller: 0.0}, shipped, {}, {})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(designs, "_tune", axis)
        patch.setattr(at_limit, "MAX_EVALUATIONS", 60)
        return designs.design("edf-as-flown", controller="optimal", lead=False)


def law() -> Tuning:
    after = designed().axes["roll"].after
    assert after is not None
    return after.tuning


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "optimal.toml"
    path.write_text(toml_text(make_controller_table(designed())), encoding="utf-8")
    return path


def test_a_law_by_its_matrices_and_by_its_response_is_one_loop() -> None:
    channel = replace(designed().axes["roll"].channel, added_delay=2)
    tuning = Tuning.of_law(DEFAULTS, predictor_model(channel, "test"), law())
    closed = ClosedLoop(FrequencyGrid(channel), tuning)
    assert closed.unstable_poles == 0
    other = steps_by_response(channel, tuning, 400)
    for ours, theirs in zip(closed.steps, other, strict=True):
        assert np.asarray(ours)[:400] == pytest.approx(np.asarray(theirs), abs=1e-7)


def test_a_design_keeps_what_is_asked() -> None:
    roll, need = designed().axes["roll"], designed().need
    after = roll.after
    assert designed().ok
    assert after is not None
    assert after.peak_sensitivity is not None
    assert after.peak_sensitivity <= need.max_sensitivity
    assert after.tolerated is not None
    assert after.tolerated >= 1.0
    assert after.noise is not None
    assert after.noise <= need.noise_share * roll.channel.room
    assert after.step_peak is not None
    assert after.step_peak * need.step_rad <= roll.channel.room
    assert all(roll.checks.values())
    assert list(roll.candidates) == ["optimal"]
    other = Tuning.of_law(
        DEFAULTS, law().model, law()
    )  # as the law ships it is too sensitive to gain and delay at once
    assert "tolerances" in excesses(ClosedLoop(FrequencyGrid(roll.channel), other), need)


def test_at_the_late_corners_a_step_overshoots_by_no_more_than_a_proof_allows() -> None:
    channel, need = designed().axes["roll"].channel, designed().need
    corners = at_limit._late_corners(channel, need)
    assert [corner.actuator_delay - channel.actuator_delay for corner in corners] == [7.0, 7.0]
    assert [corner.gain / channel.gain for corner in corners] == pytest.approx([0.7, 1.3])
    for corner in corners:
        assert ClosedLoop(FrequencyGrid(corner, close=100), law()).overshoot < 0.2


@pytest.mark.parametrize("zero", [0.0, -1.0, -1.5, 1.5])
def test_the_largest_command_after_a_step_is_that_of_the_loop(zero: float) -> None:
    """With zeros that the law inverts, and with those that it leaves in its answer."""
    roll = designed().axes["roll"].channel
    exact = roll.model("exact")
    model = exact.model_copy(update={"zeros": [zero, *exact.zeros[1:]], "gain": exact.gain / (1.0 - zero)})
    channel = replace(roll, identified=model)
    search = at_limit._Search(channel, model, law(), Requirements())
    closed = ClosedLoop(FrequencyGrid(channel), Tuning.of_law(DEFAULTS, model, law()))
    assert search._first_command(DEFAULTS["response"] * search.delay) == pytest.approx(closed.step_peak, rel=1e-9)


def test_its_file_flies_the_law_that_was_designed(file: Path) -> None:
    table = read_toml(file)
    assert table["controller"] == "optimal"
    assert table["controller_parameters"] == law().law
    scenario = apply_controller("roll-doublet", file)
    assert scenario.controller_parameters == law().law
    swept = with_values(Scenario.load("roll-doublet"), {"controller": str(file)})
    assert (swept.controller, swept.controller_parameters) == (scenario.controller, scenario.controller_parameters)
    with build(scenario) as simulation:
        (axis, *_) = make_form(simulation)["axes"]
        vehicle, spec = simulation.vehicle, simulation.engine
    assert axis["gains"]["p"] == pytest.approx(law().gains.p, rel=1e-12)
    assert axis["scale"] * vehicle.control.attitude.gain_1_s[0] == pytest.approx(law().angle_gain, rel=1e-12)
    margins = compute_margins(scenario, vehicle, spec, ["roll"])
    assert not isinstance(margins, str)
    after = designed().axes["roll"].after
    assert after is not None
    assert after.margins is not None
    assert margins["roll"].margins.gain_db == pytest.approx(after.margins.gain_db, rel=1e-6)


def test_parameters_that_a_controller_does_not_have_are_refused(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("damping_1", "dampin_1"), encoding="utf-8")
    with pytest.raises(
        InputError, match=r"controller_parameters\.dampin_1: unknown parameter; did you mean 'damping_1'"
    ):
        apply_controller("roll-doublet", file)
    file.write_text(text.replace('controller = "optimal"', 'controller = "smith"', 1), encoding="utf-8")
    with pytest.raises(InputError, match=r"controller_parameters: of controller 'optimal' alone, not of 'smith'"):
        apply_controller("roll-doublet", file)


def test_where_none_keeps_the_requirements_it_says_what_each_would_have_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(at_limit, "RELAXATIONS", (2.5,))
    monkeypatch.setattr(at_limit, "SLOWER_POLES", (1.0,))
    channel, need = designed().axes["roll"].channel, Requirements(min_bandwidth_hz=4.0)
    found = tune_at_limit(channel, law().model, law(), need)
    assert found.tuning is None
    assert found.why_not == "it would take a bandwidth of 1.6 Hz"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"engine": "edf", "start": Path("x.toml")}, "controller optimal: its search begins at the limit"),
        ({"engine": "edf", "aircraft": "jetwing"}, "controller optimal: servos turn the roll of jetwing"),
    ],
)
def test_what_it_is_not_for_is_refused(arguments: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        designs.design(controller="optimal", **arguments)  # type: ignore[arg-type]


def test_no_search_of_gains_begins_at_its_file(file: Path) -> None:
    with pytest.raises(
        InputError, match=r"optimal\.toml: is of controller 'optimal', whose search begins at the limit"
    ):
        designs.design("edf-as-flown", start=file)


def test_an_axis_without_a_limit_says_which_condition_it_does_not_keep() -> None:
    found = designed()
    axes = {
        axis: replace(each, after=each.after and replace(each.after, load_error=1.0 if axis == "roll" else None))
        for axis, each in found.axes.items()
    }
    model = axes["roll"].channel.model("late")
    late = model.model_copy(update={"delay_samples": model.delay_samples + 0.5})
    axes["roll"] = replace(axes["roll"], channel=replace(axes["roll"].channel, identified=late))
    limited = add_limits(replace(found, axes=axes))
    reason = f"roll: a limit needs a delay of whole steps, not {late.delay_samples:g}"
    assert limited.performance == {"roll": reason}
    assert f"no limit of performance: {reason}" in detail_lines(limited)
    assert to_dict(limited)["limit"] == {"roll": {"reason": reason}}


@pytest.mark.long
def test_the_page_ends_with_how_many_times_the_limit_it_is() -> None:
    limited = add_limits(replace(designed()))
    roll = limited.performance["roll"]
    assert not isinstance(roll, str)
    assert roll.times_tolerant is not None
    assert 1.0 < roll.times_tolerant < 1.6
    assert "times the least that any linear controller leaves" in detail_lines(limited)[-1]
    assert answer_lines(limited)[0].startswith("controller: optimal; ")
