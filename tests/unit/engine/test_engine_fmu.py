"""The engine FMUs themselves, driven by FMPy's own wrappers: equations, delay, states, refusals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import fmpy
import numpy as np
import pytest
from engine_tools import BOTH, NEWTON_PER_KGF, PAPER, STEP, Driven, archive, driven, paper_thrust, throttles
from fmpy.fmi1 import FMICallException

pytestmark = pytest.mark.usefixtures("built_engines")


@pytest.fixture(params=[2, 3], ids=["fmi2", "fmi3"])
def edf(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Driven]:
    with driven(archive("edf-as-flown", request.param), tmp_path) as it:
        yield it


@pytest.mark.parametrize("shape", ["step", "ramp", "random"])
@pytest.mark.parametrize(("name", "fmi"), BOTH)
def test_thrust_is_the_papers_difference_equation(name: str, fmi: int, shape: str, tmp_path: Path) -> None:
    throttle = throttles()[shape]
    with driven(archive(name, fmi), tmp_path) as engine:
        engine.start()
        thrust = engine.run(throttle)
    # the same few operations in another order: some rounding errors of 20 N
    np.testing.assert_allclose(thrust, paper_thrust(name, throttle), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("delay", [0, 1, 999, 1000])
@pytest.mark.parametrize("fmi", [2, 3])
def test_any_delay_of_the_declared_range(fmi: int, delay: int, tmp_path: Path) -> None:
    random = np.random.default_rng(7).uniform(0.0, 1.0, 2100)
    with driven(archive("edf", fmi), tmp_path) as engine:
        engine.start()
        undelayed = engine.run(random)
    with driven(archive("edf", fmi), tmp_path) as engine:
        engine.start(delay_samples=delay)
        delayed = engine.run(random)
    assert not delayed[:delay].any()
    assert delayed[delay:].tobytes() == undelayed[: len(random) - delay].tobytes()


@pytest.mark.parametrize(("name", "fmi"), BOTH)
def test_the_papers_numbers_and_what_a_master_may_do_are_described(name: str, fmi: int) -> None:
    description = fmpy.read_model_description(str(archive(name, fmi)))
    variables = {v.name: v for v in description.modelVariables}
    newton = {u.name: u.baseUnit for u in description.unitDefinitions}["N"]
    assert (newton.kg, newton.m, newton.s, newton.factor) == (1, 1, -2, 1.0)
    gain, pole, delay = PAPER[name]
    found = [float(variables[key].start) for key in ("gain", "pole", "delay_samples", "newton_per_unit")]
    assert found == [gain, pole, delay, NEWTON_PER_KGF]
    assert (variables["delay_samples"].min, variables["delay_samples"].max) == ("0", "1000")
    assert float(description.defaultExperiment.stepSize) == STEP
    assert description.coSimulation.canGetAndSetFMUstate
    assert description.coSimulation.canSerializeFMUstate
    assert description.coSimulation.canHandleVariableCommunicationStepSize == (fmi == 3)
    assert fmi == 2 or float(description.coSimulation.fixedInternalStepSize) == STEP


def test_outputs_follow_the_parameters_in_initialization_mode(edf: Driven) -> None:
    if edf.fmi == 2:
        edf.fmu.setupExperiment()
    edf.fmu.enterInitializationMode()
    for start in (0.2, 0.6):
        edf.set("throttle_start", start)
        assert edf.get("thrust") == pytest.approx(start * 2.039936102236422 * NEWTON_PER_KGF, rel=1e-13)


def test_throttle_is_limited_at_the_input(edf: Driven) -> None:
    edf.start()
    beyond = edf.run(np.concatenate([np.full(100, 7.0), np.full(100, -3.0)]))
    np.testing.assert_array_equal(beyond, _again(edf, np.concatenate([np.ones(100), np.zeros(100)])))


def _again(engine: Driven, throttle: np.ndarray) -> np.ndarray:
    engine.fmu.reset()
    engine.start()
    return engine.run(throttle)


def test_reset_brings_back_start_values_and_state(edf: Driven) -> None:
    edf.start()
    first = edf.run(throttles()["random"])
    edf.fmu.reset()
    edf.start(gain=0.5, delay_samples=3, throttle_start=1.0)
    assert edf.run(throttles()["random"]).tobytes() != first.tobytes()
    assert _again(edf, throttles()["random"]).tobytes() == first.tobytes()


def test_a_step_of_several_internal_steps_is_those_steps(edf: Driven) -> None:
    edf.start()
    fine = edf.run(np.repeat([0.3, 0.9], 30))
    edf.fmu.reset()
    edf.start()
    coarse = [float(edf.run(np.array([u]), first=k, step=30 * STEP)[0]) for k, u in enumerate([0.3, 0.9])]
    assert coarse == [fine[29], fine[59]]


def test_time_is_counted_not_accumulated(edf: Driven) -> None:
    edf.start(start_time=3.0)
    for k in range(1000):
        edf.fmu.doStep(3.0 + k * STEP, STEP)
    assert edf.get("time") == 3.0 + 1000 * STEP


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (0.005, "communication step 0.005 s is not a whole multiple of the internal step 0.004 s"),
        (0.002, "communication step 0.002 s is not a whole multiple of the internal step 0.004 s"),
        (0.0, "communication step 0 s is not a whole multiple of the internal step 0.004 s"),
        (-0.004, "communication step -0.004 s is not a whole multiple of the internal step 0.004 s"),
        (STEP * (1 + 1e-8), "communication step 0.00400000004 s is not a whole multiple of the internal step 0.004 s"),
        (math.nan, "communication step nan s is not a whole multiple of the internal step 0.004 s"),
        (math.inf, "communication step inf s is not a whole multiple of the internal step 0.004 s"),
    ],
)
def test_a_step_that_does_not_fit_is_refused(edf: Driven, step: float, words: str) -> None:
    edf.start()
    with pytest.raises(FMICallException, match=r"DoStep failed with status 3 \(error\)"):
        edf.fmu.doStep(0.0, step)
    assert edf.messages == [words]


@pytest.mark.parametrize("factor", [1 + 5e-10, 1 - 5e-10])
def test_a_step_within_rounding_is_accepted(edf: Driven, factor: float) -> None:
    edf.start()
    edf.fmu.doStep(0.0, STEP * factor)
    edf.fmu.doStep(STEP * factor, 3 * STEP * factor)
    assert edf.get("time") == 4 * STEP


@pytest.mark.parametrize("point", [STEP, -STEP, 1e-10, math.nan])
def test_a_step_from_elsewhere_is_refused(edf: Driven, point: float) -> None:
    edf.start()
    with pytest.raises(FMICallException, match="error"):
        edf.fmu.doStep(point, STEP)
    assert edf.messages == [f"communication point {point:.10g} s is not where the engine stands, 0 s"]


def test_the_stop_time_is_kept(edf: Driven) -> None:
    edf.start(stop_time=2 * STEP)
    edf.run(np.ones(2))
    with pytest.raises(FMICallException):
        edf.fmu.doStep(2 * STEP, STEP)
    assert edf.messages == ["a step to 0.012 s passes the stop time 0.008 s"]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("variable", ["throttle", "gain", "throttle_start"])
def test_what_is_not_finite_is_refused(edf: Driven, variable: str, value: float) -> None:
    with pytest.raises(FMICallException):
        edf.set(variable, value)
    assert edf.messages == [f"{variable} is not finite"]


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("pole", 1.0, "pole = 1 is outside 0 to 0.999999"),
        ("gain", -0.1, "gain = -0.1 is outside 0 to 1000"),
        ("delay_samples", 1001, "delay_samples = 1001 is outside 0 to 1000"),
        ("delay_samples", -1, "delay_samples = -1 is outside 0 to 1000"),
        ("throttle_start", 1.5, "throttle_start = 1.5 is outside 0 to 1"),
        ("thrust", 1.0, "thrust cannot be set before initialization"),
        ("time", 1.0, "time cannot be set before initialization"),
    ],
)
def test_values_out_of_range_are_refused(edf: Driven, variable: str, value: float, words: str) -> None:
    with pytest.raises(FMICallException):
        edf.set(variable, value)
    assert edf.messages == [words]


def test_parameters_are_fixed_once_the_engine_runs(edf: Driven) -> None:
    edf.start()
    with pytest.raises(FMICallException):
        edf.set("gain", 0.3)
    assert edf.messages == ["gain cannot be set while stepping"]


@pytest.mark.parametrize(
    ("prepare", "call", "words"),
    [
        ([], "doStep", "DoStep is not allowed before initialization"),
        ([], "exitInitializationMode", "ExitInitializationMode is not allowed before initialization"),
        ([], "terminate", "Terminate is not allowed before initialization"),
        (["start"], "enterInitializationMode", "EnterInitializationMode is not allowed while stepping"),
        (["start", "terminate"], "doStep", "DoStep is not allowed after termination"),
        (["start", "terminate"], "terminate", "Terminate is not allowed after termination"),
    ],
)
def test_calls_out_of_order_are_refused(edf: Driven, prepare: list[str], call: str, words: str) -> None:
    for name in prepare:
        getattr(edf, name, getattr(edf.fmu, name, None))()
    with pytest.raises(FMICallException):
        getattr(edf.fmu, call)(*((0.0, STEP) if call == "doStep" else ()))
    assert edf.messages == [f"fmi{edf.fmi}{words}"]


def test_after_an_error_only_a_reset_or_a_restored_state_leads_on(edf: Driven) -> None:
    edf.start()
    edf.run(np.ones(30))
    saved = edf.fmu.getFMUState()
    expected = edf.run(np.ones(30), first=30)
    for rescue in (lambda: edf.fmu.setFMUState(saved), None):
        with pytest.raises(FMICallException):
            edf.fmu.doStep(99.0, STEP)
        with pytest.raises(FMICallException):
            edf.fmu.doStep(60 * STEP, STEP)
        assert edf.messages[-1] == f"fmi{edf.fmi}DoStep is not allowed after an error"
        if rescue:
            rescue()
            assert edf.run(np.ones(30), first=30).tobytes() == expected.tobytes()
    assert _again(edf, np.ones(60))[30:].tobytes() == expected.tobytes()
    edf.fmu.freeFMUState(saved)


def test_fmi2_lets_nothing_be_read_before_initialization(tmp_path: Path) -> None:
    with driven(archive("edf", 2), tmp_path) as engine, pytest.raises(FMICallException):
        engine.get("thrust")
    with driven(archive("edf", 3), tmp_path / "3") as engine:  # FMI 3.0 allows it: the start values
        assert engine.get("gain") == 0.2554


def test_a_wrong_token_is_refused(tmp_path: Path) -> None:
    for fmi in (2, 3):
        with driven(archive("edf", fmi), tmp_path / str(fmi)) as engine:
            engine.fmu.guid = "{00000000-0000-0000-0000-000000000000}"
            component = engine.fmu.component
            with pytest.raises(Exception, match="Failed to instantiate"):
                engine.instantiate()
            assert engine.messages == [f"the {'guid' if fmi == 2 else 'instantiation token'} is not that of this FMU"]
            engine.fmu.component = component


def test_no_messages_unless_asked_for(tmp_path: Path) -> None:
    for fmi in (2, 3):
        with driven(archive("edf", fmi), tmp_path / str(fmi), logging=False) as engine:
            with pytest.raises(FMICallException):
                engine.set("gain", math.nan)
            assert engine.messages == []


def test_a_saved_state_continues_in_another_instance_bit_for_bit(edf: Driven, tmp_path: Path) -> None:
    throttle = throttles()["random"]
    edf.start(gain=0.31, throttle_start=0.4)
    edf.run(throttle[:200])
    state = edf.fmu.getFMUState()
    expected = edf.run(throttle[200:], first=200)
    data = edf.fmu.serializeFMUState(state)
    edf.fmu.freeFMUState(state)
    with driven(archive("edf-as-flown", edf.fmi), tmp_path) as other:
        restored = other.fmu.deserializeFMUState(data)
        other.fmu.setFMUState(restored)
        assert other.run(throttle[200:], first=200).tobytes() == expected.tobytes()
        assert other.fmu.serializeFMUState(restored) == data
        other.fmu.freeFMUState(restored)


def test_the_state_of_another_engine_is_refused(edf: Driven, tmp_path: Path) -> None:
    with driven(archive("turbojet", edf.fmi), tmp_path / "other") as other:
        state = other.fmu.getFMUState()
        data = other.fmu.serializeFMUState(state)
        other.fmu.freeFMUState(state)
    with pytest.raises(FMICallException):
        edf.fmu.deserializeFMUState(data)
    assert edf.messages == ["this is not a serialized state of this engine"]


def test_a_damaged_state_is_refused_wherever_the_damage_is(edf: Driven) -> None:
    """A delay's index beyond its line once made an instance write outside its memory."""
    edf.start()
    state = edf.fmu.getFMUState()
    data = edf.fmu.serializeFMUState(state)
    edf.fmu.freeFMUState(state)
    for place in (*range(40, len(data), 97), len(data) - 9, len(data) - 1):
        edf.messages.clear()
        with pytest.raises(FMICallException):
            edf.fmu.deserializeFMUState(data[:place] + bytes([data[place] ^ 0x40]) + data[place + 1 :])
        assert edf.messages[0].endswith(("not a serialized state of this engine", "its checksum does not fit"))


def test_a_step_may_be_the_difference_of_large_times(edf: Driven) -> None:
    """From a day on: what the times cannot hold of a step is no fault of the master's."""
    times = 86400.0 + STEP * np.arange(500)
    edf.start(start_time=86400.0)
    thrusts = []
    for here, there in pairwise(times):
        edf.set("throttle", 0.5)
        edf.fmu.doStep(here, there - here)
        thrusts.append(edf.get("thrust"))
    assert np.array(thrusts) == pytest.approx(paper_thrust("edf-as-flown", np.full(499, 0.5)), rel=1e-12)
    with pytest.raises(FMICallException):
        edf.fmu.doStep(times[-1], STEP * (1.0 + 1e-6))


def test_what_is_not_provided_says_so(tmp_path: Path) -> None:
    with driven(archive("edf", 3), tmp_path / "3") as engine:
        engine.start()
        with pytest.raises(FMICallException):
            engine.fmu.enterEventMode()
        assert engine.messages == ["fmi3EnterEventMode is not provided"]
    with driven(archive("edf", 2), tmp_path / "2") as engine:
        engine.start()
        with pytest.raises(FMICallException):
            engine.fmu.getDirectionalDerivative([2], [1], [1.0])
        assert engine.messages == ["fmi2GetDirectionalDerivative is not provided"]


def test_fmi2_answers_for_its_last_successful_time(tmp_path: Path) -> None:
    with driven(archive("edf", 2), tmp_path) as engine:
        engine.start()
        engine.run(np.ones(5))
        assert engine.fmu.getRealStatus(2) == 5 * STEP
        assert engine.fmu.getBooleanStatus(3) is False
