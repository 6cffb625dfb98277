"""Floors of the house, the way of a step through it, and names that are the field's."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import vessel_gym  # noqa: F401, registers the environments
from estimators import engine

ROOT = Path(__file__).parents[1]
FLOORS = ("estimators", "vessel_gym", "agents", "scripts")
"""A folder imports those before it, and never those behind it."""
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for floor in FLOORS
    for path in sorted((ROOT / floor).rglob("*.py"))
}

PRIVATE = {
    "reading", "readings", "noted", "informs", "arrivals", "attach", "forcing", "kick", "kicks", "stir", "spoil",
    "tally",
    "neutralised", "climbed", "ladder", "rung", "settled", "straightened", "suiting", "retimed", "sheet", "sheets",
    "pilot", "pilots", "anybody", "handed", "told", "shown", "begun",
}  # fmt: skip
"""Words that once stood for a term of the field: docs/glossary.md has the terms."""


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(MODULES[module].read_text(encoding="utf-8"))


@cache
def imports(module: str, late: bool) -> set[str]:
    """Modules of the package that a module imports, for types too; ``late``: those within functions as well."""
    found: set[str] = set()

    def visit(node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                found.update(name.name for name in child.names)
            elif isinstance(child, ast.ImportFrom):
                names = {f"{child.module}.{name.name}" for name in child.names}
                found.update(names & MODULES.keys())
                if names - MODULES.keys():
                    found.add(str(child.module))
            elif late or not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                visit(child)

    visit(tree(module))
    return (found & MODULES.keys()) - {module}


def test_no_module_imports_itself_through_others() -> None:
    try:
        graph = {  # registries of agents load entries late
            module: imports(module, late=not module.startswith("agents")) for module in MODULES
        }
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_no_folder_imports_one_above_it() -> None:
    floor = {module: FLOORS.index(module.split(".")[0]) for module in MODULES}
    upward = [
        (one, other)
        for one in MODULES
        for other in imports(one, late=True)
        if floor[other] > floor[one]
    ]
    assert upward == []


def test_engine_is_imported_by_its_public_names() -> None:
    inside = [
        (module, f"{node.module}.{name.name}")
        for module in MODULES
        if not module.startswith("estimators.engine")
        for node in ast.walk(tree(module))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("estimators.engine")
        for name in node.names
        if node.module != "estimators.engine" or name.name not in engine.__all__
    ]
    assert inside == []


def identifiers(path: Path) -> Iterator[str]:
    """Names in a file's code, without comments and strings."""
    source = io.StringIO(path.read_text(encoding="utf-8"))
    return (
        token.string
        for token in tokenize.generate_tokens(source.readline)
        if token.type == tokenize.NAME
    )


def test_names_are_of_the_field() -> None:
    private = {
        (module, name)
        for module, path in MODULES.items()
        for name in identifiers(path)
        for word in re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower().split("_")
        if word in PRIVATE
    }
    assert not private
