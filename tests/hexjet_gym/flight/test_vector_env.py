"""Many flights as one environment: each is the flight that the environment of one flight has."""

from __future__ import annotations

import numpy as np
import pytest

from cosim import InputError, Scenario

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils import env_checker as checker  # noqa: E402

from hexjet_batch.vector_env import HexJetVectorEnv as OldName  # noqa: E402
from hexjet_gym import HexJetEnv, HexJetVectorEnv  # noqa: E402

pytestmark = pytest.mark.flight


@pytest.mark.parametrize("act", ["rates", "attitude"])
def test_each_flight_is_that_of_the_environment_of_one(act: str) -> None:
    """JSBSim with 16 runs a step is within 1e-4 of the batch after 100 steps: of rates, angles, speeds, m."""
    scenario = Scenario.load("roll-doublet", ["duration_s=0.8", "substeps=16"])
    envs, single = HexJetVectorEnv(3, scenario, act, hold=2, memory=2), HexJetEnv(scenario, act, hold=2, memory=2)
    observation, _ = envs.reset(seed=5)
    alone, _ = single.reset(seed=7)
    np.testing.assert_allclose(observation[2], alone, atol=1e-12)
    action = np.array([0.02, -0.01, 0.01, 0.45 if act == "rates" else 0.01])
    for _ in range(50):
        observation, reward, _, _, info = envs.step(np.tile(action, (3, 1)))
        alone, reward_alone, _, _, info_alone = single.step(action)
    np.testing.assert_allclose(observation[2], alone, atol=1e-4)
    assert reward[2] == pytest.approx(reward_alone, rel=1e-4)
    assert info["time_s"][2] == pytest.approx(info_alone["time_s"])
    single.close()


def test_it_is_what_gymnasium_asks_of_an_environment_of_many() -> None:
    """Its checkers pass, all flights end with the scenario, and the step after begins the next episode."""
    envs = OldName(2, Scenario.load("hover", ["duration_s=0.04"]))
    for check in (checker.check_reset_seed_determinism, checker.check_reset_options, checker.env_reset_passive_checker):
        check(envs)
    envs.action_space.seed(1)
    recorded = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
    recorded.reset(seed=1)
    for k in range(1, 12):
        observation, reward, terminated, truncated, info = recorded.step(envs.action_space.sample())
        assert envs.observation_space.contains(observation)
        assert reward.shape == terminated.shape == truncated.shape == (2,)
        assert truncated.tolist() == [k == 10] * 2
        assert ("episode" in info) is (k == 10)
    assert envs.step(envs.action_space.sample())[4]["time_s"].tolist() == [0.004] * 2


def test_a_flight_that_is_lost_stays_lost_without_reward() -> None:
    envs = HexJetVectorEnv(2, Scenario.load("hover", ["duration_s=1.2", "sensor_noise=false"]), hold=300)
    envs.reset(seed=1)
    _, _, terminated, truncated, _ = envs.step(np.array([[0.0, 0.0, 0.0, 0.4], [1.0, 1.0, 0.0, 1.0]]))
    assert (terminated.tolist(), truncated.tolist()) == ([False, True], [True, False])


@pytest.mark.parametrize(("given", "named"), [((0,), "num_envs = 0"), ((2, "hover", "actuators"), "act = 'actuators'")])
def test_wrong_input_is_one_line(given: tuple[object, ...], named: str) -> None:
    with pytest.raises(InputError, match=named):
        HexJetVectorEnv(*given)  # type: ignore[arg-type]
