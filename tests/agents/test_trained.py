"""The agents that come with the package: they fly without torch."""

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
TRAINED = ROOT / "agents/policies/trained"
ENVIRONMENTS = ["SigmaCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"]


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_trained_agent_is_far_better_than_chance(env_id: str):
    trained, random = (
        rollout(name, env_id, evaluation_seeds(8), record=False) for name in ("ppo", "random")
    )
    assert (trained.score > random.score + 0.2).all()
    described = description(packaged(env_id))
    assert described["env_id"] == env_id
    assert described["trained_steps"] >= described["steps"]
    assert {"seed", "hyperparameters", "versions", "source"} <= set(described)
    assert described["env_options"].get("estimator") is None  # the default


def test_make_policies_trains_those_of_the_package():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    policies = re.search(r"^POLICIES := (.+)$", makefile, re.MULTILINE)
    assert policies is not None
    assert set(policies[1].split()) == {path.stem for path in TRAINED.iterdir()}
    assert set(policies[1].split()) == set(ENVIRONMENTS)
    assert sum(path.stat().st_size for path in TRAINED.iterdir()) <= 2**18


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
        ("SigmaCorvette-v0", {"observe": "measurement"}, "on observe='mean', .* 'measurement'"),
        ("SigmaCorvette-v0", {"observe": "mean+std"}, "observe='mean', .* gives 'mean.std'"),
        ("SigmaCorvette-v0", {"guidance": False}, "was trained in another environment"),
        ("ThesisCorvette-v0", {}, "no trained .* for 'ThesisCorvette-v0', only for Itsunusa"),
        ("vessel_gym/Ship-v0", {"vessel": "corvette"}, "no trained .*vessel-gym train"),
    ],
)
def test_where_it_cannot_fly_a_sentence_says_so(
    env_id: str, options: dict[str, object], sentence: str
):
    with refused(ValueError, sentence):
        load_agent("ppo", gym.make(env_id, **options))


def test_observations_of_too_many_rows_are_refused():
    env = gym.make("SigmaCorvette-v0")
    agent, (seen, _) = load_agent("ppo", env), env.reset(seed=0)
    assert agent.act(seen[None]).shape == (1, 1)
    for wrong in (seen, np.tile(seen, (3, 1))):
        with pytest.raises(ValueError, match=r"as many rows as reset\(num_envs\) was told, got \("):
            agent.act(wrong)
