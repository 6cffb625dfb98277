"""Pages of logs and of voyages hold what was measured and estimated, need no network, and work in a browser."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.episodes.logs import log_page
from agents.episodes.page import FRAMES, Page, unpacked
from agents.episodes.voyages import voyage_page
from tests.vessel_gym.identification.voyages import SHIP, coefficients, trial, write
from vessel_gym.identification.consistency import Verdict, nis_of
from vessel_gym.identification.filtering import (
    NOISE,
    SENSORS,
    Estimates,
    Voyage,
    estimate,
    noise_of,
    start_noise,
    voyages,
)
from vessel_gym.logs import Channel, Log, read
from vessel_gym.logs.inspection import inspect
from vessel_gym.vehicles.measured_ship import MeasuredShip


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """A log of 500 rows with a damaged one, a gap and a jump."""
    rng, path = np.random.default_rng(0), tmp_path_factory.mktemp("log") / "log.csv"
    write(path, trial(rng, coefficients(rng, 0.2), 100.0))
    lines = path.read_text().splitlines()
    lines[200] = "oops" + lines[200][lines[200].index(",") :]
    fields = lines[100].split(",")
    lines[100] = ",".join([fields[0], str(float(fields[1]) + 5.0), *fields[2:]])
    path.write_text("\n".join([*lines[:300], *lines[330:]]))
    return read(path)


@pytest.fixture(scope="module")
def judged(log: Log) -> tuple[Voyage, list[tuple[str, Estimates, Verdict]]]:
    """The longest part of the log, and two filters on it."""
    ship = MeasuredShip.assumed(SHIP)
    ship = replace(ship, noise=dict(zip(NOISE, start_noise(ship, 15.0).tolist(), strict=True)))
    voyage = max(voyages(log, 0.4), key=lambda each: len(each.u))
    verdict = Verdict(0.9, 1.1, 0.0, 0.1, {"position": 0.95}, {"position": 1.0}, 100)
    return voyage, [(name, estimate(name, ship, voyage, noise_of(ship)), verdict) for name in ("ekf", "huber-kf")]


def data(page: Page) -> dict[str, Any]:
    """What the document of a page holds; NaN would be no JSON."""
    found = re.search(r'<script type="application/json" id="episode">(.*?)</script>', page.html(), re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def charts(page: dict[str, Any], flight: int = 0) -> dict[str, dict[str, Any]]:
    return {chart["title"]: chart for chart in page["flights"][flight]["charts"]}


def test_a_page_of_a_log_holds_each_channel_with_its_faults(log: Log) -> None:
    findings = inspect(log)
    page = data(log_page(log, findings))
    drawn = charts(page)
    assert list(drawn) == [f"{channel.name} [{channel.unit}]" for channel in log.channels.values()]
    line = unpacked(drawn["x [m]"]["series"][0]["value"])
    times, values = log["x"].measured()
    index = np.round((times - log.span[0]) / page["dt"]).astype(int)
    np.testing.assert_allclose(line[index], values, rtol=1e-6)
    before, grid = int(np.argmax(np.diff(times))), log.span[0] + page["dt"] * np.arange(len(line))
    gap = (grid > times[before] + 0.1) & (grid < times[before + 1] - 0.1)
    assert np.isnan(line[gap]).all()
    assert gap.sum() > 20
    listed = [fault for chart in drawn.values() for fault in chart["faults"]] + page["faults"]
    assert sorted(each["line"] for each in listed) == [each.line for each in findings]
    (jump,) = [each for each in drawn["x [m]"]["faults"] if each["line"] == 101]
    assert "jumps by" in jump["text"]
    assert abs(jump["at"] - (log["x"].times[99] - log.span[0])) < 0.3
    assert any("is no number" in each["text"] and each["line"] == 201 for each in page["faults"])


def test_a_page_of_many_rows_is_small_and_keeps_every_extreme() -> None:
    """A single wild value among 50,000 is within what is drawn."""
    count = 50_000
    values = np.sin(np.arange(count) / 3000.0)
    values[31_234] = 9.0
    t, lines = 0.1 * np.arange(count), np.arange(2, count + 2)
    one = Log("long.csv", {"x": Channel("x", t, values, lines), "y": Channel("y", t, 0.0 * values, lines)})
    page = log_page(one, [])
    assert len(page.html()) < 400_000
    chart = charts(data(page))["x [m]"]
    low, high = map(unpacked, chart["band"])
    assert len(low) == FRAMES
    assert high.max() == 9.0
    assert chart["limits"][1] > 9.0
    np.testing.assert_allclose(low.min(), values.min(), rtol=1e-6)
    assert charts(data(page))["y [m]"]["band"] is None


def test_a_page_of_a_log_without_numbers_in_a_channel_lists_its_fault() -> None:
    t, lines = np.arange(30.0), np.arange(2, 32)
    one = Log("log.csv", {"x": Channel("x", t, t, lines), "y": Channel("y", t, np.full(30, np.nan), lines)})
    page = data(log_page(one, inspect(one)))
    assert list(charts(page)) == ["x [m]"]
    assert [(each["line"], each["text"]) for each in page["faults"]] == [(2, "y: 30 rows without a number")]


def test_a_page_of_a_voyage_holds_what_the_filters_estimate(judged: tuple[Voyage, list[Any]]) -> None:
    voyage, filters = judged
    page = data(voyage_page(SHIP.length, *judged))
    assert (page["truth"], page["scene"]["hull"], page["scene"]["size"]) == (False, "ship", SHIP.length)
    for i, (name, series, _) in enumerate(filters):
        flight, drawn = page["flights"][i], charts(page, i)
        assert (flight["estimator"], flight["verdict"]) == (name, "NIS inside 90 %, trusted")
        mean, sd = np.asarray(series.mean), np.sqrt(np.einsum("tii->ti", np.asarray(series.cov)))
        np.testing.assert_allclose(unpacked(flight["believed"])[:, :2], mean[:, :2], rtol=1e-5, atol=1e-5)
        fix = unpacked(flight["fix"]) + mean[:, [1, 0]]
        came = np.isfinite(voyage.y[:, :2]).all(1)
        np.testing.assert_allclose(fix[came], voyage.y[came][:, [1, 0]], atol=1e-4)
        assert np.isnan(fix[~came]).all()
        root = unpacked(flight["root"]).astype(float)
        cov = np.asarray(series.cov)[:, [1, 0]][:, :, [1, 0]]
        np.testing.assert_allclose(root @ root.swapaxes(1, 2), cov, rtol=1e-4, atol=1e-9)
        surge = drawn["Surge [m/s]"]
        np.testing.assert_allclose(unpacked(surge["series"][0]["value"]), mean[:, 3], rtol=1e-5, atol=1e-6)
        low, high = map(unpacked, surge["band"])
        np.testing.assert_allclose(high - low, 4.0 * sd[:, 3], rtol=1e-4, atol=1e-6)
        gyro = unpacked(drawn["Yaw rate [°/s]"]["measured"])
        np.testing.assert_allclose(gyro, np.rad2deg(voyage.y[:, SENSORS.index("yaw rate")]), rtol=1e-4, atol=1e-5)
        square, count = nis_of(series)
        np.testing.assert_allclose(
            unpacked(drawn["NIS"]["series"][0]["value"])[count > 0], square[count > 0], rtol=1e-5
        )
        assert len([title for title in drawn if title.startswith("Innovation of")]) == 4
        assert len([title for title in drawn if title.startswith("Unexplained ")]) == 3
    html = voyage_page(SHIP.length, *judged).html()
    assert not re.search(r'(src|href)\s*=\s*["\']?(https?:)?//', html)
    assert "three.js" not in html


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium to look at the page with")
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize("width", [1280, 390])
def test_in_a_browser_both_rest_at_their_end_and_lead_to_faults(
    tmp_path: Path, width: int, log: Log, judged: tuple[Voyage, list[Any]]
) -> None:
    from playwright.sync_api import sync_playwright

    log_page(log, inspect(log)).save(tmp_path / "log.html")
    voyage_page(SHIP.length, *judged).save(tmp_path / "voyage.html")
    complaints: list[str] = []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": 800})
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: complaints.append(request.url) if "://" in request.url[5:] else None)
        page.goto((tmp_path / "log.html").as_uri())
        assert float(page.input_value("#time")) == pytest.approx(float(page.get_attribute("#time", "max") or "nan"))
        assert not page.is_visible("#estimators")
        page.locator("#charts .faults button", has_text="line 10").first.click()
        page.wait_for_function("+document.getElementById('time').value < 25")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.goto((tmp_path / "voyage.html").as_uri())
        assert "ekf\nNIS inside 90 %, trusted" in page.locator("#estimators button").first.inner_text()
        words = page.inner_text("#status")
        assert "truth" not in words
        assert "±" in words
        page.keyboard.press("Shift+2")  # an overlay of the same voyage: one truth, if unknown
        assert not page.is_visible("#overlay-note")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        browser.close()
    assert complaints == []
