"""Laws of the scores of all tasks along a path: what pays, what costs, and what ends an episode."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vessel_gym.envs import (
    ItsunusaAUVEnv,
    PunaUAVEnv,
    SegorogeniAUVEnv,
    SigmaChannelEnv,
    SigmaCorvetteEnv,
)
from vessel_gym.guidance.dive_path import path_point
from vessel_gym.guidance.path_following import pose_along
from vessel_gym.system import System
from vessel_gym.tasks.flight import ALTITUDE, LENGTH


@dataclass(frozen=True, repr=False)
class Course:
    """A path of a task, and how its vehicle is put beside it.

    Attributes:
        system: The environment.
        scenario: ``(1, k)``.
        length: Of the path [m], or of its straight beginning.
        step: Distance [m] in a step at cruising speed.
        place: The true state at a distance along the path, to starboard and above it [m].
        helm: Actuators and action ``(1, a)`` that turn by a share of the full rate and back.
        price: Of steering.
        halves: Distances to starboard and above [m] that halve the reward of a metre.
        along: Share of the score for the metres of the path; the rest is for arriving.
    """

    system: System
    scenario: np.ndarray
    length: float
    step: float
    place: Callable[..., np.ndarray]
    helm: Callable[[float], tuple[np.ndarray, np.ndarray]]
    price: float
    halves: tuple[tuple[float, float], ...]
    along: float

    @property
    def task(self) -> Any:
        return self.system.task

    def beside(self, distance: float) -> tuple[float, float]:
        """A place so far off, on one of the sides on which the vehicle can be."""
        return (distance, 0.0) if self.halves[0][0] else (0.0, distance)


def scenario_of(system: System, seed: int) -> np.ndarray:
    task = system.task
    return task.scenario(np.random.default_rng(seed).random((1, task.uniforms)), {})


def dive(system: System) -> Course:
    task, scenario = system.task, scenario_of(system, 12)
    vertical = task.actuators == 2
    places = [-1 if i is None else i for i in task.components[6:9]]

    def place(s: float, off: float = 0.0, above: float = 0.0) -> np.ndarray:
        x, y, z, heading, slope = path_point(s, scenario[0])
        above *= np.hypot(1.0, slope)  # at right angles to the path
        state = np.zeros(len(task.prior_sd) + 1)  # what a plane has not goes into the last
        state[0] = task.auv.cruise_speed
        state[places] = x - off * np.sin(heading), y + off * np.cos(heading), z - above
        return state[:-1]

    def helm(share: float) -> tuple[np.ndarray, np.ndarray]:
        fin = 0.5 * share * task.auv.fin_rate * task.dt
        actuators = np.array([[*[fin] * (task.actuators - 1), task.auv.cruise_thrust]])
        return actuators, actuators

    halves = ((0.0, 0.25),) if vertical else ((0.25, 0.0), (0.0, 0.25), (0.15, 0.2))
    step = task.auv.cruise_speed * task.dt
    return Course(
        system, scenario, scenario[0, 1], step, place, helm, task.FIN_PRICE, halves, task.TRACKING
    )


def flight() -> Course:
    system = PunaUAVEnv.system
    task: Any = system.task
    scenario = scenario_of(system, 4)

    def place(s: float, off: float = 0.0, above: float = 0.0) -> np.ndarray:
        x, y, heading = pose_along(np.array(s), scenario[0, :LENGTH])
        sin, cos = np.sin(heading), np.cos(heading)
        height = scenario[0, ALTITUDE] + above
        return np.array([x - off * sin, y + off * cos, height, 20.0 * cos, 20.0 * sin, 0.0, 0.0])

    def helm(share: float) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((1, 3)), np.full((1, 3), share)

    length = float(scenario[0, LENGTH])
    return Course(
        system, scenario, length, 2.0, place, helm, 1.0, ((3.0, 0.0), (0.0, 1.5)), task.TRACKING
    )


def voyage(system: System, length: float, half: float) -> Course:
    """The straight with which a ship's path begins."""
    ship, task, scenario = system.task.ship, system.task, scenario_of(system, 1)

    def place(s: float, off: float = 0.0, above: float = 0.0) -> np.ndarray:
        sin, cos = np.sin(scenario[0, 0]), np.cos(scenario[0, 0])
        position = s * cos - off * sin, s * sin + off * cos
        return np.array([*position, scenario[0, 0], ship.speed, *[0.0] * 4])

    def helm(share: float) -> tuple[np.ndarray, np.ndarray]:
        return np.full((1, 1), 0.5 * share * ship.rudder_rate * task.dt), np.zeros((1, 1))

    return Course(
        system, scenario, length, ship.speed * task.dt, place, helm, 1.0, ((half, 0.0),), 1.0
    )


SHIP = SigmaChannelEnv.system.task.ship
SPATIAL, VERTICAL, FLIGHT = dive(SegorogeniAUVEnv.system), dive(ItsunusaAUVEnv.system), flight()
CHANNEL = voyage(SigmaChannelEnv.system, SigmaChannelEnv.system.task.leg * SHIP.length, 7.0)
CIRCLE = voyage(SigmaCorvetteEnv.system, SigmaCorvetteEnv.system.task.lead * SHIP.speed, 10.0)


def over(*courses: Course) -> Any:
    return pytest.mark.parametrize("course", courses, ids=lambda course: course.system.name)


every_course = over(SPATIAL, VERTICAL, FLIGHT, CHANNEL, CIRCLE)
with_an_end = over(SPATIAL, VERTICAL, FLIGHT, CHANNEL)
with_a_goal = over(SPATIAL, VERTICAL, FLIGHT)


def judged(
    course: Course, truth: np.ndarray, kept: np.ndarray, believed: np.ndarray, helm: float = 0.0
) -> tuple[float, str, np.ndarray]:
    """Reward, end and next score state of a step to a true state ``(n,)``."""
    task, scenario, vehicle = course.task, course.scenario, course.system.vehicle
    known = believed[None, : len(task.prior_sd)]
    reference = task.reference(scenario, np.zeros(1, int), known)
    still = np.zeros((1, len(vehicle.increments + vehicle.ambient_flows)))
    reward, end, kept = task.score(
        truth[None], still, scenario, reference, task.over(scenario, reference),
        *course.helm(helm), kept,
    )  # fmt: skip
    assert 0.0 <= reward[0] <= 1.0
    return float(reward[0]), task.end_reasons[int(np.broadcast_to(end, 1)[0])], kept


def scored(course: Course, places: Any, helm: float = 0.0) -> tuple[np.ndarray, str, np.ndarray]:
    """Rewards, end and last score state of a run through places ``(k, 3)``, see `Course.place`."""
    states = [course.place(*place) for place in places]
    kept = course.task.initial_score_state(states[0][None], course.scenario)
    rewards, end = [], ""
    for k, state in enumerate(states[1:]):
        reward, end, kept = judged(course, state, kept, state, helm * (-1) ** k)
        rewards.append(reward)
        if end:
            break
    return np.array(rewards), end, kept


def places(s: np.ndarray, off: float = 0.0, above: float = 0.0) -> np.ndarray:
    return np.stack([s, 0.0 * s + off, 0.0 * s + above], -1)


def whole(course: Course) -> np.ndarray:
    """Places of a step each, from the beginning to just beyond the end."""
    return places(np.append(np.arange(0.0, course.length, course.step), course.length + 1e-6))


def part(course: Course, share: float = 0.5) -> np.ndarray:
    """Distances of a step each, along a share of the path."""
    return np.arange(0.0, share * course.length, course.step)


# --- what pays ------------------------------------------------------------------------------------


@with_an_end
def test_a_perfect_run_scores_one_and_a_faster_one_no_more(course: Course):
    rewards, end, _ = scored(course, whole(course))
    assert end == course.task.success
    assert 0.98 < rewards.sum() <= 1.0 + 1e-12
    assert rewards[:-1].sum() == pytest.approx(course.along, rel=0.02)
    for faster in (2, 5):
        hurried = np.concatenate([whole(course)[::faster], whole(course)[-1:]])
        assert scored(course, hurried)[0].sum() <= 1.0 + 1e-12


@with_an_end
def test_every_metre_pays_the_same(course: Course):
    for pace in (0.2, 1.0, 1.9):
        s = np.arange(0.0, 0.2 * course.length, pace * course.step)
        rewards, _, kept = scored(course, places(s))
        paid = course.along * pace * course.step / course.length
        np.testing.assert_allclose(rewards, paid, rtol=1e-5)
        assert kept[0, 0] == pytest.approx(s[-1])


@with_a_goal
def test_a_leap_pays_for_the_fastest_step_only(course: Course):
    most = course.task.FASTEST * course.step
    rewards, _, kept = scored(course, places(np.array([0.0, most + 0.9 * course.step])))
    assert rewards[0] == pytest.approx(course.along * most / course.length)
    assert kept[0, 0] == pytest.approx(most)


@with_a_goal
@pytest.mark.parametrize("first", [-20.0, -5.0, 7.0])
def test_path_behind_the_start_does_not_pay(course: Course, first: float):
    s = course.step * np.arange(first, first + 40.0)
    paid = course.along * (s[-1] - max(s[0], 0.0)) / course.length
    assert scored(course, places(s))[0].sum() == pytest.approx(paid)


moves = st.lists(
    st.tuples(st.floats(-1.9, 1.9), st.floats(-6.0, 6.0), st.floats(-4.0, 4.0)),
    min_size=3,
    max_size=30,
)
"""Steps along the path, all of which count, and where beside it, in tolerances."""


@pytest.mark.slow
@every_course
@settings(derandomize=True, max_examples=25, deadline=None)
@given(steps=moves, detour=moves, when=st.floats(0.0, 1.0), arrive=st.booleans())
def test_no_detour_ever_raises_the_score(
    course: Course, steps: list, detour: list, when: float, arrive: bool
):
    """Loitering, circling, waiting and going back: out from a place that is met, and back to it.

    The detour stays behind the farthest place so far: one that goes on covers new metres, and may
    cover them better. It also stays beside the straight: in the bend that follows, places to its
    sides are not equally far along the track.
    """
    scales = [max(each) for each in zip(*course.halves, strict=True)]

    def trail(steps: list, s: float, farthest: float = np.inf) -> np.ndarray:
        listed = []
        for step, *aside in steps:
            s = min(s + step * course.step, farthest)
            listed.append((s, *np.multiply(aside, scales)))
        return np.array(listed)

    out = np.concatenate([np.zeros((1, 3)), trail(steps, 0.0)])
    if arrive:
        rest = np.arange(max(out[-1, 0], 0.0), course.length + course.step, 1.4 * course.step)
        out = np.concatenate([out, places(rest)])
    i = round(when * (len(out) - 1))
    farthest = min(max(out[: i + 1, 0].max(), 0.0), course.length)
    away = trail(detour, out[i, 0], farthest)
    longer = np.concatenate([out[: i + 1], away, out[i:]])
    assert scored(course, longer)[0].sum() <= scored(course, out)[0].sum() + 1e-12


@with_a_goal
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.95])
def test_ending_early_forgoes_the_rest(course: Course, share: float):
    s = part(course, share)
    early, _, kept = scored(course, places(s))
    beyond = course.place(course.length + 1e-6)
    last, end, _ = judged(course, course.place(s[-1]), kept, beyond)
    assert end == "missed the goal"
    assert early.sum() + last < 1.0 - 0.9 * course.along * (1.0 - share)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_a_short_cut_forgoes_the_pay_of_arriving(share: float):
    """But for the tolerance at the goal, and what a step can cover."""
    there, kept = FLIGHT.place(FLIGHT.length + 1e-6), np.eye(1, 7) * share * FLIGHT.length
    reward, end, _ = judged(FLIGHT, there, kept, there)
    assert end == "arrived"
    covered = share + FLIGHT.task.GOAL_TOLERANCE / FLIGHT.length
    assert reward == pytest.approx((1.0 - FLIGHT.along) * covered, abs=0.003)


@with_a_goal
@pytest.mark.parametrize("miss", [0.0, 0.6, 0.98, 1.02, 4.0])
def test_arrival_is_by_estimate_and_paid_by_truth(course: Course, miss: float):
    tolerance = course.task.GOAL_TOLERANCE
    there = course.place(course.length + 1e-6)
    kept = course.task.initial_score_state(there[None], course.scenario)
    kept[0, 0] = course.length
    side = (1.0, 0.0) if course is FLIGHT else course.beside(1.0)
    truth = course.place(course.length, *np.multiply(side, miss * tolerance))
    reward, end, _ = judged(course, truth, kept, there)
    assert end == ("arrived" if miss < 1.0 else "missed the goal")
    assert reward == pytest.approx((1.0 - course.along) / (1.0 + miss**2), rel=1e-6)
    near = course.place(course.length - 1e-3)
    assert judged(course, truth, kept, near)[:2] == (0.0, "")


# --- what costs -----------------------------------------------------------------------------------


@every_course
def test_half_is_lost_at_each_tolerance(course: Course):
    s = part(course)
    best = scored(course, places(s))[0]
    for off, above in course.halves:
        for side in (1.0, -1.0):
            for far, kept in ((1.0, 0.5), (2.0, 0.2)):
                found = scored(course, places(s, side * far * off, far * above))[0]
                np.testing.assert_allclose(found, kept * best, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize(
    ("course", "share"), [(CHANNEL, 0.3), (CIRCLE, 0.6)], ids=["channel", "circle"]
)
def test_a_course_off_the_track_costs_half_of_its_share(course: Course, share: float):
    s = part(course)
    turned = replace(course, place=lambda *at: course.place(*at) + 0.05 * np.eye(8)[2])
    found, best = (scored(each, places(s))[0] for each in (turned, course))
    np.testing.assert_allclose(found, (1.0 - 0.5 * share) * best, rtol=1e-9)


@every_course
@pytest.mark.parametrize("share", [0.02, 0.3, 1.0])
def test_dithering_costs_without_bound(course: Course, share: float):
    """Travel and reversals: actuators that turn by a share of the full rate and back each step."""
    s = part(course)[:60]
    best, dithering = (scored(course, places(s), helm)[0] for helm in (0.0, share))
    cost = 1.0 + share * course.price * (1.25 + 4.0)
    np.testing.assert_allclose(dithering[2:], best[2:] / cost, rtol=1e-9)


# --- ends -----------------------------------------------------------------------------------------

LIMITS = [
    (SPATIAL, "off the path", 0.5, (5.0, 0.0)), (SPATIAL, "off the path", 0.5, (-5.0, 0.0)),
    (SPATIAL, "surfaced", 0.0, (0.0, 2.0)), (SPATIAL, "too deep", 1.0, (0.0, -3.0)),
    (VERTICAL, "off the path", 0.5, (0.0, -5.0)),
    (VERTICAL, "surfaced", 0.0, (0.0, VERTICAL.task.launch_depth)),
    (VERTICAL, "too deep", 1.0, (0.0, -VERTICAL.task.margin)),
    (FLIGHT, "off the path", 0.0, (-100.0, 0.0)), (FLIGHT, "off the altitude", 0.0, (0.0, 40.0)),
    (FLIGHT, "off the altitude", 0.0, (0.0, -40.0)), (CHANNEL, "aground", 0.5, (28.0, 0.0)),
    (CHANNEL, "aground", 0.5, (-28.0, 0.0)), (CIRCLE, "turn lost", 0.5, (3.0 * SHIP.length, 0.0)),
]  # fmt: skip


@pytest.mark.parametrize(("course", "reason", "share", "limit"), LIMITS, ids=range(len(LIMITS)))
def test_each_failure_ends_the_episode_at_its_limit(
    course: Course, reason: str, share: float, limit: tuple[float, float]
):
    start = course.place(0.0)
    kept = course.task.initial_score_state(start[None], course.scenario)
    for factor, expected in ((0.99, ""), (1.01, reason)):
        truth = course.place(share * course.length, *np.multiply(limit, factor))
        assert judged(course, truth, kept, start)[1] == expected


@over(SPATIAL, VERTICAL)
def test_a_dive_that_pitches_over_ends(course: Course):
    start = course.place(0.0)
    kept = course.task.initial_score_state(start[None], course.scenario)
    for degrees, expected in ((74.0, ""), (76.0, "pitched over"), (-76.0, "pitched over")):
        truth = start.copy()
        truth[course.task.components[10]] = np.deg2rad(degrees)
        assert judged(course, truth, kept, start)[1] == expected


@with_a_goal
def test_estimated_arrival_overrides_a_failure(course: Course):
    """The mission is over then; where the vehicle is says whether it was a success."""
    kept = course.task.initial_score_state(course.place(0.0)[None], course.scenario)
    lost = course.place(0.5 * course.length, *course.beside(120.0))
    there = course.place(course.length + 1e-6)
    assert judged(course, lost, kept, there)[1] == "missed the goal"
