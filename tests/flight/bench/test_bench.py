"""The benchmarks measure what they say, and say it; no test looks at how long anything took."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner
from places import DOCS, ROOT

from benchmarks.machine import package_versions
from benchmarks.measures import (
    blocks,
    campaign,
    growth,
    others,
    own_blocks,
    process,
    speed,
)
from benchmarks.measures.blocks import Block, Replay
from benchmarks.measures.browser import looking
from benchmarks.measures.campaign import CampaignPlan
from benchmarks.measures.long_flight import fly_long, resident_and_peak, resident_of
from benchmarks.measures.pages import PagesPlan
from benchmarks.page import (
    ABSENT,
    NAMES,
    check_page,
    write_page,
)
from benchmarks.peers import block_diagram, multirotor, peers
from benchmarks.show import print_result
from benchmarks.suite import (
    CAMPAIGN,
    FULL,
    MEMORY,
    PARTS,
    QUICK,
    Plan,
    Result,
    make_plan,
    measure,
)
from benchmarks.tables import ASKED, MISSED, spread
from benchmarks.targets import OUTSIDE_UNITS, TargetResult, judge_targets, to_dict, values_before, vehicle_targets
from benchmarks.timing import (
    Clocked,
    Cost,
    Job,
    Pair,
    Spread,
    interleave,
)
from cosim.base.errors import FlightError, InputError
from cosim.cli.main import cli
from cosim.results.report.marks import page_parts
from cosim.results.run import open_run
from cosim.simulation.build import build

STEPS = 500


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """One small run of everything."""
    folder = tmp_path_factory.mktemp("bench")
    told: list[tuple[str, int, int]] = []
    plan = Plan(
        parts=PARTS,
        steps=100,
        rounds=2,
        starts=1,
        lengths_s=(1, 2),
        hover_s=0.2,
        others_s=0.2,
        pages=PagesPlan((1,), flights=2, look_s=0.2),
        memory_minutes=0.1,
        campaign=CampaignPlan(rounds=2, bare_s=0.02, flights=11, flight_s=0.1, fixed_rounds=1, study=24),
        folder=str(folder),
    )
    found = measure(plan, lambda *progress: told.append(progress))
    assert not list(folder.iterdir())  # nothing stays behind
    assert tuple(dict.fromkeys(what for what, _, _ in told)) == PARTS
    for what in {what for what, _, _ in told}:
        done = [(count, total) for name, count, total in told if name == what]
        assert done == [(count, done[0][1]) for count in range(done[0][1] + 1)], what
    return found


@pytest.fixture(scope="module")
def result(measured: Result) -> dict[str, Any]:
    """The same as JSON has it."""
    text = json.dumps(to_dict(measured), allow_nan=False)
    found: dict[str, Any] = json.loads(text)
    return found


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Block]]:
    with build(speed.hover(STEPS, blocks.SUBSTEPS)) as simulation:
        replay = Replay(simulation, tmp_path_factory.mktemp("replay"))
        yield replay.blocks()
        replay.close()


@pytest.mark.long
def test_one_json_object_with_every_part(result: dict[str, Any]) -> None:
    assert set(result) == {"machine", "versions", "compilers", "plan", "wall_s", "failed", "asked", *PARTS}
    assert not result["failed"]
    assert result["plan"]["steps"] == 100
    assert "folder" not in result["plan"]
    assert all(result[part] for part in PARTS)


@pytest.mark.long
def test_every_spread_says_how_often_it_was_measured(result: dict[str, Any]) -> None:
    """Median, quartiles and repeats, wherever a figure is."""
    found: list[dict[str, float]] = []

    def walk(value: Any) -> None:
        if isinstance(value, dict):
            if "median" in value:
                found.append(value)
            for each in value.values():
                walk(each)
        elif isinstance(value, list):
            for each in value:
                walk(each)

    walk(result)
    assert len(found) > 100
    for each in found:
        assert set(each) == {"median", "low", "high", "least", "repeats"}
        assert each["least"] <= each["low"] <= each["median"] <= each["high"]
        assert each["repeats"] >= 1


@pytest.mark.long
def test_the_machine_is_stated(result: dict[str, Any]) -> None:
    machine = result["machine"]
    assert machine["cpu"]
    assert machine["cores"] >= 1
    assert machine["kernel"]
    assert machine["memory_mb"] is None or machine["memory_mb"] > 100.0
    assert result["compilers"]["python"]


def test_every_package_that_is_needed_is_stated() -> None:
    """Those that we name, and those that they need: annotated-types is Pydantic's."""
    found = package_versions()
    assert list(found)[:2] == ["python", "hexjet-cosim"]
    assert {"jsbsim", "numpy", "fmpy", "pyarrow", "pydantic", "annotated-types"} <= set(found)
    assert "pytest" not in found  # of an extra


@pytest.mark.long
@pytest.mark.parametrize("substeps", speed.SUBSTEPS)
def test_a_step_costs_something_in_every_way(result: dict[str, Any], substeps: int) -> None:
    costs = result["step"][str(substeps)]
    assert set(costs) == {
        speed.BARE, speed.ENGINES, speed.WHOLE_STEP, speed.RECORDED, speed.AIRFRAME, speed.PLAIN, speed.PRICE,
        speed.OUTSIDE_JSBSIM, speed.OUTSIDE,
    }  # fmt: skip
    for name in (speed.BARE, speed.ENGINES, speed.WHOLE_STEP, speed.RECORDED, speed.AIRFRAME, speed.PLAIN):
        for clock in ("wall_us", "cpu_us", "units", "units_wall", "units_process"):
            spread = costs[name][clock]
            assert 0.0 < spread["least"] <= spread["low"] <= spread["median"] <= spread["high"], (name, clock)


@pytest.mark.long
@pytest.mark.parametrize("substeps", speed.SUBSTEPS)
def test_what_is_not_jsbsim_is_the_whole_less_its_runs(result: dict[str, Any], substeps: int) -> None:
    """Exactly, round by round, and so in the median and the quartiles too."""
    costs = result["step"][str(substeps)]
    for outside, whole in ((speed.OUTSIDE, speed.RECORDED), (speed.OUTSIDE_JSBSIM, speed.WHOLE_STEP)):
        for quantile in ("median", "low", "high", "least"):
            assert costs[outside]["units"][quantile] == pytest.approx(costs[whole]["units"][quantile] - substeps)


@pytest.mark.long
def test_the_breakdown_adds_up(result: dict[str, Any]) -> None:
    found = result["blocks"]
    flying = set(found["alone"]) - {blocks.DISK}  # which comes once in many steps and has no median
    assert set(found["in_flight"]) <= flying  # a compiled block lets no clock in
    assert blocks.ENGINES in found["in_flight"]
    parts = {name: cost["units"]["median"] for name, cost in found["alone"].items()}
    parts |= {name: part["units"] for name, part in found["in_flight"].items()}
    assert sum(parts.values()) + found["rest_units"] == pytest.approx(found["outside"]["units"]["median"])


@pytest.mark.long
def test_every_engine_that_is_there_is_timed(result: dict[str, Any]) -> None:
    """Ours and FMPy's wrappers always; the others if they are installed, else they are named with the reason."""
    found = result["peers"]
    assert {"ours", "FMPy's wrappers"} <= set(found["costs"]) == set(found["versions"])
    assert set(found["costs"]) | set(found["missing"]) == {"ours", "FMPy's wrappers", "ecos", "libcosim"}
    assert not set(found["costs"]) & set(found["missing"])
    for costs in found["costs"].values():
        for cost in costs.values():
            assert 0.0 < cost["units_process"]["least"] <= cost["units_process"]["median"]
    for costs in (found["costs"][name] for name in found["costs"] if name != "ours"):
        assert set(costs) == {peers.EXCHANGE, peers.ALONE}


@pytest.mark.long
def test_what_is_asked_for(measured: Result) -> None:
    """The figures that decide, by the medians that were measured."""
    rows = {row.name: row for row in judge_targets(measured)}
    assert measured.step is not None
    assert measured.campaign is not None
    for runs, most in ((1, 4.5), (4, 2.0)):
        in_it = f"{runs} run{'s' if runs > 1 else ''} a step"
        costs = measured.step[runs]
        outside = rows[f"not JSBSim, recorded in full, {in_it}"]
        assert (outside.measured, outside.bound) == (costs[speed.OUTSIDE].units, OUTSIDE_UNITS)
        whole = rows[f"whole flight by bare JSBSim, {in_it}"]
        assert whole.bound == most
        assert whole.measured.median == pytest.approx(costs[speed.RECORDED].units.median / runs)
        engines = rows[f"six engine FMUs, {in_it}"]
        assert (engines.measured, engines.bound) == (costs[speed.ENGINES].units, 1.5)
    share = rows["gain by a second worker, by bare JSBSim's"]
    assert (share.measured, share.bound, share.least) == (measured.campaign.share, 0.95, True)
    assert rows["from command to first step"].bound == 1.5
    assert not judge_targets(replace(measured, **dict.fromkeys(PARTS)))  # what was not measured is not judged


@pytest.mark.parametrize(("median", "least", "met"), [(1.9, False, True), (2.1, False, False), (1.9, True, False)])
def test_the_median_decides(median: float, least: bool, met: bool) -> None:
    assert TargetResult("a", Spread.of([median - 1.0, median, median + 1.0]), 2.0, "times", least).met is met


@pytest.mark.long
def test_what_it_came_to_before_stands_beside_it(measured: Result) -> None:
    """No number of before is for a row that there is not."""
    rows = judge_targets(measured)
    keys = [row.key for row in rows if row.key]
    assert len(set(keys)) == len(keys)
    assert {row.key: row.before for row in rows}["outside-1"] == "1.32"
    not_here = (
        "page-",
        "campaign-page-",
        "study",
        "memory-",
        "process",
        "isolated",
        "fmu",
    )  # of longer flights, or no compiler
    assert {key for key in values_before() if not key.startswith(not_here)} <= set(keys)
    assert (TargetResult("a", Spread.of([1.0]), 2.0, "s").before, len(values_before())) == (None, 37)


def test_a_hover_in_a_block_diagram_is_one(tmp_path: Path) -> None:
    pytest.importorskip("pathsim", exc_type=ImportError)
    found = block_diagram.find_pathsim()
    assert not isinstance(found, str)
    with build(speed.hover(500, block_diagram.SUBSTEPS)) as simulation:
        begin = simulation.airframe._fdm.get_sim_time()
        found.hover(simulation, 500)()
        assert simulation.airframe._fdm.get_sim_time() - begin == pytest.approx(500 * 0.004, abs=0.01)


def test_without_pathsim_ours_is_measured_and_the_reason_given(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def absent(name: str) -> object:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(block_diagram, "import_module", absent)
    found = block_diagram.measure_block_diagram(250, 1, tmp_path, lambda: None)
    assert (found.cost, found.ratio, found.version) == (None, None, None)
    assert found.missing == "No module named 'pathsim'; it comes with: pip install pathsim"
    assert found.ours.units.median > block_diagram.SUBSTEPS


def test_all_engines_answer_alike_to_the_last_bit() -> None:
    """The same FMU, inputs and step: what is compared in time is the same work."""
    wanted: list[tuple[float, ...]] = []
    for peer in peers.find_peers()[0]:
        with ExitStack() as stack:
            exchange = peer.open(stack).exchange
            answers = [tuple(exchange(k, throttles)) for k, throttles in enumerate(peers.inputs(100))]
        wanted = wanted or answers
        assert answers == wanted, peer.name
    assert min(wanted[-1]) > 0.0
    assert len(set(wanted[-1])) == len(wanted[-1])  # each has its own throttle


def test_an_engine_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> object:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(peers, "import_module", absent)
    found, missing = peers.find_peers()
    assert [peer.name for peer in found] == ["ours", "FMPy's wrappers"]
    assert missing["ecos"] == "No module named 'ecospy'; it comes with: pip install ecospy"
    assert missing["libcosim"].endswith("pip install libcosimpy")
    monkeypatch.setattr(multirotor, "import_module", absent)
    assert multirotor.find_rotorpy() == "No module named 'rotorpy.environments'; it comes with: pip install rotorpy"


class FakeRotorPy:
    """As much of RotorPy as is asked of it; ``drift`` is where it ends, ``evaluations`` how often in a step."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, drift: float = 0.0, evaluations: int = 7) -> None:
        self.steps = 0

        class Vehicle:
            def __init__(self, parameters: dict[str, float], initial_state: dict[str, Any]) -> None:
                assert 4 * parameters["k_eta"] * initial_state["rotor_speeds"][0] ** 2 == pytest.approx(2.0 * 9.81)

            def _s_dot_fn(self) -> None: ...

            def step(vehicle, state: int, control: int, step: float) -> int:  # noqa: N805
                for _ in range(evaluations):
                    vehicle._s_dot_fn()
                self.steps += 1
                return state

        class Environment:
            def __init__(self, vehicle: Vehicle, controller: object, trajectory: object, sim_rate: int) -> None:
                self.vehicle, self.step = vehicle, 1.0 / sim_rate

            def run(self, t_final: float, use_mocap: bool, **options: bool) -> dict[str, Any]:
                assert use_mocap
                assert not any(options.values())
                times = [0.0]
                while times[-1] < t_final:
                    times.append(times[-1] + self.step)
                    self.vehicle.step(0, 0, self.step)
                return {"time": times, "state": {"x": [[0.0, 0.0, drift]] * len(times)}}

        parts = {
            "rotorpy.environments": {"Environment": Environment},
            "rotorpy.vehicles.multirotor": {"Multirotor": Vehicle},
            "rotorpy.vehicles.hummingbird_params": {"quad_params": {"mass": 2.0, "num_rotors": 4, "k_eta": 1e-5}},
            "rotorpy.controllers.quadrotor_control": {"SE3Control": lambda parameters: None},
            "rotorpy.trajectories.hover_traj": {"HoverTraj": lambda: None},
        }
        monkeypatch.setattr(multirotor, "import_module", lambda name: SimpleNamespace(**parts[name]))
        monkeypatch.setattr(multirotor.metadata, "version", lambda name: "1.2.3")


@pytest.mark.parametrize("rate", multirotor.RATES)
def test_rotorpy_flies_as_many_steps_as_we(monkeypatch: pytest.MonkeyPatch, rate: int) -> None:
    """Although it adds up its time: 10 s at 400 Hz would be 4001 steps."""
    fake = FakeRotorPy(monkeypatch)
    found = multirotor.RotorPy()
    found.whole(rate, 10 * rate)()
    assert fake.steps == 10 * rate
    replay = found.plant(rate, 100)
    fake.steps = 0
    replay()
    found.plant(rate, 100)()  # no further flight for the same
    assert fake.steps == 200
    assert found.evaluations(rate) == 7.0


def test_a_flight_of_rotorpy_that_goes_astray_is_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    FakeRotorPy(monkeypatch, drift=0.2)
    with pytest.raises(FlightError, match=r"does not hover: it ends at \[0\.0, 0\.0, 0\.2\] m"):
        multirotor.RotorPy().whole(250, 10)()
    FakeRotorPy(monkeypatch, drift=math.nan)
    with pytest.raises(FlightError, match="does not hover"):
        multirotor.RotorPy().whole(250, 10)()


def test_rotorpy_stands_beside_ours(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    FakeRotorPy(monkeypatch)
    # an odd number of rounds: the median of what is divided by is then what the median was divided by
    found = multirotor.measure_multirotor(0.1, 3, tmp_path, lambda: None)
    assert (found.version, found.missing, found.evaluations) == ("1.2.3", None, {250: 7.0, 400: 7.0})
    assert list(found.hovers) == [
        "ours, Hex-Jet", "RotorPy, whole flight, 250 Hz", "RotorPy, vehicle alone, 250 Hz",
        "ours, quadrotor", "RotorPy, whole flight, 400 Hz", "RotorPy, vehicle alone, 400 Hz",
    ]  # fmt: skip
    for name, each in found.hovers.items():
        assert each.factor.median * each.cost.wall_us.median * each.rate == pytest.approx(1e6, rel=1e-9), name
        assert (each.ratio.least == each.ratio.high == 1.0) is name.startswith("ours")


def test_rotorpys_step_is_held_against_ours_in_units() -> None:
    """Ours took 2 of its units, RotorPy 50 of its own, on a machine that was half as fast then."""
    ours = [Pair(Clocked(8e-6, 8e-6, 8e-6), Clocked(4e-6, 4e-6, 4e-6))]
    theirs = [Pair(Clocked(500e-6, 400e-6, 400e-6), Clocked(9e-6, 8e-6, 8e-6))]
    found = multirotor._hover(400, theirs, ours)
    assert found.ratio.median == pytest.approx(25.0)
    assert found.factor.median == pytest.approx(1.0 / (400 * 500e-6))  # by the wall clock


def test_rotorpy_as_it_is() -> None:
    """The real one hovers, where it is installed."""
    pytest.importorskip("rotorpy", exc_type=ImportError)
    found = multirotor.find_rotorpy()
    assert isinstance(found, multirotor.RotorPy)
    found.whole(250, 100)()
    assert 6.0 <= found.evaluations(250) <= 20.0  # six of one RK45 step, one at least for the IMU


def test_other_flights_are_less_jsbsims_own_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A step that costs 10 units with 4 runs in it is 6 of ours, with 1 run 9; the dearest is judged."""
    unit = Clocked(4e-6, 4e-6, 4e-6)
    row = [Pair(Clocked(40e-6, 40e-6, 40e-6), unit)]
    monkeypatch.setattr(others, "FLIGHTS", {"a": ("hover", {}), "b": ("hover", {"controller": "baseline"})})
    monkeypatch.setattr(others, "collect", lambda jobs, *_: {(job.substeps, job.name): row for job in jobs})
    found = others.measure_others(0.1, 1, tmp_path, lambda: None)
    units = {name: {runs: cost.units.median for runs, cost in costs.items()} for name, costs in found.outside.items()}
    assert units == {name: {1: pytest.approx(9.0), 4: pytest.approx(6.0)} for name in "ab"}
    shipped = sorted(path.parent.name for path in (ROOT / "aircraft").glob("*/vehicle.toml"))
    assert sorted(found.vehicles) == shipped
    assert all(ratios[runs].median == pytest.approx(1.0) for ratios in found.vehicles.values() for runs in (1, 4))


def test_a_vehicle_is_compared_with_the_hexjet_round_by_round() -> None:
    """Twice its microseconds while the unit took twice as long is the same step."""
    slow, quick = Clocked(8e-6, 8e-6, 8e-6), Clocked(4e-6, 4e-6, 4e-6)
    own = [Pair(Clocked(80e-6, 80e-6, 80e-6), slow), Pair(Clocked(60e-6, 60e-6, 60e-6), quick)]
    hexjet = [Pair(Clocked(40e-6, 40e-6, 40e-6), quick), Pair(Clocked(20e-6, 20e-6, 20e-6), quick)]
    assert others.ratio(own, hexjet).median == pytest.approx(2.0)  # of 1 and 3


def test_the_dearest_vehicle_is_judged() -> None:
    ratios = {"even": (1.0, 1.0), "winged": (2.1, 1.9)}
    vehicles = {name: {1: Spread.of([once]), 4: Spread.of([often])} for name, (once, often) in ratios.items()}
    judged = list(vehicle_targets(others.Others({}, vehicles)))
    assert [(row.measured.median, row.met) for row in judged] == [(2.1, False), (1.9, True)]
    assert all("winged" in row.name for row in judged)


@pytest.mark.long
def test_other_flights(result: dict[str, Any]) -> None:
    found = result["others"]["outside"]
    assert list(found) == list(others.FLIGHTS)
    assert all(list(costs) == ["1", "4"] for costs in found.values())
    (row,) = [row for row in result["asked"] if "other flights" in row["name"]]
    assert row["measured"]["median"] == max(
        cost["units"]["median"] for costs in found.values() for cost in costs.values()
    )


def test_a_block_of_ones_own_costs_what_its_flight_costs_more() -> None:
    """Round by round, in the unit around it: 60 us against 50 is 2.5 of 4 us, whatever the other round was."""
    slow, quick = Clocked(4e-6, 4e-6, 4e-6), Clocked(2e-6, 2e-6, 2e-6)
    own = [Pair(Clocked(60e-6, 60e-6, 60e-6), slow), Pair(Clocked(30e-6, 30e-6, 30e-6), quick)]
    ours = [Pair(Clocked(50e-6, 50e-6, 50e-6), quick), Pair(Clocked(25e-6, 25e-6, 25e-6), quick)]
    assert Cost.of(speed.differences(own, ours)).units.median == pytest.approx(2.5)


@pytest.mark.long
def test_blocks_of_ones_own(result: dict[str, Any]) -> None:
    """Every way in flew to its end; what a class costs more is judged."""
    found = result["own"]
    ways = {*own_blocks.CLASSES, own_blocks.PROCESS, own_blocks.ISOLATED}
    assert set(found["more"]) == (ways | {own_blocks.FMU} if found["missing"] is None else ways)
    judged = {row["name"]: row["measured"] for row in result["asked"]}
    for name in own_blocks.CLASSES:
        assert judged[f"more by {name}"] == found["more"][name]["units"]


@pytest.mark.parametrize("name", [own_blocks.RATE, own_blocks.CONTROLLER])
def test_the_loops_that_are_timed_hover(tmp_path: Path, name: str) -> None:
    with build(own_blocks.flights(3.0, 1, tmp_path, fmu=False)[name]) as simulation:
        speed.fly_through(simulation)
        assert simulation.state.altitude == pytest.approx(10.0, abs=0.1)
        assert max(map(abs, simulation.state.euler)) < math.radians(30.0)


@pytest.mark.long
def test_growth_in_every_way(result: dict[str, Any]) -> None:
    time, engines, log = result["time"], result["engines"], result["log"]
    assert list(time["steps"]) == list(time["memory"]) == ["1", "2"]
    assert [memory["steps"] for memory in time["memory"].values()] == [250, 500]
    assert list(engines["banks"]) == ["1", "2", "4", "6", "8", "12", "16"]
    flown = [growth.HEXJET, growth.QUADROTOR, growth.BARE_QUADROTOR, *growth.TURBINES.values()]
    assert list(engines["flown"]) == flown
    assert list(log["steps"]) == ["1", "2", "5", "25", "0"]


def test_growth_is_the_longest_by_the_shortest(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """8 units a step against 10, the machine twice as slow during the long flight."""
    slow, quick = Clocked(4e-6, 4e-6, 4e-6), Clocked(2e-6, 2e-6, 2e-6)
    rows = {(4, "2"): [Pair(Clocked(40e-6, 40e-6, 40e-6), slow)], (4, "1"): [Pair(Clocked(16e-6, 16e-6, 16e-6), quick)]}
    monkeypatch.setattr(growth, "collect", lambda *_: rows)
    monkeypatch.setattr(growth, "measure_memory", lambda *_, **__: None)
    found = growth.measure_lengths((2, 1), 1, 1, tmp_path, lambda: None)
    assert found.growth.median == pytest.approx(10.0 / 8.0)


@pytest.mark.parametrize("every", [1, 2, 7])
def test_a_log_rate_records_each_so_many_steps(tmp_path: Path, every: int) -> None:
    with speed.Flights(250, tmp_path) as flights:
        flown = flights.fly(speed.hover(50, 1))
        flown.recorded("some", every).prepare()()
        flown.close()
    (folder,) = (path.parent for path in tmp_path.glob("*/*/summary.json"))
    assert list(open_run(folder).log["time_s"]) == pytest.approx([k * 0.004 for k in range(0, 50, every)])


def test_the_quadrotor_hovers_at_its_own_rate() -> None:
    scenario = growth.quadrotor(400)
    assert (scenario.aircraft, scenario.engine, scenario.steps) == ("quadrotor", "motor", 400)
    with build(scenario) as simulation:
        speed.fly_through(simulation)
        assert simulation.state.altitude == pytest.approx(10.0, abs=0.1)


@pytest.mark.long
def test_a_second_worker_beside_a_second_process(result: dict[str, Any]) -> None:
    found = result["campaign"]
    for each in (found["bare"], found["flown"]):
        assert list(each["rate"]) == ["1", "2"]
        assert each["gain"]["repeats"] == 2
    assert found["flight"]["by_steps"]["median"] > 1.0
    study = found["study"]
    assert study["flights"] == 24 == sum(each["flights"] for each in study["workers"])
    assert len(study["workers"]) == 2
    assert found["cheap_s"] > 0.0


def test_the_campaigns_gain_is_held_against_bare_jsbsims(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """From 100 to 150 runs against 10 to 18 flights a second: 1.8 by 1.5."""

    class Alone(campaign.Bare):
        def __enter__(self) -> Alone:
            return self

        def rate(self, count: int, seconds: float) -> float:
            return {1: 100.0, 2: 150.0}[count]

    monkeypatch.setattr(campaign, "Bare", Alone)
    monkeypatch.setattr(campaign, "fly_study", lambda study, workers, folder: [])
    monkeypatch.setattr(campaign, "rate", lambda looks, count: {1: 10.0, 2: 18.0}[count])
    monkeypatch.setattr(campaign, "measure_flight_cost", lambda *_: None)
    found = campaign.measure_campaign(CampaignPlan(rounds=2), tmp_path, lambda: None)
    assert (found.bare.gain.median, found.flown.gain.median) == pytest.approx((1.5, 1.8))
    assert found.share.median == pytest.approx(1.2)
    assert (found.share.repeats, found.study) == (2, None)


def test_a_campaigns_rate_is_that_of_busy_warm_workers() -> None:
    """Two workers, 4 flights a second once warm: 5 slow rows of each at the beginning and the end do not count."""
    times = (
        [10.0 * k for k in range(10)]
        + [90.0 + 0.25 * k for k in range(1, 101)]
        + [115.0 + 7.0 * k for k in range(1, 10)]
    )
    looks = [campaign._Look(time, "here:1", None) for time in times]
    assert campaign.rate(looks, 2) == pytest.approx(4.0)
    with pytest.raises(ValueError, match="too few"):
        campaign.rate(looks[:19], 2)


def test_a_campaign_whose_flights_fail_is_not_timed() -> None:
    row = {"flight": 0, "outcome": "failed", "reason": "engine 1 does not start", "worker": "here:1"}
    workers = SimpleNamespace(fly=lambda study, flights: iter([row]))
    with pytest.raises(FlightError, match="ended early: engine 1 does not start"):
        list(campaign.Watched(workers).fly(None, []))  # type: ignore[arg-type]


def test_a_bare_process_that_ends_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "_BARE", "raise SystemExit(3)")
    with pytest.raises(FlightError, match="ended with status 3"):
        campaign.Bare().__enter__()


@pytest.mark.long
def test_the_way_to_the_first_step(result: dict[str, Any]) -> None:
    startup = result["start"]
    parts = [startup[name]["median"] for name in ("python_s", "imports_s", "build_s")]
    assert min(parts) > 0.0
    assert sum(parts) == pytest.approx(startup["first_step_s"]["median"])


@pytest.mark.long
def test_memory_is_seen_all_along_a_flight(result: dict[str, Any]) -> None:
    memory = result["memory"]
    assert memory["steps"] == 1500  # 0.1 min at 250 Hz
    assert [mark["where"] for mark in memory["landmarks"]] == [
        "start", "1/4", "2/4", "3/4", "4/4", "log and summary", "report"
    ]  # fmt: skip
    peaks = [mark["peak_mb"]["median"] for mark in memory["landmarks"]]
    assert peaks == sorted(peaks)
    assert memory["peak_mb"]["median"] == peaks[-1] > 0.0
    assert memory["log_mb"] > 1500 * 8 / 1e6  # one column alone, were it not compressed


@pytest.mark.long
def test_tables_for_people(measured: Result, capsys: pytest.CaptureFixture[str]) -> None:
    print_result(measured)
    told = capsys.readouterr().out
    for words in (
        speed.OUTSIDE, blocks.SENSORS, "FMPy's wrappers", "to the first step", "at most", "[quartiles]", "min flown",
        growth.QUADROTOR, "one step in 25", "from one process to two", "at least 0.95 times",
    ):  # fmt: skip
        assert words in told
    assert "not measured: memory" not in told
    print_result(replace(measured, memory=None, peers=replace(measured.peers, missing={"other": "why not"})))
    told = capsys.readouterr().out
    assert "min flown" not in told
    assert "other not measured: why not" in told
    assert "not measured: memory; --full measures everything" in told


def test_figures_have_three_digits() -> None:
    found = [spread(Spread.of([0.9 * value, value, 1.1 * value])) for value in (0.0456, 2.0, 34.56, 1234.5)]
    assert found == ["0.046 [0.043, 0.048]", "2.00 [1.90, 2.10]", "34.6 [32.8, 36.3]", "1234 [1173, 1296]"]


@pytest.mark.long
def test_a_page_takes_every_figure_from_one_run(measured: Result, tmp_path: Path) -> None:
    """What stands around the marks stays, what stands between them goes, also where nothing was measured now."""
    page = tmp_path / "page.md"
    check_page(page)
    assert not page.exists()
    write_page(page, measured, "hexjet bench --full")
    fresh = page.read_text()
    assert fresh.count("<!-- measured: ") == fresh.count("<!-- end -->") == len(NAMES)
    assert ABSENT not in fresh
    assert "hexjet bench --full" in fresh
    assert "| six engine FMUs, 1 run a step |" in fresh
    kept = "Words of ours.\n\n<!-- measured: step -->\nold 1.23\n<!-- end -->\n\nMore.\n<!-- measured: memory -->\n<!-- end -->\n"
    page.write_text(kept)
    write_page(page, replace(measured, memory=None), "hexjet bench")
    text = page.read_text()
    assert text.startswith("Words of ours.\n\n<!-- measured: step -->\n**One control step")
    assert text.endswith(f"\n\nMore.\n<!-- measured: memory -->\n{ABSENT}<!-- end -->\n")
    assert "old 1.23" not in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.md"]


def test_the_documentation_has_every_table_generated() -> None:
    """Its marks are whole, and no part is left out."""
    page = DOCS / "benchmarks.md"
    check_page(page)
    parts = page_parts(page)
    assert parts.keys() == set(NAMES)
    goals = [line.split(" | ") for line in parts[ASKED].splitlines() if line.startswith("| ")][2:]
    missed = parts[MISSED].splitlines()
    assert missed[0] == f"**Goals that are not met, of {len(goals)}**"
    assert [line.strip("| ").split(" | ") for line in missed[4:]] == [
        [row[0].strip("| "), *row[1:-1]] for row in goals if row[-1] == "no |"
    ]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("# A page of mine\n", "it has no mark"),
        ("<!-- measured: step -->\n", "do not come in pairs"),
        ("<!-- measured: step -->\n<!-- measured: log -->\n<!-- end -->\n", "do not come in pairs"),
        ("<!-- measured: stepp -->\n<!-- end -->\n", "unknown mark 'stepp'"),
    ],
)
def test_a_page_without_whole_marks_is_left_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str, complaint: str
) -> None:
    """And that is said before anything is measured."""
    monkeypatch.setattr("benchmarks.suite.measure", lambda *_: pytest.fail("measured"))
    page = tmp_path / "page.md"
    page.write_text(text)
    with pytest.raises(InputError, match=rf"page\.md: .*{complaint}"):
        check_page(page)
    answer = CliRunner().invoke(cli, ["bench", "--page", str(page)])
    assert isinstance(answer.exception, InputError)
    assert page.read_text() == text
    with pytest.raises(InputError, match="there is no folder"):
        check_page(tmp_path / "absent" / "page.md")


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "plan"),
    [
        ([], Plan()),
        (["--steps", "300", "--rounds", "3", "--starts", "2"], Plan(steps=300, rounds=3, starts=2)),
        (["--full"], FULL),
        (["--campaign"], Plan(parts=(*QUICK, CAMPAIGN))),
        (["--memory-minutes", "7"], Plan(parts=(*QUICK, MEMORY), memory_minutes=7.0)),
        (["--full", "--memory-minutes", "5"], replace(FULL, memory_minutes=5.0)),
        (["--full", "--only", "log", "--only", "step"], replace(FULL, parts=("step", "log"))),
    ],
)
def test_options_make_the_plan(
    measured: Result, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str], plan: Plan
) -> None:
    """What takes minutes is off unless asked for; the page says what was typed."""
    plans: list[Plan] = []

    def note(plan: Plan, on_progress: object) -> Result:
        plans.append(plan)
        return measured

    monkeypatch.setattr("benchmarks.suite.measure", note)
    monkeypatch.chdir(tmp_path)
    answer = CliRunner().invoke(cli, ["bench", *arguments, "--json", "--page", "page.md"])
    assert answer.exit_code == 0, answer.output
    assert plans == [plan]
    assert json.loads(answer.stdout) == json.loads(json.dumps(to_dict(measured)))
    (typed,) = (line for line in Path("page.md").read_text().splitlines() if line.startswith("hexjet bench"))
    assert sorted(typed.split()) == sorted(["hexjet", "bench", *arguments, "--json", "--page", "page.md"])


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (FlightError("the disk | is full"), "the disk | is full"),
        (KeyError("theirs"), "KeyError: 'theirs'"),  # of somebody else's program, say
    ],
)
def test_a_part_that_fails_leaves_the_others(
    error: Exception, said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It is named on the terminal and on the page, and the exit status tells."""

    def fails(*_: object) -> None:
        raise error

    monkeypatch.setattr("benchmarks.suite.measure_log_rates", fails)
    monkeypatch.setattr("benchmarks.suite.measure_startup", lambda *_: None)
    found = measure(Plan(parts=("log", "start"), folder=str(tmp_path)))
    assert found.failed == {"log": said}
    monkeypatch.setattr("benchmarks.suite.measure", lambda *_: found)
    page = tmp_path / "page.md"
    answer = CliRunner().invoke(cli, ["bench", "--page", str(page)], standalone_mode=False)
    assert answer.return_value == 1
    assert f"log not measured: {said}" in answer.stdout
    escaped = said.replace("|", "\\|")
    assert f"<!-- measured: log -->\nNot measured: {escaped}\n<!-- end -->" in page.read_text()


def test_without_a_browser_nobody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HEXJET_BROWSER", raising=False)
    monkeypatch.setenv("PATH", "")
    with looking() as look:
        assert look == "no browser: install chromium, or name one in HEXJET_BROWSER"
    pytest.importorskip("playwright")
    monkeypatch.setenv("HEXJET_BROWSER", "/not/there")
    with looking() as look:
        assert isinstance(look, str)
        assert look.startswith("/not/there: ")


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(InputError, match=r"--only: unknown part 'setp'; .*step"):
        make_plan(False, False, ["setp"], {})


def test_the_help_names_every_part() -> None:
    told = CliRunner().invoke(cli, ["bench", "--help"]).stdout
    assert ", ".join(PARTS) in " ".join(told.split())


@pytest.mark.parametrize(
    "name",
    [
        blocks.COMMAND, blocks.DISTURBANCE, blocks.ATTITUDE, blocks.RATE, blocks.ALTITUDE, blocks.ALLOCATION,
        blocks.ENGINES, blocks.SERVOS, blocks.SENSORS, blocks.END_CHECK,
    ],
)  # fmt: skip
def test_a_block_alone_does_what_it_did_in_flight(replayed: list[Block], name: str) -> None:
    """Bit for bit, and again when it is timed once more: what is timed is the work of the flight."""
    (block,) = (each for each in replayed if each.name == name)
    assert block.answered is not None
    assert len(block.inputs) == STEPS
    for _ in range(2):
        # as text, which has every digit: what an engine does not say is NaN
        assert list(map(repr, block.replay())) == list(map(repr, block.answered))


def test_every_block_can_be_timed_again(replayed: list[Block]) -> None:
    for block in replayed:
        for _ in range(2):
            block.job(STEPS).prepare()()


def test_the_engines_are_six_instances() -> None:
    with build(speed.hover(250, 1)) as simulation:
        simulation.propulsion.engines.reset(0.4)
        # one throttle is moved: one thrust moves, later than the engine's delay
        for k in range(100):
            thrust = simulation.propulsion.engines.step(k, (0.4, 0.4, 0.5, 0.4, 0.4, 0.4)).thrust
        assert len(set(thrust[:2] + thrust[3:])) == 1
        assert thrust[2] > thrust[0]


def test_the_unit_is_one_run_in_hover(tmp_path: Path) -> None:
    """Bare JSBSim stays in the air with the forces held, and one ``run`` is one of its steps."""
    with speed.Flights(250, tmp_path) as flights:
        for substeps, unit in flights.units().items():
            unit.prepare()()
            airframe = flights._bare[substeps].airframe
            state = airframe.step([(0.0, 0.0, -9.0)] * 6, flights._bare[substeps].disturbances.at(0))
            assert state.altitude == pytest.approx(10.0, abs=1.0)  # g at the place is 0.02 m/s^2 below standard
            assert airframe._fdm.get_sim_time() == pytest.approx((unit.steps + substeps) * 0.004 / substeps)


def test_a_flight_that_ends_early_is_not_timed() -> None:
    scenario = speed.hover(2000, 1).replace(
        disturbance=[{"kind": "force", "start_s": 0.0, "duration_s": 8.0, "force_n": (0.0, 0.0, 100.0)}]
    )
    with build(scenario) as simulation, pytest.raises(FlightError, match="ended early"):
        speed.fly_through(simulation)


def test_jobs_stand_between_their_units() -> None:
    done: list[str] = []

    def job(name: str, substeps: int) -> Job:
        def prepare() -> Callable[[], object]:
            return lambda: done.append(name)

        return Job(name, substeps, 10, prepare)

    jobs, units = [job("a", 1), job("b", 4)], {1: job("one", 1), 4: job("four", 4)}
    assert [found.name for found, _ in interleave(jobs, units, 2)] == ["a", "b", "b", "a"]
    assert done == ["one", "a", "one", "four", "b", "four", "four", "b", "four", "one", "a", "one"]


def test_ratios_are_of_the_same_round() -> None:
    """A machine twice as slow in the second round changes the microseconds and not the units."""
    pairs = [
        Pair(Clocked(12e-6, 10e-6, 14e-6), Clocked(2e-6, 2e-6, 2e-6)),
        Pair(Clocked(24e-6, 20e-6, 28e-6), Clocked(4e-6, 4e-6, 4e-6)),
    ]
    cost = Cost.of(pairs, less=4)
    for found, value in ((cost.units, 1.0), (cost.units_wall, 2.0), (cost.units_process, 3.0)):
        assert [found.median, found.low, found.high, found.least] == pytest.approx(4 * [value])
    assert cost.cpu_us.median == pytest.approx(3.0)  # of 10 - 4 * 2 and 20 - 4 * 4
    assert cost.cpu_us.least == pytest.approx(2.0)


def test_memory_landmarks_in_order(tmp_path: Path) -> None:
    told: list[tuple[str, int]] = []
    fly_long(tmp_path / "run", 0.02, lambda where, steps: told.append((where, steps)))
    assert told == [
        ("start", 0), ("1/4", 75), ("2/4", 150), ("3/4", 225), ("4/4", 300), ("log and summary", 300), ("report", 300)
    ]  # fmt: skip
    assert (tmp_path / "run" / "report.html").is_file()


def test_what_a_flight_gains_in_memory() -> None:
    """From the first quarter, when everything is loaded, to the end; nothing where the system does not tell."""
    held = {"start": 50.0, "1/4": 101.0, "2/4": 104.0, "3/4": 102.0, "4/4": 103.5, "log and summary": 140.0}
    marks = [process._Mark(where, resident, resident, 0) for where, resident in held.items()]
    assert process._Long(marks, 1.0, 1.0, None).growth == pytest.approx(2.5)
    assert process._Long([mark._replace(resident=None) for mark in marks], 1.0, 1.0, None).growth is None


def test_memory_grows_with_what_is_held() -> None:
    before, _ = resident_and_peak()
    held = bytearray(b"x" * 50_000_000)
    after, peak = resident_and_peak()
    assert peak >= 50.0
    if before is not None and after is not None:
        assert math.isclose(after - before, 50.0, abs_tol=10.0)  # the allocator's own
        assert peak >= after - 1.0  # the kernel brings the peak up to date now and then
        other = resident_of(str(os.getpid()))
        assert other is not None
        assert math.isclose(other, after, abs_tol=10.0)
    del held
    assert resident_of("0") is None
