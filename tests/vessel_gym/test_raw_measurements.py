"""Raw measurements: an episode that nothing enters that an estimator believes."""

import numpy as np
import pytest
from contract import (
    make_core,
    random_walk,
)

NEAR = {
    "SigmaCorvette-v0": {"radius": 300.0},
    "ThesisCorvette-v0": {"simulation": "V"},
    "SegorogeniAUV-v0": {"goal": (4.5, 0.0, 0.2)},
    "ItsunusaAUV-v0": {"goal": (9.0, 0.0, 0.4)},
    "PunaUAV-v0": {"start": (0.0, 0.0, 0.0), "goal": (140.0, 0.0, 0.0), "obstacles": []},
}
"""Missions that are soon over."""


def test_missing_measurements_are_zero_and_the_mask_says_so():
    core = make_core("SigmaCorvette-v0", 3, observe="measurement", guidance=False)
    core.start(1)
    y = core.now.y
    available = np.arange(y.size).reshape(y.shape) % 3 > 0
    seen = core.config.mission.observation(core.now.but(available=available), None)
    p = y.shape[1]
    np.testing.assert_array_equal(seen[:, :p] != 0.0, available)
    np.testing.assert_array_equal(seen[:, p : 2 * p], available)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", NEAR)
def test_an_episode_is_judged_as_if_the_truth_were_believed(env_id: str):
    raw = make_core(env_id, 6, observe="measurement", estimator="dead-reckoning")
    told = make_core(env_id, 6, estimator="truth")
    for core in (raw, told):
        core.start(4, NEAR[env_id])
    walk, over = random_walk(4, 6, raw.config.action_size), 0
    for _ in range(100):
        actions = 0.3 * next(walk)
        now, expected = raw.step(actions), told.step(actions)
        np.testing.assert_allclose(now.reward, expected.reward, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(now.end, expected.end)
        np.testing.assert_array_equal(raw.truth, told.truth)
        over += now.end.sum()
    assert over > 0
