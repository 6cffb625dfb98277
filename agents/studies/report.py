"""The report of a study: one page that needs nothing but itself, and every word about numbers computed."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import vessel_gym
from agents.files import replacing
from agents.jobs import Job
from agents.page import Block, Bullets, Page, Prose, Section, listed, many, write
from agents.studies.answer import answer, summary
from agents.studies.cost import cost
from agents.studies.examples import examples
from agents.studies.learning import learning
from agents.studies.measures import consistency, episodes, measures
from agents.studies.plan import Flight
from agents.studies.ranking import costs, price, ranking, tails
from agents.studies.results import Results
from agents.studies.robustness import AXES, robustness
from agents.studies.settings import settings
from agents.studies.wording import grouped, paragraphs
from vessel_gym.extras import require


def page(results: Results, out: Path) -> Page:
    """The report of a study as data, as far as it is flown; the folder is for the command that runs it again."""
    study = results.plan.study
    sections = [
        ranking(results),
        tails(results),
        price(results),
        costs(results),
        learning(results),
        consistency(results),
        robustness(results),
        cost(results),
        episodes(results),
        measures(results),
        _missing(results),
        _limits(results),
        settings(results, out),
    ]
    return Page(
        study.title,
        f"vessel-gym {vessel_gym.__version__}: {many(len(study.environments), 'environment')}, "
        f"{many(len(study.estimators), 'estimator')}, {many(len(study.agents), 'agent')}, "
        f"{many(len(study.conditions), 'condition')}, {study.episodes} paired evaluation seeds"
        + (
            f", {many(study.training_seeds, 'training run')} of each learned agent"
            if study.learned
            else ""
        ),
        answer(results),
        [section for section in sections if section.blocks],
        summary(results),
    )


def write_report(results: Results, out: Path) -> Path:
    """Write ``report.html``, ``answer.md``, ``episodes.csv`` and ``tables/``, each file whole or not at all.

    Arguments are those of `page`. Returns the page.

    Raises:
        OSError: if a file cannot be written.
        ModuleNotFoundError: without Matplotlib or Jinja.
    """
    require("matplotlib", "jinja2")
    report = page(results, out)
    files = {
        out / "episodes.csv": results.episodes_csv(),
        out / "answer.md": "\n".join(report.answer) + "\n",
    }
    for table in report.tables:
        if table.name:
            forms = {".csv": table.csv(), ".md": table.markdown()}
            files |= {
                out / "tables" / f"{table.name}{suffix}": text for suffix, text in forms.items()
            }
    for path, text in files.items():
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return write(report, out / "report.html")


# --- missing --------------------------------------------------------------------------------------


def _missing(results: Results) -> Section:
    left_out = []
    for reason, skipped in grouped((each.reason, each) for each in results.plan.skipped).items():
        where = grouped((each.environment, each.what) for each in skipped)
        same = grouped((listed(names), environment) for environment, names in where.items())
        left_out += [f"{names} in {listed(places)}: {reason}." for names, places in same.items()]
    labels = _labels([*results.plan.jobs, *examples(results.plan).values()])
    whys = {
        key: (why.strip().splitlines() or ["no reason given"])[-1]
        for key, why in results.failures.items()
    }
    failed = grouped((why, labels.get(key, key)) for key, why in whys.items())
    lost = [f"{_abbreviated(names)}: {why}" for why, names in failed.items()]
    absent = [
        f for f in results.plan.flights if f.job.key not in {*results.values, *results.failures}
    ]
    blocks: list[Block] = []
    for title, items in (
        ("Left out, because the environment refuses it:", left_out),
        (
            (
                "Failed (last line of the traceback; the command printed the rest), to be tried"
                " again in the next run:"
            ),
            lost,
        ),
        ("Not computed yet:", [_abbreviated([_flown(f) for f in absent])] if absent else []),
    ):
        if items:
            blocks += [Prose(title), Bullets(list(items))]
    return Section("Left out and failed", blocks)


def _labels(jobs: Iterable[Job]) -> dict[str, str]:
    """Labels of jobs and of those that they need, by key."""
    found: dict[str, str] = {}
    for job in jobs:
        condition = job.arguments.get("options", {})
        world = ", ".join(str(condition[name]) for name in AXES if name in condition)
        found[job.key] = f"{job.label} ({world})" if world else job.label
        found |= _labels(job.needs)
    return found


def _flown(flight: Flight) -> str:
    return f"{flight.agent} on {flight.flown_on} in {flight.environment}, {flight.condition}"


def _abbreviated(names: Sequence[str]) -> str:
    """Names, or how many there are of them beside the first."""
    unique = list(dict.fromkeys(names))
    return listed(unique) if len(names) <= 3 else f"{names[0]} and {len(names) - 1} more"


# --- limits ---------------------------------------------------------------------------------------


def _limits(results: Results) -> Section:
    study = results.plan.study
    model = (
        "limits-mismatch"
        if any(condition.mismatch for condition in study.conditions)
        else "limits-exact"
    )
    names = ("limits", model, *(["limits-learned"] if study.learned else []))
    return Section(
        "Assumptions and limits",
        [Bullets([text for name in names for text in paragraphs(name, results)])],
    )
