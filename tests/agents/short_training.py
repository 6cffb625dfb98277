"""Settings of a training of a moment."""

STEPS = 3 * 8 * 16
"""Environment steps of a short training: three rollouts."""
TINY = {"num_envs": 8, "n_steps": 16, "batch_size": 64, "n_epochs": 2, "net_arch": [8]}
REMEMBERING = {"none": {}, "frames": {"frames": 3}, "lstm": {"lstm_hidden_size": 4}}
