"""No estimate of a vehicle depends on where its headings are cut and its positions count from.

The law of tests/estimators/test_invariance.py on the vehicles themselves, with the estimators that
only environments have: the axes are turned by half a turn, so that a heading about north becomes
one about the cut, and the origin is moved far away. What the vehicle's own model makes of the
measurements is turned and moved back, and what is left is rounding. So the vehicles' equations,
their Jacobians by differences and what measurements alone give obey it, too.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from contract import CARRIED, FEW_MEMBERS, make_core, random_walk, single_class

from estimators import Belief, Gaussian, models, wrap
from vessel_gym.models.estimation import ENVIRONMENT_ONLY, Estimation, build
from vessel_gym.models.reference_filters import HeldBelief, Oracle, ZeroOrderHold
from vessel_gym.simulation.core import Core
from vessel_gym.simulation.draws import filter_prior

FAR = {"x": 6e5, "y": -5e6, "north [m]": 6e5, "east [m]": -5e6}
"""A place in UTM coordinates [m], as states and as measurements."""
ROWS, STEPS = 6, 80
NORTH = {"PunaUAV-v0": {"start": (0.0, 0.0, 0.0), "goal": (900.0, 0.0, 0.0), "obstacles": []}}
"""Missions that begin to the north; the others do so anyway."""
STEERING = {"PunaUAV-v0": 2}
"""Which action steers; in the others the first."""
TURNED = {
    "x", "y", "north", "east", "current north", "current east", "mean wind north", "mean wind east", "gust north",
    "gust east", "bias x", "bias y", "north [m]", "east [m]",
}  # fmt: skip
"""Components of state and measurements that half a turn of the axes reverses; but for headings the rest stays.

So are their increments and changes.
"""
HEADINGS = ("psi", "course over ground", "heading [rad]")


ENSEMBLES = tuple(FEW_MEMBERS)


class Episode(NamedTuple):
    """What happened: times first, then rows, then components."""

    core: Core  # what flew: its system, sensors and disturbance are those of the filters
    prior: Gaussian
    x: np.ndarray  # (T, rows, n) truth, as filters estimate it
    d: np.ndarray  # (T, rows, q) unknown input over the coming step
    y: np.ndarray  # (T, rows, p)
    available: np.ndarray  # (T, rows, p)
    u: np.ndarray  # (T, rows, m) known input over the step before


class Axes(NamedTuple):
    """How the components of state, unknown input and measurements are written in other axes: sign, then shift."""

    x: tuple[np.ndarray, np.ndarray]
    d: tuple[np.ndarray, np.ndarray]
    y: tuple[np.ndarray, np.ndarray]


def names(core: Core) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Components of the widest state that filters have, of the unknown input and of the measurements."""
    return (
        core.config.estimation.space.names,
        core.config.estimation.inputs,
        core.config.sensors.channels,
    )


def half_a_turn(core: Core) -> Axes:
    """Axes that point south and west; what adds to or changes a component turns with it, and has no cut."""
    return Axes(*(
        (np.array([-1.0 if n.removesuffix(" increment").removeprefix("change of ") in TURNED else 1.0 for n in part]),
         np.array([np.pi * (n in HEADINGS) for n in part]))
        for part in names(core)
    ))  # fmt: skip


def elsewhere(core: Core) -> Axes:
    """Axes that begin far away; a current or an increment has no place."""
    shifts = [np.array([FAR.get(n, 0.0) for n in part]) for part in names(core)]
    return Axes(*((np.ones(len(shift)), shift) for shift in shifts))


def estimation(core: Core, name: str, options: dict[str, object] | None) -> Estimation:
    """An estimator of the core's system, told what there is."""
    return build(
        core.config.system, name, options, core.config.sensors, core.config.world.disturbance
    )


def written(values: np.ndarray, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Vectors ``(..., k)`` in other axes; they may have only the first components."""
    sign, shift = (part[: values.shape[-1]] for part in axes)
    return sign * values + shift


@cache
def episode(env_id: str) -> Episode:
    """A rough episode in which the vehicle begins to the north and weaves about it, with measurements that get lost."""
    widest = {
        "model": single_class(env_id).system.vehicle.kinds[0]
    }  # other models have the first components of it
    core = make_core(
        env_id, ROWS, seed=2, estimator="truth", estimator_options=widest, disturbance="rough"
    )
    core.reset(options=NORTH.get(env_id))
    vehicle, task = core.config.system.vehicle, core.config.system.task
    state, _, channels = names(core)
    prior = filter_prior(task.prior(core.now.scenario), core.config.estimation.space)
    north = -prior.mean[:, state.index("psi")] if env_id == "ThesisCorvette-v0" else np.zeros(ROWS)
    of_state, of_measurements = (
        np.multiply.outer(north, np.isin(part, HEADINGS)) for part in (state, channels)
    )
    walk = random_walk(5, ROWS, core.config.action_size)
    found: list[tuple[np.ndarray, ...]] = []
    u = vehicle.known_input(
        core.now.actuators, core.now.actuators, task.commanded(core.now.scenario, core.now.steps)
    )
    for k in range(STEPS):
        now, truth = core.now, core.config.true_state.in_filter_order(core.truth) + of_state
        d = core.config.unknown_input.values(now)
        found.append((truth, d, now.y + of_measurements, now.available, u))
        before, at = core.now.actuators, core.now.steps.copy()
        action = 0.1 * next(walk)
        action[:, STEERING.get(env_id, 0)] += 0.8 * np.cos(np.pi / 20.0 * k)
        core.step(action)
        u = vehicle.known_input(before, core.now.actuators, task.commanded(core.now.scenario, at))
    assert np.isfinite(found[-1][0]).all(), "filters estimate what is not there"
    return Episode(
        core, Gaussian(prior.mean + of_state, prior.cov), *map(np.array, zip(*found, strict=True))
    )


def seen_from(told: Episode, axes: Axes, turns: int = 0) -> Episode:
    """The same episode in other axes, its angles read within half a turn of zero, or some turns further on."""
    sign, channels = axes.x[0], names(told.core)[2]
    y = written(told.y, axes.y)
    headings = np.isin(channels, HEADINGS)
    y[..., headings] = wrap(y[..., headings]) + 2.0 * np.pi * turns
    prior = Gaussian(written(told.prior.mean, axes.x), sign[:, None] * told.prior.cov * sign)
    return told._replace(prior=prior, x=written(told.x, axes.x), d=written(told.d, axes.d), y=y)


def track(name: str, told: Episode) -> list[Belief]:
    """What an estimator believes after every measurement, as an environment asks it."""
    built = estimation(told.core, name, FEW_MEMBERS.get(name))
    filter, n, rng = built.filter, len(built.space.names), np.random.default_rng(3)
    assert built.space.names == names(told.core)[0][:n]
    belief, beliefs = (
        filter.init(Gaussian(told.prior.mean[:, :n], told.prior.cov[:n, :n]), rng=rng),
        [],
    )
    for k in range(STEPS):
        if k:
            belief = filter.predict(belief, told.u[k], rng=rng)
        if isinstance(filter, Oracle):
            belief = filter.update(
                belief, np.concatenate([told.x[k][:, :n], told.d[k]], -1), rng=rng, u=told.u[k]
            )
        else:
            known = None if k else told.u[0]
            belief = filter.update(belief, told.y[k], rng=rng, available=told.available[k], u=known)
        beliefs.append(belief)
    return beliefs


def apart(told: Episode, axes: Axes, one: list[Belief], other: list[Belief]) -> float:
    """The largest difference of two series of beliefs, the second in other axes, in the standard deviations told.

    Of what an estimator tells none (the truth), in those of the start.
    """
    worst, angles = 0.0, [np.isin(part, HEADINGS) for part in names(told.core)]

    def short(change: np.ndarray, angle: np.ndarray) -> np.ndarray:
        return np.where(angle[: change.shape[-1]], wrap(change), change)

    for a, b in zip(one, other, strict=True):
        n = a.mean.shape[-1]
        sign, sd = axes.x[0][:n], np.sqrt(np.diagonal(a.cov, axis1=-2, axis2=-1))
        sd = np.where(sd > 0.0, sd, np.sqrt(np.diagonal(told.prior.cov))[:n])
        error = short(b.mean - written(a.mean, axes.x), angles[0]) / sd
        spread = (b.cov - sign[:, None] * a.cov * sign) / (sd[..., None] * sd[..., None, :])
        found = [error, spread]
        if a.input_mean is not None:
            scale = told.d.std((0, 1)) + 1e-3
            found.append((b.input_mean - written(a.input_mean, axes.d)) / scale)
        if isinstance(a, HeldBelief):
            sd, dt = told.core.config.sensors.sd, told.core.config.system.vehicle.dt
            found.append(short(b.held - written(a.held, axes.y), angles[2]) / sd)
            found.append((b.slope - axes.y[0] * a.slope) * dt / sd)
        worst = max(worst, *(float(np.abs(part).max()) for part in found))
        np.testing.assert_array_equal(b.healthy, a.healthy)
    return worst


# --- the law --------------------------------------------------------------------------------------

DIFFERENCING = ("ekf", "iekf", "huber-kf", "robust-kf", "dead-reckoning")
"""Filters that take the vehicles' Jacobians by differences (on the thesis' corvette only `ekf` does)."""

# A heading of half a turn has digits of 4e-16 rad. Over a step of 1e-5 rad a difference has 4e-11,
# which the gains of eighty steps may enlarge a hundredfold.
SEAM = 1e-8
# At 5e6 m a position has digits of 1e-9 m, 1e-8 of the 0.1 m to which it is known, in each of
# eighty steps ...
PLACE = 1e-6
# ... and a difference is at its best off by (eps F)^(4/5) = 4e-7 there, with F = 5e6 m / 0.1 m.
DIFFERENCED = 3e-5
# How far differences step follows the largest state, and with it where they straddle a kink, such
# as that of v |v| at rest, which the filters then see otherwise. A thousandth of a standard
# deviation is nothing to whoever flies on them.
STEPPED = 1e-3


def cases(env_ids: tuple[str, ...], reversed_too: bool) -> list[object]:
    """Every estimator of these environments; those that only environments have and one that differences for daily work.

    Where axes are reversed, ensembles, whose members are drawn along the axes, are others and no
    worse. Which particles a particle filter keeps, rounding decides.
    """
    chosen = []
    for env_id, name in CARRIED:
        if "Corvette" in env_id and name in ("kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv"):
            continue  # whose state holds the unknown input besides
        if name == "pf":
            continue
        if env_id not in env_ids or (
            reversed_too and name in ENSEMBLES and env_id != "ThesisCorvette-v0"
        ):
            continue
        quick = name in (*ENVIRONMENT_ONLY, "ekf")
        chosen.append(pytest.param(env_id, name, marks=() if quick else pytest.mark.slow))
    return chosen


def hold_steps(patch: pytest.MonkeyPatch, axes: Axes) -> None:
    """Let differences step as far in the one description as in the other: as the larger numbers have it."""
    usual, reach = models.steps, 1.5 * np.abs(axes.x[1])

    def steps(x: np.ndarray, cov: np.ndarray | None, angles: tuple[int, ...] = ()) -> np.ndarray:
        return usual(np.maximum(np.abs(x), reach[: x.shape[-1]]), cov, angles)

    patch.setattr(models, "steps", steps)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "name"),
    cases(("ThesisCorvette-v0", "SegorogeniAUV-v0", "PunaUAV-v0"), reversed_too=True),
)
def test_an_estimate_across_the_cut_of_a_heading_is_that_of_a_heading_north(
    env_id: str, name: str, monkeypatch: pytest.MonkeyPatch
):
    north = episode(env_id)
    axes = half_a_turn(north.core)
    south = seen_from(north, axes)
    heading = int(np.flatnonzero(np.isin(names(north.core)[2], HEADINGS))[0])
    read = north.available[:, :, heading].all(1)
    assert np.abs(north.y[read, :, heading]).max() < 1.0
    jumps = np.abs(np.diff(south.y[read, :, heading], axis=0)) > np.pi
    assert jumps.any(0).sum() >= ROWS // 2, "few headings cross the cut"
    about = track(name, north)
    allowed = STEPPED if name in DIFFERENCING else SEAM
    assert apart(north, axes, about, track(name, south)) < allowed
    assert apart(north, axes, about, track(name, seen_from(north, axes, turns=2))) < allowed
    hold_steps(monkeypatch, axes)
    assert apart(north, axes, track(name, north), track(name, south)) < SEAM


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "name"),
    cases(
        ("SigmaCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"), reversed_too=False
    ),
)
def test_an_estimate_far_away_is_that_at_the_origin_but_for_the_digits_of_the_place(
    env_id: str, name: str, monkeypatch: pytest.MonkeyPatch
):
    here = episode(env_id)
    axes = elsewhere(here.core)
    there = seen_from(here, axes)
    assert np.abs(there.x).max() > 5e5
    differencing = name in (*DIFFERENCING, "kf-umv-ui")  # which takes nonlinear models as ekf does
    assert apart(here, axes, track(name, here), track(name, there)) < (
        STEPPED if differencing else PLACE
    )
    hold_steps(monkeypatch, axes)
    assert apart(here, axes, track(name, here), track(name, there)) < (
        DIFFERENCED if differencing else PLACE
    )


@pytest.mark.parametrize("env_id", ["ThesisCorvette-v0", "SegorogeniAUV-v0", "PunaUAV-v0"])
def test_what_is_derived_of_two_measurements_does_not_depend_on_the_cut_between_them(env_id: str):
    told = episode(env_id)
    core = told.core
    axes, (state, unknown, channels) = half_a_turn(core), names(core)
    held = estimation(core, "measurement", {"model": core.config.system.vehicle.kinds[0]}).filter
    assert isinstance(held, ZeroOrderHold)
    rng, sd = np.random.default_rng(1), core.config.sensors.sd
    middle = np.array(
        [{"ground speed": 20.0, "airspeed": 20.0}.get(channel, 0.0) for channel in channels]
    )
    now, before = middle + sd * rng.normal(size=(2, 200, len(sd)))
    interval = rng.uniform(0.1, 2.0, size=now.shape)
    headings = np.isin(channels, HEADINGS)
    turned = [written(y, axes.y) for y in (now, before)]
    for y in turned:
        y[:, headings] = wrap(y[:, headings])
    assert (np.abs(turned[0] - turned[1])[:, headings] > np.pi).mean() > 0.3
    (x, d), (x_turned, d_turned) = (
        np.split(held._derived(pair[0], held._rates(*pair, interval)), [held.model.n], -1)
        for pair in ((now, before), turned)
    )
    error = x_turned - written(x, axes.x)
    angles = np.isin(state, HEADINGS)
    error[:, angles] = wrap(error[:, angles])
    np.testing.assert_allclose(
        error, 0.0, rtol=0, atol=1e-13
    )  # 20 m/s in a direction of 4e-16 rad of digits
    np.testing.assert_allclose(d_turned, written(d, axes.d), rtol=0, atol=1e-15)
    assert (len(state), len(unknown)) == (x.shape[-1], d.shape[-1])
