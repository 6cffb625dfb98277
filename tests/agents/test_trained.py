"""The agents that come with the package: they fly without torch, as torch would have them fly."""

import io
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from pages import blocks

from agents import load_agent, rollout
from agents.policies.agent import TrainedAgent
from agents.policies.checkpoint import description, packaged
from agents.seeds import evaluation_seeds

ROOT = Path(__file__).parents[2]
ENVIRONMENTS = ["SigmaCorvette-v0", "ThesisCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"]
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
    told = description(packaged(env_id))
    assert told is not None
    assert told["env_id"] == env_id
    assert told["trained_steps"] >= told["steps"]
    assert {"seed", "hyperparameters", "versions", "source"} <= set(told)
    assert told["env_options"]["estimator"] is None  # the default


def test_together_they_are_small():
    assert sum(path.stat().st_size for path in (ROOT / "agents/policies/trained").iterdir()) <= 2 * 1024**2


@pytest.mark.slow
@every_environment
def test_it_flies_far_better_than_chance(env_id: str):
    trained, random = (rollout(name, env_id, evaluation_seeds(8), record=False) for name in ("ppo", "random"))
    assert (trained.score > random.score + 0.2).all()


def test_it_flies_without_loading_torch():
    program = (
        "import sys; from agents import rollout; rollout('ppo', 'ThesisCorvette-v0', [0], record=False); "
        "print({'torch', 'stable_baselines3', 'sb3_contrib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.stdout == "set()\n", done.stderr


def test_the_example_of_the_page_runs():
    (example,) = blocks("agents", "python")
    exec(compile(example, "agents.md", "exec"), {"__name__": "page"})


@pytest.mark.parametrize(
    ("env_id", "options", "sentence"),
    [
        ("SigmaCorvette-v0", {"observe": "measurement"}, "trained on observe='mean', .* gives 'measurement'"),
        ("SigmaCorvette-v0", {"observe": "mean+std"}, "trained on observe='mean', .* gives 'mean.std'"),
        ("SigmaCorvette-v0", {"guidance": False}, "was trained in another environment"),
        ("vessel_gym/Ship-v0", {"vessel": "corvette"}, "no trained agent comes with the package for .* scripts.train"),
    ],
)
def test_where_it_cannot_fly_a_sentence_says_so(env_id: str, options: dict[str, object], sentence: str):
    with pytest.raises(ValueError, match=sentence) as caught:
        load_agent("ppo", gym.make(env_id, **options))
    assert "\n" not in str(caught.value)


def test_it_flies_other_estimators_as_it_is():
    assert rollout("ppo", "ThesisCorvette-v0", [0], {"estimator": "kf"}, record=False).score[0] > 0.5


def _with(path: Path, name: str, change: object) -> Path:
    """The Thesis corvette's checkpoint with one of its files changed; None: without it."""
    with zipfile.ZipFile(packaged("ThesisCorvette-v0")) as whole, zipfile.ZipFile(path, "w") as archive:
        for each in whole.namelist():
            data = whole.read(each)
            if each == name:
                data = change(data)  # type: ignore[operator]
            if data is not None:
                archive.writestr(each, data)
    return path


LAST = "weights/action_net.weight.npy"
DAMAGE = {
    "a layer missing": (LAST, lambda data: None),
    "not finite": (LAST, lambda data: data[:-4] + b"\xff" * 4),
    "truncated": (LAST, lambda data: data[:-4]),
    "another network": ("vessel_gym.json", lambda data: data.replace(b'"Tanh"', b'"ReLU"')),
    "another observation": (
        "vessel_gym.json",
        lambda data: re.sub(rb'"observations": \d+', b'"observations": 3', data),
    ),
    "other actions": ("vessel_gym.json", lambda data: re.sub(rb'"actions": \d+', b'"actions": 3', data)),
    "no JSON": ("vessel_gym.json", lambda data: data[:-9]),
}


def _first_row(data: bytes) -> bytes:
    """The first row of an array, in a file of its own."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.load(io.BytesIO(data))[:1])
    return buffer.getvalue()


LAYER = "weights/mlp_extractor.policy_net.{}.{}.npy"
DAMAGE |= {name: (name, _first_row) for name in (LAYER.format(0, "weight"), LAYER.format(0, "bias"),
                                                 LAYER.format(2, "bias"))}  # fmt: skip


@pytest.mark.parametrize("what", DAMAGE)
def test_a_damaged_file_is_refused_in_a_sentence(tmp_path: Path, what: str):
    env = gym.make("ThesisCorvette-v0")
    with pytest.raises(ValueError, match=r"agent\.zip is not a checkpoint of an agent, or is damaged") as caught:
        TrainedAgent(_with(tmp_path / "agent.zip", *DAMAGE[what]), env, dense=True)
    assert "\n" not in str(caught.value)


def test_a_file_cut_short_is_refused_in_a_sentence(tmp_path: Path):
    path = tmp_path / "agent.zip"
    shutil.copy(packaged("ThesisCorvette-v0"), path)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(ValueError, match=r"agent\.zip is not a checkpoint of an agent"):
        TrainedAgent(path, gym.make("ThesisCorvette-v0"), dense=True)


def test_observations_of_more_environments_than_were_counted_are_refused_in_a_sentence():
    env = gym.make("SigmaCorvette-v0")
    agent, (seen, _) = load_agent("ppo", env), env.reset(seed=0)
    assert agent.act(seen[None]).shape == (1, 1)
    for wrong in (seen, np.tile(seen, (3, 1))):
        with pytest.raises(ValueError, match=r"as many rows as reset\(num_envs\) was told, got \("):
            agent.act(wrong)
