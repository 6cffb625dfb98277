"""The moving picture of the README: one ship in the same waves on a filter and on raw measurements.

Run it from the root of the repository: ``python docs/images/turning.py``.
"""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pygame
from PIL import Image, ImageDraw

import vessel_gym  # noqa: F401  (registers the environments)
from agents import load_agent
from vessel_gym.rendering.canvas import Canvas
from vessel_gym.rendering.maps import Map
from vessel_gym.rendering.scene import Scene

ENV, SEED, STEPS, EVERY = "SigmaCorvette-v0", 1_000_000_005, 480, 10
ESTIMATORS = {"kf-umv-ui": "on a filter", "measurement": "on the last measurements"}
WIDTH, SEA, HEIGHT, TOP = 380, 280, 352, 30


def close_up(scene: Scene, rudder: list[float]) -> Image.Image:
    """The estimated ship in the middle of a map, and the commanded rudder rate below."""
    canvas = Canvas(WIDTH, HEIGHT)
    canvas.clear()
    sea = Map(scene, np.eye(2, 3), pygame.Rect(0, 0, WIDTH, SEA))
    sea.middle, sea.scale, sea.size = scene.believed[-1, :2], 2.4, scene.surroundings.size
    sea.draw(canvas)
    canvas.panel(pygame.Rect(0, SEA + 6, WIDTH, HEIGHT - SEA - 6))
    canvas.text(12, SEA + 20, "rudder rate", size=11)
    x, y = np.linspace(12.0, WIDTH - 12.0, STEPS), SEA + 44.0 - 22.0 * np.array(rudder)
    canvas.line(np.stack([x[: len(y)], y], -1), "true")
    return Image.fromarray(canvas.pixels())


def frames(estimator: str) -> tuple[list[Image.Image], float]:
    """Close-ups of an episode under the autopilot, and its score."""
    env = gym.make(ENV, estimator=estimator, disturbance="rough", render_mode="rgb_array")
    agent = load_agent("autopilot", env)
    seen, info = env.reset(seed=SEED)
    agent.reset(1)
    found, rudder, ended, step = [], list[float](), False, 0
    while not ended:
        action = agent.act(seen[None])[0]
        rudder.append(float(action[0]))
        seen, _, terminated, truncated, info = env.step(action)
        if step % EVERY == 0 and step < STEPS:
            found.append(close_up(env.unwrapped._renderer.scene, rudder))  # type: ignore[attr-defined]
        step, ended = step + 1, terminated or truncated
    return found, float(info["score"])


def main() -> None:
    """Both episodes side by side, as one GIF."""
    flown = {label: frames(name) for name, label in ESTIMATORS.items()}
    size, shown = (2 * WIDTH + 8, HEIGHT + TOP), []
    for i in range(min(len(each) for each, _ in flown.values())):
        both = Image.new("RGB", size, "white")
        draw = ImageDraw.Draw(both)
        for x, (label, (each, score)) in zip((0, WIDTH + 8), flown.items(), strict=True):
            both.paste(each[i], (x, TOP))
            draw.text((x + 6, 5), f"{label}: score {score:.2f}", fill="black", font_size=17)
        shown.append(both)
    colours = shown[-1].quantize(64, kmeans=1)  # of all frames, so none flickers
    shown = [each.quantize(palette=colours, dither=Image.Dither.NONE) for each in shown]
    path = Path(__file__).with_suffix(".gif")
    shown[0].save(path, save_all=True, append_images=shown[1:], duration=140, loop=0, optimize=True)
    print(path.stat().st_size, {label: score for label, (_, score) in flown.items()})


if __name__ == "__main__":
    main()
