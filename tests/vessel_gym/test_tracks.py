"""Paths of ships on a turning circle."""

import gymnasium as gym
import numpy as np

import vessel_gym  # noqa: F401


def test_the_commanded_path_of_a_trial_is_that_of_the_ship_in_it():
    task = gym.make("ThesisCorvette-v0").unwrapped.core.config.system.task
    points = task.workspace(task.scenario(np.zeros((1, 0)), {})[0]).path[:, :2]
    np.testing.assert_array_equal(points, task.record[:195, :2])


def test_a_commanded_track_closes_its_circle():
    task = gym.make("SigmaCorvette-v0").unwrapped.core.config.system.task
    radius = 4.0 * task.ship.length
    for side in (1.0, -1.0):
        scenario = task.scenario(np.zeros((1, task.uniforms)), {"radius": side * radius})[0]
        points = task.workspace(scenario).path[:, :2]
        length = np.hypot(*np.diff(points, axis=0).T)
        turn = points[
            np.concatenate([[0.0], length.cumsum()]) >= task.ship.speed * (task.lead + task.ramp)
        ]
        columns = np.column_stack([2.0 * turn, np.ones(len(turn))])
        centre = np.linalg.lstsq(columns, (turn**2).sum(1))[0][
            :2
        ]  # of the circle through the points
        np.testing.assert_allclose(np.hypot(*(turn - centre).T), radius, rtol=1e-4)
        assert np.hypot(*(turn[-1] - turn[0])) < 1.5 * length.max()  # once round
        along, across = turn[1] - turn[0], centre - turn[0]
        assert np.sign(along[0] * across[1] - along[1] * across[0]) == side
