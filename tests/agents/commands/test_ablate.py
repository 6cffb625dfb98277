"""`vessel-gym ablate`: from a study file to a report, whatever happens on the way."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from agents.commands import ablate
from agents.commands.console import command
from agents.training import callbacks

ROOT = Path(__file__).parents[3]
SMALL = """
title = "A small study of a :ship:"
episodes = 2
training_seeds = 1

[environments]
SigmaCorvette-v0 = {}

[estimators]
kf-umv-ui = {}

[agents.PPO]
kind = "ppo"
steps = { SigmaCorvette-v0 = 384 }
settings = { n_envs = 8, n_steps = 16, batch_size = 64, n_epochs = 2, policy_kwargs = { net_arch = [8] } }
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_main_job_installs_no_test_dependencies():
    """In an empty environment; the tests install theirs, too."""
    installed = {}
    for job in ("ablation", "test"):
        done = subprocess.run(
            ["make", "-n", "-B", job], cwd=ROOT, capture_output=True, text=True, check=True
        )
        installed[job] = re.findall(r"pip install .*'\.(\[[a-z,]*\])'", done.stdout)
    assert installed == {"ablation": ["[train,report]"], "test": ["[train,report]", "[dev]"]}


@pytest.mark.slow
def test_study_is_reported_and_not_computed_twice(study, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(callbacks, "EPISODES", 1)
    out = tmp_path / "out"
    assert ablate.main(study, out, processes=1) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("A small study of a :ship:\n")
    assert f"Report: {out / 'report.html'}" in printed
    assert (out / "report.html").stat().st_size > 100_000
    assert (out / "study.toml").read_text() == SMALL
    assert (out / "ranking.md").read_text().startswith("# A small study of a :ship:\n\n")
    computed = {path.name: path.stat().st_ino for path in (out / "jobs").iterdir()}
    table = (out / "results.parquet").read_bytes()
    assert ablate.main(out / "study.toml", out, processes=1) == 0  # as the report says
    assert {path.name: path.stat().st_ino for path in (out / "jobs").iterdir()} == computed
    assert (out / "results.parquet").read_bytes() == table


@pytest.mark.nightly
def test_study_of_documentation_runs_user_defined_parts(tmp_path, monkeypatch):
    def found(page: str, pattern: str) -> str:
        text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        return re.findall(rf"^```{pattern}", text, re.M | re.S)[-1]

    observer = found("tutorials/own-filter.md", r"\{code-cell\}\n(import gymnasium.*?)^env = ")
    (tmp_path / "my_filters.py").write_text(observer)  # in the working directory
    (folder := tmp_path / "studies").mkdir()
    for name, page, pattern in (
        ("usv.py", "recipes/differential-drive.md", "python usv\n(.*?)```"),
        ("own.toml", "studies.md", "toml\n(.*?)```"),
    ):
        (folder / name).write_text(found(page, pattern))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*filter(None, sys.path)])  # the command adds to it
    assert command(ablate.main, ["studies/own.toml", "--out", "out", "--processes", "1"]) == 0
    table = pd.read_parquet(tmp_path / "out" / "results.parquet")
    flown = set(zip(table.environment, table.estimator, strict=True))
    everywhere = {"truth", "dead-reckoning", "ekf", "steady-kf"}
    estimators = {"usv:USV-v0": everywhere, "SigmaCorvette-v0": everywhere | {"observer"}}
    assert flown == {(env, name) for env, names in estimators.items() for name in names}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "observer" in page
    again = shlex.split(re.search("<li>vessel-gym ablate ([^<]*)</li>", page)[1])
    computed = set((tmp_path / "out" / "jobs").iterdir())
    assert command(ablate.main, [*again, "--processes", "1"]) == 0
    assert set((tmp_path / "out" / "jobs").iterdir()) == computed
