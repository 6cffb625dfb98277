"""Inspect a measured log: ``vessel-gym inspect voyage.csv --columns map.toml``."""

from pathlib import Path
from typing import Annotated

import tyro

from agents.commands.console import asked, print_table


def main(log: Annotated[Path, tyro.conf.Positional], /, columns: Path | None = None, page: Path | None = None) -> None:
    """Say what is in a log and what is wrong with it, each fault with its line.

    Args:
        log: CSV, Parquet, NMEA 0183 or ULog file.
        columns: Column map of the log; columns are recognised by their names without one.
        page: HTML file to write: each channel over time, with its faults.
    """
    from agents.files import check_file
    from vessel_gym.logs import Columns, read, read_columns
    from vessel_gym.logs.inspection import inspect, noise, rate

    with asked():
        if page is not None:
            check_file(page)
        found = read(log, read_columns(columns) if columns else Columns({}))
    rows = []
    for name, channel in found.channels.items():
        _, values = channel.measured()
        low, high = (f"{values.min():.4g}", f"{values.max():.4g}") if len(values) else ("", "")
        rows.append(
            (f"{name} [{channel.unit}]", str(len(values)), f"{rate(channel):.3g}", low, high, f"{noise(channel):.2g}")
        )
    first, last = found.span
    print_table(f"{found.name}: {last - first:.6g} s", ("", "numbers", "rate [Hz]", "least", "most", "noise"), [rows])
    faults = inspect(found)
    for fault in faults:
        print(f"line {fault.line}: {fault.channel + ': ' if fault.channel else ''}{fault.sentence}")
    if not faults:
        print("no fault found")
    if page is not None:
        from agents.episodes.logs import log_page

        log_page(found, faults).save(page)
        print(f"page: {page}")
