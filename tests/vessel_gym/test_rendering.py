"""Pictures: what they need, that they change with the episode, and that they cost nothing when not asked for."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import vessel_gym  # noqa: F401

pygame = pytest.importorskip("pygame")

from vessel_gym.rendering.canvas import Box, Canvas, PlanView, nice, ship_outline  # noqa: E402
from vessel_gym.rendering.turning_circle import wedge_factor  # noqa: E402
from vessel_gym.sea_trials import fit_circle  # noqa: E402
from vessel_gym.tracks import believed_path, commanded_path, path  # noqa: E402

IDLE = np.zeros(1, np.float32)


def drawn(steps=3, seed=0, env_id="SigmaCorvette-v0", **options):
    env = gym.make(env_id, render_mode="rgb_array", **options)
    env.reset(seed=seed)
    for _ in range(steps):
        env.step(IDLE)
    picture = env.render()
    env.close()
    return picture


def modules_after(code):
    command = f"import sys; {code}; print(' '.join(sys.modules))"
    return subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.slow
def test_importing_and_stepping_import_no_pygame():
    code = "import gymnasium, vessel_gym; e = gymnasium.make('SigmaCorvette-v0'); e.reset(seed=0)"
    modules = modules_after(code + "; e.step(e.action_space.sample())")
    assert "vessel_gym" in modules
    assert "pygame" not in modules
    assert "vessel_gym.rendering" not in modules


@pytest.mark.slow
def test_rgb_array_is_a_picture_and_opens_no_display():
    picture = drawn()
    assert picture.shape == (720, 1008, 3)
    assert picture.dtype == np.uint8
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    assert not pygame.display.get_init()


def test_pictures_change_as_the_episode_goes_on():
    assert (drawn(steps=3) != drawn(steps=6)).any()


def test_the_same_seed_gives_the_same_picture_and_another_seed_another():
    assert (drawn(seed=1) == drawn(seed=1)).all()
    assert (drawn(seed=1) != drawn(seed=2)).any()


def test_a_new_episode_forgets_the_old_track():
    env = gym.make("SigmaCorvette-v0", render_mode="rgb_array")
    env.reset(seed=4)
    for _ in range(3):
        env.step(IDLE)
    env.reset(seed=3)
    again = env.render()
    assert (again == drawn(steps=0, seed=3)).all()


def test_drawing_changes_nothing_in_the_episode():
    plain, watched = gym.make("SigmaCorvette-v0"), gym.make("SigmaCorvette-v0", render_mode="rgb_array")
    plain.reset(seed=5), watched.reset(seed=5)
    for _ in range(3):
        expected = plain.step(IDLE)[0]
        watched.render()
        assert (watched.step(IDLE)[0] == expected).all()


@pytest.mark.parametrize("estimator", ["kf", "ekf", "truth", "measurement", "dead-reckoning"])
@pytest.mark.parametrize("env_id", ["SigmaCorvette-v0", "ThesisCorvette-v0"])
def test_every_kind_of_belief_can_be_drawn(env_id, estimator):
    picture = drawn(env_id=env_id, estimator=estimator, disturbance="rough", sensors="degraded", mismatch=0.2)
    assert picture.std() > 1.0


def test_a_window_opens_stays_current_and_closes(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make("SigmaCorvette-v0", render_mode="human")
    env.reset(seed=0)
    env.step(IDLE)
    shown = pygame.surfarray.array3d(pygame.display.get_surface())
    assert shown.std() > 1.0
    assert env.render() is None
    env.close()
    assert not pygame.display.get_init()


def test_a_window_that_the_user_closes_ends_nothing_else(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make("SigmaCorvette-v0", render_mode="human")
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    env.step(IDLE)
    assert not pygame.display.get_init()
    env.step(IDLE)
    env.reset()
    env.close()


def test_without_pygame_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    env = gym.make("SigmaCorvette-v0", render_mode="rgb_array")
    with pytest.raises(gym.error.DependencyNotInstalled, match=r"pip install 'vessel-gym\[render\]'"):
        env.reset(seed=0)


def test_the_commanded_path_closes_a_circle_of_the_commanded_radius():
    task = gym.make("ThesisCorvette-v0").unwrapped.core.task
    radius = 4.0 * task.ship.length
    for side in (1.0, -1.0):
        course = task.course(np.zeros((1, task.uniforms)), {"radius": side * radius})[0]
        points = commanded_path(task, course)
        turn = points[int((task.lead + task.ramp) / task.dt) :]
        centre = turn[:-2].mean(0)
        assert np.hypot(*(turn - centre).T) == pytest.approx(radius, rel=0.03)
        along, across = turn[1] - turn[0], centre - turn[0]
        assert np.sign(along[0] * across[1] - along[1] * across[0]) == side  # starboard is to the right


def test_a_commanded_track_closes_its_circle():
    task = gym.make("SigmaCorvette-v0").unwrapped.core.task
    radius = 4.0 * task.ship.length
    for side in (1.0, -1.0):
        course = task.course(np.zeros((1, task.uniforms)), {"radius": side * radius})[0]
        points = commanded_path(task, course)
        length = np.hypot(*np.diff(points, axis=0).T)
        turn = points[np.concatenate([[0.0], length.cumsum()]) >= task.ship.speed * (task.lead + task.ramp)]
        circle = fit_circle(*turn.T)
        assert circle.radius == pytest.approx(radius, rel=1e-4)
        assert circle.rms < 1e-6 * radius
        assert np.hypot(*(turn[-1] - turn[0])) < 1.5 * length.max()  # once round
        along, across = turn[1] - turn[0], np.array([circle.x, circle.y]) - turn[0]
        assert np.sign(along[0] * across[1] - along[1] * across[0]) == side


def test_the_believed_path_runs_straight_at_the_service_speed_and_uses_a_believed_surge():
    ship = gym.make("SigmaCorvette-v0").unwrapped.core.task.ship
    east = np.tile([0.0, 0.0, 0.5 * np.pi], (5, 1))
    end = believed_path(east, ship, 0.5)[-1]
    assert end == pytest.approx([0.0, 2.0 * ship.speed], rel=1e-6, abs=1e-9)
    slow = np.concatenate([east, np.full((5, 1), 3.0)], -1)
    assert believed_path(slow, ship, 0.5)[-1] == pytest.approx([0.0, 6.0])


def test_sway_to_starboard_of_a_ship_heading_north_goes_east():
    assert path(np.zeros(3), np.zeros(3), np.ones(3), 1.0)[-1] == pytest.approx([0.0, 2.0])


def test_the_plan_view_has_north_up_east_right_equal_axes_and_shows_everything():
    points = np.array([[0.0, 0.0], [900.0, 0.0], [0.0, 300.0]])
    box = Box(10.0, 20.0, 400.0, 500.0)
    view = PlanView(box, points, margin=30.0)
    origin, north, east = view.pixels(points)
    assert north == pytest.approx(origin - [0.0, 900.0 * view.scale])
    assert east == pytest.approx(origin + [300.0 * view.scale, 0.0])
    for x, y in (origin, north, east):
        assert box.left <= x <= box.right
        assert box.top <= y <= box.bottom


def test_a_ship_heading_east_points_right_and_its_starboard_side_is_below():
    view = PlanView(Box(0.0, 0.0, 100.0, 100.0), np.array([[0.0, 0.0], [10.0, 10.0]]), margin=10.0)
    at = np.array([5.0, 5.0])
    bow, starboard = view.body(np.array([[0.5, 0.0], [0.0, 0.5]]), at, 0.5 * np.pi, 20.0) - view.pixels(at)
    assert bow == pytest.approx([10.0, 0.0])
    assert starboard == pytest.approx([0.0, 10.0])


def test_the_hull_is_symmetric_one_length_long_and_as_wide_as_its_beam():
    hull = ship_outline(0.14)
    assert np.ptp(hull[:, 0]) == pytest.approx(1.0)
    assert np.ptp(hull[:, 1]) == pytest.approx(0.14, rel=0.05)
    assert hull[::-1] * [1.0, -1.0] == pytest.approx(hull)


def test_nice_numbers_are_round_and_never_too_small():
    for value in np.geomspace(1e-4, 1e4, 97):
        assert value * 0.999 <= nice(value) <= 2.0 * value
    assert nice(35.0) == 50.0
    assert nice(2.0) == 2.0


def test_a_wedge_is_magnified_only_as_far_as_it_stays_a_wedge():
    assert wedge_factor(0.0) == 1
    assert wedge_factor(1e-4) == 50
    assert wedge_factor(1.5e-3) == 50
    assert wedge_factor(0.02) == 2
    assert wedge_factor(1.0) == 1


def test_a_line_of_one_point_draws_nothing():
    canvas = Canvas(32, 32)
    canvas.clear()
    before = pygame.image.tobytes(canvas.finish(), "RGB")
    canvas.line(np.array([[5.0, 5.0]]), (0, 0, 0))
    canvas.dashes(np.array([[5.0, 5.0]]), (0, 0, 0))
    assert pygame.image.tobytes(canvas.finish(), "RGB") == before
