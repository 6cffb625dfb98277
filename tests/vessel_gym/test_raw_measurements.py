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
from gymnasium.vector import AutoresetMode

from agents import load_agent
from estimators import Belief, Filter
from vessel_gym.core import Core
from vessel_gym.system import Estimate

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
        return {key: without_beliefs(value) for key, value in tree.items() if key.lstrip("_") not in BELIEVED}
    return tree


def flown(env: Any, env_id: str, rows: int | None) -> list[Any]:
    """All that comes out of a batch, or with ``rows=None`` of a single environment, that is steered gently."""
    out = [env.reset(seed=11, options=NEAR[env_id])]
    walk = random_walk(3, rows or 1, env.unwrapped.core.action_size)
    for _ in range(100):
        actions = 0.3 * next(walk)
        out.append(env.step(actions if rows else actions[0]))
        if rows is None and (out[-1][2] or out[-1][3]):
            out.append(env.reset())
    return [without_beliefs(part) for part in out]


@pytest.mark.slow
@every_environment
def test_an_episode_is_the_same_to_the_last_bit_whatever_estimator_is_named(env_id: str):
    options = {"observe": "measurement", "sensors": "degraded", "disturbance": "rough", "mismatch": 0.2}
    names = [name for key, name in CARRIED if key == env_id]
    batches, singles = {}, {}
    for name in names:
        chosen = options | {"estimator": name, "estimator_options": FEW_MEMBERS.get(name), "max_episode_steps": 90}
        batches[name] = flown(make_batch(env_id, 3, **chosen), env_id, 3)
        if name in (names[0], "truth", "measurement"):
            singles[name] = flown(gym.make(env_id, disable_env_checker=True, **chosen), env_id, None)
    for trials in (batches, singles):
        for name, trial in trials.items():
            for step, (one, other) in enumerate(zip(trials[names[0]], trial, strict=True)):
                assert_same_tree(one, other, f"{name} instead of {names[0]}, step {step}")
    infos = [out[-1] for out in batches[names[0]]]
    ends = {end for info in infos if "final_info" in info for end in info["final_info"]["end"]}
    assert bool(ends & {"arrived", "missed the goal"}) == (env_id in GOALS)  # what estimators used to decide


class Vandal(Filter):
    """An estimator of one's own that writes into whatever it is given, and believes nonsense, once it flies."""

    flies = False  # in an environment, not before one that looks at it first

    def update(self, belief: Belief, y: np.ndarray, *args: Any, **kwargs: Any) -> Belief:
        self.flies = "u" in kwargs
        for array in (y, kwargs["available"], kwargs["u"]) if self.flies else ():
            if array is not None and array.flags.writeable:
                array[...] = 0
        return super().update(belief, y, *args, **kwargs)

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Any) -> Belief:
        if not self.flies:
            return belief.replace(u=u)
        if u is not None and u.flags.writeable:
            u[...] = 7.0
        return belief.replace(mean=np.full_like(belief.mean, np.nan))

    def _update(self, belief: Belief, measurement: Any, rng: Any) -> Belief:
        if not self.flies:
            return belief
        measurement.available[...] = False
        return belief.replace(mean=np.full_like(belief.mean, 1e300), cov=-belief.cov)


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(AutoresetMode))
@every_environment
def test_an_estimator_of_ones_own_cannot_spoil_an_episode_of_raw_measurements(env_id: str, mode: AutoresetMode):
    def trial(estimator: Any) -> list[Any]:
        env = make_batch(env_id, 3, observe="measurement", sensors="degraded", estimator=estimator,
                         autoreset_mode=mode, max_episode_steps=12)  # fmt: skip
        out, done = [env.reset(seed=5)], np.zeros(3, bool)
        walk = random_walk(3, 3, env.core.action_size)
        for step in range(20):
            asked = done if mode is AutoresetMode.DISABLED else np.array([step == 7, False, step == 7])
            if asked.any():
                out.append(env.reset(options={"reset_mask": asked}))
            out.append(env.step(next(walk)))
            done = out[-1][2] | out[-1][3]
        return [without_beliefs(part) for part in out]

    for step, (one, other) in enumerate(zip(trial("truth"), trial(Vandal), strict=True)):
        assert_same_tree(one, other, f"step {step}")


@pytest.mark.slow
@every_environment
def test_an_episode_is_judged_as_if_the_truth_were_believed(env_id: str):
    raw = make_core(env_id, 6, seed=4, observe="measurement", estimator="dead-reckoning")
    told = make_core(env_id, 6, seed=4, estimator="truth")
    for core in (raw, told):
        core.reset(options=NEAR[env_id])
    walk, over = random_walk(4, 6, raw.action_size), 0
    for _ in range(300 if env_id == "Docking-v0" else 100):  # whose dock is where it is
        actions = 0.3 * next(walk)
        (reward, done), (expected, expected_done) = raw.step(actions), told.step(actions)
        np.testing.assert_allclose(reward, expected, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(done, expected_done)
        np.testing.assert_array_equal(raw.end, told.end)
        np.testing.assert_array_equal(raw.truth, told.truth)
        over += done.sum()
    assert over > 0


def seen_with_perfect_knowledge(core: Core) -> np.ndarray:
    """The observation of mode ``"mean"`` of somebody who knows the truth."""
    task, state = core.task, core.state
    known = Estimate(state, core.exogenous[:, len(core.vehicle.increments) :])
    seen = task.observe(known, task.reference(core.scenario, core.steps, state), core.actuators)
    return np.clip(seen, -task.BOUND, task.BOUND).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", GOALS)
def test_who_knows_the_truth_arrives_in_every_episode_on_hidden_held_measurements(env_id: str):
    """Ended by held measurements, 7 of 48 Segorogeni dives, 8 of 48 ITSUNUSA dives and 23 flights did."""
    core = make_core(env_id, 48, observe="measurement", estimator="measurement")
    controller = load_agent("autopilot", gym.make(env_id))
    core.reset()
    controller.reset(48)
    end = np.zeros(48, int)
    for _ in range(core.task.horizon):
        core.step(controller.act(seen_with_perfect_knowledge(core)))
        end = np.where(end == 0, core.end, end)
        if end.all():
            break
    assert [core.task.end_reasons[number] for number in end] == ["arrived"] * 48
