"""The environment is what Gymnasium's own checks ask for, and its numbers are those of the flight."""

from __future__ import annotations

import subprocess
import sys
from math import acos, exp, nan, pi, radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT

from cosim import Command, FlightError, InputError, Scenario, Stepper, fly

gymnasium = pytest.importorskip("gymnasium", reason="the extra gym is not installed: make setup")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from hexjet_gym import ANGLE_SCALE, HEIGHT_SCALE, MAX_CLIMB, HexJetEnv, time_on_target  # noqa: E402

ID = "hexjet_gym:HexJet-v0"
QUICK = Scenario.load("roll-doublet").replace(duration_s=0.08, expect=[])
QUAD = Scenario.load("hover").replace(
    aircraft="quadrotor", engine="motor", controller="smith", step_s=0.0025, duration_s=0.1, expect=[]
)


@pytest.mark.parametrize(
    ("settings", "numbers"),
    [
        ({}, (15 + 8, 8)),
        ({"act": "rates", "hold": 5, "memory": 25, "scenario": QUICK}, (15 + 25 * 8, 4)),
        ({"act": "attitude", "scenario": QUAD}, (15 + 4, 4)),
        ({"scenario": QUAD}, (15 + 4, 4)),
    ],
)
def test_gymnasiums_own_checks(settings: dict[str, Any], numbers: tuple[int, int]) -> None:
    """Warnings are errors here: bounds, dtypes, seeds, determinism, what is returned, render modes."""
    env = gymnasium.make(ID, **settings).unwrapped
    check_env(env)
    assert (env.observation_space.shape, env.action_space.shape) == ((numbers[0],), (numbers[1],))
    assert (len(env.observed), len(env.acted)) == numbers


@pytest.mark.parametrize(("mode", "count"), [("sync", 2), ("async", 1)])
def test_many_at_once_are_each_alone(mode: str, count: int) -> None:
    """Seeds count up from one to the next; one that is over begins anew while the others fly on."""
    more = {"vector_kwargs": {"context": "spawn"}} if mode == "async" else {}
    both = gymnasium.make_vec(ID, count, vectorization_mode=mode, scenario=QUICK, act="rates", hold=5, **more)
    try:
        first, _ = both.reset(seed=1)
        actions = [np.array([[0.1, 0.0, 0.0, 0.5], [0.0, -0.1, 0.0, 0.5]])[:count]] * 5
        seen = [both.step(action) for action in actions]
    finally:
        both.close()
    assert count == 1 or not np.array_equal(seen[0][0][0][:3], seen[0][0][1][:3])
    assert [step[3].tolist() for step in seen] == [[False] * count] * 3 + [[True] * count, [False] * count]
    for index in range(count):
        alone = gymnasium.make(ID, scenario=QUICK, act="rates", hold=5)
        assert np.array_equal(alone.reset(seed=1 + index)[0], first[index])
        for step in seen[:4]:
            observation, reward, *_ = alone.step(actions[0][index])
            assert np.array_equal(observation, step[0][index])
            assert reward == step[1][index]
        alone.close()


def test_an_observation_and_an_action_are_what_they_are_called() -> None:
    env = HexJetEnv(QUICK, memory=2)
    env.reset(seed=3)
    names = [signal.name for signal in env.observed]
    action = np.array([0.4, 0.41, 0.42, 0.43, 0.44, 0.45, 0.1, -0.2])
    range_rad = env.flight.simulation.vehicle.servo.range_rad  # type: ignore[union-attr]
    env.step(action * 0.0)
    observation, _, _, _, info = env.step(action)
    by_name = dict(zip(names, observation.tolist(), strict=True))
    measured, wanted = env.flight.measured, env.flight.command
    assert info == {"time_s": 0.008}
    assert [by_name[f"rate_{name}"] for name in "pqr"] == list(measured.rate)
    assert [by_name[f"attitude_{name}"] for name in "wxyz"] == list(measured.attitude)
    assert [by_name[f"velocity_{name}"] for name in ("north", "east", "down")] == list(measured.velocity)
    assert (by_name["altitude"], by_name["altitude_setpoint"]) == (measured.altitude, wanted.altitude)
    assert [by_name[f"throttle_{jet}_before_1"] for jet in range(1, 7)] == action[:6].tolist()
    assert by_name["tilt_right_before_1"] == pytest.approx(-0.2 * range_rad, abs=1e-15)
    assert by_name["throttle_1_before_2"] == 0.0
    # what is beyond its bounds is the bound
    env.step(action * 10.0)
    assert env.flight.simulation.propulsion.engines.bank is not None
    assert env.observed[-1].high == range_rad
    env.close()


@pytest.mark.parametrize("act", ["rates", "attitude"])
def test_what_flies_under_an_action_is_what_a_command_asks_for(act: str) -> None:
    env = HexJetEnv(QUICK, act=act)
    env.reset(seed=3)
    scale = [signal.scale for signal in env.acted]
    with Stepper(QUICK, log=False) as flight:
        flight.reset(env.flight.scenario.seed)
        for _ in range(5):
            env.step(np.array([0.2, -0.1, 0.05, 0.5]))
            x, y, z = 0.2 * scale[0], -0.1 * scale[1], 0.05 * scale[2]
            asked = flight.command
            if act == "rates":
                flight.step(Command(asked.attitude, asked.altitude, (x, y, z), 0.5))
            else:
                assert scale == [pi / 6.0, pi / 6.0, pi, MAX_CLIMB]
                flight.step(Command((x, y, z), 30.0 + 0.5 * MAX_CLIMB))
        assert flight.state == env.flight.state
    env.close()


def test_the_scenarios_own_command_flown_through_it_is_worth_what_the_formula_says() -> None:
    """Flown by its controller the reward is that of the log: the formula, on another way."""
    scenario = Scenario.load("roll-doublet").replace(
        duration_s=0.4, expect=[], command=[{"kind": "step", "signal": "roll_deg", "start_s": 0.1, "amplitude": 10.0}]
    )
    env = HexJetEnv(scenario, act="attitude", vary=lambda flown, generator: flown)
    env.reset(seed=1)
    total, scale, ended = 0.0, env.acted[0].scale, False
    while not ended:
        roll = env.flight.command.attitude[0]
        _, reward, terminated, ended, info = env.step(np.array([roll / scale, 0.0, 0.0, 0.0]))
        assert not terminated
        total += float(reward)
    assert (info["outcome"], info["reason"]) == ("completed", "flew 100 steps")
    log = fly(scenario.replace(seed=env.flight.scenario.seed, duration_s=0.404)).log
    expected = 0.0
    for k in range(100):
        roll, pitch, yaw = (log[f"{axis}_rad"][k + 1] for axis in ("roll", "pitch", "yaw"))
        roll -= log["roll_setpoint_rad"][k]
        angle = acos(max(-1.0, (np.cos(roll) * np.cos(pitch) + np.cos(roll) * np.cos(yaw) + np.cos(pitch) * np.cos(yaw)
                                + np.sin(roll) * np.sin(pitch) * np.sin(yaw) - 1.0) / 2.0))  # fmt: skip
        height = log["altitude_m"][k + 1] - log["altitude_setpoint_m"][k]
        expected += 0.004 * exp(-((angle / ANGLE_SCALE) ** 2) - (height / HEIGHT_SCALE) ** 2)
    # the turns do not quite commute with the set-point's: pitch and yaw stay below a hundredth of a radian
    assert total == pytest.approx(expected, rel=1e-3)
    assert 0.1 < total < 0.12  # the time before the step, and nearly nothing of the 10 degrees that come late
    env.close()


def test_a_reward_of_ones_own_and_flights_that_vary() -> None:
    seen: list[float] = []

    def mine(flight: Stepper, sample: Any, wanted: Command) -> float:
        seen.append(sample.time)
        return 2.0

    def vary(scenario: Scenario, generator: np.random.Generator) -> Scenario:
        lean = float(generator.uniform(-5.0, 5.0))
        return scenario.replace(initial={"altitude_m": 10.0, "attitude_deg": [lean, 0.0, 0.0]})

    env = HexJetEnv(QUICK, act="rates", reward=mine, hold=3, vary=vary)
    leans = []
    for seed in (1, 1, None, None):
        env.reset(seed=seed)
        leans.append(env.flight.state.euler[0])
    assert leans[0] == leans[1]
    assert len(set(leans)) == 3
    assert max(map(abs, leans)) <= radians(5.0)
    assert env.step(np.array([0.0, 0.0, 0.0, 0.5]))[1] == 6.0
    assert seen == [0.0, 0.004, 0.008]
    env.close()


def test_what_is_lost_is_terminated_and_worth_nothing() -> None:
    lost = QUICK.replace(initial={"altitude_m": 10.0, "rate_deg_s": [900.0, 0.0, 0.0]}, duration_s=1.0)
    env = HexJetEnv(lost, render_mode="ansi")
    env.reset(seed=0)
    assert env.render() == "0.000 s: roll 0.0, pitch 0.0, yaw 0.0 deg, height 10.00 m, throttles" + " 0.45" * 6
    terminated = False
    while not terminated:
        _, reward, terminated, truncated, info = env.step(env.action_space.high)
    assert not truncated
    assert (reward, info["outcome"]) == (0.0, "diverged")
    assert "turned faster" in info["reason"] or "leaned past" in info["reason"]
    with pytest.raises(FlightError, match=r"the episode is over \(diverged\): reset begins another"):
        env.step(env.action_space.high)
    env.close()


def test_a_controller_that_fails_terminates_with_what_was_seen_last(tmp_path: Path) -> None:
    """Nothing of the step in which it failed is to be seen, nor of one that is not flown any more."""
    (tmp_path / "wrong.py").write_text(
        "class Wrong:\n    level = 'rate'\n    def reset(self): self.k = 0\n"
        "    def update(self, *told):\n        self.k += 1\n        return [0.0 if self.k < 3 else float('nan')] * 3\n"
    )
    env = HexJetEnv(QUICK.replace(controller=f"{tmp_path / 'wrong.py'}:Wrong"), act="rates")
    env.reset(seed=0)
    action = np.array([0.0, 0.0, 0.0, 0.5])
    env.step(action)
    seen = env.step(action)[0]
    observation, reward, terminated, truncated, info = env.step(action)
    assert np.array_equal(observation, seen)
    assert (reward, terminated, truncated, info["outcome"]) == (0.0, True, False, "failed")
    assert "the answer for roll = nan: must be finite at step 2 (0.008 s)" in info["reason"]
    env.reset()
    assert not env.step(action)[2]
    env.close()


def test_what_cannot_be_is_one_line() -> None:
    other = HexJetEnv(QUICK, vary=lambda scenario, generator: scenario.replace(step_s=0.002))
    with pytest.raises(InputError, match=r"vary: step_s = 0\.002: must stay 0\.004"):
        other.reset()
    other.close()
    rates = [{"kind": "step", "signal": "rate_p_deg_s", "start_s": 0.0, "amplitude": 1.0}]
    place = [{"kind": "place", "start_s": 0.0, "north_m": 1.0}]
    wrong: dict[str, dict[str, Any]] = {
        "act = 'throttle': allowed: actuators, attitude, rates": {"act": "throttle"},
        "hold = 0: must be a whole number from 1": {"hold": 0},
        "render_mode = 'human': must be None or 'ansi'": {"render_mode": "human"},
        "commands rate_p_deg_s; an environment takes one that commands att": {"scenario": QUICK.replace(command=rates)},
        "commands a place": {"scenario": QUICK.replace(command=place)},
    }
    for said, given in wrong.items():
        with pytest.raises(InputError, match=said):
            HexJetEnv(**given)
    env = HexJetEnv(QUICK)
    env.reset(seed=0)
    for action in (np.zeros(3), np.full(8, nan)):
        with pytest.raises(InputError, match="must be 8 finite numbers"):
            env.step(action)
    env.close()
    with Stepper(QUICK, log=False) as flight:
        sample = flight.step()
        assert 0.0039 < time_on_target(flight, sample, sample.command) <= 0.004


@pytest.mark.parametrize(("ours", "extra"), [("hexjet_gym", "gymnasium"), ("hexjet_batch.with_jax", "jax")])
def test_without_the_extra_it_says_which_one(ours: str, extra: str) -> None:
    script = f"import sys; sys.modules['{extra}'] = None\nimport {ours}"
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    said = f"ModuleNotFoundError: {ours} needs {extra}, which is not installed: pip install {extra}"
    assert answer.stderr.splitlines()[-1] == said
