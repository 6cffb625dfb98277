"""The agents that come with the package: they fly without torch, as torch would have them fly."""

import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from refusals import refused

from agents import load_agent, rollout
from agents.policies.checkpoint import description, packaged
from agents.seeds import evaluation_seeds

ROOT = Path(__file__).parents[2]
ENVIRONMENTS = ["SigmaCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"]
every_environment = pytest.mark.parametrize("env_id", ENVIRONMENTS)


@every_environment
def test_numpy_flies_as_torch_does(env_id: str):
    env = gym.make_vec(env_id, num_envs=4, disturbance="rough")
    ours, theirs = load_agent("ppo", env), load_agent(packaged(env_id), env)
    seen, _ = env.reset(seed=3)
    for agent in (ours, theirs):
        agent.reset(4)
    for _ in range(30):
        actions = ours.act(seen)
        assert actions.dtype == np.float32
        np.testing.assert_allclose(actions, theirs.act(seen), rtol=0.0, atol=1e-6)
        seen = env.step(actions)[0]
    wild = np.random.default_rng(0).uniform(-10.0, 10.0, (64, seen.shape[1])).astype(np.float32)
    for agent in (ours, theirs):
        agent.reset(64)
    np.testing.assert_allclose(ours.act(wild), theirs.act(wild), rtol=0.0, atol=1e-6)
    env.close()


@every_environment
def test_it_says_how_it_was_trained(env_id: str):
    described = description(packaged(env_id))
    assert described is not None
    assert described["env_id"] == env_id
    assert described["trained_steps"] >= described["steps"]
    assert {"seed", "hyperparameters", "versions", "source"} <= set(described)
    assert described["env_options"].get("estimator") is None  # the default


def test_make_policies_trains_those_that_come_with_the_package():
    trained = {path.stem for path in (ROOT / "agents/policies/trained").glob("*.zip")}
    policies = re.search(
        r"^POLICIES := (.+)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert policies is not None
    assert set(policies[1].split()) == trained == set(ENVIRONMENTS)


def test_together_they_are_small():
    assert (
        sum(path.stat().st_size for path in (ROOT / "agents/policies/trained").iterdir())
        <= 2 * 1024**2
    )


@pytest.mark.slow
@every_environment
def test_it_flies_far_better_than_chance(env_id: str):
    trained, random = (
        rollout(name, env_id, evaluation_seeds(8), record=False) for name in ("ppo", "random")
    )
    assert (trained.score > random.score + 0.2).all()


def test_it_flies_without_loading_torch():
    program = (
        "import sys; from agents import rollout; rollout('ppo', 'ItsunusaAUV-v0', [0],"
        " record=False); print({'torch', 'stable_baselines3', 'sb3_contrib'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert done.stdout == "set()\n", done.stderr


@pytest.mark.parametrize(
    ("env_id", "options", "sentence"),
    [
        (
            "SigmaCorvette-v0",
            {"observe": "measurement"},
            "trained on observe='mean', .* gives 'measurement'",
        ),
        (
            "SigmaCorvette-v0",
            {"observe": "mean+std"},
            "trained on observe='mean', .* gives 'mean.std'",
        ),
        ("SigmaCorvette-v0", {"guidance": False}, "was trained in another environment"),
        (
            "ThesisCorvette-v0",
            {},
            "no trained agent comes with the package for 'ThesisCorvette-v0', only for Itsunusa",
        ),
        (
            "vessel_gym/Ship-v0",
            {"vessel": "corvette"},
            "no trained agent comes with the package for .*vessel-gym train",
        ),
    ],
)
def test_where_it_cannot_fly_a_sentence_says_so(
    env_id: str, options: dict[str, object], sentence: str
):
    with refused(ValueError, sentence):
        load_agent("ppo", gym.make(env_id, **options))


def test_it_flies_other_estimators_as_it_is():
    assert rollout("ppo", "ItsunusaAUV-v0", [0], {"estimator": "kf"}, record=False).score[0] > 0.5


def test_observations_of_more_environments_than_were_counted_are_refused_in_a_sentence():
    env = gym.make("SigmaCorvette-v0")
    agent, (seen, _) = load_agent("ppo", env), env.reset(seed=0)
    assert agent.act(seen[None]).shape == (1, 1)
    for wrong in (seen, np.tile(seen, (3, 1))):
        with pytest.raises(ValueError, match=r"as many rows as reset\(num_envs\) was told, got \("):
            agent.act(wrong)
