"""TOML files, with errors of one sentence and the line."""

import re
import tomllib
from pathlib import Path


class TomlError(ValueError):
    """An error in a TOML file: one sentence, and its line."""

    def __init__(self, path: Path, line: int, sentence: str) -> None:
        self.line, self.sentence = line, sentence
        super().__init__(f"{path}, line {line}: {sentence}")


class TomlFile:
    """A TOML file being read.

    Args:
        path: The file.

    Attributes:
        text: Text of the file.
        data: Tables of the file.
        otherwise: Key whose line is reported for a missing key.

    Raises:
        TomlError: for a file that is not TOML in UTF-8.
        OSError: if the file cannot be read.
    """

    otherwise: tuple[str, ...] = ()

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise TomlError(path, 1, "the file is not text in UTF-8") from None
        except OSError as error:
            raise type(error)(f"cannot read {path}: {error.strerror}") from None
        try:
            self.data = tomllib.loads(self.text)
        except (
            ValueError,
            RecursionError,
        ) as error:  # not TOML, or a number of 5,000 digits, or a thousand brackets
            found = re.search(r"line (\d+)", str(error))
            line = int(found[1]) if found else self.text.count("\n") + 1
            sentence = re.sub(r" \(at .*?\)$", "", str(error)).replace("\n", " ")
            raise TomlError(path, line, f"not TOML: {sentence}") from None

    def line(self, keys: tuple[str, ...]) -> int | None:
        """Line of a key or, if missing, of the nearest table around it; None: no line."""
        return next(
            filter(None, (line_of(self.text, keys[:n]) for n in range(len(keys), 0, -1))), None
        )

    def fault(self, keys: tuple[str, ...], sentence: str) -> TomlError:
        """Error with the line of a key, of its table, or of `otherwise`."""
        return TomlError(self.path, self.line(keys) or self.line(self.otherwise) or 1, sentence)


def line_of(text: str, keys: tuple[str, ...]) -> int | None:
    """Line of a key or table; None: no such key.

    The search reads growing parts of the file until one has the key.
    """
    if not keys:
        return None
    lines = text.split("\n")
    without = 0
    for count in range(1, len(lines) + 1):
        try:
            found = tomllib.loads("\n".join(lines[:count]))
        except ValueError:  # the part ends within a value of several lines
            continue
        for key in keys:
            if not isinstance(found, dict) or key not in found:
                break
            found = found[key]
        else:
            return without + 1
        without = count
    return None
