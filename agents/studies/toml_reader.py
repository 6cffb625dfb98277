"""Tables of a TOML file, read with every mistake and its line."""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from estimators.factory import unknown

Place = tuple[str, ...]
"""Keys that lead to a value."""


class StudyError(ValueError):
    """Everything that is wrong with a study file, a line each."""

    def __init__(self, path: Path | str, mistakes: Sequence[tuple[int, str]]) -> None:
        self.mistakes = list(mistakes)
        many = f" has {len(mistakes)} mistakes:\n" if len(mistakes) > 1 else ": "
        lines = [f"line {line}: {text}" if line else text for line, text in sorted(self.mistakes)]
        super().__init__(f"{path}{many}" + "\n".join(lines))


class TomlReader:
    """Values of parsed TOML, with a note of what is wrong with them."""

    def __init__(self, data: dict[str, Any], text: str) -> None:
        self.data, self.lines = data, lines_of(text)
        self.mistakes: list[tuple[int, str]] = []

    def wrong(self, place: Place, text: str) -> None:
        """Note a mistake at a place, or at the nearest one around it that has a line."""
        known = next((self.lines[place[:n]] for n in range(len(place), 0, -1) if place[:n] in self.lines), 0)
        self.mistakes.append((known, text))

    def accepts(self, place: Place, function: Callable[..., Any], *arguments: Any) -> bool:
        """Call a function, note its ValueError or TypeError as a mistake, and return whether there was none."""
        try:
            function(*arguments)
        except (ValueError, TypeError) as error:
            self.wrong(place, str(error))
            return False
        return True

    def section(self, key: str, options: Sequence[str], required: bool = False) -> dict[str, dict[str, Any]]:
        """A table of tables, those that are not left out."""
        tables = self.data.get(key, {})
        if not isinstance(tables, dict):
            self.wrong((key,), f"{key} must be a table: [{key}] with a line 'name = {{}}' for each")
            return {}
        if required and not tables:
            self.wrong((key,), f"a study needs {key}: [{key}] with a line 'name = {{}}' for each")
        good = {}
        for name, table in tables.items():
            if not isinstance(table, dict):
                self.wrong((key, name), f"{key}.{name} must be a table, e.g. {{}}, got {table!r}")
                continue
            if not name.isprintable() or not name.strip():
                self.wrong((key, name), f"names of {key} must be text in a line, got {name!r}")
            for option in table:
                self.name(f"key in {key}.{name}", option, options, (key, name, option))
            good[name] = table
        return good

    def names(self, place: Place, table: dict[str, Any], key: str, default: tuple[str, ...]) -> tuple[str, ...]:
        """A list of names, each once."""
        value = table.get(key, list(default))
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            self.wrong((*place, key), f"{key} must be a list of names, got {value!r}")
            return default
        if key in table and not 0 < len(value) == len(set(value)):
            self.wrong((*place, key), f"{key} must name one or more, each once, or be left out, got {value!r}")
        return tuple(value)

    def value(self, place: Place, table: dict[str, Any], key: str, kind: Any, words: str, default: Any) -> Any:
        """A value of a kind; the default where there is none, or one of another kind."""
        value = table.get(key, default)
        kinds = kind if isinstance(kind, tuple) else (kind,)
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            self.wrong((*place, key), f"{key} must be {words}, got {value!r}")
            return default
        return value

    def choice(
        self, place: Place, table: dict[str, Any], key: str, known: Iterable[str], default: str, kind: str = ""
    ) -> str:
        """One of the known names of a kind, which is called like its key if not given."""
        chosen: str = self.value(place, table, key, str, "a name", default)
        self.name(kind or key, chosen, known, (*place, key))
        return chosen

    def own_name(self, place: Place, kind: str, known: Iterable[str]) -> None:
        """Note a name that something else has."""
        if place[-1] != kind and place[-1] in known:
            self.wrong(place, f"the name {place[-1]!r} is taken: give this {kind!r} another one")

    def name(self, kind: str, name: str, known: Iterable[str], place: Place) -> None:
        """Note a name that is not known."""
        known = list(known)
        if name not in known:
            self.wrong(place, unknown(kind, name, known))


_KEY = r"""(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')"""
_DOTTED = rf"{_KEY}(?:\s*\.\s*{_KEY})*"


def lines_of(text: str) -> dict[Place, int]:
    """The line of every key of a TOML text, also of those in inline tables; values are not looked into further."""
    lines: dict[Place, int] = {}
    table: Place = ()
    place: Place = ()
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(rf"\s*\[\[?\s*({_DOTTED})\s*\]\]?", line):
            table = place = _parts(header[1])
            lines.setdefault(place, number)
        elif key := re.match(rf"\s*({_DOTTED})\s*=", line):
            place = table + _parts(key[1])
            for n in range(1, len(place) + 1):
                lines.setdefault(place[:n], number)
            line = line[key.end() :]
        for inner in re.finditer(rf"[{{,]\s*({_DOTTED})\s*=", line):
            lines.setdefault(place + _parts(inner[1]), number)
    return lines


def _parts(dotted: str) -> Place:
    return tuple(part.strip("\"'") for part in re.findall(_KEY, dotted))
