"""Pictures of dives: that they show the truth as true, the belief as believed, and say how a dive ended."""

from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest

import vessel_gym  # noqa: F401
from vessel_gym.guidance.dive_path import path_point

pygame = pytest.importorskip("pygame")

from vessel_gym.rendering import make_renderer  # noqa: E402
from vessel_gym.rendering.canvas import BELIEVED, LIMIT, MEMBER, TRUE, TRUE_SOFT, Canvas  # noqa: E402
from vessel_gym.rendering.dive import torpedo_outline  # noqa: E402
from vessel_gym.rendering.renderer import SIZE  # noqa: E402

DIVES = ["SegorogeniAUV-v0", "ItsunusaAUV-v0"]
LARGE = np.s_[94:334, 18:776]
"""Where in a picture the large views are."""
CHARTS = np.s_[440:704, 18:776]
"""Where only charts are."""


def made(env_id, steps=2, seed=0, options=None, **made_with):
    """An environment some steps into an episode in which all actuators are half way."""
    env = gym.make(env_id, render_mode="rgb_array", **made_with)
    env.reset(seed=seed, options=options)
    for _ in range(steps):
        env.step(np.zeros(env.action_space.shape, np.float32))
    return env


def drawn(env_id, **options):
    with closing(made(env_id, **options)) as env:
        return env.render()


def half_way(env_id, **options):
    """A core whose vehicle is half way on the path, and believes so."""
    env = made(env_id, steps=0, **options)
    core = env.unwrapped.core
    task = core.task
    point = path_point(0.5 * core.course[:, 1], core.course)[:, :3]
    return moved(core, point - task.position(core.state), point - task.position(core.belief.mean))


def moved(core, truth=0.0, belief=0.0):
    """The core with the vehicle and what is believed of it shifted by vectors north, east and down [m]."""
    back = core.task.position(np.eye(core.belief.mean.shape[1]))  # (n, 3)
    core.state = core.state + (np.zeros(3) + truth) @ back.T[:, : core.state.shape[1]]
    core.loop.belief = core.belief.replace(mean=core.belief.mean + (np.zeros(3) + belief) @ back.T)
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
@pytest.mark.parametrize("env_id", DIVES)
def test_rgb_array_is_a_picture_and_opens_no_display(env_id):
    pixels = drawn(env_id)
    assert pixels.shape == (720, 1008, 3)
    assert pixels.dtype == np.uint8
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 100
    assert not pygame.display.get_init()


@pytest.mark.parametrize("env_id", DIVES)
def test_pictures_change_as_the_dive_goes_on(env_id):
    assert (drawn(env_id, steps=3) != drawn(env_id, steps=6)).any()


@pytest.mark.parametrize("env_id", DIVES)
def test_the_same_seed_gives_the_same_picture_and_another_seed_another(env_id):
    assert (drawn(env_id, seed=1) == drawn(env_id, seed=1)).all()
    assert (drawn(env_id, seed=1) != drawn(env_id, seed=2)).any()


@pytest.mark.parametrize("env_id", DIVES)
def test_a_new_dive_forgets_the_old_track_and_the_old_fixes(env_id):
    with closing(made(env_id, steps=3, seed=4)) as env:
        env.reset(seed=3)
        assert (env.render() == drawn(env_id, steps=0, seed=3)).all()


@pytest.mark.parametrize("env_id", DIVES)
def test_drawing_changes_nothing_in_the_dive(env_id):
    with closing(made(env_id)) as plain, closing(made(env_id)) as watched:
        action = np.full(plain.action_space.shape, 0.3, np.float32)
        for _ in range(3):
            watched.render()
            assert (watched.step(action)[0] == plain.step(action)[0]).all()


@pytest.mark.parametrize("env_id", DIVES)
@pytest.mark.parametrize("estimator", ["enkf", "enkf-sr", "ekf", "ukf", "truth", "measurement", "dead-reckoning"])
def test_every_kind_of_belief_can_be_drawn(env_id, estimator):
    assert drawn(env_id, estimator=estimator, disturbance="rough", sensors="degraded", mismatch=0.2).std() > 1.0


@pytest.mark.parametrize("env_id", DIVES)
@pytest.mark.parametrize("observe", ["mean", "mean+std", "measurement"])
def test_every_mode_can_be_drawn(env_id, observe):
    assert drawn(env_id, observe=observe).std() > 1.0


def test_a_window_shows_a_dive(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make(DIVES[0], render_mode="human")
    with closing(env):
        env.reset(seed=0)
        assert pygame.surfarray.array3d(pygame.display.get_surface()).std() > 1.0
    assert not pygame.display.get_init()


# --- what they show ------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", DIVES)
def test_only_true_marks_move_when_only_the_truth_does(env_id):
    core = half_way(env_id, estimator="ekf")
    before = picture(core)[LARGE]
    after = picture(moved(core, truth=[0.0, 0.0, 2.0]))[LARGE]
    assert (painted(before, TRUE) != painted(after, TRUE)).any()
    assert (painted(before, BELIEVED) == painted(after, BELIEVED)).all()


@pytest.mark.parametrize("env_id", DIVES)
def test_only_believed_marks_move_when_only_the_belief_does(env_id):
    core = moved(half_way(env_id, estimator="ekf"), belief=[-2.0, 0.0, -2.0])  # clear of the true vehicle
    before = picture(core)[LARGE]
    after = picture(moved(core, belief=[0.0, 0.0, -1.0]))[LARGE]
    assert (painted(before, BELIEVED) != painted(after, BELIEVED)).any()
    assert (painted(before, TRUE) == painted(after, TRUE)).all()


@pytest.mark.parametrize("env_id", DIVES)
@pytest.mark.parametrize("whose", ["truth", "belief"])
def test_a_detour_stays_on_the_track_and_in_the_charts_of_whoever_made_it(env_id, whose):
    core = moved(half_way(env_id, estimator="truth"), belief=[-1.0, 0.0, -3.6])
    pictures = []
    for up in (0.0, 0.5):
        renderer = make_renderer(core, "rgb_array", 20)
        renderer.begin()
        for shift in (0.0, -up, up):
            moved(core, **{whose: [0.0, 0.0, shift]})
            renderer.record()
            core.steps += 40
        core.steps -= 120
        pictures.append(renderer.draw())
    mine, other = (TRUE, BELIEVED) if whose == "truth" else (BELIEVED, TRUE)
    other_line = BELIEVED if whose == "truth" else TRUE_SOFT
    assert (painted(pictures[0][LARGE], mine) != painted(pictures[1][LARGE], mine)).any()
    assert (painted(pictures[0][LARGE], other) == painted(pictures[1][LARGE], other)).all()
    assert (pictures[0][CHARTS] != pictures[1][CHARTS]).any()
    assert (painted(pictures[0][CHARTS], other_line) == painted(pictures[1][CHARTS], other_line)).all()


@pytest.mark.parametrize("env_id", DIVES)
def test_deeper_is_further_down_and_from_above_looks_the_same(env_id):
    core = moved(half_way(env_id, estimator="truth"), belief=[0.0, 0.0, -2.0])
    rows, halves = [], []
    for depth in (0.0, 1.0):
        true = painted(picture(moved(core, truth=[0.0, 0.0, depth]))[LARGE], TRUE)
        above, aside = true[:, :374], true[:, 386:]
        halves.append(above)
        rows.append(np.nonzero(aside)[0].mean() if env_id == DIVES[0] else np.nonzero(true)[0].mean())
    assert rows[1] > rows[0] + 3.0
    if env_id == DIVES[0]:
        assert (halves[0] == halves[1]).all()


def test_a_goal_to_port_is_on_the_left_and_one_to_starboard_on_the_right():
    def middle(east):
        core = made(DIVES[0], steps=0, options={"goal": (10.0, east, 6.0)}).unwrapped.core
        return np.nonzero(painted(picture(core)[LARGE][:, :374], TRUE))[1].mean()

    assert middle(-18.0) > 250.0  # the start is opposite
    assert middle(18.0) < 120.0


@pytest.mark.parametrize("env_id", DIVES)
@pytest.mark.parametrize("members", [40, 90])
def test_the_cloud_shows_as_many_members_as_there_are(env_id, members, monkeypatch, words):
    env, dots, dot = made(env_id, estimator_options={"members": members}), [], Canvas.dot

    def counted(canvas, at, colour, radius=3.0):
        dots.append((colour, tuple(at)))
        dot(canvas, at, colour, radius)

    monkeypatch.setattr(Canvas, "dot", counted)
    with closing(env):
        pixels = env.render()
    views = {DIVES[0]: 2, DIVES[1]: 1}[env_id]
    legend = 7
    assert sum(colour == MEMBER for colour, _ in dots) == 2 * views * members + legend
    assert painted(pixels, MEMBER).sum() > 50
    assert f"ensemble of {members} guesses" in words


@pytest.mark.parametrize("env_id", DIVES)
def test_without_an_ensemble_there_is_an_ellipse_and_with_certainty_nothing(env_id, words):
    drawn(env_id, estimator="ekf")
    assert "position ±2σ" in words
    assert "ensemble" not in words
    words.clear()
    drawn(env_id, estimator="truth")
    assert "position ±2σ" not in words


def test_a_fix_leaves_a_mark_when_it_arrives_and_only_then():
    with closing(made(DIVES[0], steps=0, sensors="clean")) as env:
        scene = env.unwrapped._renderer._scene
        counts = []
        for _ in range(41):
            counts.append(len(scene._fixes))
            env.step(np.zeros(3, np.float32))
    assert counts == [1] * 20 + [2] * 20 + [3]


@pytest.mark.parametrize("env_id", DIVES)
def test_the_header_says_what_is_flown_under_which_conditions(env_id, words):
    drawn(env_id, estimator="ekf", disturbance="rough", sensors="degraded", mismatch=0.15)
    for part in (env_id, "estimator ekf", "rough disturbance", "degraded sensors", "mismatch 15 %", "under way"):
        assert part in words


@pytest.mark.parametrize("env_id", DIVES)
def test_a_vehicle_that_is_drawn_larger_than_it_is_says_so(env_id, words):
    drawn(env_id)
    assert "vehicles drawn " in words


@pytest.mark.parametrize(
    ("env_id", "end", "down"),
    [
        (DIVES[0], "off the path", 5.5),
        (DIVES[0], "surfaced", -40.0),
        (DIVES[0], "too deep", 40.0),
        (DIVES[1], "off the path", -7.0),
        (DIVES[1], "surfaced", -40.0),
        (DIVES[1], "too deep", 40.0),
    ],
)
def test_a_lost_dive_is_drawn_and_says_why_it_is_lost(env_id, end, down, words):
    core = moved(half_way(env_id), truth=[0.0, 0.0, down])
    core.step(np.zeros((1, core.action_size)))
    assert core.task.ends[core.end[0]] == end
    pixels = picture(core)
    assert f"lost: {end}" in words
    assert painted(pixels[:60], LIMIT).any()


@pytest.mark.parametrize("env_id", DIVES)
def test_the_end_of_a_path_says_how_far_the_goal_is(env_id, words):
    core = half_way(env_id, estimator="ekf", disturbance="calm")
    end = path_point(core.course[:, 1] + 0.2, core.course)[:, :3] - core.task.position(core.state)
    moved(core, truth=end, belief=end)
    core.end[:] = core.task.ends.index("arrived")
    picture(core)
    assert "arrived, 0.20 m from the goal" in words
    core.end[:] = core.task.ends.index("missed the goal")
    picture(core)
    assert "missed the goal by 0.20 m" in words


@pytest.mark.parametrize("env_id", DIVES)
def test_a_dive_that_runs_out_of_time_says_so(env_id, words):
    core = half_way(env_id)
    core.steps[:] = core.task.horizon
    picture(core)
    assert "time is up" in words


@pytest.mark.parametrize(
    ("env_id", "options"),
    [
        (DIVES[0], {}),
        (DIVES[0], {"estimator": "dead-reckoning", "mismatch": 0.25, "sensors": "degraded"}),
        (DIVES[0], {"options": {"goal": (10.0, -18.0, 6.0)}, "steps": 60}),
        (DIVES[0], {"options": {"goal": (30.0, 0.0, 10.0)}}),
        (DIVES[0], {"options": {"goal": (4.0, 0.0, 0.0)}}),
        (DIVES[1], {"estimator": "ekf", "steps": 60}),
        (DIVES[1], {"options": {"goal": (10.0, 0.0, 2.0)}}),
    ],
)
def test_labels_stay_in_the_picture_and_off_each_other(env_id, options, words):
    drawn(env_id, **options)
    for text, left, right, top, bottom in words:
        assert left >= 0.0, text
        assert right <= SIZE[0], text
        assert top >= 0.0, text
        assert bottom <= SIZE[1], text
    for i, (text, left, right, top, bottom) in enumerate(words):
        for other, *box in words[i + 1 :]:
            apart = right <= box[0] or box[1] <= left or bottom <= box[2] or box[3] <= top
            assert apart, (text, other)


# --- pieces --------------------------------------------------------------------------------------------


def test_the_outline_is_symmetric_one_length_long_and_blunt_in_front():
    hull = torpedo_outline(0.2)
    assert np.ptp(hull[:, 0]) == pytest.approx(1.0)
    mirrored = np.roll(hull[::-1] * [1.0, -1.0], 1, axis=0)
    assert mirrored == pytest.approx(hull)
    assert np.abs(hull[hull[:, 0] > 0.0, 1]).max() == pytest.approx(0.1)
