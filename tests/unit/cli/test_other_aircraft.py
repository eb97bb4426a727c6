"""--aircraft over a scenario that was written for another: its engine, and a controller that it can fly with."""

from __future__ import annotations

import pytest

from cosim.api.call.choices import load_scenario
from cosim.base.errors import InputError
from cosim.simulation.build import build
from hexjet_export.controller.form import make_form


@pytest.mark.parametrize(
    ("aircraft", "controller", "settings", "flown"),
    [
        ("trijet", None, (), "baseline"),  # it states no model, and the scenario's predictor needs one
        ("octojet", None, (), "smith"),
        ("trijet", None, ("controller=adrc",), "adrc"),
        ("trijet", "smith", (), "smith"),  # asked for: refused below
    ],
)
def test_which_controller_flies(aircraft: str, controller: str | None, settings: tuple[str, ...], flown: str) -> None:
    notes: list[str] = []
    scenario = load_scenario("roll-doublet", controller, (), None, settings, None, aircraft, notes.append)
    assert scenario.controller == flown
    assert any("flown with baseline" in note for note in notes) == (flown == "baseline")


def test_a_predictor_without_a_model_is_refused_with_what_there_is() -> None:
    with pytest.raises(InputError, match=r"engine 'turbine-20'; there are none; one is made"):
        build(load_scenario("roll-doublet", "smith", (), None, (), None, "trijet"))


def test_what_has_no_form_in_c_says_what_to_do_instead() -> None:
    with (
        build(load_scenario("roll-doublet", None, (), None, (), None, "jetwing")) as simulation,
        pytest.raises(InputError, match=r"^jetwing: surfaces have no C form; with loops the"),
    ):
        make_form(simulation)
