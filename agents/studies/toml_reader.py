"""Tables of a TOML file, read with every mistake and its line."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, get_origin, get_type_hints

from estimators.factory import unknown
from vessel_gym.toml_file import TomlFile

Place = tuple[str, ...]
"""Keys that lead to a value."""


class StudyError(ValueError):
    """Everything that is wrong with a study file, a line each."""

    def __init__(self, path: Path | str, mistakes: Sequence[tuple[int, str]]) -> None:
        self.mistakes = list(mistakes)
        many = f" has {len(mistakes)} mistakes:\n" if len(mistakes) > 1 else ": "
        lines = [f"line {line}: {text}" if line else text for line, text in sorted(self.mistakes)]
        super().__init__(f"{path}{many}" + "\n".join(lines))


_KINDS: dict[Any, tuple[tuple[type, ...], str]] = {
    str: ((str,), "a name"),
    int: ((int,), "a whole number"),
    float: ((int, float), "a number"),
    bool | None: ((bool,), "true or false"),
    dict: ((dict,), "a table"),
    tuple: ((list,), "a list of tables"),
    tuple[str, ...]: ((list,), "a list of names"),
}
"""Types in TOML of a record's attributes, by their annotation, and what they are called; a record's is a table."""


def keys_of(record: type) -> list[str]:
    """Keys of a record in a file: its attributes but its name, which is that of its table."""
    return [each.name for each in fields(record) if each.name != "name"]


class TomlReader:
    """Records of parsed TOML, with a note of what is wrong with them.

    Attributes:
        WORDS: What values must be, by key, where their type says less.
        CHOICES: Values that there are, by key.
    """

    WORDS: Mapping[str, str] = {}
    CHOICES: Mapping[str, Sequence[str]] = {}

    def __init__(self, file: TomlFile) -> None:
        self.file, self.data = file, file.data
        self.mistakes: list[tuple[int, str]] = []

    def wrong(self, place: Place, text: str) -> None:
        """Note a mistake at a place, or at the nearest one around it that has a line."""
        self.mistakes.append((self.file.line(place) or 0, text))

    def accepts(self, place: Place, function: Callable[..., Any], *arguments: Any) -> bool:
        """Call a function, note its ValueError or TypeError as a mistake, and return whether there was none."""
        try:
            function(*arguments)
        except (ValueError, TypeError) as error:
            self.wrong(place, str(error))
            return False
        return True

    def section(
        self, key: str, options: Sequence[str], required: bool = False
    ) -> dict[str, dict[str, Any]]:
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

    def values(self, record: type, table: Mapping[str, Any], place: Place) -> dict[str, Any]:
        """Values of a table for the attributes of a record; those of another type are noted and left out."""
        kinds, found = get_type_hints(record), {}
        for key in keys_of(record):
            kind, where = kinds[key], (*place, key)
            if key not in table or not self.is_of(kind, key, table[key], where):
                continue
            found[key] = table[key]
            if isinstance(kind, type) and is_dataclass(kind):
                for each in table[key]:
                    self.name(f"key in {key}", each, keys_of(kind), (*where, each))
                found[key] = kind(**self.values(kind, table[key], where))
            elif kind == tuple[str, ...]:
                found[key] = tuple(table[key])
            elif kind is float:
                with suppress(OverflowError):  # too many digits, which the range refuses
                    found[key] = float(table[key])
            if key in self.CHOICES:
                self.name(
                    "observe mode" if key == "observe" else key,
                    table[key],
                    self.CHOICES[key],
                    where,
                )
        return found

    def is_of(self, kind: Any, key: str, value: Any, place: Place) -> bool:
        """Note a value of another type than an attribute's, and return whether it is of that."""
        types, words = _KINDS[kind if kind in _KINDS else get_origin(kind) or dict]
        names = value if kind == tuple[str, ...] and isinstance(value, list) else []
        good = isinstance(value, types) and isinstance(value, bool) == (bool in types)
        if not good or not all(isinstance(name, str) for name in names):
            self.wrong(place, f"{key} must be {self.WORDS.get(key, words)}, got {value!r}")
            return False
        if kind == tuple[str, ...] and not 0 < len(names) == len(set(names)):
            self.wrong(
                place, f"{key} must name one or more, each once, or be left out, got {value!r}"
            )
        return True

    def own_name(self, place: Place, kind: str, known: Iterable[str]) -> None:
        """Note a name that something else has."""
        if place[-1] != kind and place[-1] in known:
            self.wrong(place, f"the name {place[-1]!r} is taken: give this {kind!r} another one")

    def names(self, kind: str, names: Iterable[str], known: Iterable[str], place: Place) -> None:
        """Note those of some names that are not known."""
        for name in names:
            self.name(kind, name, known, place)

    def name(self, kind: str, name: str, known: Iterable[str], place: Place) -> None:
        """Note a name that is not known."""
        known = list(known)
        if name not in known:
            self.wrong(place, unknown(kind, name, known))
