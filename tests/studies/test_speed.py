"""The benchmark: what is compared computes the same, in turns, and another version is another version."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import vessel_gym
from agents.commands.console import Refusal
from estimators import RandomKeys, names
from studies.speed import flights, timing
from studies.speed.__main__ import MARK, main
from studies.speed.baselines import (
    HandWrittenLoop,
    HandWrittenShips,
    filterpys,
    measurements,
    numpy_ensemble,
    numpy_flight,
    numpy_kalman,
    ours,
)
from studies.speed.flights import STEPS, Flight, units
from studies.speed.timing import Clock, Table, Timed, Worker, measure, shown
from studies.tables.markdown import around
from vessel_gym.core import Core
from vessel_gym.envs.thesis_corvette import THESIS_CORVETTE
from vessel_gym.wrappers.vector import EstimatedObservation

HERE = Path(vessel_gym.__file__).parents[1]
ENV = "ThesisCorvette-v0"


# --- what is compared is the same -----------------------------------------------------------------


def test_the_hand_written_loop_is_the_same_environment_on_the_same_random_numbers(
    monkeypatch: pytest.MonkeyPatch,
):
    core, loop = Core(THESIS_CORVETTE, 1, estimator="kf"), HandWrittenLoop(seed=0)
    core.start(seed=5)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, 150)
    np.testing.assert_array_equal(loop.truth, core.state[0, :6])
    loop.filter.x, loop.filter.P = core.belief.mean[0].copy(), core.belief.cov[0].copy()
    for action in actions:
        reward, _ = core.step(np.array([[action]]))
        read = RandomKeys(core.loop.sensing).at(core.steps).normals(1)[0, :, 0]
        monkeypatch.setattr(loop, "rng", _Scripted([read]))
        observation, hand_reward = loop.step(float(action))
        np.testing.assert_allclose(loop.truth, core.state[0, :6], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(loop.filter.x, core.belief.mean[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(observation, core.observe()[0], rtol=0, atol=1e-6)  # float32
        assert hand_reward == pytest.approx(reward[0], abs=1e-9)


class _Scripted:
    """Gives out the normal numbers that the package has just used, in the order of the loop's calls."""

    def __init__(self, numbers: list[np.ndarray]) -> None:
        self._numbers = iter(numbers)

    def standard_normal(self, size: int) -> np.ndarray:
        number = next(self._numbers)
        assert number.shape == (size,)
        return number


@pytest.mark.parametrize("name", ["kf", "ekf", "ukf"])
def test_the_filters_of_filterpy_compute_the_same(name: str):
    one, rival = ours(name, 1), filterpys(name)
    for y in measurements(30, 1):
        np.testing.assert_allclose(one(y), rival(y), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rows", [1, 5, 130])
def test_a_kalman_filter_in_bare_numpy_computes_the_same(rows: int):
    one, other = ours("kf", rows), numpy_kalman(rows)
    for y in measurements(30, rows):
        np.testing.assert_allclose(one(y), other(y), rtol=1e-9, atol=1e-9)


def test_ships_in_bare_numpy_move_as_one_written_by_hand():
    one, ships = HandWrittenLoop(seed=0), HandWrittenShips(seed=0)
    states = np.random.default_rng(0).normal([0, 0, 0, 8, 0, 0], [1, 1, 1, 1, 2, 0.1], (50, 6))
    states[0, 3:] = 0.0
    moved = ships.ship_step(states.T, 0.1, 0.2).T
    for state, after in zip(states, moved, strict=True):
        np.testing.assert_allclose(after, one.ship_step(state, 0.1, 0.2), rtol=1e-12, atol=1e-12)


def test_ensembles_compute_the_same_but_for_chance():
    exact, errors = ours("kf", 3), {"ours": [], "NumPy": [], "filterpy": []}
    np.random.seed(0)  # noqa: NPY002  (filterpy's)
    steps = {
        "ours": ours("enkf", 3, members=400),
        "NumPy": numpy_ensemble(3, 400),
        "filterpy": filterpys("enkf"),
    }
    for y in measurements(100, 3):
        mean = exact(y)
        for name, step in steps.items():
            errors[name].append(step(y)[0] - mean[0])
    for name, error in errors.items():
        assert np.sqrt(np.mean(np.square(error))) < (0.1 if name == "filterpy" else 0.05), (
            name
        )  # 100 members, 400


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 3])
def test_a_flight_in_bare_numpy_moves_the_belief(rows: int):
    step = numpy_flight(rows)
    first, second = step(measurements(1, rows)[0]).copy(), step(measurements(1, rows)[0])
    assert first.shape == (rows, 3)
    assert np.isfinite(second).all()
    assert (first != second).any()


def test_cart_poles_behind_a_filter_fly_alike_by_numpy_and_compiled(
    monkeypatch: pytest.MonkeyPatch,
):
    infos: list[list[np.ndarray]] = []
    for in_numpy in (False, True):
        estimates: list[np.ndarray] = []
        step = EstimatedObservation.step

        def kept(env, actions, estimates=estimates, step=step):
            *result, info = step(env, actions)
            estimates.append(info["estimate"])
            return *result, info

        with monkeypatch.context() as patched:
            patched.setattr(EstimatedObservation, "step", kept)
            timed = timing.balanced(5, "ukf", in_numpy)
            assert timed.block() > 0.0
        assert timed.units == 5 * STEPS
        infos.append(estimates)
    assert len(infos[0]) == STEPS
    assert any(
        (one != other).any() for one, other in zip(*infos, strict=True)
    )  # two ways of rounding
    for one, other in zip(*infos, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    assert timing.third_party_table((2,)).timed()


# --- how it is timed ------------------------------------------------------------------------------


def test_blocks_take_turns_and_every_other_round_goes_backwards():
    order: list[str] = []

    def timed(name: str, seconds: float) -> Timed:
        return Timed(lambda: order.append(name) or seconds, units=2)

    a, b, c = timed("a", 1e-6), timed("b", 2e-6), timed("c", 4e-6)
    times = measure([a, b, c], rounds=3)
    assert "".join(order) == "abccbaabccba"
    assert times[c].tolist() == [2.0, 2.0, 2.0]  # the first round warms up


def test_a_ratio_is_that_of_the_same_round():
    one, other = Timed(lambda: 0.0, 1), Timed(lambda: 0.0, 1)
    times = {one: np.array([1.0, 20.0, 3.0]), other: np.array([2.0, 40.0, 6.0])}
    assert shown((one, other), times) == "0.5 [0.5, 0.5]"
    assert shown(one, times) == "3 [2, 11.5]"
    assert shown(None, times) == ""


def test_what_is_compared_is_timed_once_and_side_by_side():
    a, b, c = (Timed(lambda: 0.0, 1) for _ in range(3))
    assert Table("", (), {"x": (a, c, None), "y": (c, (a, b))}).timed() == [a, b, c]


@pytest.mark.parametrize(
    ("rows", "kind", "before", "after"),
    [
        (0, "steps", {0}, {64}),
        (3, "steps", {0}, {64}),
        (3, "scattered", {0, 16}, {64, 80}),
        (3, "resets", {64}, {0}),
    ],
)
def test_a_block_has_the_steps_that_are_counted(
    rows: int, kind: str, before: set[int], after: set[int]
):
    flight = Flight(ENV, rows, "steps", estimator="truth")
    flight.block()
    flight.kind = kind
    flight.prepare()
    assert set(flight.env.unwrapped.core.steps) == before
    assert flight.fly() > 0.0
    assert set(flight.env.unwrapped.core.steps) == after
    assert units(rows, kind) == max(rows, 1) * (64 if kind != "resets" else 1)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ["SegorogeniAUV-v0", "PunaUAV-v0", ENV])
def test_hardly_an_episode_ends_in_a_block(env_id: str):
    flight = Flight(env_id, 64, estimator="ekf")
    flight.block()
    assert (flight.env.unwrapped.core.episodes > 0).sum() <= 1
    assert flight.env.unwrapped.core.steps.max() == STEPS


def test_the_parts_of_a_step_are_all_of_it_and_the_clock_leaves_nothing_behind():
    before = Core.observe, Core._moved, Core._scored
    clock = Clock(Flight(ENV, 2))
    for _ in range(2):
        seconds = clock.block()
        assert sum(clock.spent.values()) == pytest.approx(seconds)
        assert min(clock.spent.values()) > 0.0
    assert (Core.observe, Core._moved, Core._scored) == before
    assert re.fullmatch(r"\d+ %", clock.share("filter")())


# --- another version ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package that can be told from it, and knows no ukf."""
    folder = tmp_path_factory.mktemp("version")
    for package in ("vessel_gym", "estimators"):
        shutil.copytree(HERE / package, folder / package)
    factory = folder / "estimators" / "factory.py"
    factory.write_text(factory.read_text().replace("        UnscentedKalmanFilter,\n", ""))
    return folder


@pytest.fixture
def worker(folder: Path) -> Iterator[Worker]:
    worker = Worker(folder)
    yield worker
    worker.close()


@pytest.mark.nightly  # compiles all equations in its folder
def test_a_worker_flies_with_the_package_of_its_folder(worker: Worker, folder: Path):
    assert Path(worker.ask("where")).is_relative_to(folder)
    one = worker.flown(env_id=ENV, rows=2, estimator="kf")
    assert one.block() > 0.0
    assert one.units == 2 * STEPS
    with pytest.raises(Refusal, match="cannot: ValueError: unknown estimator 'ukf'"):
        worker.flown(env_id=ENV, rows=2, estimator="ukf")
    assert one.block() > 0.0


@pytest.mark.slow
def test_a_worker_that_has_ended_is_one_sentence(worker: Worker, folder: Path):
    worker.process.terminate()
    worker.process.wait()
    with pytest.raises(Refusal, match=re.escape(f"the vessel_gym in {folder} has ended")):
        worker.ask("where")
    with pytest.raises(Refusal, match="has ended"):  # which is not that it has none
        timing.flight_table(("ItsunusaAUV-v0",), worker, worker)


def test_a_folder_whose_package_cannot_be_imported_is_one_sentence(tmp_path: Path):
    (tmp_path / "vessel_gym").mkdir()
    (tmp_path / "vessel_gym" / "__init__.py").write_text("import nothing_like_it")
    with pytest.raises(
        Refusal, match="cannot: ModuleNotFoundError: No module named 'nothing_like_it'"
    ):
        Worker(tmp_path)


def test_flights_import_nothing_of_this_project_by_themselves():
    source = (HERE / "studies" / "speed" / "flights.py").read_text(encoding="utf-8")
    ours_ = re.findall(r"(?:from|import) (?:vessel_gym|estimators|agents|scripts)\S*", source)
    assert ours_ == ["import vessel_gym"]


@pytest.mark.slow
def test_the_report_has_ratios_to_the_other_version(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(timing, "BATCH", 2)
    main((ENV,), what=("flights",), against=folder, rounds=1)
    printed = capsys.readouterr().out
    for label in (
        "batch of 2, degraded sensors",
        "scattered resets",
        "a reset of one",
        "this / that",
        "batch of 8",
    ):
        assert label in printed
    assert f"That version has no {ENV}, batch of 2, ukf." in printed
    cells = next(line for line in printed.splitlines() if line.startswith(f"| {ENV}  ")).split("|")[
        2:5
    ]
    assert all(re.fullmatch(r" *\S+ \[\S+, \S+\] *", cell) for cell in cells)


# --- the report -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_report_names_all_that_is_timed_and_goes_onto_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(timing, "BATCH", 2)
    for module in (timing, flights):
        monkeypatch.setattr(module, "STEPS", 4)
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- measured -->\nold\n<!-- end -->\nafter\n")
    main(("ItsunusaAUV-v0",), rows=(1, 2), rounds=1, page=page)
    printed = capsys.readouterr().out
    assert (
        page.read_text()
        == f"before\n<!-- measured -->\n\n{printed}\n<!-- end -->\nafter\n".replace(
            "\n\n\n", "\n\n"
        )
    )
    for label in (
        "by hand",
        "gymnasium.make",
        "batch of 2",
        "times filterpy",
        "enkf in bare NumPy",
        "300 members",
        *names(),
    ):
        assert label in printed
    for part in Clock.PARTS:
        assert part in printed


@pytest.mark.parametrize("page", ["speed.md", "any-environment.md"])
def test_a_page_can_be_written_again(page: str):
    before, after = around(HERE / "docs" / page, MARK)
    assert before
    assert after


def test_a_flight_is_what_gymnasium_makes():
    assert isinstance(Flight(ENV, 0).env, gym.Wrapper)
    assert Flight(ENV, 2).env.num_envs == 2
