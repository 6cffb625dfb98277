"""Files that are written whole or not at all."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name beside ``path`` that takes its place at the end.

    After an error nothing is left of it. Folders are made. A place that cannot be written shows
    before the work, and nothing lies there during it.

    Raises:
        OSError: if the file cannot be written there.
    """
    temporary = check_file(path)
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, whole or not at all.

    Raises:
        OSError: as `replacing`.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_tables(path: Path, comment: str, tables: Mapping[str, Mapping[str, Any]]) -> None:
    """Write tables as a TOML file, whole or not at all; None is ``"none"``, as in studies.

    Raises:
        TypeError: for a class or another object in a table.
        OSError: as `replacing`.
    """
    lines = [f"# {comment}"]
    for name, table in tables.items():
        lines += ["", f"[{_key(name)}]", *(f"{_key(k)} = {_toml(v)}" for k, v in table.items())]
    write_text(path, "\n".join([*lines, ""]))


def _key(name: str) -> str:
    return name if name.isidentifier() and name.isascii() else json.dumps(name)


def _toml(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return str(value)  # also nan, which JSON spells otherwise
    if not isinstance(value, str | int | None):
        raise TypeError(f"a file cannot hold {value!r}: name your own part as module:object")
    return json.dumps("none" if value is None else value, ensure_ascii=False)


def check_file(path: Path) -> Path:
    """Refuse a place where no file can be written; its folder is made.

    Returns:
        A name beside it for what is being written.

    Raises:
        OSError: as `replacing`.
    """
    if path.is_dir():
        raise IsADirectoryError(f"cannot write {path}: it is a folder")
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(
            b""
        )  # a killed process of the same number may have left something there
        temporary.unlink()
    except OSError as error:
        raise OSError(f"cannot write {path}: {error.strerror}") from None
    return temporary


def check_folder(path: Path) -> None:
    """Refuse a place where no folder can be written to; it is made.

    Raises:
        OSError: if there cannot be such a folder, or no file in it.
    """
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(f"cannot write into {path}: it is a file, not a folder")
    check_file(path / "any")
