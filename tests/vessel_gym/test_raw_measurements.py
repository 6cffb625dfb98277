"""Raw measurements: an episode that nothing enters that an estimator believes."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    CARRIED,
    ENVIRONMENTS,
    FEW_MEMBERS,
    assert_same_tree,
    every_environment,
    make_batch,
    make_core,
    random_walk,
    single_class,
)

GOALS = [key for key in ENVIRONMENTS if "arrived" in single_class(key).system.task.end_reasons]

BELIEVED = {"estimate", "covariance", "input_estimate", "healthy"}
"""All of ``info`` that may differ between estimators."""

NEAR = {
    "SigmaCorvette-v0": {"radius": 300.0},
    "ThesisCorvette-v0": {"simulation": "V"},
    "SegorogeniAUV-v0": {"goal": (4.5, 0.0, 0.2)},
    "ItsunusaAUV-v0": {"goal": (9.0, 0.0, 0.4)},
    "PunaUAV-v0": {"start": (0.0, 0.0, 0.0), "goal": (140.0, 0.0, 0.0), "obstacles": []},
}
NEAR |= {
    "vessel_gym/Ship-v0": {"radius": 600.0},
    "vessel_gym/AUV-v0": {"goal": (6.5, 0.0, 0.2)},
    "vessel_gym/FixedWing-v0": NEAR["PunaUAV-v0"],
    "Usbl-v0": NEAR["SegorogeniAUV-v0"],
    "Shear-v0": NEAR["SegorogeniAUV-v0"],
    "HeavyShip-v0": {"radius": 300.0},
    "Docking-v0": {},
}
"""Missions that are soon over."""


def without_beliefs(tree: Any) -> Any:
    """What came out of a reset or a step, but for what an estimator may believe."""
    if isinstance(tree, tuple):
        return tuple(without_beliefs(part) for part in tree)
    if isinstance(tree, dict):
        return {
            key: without_beliefs(value)
            for key, value in tree.items()
            if key.lstrip("_") not in BELIEVED
        }
    return tree


def flown(env: Any, env_id: str, rows: int | None) -> list[Any]:
    """All that comes out of a batch, or with ``rows=None`` of a single environment, that is steered gently."""
    out = [env.reset(seed=11, options=NEAR[env_id])]
    walk = random_walk(3, rows or 1, env.unwrapped.core.config.action_size)
    for _ in range(100):
        actions = 0.3 * next(walk)
        out.append(env.step(actions if rows else actions[0]))
        if rows is None and (out[-1][2] or out[-1][3]):
            out.append(env.reset())
    return [without_beliefs(part) for part in out]


@pytest.mark.slow
@every_environment
def test_an_episode_is_the_same_to_the_last_bit_whatever_estimator_is_named(env_id: str):
    options = {
        "observe": "measurement",
        "sensors": "degraded",
        "disturbance": "rough",
        "mismatch": 0.2,
    }
    names = [name for key, name in CARRIED if key == env_id]
    batches, singles = {}, {}
    for name in names:
        chosen = options | {
            "estimator": name,
            "estimator_options": FEW_MEMBERS.get(name),
            "max_episode_steps": 90,
        }
        batches[name] = flown(make_batch(env_id, 3, **chosen), env_id, 3)
        if name in (names[0], "truth", "measurement"):
            singles[name] = flown(
                gym.make(env_id, disable_env_checker=True, **chosen), env_id, None
            )
    for trials in (batches, singles):
        for name, trial in trials.items():
            for step, (one, other) in enumerate(zip(trials[names[0]], trial, strict=True)):
                assert_same_tree(one, other, f"{name} instead of {names[0]}, step {step}")
    infos = [out[-1] for out in batches[names[0]]]
    numbers = {end for info in infos if "final_info" in info for end in info["final_info"]["end"]}
    ends = {single_class(env_id).system.task.end_reasons[number] for number in numbers}
    assert bool(ends & {"arrived", "missed the goal"}) == (
        env_id in GOALS
    )  # what estimators used to decide


@pytest.mark.slow
@every_environment
def test_an_episode_is_judged_as_if_the_truth_were_believed(env_id: str):
    raw = make_core(env_id, 6, seed=4, observe="measurement", estimator="dead-reckoning")
    told = make_core(env_id, 6, seed=4, estimator="truth")
    for core in (raw, told):
        core.reset(options=NEAR[env_id])
    walk, over = random_walk(4, 6, raw.config.action_size), 0
    for _ in range(300 if env_id == "Docking-v0" else 100):  # whose dock is where it is
        actions = 0.3 * next(walk)
        now, expected = raw.step(actions), told.step(actions)
        np.testing.assert_allclose(now.reward, expected.reward, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(now.end, expected.end)
        np.testing.assert_array_equal(raw.truth, told.truth)
        over += now.end.sum()
    assert over > 0
