"""The page of an episode: it holds what was flown, nothing leaves it, and it works in a browser."""

import base64
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from refusals import refused

import agents
from agents import Episode, episode, load_agent
from agents.commands import watch
from agents.episodes.recording import TYPICAL, page_of
from agents.metrics import metrics, scores
from agents.rollouts import rollout
from agents.seeds import evaluation_seeds
from estimators import ExtendedKalmanFilter
from vessel_gym.rendering.components import pose
from vessel_gym.rendering.palette import DARK, LIGHT

SHIP = "SigmaCorvette-v0"
ENVS = {SHIP: False, "SegorogeniAUV-v0": True, "PunaUAV-v0": True}
"""And whether they move in space."""
BRIEF = {"max_episode_steps": 60, "disturbance": "rough"}


@pytest.fixture(scope="module", params=ENVS)
def flown(request: pytest.FixtureRequest) -> tuple[str, Episode]:
    return request.param, episode(
        request.param, ["enkf", "dead-reckoning"], seed=3, env_options=BRIEF
    )


def data(page: str) -> dict[str, Any]:
    found = re.search(
        r'<script type="application/json" id="episode">(.*?)</script>', page, re.DOTALL
    )
    assert found is not None
    return json.loads(found[1])


def unpacked(packing: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packing["float32"]), "<f4").reshape(packing["shape"])


def test_a_page_shows_the_waves_that_the_episode_drew(flown: tuple[str, Episode]):
    env_id, compared = flown
    waves = data(compared.html())["waves"]
    if env_id != SHIP:
        assert waves is None
        return
    env = gym.make(env_id, **BRIEF).unwrapped
    env.reset(seed=3)
    w, _, kx, ky = np.split(env.core.now.episode_constants[0][:96], 4)
    expected = np.arctan2(ky, kx), w / (2.0 * np.pi)
    np.testing.assert_allclose(unpacked(waves), expected, rtol=1e-6)


def test_a_page_holds_what_was_flown(flown: tuple[str, Episode]):
    env_id, compared = flown
    page = data(compared.html())
    assert page["scene"]["space"] == ENVS[env_id]
    for name, flight in zip(("enkf", "dead-reckoning"), page["flights"], strict=True):
        again = rollout("autopilot", env_id, [3], {**BRIEF, "estimator": name})
        core = again.env.unwrapped.core
        assert flight["estimator"] == name
        assert flight["score"] == again.score[0]
        figures, known = scores(again), metrics(core.config.system)
        paid = [(m.label, f"{figures[m.key][0]:.{m.decimals}f}", m.unit) for m in known if m.cost]
        assert [(each["label"], each["value"], each["unit"]) for each in flight["costs"]] == paid
        truth = pose(again.history["truth"][:, 0], core.config.true_state.names)
        np.testing.assert_allclose(unpacked(flight["true"]), truth, rtol=2e-7)
        focus = [core.config.estimation.space.names.index(key) for key in ("y", "x")]
        error = again.history["estimate"][:, 0, focus] - truth[:, [1, 0]]
        np.testing.assert_allclose(unpacked(flight["error"])[:, :2], error, rtol=1e-4, atol=1e-4)
        cov = again.history["covariance"][:, 0][:, focus][:, :, focus]
        k = len(page["focus"])
        root = unpacked(flight["root"]).reshape(-1, k, k).astype(float)
        np.testing.assert_allclose(
            (root @ root.swapaxes(1, 2))[:, :2, :2], cov, rtol=1e-5, atol=1e-9
        )
        np.testing.assert_array_equal(root, np.tril(root))
    assert page["flights"][1]["members"] is None
    assert page["flights"][0]["members"]["shape"][2] == len(page["focus"])


def test_a_task_that_nobody_has_drawn_has_its_page(flown: tuple[str, Episode]):
    from pages import OWN

    flight = episode("Docking-v0", ["ekf"], seed=1, env_options={"max_episode_steps": 20})
    assert "Docking-v0" in OWN
    assert set(flight.scores) == {"ekf"}
    assert data(flight.html())["flights"][0]["charts"]


@pytest.mark.parametrize("env_id", [SHIP, "SegorogeniAUV-v0"])
def test_window_and_page_show_same_charts_tracks_and_fixes(env_id: str):
    pytest.importorskip("pygame")
    kept = rollout("autopilot", env_id, [3], {"max_episode_steps": 12}, ensembles=True)
    page = page_of([kept], ["default"])
    env = gym.make(env_id, render_mode="rgb_array")
    observation, _ = env.reset(seed=3)
    agent = load_agent("autopilot", env)
    agent.reset(1)
    for _ in range(12):
        observation, *_ = env.step(agent.act(observation[None])[0])
    scene, (flight,) = env.unwrapped._renderer.scene, page["flights"]
    for name, drawn_line in (
        ("true", scene.true),
        ("believed", scene.believed),
        ("fix", scene.fixes),
    ):
        np.testing.assert_allclose(unpacked(flight[name]), drawn_line, rtol=2e-7)
    for chart, own in zip(flight["charts"], scene.charts(6), strict=True):
        assert chart["title"] == own.title
        for line, series in zip(chart["series"], own.series, strict=True):
            assert (line["label"], line["colour"]) == (series.label, series.colour)
            np.testing.assert_allclose(unpacked(line["value"]), series.value, rtol=1e-6)


def test_a_figure_shows_errors_of_all_estimators_in_bands(flown: tuple[str, Episode]):
    figure, page = flown[1].figure(), data(flown[1].html())
    panels = {panel.get_title("left"): panel for panel in figure.axes}
    names = [text.get_text().partition(",")[0] for text in figure.legends[0].get_texts()]
    assert names == [*flown[1].scores]
    for i, chart in enumerate(page["flights"][0]["charts"]):
        panel, bands = panels[chart["title"]], 0
        drawn = [line.get_ydata() for line in panel.get_lines()]
        for flight in page["flights"]:
            *true, line = (unpacked(each["value"]) for each in flight["charts"][i]["series"])
            if flight["charts"][i]["series"][-1]["label"] != "true":
                np.testing.assert_array_equal(drawn.pop(0), line - (true[0] if true else 0.0))
            bands += flight["charts"][i]["band"] is not None
        assert len(panel.collections) == bands
        assert not drawn


@pytest.mark.slow
@pytest.mark.parametrize("flown", [SHIP], indirect=True)
@pytest.mark.parametrize(("suffix", "begin"), [(".svg", b"<?xml"), (".PDF", b"%PDF")])
def test_a_figure_is_saved_by_its_suffix_in_equal_bytes(
    flown: tuple[str, Episode], tmp_path: Path, suffix: str, begin: bytes
):
    for stem in "ab":
        flown[1].save(tmp_path / f"{stem}{suffix}")
    written = [path.read_bytes() for path in tmp_path.iterdir()]
    assert written[0].startswith(begin)
    assert written[0] == written[1]


def test_all_estimators_begin_alike_and_meet_the_same_noise(flown: tuple[str, Episode]):
    """What a receiver reads besides the truth is nature's: the same under every estimator, wherever the vehicle is."""
    one, other = data(flown[1].html())["flights"]
    np.testing.assert_array_equal(unpacked(one["true"])[0], unpacked(other["true"])[0])
    noises = unpacked(one["fix"]), unpacked(other["fix"])
    np.testing.assert_array_equal(np.isnan(noises[0]), np.isnan(noises[1]))
    np.testing.assert_allclose(*noises, atol=2e-3)  # float32, of places hundreds of metres away
    assert np.isfinite(noises[0]).any()
    assert (unpacked(one["believed"]) != unpacked(other["believed"])).any()


def test_page_is_small_offline_and_escapes_names(flown: tuple[str, Episode]):
    page = flown[1].html()
    assert len(page) < 2_000_000
    assert not re.search(r'(src|href)\s*=\s*["\']?(https?:)?//', page)
    assert "default-src 'none'" in page
    hostile = "</script><script>alert(1)</script>"
    named = Episode({**flown[1].page, "title": hostile, "name": hostile})
    assert hostile not in named.html()
    assert data(named.html())["name"] == hostile


@pytest.mark.parametrize(
    ("env_id", "names"),
    [
        (SHIP, ["Current", "Wind", "Waves"]), ("ItsunusaAUV-v0", ["Current"]),
        ("PunaUAV-v0", ["Wind"]), ("ThesisCorvette-v0", []),
    ],
)  # fmt: skip
def test_a_page_shows_wind_waves_and_current(env_id: str, names: list[str]):
    kept = rollout("autopilot", env_id, [3], {"max_episode_steps": 5})
    found = page_of([kept], ["own"])["flights"][0]["ambient"]
    assert [each["name"] for each in found] == names
    core, truth = kept.env.unwrapped.core, kept.history["truth"][:, 0]
    if "Current" in names:
        level = [
            i for i, name in enumerate(core.config.true_state.names) if name.startswith("current")
        ]
        np.testing.assert_allclose(
            unpacked(found[0]["vector"])[:, : len(level)], truth[:, level], rtol=1e-6
        )
    if "Waves" in names:
        np.testing.assert_allclose(np.hypot(*unpacked(found[2]["vector"]).T), 1.88, rtol=1e-6)


@pytest.mark.parametrize(
    ("env_id", "given", "sentence"),
    [
        ("PunaUAV-v0", ["kfx"], "unknown estimator 'kfx'"),
        (SHIP, ["ekf", ExtendedKalmanFilter], "each estimator is shown once, got ekf, ekf"),
        ("Nope", None, "Nope"),
        ("CartPole-v1", ["ekf"], "CartPole-v1"),
        ("CartPole-v1", None, "CartPole-v1"),
        (None, None, "env_id must be the name of a registered environment, got None"),
        *(
            (SHIP, given, "estimators must be a list of one or more")
            for given in ("ekf", ExtendedKalmanFilter, 5, [], iter(["ekf"]))
        ),
    ],
)
def test_what_cannot_be_flown_is_one_sentence(env_id: Any, given: Any, sentence: str):
    with refused((ValueError, TypeError), sentence):
        episode(env_id, given)


def test_the_command_writes_the_page_and_a_notebook_shows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    flight = episode("ThesisCorvette-v0", ["kf"], env_options={"max_episode_steps": 9})
    monkeypatch.setattr(agents, "episode", lambda *a: flight)
    watch.main("ThesisCorvette-v0", out=tmp_path / "new" / "episode.HTML")
    written = (tmp_path / "new" / "episode.HTML").read_text(encoding="utf-8")
    assert "with kf" in capsys.readouterr().out
    assert flight.html() == written
    assert flight._repr_html_().startswith("<iframe srcdoc=")


CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))),
    None,
)


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium to look at the page with")
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize(("width", "webgl"), [(1280, True), (390, True), (1280, False)])
def test_page_works_in_browser_without_a_complaint(tmp_path: Path, width: int, webgl: bool):
    from playwright.sync_api import sync_playwright

    flight = episode(
        "SegorogeniAUV-v0", ["enkf", "dead-reckoning"], env_options={"max_episode_steps": 80}
    )
    flight.save(tmp_path / "episode.html")
    complaints: list[str] = []
    with sync_playwright() as driver:
        graphics = "--enable-unsafe-swiftshader" if webgl else "--disable-3d-apis"
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", graphics])
        page = browser.new_page(viewport={"width": width, "height": 800}, has_touch=True)
        page.on(
            "console",
            lambda message: complaints.append(message.text) if message.type == "error" else None,
        )
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request",
            lambda request: complaints.append(request.url) if "://" in request.url[5:] else None,
        )
        page.goto((tmp_path / "episode.html").as_uri() + "#t=2")

        def comes_to(reached: Callable[[float], bool]) -> None:
            for _ in range(200):
                if reached(float(page.input_value("#time"))):
                    return
                page.wait_for_timeout(50)
            raise AssertionError(f"the clock stands at {page.input_value('#time')}")

        def pressed() -> str:
            return page.locator("#estimators button[aria-pressed=true]").inner_text()

        comes_to(lambda time: time == 2.0)
        assert re.match(r"enkf\s+score 0\.\d{3} of 1", pressed())
        assert ("no WebGL" in page.inner_text("#note")) is not webgl
        assert (
            page.input_value("#second") == "1"
        )  # the second estimator is laid over from the start
        assert page.inner_text("#caption").startswith("Blue: where it is.")
        page.select_option("#second", "-1")
        status, costs = page.inner_text("#status"), page.inner_text("#costs")
        assert "Steering travel" in costs
        page.keyboard.press("2")
        assert pressed().startswith("dead-reckoning")
        assert page.inner_text("#status") != status
        assert page.inner_text("#costs") != costs
        page.keyboard.press("ArrowRight")
        comes_to(lambda time: time == pytest.approx(2.1))
        page.keyboard.press("End")
        comes_to(lambda time: time == pytest.approx(8.0))
        page.click("#play")  # from the end it begins anew
        page.wait_for_function(
            "0 < +document.getElementById('time').value &&"
            " +document.getElementById('time').value < 7"
        )
        page.click("#play")
        assert page.get_attribute("#play", "aria-label") == "Play"
        page.focus("#estimators button:first-child")
        page.keyboard.press("Space")  # a button with the focus is pressed: nothing plays
        assert pressed().startswith("enkf")
        assert page.get_attribute("#play", "aria-label") == "Play"
        assert "ensemble of" in page.inner_text("#legend")
        page.keyboard.press("Shift+2")
        assert page.locator("#errors li").count() == 2
        assert "position fix, dead-reckoning" in page.inner_text("#legend")
        assert "Current" in page.inner_text("#ambient")
        page.locator("#charts .u-over").first.hover()
        assert "dead-reckoning:" in page.inner_text("#tip")
        assert (
            page.eval_on_selector("#view", "view => getComputedStyle(view).touchAction") == "pan-y"
        )
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        page.locator("#view").hover()
        page.mouse.wheel(0, 99)  # a page higher than the window scrolls, also over the scene
        page.wait_for_function(
            "scrollY > 0 || document.documentElement.scrollHeight <= innerHeight"
        )
        browser.close()
    assert [complaint for complaint in complaints if webgl or "WebGL" not in complaint] == []


@pytest.mark.nightly
@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium to look at the page with")
def test_page_explains_estimate_that_beats_truth(tmp_path: Path):
    from playwright.sync_api import sync_playwright

    names, options = ["ekf", "truth"], {"max_episode_steps": 20}
    page_data = episode(SHIP, names, env_options=options).page
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        for score in (0.4, 0.2):
            flights = [each | {"score": 0.3} for each in page_data["flights"]]
            flights[0]["score"] = score
            Episode(page_data | {"flights": flights}).save(tmp_path / f"{score}.html")
            page.goto((tmp_path / f"{score}.html").as_uri() + "#t=2")
            assert page.get_attribute("#follow", "aria-pressed") == "true"
            assert ("ekf scores 0.100 more" in page.inner_text("#luck")) is (score > 0.3)
        browser.close()


def test_without_seed_most_typical_episode_is_shown():
    names, options = ["ekf", "dead-reckoning"], {"max_episode_steps": 30}
    seeds = evaluation_seeds(TYPICAL)
    flown = [rollout("autopilot", SHIP, seeds, options | {"estimator": name}) for name in names]
    off = [abs(each.score - each.score.mean()) / each.score.std() for each in flown]
    seed = seeds[int((off[0] ** 2 + off[1] ** 2).argmin())]
    found = episode(SHIP, names, "autopilot", None, options)
    assert f"seed {seed}" in found.page["conditions"]


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ({}, ["kf-umv-ui", "truth"]),
        ({"estimator": "truth"}, ["truth"]),
        ({"estimator": "enkf", "estimator_options": {"members": 30}}, ["enkf", "truth"]),
    ],
)
def test_unless_named_the_second_estimator_is_the_truth(given: dict[str, Any], names: list[str]):
    assert [*episode(SHIP, env_options=BRIEF | given).scores] == names


def luminance(colour: str) -> float:
    """Relative luminance of ``#rrggbb`` (WCAG 2.2)."""
    parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("named", [LIGHT, DARK], ids=["light", "dark"])
def test_words_and_marks_stand_out_from_what_they_stand_on(named: dict[str, str]):
    """As WCAG 2.2 asks (AA): words 4.5 to 1, marks 3 to 1."""
    words, marks = (
        ("ink", "muted"),
        ("true", "believed", "second", "member", "measurement", "commanded", "goal", "obstacle"),
    )
    for name in (*words, *marks):
        for ground in ("paper", "page", "water"):
            dark, light = sorted(luminance(named[each]) for each in (name, ground))
            least = 4.5 if name in words else 3.0
            assert (light + 0.05) / (dark + 0.05) >= least, (name, ground)
