"""Refusals of bad input: an exception whose message is one sentence on one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

Expected = type[Exception] | tuple[type[Exception], ...]


@contextmanager
def refused(expected: Expected, match: str) -> Iterator[None]:
    """Around what must be refused with a message on one line in which the pattern is found."""
    with pytest.raises(expected, match=match) as caught:
        yield
    assert "\n" not in str(caught.value)


def refusal(expected: Expected, call: Any, *args: Any, **kwargs: Any) -> str:
    """The message of the exception that a call raises, of a readable length."""
    with pytest.raises(expected) as caught:
        call(*args, **kwargs)
    message = str(caught.value)
    assert "\n" not in message
    assert 10 < len(message) < 350, message
    return message
