"""`vessel-gym watch` writes pictures and films, and refuses in one sentence what the machine cannot write."""

from pathlib import Path

import gymnasium as gym
import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest

pytest.importorskip("pygame")

import agents
from agents.commands import watch
from agents.commands.console import command

STEPS = 8


class Helmsman:
    """Steers on the heading error."""

    def reset(self, num_envs):
        self.acted = 0

    def act(self, observations):
        self.acted += 1
        return np.clip(observations[:, :1], -1.0, 1.0)


@pytest.fixture(autouse=True)
def short_episodes(monkeypatch):
    make = gym.make
    monkeypatch.setattr(
        gym, "make", lambda *args, **kwargs: make(*args, max_episode_steps=STEPS, **kwargs)
    )
    monkeypatch.setattr(agents, "load_agent", lambda name, env: Helmsman())


def run(*words):
    """The exit status of a command line."""
    try:
        command(watch.main, words)
    except SystemExit as error:
        return error.code
    return 0


@pytest.mark.slow
@pytest.mark.parametrize(("suffix", "frames"), [(".gif", 3), (".mp4", 3), (".PNG", 1)])
def test_file_holds_frames_asked_for_and_nothing_else_is_left(tmp_path, suffix, frames):
    out = tmp_path / f"turn{suffix}"
    assert run("SigmaCorvette-v0", "--out", str(out), "--every", "5", "--estimator", "kf") == 0
    assert [p.name for p in tmp_path.iterdir()] == [out.name]
    if suffix == ".mp4":
        assert imageio_ffmpeg.count_frames_and_secs(str(out)) == (
            frames,
            pytest.approx(frames / watch.FPS, abs=0.01),
        )
    else:
        images = iio.imread(out, index=...)
        assert images.shape == (frames, 720, 1008, 3)
        assert images.std() > 1.0


def test_the_picture_is_of_the_end_of_the_episode(tmp_path):
    out = tmp_path / "end.png"
    assert run("--out", str(out), "--seed", "3") == 0
    env = gym.make("SigmaCorvette-v0", render_mode="rgb_array")
    agent = Helmsman()
    agent.reset(1)
    observation, _ = env.reset(seed=3)
    for _ in range(STEPS):
        observation = env.step(agent.act(observation[None])[0])[0]
    assert (iio.imread(out) == env.render()).all()


@pytest.mark.parametrize("suffix", [".gif", ".mp4", ".png"])
def test_a_film_that_fails_half_way_leaves_the_old_one_alone(tmp_path, monkeypatch, suffix):
    class Broken(Helmsman):
        def act(self, observations):
            if self.acted == 4:
                raise KeyboardInterrupt
            return super().act(observations)

    monkeypatch.setattr(agents, "load_agent", lambda name, env: Broken())
    out = tmp_path / f"turn{suffix}"
    out.write_bytes(b"old")
    assert run("--out", str(out)) == 130
    assert [p.name for p in tmp_path.iterdir()] == [out.name]
    assert out.read_bytes() == b"old"


@pytest.mark.parametrize(
    ("method", "error"),
    [
        ("write_bytes", PermissionError(13, "Permission denied")),
        ("replace", OSError(28, "No space left on device")),
    ],
)
def test_missing_permission_or_full_disk_is_one_sentence(
    tmp_path, monkeypatch, capsys, method, error
):
    def refuse(*arguments):
        raise error

    monkeypatch.setattr(Path, method, refuse)
    assert run("--out", str(tmp_path / "turn.png")) == 2
    assert f"{error.strerror}\n" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
