"""The benchmarks measure what they say, and say it; no test looks at how long anything took."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from cosim.bench import Plan, Result, blocks, measure, peers, speed
from cosim.bench.blocks import Block, Replay
from cosim.bench.long_flight import fly_long, resident_and_peak
from cosim.bench.show import print_result
from cosim.bench.timing import Clocked, Cost, Job, Pair, interleave
from cosim.cli import cli
from cosim.errors import FlightError
from cosim.simulation import build

STEPS = 500


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """One small run of everything."""
    folder = tmp_path_factory.mktemp("bench")
    told: list[tuple[str, int, int]] = []
    plan = Plan(steps=250, rounds=2, starts=1, memory_minutes=0.1, folder=str(folder))
    found = measure(plan, lambda *progress: told.append(progress))
    assert not list(folder.iterdir())  # nothing stays behind
    for what in {what for what, _, _ in told}:
        done = [(count, total) for name, count, total in told if name == what]
        assert done == [(count, done[0][1]) for count in range(done[0][1] + 1)], what
    return found


@pytest.fixture(scope="module")
def result(measured: Result) -> dict[str, Any]:
    """The same as JSON has it."""
    text = json.dumps(measured.to_dict(), allow_nan=False)
    found: dict[str, Any] = json.loads(text)
    return found


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Block]]:
    with build(speed.hover(STEPS, blocks.SUBSTEPS)) as simulation:
        replay = Replay(simulation, tmp_path_factory.mktemp("replay"))
        yield replay.blocks()
        replay.close()


def test_one_json_object_with_every_part(result: dict[str, Any]) -> None:
    assert set(result) == {
        "machine", "versions", "plan", "speed", "breakdown", "peers", "startup", "memory", "targets", "wall_s"
    }  # fmt: skip
    assert result["plan"] == {"steps": 250, "rounds": 2, "starts": 1, "memory_minutes": 0.1}
    assert result["machine"]["cpu"]
    assert {"python", "jsbsim", "numpy"} <= set(result["versions"])


@pytest.mark.parametrize("substeps", speed.SUBSTEPS)
def test_a_step_costs_something_in_every_way(result: dict[str, Any], substeps: int) -> None:
    costs = result["speed"][str(substeps)]
    assert set(costs) == {
        speed.BARE, speed.ENGINES, speed.FLOWN, speed.RECORDED, speed.OUTSIDE_FLOWN, speed.OUTSIDE
    }  # fmt: skip
    for name in (speed.BARE, speed.ENGINES, speed.FLOWN, speed.RECORDED):
        for clock in ("wall_us", "cpu_us", "units", "units_wall", "units_process"):
            spread = costs[name][clock]
            assert 0.0 < spread["least"] <= spread["low"] <= spread["median"] <= spread["high"], (name, clock)


@pytest.mark.parametrize("substeps", speed.SUBSTEPS)
def test_what_is_not_jsbsim_is_the_whole_less_its_runs(result: dict[str, Any], substeps: int) -> None:
    """Exactly, round by round, and so in the median and the quartiles too."""
    costs = result["speed"][str(substeps)]
    for outside, whole in ((speed.OUTSIDE, speed.RECORDED), (speed.OUTSIDE_FLOWN, speed.FLOWN)):
        for quantile in ("median", "low", "high", "least"):
            assert costs[outside]["units"][quantile] == pytest.approx(costs[whole]["units"][quantile] - substeps)


def test_the_breakdown_adds_up(result: dict[str, Any]) -> None:
    found = result["breakdown"]
    flying = set(found["alone"]) - {blocks.DISK}  # which comes once in many steps and has no median
    assert set(found["in_flight"]) == flying
    parts = [part["units"] for part in found["in_flight"].values()] + [found["alone"][blocks.DISK]["units"]["median"]]
    assert sum(parts) + found["rest_units"] == pytest.approx(found["outside"]["units"]["median"])


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


def test_six_engines_are_asked_to_cost_at_most_one_and_a_half_runs(measured: Result) -> None:
    rows = [row for row in measured.headlines() if row[0].startswith(speed.ENGINES)]
    assert [most for _, _, most, _ in rows] == [1.5] * len(speed.SUBSTEPS)
    expected = [measured.speed[runs][speed.ENGINES].units.median for runs in speed.SUBSTEPS]
    assert [value for _, value, _, _ in rows] == expected


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


def test_the_way_to_the_first_step(result: dict[str, Any]) -> None:
    startup = result["startup"]
    parts = [startup[name]["median"] for name in ("python_s", "imports_s", "build_s")]
    assert min(parts) > 0.0
    assert sum(parts) == pytest.approx(startup["first_step_s"]["median"])


def test_memory_is_seen_all_along_a_flight(result: dict[str, Any]) -> None:
    memory = result["memory"]
    assert memory["steps"] == 1500  # 0.1 min at 250 Hz
    assert [mark["where"] for mark in memory["landmarks"]] == [
        "start", "1/4", "2/4", "3/4", "4/4", "log and summary", "report"
    ]  # fmt: skip
    peaks = [mark["peak_mb"] for mark in memory["landmarks"]]
    assert peaks == sorted(peaks)
    assert memory["peak_mb"] == peaks[-1] > 0.0
    assert memory["log_mb"] > 1500 * 8 / 1e6  # one column alone, were it not compressed


def test_tables_for_people(measured: Result, capsys: pytest.CaptureFixture[str]) -> None:
    print_result(measured)
    told = capsys.readouterr().out
    for words in (speed.OUTSIDE, blocks.SENSORS, "to the first step", "at most", "[quartiles]", "min flown"):
        assert words in told
    assert "FMPy's wrappers" in told
    print_result(replace(measured, memory=None, peers=replace(measured.peers, missing={"other": "why not"})))
    told = capsys.readouterr().out
    assert "min flown" not in told
    assert "other not measured: why not" in told


@pytest.mark.parametrize(
    ("arguments", "plan"),
    [
        ([], Plan()),
        (["--steps", "300", "--rounds", "3", "--starts", "2"], Plan(300, 3, 2)),
        (["--full"], Plan(memory_minutes=60.0)),
        (["--full", "--memory-minutes", "5"], Plan(memory_minutes=5.0)),
    ],
)
def test_options_make_the_plan(
    measured: Result, monkeypatch: pytest.MonkeyPatch, arguments: list[str], plan: Plan
) -> None:
    """The long flight is off unless asked for."""
    plans: list[Plan] = []

    def note(plan: Plan, on_progress: object) -> Result:
        plans.append(plan)
        return measured

    monkeypatch.setattr("cosim.bench.measure", note)
    answer = CliRunner().invoke(cli, ["bench", *arguments, "--json"])
    assert answer.exit_code == 0, answer.output
    assert plans == [plan]
    assert json.loads(answer.stdout) == json.loads(json.dumps(measured.to_dict()))


@pytest.mark.parametrize(
    "name",
    [
        blocks.COMMAND, blocks.DISTURBANCE, blocks.ATTITUDE, blocks.RATE, blocks.ALTITUDE, blocks.ALLOCATION,
        blocks.ENGINES, blocks.SERVOS, blocks.SENSORS, blocks.JUDGE,
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
        simulation.engines.reset(0.4)
        # one throttle is moved: one thrust moves, later than the engine's delay
        for k in range(100):
            thrust = simulation.engines.step(k, (0.4, 0.4, 0.5, 0.4, 0.4, 0.4)).thrust
        assert len(set(thrust[:2] + thrust[3:])) == 1
        assert thrust[2] > thrust[0]


def test_the_unit_is_one_run_in_hover(tmp_path: Path) -> None:
    """Bare JSBSim stays in the air with the forces held, and one ``run`` is one of its steps."""
    with speed.Flights(250, tmp_path) as flights:
        for substeps, unit in flights.units().items():
            unit.prepare()()
            airframe = flights._bare[substeps].airframe
            state = airframe.step([(0.0, 0.0, -9.0)] * 6, flights._bare[substeps].disturber.at(0))
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
    for spread, value in ((cost.units, 1.0), (cost.units_wall, 2.0), (cost.units_process, 3.0)):
        assert [spread.median, spread.low, spread.high, spread.least] == pytest.approx(4 * [value])
    assert cost.cpu_us.median == pytest.approx(3.0)  # of 10 - 4 * 2 and 20 - 4 * 4
    assert cost.cpu_us.least == pytest.approx(2.0)


def test_memory_landmarks_in_order(tmp_path: Path) -> None:
    told: list[tuple[str, int]] = []
    fly_long(tmp_path / "run", 0.02, lambda where, steps: told.append((where, steps)))
    assert told == [
        ("start", 0), ("1/4", 75), ("2/4", 150), ("3/4", 225), ("4/4", 300), ("log and summary", 300), ("report", 300)
    ]  # fmt: skip
    assert (tmp_path / "run" / "report.html").is_file()


def test_memory_grows_with_what_is_held() -> None:
    before, _ = resident_and_peak()
    held = bytearray(b"x" * 50_000_000)
    after, peak = resident_and_peak()
    assert peak >= 50.0
    if before is not None and after is not None:
        assert math.isclose(after - before, 50.0, abs_tol=10.0)  # the allocator's own
        assert peak >= after - 1.0  # the kernel brings the peak up to date now and then
    del held
