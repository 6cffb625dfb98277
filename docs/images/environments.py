"""Draw the pictures of the environments on the first page: ``python docs/images/environments.py``."""

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
MAP = slice(60, 462), slice(17, 512)
"""Rows and columns of the map in a frame."""


def draw(env_id: str, name: str) -> None:
    """Write the map at the end of an episode."""
    env = gym.make(env_id, render_mode="rgb_array")
    agent = load_agent(name, env)
    agent.reset(1)
    observation, _ = env.reset(seed=7)
    done = False
    while not done:
        observation, _, terminated, truncated, _ = env.step(agent.act(observation[None])[0])
        done = terminated or truncated
    file = HERE / f"{env_id.removesuffix('-v0').lower()}.png"
    Image.fromarray(env.render()[MAP]).quantize(48).save(file, optimize=True)


if __name__ == "__main__":
    for env_id, name in AGENTS.items():
        draw(env_id, name)
