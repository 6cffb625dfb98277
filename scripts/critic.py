"""What the truth is worth to the critic, and what a leak looks like: ``python -m scripts.critic`` (docs/critic.md)."""

from pathlib import Path

from scripts.console import asked, command, in_checkout, in_range


def main(worlds: tuple[str, ...] = (), /, runs: int = 5, out: Path = Path("results/critic")) -> None:
    """Train PPO with and without the truth for its critic, and write the tables and the picture of docs/critic.md.

    A training whose result is there is not repeated. All of them take an hour.

    Args:
        worlds: Where; all, from which the page is written, if none is named.
        runs: Training seeds.
        out: Folder of the results.
    """
    from estimators.factory import unknown
    from scripts import critic_page

    in_checkout()
    with asked():
        in_range("--runs", runs, 2)  # one run has no interval
        for name in worlds:
            if name not in critic_page.WORLDS:
                raise ValueError(unknown("world", name, critic_page.WORLDS))
    critic_page.learn(worlds or tuple(critic_page.WORLDS), runs, out)
    if not worlds or set(worlds) == set(critic_page.WORLDS):
        critic_page.write(runs, out)


if __name__ == "__main__":
    command(main)
