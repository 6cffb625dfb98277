"""Draw the pictures of the environments: ``python docs/images/environments.py``.

The first page has the map of each, the environments' pages a whole frame.
"""

from pathlib import Path

import gymnasium as gym
from PIL import Image

import vessel_gym  # noqa: F401  (registers the environments)
from agents import load_agent

HERE = Path(__file__).parent
AGENTS = {
    "SigmaCorvette-v0": "autopilot",
    "SigmaChannel-v0": "autopilot",
    "SegorogeniAUV-v0": "autopilot",
    "ItsunusaAUV-v0": "autopilot",
    "PunaUAV-v0": "autopilot",
    "ThesisCorvette-v0": "constant-rudder",
}
MAP = (17, 60, 735, 704)
"""Left, top, right and bottom of the maps in a frame."""
FRAMES = {
    "turning-circle": ("SigmaCorvette-v0", "rough"),
    "channel": ("SigmaChannel-v0", "rough quartering"),
    "segorogeni-dive": ("SegorogeniAUV-v0", "moderate"),
    "itsunusa-dive": ("ItsunusaAUV-v0", "moderate"),
    "puna-flight": ("PunaUAV-v0", "moderate"),
}
"""Environment and disturbance of each whole frame."""


def frame(env_id: str, seed: int, **options: str) -> Image.Image:
    """The last frame of an episode."""
    env = gym.make(env_id, render_mode="rgb_array", **options)
    agent = load_agent(AGENTS[env_id], env)
    agent.reset(1)
    observation, _ = env.reset(seed=seed)
    done = False
    while not done:
        observation, _, terminated, truncated, _ = env.step(agent.act(observation[None])[0])
        done = terminated or truncated
    return Image.fromarray(env.render())


def main() -> None:
    """Write all pictures."""
    for env_id in AGENTS:
        name = env_id.removesuffix("-v0").lower()
        small = frame(env_id, 7).crop(MAP).resize((480, 430), Image.Resampling.LANCZOS)
        small.quantize(128).save(HERE / f"{name}.png", optimize=True)
    for name, (env_id, disturbance) in FRAMES.items():
        frame(env_id, 0, disturbance=disturbance).save(HERE / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
