"""A predictor is known in one place: one from elsewhere flies, is offered, tuned, designed and varied by its name."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from places import ROOT

from cosim import Scenario, fly
from cosim.base.errors import InputError
from cosim.campaign.study.keys import find_key
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import flights
from cosim.campaign.workers.flight_row import fly_one
from cosim.control.autopilot.parameters import Parameters, table
from cosim.control.predictors.registry import PREDICTORS, PredictorSpec, TuningParameter
from cosim.control.predictors.smith import FilteredSmithPredictor, NoPredictor, robustness_filter
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.vehicle import load_vehicle
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid, steps_by_response
from hexjet_design.loop.criteria import excess, objective
from hexjet_design.loop.tuning import Tuning, candidates
from hexjet_design.tune import TuningBounds

FIXED = {"baseline": 0, "smith": 1, "filtered-smith": 2, "state": 3, "state-model": 4, "state-disturbance": 5}
TAU = TuningParameter("tau_s", "s", "time constant of its filter", 0.0, 2.0, (0.05, 5.0), 0.15, mavlink="HJ_PRED_MINE")
FILTERED = PREDICTORS["filtered-smith"]


def _response(model: Any, own: Mapping[str, float]) -> Any:
    return FILTERED.response(model, {"filter_s": own["tau_s"]})


MINE = PredictorSpec(
    "mine",
    "the filtered predictor under another name",
    lambda model, own: FilteredSmithPredictor(model, *robustness_filter(model, own["tau_s"])),
    parameters=(TAU,),
    response=_response,
)
PLAIN = PredictorSpec(
    "plain", "the measurement, by a predictor of one's own", lambda model, own: NoPredictor(), needs_model=False
)


@pytest.fixture
def mine() -> Iterator[PredictorSpec]:
    PREDICTORS.register(MINE)
    yield MINE
    PREDICTORS.forget("mine")


@pytest.fixture
def plain() -> Iterator[PredictorSpec]:
    PREDICTORS.register(PLAIN)
    yield PLAIN
    PREDICTORS.forget("plain")


def roll(controller: str, **changes: Any) -> np.ndarray:
    doublet = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.04, "amplitude": 8.0, "width_s": 0.1}
    scenario = Scenario.load("roll-doublet").replace(
        controller=controller, duration_s=0.6, command=[doublet], expect=[], **changes
    )
    return np.asarray(fly(scenario).log["roll_rad"])


def test_the_numbers_over_mavlink_stay_what_they_are() -> None:
    """A parameter file of last year means the same predictor."""
    assert {name: PREDICTORS[name].value for name in FIXED} == FIXED
    assert MINE.value == 32891  # of its name alone, whatever else is registered


def test_every_predictor_is_described() -> None:
    for name, spec in PREDICTORS.items():
        assert spec.name == name
        assert spec.title
        assert (spec.response is None) == (spec.space is None)


def test_no_other_module_compares_a_predictors_name() -> None:
    """Whoever wants to know what a predictor is like asks the registry; the paper's own experiments are about some by name."""
    found = []
    for path in (ROOT / "cosim").rglob("*.py"):
        if "paper" in path.parts or path.name == "registry.py":
            continue
        text, names = path.read_text(encoding="utf-8"), set(FIXED) - {"state"}
        if not any(name in text for name in names):
            continue  # it need not be parsed
        for node in ast.walk(ast.parse(text)):
            if (
                isinstance(node, ast.Compare)
                and {c.value for c in ast.walk(node) if isinstance(c, ast.Constant) and isinstance(c.value, str)}
                & names
            ):
                found.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not found


def test_one_from_elsewhere_flies_as_what_it_is(mine: PredictorSpec) -> None:
    assert np.array_equal(roll("mine"), roll("filtered-smith"))
    own, theirs = {"own": {"mine": {"tau_s": 0.6}}}, {"filter_s": 0.6}
    slow, other = ({"control": {"predictor": each}} for each in (own, theirs))
    assert np.array_equal(roll("mine", vehicle=slow), roll("filtered-smith", vehicle=other))


def test_one_that_needs_no_model_flies_with_any_engine(plain: PredictorSpec) -> None:
    assert np.array_equal(roll("plain", engine="turbojet"), roll("baseline", engine="turbojet"))


def test_what_it_lacks_is_said_in_one_line(mine: PredictorSpec, plain: PredictorSpec) -> None:
    message = r"controller 'mine' needs an identified model of hexjet with engine 'turbojet'"
    with pytest.raises(InputError, match=message):
        roll("mine", engine="turbojet")
    from hexjet_design.design import design

    message = r"controller plain: states no frequency response, which a design needs; allowed: auto, "
    with pytest.raises(InputError, match=message):
        design("edf", controller="plain")


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"nine": {"tau_s": 1.0}}, r"predictor\.own\.nine: unknown predictor; did you mean 'mine'\?"),
        ({"mine": {"tua_s": 1.0}}, r"own\.mine\.tua_s: unknown parameter; did you mean 'tau_s'\?"),
        ({"mine": {"tau_s": 3.0}}, r"own\.mine\.tau_s = 3: must be from 0 to 2 s"),
        ({"smith": {"tau_s": 1.0}}, r"own\.smith\.tau_s: unknown parameter; there are none"),
        ({"mine": {"tau_s": "x"}}, r"tau_s = 'x'"),
    ],
)
def test_wrong_tuning_is_refused(mine: PredictorSpec, own: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        roll("mine", vehicle={"control": {"predictor": {"own": own}}})


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (replace(MINE, name="smith"), "predictor 'smith': there is one of this name already"),
        (replace(MINE, name="My own"), "predictor 'My own': a name has small letters"),
        (replace(MINE, title=" "), "title = ' ': must be one line"),
        (replace(MINE, number=3), "its number 3 is that of 'state'; state another"),
        (
            replace(MINE, parameters=(replace(TAU, mavlink="MINE_TAU"),)),
            "mavlink = 'MINE_TAU': must begin with HJ_PRED_",
        ),
        (replace(MINE, parameters=(replace(TAU, mavlink="HJ_PRED_FILT"),)), "mavlink = 'HJ_PRED_FILT': must begin"),
        (replace(MINE, parameters=(replace(TAU, default=None),)), "tau_s: needs a default from 0 to 2"),
        (
            replace(MINE, parameters=(replace(TAU, search=(0.0, 1.0)),)),
            r"search = \(0.0, 1.0\): must be two numbers above 0",
        ),
    ],
)
def test_what_could_not_be_told_apart_is_not_registered(spec: PredictorSpec, message: str) -> None:
    with pytest.raises(InputError, match=message):
        PREDICTORS.register(spec)
    assert "mine" not in PREDICTORS


def test_a_ground_station_is_offered_it(mine: PredictorSpec) -> None:
    vehicle, _ = load_vehicle("hexjet")
    parameters = Parameters(table(vehicle.control, vehicle.control.pilot, "mine", 25.0))
    assert parameters["HJ_PRED_TYPE"] == MINE.value
    assert (MINE.value, "mine") in parameters.table["HJ_PRED_TYPE"].values
    assert parameters["HJ_PRED_MINE"] == 0.15
    assert parameters.table["HJ_PRED_MINE"].text == "mine: time constant of its filter"
    numbers = sorted(spec.value for spec in PREDICTORS.values())
    assert numbers[-1] == MINE.value
    none = numbers[-2] + 1
    with pytest.raises(InputError, match=f"HJ_PRED_TYPE = {none}: must be one of {', '.join(map(str, numbers))}"):
        parameters.set("HJ_PRED_TYPE", none)


@pytest.fixture(scope="module")
def loop() -> tuple[Channel, Tuning]:
    """The roll channel with EDF engines, and the aircraft's own gains on it."""
    from cosim.engine import load_engine
    from hexjet_design.assessment import predictor_model, shipped_tuning
    from hexjet_design.design import _scenario, identify_hover, make_dynamics
    from hexjet_design.loop.actuator import Actuator
    from hexjet_design.loop.channel import channels

    scenario, vehicle = _scenario("edf", "hexjet", [])
    spec = load_engine(scenario.engine, scenario.engine_parameters, scenario.step_s)
    actuator = Actuator.of(spec.name, make_dynamics(identify_hover(scenario, vehicle, spec, None)))
    channel = channels(scenario, vehicle, spec, actuator)["roll"]
    return channel, replace(shipped_tuning(channel, vehicle, spec), model=predictor_model(channel, "test"))


@pytest.mark.parametrize("name", candidates())
def test_responses_in_time_from_the_frequency_response_are_those_of_the_state_space(name: str, loop: tuple) -> None:
    """So a predictor that states its frequency response alone is designed with what is exact for the others."""
    closed = ClosedLoop(FrequencyGrid(loop[0]), replace(loop[1], controller=name))
    assert not closed.unstable_poles
    exact = closed.steps
    found = steps_by_response(closed.points.channel, closed.tuning, len(exact.angle))
    for ours, theirs in zip(found, exact, strict=True):
        assert np.abs(ours - theirs).max() < 1e-8 * np.abs(theirs).max()  # FADED, and rounding grown by its root


def test_a_design_searches_and_measures_it_like_the_one_that_it_is(mine: PredictorSpec, loop: tuple) -> None:
    """The same box for its parameter, and the same objective and requirements, once with a state space and once without."""
    channel, start = loop
    need = Requirements()
    theirs = TuningBounds(channel, "filtered-smith", start.model, start, predictor=True)
    ours = TuningBounds(channel, "mine", start.model, start, predictor=True)
    assert np.array_equal(ours.low, theirs.low)
    assert np.array_equal(ours.high, theirs.high)
    for share in (0.3, 0.5, 0.6):
        x = ours.low + share * (ours.high - ours.low)
        one, other = ours.tuning(x), theirs.tuning(x)
        expected = (other.gains, other.angle_gain, other.predictor.filter_s)
        assert (one.gains, one.angle_gain, MINE.own(one.predictor)["tau_s"]) == expected
        a, b = ClosedLoop(FrequencyGrid(channel), one), ClosedLoop(FrequencyGrid(channel), other)
        assert a.unstable_poles == b.unstable_poles
        if not b.unstable_poles:
            assert objective(a) == pytest.approx(objective(b), rel=1e-7)
            assert excess(a, need) == pytest.approx(excess(b, need), rel=1e-7)


def test_a_study_varies_what_it_is_tuned_with(mine: PredictorSpec) -> None:
    key = find_key(Scenario.load("hover"), "vehicle.control.predictor.own.mine.tau_s")
    assert (key.nominal, key.unit, key.low, key.high) == (0.15, "s", 0.0, 2.0)
    vary = "vehicle.control.predictor.own.mine.tau_s=0.1:0.6"
    study = open_study("hover", vary=[vary], controllers=["mine", "smith"], runs=2, settings=["duration_s=0.2"])
    rows = [fly_one(study, flight) for flight in flights(study)]
    assert [row["outcome"] for row in rows] == ["completed"] * 4
    assert {row["controller"] for row in rows} == {"mine", "smith"}
    assert len({row[vary.split("=")[0]] for row in rows}) == 2
