"""Base class of disturbances.

A disturbance is made from white noise. It has a state z of its own and acts on a vehicle through
components of its exogenous input. Your own disturbance is a subclass of `Disturbance`:
docs/own-disturbance.md.
"""

import numpy as np

from estimators.engine import compiled
from vessel_gym.processes import Process


@compiled
class Disturbance:
    """Base class of disturbances that act on a vehicle over a step.

    The state moves as ``z+ = transition z + root n``. Over a step the vehicle receives ``effect(z,
    state)`` and, for the increments in ``white_increments``, the product ``white n'``. n and n' are
    standard normal.

    Attributes:
        names: Components of z.
        forces: Components of the vehicle's exogenous input (see `vessel_gym.system.Vehicle`) that
            `effect` returns, in order.
        process: Process of z; its ``start_cov`` is the covariance of z at the start.
        white_increments: Increments of the vehicle that are white noise.
        white: Root ``(len(white_increments), m)`` of the covariance of ``white_increments``.
        assumed_as: Default way in which filters model the disturbance, see
            `vessel_gym.models.assumed.ASSUMED`.
        inputs: Components of the unknown input d, where filters assume one: names from ``forces``
            or ``white_increments``. None: all of these that are increments of the vehicle.
        input_sd: Standard deviations of d that filters assume where no measurement shows d. None:
            derived from `process` and ``white``.
        scale: An agent that observes standard deviations receives those of z divided by these
            numbers. None: divided by the standard deviations at the start.
        averaged: Names from ``forces`` that are means over the coming step, which no sensor may
            read.
        dt: Time step [s] for which the disturbance was made; None: any.
        believed: Disturbance that filters assume unless the user names another; None: this one.
        modelled: Where a filter assumes this disturbance, ``modelled`` takes its place. None: no
            replacement.
        uniforms: Number of uniform random numbers that `draw` receives in an episode.
    """

    names: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()
    process: Process = Process.joined()
    white_increments: tuple[str, ...] = ()
    white: np.ndarray = np.zeros((0, 0))
    assumed_as: str = "states"
    inputs: tuple[str, ...] | None = None
    input_sd: tuple[float, ...] | None = None
    scale: tuple[float, ...] | None = None
    averaged: tuple[str, ...] = ()
    dt: float | None = None
    believed: "Disturbance | None" = None
    modelled: "Disturbance | None" = None
    uniforms: int = 0

    @compiled
    def met(self, z: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """State z ``(..., k)`` after the vehicle moved from ``before`` to ``after``; default: z."""
        return z

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants ``(..., e)`` of an episode, from ``uniforms (..., u)`` in [0, 1]."""
        return uniforms

    def effect_at(
        self, drawn: np.ndarray, time: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Effect at ``time (...)`` [s] of an episode with constants; default: `effect`.

        The argument ``drawn (..., e)`` has the constants.
        """
        return self.effect(z, state)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Effect ``(..., len(forces))`` of z on a vehicle in a state; default: z.

        An override may be any function of both arguments.

        Args:
            z: ``(..., k)`` state of the disturbance.
            state: ``(..., n)`` state of the vehicle.
        """
        return z
