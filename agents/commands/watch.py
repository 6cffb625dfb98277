"""Watch an agent steer: ``vessel-gym watch SigmaCorvette-v0 --out turn.gif``."""

from contextlib import closing
from pathlib import Path
from typing import Any

from agents.commands.console import asked, progress
from agents.commands.options import acting
from agents.plotting import KINDS
from agents.refusal import Refusal

FPS = 12
"""Frames a second of a GIF or MP4."""
WRITERS: dict[str, dict[str, Any]] = {
    ".gif": {"duration": 1000.0 / FPS, "loop": 0},
    ".mp4": {"fps": FPS},
    ".png": {},
}
"""Suffixes of frames and films, with their settings for imageio."""
NEEDED: dict[str, tuple[str, ...]] = {
    ".html": (),
    **dict.fromkeys(KINDS, ("matplotlib",)),
    **dict.fromkeys(WRITERS, ("imageio", "imageio_ffmpeg", "PIL")),
}
"""Optional modules that a file of each suffix needs."""


OPTIONS = {
    "estimator": "one or more estimators, of which a page or figure shows the same episode; the"
    " environment's default and the truth if not given",
    "seed": "seed of the episode; if not given, a page or figure shows the most typical of 40"
    " episodes, all else seed 0",
    "out": ".html, an interactive page; .pdf or .svg, a figure; .gif or .mp4, a film of one"
    " estimator; .png, its last frame",
    "every": "keep one frame in this many steps (.gif and .mp4)",
}


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    estimator: tuple[str, ...] = (),
    seed: int | None = None,
    agent: str = "autopilot",
    out: Path = Path("results/episode.html"),
    every: int = 6,
    **options: Any,
) -> None:
    """Write an episode to a file, to watch it; several estimators meet equal waves and noise."""
    from agents import episode
    from agents.files import check_file
    from agents.studies.worlds import environment_options, registered_id
    from vessel_gym.checks import one_of
    from vessel_gym.extras import require

    agent = acting(agent, options)
    with asked():
        require(*NEEDED[one_of("kind of file", kind := out.suffix.lower(), NEEDED)])
        if len(estimator) == 1:
            options["estimator"] = estimator[0]
        elif estimator and kind in WRITERS:
            raise ValueError(
                f"{out} shows one estimator: name one, or write an .html, .pdf or .svg of several"
            )
        options = environment_options(env_id := registered_id(env_id), options)
        check_file(out)
    if kind in WRITERS:
        _film(env_id, agent, seed or 0, out, every, options)
        return
    with asked():
        chosen = [environment_options(env_id, {"estimator": each}) for each in estimator]
        names = [each["estimator"] for each in chosen] if len(chosen) > 1 else None
        page = episode(env_id, names, agent, seed, options)
    page.save(out)
    scores = ", ".join(f"{score:.3f} with {name}" for name, score in page.scores.items())
    print(f"wrote {out}, {page.page['conditions'][-1]}, score {scores}")


def _film(
    env_id: str, agent: str, seed: int, out: Path, every: int, options: dict[str, Any]
) -> None:
    """Write pictures of an episode."""
    import gymnasium as gym

    from agents import load_agent
    from agents.studies.worlds import environment_options

    with asked():
        drawn = environment_options(env_id, {"render_mode": "rgb_array"})
        env: Any = gym.make(env_id, **options, **drawn)
        flyer = load_agent(agent, env)
    with closing(env):
        flyer.reset(1)
        with asked():
            observation, _ = env.reset(seed=seed)
        try:
            env.render()
        except Exception as error:  # of whatever library draws it, such as a missing pygame
            raise Refusal(f"{env_id} cannot be drawn here ({error})") from error
        score = record(env, flyer, observation, out, every)
    print(f"wrote {out}, score {score:.3f}")


def record(env: Any, agent: Any, observation: Any, out: Path, every: int) -> float:
    """Write the rest of an episode to a file, and return its score.

    The score is the return in an environment without one.
    """
    import imageio.v2 as imageio

    from agents.files import replacing
    from agents.rollouts import acted

    kind, shape = out.suffix.lower(), (1, *(env.action_space.shape or ()))
    steps = (env.spec and env.spec.max_episode_steps) or 0
    done, total, step, info = False, 0.0, 0, dict[str, Any]()
    with (
        replacing(out) as path,
        # imageio's own exit closes nothing on errors
        closing(imageio.get_writer(path, **WRITERS[kind])) as writer,
        progress(f"writing {out.name}") as show,
    ):
        while not done:
            action = acted(agent, observation[None], shape)[0]
            observation, reward, terminated, truncated, info = env.step(action)
            done, total = terminated or truncated, total + float(reward)
            if done or (kind != ".png" and step % every == 0):
                writer.append_data(env.render())
            show(step := step + 1, steps)
    return float(info.get("score", total))
