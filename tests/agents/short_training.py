"""Settings of a training of a moment."""

STEPS = 3 * 8 * 16
"""Environment steps of a short training: three rollouts."""
TINY = {
    "n_envs": 8,
    "n_steps": 16,
    "batch_size": 64,
    "n_epochs": 2,
    "policy_kwargs": {"net_arch": [8], "log_std_init": -1.6},
}
REMEMBERING = {
    "none": {},
    "frames": {"frame_stack": 3},
    "lstm": {"policy_kwargs": TINY["policy_kwargs"] | {"lstm_hidden_size": 4}},
}
