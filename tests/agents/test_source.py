import itertools
import subprocess
import sys
from importlib import invalidate_caches
from types import SimpleNamespace

import pytest

from agents import source
from agents.source import source_digest

names = (f"package_{number}" for number in itertools.count())


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A function that gives the digest of a user's module, which imports others beside it, some module changed."""
    number = next(names)
    filters, gains, deep, pack, open_ = (
        f"{number}_{name}" for name in ("filters", "gains", "deep", "pack", "open")
    )
    monkeypatch.syspath_prepend(tmp_path)
    for package in (pack, open_):
        (tmp_path / package).mkdir()
    written = {
        "filters": (
            f"{filters}.py",
            f"import numpy\nimport json\nimport {gains}\nimport {pack}.inner, {open_}.part\n",
        ),
        "gains": (f"{gains}.py", f"def late():\n    from {deep} import K\n"),
        "deep": (f"{deep}.py", "K = 1\n"),
        "pack": (f"{pack}/__init__.py", "scale = 2\n"),
        "inner": (f"{pack}/inner.py", "from . import relative\n"),
        "relative": (f"{pack}/relative.py", f"import {filters}\n"),  # a circle
        "part": (f"{open_}/part.py", ""),  # of a package without __init__.py
        "beside": (f"{number}_beside.py", "unused = 1\n"),
    }

    def digest(changed: str = "") -> str:
        for name, (path, text) in written.items():
            (tmp_path / path).write_text(text + ("changed = True\n" if name == changed else ""))
        invalidate_caches()
        source_digest.cache_clear()
        return source_digest(filters)

    yield digest
    source_digest.cache_clear()


@pytest.mark.parametrize(
    "module", ["filters", "gains", "deep", "pack", "inner", "relative", "part"]
)
def test_digest_of_user_module_follows_its_imports(own, module):
    assert own(module) != own()


def test_digest_ignores_modules_that_are_not_imported(own):
    assert own("beside") == own()


@pytest.mark.slow
def test_digest_ignores_installed_modules():
    code = (
        "import sys; from agents import source; found ="
        " source._sources('agents.training.algorithms'); assert"
        " 'agents.policies.network' in found and all(name.split('.')[0] == 'agents' for name in"
        " found), found; assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_module_that_is_not_there_is_an_error():
    with pytest.raises(ValueError, match="there is no module agents\\.nowhere"):
        source_digest("agents.nowhere")


@pytest.mark.parametrize("file", ["estimators/kf.py", "vessel_gym/vehicles/data/ship.toml"])
def test_all_of_the_lower_layers_counts(tmp_path, monkeypatch, file):
    package, _, below = file.partition("/")
    places = SimpleNamespace(submodule_search_locations=[str(tmp_path)])
    usual = source.find_spec
    monkeypatch.setattr(
        source, "find_spec", lambda name: places if name == package else usual(name)
    )
    path = tmp_path / below
    path.parent.mkdir(parents=True, exist_ok=True)
    digests = set()
    for text in ("a = 1", "a = 2"):
        path.write_text(text)
        source_digest.cache_clear()
        digests.add(source_digest("agents.seeds"))
    source_digest.cache_clear()
    assert len(digests) == 2
