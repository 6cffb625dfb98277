"""TOML files whose mistakes are refused in one sentence with the line."""

import re
import tomllib
from pathlib import Path


class TomlFile:
    """A TOML file being read.

    Args:
        path: The file.

    Attributes:
        text: Its text.
        data: Its tables.
        otherwise: Key whose line an error names if the file lacks the key that the error is about.

    Raises:
        ValueError: for a file that is not TOML in UTF-8.
        OSError: if it cannot be read.
    """

    otherwise: tuple[str, ...] = ()

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.text = path.read_text(encoding="utf-8")
            self.data = tomllib.loads(self.text)
        except UnicodeDecodeError:
            raise ValueError(f"{path}, line 1: the file is not text in UTF-8") from None
        except (ValueError, RecursionError) as error:  # not TOML; a number of 5,000 digits, a thousand brackets
            found = re.search(r"line (\d+)", str(error))
            line = int(found[1]) if found else self.text.count("\n") + 1
            sentence = re.sub(r" \(at .*?\)$", "", str(error)).replace("\n", " ")
            raise ValueError(f"{path}, line {line}: not TOML: {sentence}") from None

    def fault(self, keys: tuple[str, ...], sentence: str) -> ValueError:
        """The error of a sentence on a key, or its table where it is missing, or `otherwise` where that is."""
        places = (line_of(self.text, each) for each in (*(keys[:n] for n in range(len(keys), 0, -1)), self.otherwise))
        return ValueError(f"{self.path}, line {next(filter(None, places), 1)}: {sentence}")


def line_of(text: str, keys: tuple[str, ...]) -> int | None:
    """Line of a key or table, right after the lines that make a file without it; None: there is none."""
    if not keys:
        return None
    lines = text.split("\n")
    without = 0
    for count in range(1, len(lines) + 1):
        try:
            found = tomllib.loads("\n".join(lines[:count]))
        except ValueError:  # amid a value of several lines
            continue
        for key in keys:
            if not isinstance(found, dict) or key not in found:
                break
            found = found[key]
        else:
            return without + 1
        without = count
    return None
