"""Benchmark of the asymmetric critic, and of a leak to the actor: ``python -m studies.critic`` (docs/critic.md)."""

from pathlib import Path

from agents.commands.console import asked, command, in_range


def main(worlds: tuple[str, ...] = (), /, runs: int = 5, out: Path = Path("results/critic")) -> None:
    """Train PPO with and without the truth for its critic, and write the tables and the picture of docs/critic.md.

    A training whose result is there is not repeated. All of them take an hour.

    Args:
        worlds: Where; all, from which the page is written, if none is named.
        runs: Training seeds.
        out: Folder of the results.
    """
    from estimators.factory import unknown
    from studies.critic import page

    with asked():
        in_range("--runs", runs, 2)  # one run has no interval
        for name in worlds:
            if name not in page.WORLDS:
                raise ValueError(unknown("world", name, page.WORLDS))
    page.learn(worlds or tuple(page.WORLDS), runs, out)
    if not worlds or set(worlds) == set(page.WORLDS):
        page.write(runs, out)


if __name__ == "__main__":
    command(main)
