"""Watch an agent steer: ``vessel-gym watch SigmaCorvette-v0 --disturbance rough --out episode.html``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from agents.commands.console import asked, in_range, progress_bar
from agents.commands.world import World

if TYPE_CHECKING:
    import gymnasium as gym
    import numpy as np

    Env = gym.Env[np.ndarray, np.ndarray]
    Episode = Iterator[tuple[bool, float]]

FPS = 12
"""Frames a second of a GIF or MP4."""
SUFFIXES = (".html", ".gif", ".mp4", ".png")


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    estimator: str | None = None,
    world: tyro.conf.OmitArgPrefixes[World] = World(),  # noqa: B008  (frozen)
    seed: int | None = None,
    agent: str = "autopilot",
    out: Path | None = None,
    every: int = 6,
    trust: bool = False,
) -> None:
    """Watch one episode in a window or, with --out, write it to a file.

    Args:
        env_id: Registered environment.
        estimator: What the agent sees the world through, in an .html at first; the environment's
            default if not given.
        world: Options of the environment.
        seed: Seed of the episode; if not given, an .html shows the most typical of 40 episodes, all
            else seed 0.
        agent: A controller of the task (autopilot, lqg, pid), ppo (comes with the package), random,
            the path of a checkpoint, or your own as module:object, whose code is run.
        out: An .html, an interactive page on several estimators; a .gif, an .mp4, or a .png of the
            last frame.
        every: Keep one frame in this many steps (.gif and .mp4).
        trust: Load a checkpoint that vessel-gym did not write, although it can run any code.
    """
    from agents import load_agent
    from agents.files import check_file
    from agents.studies.worlds import options_of_command, registered_id

    if out is not None:
        check_suffix(out)
    with asked():
        options = options_of_command(env_id := registered_id(env_id), world.options(estimator))
        in_range("--every", every, 1)
        in_range("--seed", seed or 0, 0)
        if out is None:
            check_display()
    if out is not None and out.suffix.lower() == ".html":
        touch(env_id, agent, seed, options, trust, out)
        return
    with asked():
        env = with_pictures(env_id, "rgb_array" if out else "human", options)
        flyer = load_agent(agent, env, trust)
    if out is not None:
        check_file(out)
    with closing(env):
        flyer.reset(1)
        with asked():  # the first picture needs pygame
            observation, _ = env.reset(seed=seed or 0)
            drawn(env, env_id)
        episode = fly(env, flyer, observation)
        score = record(env, episode, out, every) if out else show(env, episode)
    print(f"wrote {out}, score {score:.3f}" if out else f"score {score:.3f}")


def touch(
    env_id: str,
    agent: str,
    seed: int | None,
    options: dict[str, Any],
    trust: bool,
    out: Path,
) -> None:
    """Write the episode on several estimators as a page."""
    from agents import episode
    from agents.files import check_file

    check_file(out)
    with asked():
        flown = episode(env_id, None, agent, seed, options, trust)
    flown.save(out)
    print(
        f"wrote {out}, score"
        f" {', '.join(f'{score:.3f} on {name}' for name, score in flown.scores.items())}"
    )


def check_suffix(out: Path) -> None:
    """Refuse a file that is neither a page nor a picture, or for whose kind an extra is missing."""
    from vessel_gym.extras import require

    with asked():
        if out.suffix.lower() not in SUFFIXES:
            raise ValueError(
                f"cannot write {str(out)!r}: the suffix must be one of {', '.join(SUFFIXES)}"
            )
    if out.suffix.lower() != ".html":
        require("imageio", "imageio_ffmpeg", "PIL")


def check_display() -> None:
    """Refuse to open a window where nobody could see it.

    Raises:
        ValueError: if there is no display.
        ModuleNotFoundError: without pygame.
    """
    from vessel_gym.extras import require

    require("pygame")
    import pygame

    try:
        with _quietly():
            pygame.display.init()
        seen = pygame.display.get_driver() != "offscreen"  # what SDL falls back to
        pygame.display.quit()
    except pygame.error:
        seen = False
    if not seen:
        raise ValueError("there is no display for a window: write a file with --out")


@contextmanager
def _quietly() -> Iterator[None]:
    """Hide what libraries in C write to stderr."""
    with open(os.devnull, "w") as nowhere:
        kept = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def fly(env: Env, agent: Any, observation: np.ndarray) -> Episode:
    """One episode; after each step, whether it has ended and the score so far, or the return of one without."""
    from agents.rollouts import acted

    done, total, shape = False, 0.0, (1, *(env.action_space.shape or ()))
    while not done:
        observation, reward, terminated, truncated, info = env.step(
            acted(agent, observation[None], shape)[0]
        )
        done, total = terminated or truncated, total + float(reward)
        yield done, info.get("score", total)


def show(env: Env, episode: Episode) -> float:
    """Show an episode in a window, which stays until the user closes it; returns the score."""
    import pygame

    score, own = 0.0, env.has_wrapper_attr("core")  # others have windows of their own
    for _, score in episode:
        if own and not pygame.display.get_init():
            return score
    while pygame.display.get_init():
        env.render()
    return score


def record(env: Env, episode: Episode, out: Path, every: int) -> float:
    """Write an episode to a file; returns the score."""
    from agents.files import replacing

    last_only = out.suffix.lower() == ".png"
    score = 0.0
    with (
        replacing(out) as path,
        closing(_writer(path)) as writer,  # imageio's own exit closes nothing on errors
        progress_bar(f"writing {out.name}", horizon(env)) as advance,
    ):
        for step, (done, so_far) in enumerate(episode):
            score = so_far
            if done or (not last_only and step % every == 0):
                writer.append_data(env.render())
            advance()
    return score


def with_pictures(env_id: str, mode: str, options: dict[str, Any]) -> Env:
    """An environment with a render mode."""
    import gymnasium as gym

    from agents.studies.worlds import options_of_command

    return gym.make(env_id, **options_of_command(env_id, {"render_mode": mode}), **options)


def drawn(env: Env, env_id: str) -> None:
    """Refuse an environment of others that cannot draw itself on this machine.

    Raises:
        ValueError: with its reason.
    """
    if env.has_wrapper_attr("core"):
        return
    try:
        env.render()
    except Exception as error:  # of whatever library it draws by
        raise ValueError(
            f"{env_id} cannot draw itself here ({error}): write an .html with --out"
        ) from error


def horizon(env: Env) -> int:
    """Steps of an episode at most."""
    if env.has_wrapper_attr("core"):
        return int(env.get_wrapper_attr("core").task.horizon)
    return (env.spec and env.spec.max_episode_steps) or 0


def _writer(path: Path) -> Any:
    import imageio.v2 as imageio

    settings: dict[str, dict[str, Any]] = {
        ".gif": {"duration": 1000.0 / FPS, "loop": 0},
        ".mp4": {"fps": FPS},
        ".png": {},
    }
    return imageio.get_writer(path, **settings[path.suffix.lower()])
