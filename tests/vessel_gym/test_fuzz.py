"""Malformed and extreme input at every entrance of the environments: it works, or one sentence says why not.

``--hypothesis-profile thorough`` tries ten thousand of each.
"""

from functools import cache
from typing import Any

import numpy as np
from contract import FEW_MEMBERS, assert_same_tree, assert_sound, single_class, vector_class
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from vessel_gym.envs import VesselEnv
from vessel_gym.models.estimation import estimator_names
from vessel_gym.sensors import SUITES
from vessel_gym.simulation.core import Core

EXTREME = st.sampled_from(
    [0.0, -0.0, 5e-324, 1e-300, 1e7, -1e7, 1e300, -1e300, np.inf, -np.inf, np.nan]
)
OBJECTS = st.sampled_from([object(), dict, np.float32(0.1), np.uint8(3), ..., "a\nb"])
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(), st.integers(-(10**400), 10**400), st.floats(), EXTREME, OBJECTS,
    st.text(), st.text(min_size=300, max_size=400), st.binary(), st.complex_numbers(),
)  # fmt: skip
JUNK = st.one_of(
    SCALARS, st.lists(SCALARS, max_size=4), st.tuples(SCALARS, SCALARS, SCALARS), st.sets(st.integers(), max_size=3),
    st.dictionaries(st.text(), SCALARS, max_size=3),
    st.dictionaries(st.integers(), SCALARS, min_size=1, max_size=2),
    st.lists(st.lists(st.floats(), max_size=3), max_size=4),
    npst.arrays(npst.scalar_dtypes(), npst.array_shapes(min_dims=0, max_dims=3, max_side=4)),
)  # fmt: skip


TOLD = st.sampled_from(["linear", "discarded", {"as": "white-input"}, {"Q": 2.0, "how": None}])
ARGUMENTS = {  # what is, or nearly is, right
    "estimator": st.sampled_from([*estimator_names(), "kf-umv", "EKF"]),
    # What a filter makes of the values of its own options is tested with the filters.
    "estimator_options": st.sampled_from(["model", "assume", "late"]).flatmap(
        lambda name: st.fixed_dictionaries({name: JUNK | TOLD})
    ),
    "sensors": st.sampled_from([*SUITES, "clen"]),
    "disturbance": st.sampled_from(["calm", "Rough"]),
    "mismatch": st.floats(0.0, 0.3),
    "observe": st.sampled_from(["mean+std", "measurement", "means"]),
    "render_mode": st.sampled_from([None, "ansi"]),
    "sensor_faults": st.just([]) | st.lists(JUNK, max_size=2),
}
OTHER_WORDS = {
    "estimator": ("needs",), "estimator_options": ("has no option", "model", "assume", "disturbance", "late"),
    "sensors": ("sensor suite",), "render_mode": ("argument",),
}  # fmt: skip
NUMBERS = st.floats(-300.0, 900.0) | EXTREME
POSES = st.tuples(NUMBERS, NUMBERS, st.floats(-4.0, 40.0) | EXTREME)
OPTIONS = {
    "radius": NUMBERS | st.integers(-900, 900), "goal": POSES, "start": POSES, "altitude": NUMBERS,
    "obstacles": st.lists(POSES, max_size=7),
}  # fmt: skip

environments = st.sampled_from(["SigmaCorvette-v0", "ItsunusaAUV-v0", "PunaUAV-v0"])


def refusal(words: tuple[str, ...], call: Any, *args: Any, **kwargs: Any) -> bool:
    """Whether a call is refused: then in one readable sentence that has one of the words that name what is wrong."""
    try:
        call(*args, **kwargs)
    except Exception as error:
        kind, message = type(error), str(error)
    else:
        return False
    assert issubclass(kind, ValueError | TypeError), (kind, message)
    assert "\n" not in message
    assert 10 < len(message) < 500, message
    assert any(word in message for word in words), message
    return True


@cache
def prepared(env_id: str) -> VesselEnv:
    """An environment of each kind, made once."""
    few = FEW_MEMBERS.get(single_class(env_id).system.estimator)
    env = single_class(env_id)(estimator_options=few, sensors="degraded")
    env.reset(seed=1)
    return env


def held(core: Core) -> Any:
    """All that a refused call must leave as it was."""
    return core.info(), list(core.seeds), core.now.episode.copy(), core.now.steps.copy()


def assert_flies(core: Core) -> None:
    """That what was accepted is sound, and the next step too."""
    assert_sound(core, core.observe(), None, core.info())
    reward = core.step(np.zeros((core.num_envs, core.config.action_size))).reward
    assert_sound(core, core.observe(), reward, core.info())


@given(st.data(), environments, st.sampled_from(list(ARGUMENTS)), st.booleans())
def test_any_argument_works_or_is_refused_by_name(data: Any, env_id: str, name: str, batch: bool):
    value = data.draw(ARGUMENTS[name] | JUNK)
    cls, made = vector_class(env_id) if batch else single_class(env_id), []
    if not refusal((name, *OTHER_WORDS.get(name, ())), lambda: made.append(cls(**{name: value}))):
        made[0].reset(seed=3)
        assert_flies(made[0].core)


@given(JUNK | st.integers(0, 2**300))
def test_any_seed_works_or_is_refused_and_changes_nothing(seed: Any):
    env = prepared("SigmaCorvette-v0")
    before = held(env.core)
    if refusal(("seed",), env.reset, seed=seed):
        assert_same_tree(before, held(env.core))
    else:
        assert_flies(env.core)


@given(st.data(), environments, st.sampled_from(list(OPTIONS)), st.integers(0, 3))
def test_any_reset_option_works_or_refusal_changes_nothing(
    data: Any, env_id: str, name: str, seed: int
):
    env = prepared(env_id)
    options = data.draw(JUNK | st.fixed_dictionaries({name: OPTIONS[name] | JUNK}))
    before = held(env.core)
    if refusal((name, "option", "path", "obstacle"), env.reset, seed=seed, options=options):
        assert_same_tree(before, held(env.core))
    else:
        assert_flies(env.core)


@given(st.data(), environments)
def test_any_action_works_or_is_refused_and_changes_nothing(data: Any, env_id: str):
    env = prepared(env_id)
    shape = env.action_space.shape
    extreme = npst.arrays(float, shape, elements=st.floats() | EXTREME)
    action = data.draw(JUNK | extreme | npst.arrays(npst.scalar_dtypes(), shape))
    if env.core.now.end.any() or env.core.now.steps[0] > 200:
        env.reset()
    before = held(env.core)
    if refusal(("action",), env.step, action):
        assert_same_tree(before, held(env.core))
    else:
        assert_flies(env.core)
