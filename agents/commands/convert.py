"""Convert an agent of rl_zoo3: ``vessel-gym convert logs/ppo/SigmaCorvette-v0_1 --trust``."""

from pathlib import Path
from typing import Annotated

import tyro

from agents.commands.console import asked


def main(
    folder: Annotated[Path, tyro.conf.Positional],
    out: Path = Path("results/zoo.zip"),
    best: bool = False,
    trust: bool = False,
) -> None:
    """Convert an agent that rl_zoo3 trained into a checkpoint of this package, without pickle.

    Args:
        folder: Folder of a training, such as logs/ppo/SigmaCorvette-v0_1.
        out: Checkpoint to write.
        best: Convert best_model.zip instead of the last model.
        trust: Read the folder, although its pickles can run any code.
    """
    from agents.files import check_file
    from agents.training.zoo import convert

    check_file(out)
    with asked():
        path = convert(folder, out, best, trust)
    print(f"checkpoint: {path}")
