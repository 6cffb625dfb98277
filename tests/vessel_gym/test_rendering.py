"""Frames show the truth as true and the belief as believed, for every task, and change nothing."""

from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest

import vessel_gym  # noqa: F401

pygame = pytest.importorskip("pygame")

from pages import OWN  # noqa: E402

from vessel_gym.rendering.canvas import Canvas, _label  # noqa: E402
from vessel_gym.rendering.hulls import HULLS  # noqa: E402
from vessel_gym.rendering.maps import STYLES, Map, views  # noqa: E402
from vessel_gym.rendering.palette import LIGHT  # noqa: E402
from vessel_gym.rendering.picture import SIZE  # noqa: E402
from vessel_gym.rendering.renderer import Renderer  # noqa: E402
from vessel_gym.tasks import task  # noqa: E402

CORVETTE, THESIS, SPATIAL, VERTICAL, FLIGHT = (
    "SigmaCorvette-v0", "ThesisCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0",
)  # fmt: skip
DOCKING = OWN[2]
EVERY = [CORVETTE, THESIS, SPATIAL, VERTICAL, FLIGHT, DOCKING]
PLACED = [CORVETTE, SPATIAL, VERTICAL, FLIGHT, DOCKING]
"""Environments in which the position is estimated."""
BOX = pygame.Rect(20, 60, 700, 500)


def made(env_id, steps=2, seed=0, options=None, **made_with):
    """An environment some steps into an episode, with all actuators half way."""
    env = gym.make(env_id, render_mode="rgb_array", **made_with)
    env.reset(seed=seed, options=options)
    for _ in range(steps):
        env.step(np.zeros(env.action_space.shape, np.float32))
    return env


def drawn(env_id, **options):
    with closing(made(env_id, **options)) as env:
        return env.render()


def scene_of(env_id, **options):
    with closing(made(env_id, **options)) as env:
        return env.unwrapped._renderer.scene


def maps_of(scene):
    return [Map(scene, axes, BOX) for axes in views(scene)]


def painted(pixels, colour):
    """Mask of the pixels of exactly this colour."""
    return (pixels == np.array(pygame.Color(LIGHT[colour])[:3], np.uint8)).all(-1)


class Words(list):
    """Every text that canvases write, as (text, left, right, top, bottom)."""

    def __contains__(self, words):
        return any(words in entry[0] for entry in self)


@pytest.fixture
def words(monkeypatch):
    written, write = Words(), Canvas.text

    def text(canvas, x, y, text, colour="ink", size=12, anchor=0.0, bold=False):
        write(canvas, x, y, text, colour, size, anchor, bold)
        width = 0.5 * _label(text, size, colour, bold).get_width()  # of twice the pixels
        left = x - anchor * width
        written.append((text, left, left + width, y - 0.35 * size, y + 0.35 * size))

    monkeypatch.setattr(Canvas, "text", text)
    return written


# --- frames in general ----------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", EVERY)
def test_picture_depends_on_seed_and_step_alone(env_id):
    pixels = drawn(env_id, seed=1)
    assert (pixels.shape, pixels.dtype) == ((*SIZE[::-1], 3), np.uint8)
    assert (pixels == drawn(env_id, seed=1)).all()
    assert (pixels != drawn(env_id, seed=2)).any()
    assert (pixels != drawn(env_id, seed=1, steps=4)).any()
    assert not pygame.display.get_init()


@pytest.mark.parametrize("env_id", EVERY)
def test_new_episode_forgets_old_track_and_fixes(env_id):
    with closing(made(env_id, steps=12, seed=4)) as env:
        env.reset(seed=3)
        assert (env.render() == drawn(env_id, steps=0, seed=3)).all()


@pytest.mark.parametrize("env_id", EVERY)
def test_drawing_changes_nothing_in_the_episode(env_id):
    with closing(made(env_id)) as plain, closing(made(env_id)) as watched:
        action = np.full(plain.action_space.shape, 0.3, np.float32)
        for _ in range(3):
            watched.render()
            assert (watched.step(action)[0] == plain.step(action)[0]).all()


@pytest.mark.parametrize("env_id", EVERY)
@pytest.mark.parametrize(
    "options",
    [
        {"estimator": "enkf-sr", "observe": "mean+std"},
        {"estimator": "ekf", "observe": "measurement"},
        {"estimator": "ukf", "termination": "task"},
        {"estimator": "truth"},
        {"estimator": "measurement"},
        {"estimator": "dead-reckoning"},
    ],
    ids=lambda options: options["estimator"],
)
def test_every_kind_of_belief_can_be_drawn(env_id, options):
    pixels = drawn(env_id, disturbance="rough", sensors="degraded", mismatch=0.2, **options)
    assert painted(pixels[90:690, 18:730], "believed").any()


# --- marks of maps --------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", PLACED)
@pytest.mark.parametrize(("whose", "other"), [("true", "believed"), ("believed", "true")])
def test_marks_follow_truth_or_belief_alone(env_id, whose, other):
    scene = scene_of(env_id)
    for each in maps_of(scene):
        before, track = each.marks(), getattr(scene, whose)
        setattr(scene, whose, track + [3.0, 2.0, 1.0, 0.0, 0.0, 0.0])
        after = each.marks()
        setattr(scene, whose, track)
        for kind, moves in ((whose, True), (other, False)):
            for mark in (kind, f"{kind} track"):
                assert np.array_equal(before[mark], after[mark]) != moves


@pytest.mark.parametrize("env_id", [SPATIAL, FLIGHT])
def test_north_is_up_east_is_right_and_deeper_is_lower(env_id):
    above, aside = maps_of(scene_of(env_id))
    north, east, down = above.pixels(np.eye(3)) - above.pixels(np.zeros(3))
    np.testing.assert_allclose([north, east], above.scale * np.array([[0, -1], [1, 0]]), atol=1e-9)
    np.testing.assert_allclose(down, 0.0, atol=1e-9)
    *_, down = aside.pixels(np.eye(3)) - aside.pixels(np.zeros(3))
    np.testing.assert_allclose(down, [0.0, aside.scale], atol=1e-9)


@pytest.mark.parametrize("env_id", PLACED)
def test_map_has_room_for_tracks_and_landmarks(env_id):
    scene = scene_of(env_id, steps=30)
    around = scene.workspace
    for each in maps_of(scene):
        points = [around.landmarks, scene.true[:, :3], scene.believed[:, :3]]
        pixels = each.pixels(np.concatenate(points))
        assert (pixels > np.array(BOX.topleft) + 20.0).all()
        assert (pixels < np.array(BOX.bottomright) - 20.0).all()


@pytest.mark.parametrize("env_id", PLACED)
def test_ellipse_is_two_deviations_of_position(env_id):
    scene = scene_of(env_id, estimator="ekf")
    for each in maps_of(scene):
        (ellipse,) = each.marks()["ellipse"]
        seen = each.axes @ scene.position.axes.T
        away = (ellipse - scene.believed[-1, :3]) @ each.axes.T
        cov = seen @ scene.position.cov[-1] @ seen.T
        squares = (away @ np.linalg.inv(cov) * away).sum(-1)
        np.testing.assert_allclose(squares, 4.0, rtol=1e-6)
    assert "ellipse" not in scene_of(env_id, estimator="truth").legend


@pytest.mark.slow
@pytest.mark.parametrize("env_id", [SPATIAL, VERTICAL, FLIGHT, DOCKING])
@pytest.mark.parametrize("members", [70, 90])
def test_cloud_shows_as_many_members_as_there_are(env_id, members):
    scene = scene_of(env_id, estimator="enkf", estimator_options={"members": members})
    assert scene.legend["cloud"] == f"ensemble of {members}"
    for each in maps_of(scene):
        (cloud,) = each.marks()["cloud"]
        assert cloud.shape == (members, 3)
        np.testing.assert_allclose(cloud.mean(0), scene.believed[-1, :3], atol=1e-6)
    assert "cloud" not in scene_of(env_id, estimator="ekf").legend


@pytest.mark.parametrize(("env_id", "every"), [(SPATIAL, 20), (FLIGHT, 10)])
def test_a_fix_leaves_a_mark_when_it_arrives(env_id, every):
    scene = scene_of(env_id, steps=2 * every + 1, sensors="clean")
    arrived = np.flatnonzero(np.isfinite(scene.fixes).all(1))
    assert arrived.tolist() == [0, every, 2 * every]
    assert 0.0 < np.linalg.norm(scene.fixes[arrived[1]]) < 5.0
    for each in maps_of(scene):
        assert len(each.marks()["fix"][0]) == 3


@pytest.mark.parametrize("env_id", EVERY)
def test_every_kind_of_marks_is_named_in_the_legend(env_id):
    scene = scene_of(env_id)
    shown = {kind.removesuffix(" track") for each in maps_of(scene)
             for kind, points in each.marks().items() if any(map(len, points))}  # fmt: skip
    assert shown <= {*scene.legend} <= {*STYLES}


# --- words ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", EVERY)
def test_header_says_under_which_conditions(env_id, words):
    drawn(env_id, estimator="ekf", disturbance="rough", sensors="degraded", mismatch=0.15)
    for part in (
        env_id,
        "estimator ekf",
        "rough disturbance",
        "degraded sensors",
        "mismatch 15 %",
        "under way",
    ):
        assert part in words


@pytest.mark.parametrize("env_id", EVERY)
def test_frame_has_error_of_every_estimated_component(env_id, words):
    scene = scene_of(env_id, estimator="ekf")
    drawn(env_id, estimator="ekf")
    for words_, unit, _ in scene.position.words:
        assert words_ in words
        assert unit in words
    for error in scene.position.error[-1]:
        assert f"{error:+.2f} ±" in words


@pytest.mark.parametrize("env_id", EVERY)
def test_an_end_that_is_no_success_is_red(env_id, words):
    core = made(env_id, steps=0).unwrapped.core
    renderer, task = Renderer(core, "rgb_array", 20), core.config.system.task
    renderer.record(begin=True)

    def is_red():
        return painted(renderer.draw()[:60], "obstacle").any()

    assert not is_red()
    for number, end in enumerate(task.end_reasons[1:], 1):
        core.now.end[:] = number
        assert is_red() == (end != task.success)
        assert end in words
    core.now.end[:], core.now.steps[:] = 0, task.horizon
    assert is_red() == bool(task.success)
    assert "time is up" in words


@pytest.mark.parametrize(
    ("env_id", "options"),
    [
        *((env_id, {"steps": 40}) for env_id in EVERY),
        (CORVETTE, {"estimator": "dead-reckoning", "mismatch": 0.25, "sensors": "degraded", "steps": 60}),
        (CORVETTE, {"options": {"radius": -5000.0}}),
        (SPATIAL, {"options": {"goal": (10.0, -18.0, 6.0)}, "steps": 60}),
        (SPATIAL, {"options": {"goal": (4.0, 0.0, 0.0)}}),
        (VERTICAL, {"estimator": "truth", "options": {"goal": (10.0, 0.0, 2.0)}}),
        (FLIGHT, {"options": {"obstacles": [], "altitude": 1000.0}}),
    ],
)  # fmt: skip
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


# --- windows --------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", EVERY)
def test_a_window_opens_stays_current_and_closes(env_id, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with closing(gym.make(env_id, render_mode="human")) as env:
        env.reset(seed=0)
        before = pygame.surfarray.array3d(pygame.display.get_surface())
        env.step(np.zeros(env.action_space.shape, np.float32))
        assert (pygame.surfarray.array3d(pygame.display.get_surface()) != before).any()
        assert env.render() is None
    assert not pygame.display.get_init()


def test_window_that_the_user_closes_ends_nothing_else(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with closing(gym.make(CORVETTE, render_mode="human")) as env:
        env.reset(seed=0)
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        env.step(np.zeros(1, np.float32))
        assert not pygame.display.get_init()
        env.step(np.zeros(1, np.float32))
        env.reset()


# --- pieces ---------------------------------------------------------------------------------------


def test_every_hull_is_symmetric_and_one_length_long():
    assert tuple(HULLS) == task.HULLS
    for name, hull in HULLS.items():
        above = hull.above
        assert np.ptp(above[:, int(name == "aircraft")]) == pytest.approx(1.0, rel=0.01)
        assert np.sort(above[:, 1]) == pytest.approx(np.sort(-above[:, 1]))


@pytest.mark.parametrize("yaw", [0.0, 0.5 * np.pi, np.pi, -2.0])
@pytest.mark.parametrize("pitch", [-0.4, 0.0, 0.4])
def test_a_hull_points_where_its_vehicle_does(yaw, pitch):
    above, aside = maps_of(scene_of(FLIGHT))
    lies = np.array([0.0, 0.0, 0.0, 0.0, pitch, yaw])

    def metres(view):  # up and right, in lengths
        return (view.outline(lies) - lies[:3]) @ view.axes.T / view.size

    hull, seen, ahead = HULLS["aircraft"], metres(above), np.array([np.cos(yaw), np.sin(yaw)])
    starboard, tip = np.array([-ahead[1], ahead[0]]), hull.above[:, 1].argmax()
    assert seen[0] == pytest.approx(hull.above[0, 0] * np.cos(pitch) * ahead)
    assert seen[tip] @ starboard == pytest.approx(0.5)
    seen, right = metres(aside), aside.axes[1, :2] @ ahead
    nose = np.array([np.sin(pitch), np.cos(pitch) * right])
    assert seen[0] == pytest.approx(hull.above[0, 0] * nose)
