"""One FMU that holds several engines: one instance for as many stations, with what is each engine's own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from engine_tools import STEP
from foreign_engines import ARRAYS, FULL, SIX, Row, foreign, lever, mapped

from cosim import Scenario, fly
from cosim.base.errors import EngineError, InputError
from cosim.base.signals import Ambient
from cosim.engine import EngineBank, EngineSpec, IsolatedBank, load_engine
from cosim.engine.qualify import check
from cosim.engine.qualify.trial import run_task
from cosim.results.log.digest import log_digest
from cosim.stepper import Stepper

LISTED = ("[ports]", "throttle = ['u0', 'u1', 'u2', 'u3', 'u4', 'u5']", "thrust = ['F0', 'F1', 'F2', 'F3', 'F4', 'F5']")
NUMBERED = ("[ports]", "throttle = 'u*'", "thrust = 'F*'")
ELEMENTS = ("[ports]", "throttle = 'u[*]'", "thrust = 'F[*]'")
RUNS: list[Row] = [(f"on{k}", f"runs[{k}]", "input", 'min="0" max="1" start="1"') for k in range(6)]
HELD = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("in-one")


def load(path: Path, *lines: str) -> EngineSpec:
    return load_engine(str(mapped(path, *lines) if lines else path), {}, STEP, unchecked=True)


def all_six(spec: EngineSpec) -> list[EngineSpec]:
    return [spec.at_station(station) for station in range(6)]


def throttles(steps: int) -> list[tuple[float, ...]]:
    random = np.random.default_rng(5)
    return [
        tuple(held + 0.1 * each for held, each in zip(HELD, row, strict=True))
        for row in random.uniform(size=(steps, 6))
    ]


@pytest.mark.parametrize(("rows", "fmi", "lines"), [(SIX, 2, LISTED), (SIX, 2, NUMBERED), (ARRAYS, 3, ELEMENTS)])
def test_six_engines_of_one_instance_are_six_of_one_each(
    rows: list[Row], fmi: int, lines: Sequence[str], place: Path
) -> None:
    """The same equations in six instances, within what a run-up leaves; at most six lines of mapping say it."""
    made_of = "lag=0.1,delay=0.02"
    spec = load(foreign(place, f"six{fmi}{len(rows)}", f"{made_of},engines=6", rows, fmi), *lines)
    assert len(lines) + 1 <= 6
    alone = load(foreign(place, "alone", made_of))
    with EngineBank(all_six(spec), 6, STEP) as one, EngineBank(alone, 6, STEP) as six:
        assert (len(one._instances), len(six._instances)) == (1, 6)
        assert one.reset(HELD).thrust == pytest.approx(six.reset(HELD).thrust, abs=1e-9)
        for k, each in enumerate(throttles(60)):
            assert one.step(k, each).thrust == pytest.approx(six.step(k, each).thrust, abs=1e-9)


def test_each_has_its_own_static_curve_and_they_may_take_from_each_other(place: Path) -> None:
    """``F_i = 20 (1 - 0.05 i) u_i (1 - 0.2 mean(u))``: what no instance for each could do."""
    spec = load(foreign(place, "uneven", "lag=0.05,engines=6,uneven=0.05,coupled=0.2", SIX), *NUMBERED)
    stations = all_six(spec)
    for i, each in enumerate(stations):
        assert each.slot == i
        for u, thrust in zip(*each.curve, strict=True):  # measured while all have the same throttle
            assert thrust == pytest.approx(FULL * (1.0 - 0.05 * i) * u * (1.0 - 0.2 * u), abs=1e-7)
    with EngineBank(stations, 6, STEP) as bank:
        given = bank.reset(HELD).thrust
    wanted = [FULL * (1.0 - 0.05 * i) * u * (1.0 - 0.2 * np.mean(HELD)) for i, u in enumerate(HELD)]
    assert given == pytest.approx(wanted, abs=1e-7)
    with EngineBank(stations[2], 1, STEP) as bank:  # alone, as it is identified: the others stand where it stands
        assert bank.reset(0.5).thrust[0] == pytest.approx(FULL * 0.9 * 0.5 * 0.9, abs=1e-7)
        assert bank.step(0, (0.5,)).thrust[0] == pytest.approx(FULL * 0.9 * 0.5 * 0.9, abs=1e-7)


def test_two_instances_and_a_stranger_between(place: Path) -> None:
    """Eight stations on an FMU of two; with another engine at station 3 the second instance's first stands still."""
    rows = [*SIX[:2], *SIX[6:8]]
    spec = load(foreign(place, "two", "lag=0.05,engines=2,coupled=0.5", rows), *NUMBERED)
    other = load_engine("edf", {}, STEP)
    stations = [spec.at_station(0), spec.at_station(1), other, spec.at_station(3)]
    with EngineBank(stations, 4, STEP) as bank:
        assert len(bank._instances) == 3
        thrust = bank.reset(0.5).thrust
        assert thrust[:2] == pytest.approx((5.0 * 1.5, 5.0 * 1.5), abs=1e-7)
        assert thrust[3] == pytest.approx(10.0 * (1.0 - 0.5 * 0.25), abs=1e-7)  # its companion takes nothing
    with EngineBank(spec, 8, STEP) as bank:
        assert len(bank._instances) == 4
        assert bank.reset(0.5).thrust == pytest.approx((7.5,) * 8, abs=1e-7)


def test_one_goes_out_and_the_others_run_on(place: Path) -> None:
    spec = load(foreign(place, "runs", "lag=0.05,engines=6", [*SIX, *RUNS]), *NUMBERED, "run = 'on*'")
    apart = IsolatedBank(all_six(spec), STEP)
    try:
        with EngineBank(all_six(spec), 6, STEP) as here:
            courses = []
            for bank in (here, apart):
                bank.reset(0.5)
                assert bank.set_run(2, False)
                course = [bank.step(k, (0.5,) * 6).thrust for k in range(50)]
                assert bank.set_run(2, True)
                courses.append(course + [bank.step(50 + k, (0.5,) * 6).thrust for k in range(50)])
    finally:
        apart.close()
    assert courses[0] == courses[1]
    out, lit = courses[0][49], courses[0][99]
    assert out[2] == pytest.approx(10.0 * np.exp(-4.0), rel=1e-6)  # 0.2 s at a lag of 0.05 s
    assert lit[2] == pytest.approx(10.0, rel=0.03)
    assert [out[i] for i in (0, 1, 3, 4, 5)] == pytest.approx([10.0] * 5)


def test_what_is_one_for_all_is_told_to_all(place: Path) -> None:
    """Density and pressure are everybody's; of the air speed, which is each intake's, an input for all has the mean."""
    air: list[Row] = [("rho", "density", "input", 'unit="kg/m3" start="1"'), ("Mn", "mach", "input", 'start="0"')]
    spec = load(foreign(place, "deck", "lag=0.02,air=1,engines=6", [*SIX, *air]), *NUMBERED)
    assert spec.archive.has_shared_air_speed
    speeds = (0.0, 10.0, 20.0, 30.0, 40.0, 20.0)
    with EngineBank(all_six(spec), 6, STEP) as bank:
        bank.reset(0.5)
        for k in range(100):
            thrust = bank.step(k, (0.5,) * 6, Ambient(95000.0, 280.0, speeds)).thrust
    mach = 20.0 / np.sqrt(1.4 * 287.05287 * 280.0)
    density = 95000.0 / (287.05287 * 280.0)
    assert thrust == pytest.approx((10.0 * density / 1.225 * (1.0 - 0.3 * mach),) * 6, rel=1e-9)


@pytest.fixture(scope="module")
def flyable(place: Path) -> Path:
    rows = [*SIX, ("fuel", "speed", "output", "")]
    lines = ("[log]", "thrust_again = 'F*'", "common = 'fuel'")
    return mapped(foreign(place, "flyable", "lag=0.1,engines=6", rows), *NUMBERED, *lines)


def test_it_flies_with_columns_a_fault_and_in_a_process_of_its_own(flyable: Path, tmp_path: Path) -> None:
    loss = {"kind": "thrust_loss", "jet": [4], "start_s": 0.1, "share": 0.5}
    table = {"name": "one", "engine": str(flyable), "controller": "baseline", "engine_unchecked": True,
             "duration_s": 0.4, "fault": [loss]}  # fmt: skip
    scenario = Scenario.from_table(table, Scenario.load("hover").folder, "test")
    run = fly(scenario, tmp_path / "run", report=False)
    assert run.outcome == "completed"
    names = [each.name for each in run.log.described]
    assert [name for name in names if name.startswith("common_")] == ["common_1"]  # one output for all
    assert run.log["thrust_again_3"].tolist() == run.log["thrust_3_N"].tolist()
    assert run.log["thrust_4_N"][-1] == pytest.approx(0.5 * run.log["thrust_again_4"][-1])
    apart = fly(scenario.replace(engine_isolated=True))
    assert log_digest(apart.log) == log_digest(run.log)
    kept = Scenario.read(tmp_path / "run" / "scenario.toml")
    assert kept.stations == {}
    assert log_digest(fly(kept).log) == log_digest(run.log)


def test_the_check_tries_two_instances_of_it(place: Path) -> None:
    said: list[dict[str, object]] = []
    path = mapped(foreign(place, "checked", "lag=0.1,engines=6,coupled=0.2", SIX), *NUMBERED)
    run_task(
        {"name": str(path), "parameters": {}, "step": STEP, "parts": ("measure", "repeat", "together", "reset")},
        said.append,
    )
    found = {each["of"]: each for each in said if "of" in each}
    assert [each["problems"] for each in found.values()] == [[]] * 4
    measured = check.make_measurement_adapter().validate_python(found["measure"]["found"]["measured"])  # type: ignore[index]
    assert len(measured.others) == 5
    report, _ = check._check(str(path), STEP, {}, check.LIMITS, ("start",))
    said_of = dict(report.lines())
    assert said_of["thrust of engine 6"].startswith("F5 [N], found in the mapping file")
    assert "input" not in said_of  # none is left over


def test_what_fails_names_those_that_it_serves(place: Path) -> None:
    spec = load(foreign(place, "fails", "lag=0.1,engines=6", SIX), *NUMBERED)
    with EngineBank(all_six(spec), 6, STEP) as bank:
        bank.reset(0.5)
        with pytest.raises(EngineError, match=r"^engine 3 \(fails.fmu\): throttle is not finite at step 0"):
            bank.step(0, (0.5, 0.5, float("nan"), 0.5, 0.5, 0.5))
    assert bank._label(0) == "engines 1 to 6 (fails.fmu)"


WRONG: dict[str, tuple[tuple[str, ...], str]] = {
    "thrust alone": (("thrust = 'F*'",), r"states several engines by thrust; their throttle too must be stated"),
    "unlike": (("throttle = 'u*'", "thrust = ['F0', 'F1']"), "states 6 of throttle, 2 of thrust: must be as many"),
    "nothing like it": (("throttle = 'v*'", "thrust = 'F*'"), r"has no input like v\*, with a number for \*"),
    "twice": (("throttle = ['u0', 'u0']", "thrust = ['F0', 'F1']"), "u0 is both throttle of engine 1 and throttle of eng"),
    "unknown": (("throttle = ['u0', 'u9']", "thrust = ['F0', 'F1']"), "has no input called u9 for throttle"),
    "one": (("throttle = ['u0']", "thrust = ['F0']"), r"states 1 engines; 2 to \d+ may be in one FMU"),
    "shared": ((*NUMBERED[1:], "spool_speed = 'n'"), "spool_speed is one for 6 engines; state one for each"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_mapping_that_does_not_fit_is_refused_in_one_line(case: str, place: Path) -> None:
    lines, said = WRONG[case]
    path = foreign(place, "wrong", "lag=0.1,engines=6", [*SIX, ("n", "speed", "output", 'unit="1"'), lever("w")])
    with pytest.raises(InputError, match=said) as caught:
        load(path, "[ports]", *lines)
    assert "\n" not in str(caught.value)


def test_a_vehicle_needs_a_whole_multiple_of_them(place: Path) -> None:
    path = mapped(foreign(place, "four", "lag=0.1,engines=4", [*SIX[:4], *SIX[6:10]]), *NUMBERED)
    scenario = Scenario.load("hover").replace(engine=str(path), engine_unchecked=True, controller="baseline", expect=[])
    with pytest.raises(
        InputError, match="its FMU holds 4 engines, and hexjet has 6 stations, which is no whole multiple"
    ):
        fly(scenario)


def test_a_flight_goes_back_to_a_snapshot(flyable: Path) -> None:
    """The instance holds six engines' states, and all of them come back."""
    scenario = Scenario.load("hover").replace(
        engine=str(flyable), controller="baseline", engine_unchecked=True, duration_s=0.4, expect=[]
    )
    with Stepper(scenario) as stepper:
        stepper.reset()
        for _ in range(30):
            stepper.step()
        there = stepper.snapshot()
        first = [repr(stepper.step()) for _ in range(20)]  # what is not a number is not equal to itself
        stepper.restore(there)
        assert [repr(stepper.step()) for _ in range(20)] == first
