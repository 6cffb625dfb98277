import os
import subprocess
import sys
from pathlib import Path

from scripts.ablate import ablate

ROOT = Path(__file__).parents[2]


def _shell(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "scripts.ablate", *arguments],
        cwd=ROOT, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_a_study_ends_with_the_answer_and_where_the_report_lies(tmp_path, capsys):
    assert ablate(tmp_path, episodes=2, training_seeds=1, steps=128 * 64) == 0
    printed = capsys.readouterr().out
    assert "2 paired seeds" in " ".join(printed.split())
    assert str(tmp_path / "report.html") in printed.replace("\n", "")
    assert (tmp_path / "report.html").stat().st_size > 100_000
    assert {path.name for path in (tmp_path / "checkpoints").iterdir()} == {"ppo-0.zip"}


def test_an_output_that_cannot_be_written_is_one_sentence_and_exit_code_2(tmp_path):
    (tmp_path / "file").write_text("mine")
    done = _shell("--out", str(tmp_path / "file"))
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == f"ablate: cannot write to {tmp_path / 'file'}: {tmp_path / 'file'} is a file, not a folder\n"


def test_a_study_that_cannot_be_run_is_one_sentence_and_exit_code_2(tmp_path, capsys):
    assert ablate(tmp_path / "out", env_id="Nonsense-v0") == 2
    assert ablate(tmp_path / "out", episodes=0) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2
    assert not (tmp_path / "out").exists()
