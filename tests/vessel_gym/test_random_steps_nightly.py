"""1.2e8 steps under random actions: nothing raises, and nothing that is shown is not a number.

``make nightly``; some twenty minutes on two cores. Degraded sensors, rough weather and a wrong model, a seed each.
"""

import gymnasium as gym
import numpy as np
import pytest
from contract import OURS

import vessel_gym  # noqa: F401
from vessel_gym.estimation import estimator_names

pytestmark = pytest.mark.nightly

ROWS = 512
CHEAP = ("kf-umv-ui", "kf", "ulise", "huber-kf", "robust-kf", "truth", "measurement", "dead-reckoning")
CASES = [(env_id, name) for env_id in OURS for name in estimator_names()]
STEPS = {case: 10_000_000 if case[0].startswith("Sigma") and case[1] in CHEAP else 600_000 for case in CASES}


@pytest.mark.parametrize(("env_id", "estimator"), CASES)
def test_random_steps_stay_finite(env_id: str, estimator: str):
    try:
        env = gym.make_vec(
            env_id, num_envs=ROWS, vectorization_mode="vector_entry_point", estimator=estimator, observe="mean+std",
            sensors="degraded", disturbance="rough", mismatch=0.25,
        )  # fmt: skip
    except ValueError:
        pytest.skip("this filter cannot carry the model, as the contract tests say")
    env.reset(seed=CASES.index((env_id, estimator)))
    rng, ended = np.random.default_rng(0), 0
    for step in range(STEPS[env_id, estimator] // ROWS + 1):
        if step % 50 == 0:  # held for a while, so that limits are met, too
            held = rng.uniform(-1.5, 1.5, env.action_space.shape).astype(np.float32)
        actions = held if step % 100 < 50 else rng.uniform(-1.5, 1.5, held.shape).astype(np.float32)
        seen, reward, terminated, truncated, info = env.step(actions)
        assert np.isfinite(seen).all()
        assert np.isfinite(reward).all()
        assert np.isfinite(info["truth"]).all()
        assert np.isfinite(info["estimate"]).all()
        assert np.isfinite(info["covariance"]).all()
        ended += int((terminated | truncated).sum())
    assert ended > ROWS
