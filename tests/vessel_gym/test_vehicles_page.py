"""The page on vehicle files: its example runs as it stands, and its tables know the keys that there are."""

import re
from pathlib import Path

import pytest

from vessel_gym.vehicles.files import load, names
from vessel_gym.vehicles.hydrodynamics import Coefficients
from vessel_gym.vehicles.puna import PunaParameters
from vessel_gym.vehicles.rov import ROVParameters
from vessel_gym.vehicles.segorogeni import SegorogeniParameters

PAGE = (Path(__file__).parents[2] / "docs" / "vehicles.md").read_text(encoding="utf-8")


def test_the_example_runs_as_it_stands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_ship.toml").write_text(re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL)[1])
    for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(code, "docs/vehicles.md", "exec"), {"__name__": "page"})
    assert re.fullmatch(r"rudder \d+ deg: radius \d+ m, [\d.]+ m/s\n", capsys.readouterr().out)


def test_the_sentences_on_mistakes_are_those_that_are_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL)[1]
    said = []
    for old, new in (("length", "lenght"), ("0.9e6", "900")):
        (tmp_path / "my_ship.toml").write_text(text.replace(old, new, 1))
        with pytest.raises(ValueError, match="my_ship") as caught:
            load("my_ship.toml")
        said.append(str(caught.value))
    printed = re.findall(r"^my_ship\.toml, line .*$", PAGE, re.MULTILINE)
    assert len(printed) == len(said) == 2
    for ours, theirs in zip(said, printed, strict=True):
        assert ours.startswith(theirs.removesuffix(", ..."))


def test_every_key_and_every_vehicle_is_on_the_page():
    for cls in (type(load("corvette")), SegorogeniParameters, PunaParameters, ROVParameters):
        for key in cls.file_keys():
            assert f"`{key}`" in PAGE or key in Coefficients._fields, key
    for name in names():
        assert f"| `{name}` |" in PAGE
