"""Systems with the misprints of their papers: one word, for the world, the model or the filter."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from vessel_gym.envs import ItsunusaAUVEnv, PunaUAVEnv, SegorogeniAUVEnv, ThesisCorvetteEnv

PAPERS = {
    "SegorogeniAUV-v0": SegorogeniAUVEnv, "ItsunusaAUV-v0": ItsunusaAUVEnv,
    "PunaUAV-v0": PunaUAVEnv, "ThesisCorvette-v0": ThesisCorvetteEnv,
}  # fmt: skip
ROLL_AND_PITCH = slice(9, 11)


def episode(env_id: str, steps: int = 25, **options: Any) -> Any:
    """Environment, and truth and estimate before and after some steps of a constant action."""
    env = gym.make(env_id, **options).unwrapped
    _, first = env.reset(seed=3)
    action = np.full(env.action_space.shape, 0.3, np.float32)
    for _ in range(steps):
        *_, last = env.step(action)
    return env, first, last


@pytest.mark.parametrize("as_printed", [False, True])
def test_as_printed_neither_world_nor_filter_rolls_or_pitches(as_printed: bool):
    dead_reckoning = {"as_printed": as_printed, "estimator": "dead-reckoning"}
    _, first, last = episode("SegorogeniAUV-v0", **dead_reckoning)
    for values in ("truth", "estimate"):
        turned = (last[values] - first[values])[ROLL_AND_PITCH]
        assert bool(turned.any()) != as_printed


def test_a_printed_model_is_the_filter_s_alone():
    options = {"estimator": "dead-reckoning", "estimator_options": {"model": "as_printed"}}
    _, first, last = episode("SegorogeniAUV-v0", **options)
    turned = {
        name: (last[name] - first[name])[ROLL_AND_PITCH].any() for name in ("truth", "estimate")
    }
    assert turned == {"truth": True, "estimate": False}


@pytest.mark.parametrize("env_id", PAPERS)
def test_as_printed_an_episode_differs_and_its_score_counts(env_id: str):
    (_, _, right), (env, _, printed) = (episode(env_id, as_printed=of) for of in (False, True))
    assert np.abs(printed["estimate"] - right["estimate"]).max() > 1e-6
    assert 0.0 <= printed["score"] <= 1.0
    assert env.system is not PAPERS[env_id].system


def test_as_printed_is_true_or_false_and_of_papers_alone():
    with pytest.raises(ValueError, match="as_printed must be True or False, got 'yes'"):
        gym.make("PunaUAV-v0", as_printed="yes")
    with pytest.raises(TypeError, match="keyword argument 'as_printed'"):
        gym.make("SigmaCorvette-v0", as_printed=True)
