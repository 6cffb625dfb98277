"""Hold a turning circle as a place on the map: straight on, into the turn and round, whatever sets the ship."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators import Gaussian, wrap
from estimators.checks import writable
from estimators.compiled import inlined, rowwise, sincos
from vessel_gym.sensors import Sensors
from vessel_gym.system import Estimate
from vessel_gym.tasks.turning_circle import TurningCircle, wrapped
from vessel_gym.vehicles.corvette import steady_turns

# Columns of a course,
HEADING, RATE, CURVATURE, SPEED = range(4)
# and of a reference.
WANTED, RATE_NOW, RATE_AHEAD, RATE_FINALLY, OFF, TRACK, SURGE, BELIEVED = range(8)
_ABSURD = 1e9  # m: where a belief has run away, squares of places are still finite


@inlined
def _ramp(length: float, total: float, curvature: float) -> tuple[float, float, float]:
    """Place and direction on a clothoid whose curvature rises to ``curvature`` over its ``total`` length.

    Series of the Fresnel integrals: to 1e-5 of the length, as it turns by 0.6 rad at most.
    """
    angle = 0.5 * curvature * length * length / total
    square = angle * angle
    forward = length * (1.0 - square * (1.0 / 10.0 - square * (1.0 / 216.0 - square / 9360.0)))
    return forward, length * angle * (1.0 / 3.0 - square * (1.0 / 42.0 - square / 1320.0)), angle


@inlined
def _sailed(step: int, dt: float, lead: float, ramp: float, service: float, speed: float) -> float:
    """How far [m] a ship has come that keeps to its track, and to its speed, which falls over the ramp."""
    elapsed = max(step, 0) * dt
    turning = min(max(elapsed - lead, 0.0), ramp)
    return elapsed * service + (speed - service) * (0.5 * turning * turning / ramp + max(elapsed - lead - ramp, 0.0))


@inlined
def nearest(
    x: float, y: float, heading: float, curvature: float, lead: float, ramp: float, guess: float
) -> tuple[float, float, float, float]:
    """The nearest point of a track: how far along, how far the place is to starboard of it, direction, curvature.

    Args:
        x: The place, north of where the track begins [m],
        y: and east.
        heading: In which the track begins [rad].
        curvature: Of the circle [1/m], positive to starboard.
        lead: Length of the straight [m],
        ramp: and of the clothoid behind it.
        guess: How far along the place may be [m]: it tells one round from the next, and the way in from the rounds.
    """
    sin, cos = sincos(heading)
    ahead, aside = x * cos + y * sin, y * cos - x * sin
    forward, sideways, turned = _ramp(ramp, ramp, curvature)
    sin, cos = sincos(turned)
    middle, off = lead + forward - sin / curvature, sideways + cos / curvature
    begin = lead + ramp
    # On the circle: the direction there, next to that of the guess.
    direction = np.arctan2((ahead - middle) * curvature, (off - aside) * curvature)
    expected = turned + curvature * (guess - begin)
    direction = expected + wrapped(direction - expected)
    along = begin + (direction - turned) / curvature
    if along >= begin:
        radius = np.sqrt((ahead - middle) ** 2 + (aside - off) ** 2)
        distance = 1.0 / abs(curvature) - radius
        return along, distance if curvature > 0.0 else -distance, heading + direction, curvature
    if ahead <= lead:
        return ahead, aside, heading, 0.0
    length, distance, direction = min(ahead - lead, ramp), 0.0, 0.0
    for _ in range(4):
        forward, sideways, direction = _ramp(length, ramp, curvature)
        sin, cos = sincos(direction)
        missing = (ahead - lead - forward) * cos + (aside - sideways) * sin
        distance = (aside - sideways) * cos - (ahead - lead - forward) * sin
        step = missing / max(1.0 - distance * curvature * length / ramp, 0.2)
        length = min(max(length + step, 0.0), ramp)
    return lead + length, distance, heading + direction, curvature * length / ramp


@inlined
def _between(value: float, highest: float, values: np.ndarray) -> float:
    """Of ``values`` at equal steps from 0 to ``highest``."""
    at = min(abs(value) / highest, 1.0) * (len(values) - 1)
    i = min(int(at), len(values) - 2)
    return values[i] + (at - i) * (values[i + 1] - values[i])


@rowwise("void(f8[:,:],f8[:],f8[::1],f8[:,::1],f8[::1])")
def track_places(
    course: np.ndarray, along: np.ndarray, timing: np.ndarray, place: np.ndarray, direction: np.ndarray
) -> None:
    """Where tracks are ``(B, 2)``, so far along, and where they lead ``(B,)``: the last two."""
    lead = timing[1] * timing[4]
    for row in range(len(course)):
        curvature, ramp = course[row, 2], 0.5 * timing[2] * (timing[4] + course[row, 3])
        length = min(max(along[row] - lead, 0.0), ramp)
        forward, sideways, turned = _ramp(length, ramp, curvature)
        forward += min(along[row], lead)
        rest = max(along[row] - lead - ramp, 0.0)
        if rest > 0.0:
            sin, cos = sincos(turned)
            sin_after, cos_after = sincos(turned + rest * curvature)
            forward += (sin_after - sin) / curvature
            sideways += (cos - cos_after) / curvature
            turned += rest * curvature
        sin, cos = sincos(course[row, 0])
        place[row, 0] = forward * cos - sideways * sin
        place[row, 1] = forward * sin + sideways * cos
        direction[row] = course[row, 0] + turned


@rowwise("void(f8[:,:],i8[:],f8[::1],f8[::1])")
def track_sailed(course: np.ndarray, step: np.ndarray, timing: np.ndarray, along: np.ndarray) -> None:
    """How far [m] ships have come at a step that keep to their tracks ``(B,)``."""
    for row in range(len(along)):
        along[row] = _sailed(step[row], timing[0], timing[1], timing[2], timing[4], course[row, 3])


@rowwise("void(f8[:,:],i8[:],f8[:,:],f8[::1],f8[:,::1],f8[:,::1])")
def track_reference(
    course: np.ndarray, step: np.ndarray, state: np.ndarray, timing: np.ndarray, turns: np.ndarray, out: np.ndarray
) -> None:
    """What is commanded where ships are believed to be ``(B, 8)``.

    Timing is (time step, lead, ramp, preview) in s and the service speed; ``turns (3, k)`` are yaw rates, speeds and
    sway velocities of steady turns.
    """
    dt, lead, ramp, preview, service = timing
    highest = turns[0, -1]
    for row in range(len(out)):
        heading, rate, curvature, speed = course[row, 0], course[row, 1], course[row, 2], course[row, 3]
        straight, way_in = lead * service, 0.5 * ramp * (service + speed)
        guess = _sailed(step[row], dt, lead, ramp, service, speed)
        x, y = min(max(state[row, 0], -_ABSURD), _ABSURD), min(max(state[row, 1], -_ABSURD), _ABSURD)
        along, off, direction, bent = nearest(x, y, heading, curvature, straight, way_in, guess)
        share = bent / curvature
        now = bent * (service + share * (speed - service))
        then = min(max((along + preview * (service + share * (speed - service)) - straight) / way_in, 0.0), 1.0)
        surge = _between(now, highest, turns[1])
        sway = _between(now, highest, turns[2])
        out[row, 0] = direction - np.arctan2(sway if now >= 0.0 else -sway, surge)
        out[row, 1] = now
        out[row, 2] = then * curvature * (service + then * (speed - service))
        out[row, 3] = rate
        out[row, 4] = off
        out[row, 5] = direction
        out[row, 6] = surge
        out[row, 7] = state[row, 2]


@rowwise("void(f8[:,:],f8[:,:],f8[:,:],f8[::1],f8[:,:],f8[::1],i8[::1],f8[:,::1])")
def track_score(
    truth: np.ndarray, current: np.ndarray, action: np.ndarray, kernel: np.ndarray, tally: np.ndarray,
    reward: np.ndarray, lost: np.ndarray, after: np.ndarray,
) -> None:  # fmt: skip
    """Reward, whether the turn is lost, and the next tally; ``kernel`` is as `CircleTrack` makes it."""
    distance, angle, rate_share, helm, far, lead, ramp, service, dt, share = kernel
    for row in range(len(reward)):
        heading, rate, curvature, speed = tally[row, 0], tally[row, 1], tally[row, 2], tally[row, 3]
        psi, u, v, r = truth[row, 2], truth[row, 3], truth[row, 4], truth[row, 5]
        straight, way_in = lead * service, 0.5 * ramp * (service + speed)
        along, off, direction, bent = nearest(
            truth[row, 0], truth[row, 1], heading, curvature, straight, way_in, tally[row, 4]
        )
        sin, cos = sincos(psi)
        north, east = u * cos - v * sin + current[row, 0], u * sin + v * cos + current[row, 1]
        aside = wrapped(np.arctan2(east, north) - direction)
        turning = (r - bent * np.sqrt(u * u + v * v)) / rate
        farthest = max(tally[row, 5], along)
        nominal = dt * (service + bent / curvature * (speed - service))
        progress = min((farthest - tally[row, 5]) / (share * nominal), 1.0)
        value = 0.5 / (1.0 + (off / distance) ** 2) + 0.3 / (1.0 + (aside / angle) ** 2)
        value += 0.2 / (1.0 + (turning / rate_share) ** 2)
        reward[row] = value * (1.0 - helm * action[row, 0] ** 2) * progress
        lost[row] = abs(off) > far
        for i in range(4):
            after[row, i] = tally[row, i]
        after[row, 4], after[row, 5] = along, farthest


@rowwise("void(f8[:,::1],f8[::1],f8[:,:],f8[::1])")
def tracked(place: np.ndarray, kernel: np.ndarray, tally: np.ndarray, off: np.ndarray) -> None:
    """How far ships are off their tracks ``(B,)``; the tally goes on."""
    lead, ramp, service = kernel[5], kernel[6], kernel[7]
    for row in range(len(off)):
        along, off[row], _, _ = nearest(
            place[row, 0], place[row, 1], tally[row, 0], tally[row, 2], lead * service,
            0.5 * ramp * (service + tally[row, 3]), tally[row, 4],
        )  # fmt: skip
        tally[row, 4] = along


@rowwise("void(f8[:,:],f8[:,:],f8[:,:],f8[:,:],f8[:,:],f8[::1],f8[:,::1])")
def track_view(
    mean: np.ndarray, flow: np.ndarray, d: np.ndarray, reference: np.ndarray, rudder: np.ndarray, gains: np.ndarray,
    out: np.ndarray,
) -> None:  # fmt: skip
    """What is seen of a turn ``(B, 11)``, see `CircleTrack.observe`."""
    for row in range(len(out)):
        sin, cos = sincos(reference[row, 5])
        along = flow[row, 0] * cos + flow[row, 1] * sin
        across = flow[row, 1] * cos - flow[row, 0] * sin
        surge = reference[row, 6]
        crab = np.arcsin(min(max(across / surge, -0.5), 0.5))
        out[row, 0] = wrapped(reference[row, 0] - crab - mean[row, 2]) * gains[0]
        out[row, 1] = (reference[row, 1] * (1.0 + 2.0 * along / surge) - mean[row, 5]) * gains[1]
        out[row, 2] = mean[row, 4] * gains[2]
        out[row, 3] = d[row, 0] * gains[3]
        out[row, 4] = rudder[row, 0] * gains[4]
        out[row, 5] = reference[row, 1] * gains[5]
        out[row, 6] = reference[row, 2] * gains[6]
        out[row, 7] = reference[row, 4] * gains[7]
        out[row, 8] = (mean[row, 3] - surge) * gains[8]
        out[row, 9] = along * gains[9]
        out[row, 10] = across * gains[10]


@dataclass(frozen=True)
class CircleTrack(TurningCircle):
    """The commanded track leads into a circle: a straight, a clothoid, rounds; a current does not shift it.

    It begins where the ship is put. A course (what is drawn at reset) is ``(initial heading [rad], yaw rate of the
    turn [rad/s], its curvature [1/m], its speed [m/s])``; a reference is that of the track's point nearest to where
    the ship is believed to be: ``(heading to steer in still water [rad], yaw rate now, yaw rate PREVIEW seconds ahead,
    final yaw rate, distance to starboard of the track [m], its direction [rad], surge of the steady turn [m/s],
    believed heading [rad])``.
    """

    commanding: ClassVar[slice | list[int]] = [RATE_NOW, BELIEVED]

    def course(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """Draw courses ``(B, 4)``, see `TurningCircle.course`."""
        turn = super().course(uniforms, options)
        course = np.empty((len(turn), 4))
        course[:, :2] = turn
        course[:, CURVATURE] = np.copysign(np.interp(np.abs(turn[:, 1]), *self._turns[::-1]), turn[:, 1])
        course[:, SPEED] = turn[:, 1] / course[:, CURVATURE]
        return course

    def prior(self, course: np.ndarray) -> Gaussian:
        """What is known of (x, y, psi, u, v, r) at the start: mean ``(B, 6)`` and covariance ``(6, 6)``."""
        mean = np.zeros((len(course), 6))
        mean[:, 2], mean[:, 3] = course[:, HEADING], self.ship.speed
        return self._spread.about(mean)

    @cached_property
    def _spread(self) -> Gaussian:
        return Gaussian(np.zeros(6), np.diag([2.0, 2.0, 0.03, 0.2, 0.2, 0.002]) ** 2)

    def reference(self, course: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """What is commanded ``(B, 8)`` at a step ``(B,)`` to a ship in a state ``(B, 6)``, as in the prior."""
        reference = np.empty((len(course), 8))
        track_reference(course, step, writable(state), self._timing, self._table, reference)
        return reference

    @cached_property
    def _timing(self) -> np.ndarray:
        return np.array([self.dt, self.lead, self.ramp, self.preview, self.ship.speed])

    @cached_property
    def _table(self) -> np.ndarray:
        turns = steady_turns(self.ship)
        return np.array([turns.yaw_rate, turns.speed, turns.sway])

    def nominal(self, course: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Where a ship that keeps to the track and its speed would be: states ``(B, 6)`` as in the prior."""
        along, state = np.empty(len(course)), np.zeros((len(course), 6))
        track_sailed(course, step, self._timing, along)
        state[:, :2], state[:, 2] = self.track(course, along)
        return state

    def track(self, course: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places ``(B, 2)`` north and east [m], and directions ``(B,)``, so far ``along (B,)`` [m] the tracks."""
        place, direction = np.empty((len(course), 2)), np.empty(len(course))
        track_places(course, along, self._timing, place, direction)
        return place, direction

    def course_of(self, reference: np.ndarray) -> np.ndarray:
        """The courses ``(B, 4)`` to which references at their start ``(B, 8)`` belong."""
        rate = reference[:, RATE_FINALLY]
        curvature = np.copysign(np.interp(np.abs(rate), *self._turns[::-1]), rate)
        return np.stack([reference[:, TRACK], rate, curvature, rate / curvature], -1)

    def off_track(self, course: np.ndarray, place: np.ndarray) -> np.ndarray:
        """How far to starboard of their tracks ships have been ``(T, B)`` [m] on their way ``(T, B, 2)``."""
        off = np.empty(place.shape[:-1])
        tally = self.begin(np.zeros((len(course), 8)), course)
        for now, at in zip(off, place, strict=True):
            tracked(np.ascontiguousarray(at), self._kernel, tally, now)
        return off

    def commanded(self, course: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The commanded yaw rate and heading of who keeps to the track ``(B, 2)``."""
        return self.reference(course, step, self.nominal(course, step))[:, self.commanding]

    # --- what the agent sees ----------------------------------------------------------------------

    TRACK_SCALE = 20.0  # m
    SPEED_SCALE = 2.0  # m/s
    FLOW_SCALE = 1.0  # m/s

    def sizes(self, readings: int, states: int) -> dict[str, int]:
        """The lengths of the parts of observations."""
        return {"guided": 11, "unguided": 12, "std": 6, "readings": 2 * readings, "mission": 2}

    @cached_property
    def _view_gains(self) -> np.ndarray:
        scales = self.TRACK_SCALE, self.SPEED_SCALE, self.FLOW_SCALE, self.FLOW_SCALE
        return np.concatenate([self._mean_gains, 1.0 / np.array(scales)])

    def observe(self, estimate: Estimate, reference: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """The observation ``(B, 11)`` of mode ``"mean"``, before clipping.

        What is missing to the heading that holds the track in the believed current, and to the yaw rate; sway, d,
        rudder, the yaw rate commanded now and ahead, distance to starboard of the track, surge above that of the steady
        turn, and the current along the track and to starboard.
        """
        mean, d = writable(estimate.state), estimate.input_mean
        d = np.zeros((len(mean), 1)) if d is None else writable(d)
        observation = np.empty((len(mean), 11))
        track_view(mean, writable(estimate.flow), d, reference, actuators, self._view_gains, observation)
        return observation

    def observe_state(self, estimate: Estimate, course: np.ndarray) -> np.ndarray:
        """The estimate as it is ``(B, 10)``, in the frame of the first heading: no guidance.

        Place, sine and cosine of the heading, surge above service speed, sway, yaw rate, d and current.
        """
        _, _, psi, u, v, r = estimate.state.T
        d = np.zeros(len(v)) if estimate.input_mean is None else estimate.input_mean[:, 0]
        turned, surge = psi - course[:, HEADING], (u - self.ship.speed) / self.SPEED_SCALE
        own = np.sin(turned), np.cos(turned), surge, v / self.SWAY_SCALE, r / self.command_scale, d / self.INPUT_SCALE
        place = _framed(course, estimate.state[:, :2]) / self._place_scale
        current = _framed(course, estimate.flow[:, :2]) / self.FLOW_SCALE
        return np.concatenate([place, np.stack(own, -1), current], -1)

    @property
    def _place_scale(self) -> float:
        """Of a place on the map [m]."""
        return 2.0 * self.ship.length

    def observe_std(self, estimate: Estimate) -> np.ndarray:
        """The standard deviations ``(B, 6)`` of place (5 m), heading, sway, yaw rate and unknown input, scaled."""
        assert estimate.sd is not None
        sd = np.zeros((len(estimate.sd), 6))
        sd[:, :5] = estimate.sd[:, [0, 1, 2, 4, 5]]
        if estimate.input_sd is not None:
            sd[:, 5] = estimate.input_sd[:, 0]
        return sd / [5.0, 5.0, self.HEADING_SCALE, self.SWAY_SCALE, self.rate_scale, self.INPUT_SCALE]

    def observe_readings(
        self, sensors: Sensors, readings: np.ndarray, available: np.ndarray, course: np.ndarray, step: np.ndarray
    ) -> np.ndarray:
        """Raw readings ``(B, 2 p)``: readings and mask, no filter; heading and place from the first heading on."""
        shown, gives = readings / sensors.scale, list(sensors.gives)
        for channel, state in enumerate(gives):
            if state == "psi":
                shown[:, channel] = wrap(readings[:, channel] - course[:, HEADING])
        if "x" in gives and "y" in gives:
            place = [gives.index("x"), gives.index("y")]
            shown[:, place] = _framed(course, readings[:, place]) / self._place_scale
        return np.concatenate([np.where(available, shown, 0.0), available], -1)

    def observe_mission(self, course: np.ndarray, step: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """The rudder and the yaw rate of the turn ``(B, 2)``."""
        return np.concatenate([actuators, course[:, [RATE]]], -1) / self._known_scales[:2]

    # --- how it is scored -------------------------------------------------------------------------

    DISTANCE_TOLERANCE = 10.0  # m from the track, that halves its share of the reward
    COURSE_TOLERANCE = 0.05  # rad between the track and the course over ground, likewise
    FAR = 3.0  # ship lengths from the track, at which the turn is lost
    ENOUGH = 0.85  # of the nominal progress that counts as all

    @cached_property
    def _kernel(self) -> np.ndarray:
        return np.array([
            self.DISTANCE_TOLERANCE, self.COURSE_TOLERANCE, self.RATE_TOLERANCE, self.HELM_COST,
            self.FAR * self.ship.length, self.lead, self.ramp, self.ship.speed, self.dt, self.ENOUGH,
        ])  # fmt: skip

    def begin(self, state: np.ndarray, course: np.ndarray) -> np.ndarray:
        """The course, how far along the ship is, and how far it has been: ``(B, 6)``."""
        return np.concatenate([course, np.zeros((len(course), 2))], -1)

    def score(
        self, state: np.ndarray, forcing: np.ndarray, reference: np.ndarray, over: np.ndarray, actuators: np.ndarray,
        action: np.ndarray, tally: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Reward in [0, 1], end of the episode and tally, ``(B,)`` and ``(B, 6)``: the only reader of truth.

        What counts is where the true ship is, which way it goes over ground, and that it goes on along the track:
        neither loitering nor ending early pays.
        """
        reward, lost, after = np.empty(len(state)), np.empty(len(state), int), np.empty(tally.shape)
        track_score(state, forcing[:, 1:3], action, self._kernel, tally, reward, lost, after)
        return reward, lost, after


def _framed(course: np.ndarray, place: np.ndarray) -> np.ndarray:
    """North and east ``(B, 2)`` as ahead and to starboard of the first heading."""
    sin, cos = np.sin(course[:, HEADING]), np.cos(course[:, HEADING])
    return np.stack([place[:, 0] * cos + place[:, 1] * sin, place[:, 1] * cos - place[:, 0] * sin], -1)
