"""The moving picture of the README: one ship in the same waves on a filter and on held measurements.

Run it from the root of the repository: ``python docs/images/turning.py``.
"""

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image, ImageDraw

import vessel_gym  # noqa: F401  (registers the environments)
from agents import load_agent

ENV, SEED, STEPS, EVERY = "SigmaCorvette-v0", 1_000_000_005, 480, 10
ESTIMATORS = {"kf-umv-ui": "on a filter", "measurement": "on the last measurements"}
CLOSE_UP, RUDDER = (0.52, 0.085, 0.985, 0.51), (0.345, 0.82, 0.655, 0.975)
"""Parts of a frame: left, top, right and bottom, as shares of it."""
WIDTH, TOP = 380, 30


def part(picture: Image.Image, box: tuple[float, float, float, float]) -> Image.Image:
    """A part of a frame, `WIDTH` wide."""
    left, top, right, bottom = np.multiply(box, 2 * picture.size)
    cut = picture.crop((left, top, right, bottom))
    return cut.resize((WIDTH, round(WIDTH * cut.height / cut.width)), Image.Resampling.LANCZOS)


def frames(estimator: str) -> tuple[list[Image.Image], float]:
    """Frames of an episode under the autopilot, and its score."""
    env = gym.make(ENV, estimator=estimator, disturbance="rough", render_mode="rgb_array")
    agent = load_agent("autopilot", env)
    seen, info = env.reset(seed=SEED)
    agent.reset(1)
    found, ended, step = [], False, 0
    while not ended:
        seen, _, terminated, truncated, info = env.step(agent.act(seen[None])[0])
        if step % EVERY == 0 and step < STEPS:
            parts = [part(Image.fromarray(env.render()), box) for box in (CLOSE_UP, RUDDER)]
            both = Image.new("RGB", (WIDTH, sum(each.height for each in parts)))
            both.paste(parts[0], (0, 0))
            both.paste(parts[1], (0, parts[0].height))
            found.append(both)
        step, ended = step + 1, terminated or truncated
    return found, float(info["score"])


def main() -> None:
    """Both episodes side by side, as one GIF."""
    flown = {label: frames(name) for name, label in ESTIMATORS.items()}
    size, shown = (2 * WIDTH + 8, flown["on a filter"][0][0].height + TOP), []
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
