"""Table of docs/environments/sigma-channel.md: what estimates are worth in bow and quartering seas."""

from studies.tables.arms import Arm
from studies.tables.markdown import shown, table

ENVIRONMENT = "SigmaChannel-v0"
SEAS = ("moderate", "rough", "moderate quartering", "rough quartering")


def arms(sea: str) -> tuple[Arm, ...]:
    """The truth, filters by what they assume of waves, and measurements as they are."""
    waves = {"assume": {"disturbance": sea, "as": "states"}}
    return (
        Arm("`truth`", "truth"),
        Arm("`kf-umv-ui`", "kf-umv-ui"),
        Arm("`ekf` assuming waves", "ekf", waves),
        Arm("`ekf`", "ekf"),
        Arm("`measurement`", "measurement"),
    )


def channel() -> str:
    """Scores and steering travel in every sea."""
    flown = {sea: [arm.scores(ENVIRONMENT, disturbance=sea) for arm in arms(sea)] for sea in SEAS}
    rows = [
        (f"{sea}, {words}", *(shown(of[key], decimals) for of in flown[sea]))
        for key, words, decimals in (
            ("score", "score", 3),
            ("steering_travel", "rudder travel [deg/min]", 0),
        )
        for sea in SEAS
    ]
    return table(("", *(arm.label for arm in arms(SEAS[0]))), rows)
