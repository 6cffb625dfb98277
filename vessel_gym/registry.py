"""Registry by kind of task, of metrics, controllers and surroundings; a user's own are registered as ours are."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Registry(Generic[T]):
    """Entries by kind of task and name. What a class is given holds for its subclasses; the nearest class counts.

    Args:
        what: What an entry is, in a word.
        ours: Imports the modules that register the package's own, when something is first looked
            for.
    """

    def __init__(self, what: str, ours: Callable[[], object]) -> None:
        self._what, self._ours, self._loaded = what, ours, False
        self._entries: dict[type, dict[str, tuple[str, T]]] = {}

    def register(self, kind: type, entry: T, module: str, name: str = "") -> None:
        """Give a kind of task an entry. A module may do so again, as in a notebook; another one may not.

        Args:
            kind: Class of the tasks.
            entry: What they get.
            module: Name of the module that it is from.
            name: Of the entry, where a task may have several.

        Raises:
            TypeError: if ``kind`` is no class.
            ValueError: if another module has given it one of this name.
        """
        if not isinstance(kind, type):
            raise TypeError(f"{self._what} can be registered for a class of tasks, got {kind!r}")
        self._load()
        entries = self._entries.setdefault(kind, {})
        if name in entries and entries[name][0] != module:
            called = f"{self._what} {name!r}" if name else self._what
            raise ValueError(
                f"{kind.__name__} has its {called} from {entries[name][0]}: subclass the task to"
                " give it another"
            )
        entries[name] = module, entry

    def of(self, task: Any) -> dict[str, T]:
        """Entries of a task by name: its class's own, and those that it inherits."""
        return self.of_class(type(task))

    def of_class(self, kind: type) -> dict[str, T]:
        """Entries of the tasks of a class by name."""
        return {name: entry for name, (_, entry) in self._found(kind).items()}

    def modules(self, task: Any) -> dict[str, str]:
        """The modules that they are from, by name."""
        return {name: module for name, (module, _) in self._found(type(task)).items()}

    def _load(self) -> None:
        """Have the package's own registered first: its modules register while they are imported here."""
        if not self._loaded:
            self._loaded = True
            self._ours()

    def _found(self, kind: type) -> dict[str, tuple[str, T]]:
        self._load()
        found: dict[str, tuple[str, T]] = {}
        for each in reversed(kind.__mro__):
            found |= self._entries.get(each, {})
        return found
