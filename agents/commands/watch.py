"""Watch an agent steer: ``vessel-gym watch SigmaCorvette-v0 --out turn.gif``."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from agents.commands.console import asked, progress
from agents.commands.options import acting

FPS = 12
"""Frames a second of a GIF or MP4."""
WRITERS: dict[str, dict[str, Any]] = {
    ".gif": {"duration": 1000.0 / FPS, "loop": 0},
    ".mp4": {"fps": FPS},
    ".png": {},
}
"""Kinds of pictures, with their settings for imageio."""
PAGE = ".html"


OPTIONS = {
    "seed": "seed of the episode; if not given, an .html shows the most typical of 40 episodes, all"
    " else seed 0",
    "out": ".html, an interactive page on several estimators; .gif, .mp4, or .png of the last"
    " frame",
    "every": "keep one frame in this many steps (.gif and .mp4)",
}


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    seed: int | None = None,
    agent: str = "autopilot",
    out: Path = Path("results/episode.html"),
    every: int = 6,
    **options: Any,
) -> None:
    """Write one episode to a file, to watch it."""
    import gymnasium as gym

    from agents import load_agent
    from agents.files import check_file
    from agents.studies.worlds import environment_options, registered_id

    agent = acting(agent, options)
    with asked():
        check_kind(out)
        options = environment_options(env_id := registered_id(env_id), options)
        check_file(out)
    if out.suffix.lower() == PAGE:
        _write_page(env_id, agent, seed, options, out)
        return
    with asked():
        drawn = environment_options(env_id, {"render_mode": "rgb_array"})
        env: Any = gym.make(env_id, **options, **drawn)
        flyer = load_agent(agent, env)
    with closing(env):
        flyer.reset(1)
        with asked():  # the first picture needs pygame
            observation, _ = env.reset(seed=seed or 0)
            check_picture(env, env_id)
        score = record(env, fly(env, flyer, observation), out, every)
    print(f"wrote {out}, score {score:.3f}")


def _write_page(
    env_id: str, agent: str, seed: int | None, options: dict[str, Any], out: Path
) -> None:
    """Write an episode as a page, and print which it is and its scores."""
    from agents import episode

    with asked():
        page = episode(env_id, None, agent, seed, options)
    page.save(out)
    scores = ", ".join(f"{score:.3f} on {name}" for name, score in page.scores.items())
    print(f"wrote {out}, {page.page['conditions'][-1]}, score {scores}")


def check_kind(out: Path) -> None:
    """Refuse a file that is neither a page nor a picture, or for whose kind an extra is missing.

    Raises:
        ValueError: naming the kinds.
        ModuleNotFoundError: without what writes pictures.
    """
    from vessel_gym.extras import require

    kind = out.suffix.lower()
    if kind in WRITERS:
        require("imageio", "imageio_ffmpeg", "PIL")
    elif kind != PAGE:
        kinds = ", ".join((PAGE, *WRITERS))
        raise ValueError(f"cannot write {str(out)!r}: the suffix must be one of {kinds}")


def check_picture(env: Any, env_id: str) -> None:
    """Refuse an environment that cannot draw itself on this machine.

    Raises:
        ValueError: with its reason.
    """
    try:
        env.render()
    except Exception as error:  # of whatever library it draws by
        raise ValueError(f"{env_id} cannot be drawn here ({error})") from error


def fly(env: Any, agent: Any, observation: Any) -> Iterator[tuple[bool, float]]:
    """Fly one episode.

    Yields:
        After each step, true at the end, and the score so far, or the return of an environment
        without one.
    """
    from agents.rollouts import acted

    done, total, shape = False, 0.0, (1, *(env.action_space.shape or ()))
    while not done:
        action = acted(agent, observation[None], shape)[0]
        observation, reward, terminated, truncated, info = env.step(action)
        done, total = terminated or truncated, total + float(reward)
        yield done, info.get("score", total)


def record(env: Any, episode: Iterator[tuple[bool, float]], out: Path, every: int) -> float:
    """Write an episode to a file; returns the score."""
    import imageio.v2 as imageio

    from agents.files import replacing

    kind, score = out.suffix.lower(), 0.0
    steps = (env.spec and env.spec.max_episode_steps) or 0
    with (
        replacing(out) as path,
        # imageio's own exit closes nothing on errors
        closing(imageio.get_writer(path, **WRITERS[kind])) as writer,
        progress(f"writing {out.name}") as show,
    ):
        for step, (done, score) in enumerate(episode):  # noqa: B007  (returned)
            if done or (kind != ".png" and step % every == 0):
                writer.append_data(env.render())
            show(step + 1, steps)
    return score
