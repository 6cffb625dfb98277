"""Files that are written whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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
