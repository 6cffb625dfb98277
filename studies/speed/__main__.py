"""Time of steps and filters, and ratios to baselines: ``python -m studies.speed``."""

from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from agents.commands.console import asked, command, in_range
from agents.refusal import Refusal

What = Literal["loop", "filters", "flights", "where", "third-party"]
MARK = "measured"
"""Mark of the printed tables on a page."""


def main(
    env_ids: tuple[str, ...] = (
        "SigmaCorvette-v0",
        "ThesisCorvette-v0",
        "SegorogeniAUV-v0",
        "ItsunusaAUV-v0",
        "PunaUAV-v0",
    ),
    /,
    what: tuple[What, ...] = ("loop", "filters", "flights", "where"),
    against: Path | None = None,
    rows: tuple[int, ...] = (1, 16, 256, 1024, 4096),
    rounds: int = 11,
    page: Path | None = None,
) -> None:
    """Time steps and filters on one core: beside a loop by hand, filterpy, bare NumPy and another version, in one run.

    Everything is timed in turns in short blocks; printed are medians and quartiles over rounds, and
    those of ratios.

    Args:
        env_ids: Registered environments, for flights and where.
        what: loop: the corvette beside a loop written by hand; filters: beside filterpy, by rows,
            by members; flights: environments, estimators, batches; where: the parts of a step;
            third-party: Gymnasium's cart-poles behind a filter.
        against: A folder with another version, to fly beside this one: pip install --no-deps
            --target FOLDER vessel-gym==VERSION, or a checkout.
        rows: Sizes of batches in loop, filters and third-party.
        rounds: Blocks of each.
        page: A Markdown page: what is printed also goes between its marks.
    """
    from agents.studies.worlds import environment_id
    from studies.tables.markdown import around, put

    if find_spec("filterpy") is None:
        raise Refusal("the baselines need filterpy: pip install filterpy")
    from studies.speed import timing

    with asked():
        in_range("--rounds", rounds, 1)
        for size in rows:
            in_range("--rows", size, 1)
        for name, words in {"--rows": rows, "--what": what, "ENV-IDS": env_ids}.items():
            if not words:
                raise ValueError(f"{name} needs at least one word")
        if against is not None and not (against / "vessel_gym" / "__init__.py").is_file():
            raise ValueError(
                f"{against} holds no vessel_gym: pip install --no-deps --target {against}"
                " vessel-gym==..."
            )
        if page is not None:
            around(page, MARK)
        env_ids = tuple(map(environment_id, env_ids))
    text = timing.report(env_ids, what, against, rows, rounds)
    print(text)
    if page is not None:
        put(page, MARK, text)


if __name__ == "__main__":
    command(main)
