"""Grades of the sensors of each vehicle, with the suites that choose them and their sources."""

from agents.studies.worlds import system_of
from studies.tables.markdown import WITHOUT, table
from vessel_gym.sensors import Sensor
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
                suites += [suite for suite, chosen in grades.suites.items() if chosen.get(name) == grade]
                label = f"{grade} (`{'`, `'.join(suites)}`)" if suites else grade
                rows.append((name, label, *_figures(sensor), grades.sources[name][grade]))
        heads = ("sensor", "grade", "white noise", "bias; time", "every", "source")
        parts.append(f"### {heading}\n\n{table(heads, rows)}")
    return "\n\n".join(parts)


def _figures(sensor: Sensor) -> tuple[str, str, str]:
    """White noise, bias and the time between two measurements, in units of the channels and s."""
    bias, slow = sensor.bias, WITHOUT
    if bias is not None:
        walk = f"{_listed(bias.pace)}/√s" if any(bias.pace) else WITHOUT
        slow = f"{_listed(bias.start)}; {walk if bias.time is None else f'{bias.time:g} s'}"
    every = "step" if sensor.rate is None else f"{1.0 / sensor.rate:g} s"
    return _listed(sensor.sd), slow, f"{every}, {sensor.dropout:.0%} lost" if sensor.dropout else every


def _listed(values: tuple[float, ...]) -> str:
    """A number for all channels, or one for each."""
    return ", ".join(f"{value:g}" for value in (values[:1] if len(set(values)) == 1 else values))
