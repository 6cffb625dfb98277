"""Text of docs/overturn.md: the corvette's filters compared where one assumption of her studies is another."""

from dataclasses import replace
from itertools import product
from textwrap import fill
from typing import Any

import gymnasium as gym

from agents.page import listed
from studies.tables.arms import Arm
from studies.tables.markdown import interval, table
from studies.tables.suites import HELD, INFORMED, PLAIN, Column
from vessel_gym.envs import VesselVectorEnv
from vessel_gym.envs.ship import SIGMA_CORVETTE
from vessel_gym.tasks.circle_track import CircleTrack

CORVETTE: Any = SIGMA_CORVETTE
OURS, ROBUST, ENSEMBLE = "kf-umv-ui", "huber-kf", "enkf-sr"
CONSTANTS = {
    "DISTANCE_TOLERANCE": "tolerance off the track",
    "COURSE_TOLERANCE": "tolerance of the course",
    "RATE_TOLERANCE": "tolerance of the yaw rate",
    "RUDDER_PRICE": "price of steering",
    "ENOUGH": "progress that is enough",
}
"""Constants of the score that are halved and doubled."""


def variations() -> dict[str, dict[str, Any]]:
    """Arguments of `flown` by condition; the first is the world of the studies."""
    return {
        "as in the studies": {},
        "calm sea": {"disturbance": "calm", "sea": "calm"},
        "rough sea": {"disturbance": "rough", "sea": "rough"},
        "waves assumed calm": {"sea": "calm"},
        "waves assumed rough": {"sea": "rough"},
        "`budget` sensors": {"sensors": "budget"},
        "`denied` sensors": {"sensors": "denied"},
        "a tenth of measurements lost": {
            "sensors": [replace(each, dropout=0.1) for each in CORVETTE.vehicle.sensors]
        },
        "`degraded` sensors": {"sensors": "degraded"},
        "model 10 % off": {"mismatch": 0.1},
        "controller `lqg`": {"agent": "lqg"},
        "controller `pid`": {"agent": "pid"},
        "half the weight of the course": {"COURSE_SHARE": 0.3 / 0.7},
        "twice the weight of the course": {"COURSE_SHARE": 1.2 / 1.6},
        **{
            f"{word} the {what}": {name: factor * getattr(CircleTrack, name)}
            for (name, what), (word, factor) in product(
                CONSTANTS.items(), (("half", 0.5), ("twice", 2.0))
            )
        },
    }


def flown(condition: str, sea: str = "moderate", **changes: Any) -> Column:
    """Scores of the corvette where something differs from her studies.

    Args:
        condition: A name for it.
        sea: The sea whose waves `INFORMED` assumes.
        changes: Constants of the score, in capitals, and arguments of `Arm.fly`.
    """
    score = {name: changes.pop(name) for name in list(changes) if name.isupper()}
    task: Any = type("Scored", (CircleTrack,), score, verified=True)
    env: Any = type(
        "Env", (VesselVectorEnv,), {"system": replace(CORVETTE, task=task(CORVETTE.vehicle.ship))}
    )
    env_id = f"Scored{len(gym.registry)}-v0"
    gym.register(env_id, vector_entry_point=env, max_episode_steps=CORVETTE.task.horizon)
    assumed: dict[str, Any] = {INFORMED: {"assume": {"disturbance": sea, "as": "states"}}}
    assumed[ROBUST] = {"model": "nonlinear"}
    arms = (
        Arm(of, of.split()[0], assumed.get(of, {}))
        for of in (OURS, INFORMED, PLAIN, ROBUST, ENSEMBLE, HELD)
    )
    return Column(
        "",
        condition,
        {arm.label: arm.fly(env_id, **changes).score[None] for arm in arms},
        comparisons=1,
    )


def named(names: list[str]) -> str:
    """Their number, and they themselves."""
    return f"{len(names)} ({listed(names)})" if names else "none"


def robustness(what: str, gaps: dict[str, Any]) -> str:
    """Sentence on the worlds in which a difference has the sign of the first."""
    (_, first), *others = gaps.items()
    flips = [name for name, of in others if of.excludes_zero and of.mean * first.mean < 0.0]
    unsure = [name for name, of in others if not of.excludes_zero]
    text = f"Of {len(others)} variations, the sign of {what} holds beyond chance in"
    text += f" {len(others) - len(flips) - len(unsure)}, flips in {named(flips)}"
    return f"{text} and is not decided in {named(unsure)}."


def overturn() -> str:
    """Sentences on the claims that survive all variations, and the table that they are taken from."""
    columns = [flown(name, **changes) for name, changes in variations().items()]
    best = columns[0].best()
    others = [f"{at.condition}: `{at.best()}`" for at in columns if at.best() != best]
    apart = max(abs(at.gap(ENSEMBLE, PLAIN).mean) for at in columns)
    text = (
        f"`{best}` has the highest mean, but in {named(others)}. Means of `{ENSEMBLE}` and"
        f" `{PLAIN}` differ by at "
    )
    text += f"most {apart:.4f}."
    heads, rows = ["", "best filter"], [[at.condition, f"`{at.best()}`"] for at in columns]
    for one, other in (("", HELD), (OURS, PLAIN), (INFORMED, OURS), (ROBUST, PLAIN)):
        gaps = {at.condition: at.gap(one or at.best(), other) for at in columns}
        heads.append(f"`{one}` − `{other}`" if one else f"best − `{other}`")
        rows = [[*row, interval(gaps[row[0]])] for row in rows]
        text += f" {robustness(heads[-1], gaps)}"
    return f"{fill(text, 140, break_on_hyphens=False)}\n\n{table(heads, rows)}"
