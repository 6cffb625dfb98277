"""What the tests of the environments' common contract share: which environments, flown how, seen how."""

import importlib
from collections.abc import Iterator
from copy import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from pages import OWN

import vessel_gym  # noqa: F401  (registers the environments)
from vessel_gym.envs import VesselEnv, VesselVectorEnv
from vessel_gym.models.estimation import estimator_names
from vessel_gym.simulation.core import Core
from vessel_gym.simulation.loop import Delivery
from vessel_gym.simulation.state import State

OURS = [
    key for key, spec in gym.registry.items() if str(spec.entry_point).startswith("vessel_gym.")
]
"""Every environment that the package registers: a new one joins all tests of the contract by being registered."""
ENVIRONMENTS = [*OURS, *OWN]
"""And those of the pages on parts of one's own."""


every_environment = pytest.mark.parametrize("env_id", ENVIRONMENTS)
MANUALS = [key for key in OURS if "/" not in key]
"""Those with a manual of their own: those of any vehicle point to them."""

_NO_INPUT = dict.fromkeys(
    ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ulise", "ukf-umv"), "an unknown input"
)
_NONLINEAR_AND_NO_INPUT = dict.fromkeys(
    ("kf", "kf-umv-ui-wdf", "ulise"), "a LinearModel"
) | dict.fromkeys(("kf-umv-ui", "ekf-ui-wdf", "ukf-umv"), "an unknown input")
REFUSED = {
    "SegorogeniAUV-v0": _NONLINEAR_AND_NO_INPUT,
    "ItsunusaAUV-v0": _NO_INPUT,
    "PunaUAV-v0": _NONLINEAR_AND_NO_INPUT,
    "vessel_gym/AUV-v0": _NONLINEAR_AND_NO_INPUT,
    "vessel_gym/FixedWing-v0": _NONLINEAR_AND_NO_INPUT,
    "Usbl-v0": _NONLINEAR_AND_NO_INPUT,
    "Shear-v0": _NONLINEAR_AND_NO_INPUT,
    "Docking-v0": _NO_INPUT,
}
"""Estimators that an environment's model cannot carry, and the condition that the refusal must name."""

FEW_MEMBERS = {"pf": {"particles": 20}}
"""Options of estimators where it does not matter how good they are: a small ensemble takes the same path as a large."""

CARRIED = [
    (key, name)
    for key in ENVIRONMENTS
    for name in estimator_names()
    if name not in REFUSED.get(key, {})
]
MODES = ("mean", "mean+std", "measurement")
NATURE = "truth", "unknown_input", "parameters", "measurement", "available"
"""Keys of info that are the same to the last bit in every batch, under equal actions."""


def single_class(env_id: str) -> type[VesselEnv]:
    return _entry(gym.spec(env_id).entry_point)


def vector_class(env_id: str) -> type[VesselVectorEnv]:
    return _entry(gym.spec(env_id).vector_entry_point)


def _entry(point: Any) -> Any:
    if isinstance(point, type):
        return point
    module, name = str(point).split(":")
    return getattr(importlib.import_module(module), name)


def _spread() -> Iterator[tuple[str, str]]:
    seen: set[str] = set()
    for i, key in enumerate(ENVIRONMENTS):
        always = {"truth", "measurement", single_class(key).system.estimator}
        for j, name in enumerate(estimator_names()):
            if (key, name) in CARRIED and (
                name not in seen or name in always or j % (len(OURS) - 1) == i - 1
            ):
                yield key, name
                seen.add(name)


SPREAD = list(_spread())
"""Pairs for what is the same code for all: every estimator in one environment and a share of them in each other."""


def make_batch(env_id: str, num_envs: int, **options: Any) -> VesselVectorEnv:
    """A native batch; ended episodes are followed by the next in the same step, unless ``options`` say otherwise."""
    options = {"autoreset_mode": AutoresetMode.SAME_STEP} | options
    return gym.make_vec(
        env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", **options
    )


def make_core(env_id: str, num_envs: int, **options: Any) -> Core:
    return Core(single_class(env_id).system, num_envs, **options)


def random_walk(seed: int, num_envs: int, size: int) -> Iterator[np.ndarray]:
    """Random actions that lean to one side in each row, so that episodes end early, at different times."""
    rng = np.random.default_rng(seed)
    lean = rng.uniform(-0.8, 0.8, (num_envs, size))
    while True:
        yield np.clip(lean + rng.normal(0.0, 0.6, (num_envs, size)), -1.0, 1.0).astype(np.float32)


class AlteredCore(Core):
    """Environments in which all that is drawn at a reset is somewhere else: vehicle, disturbance and biases."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        world: Any = copy(self.config.world)  # which others share
        begin = world.begin

        def altered(now: State) -> None:
            rng = np.random.default_rng(2)
            for name in ("prior_normals", "slow_normals", "constant_uniforms"):
                numbers = getattr(now, name)
                uniform = name.endswith("uniforms")
                other = rng.random(numbers.shape) if uniform else rng.normal(size=numbers.shape)
                setattr(now, name, other)
            begin(now)

        world.begin, self.config.world = altered, world


class Replay(Delivery):
    """Delivers ``given`` in place of what sensors sample: measurements, their mask, and both by age."""

    given: tuple[Any, ...]

    def __call__(self, now: State) -> None:
        now.y, now.available, now.arrived = self.given


def replayed(core: Core) -> Replay:
    """The new delivery of a core; no program has it, so the stages of a step run one by one."""
    core._together, core.config.delivery = False, Replay(core.config.sensors)
    return core.config.delivery


def delivered(core: Core, rows: Any = slice(None)) -> tuple[Any, ...]:
    """What a core's filters were given in some rows; see `Replay`."""
    now = core.now
    return now.y[rows], now.available[rows], now.arrived and tuple(a[rows] for a in now.arrived)


def assert_same_tree(one: Any, other: Any, where: str = "", atol: float = 0.0) -> None:
    """Equal keys, types, dtypes and shapes all the way down; values to ``atol`` (0: bit for bit).

    Two runs on one machine are compared so, never one with numbers of another machine.
    float32 values, rounded from float64 ones that agree to ``atol``, may differ in their last bit.
    """
    assert type(one) is type(other), where
    if isinstance(one, dict):
        assert set(one) == set(other), where
        for key in one:
            assert_same_tree(one[key], other[key], f"{where}[{key!r}]", atol)
    elif isinstance(one, tuple):
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same_tree(a, b, f"{where}[{i}]", atol)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        assert one.shape == other.shape, where
        if one.dtype == object:
            for i, (a, b) in enumerate(zip(one, other, strict=True)):
                assert_same_tree(a, b, f"{where}[{i}]", atol)
        elif np.array_equal(one, other):
            return
        elif atol and one.dtype == np.float32:
            np.testing.assert_allclose(one, other, rtol=2.0**-23, atol=100.0 * atol, err_msg=where)
        elif atol and one.dtype.kind == "f":
            np.testing.assert_allclose(one, other, rtol=0, atol=atol, err_msg=where)
        else:
            np.testing.assert_array_equal(one, other, err_msg=where)
    elif atol and isinstance(one, float):
        assert abs(one - other) <= atol, where
    else:
        assert one == other, where


def observations(core: Core) -> dict[str, np.ndarray]:
    """What a core would let be seen now in each mode: the filter's work is the same in all.

    One of raw measurements shows those alone: its reference is where the truth is.
    """
    mission, seen = copy(core.config.mission), {}
    for mode in MODES if not mission.measured else ("measurement",):
        mission.observe, mission.measured = mode, mode == "measurement"
        seen[mode] = mission.observation(core.now, core.now.reference).astype(np.float32)
    return seen


def observations_when_truth_is_altered(
    env_id: str, **options: Any
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Fly once, then replay the same measurements and actions to another truth: both observations, largest differences.

    The other truth begins elsewhere, with another vehicle, and before every step is put somewhere
    else. Observations are those of every mode, ``(steps, rows, k)``; differences those of every
    part of what is true.
    """
    rows, steps = 4, 50
    true = make_core(env_id, rows, **options)
    other = AlteredCore(single_class(env_id).system, rows, **(options | {"mismatch": 0.25}))
    rng = np.random.default_rng(9)
    replay = replayed(other)
    true.start(5)
    replay.given = delivered(true)
    other.start(5)
    walk = random_walk(5, rows, true.config.action_size)
    seen = [observations(true)], [observations(other)]
    distance = [apart(true, other)]
    for step in range(steps):
        if step == 25:  # a partial reset, as autoreset does it
            some = np.array([1, 3])
            true.start(rows=some)
            replay.given = delivered(true, some)
            other.start(rows=some)
            seen[0].append(observations(true))
            seen[1].append(observations(other))
        scramble(other, rng)
        actions = next(walk)
        true.step(actions)
        replay.given = delivered(true)
        other.step(actions)
        seen[0].append(observations(true))
        seen[1].append(observations(other))
        distance.append(apart(true, other))
    one, two, parts = (
        {key: np.stack([frame[key] for frame in frames]) for key in frames[0]}
        for frames in (*seen, distance)
    )
    return one, two, parts


def apart(one: Core, other: Core) -> dict[str, np.ndarray]:
    """How far every part of what is true differs, ``(rows,)`` each."""
    size = one.config.world.size
    parts = {name: apart_in(one, other, name) for name in ("state", "parameters")}
    if size:  # what a task prescribes is the same at reset
        parts["exogenous"] = apart_in(one, other, "exogenous")
        parts["disturbance"] = apart_in(one, other, "slow", slice(size))
    if one.config.sensors.bias.size:
        parts["bias"] = apart_in(one, other, "slow", slice(size, None))
    return parts


def apart_in(one: Core, other: Core, name: str, columns: slice = slice(None)) -> np.ndarray:
    """Largest difference ``(rows,)`` in some columns of a field of the record."""
    return np.abs(getattr(one.now, name) - getattr(other.now, name))[:, columns].max(-1)


def scramble(core: Core, rng: np.random.Generator) -> None:
    """Put everything that is true somewhere else: vehicle, disturbance, biases, what acts and what will."""
    core.now.state = core.now.state + rng.normal(0.0, 0.01, core.now.state.shape)
    core.now.slow = rng.normal(0.0, 0.01, core.now.slow.shape) - core.now.slow
    core.now.exogenous = core.now.exogenous + rng.normal(0.0, 0.01, core.now.exogenous.shape)
    core.now.noise = core.now.noise + rng.normal(0.0, 0.01, core.now.noise.shape)
    core.now.parameters = core.now.parameters * rng.uniform(0.9, 1.1, core.now.parameters.shape)


def assert_apart(distance: dict[str, np.ndarray]) -> None:
    """Everything that is true was somewhere else; at a reset a trial begins where it always does."""
    for part, values in distance.items():
        assert values[1:].min() > 1e-5, part  # a swell of 0.01 acts with a hundredth of that
    assert distance["state"][1:].min() > 1e-3


def assert_sound(
    core: Core, observation: np.ndarray, reward: np.ndarray | None, info: dict[str, np.ndarray]
) -> None:
    """What must hold after every reset and step, whatever the estimator and however bad the measurements."""
    assert observation.dtype == np.float32
    assert np.abs(observation).max() <= core.config.system.task.BOUND  # False for NaN too
    if reward is not None:
        assert reward.min() >= 0.0
        assert reward.max() <= 1.0
    for key, value in info.items():
        if isinstance(value, np.ndarray) and value.dtype != object:
            # NaN stands in components of d that only the filter's model has.
            assert np.isfinite(value).all() or key == "unknown_input", key
    assert info["score"].min() >= 0.0
    assert info["score"].max() <= 1.0
