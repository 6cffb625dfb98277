"""The moving picture of the README: one ship in the same waves on a filter and on raw measurements.

Run it from the root of the repository: ``python docs/images/turning.py``.
"""

from pathlib import Path

import gymnasium as gym
from environments import MAP
from PIL import Image, ImageDraw

import vessel_gym  # noqa: F401  (registers the environments)
from agents import load_agent

ENV, SEED, EVERY = "SigmaCorvette-v0", 1_000_000_005, 8
WORLD = {"disturbance": "rough", "sensors": "denied"}
ESTIMATORS = {"kf-umv-ui": "on a Kalman filter", "measurement": "on raw measurements"}
WIDTH, HEIGHT, TOP = 470, 421, 30


def frames(estimator: str) -> tuple[list[Image.Image], float]:
    """Maps of an episode under the autopilot, and its score."""
    env = gym.make(ENV, estimator=estimator, **WORLD, render_mode="rgb_array")
    agent = load_agent("autopilot", env)
    seen, info = env.reset(seed=SEED)
    agent.reset(1)
    found, ended, step = [], False, 0
    while not ended:
        seen, _, terminated, truncated, info = env.step(agent.act(seen[None])[0])
        step, ended = step + 1, terminated or truncated
        if step % EVERY == 0 or ended:
            sea = Image.fromarray(env.render()).crop(MAP)
            found.append(sea.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS))
    return found, float(info["score"])


def main() -> None:
    """Both episodes side by side, as one GIF."""
    runs = {label: frames(name) for name, label in ESTIMATORS.items()}
    shown = []
    for i in range(max(len(maps) for maps, _ in runs.values())):
        both = Image.new("RGB", (2 * WIDTH + 8, HEIGHT + TOP), "white")
        draw = ImageDraw.Draw(both)
        for x, (label, (maps, score)) in zip((0, WIDTH + 8), runs.items(), strict=True):
            both.paste(maps[min(i, len(maps) - 1)], (x, TOP))
            draw.text((x + 6, 5), f"{label}: score {score:.2f}", fill="black", font_size=17)
        shown.append(both)
    colours = shown[-1].quantize(64, kmeans=1)  # of all frames, so none flickers
    shown = [each.quantize(palette=colours, dither=Image.Dither.NONE) for each in shown]
    path = Path(__file__).with_suffix(".gif")
    times = [100] * (len(shown) - 1) + [3000]  # the whole turn stays in view
    shown[0].save(
        path, save_all=True, append_images=shown[1:], duration=times, loop=0, optimize=True
    )


if __name__ == "__main__":
    main()
