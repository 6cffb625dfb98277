"""The figures of a report: one look for each estimator, and nothing drawn that was not flown."""

import numpy as np
import pytest
from invented import CONDITIONS, CORVETTE, SEGOROGENI, learned, results, study, without

from agents.page import Prose
from agents.statistics import Interval
from agents.studies.cost import cost_figure
from agents.studies.figures import Look, Row, dots, looks, policy_looks
from agents.studies.learning import profile_figure, transfer_figure
from agents.studies.records import Condition
from agents.studies.robustness import along, robustness, robustness_figure, varied


@pytest.fixture(scope="module")
def found():
    return learned()


@pytest.mark.slow
def test_no_two_estimators_look_alike(found):
    look = looks(found)
    assert list(look) == found.flown_on()
    assert len({(each.colour, each.mark, each.line) for each in look.values()}) == len(look)
    assert len(
        {(each.colour, each.mark, each.line) for each in policy_looks(found).values()}
    ) == len(found.schools())


@pytest.mark.slow
def test_an_axis_is_made_of_the_conditions_that_differ_in_it_alone(found):
    assert [c.name for c in along(found, "disturbance")] == ["calm", "nominal", "rough"]
    assert [c.name for c in along(found, "sensors")] == [
        "nominal"
    ]  # "all wrong" differs in the mismatch, too
    graded = results(
        study(
            (CORVETTE,),
            conditions=(CONDITIONS[0], Condition("b", mismatch=0.2), Condition("a", mismatch=0.1)),
        )
    )
    assert [c.mismatch for c in along(graded, "mismatch")] == [0.0, 0.1, 0.2]


@pytest.mark.slow
def test_curves_are_drawn_for_the_axes_that_vary_and_for_no_other(found):
    panels = robustness_figure(found, varied(found)).axes
    assert len(panels) == 2
    assert panels[-1].get_xlabel() == "disturbance"
    assert [t.get_text() for t in panels[-1].get_xticklabels()] == ["calm", "moderate", "rough"]
    (text,) = robustness(results(study((CORVETTE,), conditions=CONDITIONS[:1]))).blocks
    assert isinstance(text, Prose)


def test_every_point_of_costs_is_named_once_above_the_panels(found):
    figure = cost_figure(found)
    flown = {e: found.estimators(e, found.classical) for e in found.environments}
    assert {
        p.get_title(loc="left"): [c.get_label() for c in p.containers] for p in figure.axes
    } == flown
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sorted(names) == sorted(set().union(*flown.values()))


def test_without_times_there_is_no_figure_of_costs(found):
    assert cost_figure(type(found)(found.plan, found.values)) is None


def test_the_framed_cell_of_a_transfer_is_that_of_the_training(found):
    for panel in transfer_figure(found, "PPO").axes:
        on = [label.get_text() for label in panel.get_xticklabels()]
        trained = [label.get_text() for label in panel.get_yticklabels()]
        framed = {(round(box.get_x() + 0.5), round(box.get_y() + 0.5)) for box in panel.patches}
        assert framed == {(on.index(name), row) for row, name in enumerate(trained)}
    assert transfer_figure(without(found, lambda f: f.agent == "PPO"), "PPO") is None


def test_profiles_fall_from_all_runs_to_none(found):
    for panel in profile_figure(found).axes:
        for line in panel.lines:
            shares = line.get_ydata()
            assert shares[0] == 1.0
            assert shares[-1] == 0.0
            assert np.all(np.diff(shares) <= 0.0)


def test_a_dot_is_where_its_value_is_and_what_is_missing_is_not_drawn():
    rows = [
        Row("a", Look("k", "o"), [Interval(0.5, 0.4, 0.8), 0.2]),
        Row("b", Look("k", "s"), [None, None]),
    ]
    first, second = dots(rows, ["x", "y"], "share").axes
    assert [c.lines[0].get_xdata()[0] for panel in (first, second) for c in panel.containers] == [
        0.5,
        0.2,
    ]


def test_environments_keep_their_order(found):
    assert [p.get_title(loc="left") for p in cost_figure(found).axes] == [CORVETTE, SEGOROGENI]
