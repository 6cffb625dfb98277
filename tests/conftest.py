"""Hypothesis draws the same examples in every run; ``--hypothesis-profile thorough`` draws many more."""

from hypothesis import settings

settings.register_profile("default", derandomize=True, deadline=None)
settings.register_profile("thorough", derandomize=True, deadline=None, max_examples=10_000)
settings.load_profile("default")
