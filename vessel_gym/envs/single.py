"""The single face: a `gymnasium.Env` on a batch of one."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from estimators.checks import shown
from vessel_gym.checks import no_others
from vessel_gym.core import Core, whole
from vessel_gym.disturbances import Disturbance
from vessel_gym.envs.shared import action_space, check_render_mode, first_seed, observation_space
from vessel_gym.estimation import EstimatorChoice
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensor
from vessel_gym.system import System


class VesselEnv(gym.Env[np.ndarray, np.ndarray]):
    """An environment whose agent sees what an estimator believes.

    Args:
        estimator: Name of the estimator, None for the environment's default. The filters of the
            `estimators` package, ``truth`` (oracle), ``measurement`` (last reading held), ``dead-reckoning``;
            or your own: an `estimators.Filter` subclass, or a function of the model that returns a filter.
        estimator_options: Options of that estimator, over the environment's tuning; ``model``
            chooses the filter's model where there are several, ``told`` what it is told of the world
            (see `vessel_gym.estimation.Told`), ``late`` what it does with readings that come late: ``"fused"``
            where they belong (the default), ``"as new"`` or ``"discarded"``, ``monitor`` what watches its innovations
            for faults of sensors: ``"cusum"``, ``"chi-square"``, a dictionary of such a ``kind`` and its options, or
            your own (see `vessel_gym.estimation.monitor_of`).
        sensors: ``"clean"``, ``"nominal"`` or ``"degraded"`` (10 % drop-outs, 5 % outliers), or your own: a list of
            `vessel_gym.sensors.Sensor`, to which those of ``system.vehicle.sensors`` may belong.
        disturbance: ``"calm"``, ``"moderate"`` or ``"rough"``, or your own: a `vessel_gym.disturbances.Disturbance`.
        mismatch: Relative spread of the truth's parameters around the filter's, 0 to 0.25.
        observe: ``"mean"``, ``"mean+std"``, either with ``"+alarms"`` (1 for each sensor that the monitor accuses, else
            0), or ``"measurement"`` for raw readings and their mask.
        ends: Who says that a mission is done: ``"belief"`` (what the estimator believes; the default where estimates
            are observed), ``"declaration"`` (the agent, by a last component of its action above 0.5) or ``"task"``
            (the truth: one bit; the default where readings are observed). Limits of the task and time end any.
        guidance: Whether the agent is told how to go on from where it is believed to be or, of readings, from where
            the last of them put it; without, it sees estimates or readings as they are, and the mission. Default:
            where estimates are observed.
        render_mode: ``None``, ``"human"`` or ``"rgb_array"``.
        sensor_faults: What goes wrong with sensors, and when: a list of `vessel_gym.sensor_faults.SensorFault`.

    Where sensors are late (`vessel_gym.sensors.Sensor`), ``info["refused"]`` counts the readings of the episode that
    came too late for the estimator; where they have faults, ``info["sensor_faults"]`` says which act; where a monitor
    watches, ``info["alarms"]`` says which sensors it accuses.

    Raises:
        ValueError: for a name that does not exist, or a filter that the model cannot carry.
        TypeError: for an argument that there is not, an option that the estimator does not have, or sensors or faults
            that are none.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 20}
    system: ClassVar[System]

    def __init__(
        self,
        estimator: EstimatorChoice | None = None,
        estimator_options: dict[str, Any] | None = None,
        sensors: str | Sequence[Sensor] = "nominal",
        disturbance: str | Disturbance = "moderate",
        mismatch: float = 0.0,
        observe: str = "mean",
        ends: str | None = None,
        guidance: bool | None = None,
        render_mode: str | None = None,
        sensor_faults: Sequence[SensorFault] = (),
        **others: Any,
    ) -> None:
        no_others(self.system.name, type(self), others)
        check_render_mode(render_mode, self.metadata)
        self.core = Core(
            self.system, 1, estimator, estimator_options, sensors, disturbance, mismatch, observe, ends, guidance,
            sensor_faults=sensor_faults,
        )  # fmt: skip
        self.observation_space = observation_space(self.core)
        self.action_space = action_space(self.core)
        self._shape = self.action_space.shape
        self.render_mode = render_mode
        self._renderer: Any = None

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Copies and pickles go on as the original would have; the system is the class's."""
        self.__dict__.update(state)
        self.core.attach(self.system)

    @property
    def truth(self) -> np.ndarray:
        """A copy of the true state, for scoring only; components are ``core.truth_names``."""
        return self.core.scored_truth()[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`. ``options`` are the task's."""
        if seed is not None and not whole(seed):
            raise ValueError(f"seed must be a whole number or None, got {shown(seed)}")
        self.core.start(first_seed(self, self.core) if seed is None else seed, options)
        super().reset(seed=None if seed is None else int(seed))
        if self.render_mode is not None:
            self._record(begin=True)
        return self.core.observe()[0], self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance one step; see `gymnasium.Env.step`. Truncation is `gymnasium.wrappers.TimeLimit`'s.

        An episode that has ended stays as it is, with reward 0, until the next reset.
        """
        core = self.core
        if core.end[0]:
            core.checked(action, shape=self._shape)
            return core.observe()[0], 0.0, True, False, self._info()
        reward, end = core.step(action, shape=self._shape)
        if self.render_mode is not None:
            self._record()
        return self.core.observe()[0], float(reward[0]), bool(end[0]), False, self._info()

    def render(self) -> np.ndarray | None:
        """An image ``(height, width, 3)`` of the episode so far; in mode ``"human"``, the window is kept current."""
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode: give one to gym.make")
            return None
        return self._renderer.draw() if self._renderer is not None else None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _info(self) -> dict[str, Any]:
        core, end = self.core, int(self.core.end[0])
        info: dict[str, Any] = {name: values[0].copy() for name, values in core.happened().items()}
        info["healthy"], info["score"] = not core.loop.belief.recovery[0], core.score_of(0)
        info["end"], info["is_success"] = core.task.ends[end], end == core.success
        return info

    def _record(self, begin: bool = False) -> None:
        if self._renderer is None:
            from vessel_gym.rendering import make_renderer

            assert self.render_mode is not None
            self._renderer = make_renderer(self.core, self.render_mode, self.metadata["render_fps"])
        if begin:
            self._renderer.begin()
        self._renderer.record()
        if self.render_mode == "human":
            self._renderer.draw()
