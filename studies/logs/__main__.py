"""Compare logs of the Esso Osaka with their simulation: ``python -m studies.logs FOLDER`` (docs/logs-findings.md)."""

import json
from pathlib import Path

from agents.commands.console import asked, command


def main(folder: Path, /, filters: tuple[str, ...] = ()) -> None:
    """Identify the ship on three quarters of the runs, compare it with the others, and write docs/logs-findings.md.

    It takes some minutes of one core. The numbers go to studies/logs/summary.json, which the tables are made of.

    Args:
        folder: The CSV files of the dataset FRT-DS-ESSO.
        filters: Names of filters; those that `vessel-gym estimate` runs if none is given.
    """
    from agents.files import replacing
    from studies.logs import results, tables

    with asked():
        logs = results.read_folder(folder)
    with replacing(tables.STORED) as file:
        file.write_text(json.dumps(results.computed(logs, filters or results.FILTERS)), encoding="utf-8")
    tables.write()


if __name__ == "__main__":
    command(main)
