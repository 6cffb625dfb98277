"""Pictures of flights: that they show the truth as true, the belief as believed, and say how a flight ended."""

from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest

import vessel_gym  # noqa: F401

pygame = pytest.importorskip("pygame")

from vessel_gym.rendering import make_renderer  # noqa: E402
from vessel_gym.rendering.canvas import BELIEVED, COMMANDED, LIMIT, MEMBER, TRUE, TRUE_SOFT, Canvas  # noqa: E402
from vessel_gym.rendering.renderer import SIZE  # noqa: E402

FLIGHT = "PunaUAV-v0"
PLAN = np.s_[94:519, 18:502]
"""Where in a picture the plan view is."""
WIND = np.s_[520:568, 300:502]
"""Where the wind is told."""
CHARTS = np.s_[312:704, 514:992]
"""Where only charts are."""
STRAIGHT = {"start": (0.0, 0.0, 0.0), "goal": (600.0, 0.0, 0.0), "obstacles": [(300.0, 200.0, 40.0)], "altitude": 100.0}


def made(steps=2, seed=0, options=None, **made_with):
    """An environment some steps into an episode in which all actuators are half way."""
    env = gym.make(FLIGHT, render_mode="rgb_array", **made_with)
    env.reset(seed=seed, options=options)
    for _ in range(steps):
        env.step(np.zeros(env.action_space.shape, np.float32))
    return env


def drawn(**options):
    with closing(made(**options)) as env:
        return env.render()


def core_of(options=STRAIGHT, **made_with):
    return made(steps=0, options=options, **made_with).unwrapped.core


def moved(core, truth=(), belief=()):
    """The core with the first components of the truth and of what is believed shifted."""
    change = np.zeros((2, core.truth.shape[1]))
    change[0, : len(truth)], change[1, : len(belief)] = truth, belief
    n, k = core.state.shape[1], core.sea_state.shape[1]
    core.state = core.state + change[0, :n]
    core.sea_state[:] += change[0, n : n + k]
    core.forcing[:, 4:] = core.forces.flow(core.sea_state, core.state)
    core.loop.belief = core.belief.replace(mean=core.belief.mean + change[1])
    return core


def picture(core):
    """A picture of a core as it is."""
    renderer = make_renderer(core, "rgb_array", 20)
    renderer.begin()
    renderer.record()
    return renderer.draw()


def painted(pixels, colour):
    """Which pixels have exactly this colour."""
    return (pixels == np.array(colour, np.uint8)).all(-1)


class Words(list):
    """Every text that canvases write, as (text, left, right, top, bottom)."""

    def __contains__(self, words):
        return any(words in entry[0] for entry in self)


@pytest.fixture
def words(monkeypatch):
    written, write = Words(), Canvas.text

    def text(canvas, x, y, text, colour=TRUE, size=12, align="left", bold=False):
        width = write(canvas, x, y, text, colour, size, align, bold)
        left = x - {"left": 0.0, "centre": 0.5, "right": 1.0}[align] * width
        written.append((text, left, left + width, y - 0.35 * size, y + 0.35 * size))
        return width

    monkeypatch.setattr(Canvas, "text", text)
    return written


# --- pictures in general -------------------------------------------------------------------------------


@pytest.mark.slow
def test_rgb_array_is_a_picture_and_opens_no_display():
    pixels = drawn()
    assert pixels.shape == (720, 1008, 3)
    assert pixels.dtype == np.uint8
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 100
    assert not pygame.display.get_init()


def test_the_same_seed_gives_the_same_picture_and_another_seed_or_step_another():
    assert (drawn(seed=1) == drawn(seed=1)).all()
    assert (drawn(seed=1) != drawn(seed=2)).any()
    assert (drawn(seed=1) != drawn(seed=1, steps=4)).any()


def test_a_new_flight_forgets_the_old_track_and_the_old_fixes():
    with closing(made(steps=12, seed=4)) as env:
        env.reset(seed=3)
        assert (env.render() == drawn(steps=0, seed=3)).all()


def test_drawing_changes_nothing_in_the_flight():
    with closing(made()) as plain, closing(made()) as watched:
        action = np.full(plain.action_space.shape, 0.3, np.float32)
        for _ in range(3):
            watched.render()
            assert (watched.step(action)[0] == plain.step(action)[0]).all()


@pytest.mark.parametrize(
    "options",
    [
        {"estimator": "enkf-sr", "observe": "mean+std"},
        {"estimator": "ekf", "observe": "measurement"},
        {"estimator": "ukf", "options": {"obstacles": []}},
        {"estimator": "truth"},
        {"estimator": "measurement"},
        {"estimator": "dead-reckoning"},
    ],
)
def test_every_kind_of_belief_can_be_drawn(options):
    assert drawn(disturbance="rough", sensors="degraded", mismatch=0.2, **options).std() > 1.0


# --- what they show ------------------------------------------------------------------------------------


def test_only_true_marks_move_when_only_the_truth_does():
    core = moved(core_of(estimator="ekf"), truth=[50.0], belief=[300.0])
    before = picture(core)[PLAN]
    after = picture(moved(core, truth=[100.0]))[PLAN]
    assert (painted(before, TRUE) != painted(after, TRUE)).any()
    assert (painted(before, BELIEVED) == painted(after, BELIEVED)).all()


def test_only_believed_marks_move_when_only_the_belief_does():
    core = moved(core_of(estimator="ekf"), truth=[50.0], belief=[300.0])
    before = picture(core)[PLAN]
    after = picture(moved(core, belief=[100.0]))[PLAN]
    assert (painted(before, BELIEVED) != painted(after, BELIEVED)).any()
    assert (painted(before, TRUE) == painted(after, TRUE)).all()


@pytest.mark.parametrize(("north", "east", "rows", "columns"), [(100.0, 0.0, -1, 0), (0.0, 60.0, 0, 1)])
def test_north_is_up_and_east_is_right(north, east, rows, columns):
    core = moved(core_of(estimator="truth"), truth=[200.0, 20.0], belief=[400.0])
    before, after = (
        np.array(np.nonzero(painted(picture(moved(core, truth=by))[PLAN], TRUE))).mean(1)
        for by in ([], [north, east])
    )  # fmt: skip
    assert (np.sign(np.round((after - before) / 5.0)) == [rows, columns]).all()


@pytest.mark.slow
@pytest.mark.parametrize("which", [1, 3, 6], ids=["across", "speed", "bank"])
@pytest.mark.parametrize("whose", ["truth", "belief"])
def test_charts_show_what_is_true_as_true_and_what_is_believed_as_believed(which, whose):
    pictures = []
    for size in (0.0, 0.15):
        core = core_of(estimator="truth")
        moved(core, belief=[0.0, -1.5, 0.0, 1.5, 0.0, 0.0, 0.3])  # off the other's line
        renderer = make_renderer(core, "rgb_array", 20)
        renderer.begin()
        for shift in (0.0, -size, size):
            moved(core, **{whose: shift * np.eye(7)[which]})
            renderer.record()
            core.steps += 100
        pictures.append(renderer.draw()[CHARTS])
    mine, other = (TRUE_SOFT, BELIEVED) if whose == "truth" else (BELIEVED, TRUE_SOFT)
    assert (painted(pictures[0], mine) != painted(pictures[1], mine)).any()
    assert (painted(pictures[0], other) == painted(pictures[1], other)).all()


def test_the_path_and_the_obstacles_are_those_of_the_course():
    near = picture(core_of())[PLAN]
    far = picture(core_of(STRAIGHT | {"obstacles": [(400.0, -200.0, 40.0)]}))[PLAN]
    sides = [np.nonzero(painted(pixels, LIMIT))[1].mean() - np.nonzero(painted(pixels, COMMANDED))[1].mean()
             for pixels in (near, far)]  # fmt: skip
    assert sides[0] > 50.0
    assert sides[1] < -50.0
    assert not painted(picture(core_of(STRAIGHT | {"obstacles": []}))[PLAN], LIMIT).any()


@pytest.mark.parametrize(("whose", "colour", "other"), [("truth", TRUE, BELIEVED), ("belief", BELIEVED, TRUE)])
def test_the_wind_counts_gusts_and_blows_where_its_arrow_points(whose, colour, other, words):
    core = core_of(estimator="truth")
    core.sea_state[0, :4] = 0.0, 3.0, 0.0, 1.0
    moved(core)
    core.loop.belief = core.belief.replace(mean=core.truth.copy())
    before = picture(core)[WIND]
    assert sum(entry[0] == "4.00 m/s" for entry in words) == 2
    after = picture(moved(core, **{whose: 4.0 * np.eye(16)[7] - 4.0 * np.eye(16)[8]}))[WIND]
    tall, wide = (np.ptp(np.nonzero(painted(pixels, colour)[:, :110]), axis=1) for pixels in (after, before))
    assert tall[0] > tall[1]
    assert wide[1] > wide[0]
    assert (painted(before, other) == painted(after, other))[:, :110].all()


@pytest.mark.parametrize("members", [40, 90])
def test_the_cloud_shows_as_many_members_as_there_are(members, monkeypatch, words):
    env, dots, dot = made(estimator_options={"members": members}), [], Canvas.dot

    def counted(canvas, at, colour, radius=3.0):
        dots.append(colour)
        dot(canvas, at, colour, radius)

    monkeypatch.setattr(Canvas, "dot", counted)
    with closing(env):
        env.render()
    legend = 7
    assert dots.count(MEMBER) == 2 * members + legend
    assert f"ensemble of {members} guesses" in words


def test_without_an_ensemble_there_is_an_ellipse_and_with_certainty_nothing(words):
    drawn(estimator="ekf")
    assert "position ±2σ" in words
    assert "ensemble" not in words
    words.clear()
    drawn(estimator="truth")
    assert "position ±2σ" not in words


def test_a_fix_leaves_a_mark_when_it_arrives_and_only_then():
    with closing(made(steps=0, sensors="clean")) as env:
        scene, counts = env.unwrapped._renderer._scene, []
        for _ in range(21):
            counts.append(len(scene._fixes))
            env.step(np.zeros(3, np.float32))
    assert counts == [1] * 10 + [2] * 10 + [3]


def test_the_header_says_what_is_flown_under_which_conditions(words):
    drawn(estimator="ekf", disturbance="rough", sensors="degraded", mismatch=0.15)
    for part in (FLIGHT, "estimator ekf", "rough disturbance", "degraded sensors", "mismatch 15 %", "under way"):
        assert part in words


def test_an_aircraft_that_is_drawn_larger_than_it_is_says_so(words):
    drawn()
    assert "aircraft drawn " in words
    assert "aircraft to scale" in words


@pytest.mark.parametrize(
    ("end", "change"),
    [
        ("hit an obstacle", [300.0, 170.0]),
        ("stalled", [0.0, 0.0, 0.0, -15.0]),
        ("crashed", [0.0, 0.0, -200.0]),
        ("off the path", [0.0, -150.0]),
        ("off the altitude", [0.0, 0.0, 60.0]),
    ],
)
def test_a_lost_flight_is_drawn_and_says_why_it_is_lost(end, change, words):
    core = moved(core_of(), truth=change)
    core.step(np.zeros((1, core.action_size)))
    assert core.task.ends[core.end[0]] == end
    pixels = picture(core)
    assert f"lost: {end}" in words
    assert painted(pixels[:60], LIMIT).any()


def test_the_end_of_a_path_says_how_far_the_goal_is(words):
    core = core_of(estimator="ekf")
    core.state[0, :2] = 603.0, 4.0
    core.end[:] = core.task.ends.index("arrived")
    picture(core)
    assert "arrived, 5.0 m from the goal" in words
    core.end[:] = core.task.ends.index("missed the goal")
    picture(core)
    assert "missed the goal by 5.0 m" in words


def test_a_flight_that_runs_out_of_time_says_so(words):
    core = core_of()
    core.steps[:] = core.task.horizon
    picture(core)
    assert "time is up" in words


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"estimator": "dead-reckoning", "mismatch": 0.25, "sensors": "degraded", "steps": 40},
        {"options": STRAIGHT | {"altitude": 1000.0}},
        {"estimator": "ekf", "seed": 5},
    ],
)
def test_labels_stay_in_the_picture_and_off_each_other(options, words):
    drawn(**options)
    for text, left, right, top, bottom in words:
        assert left >= 0.0, text
        assert right <= SIZE[0], text
        assert top >= 0.0, text
        assert bottom <= SIZE[1], text
    for i, (text, left, right, top, bottom) in enumerate(words):
        for other, *box in words[i + 1 :]:
            apart = right <= box[0] or box[1] <= left or bottom <= box[2] or box[3] <= top
            assert apart, (text, other)
