"""The bank of engines: the same equations through the C loop, starts, failures in flight, and what it leaves behind."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import engine_tools as tools
import numpy as np
import pytest

from cosim.base.errors import EngineError, InputError
from cosim.engine import EngineBank, EngineSpec, load_engine

pytestmark = pytest.mark.usefixtures("built_engines")


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Mapping[int, Path]:
    return tools.build_faulty(tmp_path_factory.mktemp("faulty"))


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where temporary folders go; it must be empty at the end."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def spec_of(name: str, fmi: int = 3) -> EngineSpec:
    return load_engine(name if fmi == 3 else f"{name}-fmi2", {}, tools.STEP)


@pytest.mark.parametrize("shape", ["step", "ramp", "random"])
@pytest.mark.parametrize(("name", "fmi"), tools.BOTH)
def test_six_engines_follow_the_papers_difference_equation(name: str, fmi: int, shape: str, workplace: Path) -> None:
    # six different throttles, so that no engine can be taken for another
    throttle = np.outer(tools.throttles()[shape], np.linspace(0.1, 1.0, 6))
    with EngineBank(spec_of(name, fmi), 6, tools.STEP) as bank:
        assert bank.reset(0.0).thrust == (0.0,) * 6
        thrust = np.array([bank.step(k, tuple(row)).thrust for k, row in enumerate(throttle.tolist())])
    for i in range(6):
        np.testing.assert_allclose(thrust[:, i], tools.paper_thrust(name, throttle[:, i]), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_bank_and_fmpys_wrappers_agree_bit_for_bit(fmi: int, tmp_path: Path) -> None:
    throttle = tools.throttles()["random"]
    with tools.driven(tools.archive("turbojet", fmi), tmp_path) as engine:
        engine.start()
        expected = engine.run(throttle)
    with EngineBank(spec_of("turbojet", fmi), 1, tools.STEP) as bank:
        bank.reset(0.0)
        thrust = [bank.step(k, (u,)).thrust[0] for k, u in enumerate(throttle.tolist())]
    assert np.array(thrust).tobytes() == expected.tobytes()


@pytest.mark.parametrize("name", ["turbojet", "edf", "edf-as-flown-fmi2"])
def test_reset_starts_in_equilibrium(name: str) -> None:
    spec = load_engine(name, {}, tools.STEP)
    assert spec.start == "throttle_start"
    with EngineBank(spec, 6, tools.STEP) as bank:
        for throttle in (0.45, 0.8):  # twice, to see that a second reset is as good as the first
            steady = bank.reset(throttle).thrust
            assert steady == (pytest.approx(throttle * spec.curve.thrust[-1], rel=1e-9),) * 6
            for k in range(200):
                assert bank.step(k, (throttle,) * 6).thrust == pytest.approx(steady, rel=1e-14)


def test_engines_without_a_start_parameter_are_run_up(faulty: Mapping[int, Path]) -> None:
    """Thrust after the run-up is that of an engine that started there, and flight step 0 comes next."""
    known = spec_of("edf")
    throttle = tools.throttles()["random"].tolist()
    with EngineBank(known, 1, tools.STEP) as bank:
        first = bank.reset(0.4).thrust
        expected = [first, *(bank.step(k, (u,)).thrust for k, u in enumerate(throttle))]
    for path in faulty.values():
        spec = load_engine(str(path), {}, tools.STEP, unchecked=True)
        assert spec.start is None
        with EngineBank(spec, 2, tools.STEP) as bank:
            for _ in range(2):
                first = bank.reset(0.4).thrust
                thrust = [first, *(bank.step(k, (u, u)).thrust for k, u in enumerate(throttle))]
                assert all(a == b for a, b in thrust)
                # settled to 1e-10 of 1 N per window of steps, which is 1e-10 N of the final value for this lag
                np.testing.assert_allclose([a for a, _ in thrust], np.ravel(expected), rtol=0.0, atol=1e-9)


def test_engines_of_different_kinds_in_one_bank() -> None:
    names = ["edf", "turbojet-fmi2", "edf-as-flown"]
    with EngineBank([load_engine(name, {}, tools.STEP) for name in names], 3, tools.STEP) as bank:
        bank.reset(0.0)
        thrust = np.array([bank.step(k, (1.0, 1.0, 1.0)).thrust for k in range(100)])
    for i, name in enumerate(["edf", "turbojet", "edf-as-flown"]):
        np.testing.assert_allclose(thrust[:, i], tools.paper_thrust(name, np.ones(100)), rtol=0.0, atol=1e-12)


def test_parameters_reach_every_engine() -> None:
    spec = load_engine("edf", {"delay_samples": 7, "gain": 0.5}, tools.STEP)
    with EngineBank(spec, 6, tools.STEP) as bank:
        bank.reset(0.0)
        thrust = [bank.step(k, (1.0,) * 6).thrust for k in range(9)]
    assert thrust[6] == (0.0,) * 6
    assert thrust[7] == (pytest.approx(0.5 * tools.NEWTON_PER_KGF),) * 6


def test_a_control_step_of_several_internal_steps() -> None:
    with EngineBank(load_engine("edf", {}, 0.012), 1, 0.012) as coarse:
        coarse.reset(0.0)
        thrust = [coarse.step(k, (1.0,)).thrust[0] for k in range(50)]
    np.testing.assert_allclose(thrust, tools.paper_thrust("edf", np.ones(150))[2::3], rtol=0.0, atol=1e-12)


IN_FLIGHT = {
    "nan": "thrust is not finite at step 812 (3.248 s)",
    "infinite": "thrust is not finite at step 812 (3.248 s)",
    "error": "doStep returned error at step 812 (3.248 s): compressor surge; flame out",
    "fatal": "doStep returned fatal at step 812 (3.248 s)",
    "discard": "doStep returned discard at step 812 (3.248 s)",
    "set": "setting its inputs returned error at step 812 (3.248 s)",
    "get": "getting its outputs returned error at step 812 (3.248 s)",
    "terminate": "it asked to end the simulation at step 812 (3.248 s)",
    "early": "it returned early from doStep and gets no further at step 812 (3.248 s)",
    "pending": "doStep returned pending at step 812 (3.248 s), which is for FMUs that step in the background; these are not supported",
    "event": "it requested event handling, for which it has no mode at step 812 (3.248 s)",
}
ONLY = {2: ("pending",), 3: ("terminate", "early", "event")}


@pytest.mark.parametrize(
    ("fmi", "fault"), [(fmi, fault) for fmi in (2, 3) for fault in IN_FLIGHT if fault not in ONLY[5 - fmi]]
)
def test_a_failure_in_flight_names_engine_step_and_time(faulty: Mapping, fmi: int, fault: str, workplace: Path) -> None:
    spec = load_engine(str(faulty[fmi]), {"fault": tools.FAULTS[fault]}, tools.STEP, unchecked=True)
    with EngineBank(spec, 6, tools.STEP) as bank:
        bank.reset(0.3)
        for k in range(812):
            bank.step(k, (0.6,) * 6)
        with pytest.raises(EngineError) as caught:
            bank.step(812, (0.6, 0.6, tools.FAULT_THROTTLE, 0.6, 0.6, 0.6))
        text, _, reached = str(caught.value).partition("; it came as far as its own time ")
        assert text == f"engine 3 ({faulty[fmi].name}): {IN_FLIGHT[fault]}"
        if fmi == 2 and fault == "discard":  # only FMI 2.0 can ask; this engine has been run up, so its time is ahead
            assert 3.252 < float(reached.removesuffix(" s")) < 60.0
        with pytest.raises(ValueError, match="step 813 after a failure"):
            bank.step(813, (0.6,) * 6)
        bank.reset(0.3)  # fresh instances: the bank can be used again
        assert len(bank.step(0, (0.6,) * 6).thrust) == 6


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("nan", "thrust is not finite at the start"),
        ("set", "fmi{}returned error"),
        ("error", "doStep returned error before the flight: compressor surge; flame out"),
    ],
)
def test_a_failure_at_start_names_the_engine(
    faulty: Mapping[int, Path], fmi: int, fault: str, words: str, workplace: Path
) -> None:
    spec = load_engine(str(faulty[fmi]), {"fault": tools.FAULTS[fault]}, tools.STEP, unchecked=True)
    with EngineBank(spec, 2, tools.STEP) as bank, pytest.raises(EngineError) as caught:
        bank.reset(tools.FAULT_THROTTLE)
    words = words.format("2SetReal " if fmi == 2 else "3SetFloat64 ")
    assert str(caught.value) == f"engine 1 ({faulty[fmi].name}): {words}"


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_warning_is_not_a_failure(faulty: Mapping[int, Path], fmi: int) -> None:
    spec = load_engine(str(faulty[fmi]), {"fault": tools.FAULTS["warning"]}, tools.STEP, unchecked=True)
    with EngineBank(spec, 1, tools.STEP) as bank:
        bank.reset(0.3)
        assert bank.step(0, (tools.FAULT_THROTTLE,)).thrust[0] > 0.0


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_throttle_that_is_not_finite_is_stopped_before_the_engine(value: float) -> None:
    with EngineBank(spec_of("edf"), 2, tools.STEP) as bank:
        bank.reset(0.0)
        with pytest.raises(EngineError, match=r"^engine 2 \(edf\.fmu\): throttle is not finite at step 0 \(0 s\)$"):
            bank.step(0, (0.5, value))


def test_steps_come_one_after_the_other() -> None:
    with EngineBank(spec_of("edf"), 1, tools.STEP) as bank:
        bank.reset(0.0)
        bank.step(0, (0.1,))
        for wrong in (0, 2, -1):
            with pytest.raises(ValueError, match=f"step {wrong}, but 1 is next"):
                bank.step(wrong, (0.1,))
        bank.step(1, (0.1,))
        with pytest.raises(TypeError, match="tuple of 1 throttles"):
            bank.step(2, (0.1, 0.1))


def test_stepping_before_reset_or_after_close_is_an_error() -> None:
    bank = EngineBank(spec_of("edf"), 1, tools.STEP)
    with pytest.raises(EngineError, match="fmi3DoStep is not allowed before initialization"):
        bank.step(0, (0.1,))
    bank.close()
    bank.close()
    with pytest.raises(TypeError):
        bank.step(0, (0.1,))


def test_an_fmu_that_may_be_instantiated_once_gets_libraries_of_its_own(tmp_path: Path, workplace: Path) -> None:
    once = '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '
    path = tools.edit_description(tools.archive("edf", 3), tmp_path / "once.fmu", "<CoSimulation ", once)
    with EngineBank(load_engine(str(path), {}, tools.STEP, unchecked=True), 3, tools.STEP) as bank:
        assert len({instance.fmu.dll._handle for instance in bank._instances}) == 3
        bank.reset(0.0)
        thrust = np.array([bank.step(k, (0.2, 0.5, 1.0)).thrust for k in range(50)])
    np.testing.assert_allclose(thrust[:, 1], tools.paper_thrust("edf", np.full(50, 0.5)), rtol=0.0, atol=1e-12)
    with EngineBank(spec_of("edf"), 3, tools.STEP) as bank:
        assert len({instance.fmu.dll._handle for instance in bank._instances}) == 1


def test_an_archive_that_changed_since_it_was_loaded_is_refused(tmp_path: Path, workplace: Path) -> None:
    path = tmp_path / "engine.fmu"
    path.write_bytes(tools.archive("edf", 3).read_bytes())
    spec = load_engine(str(path), {}, tools.STEP, unchecked=True)
    path.write_bytes(tools.archive("turbojet", 3).read_bytes())
    with pytest.raises(InputError, match=r"engine\.fmu: was changed while it was in use"):
        EngineBank(spec, 6, tools.STEP)
