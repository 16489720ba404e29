"""In-memory store of recent results, addressed by all their inputs."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

__all__ = ["Kept"]

Result = TypeVar("Result")


class Kept(Generic[Result]):
    """Most recently requested results.

    Trials of a study build the same meshes, voxels and tables again and again.

    Parameters
    ----------
    most
        Number of results kept. The least recently requested result is dropped first, so that memory
        does not grow.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._results: OrderedDict[Hashable, Result] = OrderedDict()

    def __len__(self) -> int:
        return len(self._results)

    def of(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """Return the result of a key, computed if it is not kept.

        All callers share the result and must not change it.
        """
        found = self._results.pop(key, None)
        if found is None:
            found = make()
        self._results[key] = found
        while len(self._results) > self._most:
            self._results.popitem(last=False)
        return found
