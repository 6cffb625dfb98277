"""Rollouts: the same seeds give the same flights, however they are batched."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from refusals import refused

from agents import RandomAgent, load_agent, rollout
from agents.metrics import scores
from agents.rollouts import run_to_ends
from vessel_gym.envs import SigmaCorvetteVectorEnv
from vessel_gym.sensor_faults import SensorFault

ENV = "SigmaCorvette-v0"
ROUGH = {"disturbance": "rough", "sensors": "degraded"}
SENSORS = SigmaCorvetteVectorEnv.system.vehicle.sensors


class Own:
    """An agent that acts on the number of rows alone."""

    def __init__(self, act: Callable[[int], Any]) -> None:
        self.given = act

    def reset(self, num_envs: int) -> None:
        pass

    def act(self, observations: np.ndarray) -> Any:
        return self.given(len(observations))


HARD_OVER = Own(lambda rows: np.ones((rows, 1), np.float32))
"""Puts the rudder hard over at once, and loses the turn."""


@pytest.mark.parametrize("agent", ["autopilot", HARD_OVER], ids=["autopilot", "hard over"])
def test_a_rollout_equals_a_loop_over_single_environments(agent: Any):
    seeds = [*range(5, 14), 900_000]
    flight = rollout(agent, ENV, seeds, ROUGH)
    hard_over = agent is HARD_OVER
    assert flight.terminated.any() == hard_over
    assert len(set(flight.length)) > 1 or not hard_over  # the ends are staggered
    for i in (0, 4, 9):
        env: Any = gym.make(ENV, **ROUGH)
        flyer = load_agent(agent, env) if agent == "autopilot" else agent
        flyer.reset(1)
        seen, info = env.reset(seed=seeds[i])
        infos, total, done = [info], 0.0, False
        while not done:
            seen, reward, terminated, truncated, info = env.step(flyer.act(seen[None])[0])
            infos.append(info | {"input_covariance": env.unwrapped.core.now.belief.input_cov[0]})
            total += reward
            done = terminated or truncated
        assert flight.length[i] == len(infos) - 1
        assert flight.terminated[i] == terminated
        assert flight.end[i] == ("turn lost" if terminated else "")
        assert abs(flight.returns[i] - total) < 1e-6
        assert abs(flight.score[i] - info["score"]) < 1e-9
        for key, value in flight.history.items():
            alone = [each[key] for each in infos[1:]]
            np.testing.assert_allclose(value[1 : len(infos), i], alone, 0, 1e-8, err_msg=key)
            # After its end an episode repeats its last values, and is marked as over.
            after, last = value[len(infos) :, i], value[len(infos) - 1, i]
            np.testing.assert_array_equal(after, np.broadcast_to(last, after.shape), err_msg=key)
        np.testing.assert_array_equal(flight.alive[:, i], np.arange(len(flight.alive)) < len(infos))


@pytest.mark.parametrize(
    "world",
    [
        ROUGH,
        {"estimator": "enkf", "sensors": [replace(each, latency=0.5) for each in SENSORS]},
        {"sensor_faults": [SensorFault(each.name, "off", begin=5.0) for each in SENSORS]},
        {"observe": "mean+std", "max_episode_steps": 110},
        {"observe": "measurement", "guidance": True},
    ],
    ids=["one program", "late", "faults", "truncated", "raw"],
)
def test_a_rollout_without_a_record_has_the_same_results(world: dict[str, Any]):
    whole, scored = (
        rollout(HARD_OVER, ENV, range(12), world, record=each) for each in (True, False)
    )
    assert len(set(whole.length)) > 1
    assert "ensemble" not in whole.history
    for name in ("score", "returns", "length", "terminated", "end", "scenario"):
        np.testing.assert_array_equal(getattr(scored, name), getattr(whole, name), err_msg=name)
    with pytest.raises(ValueError, match="record=True"):
        scores(scored)


def test_an_interrupted_run_leaves_the_core_at_the_start():
    env = rollout(HARD_OVER, ENV, range(12), ROUGH, record=False).env

    def stop(rows: np.ndarray, before: Any) -> None:
        assert not before.end.any()  # an episode that has ended is not stepped on
        if len(rows) < 12:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_to_ends(env.core, HARD_OVER, env.max_episode_steps, stop)
    np.testing.assert_array_equal(env.core.now.steps, np.zeros(12))


def test_a_step_of_ones_own_is_flown_with_and_without_a_record():
    class Halved(SigmaCorvetteVectorEnv):
        def step(self, actions: np.ndarray) -> Any:
            observations, reward, *rest = super().step(actions)
            return observations, 0.5 * reward, *rest

    gym.register("Halved-v0", vector_entry_point=Halved, max_episode_steps=5)
    whole, *halved = (
        rollout(HARD_OVER, name, [0], {"max_episode_steps": 5}, record=record).returns
        for name, record in ((ENV, False), ("Halved-v0", True), ("Halved-v0", False))
    )
    np.testing.assert_array_equal(halved, [0.5 * whole] * 2)


def test_reset_options_reach_the_environment():
    flight = rollout("autopilot", ENV, [1, 2], reset_options={"radius": -300.0})
    rate = flight.history["reference"][0, :, 3]
    assert rate[0] == rate[1] < 0.0
    assert not any(key.startswith("_") for key in flight.history)
    np.testing.assert_allclose(flight.score, flight.history["score"][-1], rtol=0, atol=1e-12)


class Counting(gym.Env):
    """Counts to three if its seed is 0, with a whole number in its first info and a word at last."""

    observation_space = action_space = gym.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        self.count, self.last = 0, 3 if seed == 0 else np.inf
        return np.zeros(1, np.float32), {"share": 0}

    def step(self, action: np.ndarray) -> Any:
        self.count += 1
        over = {"end": "there"} if self.count == self.last else {}
        info = {"share": self.count / 3.0} | over
        return np.zeros(1, np.float32), action.item(), bool(over), False, info


def test_environments_of_others_are_flown_too():
    gym.register("Counting-v0", Counting, max_episode_steps=5)
    flight = rollout(agent := RandomAgent(1, seed=5), "Counting-v0", [0, 1])
    agent.reset(2)
    actions = np.array([agent.act(np.zeros((2, 1)))[:, 0] for _ in range(5)], float)
    np.testing.assert_allclose(flight.returns, [actions[:3, 0].sum(), actions[:, 1].sum()])
    np.testing.assert_array_equal(flight.score, flight.returns)  # they have no score of their own
    assert flight.length.tolist() == [3, 5]
    assert flight.terminated.tolist() == [True, False]
    assert flight.end.tolist() == ["", ""]
    shares = np.array([[0, 1, 2, 3, 3, 3], range(6)]) / 3.0
    np.testing.assert_array_equal(flight.history["share"].T, shares)


def test_random_agent_repeats_itself_after_a_reset():
    agent, seen = RandomAgent(2, seed=1), np.zeros((4, 7))
    agent.reset(4)
    first, second = agent.act(seen), agent.act(seen)
    assert (first.shape, first.dtype) == ((4, 2), np.float32)
    assert (np.abs(first) <= 1.0).all()
    assert (first != second).any()
    agent.reset(4)
    np.testing.assert_array_equal(agent.act(seen), first)


KNOWN = "^unknown agent .*: choose autopilot, lqg, pid, ppo, random, the path of a checkpoint"


@pytest.mark.parametrize(
    ("agent", "env_id", "sentence"),
    [
        *((name, ENV, KNOWN) for name in ("controller", "p" * 5000, "pi\0lot")),
        *((kind("missing.zip"), ENV, "there is no checkpoint") for kind in (str, Path)),
        *((wrong, ENV, f"got {wrong!r}$") for wrong in (7, b"autopilot")),
        *((Own(lambda rows, shape=shape: shape and np.zeros(shape)), env_id,
           r"^act of Own returns shape .*, and must return \(2, 1\): ")
          for env_id, shape in ((ENV, (2, 7)), ("Pendulum-v1", (2,)), (ENV, None))),
        ("random", "Endless-v0", "episodes of Endless-v0 may never end: register it with max_ep"),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_is_refused_in_one_sentence(agent: Any, env_id: str, sentence: str):
    spec = gym.spec(ENV)
    gym.register("Endless-v0", spec.entry_point, vector_entry_point=spec.vector_entry_point)
    try:
        with refused((ValueError, TypeError), sentence):
            rollout(agent, env_id, [0, 1])
        assert rollout("random", "Endless-v0", [0], {"max_episode_steps": 5}).length == [5]
    finally:
        del gym.registry["Endless-v0"]


def test_ensemble_is_kept_if_asked_for():
    world = {"max_episode_steps": 4, "estimator": "enkf"}
    members = rollout("autopilot", ENV, [5], world, ensembles=True).history["ensemble"]
    assert members.shape[:2] == (5, 1)
    assert np.isfinite(members).all()
