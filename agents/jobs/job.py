"""A job of work: a pure function, its arguments, and the key that both and their code give."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import vessel_gym
from agents.source import source_digest

LIBRARIES = ("numpy", "scipy", "llvmlite")
"""Whose versions results depend on."""


@dataclass(frozen=True, eq=False)
class Job:
    """A pure function and everything that its result depends on.

    Attributes:
        function: ``"module:name"``. It is called with the arguments and returns values by name:
            JSON values or arrays of numbers. A value named ``timing`` depends on the machine: it
            goes to the journal, not to the result.
        arguments: Keyword arguments, JSON values. The function gets what JSON makes of them: lists
            for tuples.
        label: What it is, for people. Jobs with the same label take about the same time.
        needs: Jobs whose artifacts the function reads; it gets their paths as ``needs``.
        artifact: Suffix of a file that the function writes beside its values; it gets the path as
            ``artifact``.
    """

    function: str
    arguments: dict[str, Any]
    label: str = ""
    needs: tuple["Job", ...] = ()
    artifact: str = ""

    @cached_property
    def description(self) -> dict[str, Any]:
        """Everything that decides the result, as plain data.

        Raises:
            TypeError: if an argument is not a JSON value.
        """
        described = {
            "function": self.function,
            "arguments": self.arguments,
            "needs": [job.key for job in self.needs],
            "artifact": self.artifact,
            "versions": _versions(),
            "source": source_digest(self.function.partition(":")[0]),
        }
        return json.loads(json.dumps(described))

    @cached_property
    def key(self) -> str:
        """The name of its result: a hash of its description."""
        return hashlib.sha256(canonical(self.description)).hexdigest()[:32]

    def compute(self, artifact: Path | None = None, needs: Sequence[Path] = ()) -> dict[str, Any]:
        """Call the function."""
        module, _, name = self.function.partition(":")
        files: dict[str, Any] = {}
        if self.artifact:
            files["artifact"] = artifact
        if self.needs:
            files["needs"] = list(needs)
        return getattr(import_module(module), name)(**self.description["arguments"], **files)

    def __getstate__(self) -> dict[str, Any]:
        """State for another process, without the key, which it computes from its own code."""
        return {attribute.name: getattr(self, attribute.name) for attribute in fields(self)}


@cache
def _versions() -> dict[str, str]:
    return {"vessel-gym": vessel_gym.__version__} | {
        name: metadata.version(name) for name in LIBRARIES
    }


def canonical(values: Any) -> bytes:
    """Bytes of values for hashing: equal for equal values."""
    return json.dumps(values, sort_keys=True, separators=(",", ":")).encode()
