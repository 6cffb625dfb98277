# /// script
# dependencies = [
#     "torch==2.13.0", "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "rich==15.0.0",
#     "gymnasium==1.4.0", "rl_zoo3==2.9.2", "sbx-rl==0.28.0", "jax==0.10.2",
#     "torchrl==0.14.1", "tensordict==0.14.3", "skrl==2.1.1", "tianshou==2.0.1",
#     "minari[hdf5]==0.5.4",
# ]
# ///
"""rl_zoo3 trains SAC on an environment that its command line names."""

import sys
from pathlib import Path
from tempfile import mkdtemp
from unittest.mock import patch

from recorder import ROWS, SEED, STEPS, Record, run
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.train import train
from with_stable_baselines3 import SEEDS, replayed

SETTINGS = (
    f"{{n_timesteps: {ROWS * STEPS}, policy: MlpPolicy, n_envs: {ROWS},"
    f" learning_starts: {ROWS * STEPS - 100}}}"
)


def play(record: Record) -> None:
    """Train from the command line."""
    folder = Path(mkdtemp())
    (folder / "sac.yml").write_text(f"{record.env_id}: {SETTINGS}")
    line = f"train --algo sac --env {record.env_id} --gym-packages vessel_gym --seed {SEED}"
    line += f" --env-kwargs max_episode_steps:{record.limit} --conf-file {folder}/sac.yml"
    sys.argv = [*line.split(), "--log-folder", str(folder), "--eval-freq", "-1", "--verbose", "0"]
    with patch.object(ExperimentManager, "save_trained_model") as saved:
        train()
    record.check(SEEDS, replayed(saved.call_args.args[0].replay_buffer))


if __name__ == "__main__":
    run(play)
