"""Threads share the rows of a batch, and no result depends on how many there are."""

import copy
import multiprocessing
import pickle
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from contract import assert_same_tree, copy_tree, make_batch, make_core, random_walk
from gymnasium.vector import AutoresetMode

from estimators import Belief, Filter, threads
from estimators.engine import function
from estimators.measurement import Measurement

MANY, SOME = 800, 250
"""Rows that three threads share, and those that make four chunks of an ensemble."""


class OwnKalman(Filter[Belief]):
    """Somebody's own, in NumPy: products of all rows at once, whose last digits may follow their number."""

    def _predict(self, belief: Belief, u: Any, rng: Any) -> Belief:
        A, Q = self.model.A(u), self.model.Q  # type: ignore[union-attr,operator,misc]
        return Belief.predicted(belief, np.matvec(A, belief.mean), A @ belief.cov @ A.mT + Q, u)

    def _update(self, belief: Belief, measurement: Measurement, rng: Any) -> Belief:
        C, R = self.model.C, self.model.R  # type: ignore[union-attr]
        first = belief.cov.reshape(-1, *belief.cov.shape[-2:])[0]
        gain = np.linalg.solve(C @ first @ C.T + R, C @ first).T  # the first row's, for all
        mean = belief.mean + measurement.innovation @ gain.T
        cov = belief.cov - gain @ C @ belief.cov
        return Belief.updated(belief, mean, 0.5 * (cov + cov.mT), measurement, C @ belief.cov @ C.T + R)


WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    "corvette": ("SigmaCorvette-v0", {}),
    "corvette, linear": ("SigmaCorvette-v0", {"estimator": "kf"}),
    "corvette, asked": ("SigmaCorvette-v0", {"estimator": "ekf", "observe": "mean+std"}),
    "corvette, own": ("SigmaCorvette-v0", {"estimator": OwnKalman, "estimator_options": {"model": "linear"}}),
    "the thesis' corvette": ("ThesisCorvette-v0", {}),
    "Segorogeni": ("SegorogeniAUV-v0", {}),
    "Puna": ("PunaUAV-v0", {"estimator": "etkf", "guidance": False}),
    "Itsunusa, measurements": ("ItsunusaAUV-v0", {"estimator": "ekf", "observe": "measurement", "guidance": True}),
    "ship with a sea of its own": ("Shear-v0", {"estimator": "ekf"}),
}
HARD = {"sensors": "degraded", "mismatch": 0.2, "max_episode_steps": 9}

every_world = pytest.mark.parametrize("world", WORLDS)


def make(world: str, threads: int, mode: AutoresetMode = AutoresetMode.NEXT_STEP) -> Any:
    env_id, options = WORLDS[world]
    rows = SOME if world in ("Segorogeni", "Puna") else MANY
    return make_batch(env_id, rows, autoreset_mode=mode, num_threads=threads, **(HARD | options))


def flown(env: Any, steps: int, between: Callable[[Any], Any] = lambda env: env) -> list[Any]:
    """What resets of all and of some rows, and steps, give."""
    rows, size = env.action_space.shape
    rng = np.random.default_rng(1)
    seen, actions, ended = [copy_tree(env.reset(seed=4))], random_walk(2, rows, size), np.zeros(rows, bool)
    for k in range(steps):
        env = between(env)
        mask = ended if env.autoreset_mode is AutoresetMode.DISABLED else rng.random(rows) < 0.03 * (k % 4 == 2)
        if mask.any():
            seen.append(copy_tree(env.reset(options={"reset_mask": mask})))
        seen.append(copy_tree(env.step(next(actions))))
        ended = seen[-1][2] | seen[-1][3]
    return seen


def assert_same(one: list[Any], other: list[Any]) -> None:
    for i, (a, b) in enumerate(zip(one, other, strict=True)):
        assert_same_tree(a, b, f"number {i}")


@pytest.fixture(autouse=True)
def few_rows_are_worth_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "WORTH", 1)


@every_world
def test_the_bits_are_the_same_for_any_number_of_threads(world: str):
    alone = flown(make(world, 1), 8)
    for count in (3, 2 * MANY):
        assert_same(flown(make(world, count), 8), alone)


@pytest.mark.parametrize("env_id", ["SigmaCorvette-v0", "ThesisCorvette-v0", "vessel_gym/Ship-v0"])
def test_threads_share_world_filter_and_task_of_ships(env_id: str, monkeypatch: pytest.MonkeyPatch):
    shared, each = [], threads.each
    monkeypatch.setattr(
        function, "each_part", lambda work, parts, count: shared.append(len(parts)) or each(work, parts, count)
    )
    core = make_core(env_id, MANY, num_threads=3)
    core.start(0)
    shared.clear()
    core.step(np.zeros((MANY, 1)))
    assert shared == [3, 3, 3]


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.DISABLED])
@pytest.mark.parametrize("world", ["corvette", "Segorogeni"])
def test_the_bits_are_the_same_in_every_mode(world: str, mode: AutoresetMode):
    assert_same(flown(make(world, 3, mode), 21), flown(make(world, 1, mode), 21))


@pytest.mark.parametrize("world", ["corvette", "Segorogeni"])
def test_copies_and_pickles_go_on_with_their_threads(world: str):
    for again in (copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))):
        env = make(world, 2)
        assert again(env).core.num_threads == again(env).core.filter.num_threads == 2
        assert_same(flown(env, 4, between=again), flown(make(world, 1), 4))


def test_environments_of_several_threads_do_not_disturb_each_other():
    alone = flown(make("corvette", 1), 15)
    with ThreadPoolExecutor(3) as users:
        for seen in users.map(lambda count: flown(make("corvette", count), 15), (2, 2, 3)):
            assert_same(seen, alone)


def _further(env: Any, back: Any) -> None:
    back.send((env.step(np.zeros(env.action_space.shape, np.float32)), threading.active_count()))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="nothing is forked here")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_process_that_is_forked_has_threads_of_its_own():
    env = make("corvette", 2)
    flown(env, 3)
    forking = multiprocessing.get_context("fork")
    here, there = forking.Pipe()
    child = forking.Process(target=_further, args=(env, there))
    child.start()
    assert here.poll(60), "it waits for threads that it does not have"
    seen, running = here.recv()
    child.join()
    assert running == 2
    assert_same_tree(seen, env.step(np.zeros(env.action_space.shape, np.float32)))
