"""Ranges of tunable parameters."""

import numpy as np
import pytest
from refusals import refused

from estimators import Linear, Log
from estimators.tunable import check_parameters, defaults

RANGES = pytest.mark.parametrize("span", [Log(0.005, 0.5), Linear(-2.0, 3.0)])


@RANGES
def test_a_share_of_a_range_and_a_value_are_inverse(span: Linear):
    shares = np.linspace(-0.5, 1.5, 9)
    values = [span.from_unit(share) for share in shares]
    np.testing.assert_allclose([*map(span.to_unit, values)], shares, atol=1e-12)
    assert (np.diff(values) > 0.0).all()
    np.testing.assert_allclose([span.from_unit(0.0), span.from_unit(1.0)], [span.low, span.high])


def test_equal_shares_are_equal_factors_or_equal_differences():
    factors = [Log(0.1, 10.0).from_unit(share) for share in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(factors, [0.1, 1.0, 10.0])
    assert Linear(0.0, 10.0).from_unit(0.5) == 5.0


@pytest.mark.parametrize("kind", [Log, Linear])
def test_ranges_upside_down_or_without_end_are_refused(kind: type[Linear]):
    with refused(ValueError, "^high of a range must be a finite number above its low, 2, got 1"):
        kind(2.0, 1.0)
    for bounds in ((np.nan, 1.0), (1.0, np.inf), (1.0, 1.0), ("1", 2.0)):
        with refused(ValueError, "^(low|high) of a .*range must be a finite number"):
            kind(*bounds)
    with refused(ValueError, "^low of a logarithmic range must be a finite number above 0, got 0"):
        Log(0.0, 1.0)


def test_parameters_that_cannot_be_tuned_are_refused():
    ranges = {"heading": Log(0.005, 0.5), "offset": Linear(-1.0, 1.0)}
    check_parameters("autopilot", ranges, {"heading": 40.0, "offset": -40.0})
    with refused(ValueError, "^unknown parameter of autopilot 'head' .*'heading'.*: choose from"):
        check_parameters("autopilot", ranges, {"head": 1.0})
    for value in (0.0, -1.0, np.inf, np.nan, True, "1"):
        with refused(ValueError, "^heading of autopilot must be a finite number above 0, got"):
            check_parameters("autopilot", ranges, {"heading": value})
    with refused(ValueError, "^offset of autopilot must be a finite number, got nan"):
        check_parameters("autopilot", ranges, {"offset": np.nan})


def test_what_is_tunable_has_a_range_and_a_default():
    def controller(system: object, gain: float = 2.0, other: float = -1.0, *, last: float) -> None:
        """A controller by a function."""

    assert defaults("mine", controller) == {}
    for ranges, said in (
        ({"gain": Log(0.1, 9.0), "other": Linear(-2.0, 2.0)}, ""),
        ({"gain": (0.1, 9.0)}, r"tunable of mine needs a range of gain, .*, got \(0.1, 9.0\)"),
        ({"last": Log(0.1, 9.0)}, "mine has last in tunable: it must take last with a default"),
        ({"none": Log(0.1, 9.0)}, "mine has none in tunable: it must take none with a default"),
        ({"other": Log(0.1, 9.0)}, "other of mine must be a finite number above 0, got -1.0"),
    ):
        controller.tunable = ranges  # type: ignore[attr-defined]
        if not said:
            assert defaults("mine", controller) == {"gain": 2.0, "other": -1.0}
            continue
        with refused(ValueError, said):
            defaults("mine", controller)
