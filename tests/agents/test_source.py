import itertools
from importlib import invalidate_caches

import pytest

import estimators
import vessel_gym
from agents import source
from agents.source import source_digest

MODULES = {
    "__init__": "",
    "work": "import numpy\nfrom {0} import helper\nfrom {0}.constants import g\nimport json\n",
    "helper": "def late():\n    import {0}.deep\n",
    "deep": "from . import relative\n",
    "relative": "x = 1\n",
    "constants": "g = 9.81\n",
    "report": "import {0}.work\n",
}
names = (f"package_{number}" for number in itertools.count())


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A function that gives the digest of a package's module ``work``, some module changed."""
    monkeypatch.syspath_prepend(tmp_path)
    name = next(names)
    (tmp_path / name).mkdir()

    def digest(**changed: str) -> str:
        for module, text in (MODULES | changed).items():
            (tmp_path / name / f"{module}.py").write_text(text.format(name))
        invalidate_caches()
        source_digest.cache_clear()
        return source_digest(f"{name}.work")

    yield digest
    source_digest.cache_clear()


@pytest.mark.parametrize("module", ["work", "helper", "deep", "relative", "constants"])
def test_the_digest_changes_with_what_a_module_uses(package, module):
    assert package(**{module: MODULES[module] + "y = 2\n"}) != package()


def test_the_digest_does_not_change_with_what_a_module_does_not_use(package):
    assert package(report="changed = True\n") == package()


def test_the_digest_is_the_same_again(package):
    assert package() == package()


def test_a_circle_of_imports_ends(package):
    assert package(relative="import {0}.work\n") != package()


@pytest.mark.parametrize(
    ("layer", "file", "counts"),
    [("estimators", "kf.py", True), ("vessel_gym", "core.py", True), ("vessel_gym", "rendering/__init__.py", False)],
)
def test_all_of_the_lower_layers_counts_but_the_pictures(tmp_path, monkeypatch, layer, file, counts):
    package = {"estimators": estimators, "vessel_gym": vessel_gym}[layer]
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    monkeypatch.setattr(package, "__file__", str(tmp_path / "__init__.py"))
    digests = []
    for text in ("a = 1\n", "a = 2\n"):
        path.write_text(text)
        source_digest.cache_clear()
        digests.append(source_digest(source.__name__))
    source_digest.cache_clear()
    assert (digests[0] != digests[1]) == counts


def test_a_module_that_is_not_there_is_an_error():
    with pytest.raises(ValueError, match="there is no module agents\\.nowhere"):
        source_digest("agents.nowhere")


@pytest.mark.parametrize("module", source._AROUND)
def test_what_keeps_and_shows_results_is_left_out_of_what_computes_them(module):
    imported = source._closure("agents.reproduction.segorogeni", "agents", {})
    assert source._is_module(module)
    assert not any(name.startswith(module) for name in imported)
