"""Benchmark of the asymmetric critic, and of a leak to the actor: ``python -m studies.critic`` (docs/critic.md)."""

from pathlib import Path

from agents.commands.console import asked, command, in_range


def main(runs: int = 5, out: Path = Path("results/critic")) -> None:
    """Train PPO with and without the truth for its critic, and write the tables and the picture of docs/critic.md.

    A training whose result is there is not repeated. All of them take an hour.

    Args:
        runs: Training seeds.
        out: Folder of the results.
    """
    from studies.critic import page

    with asked():
        in_range("--runs", runs, 2)  # one run has no interval
    page.write(page.measured(runs, out))


if __name__ == "__main__":
    command(main)
