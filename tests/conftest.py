"""Hypothesis draws the same examples every time; ``--hypothesis-profile thorough`` draws ten thousand."""

from hypothesis import settings

settings.register_profile("default", derandomize=True, deadline=None)
settings.register_profile("thorough", settings.get_profile("default"), max_examples=10_000)
settings.load_profile("default")
