"""The error that commands print as one sentence, wherever it is raised."""


class Refusal(ValueError):
    """A request that cannot be met; the text says why, and what to do, in one sentence."""
