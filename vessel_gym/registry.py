"""Registry of metrics and controllers by kind of task, the package's and users'."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Registry(Generic[T]):
    """Entries by kind of task and name.

    Subclasses of a task inherit its entries; the entry of the nearest class counts.

    Args:
        what: Kind of the entries, for error messages.
        ours: Function that imports the modules with the package's own entries, called at first use.
    """

    def __init__(self, what: str, ours: Callable[[], object]) -> None:
        self._what, self._ours, self._loaded = what, ours, False
        self._entries: dict[type, dict[str, tuple[str, T]]] = {}

    def register(self, kind: type, entry: T, module: str, name: str = "") -> None:
        """Register an entry for a kind of task; only its own module may replace it.

        Args:
            kind: Class of the tasks.
            entry: Entry.
            module: Name of the entry's module.
            name: Name of the entry, if a task may have several.

        Raises:
            TypeError: if ``kind`` is no class.
            ValueError: if another module registered an entry of this name.
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
        """Entries of a task by name, its class's own and inherited ones."""
        return {name: entry for name, (_, entry) in self._found(type(task)).items()}

    def modules(self, task: Any) -> dict[str, str]:
        """Modules of a task's entries, by name of the entry."""
        return {name: module for name, (module, _) in self._found(type(task)).items()}

    def _load(self) -> None:
        """Import the modules of the package's own entries, once; they register meanwhile."""
        if not self._loaded:
            self._loaded = True
            self._ours()

    def _found(self, kind: type) -> dict[str, tuple[str, T]]:
        self._load()
        found: dict[str, tuple[str, T]] = {}
        for each in reversed(kind.__mro__):
            found |= self._entries.get(each, {})
        return found
