"""What is said of parameters that lose a vehicle, against the loop's own margins and against what was lost in flight."""

from __future__ import annotations

from functools import lru_cache

import pytest

from cosim.control.autopilot.parameters import table
from cosim.control.predictors.registry import PREDICTORS
from cosim.engine import load_engine
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import engine_of
from hexjet_design.measured.computed import compute_margins
from hexjet_design.measured.judge import LoopJudge


@lru_cache
def judged(aircraft: str) -> tuple[LoopJudge, dict[str, float], dict[str, float]]:
    """A vehicle's judge, its parameters, and the most that each may be."""
    scenario = Scenario.load("hover")  # with the engine that is flown: 0.1 s late
    if aircraft != scenario.aircraft:
        scenario = scenario.replace(aircraft=aircraft, engine=engine_of(aircraft))
    vehicle, _ = scenario.resolved_vehicle()
    family = load_engine(scenario.engine, {}, scenario.step_s).family
    model = vehicle.identified.get(family, {}).get("roll")  # type: ignore[call-overload]
    assert vehicle.control.pilot is not None
    lines = table(vehicle.control, vehicle.control.pilot, scenario.controller, model.delay_samples if model else None)
    return LoopJudge(scenario), {line.name: line.default for line in lines}, {line.name: line.most for line in lines}


# Set in hover, each of these lost the vehicle within ten seconds, leaned it by more than 60 deg or let it climb away.
LOST = [
    ("hexjet", "HJ_ROLL_P", 0.0, "roll"),
    ("hexjet", "HJ_PITCH_P", 0.0, "pitch"),
    ("hexjet", "HJ_PRED_DELAY", 100.0, "roll"),
    ("hexjet-p220", "HJ_ROLL_P", 0.0, "roll"),
    ("hexjet-p220", "HJ_ROLL_P", None, "roll"),
    ("hexjet-p220", "HJ_ROLL_I", None, "roll"),
    ("hexjet-p220", "HJ_ROLL_D", None, "roll"),
    ("hexjet-p220", "HJ_ROLL_D", 0.0, "roll"),
    ("hexjet-p220", "HJ_PITCH_P", 0.0, "pitch"),
    ("hexjet-p220", "HJ_ATT_ROLL", None, "roll"),
    ("hexjet-p220", "HJ_YAW_P", 0.0, "yaw"),
]


@pytest.mark.parametrize(("aircraft", "name", "value", "axis"), LOST)
def test_what_loses_the_vehicle_is_unstable(aircraft: str, name: str, value: float | None, axis: str) -> None:
    """``value`` None: the most that it may be."""
    judge, default, most = judged(aircraft)
    assert judge.tunes_loop(name)
    after = {**default, name: most[name] if value is None else value}
    (caution,) = judge.find_cautions(default, after)
    assert (caution.axis, caution.unstable, caution.was_stable) == (axis, True, True)
    assert caution.text == f"{axis}: the loop is unstable"
    assert judge.find_cautions(after, default) == []  # the way back is open


@pytest.mark.parametrize("aircraft", ["hexjet", "hexjet-p220", "quadrotor", "jetwing"])
def test_a_little_more_or_less_of_a_gain_is_taken_without_a_word(aircraft: str) -> None:
    judge, default, _ = judged(aircraft)
    names = [name for name in default if judge.tunes_loop(name) and name not in ("HJ_PRED_TYPE", "HJ_PRED_DELAY")]
    assert len(names) > 12
    for name in names:
        for factor in (0.95, 1.05):
            assert judge.find_cautions(default, {**default, name: factor * default[name]}) == [], (name, factor)
    for name in ("HJ_LEAN_MAX", "HJ_FUEL_LOW", "MPC_XY_VEL_MAX", "HJ_RLIM_ROLL"):
        assert not judge.tunes_loop(name)


@pytest.mark.parametrize("axis", ["pitch", "yaw"])
def test_the_verdict_turns_at_the_gain_margin_of_the_loop(axis: str) -> None:
    """Without a predictor, all gains of the rate law times a factor is a gain of the whole loop: unstable from its margin."""
    judge, default, _ = judged("hexjet")
    scenario = Scenario.load("hover")
    vehicle, _ = scenario.resolved_vehicle()
    known = compute_margins(scenario, vehicle, load_engine(scenario.engine, {}, scenario.step_s), [axis])
    assert isinstance(known, dict)
    margin = known[axis].margins.gain_db
    assert margin is not None
    for decibel, unstable in ((margin - 0.1, False), (margin + 0.1, True)):
        factor = 10.0 ** (decibel / 20.0)
        after = {
            **default,
            **{f"HJ_{axis.upper()}_{term}": factor * default[f"HJ_{axis.upper()}_{term}"] for term in "PID"},
        }
        (caution,) = judge.find_cautions(default, after)
        assert caution.unstable is unstable
        if not unstable:
            assert caution.text.startswith(f"{axis}: gain margin 0.1 dB")


@pytest.mark.parametrize("controller", ["own", "lqg", "mpc", "state", "smith"])
def test_the_height_is_judged_whatever_the_controller(controller: str) -> None:
    scenario = Scenario.load("hover").replace(controller=controller)
    judge, (_, default, _) = LoopJudge(scenario), judged("hexjet")
    judge.prepare()
    assert judge.tunes_loop("HJ_ALT_P")
    for name, value, text in (
        ("HJ_ALT_P", 0.0, "a gain of 0: nothing brings it back"),
        ("HJ_CLIMB_P", 0.0, "the loop is unstable"),
        ("HJ_CLIMB_P", 10.0 * default["HJ_CLIMB_P"], "the loop is unstable"),
    ):
        after = {**default, name: value, "HJ_PRED_TYPE": kind_of(controller, default)}
        (caution,) = judge.find_cautions({**after, name: default[name]}, after)
        assert caution == ("altitude", True, True, f"altitude: {text}")


@pytest.mark.parametrize("controller", ["own", "lqg", "mpc"])
def test_a_law_from_outside_leaves_the_height_alone_to_judge(controller: str) -> None:
    judge = LoopJudge(Scenario.load("hover").replace(controller=controller))
    assert not judge.tunes_loop("HJ_ROLL_P")
    assert not judge.tunes_loop("HJ_ATT_YAW")


def test_a_predictor_without_a_response_leaves_the_other_axes_to_judge() -> None:
    judge, (_, default, _) = LoopJudge(Scenario.load("hover").replace(controller="state")), judged("hexjet")
    before = {**default, "HJ_PRED_TYPE": kind_of("state", default)}
    assert judge.find_cautions(before, {**before, "HJ_ROLL_P": 0.0}) == []
    (caution,) = judge.find_cautions(before, {**before, "HJ_PITCH_P": 0.0})
    assert (caution.axis, caution.was_stable) == ("pitch", True)
    # from what cannot be computed to what is unstable
    (lost,) = judge.find_cautions({**before, "HJ_ROLL_P": 0.0}, {**default, "HJ_ROLL_P": 0.0})
    assert (lost.axis, lost.was_stable) == ("roll", True)


def kind_of(controller: str, default: dict[str, float]) -> float:
    """Return HJ_PRED_TYPE of a controller."""
    spec = PREDICTORS.get(controller)
    return default["HJ_PRED_TYPE"] if spec is None else float(spec.value)
