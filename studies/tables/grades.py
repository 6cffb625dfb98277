"""Grades of the sensors of each vehicle, with the suites that choose them and their sources."""

from agents.studies.worlds import system_of
from studies.tables.markdown import WITHOUT, table
from vessel_gym.sensors import Bias, Sensor
from vessel_gym.sensors.grades import NOMINAL, read_grades

VEHICLES = {
    "SigmaCorvette-v0": "Ships",
    "SegorogeniAUV-v0": "Underwater vehicles",
    "PunaUAV-v0": "Small aircraft",
    "ThesisCorvette-v0": "The ship of the thesis",
}
"""Headings by an environment with such a vehicle."""


def sensor_grades() -> str:
    """A table for each kind of vehicle, in Markdown."""
    parts = []
    for env_id, heading in VEHICLES.items():
        grades, rows = read_grades(system_of(env_id)), []
        for name, of in grades.sensors.items():
            for grade, sensor in of.items():
                suites = [NOMINAL] if grade == NOMINAL else []
                suites += [
                    suite for suite, chosen in grades.suites.items() if chosen.get(name) == grade
                ]
                label = f"{grade} (`{'`, `'.join(suites)}`)" if suites else grade
                figures = _figures(sensor, grades.assumed[name][grade])
                rows.append((name, label, *figures, grades.sources[name][grade]))
        heads = (
            "sensor",
            "grade",
            "white noise",
            "slow error; its time; constant error",
            "every",
            "source",
        )
        parts.append(f"### {heading}\n\n{table(heads, rows)}")
    return "\n\n".join(parts)


def _figures(sensor: Sensor, assumed: tuple[str, ...]) -> tuple[str, str, str]:
    """White noise, bias and the time between two measurements, in units of the channels and s.

    Args:
        sensor: A sensor in a grade.
        assumed: Keys of the figures that no document states.
    """

    def marked(text: str, key: str) -> str:
        return f"{text} (assumed)" if key in assumed else text

    every = "step" if sensor.rate is None else f"{1.0 / sensor.rate:g} s"
    losses = [marked(f"{sensor.dropout:.0%} lost", "dropout")] if sensor.dropout else []
    slow = (
        WITHOUT if sensor.bias is None else "; ".join(marked(*part) for part in _bias(sensor.bias))
    )
    return marked(_listed(sensor.sd), "sd"), slow, ", ".join((marked(every, "rate"), *losses))


def _bias(bias: Bias) -> list[tuple[str, str]]:
    """Parts of a bias, and the key of each."""
    if bias.time is None and not any(bias.pace):
        return [(f"constant {_listed(bias.start)}", "start")]
    parts = [(_listed(bias.start), "start")]
    if bias.time is None:
        return [*parts, (f"{_listed(bias.pace)}/√s", "pace")]
    constants = [(f"constant {_listed(bias.constant)}", "constant")] if any(bias.constant) else []
    return [*parts, (f"{bias.time:g} s", "time"), *constants]


def _listed(values: tuple[float, ...]) -> str:
    """A number for all channels, or one for each."""
    return ", ".join(f"{value:g}" for value in (values[:1] if len(set(values)) == 1 else values))
