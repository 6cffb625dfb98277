"""Pictures: that they show the truth as true, the belief as believed, of every task, and cost nothing unasked for."""

from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest
from heading_ship import HEADING_SHIP

import vessel_gym  # noqa: F401

pygame = pytest.importorskip("pygame")

from pages import OWN  # noqa: E402

from vessel_gym import surroundings  # noqa: E402
from vessel_gym.rendering import make_renderer  # noqa: E402
from vessel_gym.rendering.canvas import Box, Canvas, nice  # noqa: E402
from vessel_gym.rendering.charts import ticks  # noqa: E402
from vessel_gym.rendering.hulls import HULLS  # noqa: E402
from vessel_gym.rendering.maps import Frame, views_of  # noqa: E402
from vessel_gym.rendering.palette import LIGHT  # noqa: E402
from vessel_gym.rendering.renderer import SIZE  # noqa: E402

CORVETTE, THESIS, SPATIAL, VERTICAL, FLIGHT = (
    "SigmaCorvette-v0", "ThesisCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0",
)  # fmt: skip
DOCKING = OWN[2]
EVERY = [CORVETTE, THESIS, SPATIAL, VERTICAL, FLIGHT, DOCKING]
PLACED = [CORVETTE, SPATIAL, VERTICAL, FLIGHT, DOCKING]
"""Those of which the position is estimated,"""
ON_A_PATH = PLACED[:-1]
"""those that have a path,"""
SPACE = [SPATIAL, FLIGHT]
"""and those that are seen from above and from the side."""
MAPS = np.s_[90:440, 18:510]
"""Where in a picture the maps are."""
CHARTS = np.s_[474:704, 18:992]
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


def picture(core, *moments):
    """A picture of a core whose vehicle has been, and believed to be, at pairs of places ``(3,)``; none: as it is."""
    renderer = make_renderer(core, "rgb_array", 20)
    renderer.begin()
    state, mean = core.now.state, core.now.belief.mean
    for truth, belief in moments or [(None, None)]:
        core.now.state = put(state, core.config.system.vehicle.state_names, truth)
        core.now.belief = core.now.belief.replace(
            mean=put(mean, core.config.estimation.space.names, belief)
        )
        renderer.record()
    core.now.state, core.now.belief = state, core.now.belief.replace(mean=mean)
    return renderer.draw()


def core_of(env_id, estimator="ekf", **options):
    return made(env_id, steps=0, estimator=estimator, **options).unwrapped.core


def somewhere(core, *shares):
    """Places ``(n, 3)`` between the least and the most north, east and down of a path."""
    path = surroundings.surroundings_of(core, core.now.scenario[0]).path
    return path.min(0) + np.array(shares)[:, None] * np.ptp(path, 0)


def put(states, names, place):
    """States with their position at a place."""
    states = states.copy()
    for name, value in (
        () if place is None else zip(("x", "y", "z", "h"), (*place, -place[2]), strict=True)
    ):
        if name in names:
            states[0, names.index(name)] = value
    return states


def painted(pixels, colour):
    """Which pixels have exactly this colour."""
    return (pixels == np.array(pygame.Color(LIGHT[colour])[:3], np.uint8)).all(-1)


class Words(list):
    """Every text that canvases write, as (text, left, right, top, bottom)."""

    def __contains__(self, words):
        return any(words in entry[0] for entry in self)


@pytest.fixture
def words(monkeypatch):
    written, write = Words(), Canvas.text

    def text(canvas, x, y, text, colour="true", size=12, align="left", bold=False):
        width = write(canvas, x, y, text, colour, size, align, bold)
        left = x - {"left": 0.0, "centre": 0.5, "right": 1.0}[align] * width
        written.append((text, left, left + width, y - 0.35 * size, y + 0.35 * size))
        return width

    monkeypatch.setattr(Canvas, "text", text)
    return written


@pytest.fixture
def dots(monkeypatch):
    """Every dot that canvases draw: its colour and its place."""
    drawn, dot = [], Canvas.dot

    def counted(canvas, at, colour, radius=3.0):
        drawn.append((colour, np.array(at)))
        dot(canvas, at, colour, radius)

    monkeypatch.setattr(Canvas, "dot", counted)
    return drawn


# --- pictures in general --------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", EVERY)
def test_rgb_array_is_a_picture_and_opens_no_display(env_id):
    pixels = drawn(env_id)
    assert pixels.shape == (*SIZE[::-1], 3)
    assert pixels.dtype == np.uint8
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 100
    assert not pygame.display.get_init()


@pytest.mark.parametrize("env_id", EVERY)
def test_picture_depends_on_seed_and_step_alone(env_id):
    assert (drawn(env_id, seed=1) == drawn(env_id, seed=1)).all()
    assert (drawn(env_id, seed=1) != drawn(env_id, seed=2)).any()
    assert (drawn(env_id, seed=1) != drawn(env_id, seed=1, steps=4)).any()


@pytest.mark.parametrize("env_id", EVERY)
def test_a_new_episode_forgets_the_old_track_and_the_old_fixes(env_id):
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
    assert painted(pixels[MAPS], "believed").any()


# --- what they show -------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", ON_A_PATH)
@pytest.mark.parametrize("whose", ["truth", "belief"])
@pytest.mark.parametrize("detour", [False, True])
def test_marks_and_track_follow_truth_or_belief_alone(env_id, whose, detour):
    core = core_of(env_id)
    true, believed, *by = somewhere(core, 0.3, 0.7, 0.15, 0.0)  # clear of each other
    by = by[0] - by[1]
    moves = true + by * (whose == "truth"), believed + by * (whose == "belief")
    stays = true, believed
    before = picture(core, stays)[MAPS]
    after = picture(core, *([stays, moves, stays] if detour else [moves]))[MAPS]
    mine, other = ("true", "believed") if whose == "truth" else ("believed", "true")
    assert (painted(before, mine) != painted(after, mine)).any()
    assert (painted(before, other) == painted(after, other)).all()


@pytest.mark.parametrize(
    ("env_id", "by", "seen", "rows", "columns"),
    [
        (CORVETTE, (100.0, 0.0, 0.0), "above", -1, 0),
        (CORVETTE, (0.0, 100.0, 0.0), "above", 0, 1),
        (FLIGHT, (0.0, 0.0, -20.0), "the side", -1, 0),
        (SPATIAL, (0.0, 0.0, 2.0), "above", 0, 0),
        (SPATIAL, (0.0, 0.0, 2.0), "the side", 1, 0),
        (VERTICAL, (0.0, 0.0, 2.0), "the side", 1, 0),
        (VERTICAL, (4.0, 0.0, 0.0), "the side", 0, 1),
    ],
)
def test_north_is_up_east_is_right_and_deeper_is_lower(env_id, by, seen, rows, columns, words):
    core = core_of(env_id)
    believed, true = somewhere(core, 0.8, 0.4)
    middles = []
    for place in (true, true + by):
        pixels = painted(picture(core, (place, believed)), "true")[: MAPS[0].stop, : MAPS[1].stop]
        tops = {text: round(top) for text, _, _, top, _ in words if text.startswith("Seen from")}
        below = tops.get("Seen from the side", MAPS[0].start)
        part = np.s_[below:] if seen == "the side" else np.s_[: below if env_id in SPACE else None]
        middles.append(np.array(np.nonzero(pixels[part])).mean(1))
    assert (np.sign(np.round((middles[1] - middles[0]) / 5.0)) == [rows, columns]).all()


@pytest.mark.parametrize("env_id", PLACED)
def test_a_close_up_shows_by_how_much_the_estimator_is_wrong(env_id, dots):
    core = core_of(env_id)
    apart = []
    for error in (0.5, 1.0):
        dots.clear()
        picture(core, (np.array([error, 0.0, 0.0]), np.zeros(3)))
        close = [
            (colour, at)
            for colour, at in dots
            if at[0] > 520 and at[1] < 380 and colour in ("true", "believed")
        ]
        (_, true), (_, believed) = close[:2]
        assert [colour for colour, _ in close[:2]] == ["true", "believed"]
        apart.append(true - believed)
    assert np.hypot(*apart[1]) > np.hypot(*apart[0]) > 1.0
    if env_id not in (VERTICAL, DOCKING):
        assert apart[0] == pytest.approx([0.0, -np.hypot(*apart[0])])


@pytest.mark.parametrize("env_id", [SPATIAL, VERTICAL, FLIGHT, DOCKING])
@pytest.mark.parametrize("members", [70, 90])
def test_the_cloud_shows_as_many_members_as_there_are(env_id, members, dots, words):
    pixels = drawn(env_id, estimator="enkf", estimator_options={"members": members})
    legend = 7
    assert (
        sum(colour == "member" for colour, _ in dots)
        == 2 * (1 + (env_id in SPACE)) * members + legend
    )
    assert painted(pixels, "member").sum() > 20
    assert f"ensemble of {members}" in words


@pytest.mark.parametrize("env_id", PLACED)
def test_covariance_is_an_ellipse_and_certainty_nothing(env_id, words):
    drawn(env_id, estimator="ekf")
    assert any(entry[0] == "estimate ±2σ" and entry[1] > 530 and entry[3] < 470 for entry in words)
    assert "ensemble" not in words
    words.clear()
    drawn(env_id, estimator="truth")
    assert not any(entry[0] == "estimate ±2σ" and entry[3] < 470 for entry in words)


@pytest.mark.parametrize(("env_id", "every"), [(SPATIAL, 20), (FLIGHT, 10)])
def test_a_fix_leaves_a_mark_when_it_arrives_and_only_then(env_id, every, monkeypatch):
    marks = []
    monkeypatch.setattr(Canvas, "crosses", lambda canvas, points, *given: marks.append(len(points)))
    with closing(made(env_id, steps=0, sensors="clean")) as env:
        counts = []
        for _ in range(2 * every + 1):
            env.render()
            counts.append(marks[0])
            marks.clear()
            env.step(np.zeros(3, np.float32))
        core, scene = env.unwrapped.core, env.unwrapped._renderer._picture.scene
    assert counts == [1] * every + [2] * every + [3]
    np.testing.assert_array_equal(
        scene.true[-1], surroundings.pose(core.now.state, core.config.system.vehicle.state_names)[0]
    )
    assert np.flatnonzero(np.isfinite(scene.fixes).all(1)).tolist() == [0, every, 2 * every]
    assert 0.0 < np.linalg.norm(scene.fixes[-2]) < 5.0


@pytest.mark.parametrize("env_id", EVERY)
def test_charts_show_estimates_actions_and_score(env_id, words):
    drawn(env_id)
    written = [text for text, _, _, top, _ in words if top > CHARTS[0].start]
    assert {"Actions", "Score so far"} <= set(written)
    assert any("±2σ" in text for text in written)


def test_what_has_no_place_is_drawn_in_charts_alone(monkeypatch, words):
    monkeypatch.setattr("vessel_gym.rendering.picture.views_of", lambda *given: [])
    drawn(VERTICAL)
    assert "Seen from" not in words
    for name in (
        "Surge speed",
        "Heave speed",
        "Pitch rate",
        "North position",
        "Depth",
        "Pitch",
        "Score so far",
    ):
        assert name in words


# --- what they say --------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", EVERY)
def test_the_header_says_what_is_flown_under_which_conditions(env_id, words):
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
def test_an_end_is_said_and_one_that_is_no_success_in_red(env_id, words):
    core = core_of(env_id)
    task = core.config.system.task
    assert not painted(picture(core)[:60], "obstacle").any()
    for number, end in enumerate(task.end_reasons[1:], 1):
        core.now.end[:] = number
        assert painted(picture(core)[:60], "obstacle").any() == (end != task.success)
        assert end in words
    core.now.end[:], core.now.steps[:] = 0, task.horizon
    assert painted(picture(core)[:60], "obstacle").any() == bool(task.success)
    assert "time is up" in words


@pytest.mark.parametrize("env_id", [SPATIAL, VERTICAL, FLIGHT])
def test_the_header_says_how_far_the_goal_is(env_id, words):
    core = core_of(env_id)
    goal = np.array(surroundings.surroundings_of(core, core.now.scenario[0]).goal[:3])
    picture(core, (goal + [0.2, 0.0, 0.0], goal))
    assert "0.20 m" in words


@pytest.mark.parametrize(
    ("env_id", "options"),
    [
        *((env_id, {"steps": 40}) for env_id in EVERY),
        (
            CORVETTE,
            {"estimator": "dead-reckoning", "mismatch": 0.25, "sensors": "degraded", "steps": 60},
        ),
        (HEADING_SHIP.name, {"estimator": "kf", "options": {"radius": -5000.0}}),
        (
            SPATIAL,
            {"estimator": "dead-reckoning", "mismatch": 0.25, "sensors": "degraded", "steps": 0},
        ),
        (SPATIAL, {"options": {"goal": (10.0, -18.0, 6.0)}, "steps": 60}),
        (SPATIAL, {"options": {"goal": (30.0, 0.0, 10.0)}}),
        (SPATIAL, {"options": {"goal": (4.0, 0.0, 0.0)}}),
        (VERTICAL, {"estimator": "truth", "options": {"goal": (10.0, 0.0, 2.0)}}),
        (FLIGHT, {"options": {"obstacles": [], "altitude": 1000.0}}),
        (FLIGHT, {"estimator": "ekf", "seed": 5}),
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


def test_a_window_that_the_user_closes_ends_nothing_else(monkeypatch):
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
    assert tuple(HULLS) == surroundings.HULLS
    for name, hull in HULLS.items():
        above = hull.above
        assert np.ptp(above[:, int(name == "aircraft")]) == pytest.approx(1.0, rel=0.01)
        assert np.sort(above[:, 1]) == pytest.approx(np.sort(-above[:, 1]))
        assert np.abs(hull.aside).max() <= 0.5
        assert hull.near >= np.hypot(*above.T).max()


def test_a_frame_has_equal_axes_and_shows_everything():
    points = np.array([[0.0, 0.0], [900.0, 0.0], [0.0, 300.0]])
    box = Box(10.0, 20.0, 400.0, 500.0)
    frame = Frame(box, points, (30.0, 30.0, 30.0, 30.0))
    origin, up, right = frame.pixels(points)
    assert up == pytest.approx(origin - [0.0, 900.0 * frame.scale])
    assert right == pytest.approx(origin + [300.0 * frame.scale, 0.0])
    for x, y in (origin, up, right):
        assert box.left + 30.0 <= x <= box.right - 30.0
        assert box.top + 29.9 <= y <= box.bottom - 29.9
    assert Frame(box, points[::2], hung=True).pixels(points[2])[1] == pytest.approx(box.top)


@pytest.mark.parametrize("yaw", [0.0, 0.5 * np.pi, np.pi, -2.0])
@pytest.mark.parametrize("pitch", [-0.4, 0.0, 0.4])
def test_hull_points_where_vehicle_does_and_fin_stays_on_top(yaw, pitch):
    above, aside = views_of(
        ("x", "y", "z"), np.array([0.0, 2.0])
    )  # the side looks at what goes east
    lies = np.array([0.0, 0.0, 0.0, 0.0, pitch, yaw])
    hull = HULLS["aircraft"]
    nose = above.body(lies, hull)[0] / hull.above[0, 0]
    assert nose == pytest.approx(np.cos(pitch) * np.array([np.cos(yaw), np.sin(yaw)]))
    wing = (
        above.body(lies, hull)[hull.above[:, 1].argmax()]
        - nose * hull.above[hull.above[:, 1].argmax(), 0]
    )
    assert wing == pytest.approx(0.5 * np.array([-np.sin(yaw), np.cos(yaw)]))  # to starboard
    seen = aside.body(lies, hull)
    if abs(np.sin(yaw)) > 0.1:
        assert seen[0] / hull.aside[0, 0] == pytest.approx(
            [np.sin(pitch), np.cos(pitch) * np.sin(yaw)]
        )
        assert seen[:, 0].max() > 0.05 - 0.25 * abs(np.sin(pitch))  # the fin is on top


def test_nice_numbers_are_round_and_never_too_small():
    for value in np.geomspace(1e-4, 1e4, 97):
        assert value * 0.999 <= nice(value) <= 2.0 * value


def test_ticks_are_few_round_and_inside():
    for size in np.geomspace(1e-3, 1e4, 50):
        for low in (-0.3 * size, 0.0, 7.7 * size):
            found = ticks(low, low + size, 3)
            assert 3 <= len(found) <= 8
            assert low - 1e-5 * size <= found[0] < found[-1] <= low + 1.00001 * size
            assert np.ptp(np.diff(found)) < 1e-6 * size


def test_a_line_of_one_point_draws_nothing():
    canvas = Canvas(32, 32)
    canvas.clear()
    before = pygame.image.tobytes(canvas.finish(), "RGB")
    canvas.line(np.array([[5.0, 5.0]]), "ink")
    canvas.dashes(np.array([[5.0, 5.0]]), "ink")
    assert pygame.image.tobytes(canvas.finish(), "RGB") == before
