"""The page on anybody's environments: its code runs."""

import pytest
from pages import blocks

CODE = blocks("any-environment", "python")


@pytest.mark.parametrize("code", CODE, ids=range(len(CODE)))
def test_an_example_runs_as_it_stands(code: str):
    for name, library in (("InvertedPendulum", "mujoco"), ("LunarLander", "Box2D")):
        if name in code:
            pytest.importorskip(library)
    exec(compile(code, "docs/any-environment.md", "exec"), {"__name__": "page"})


def test_there_are_three_complete_examples_and_one_of_a_batch():
    assert len(CODE) == 4
