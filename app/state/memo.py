"""Values that are made again only after what they depend on has changed."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Generic, TypeVar

Value = TypeVar("Value")
COMPARED_BY_VALUE = (bool, int, float, str, bytes, Enum)


def is_same(first: object, second: object) -> bool:
    """Compare plain values by value, tuples item by item, all else by identity: `==` on arrays compares every number."""
    if first is second:
        return True
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(is_same(a, b) for a, b in zip(first, second, strict=True))
    return isinstance(first, COMPARED_BY_VALUE) and type(first) is type(second) and first == second


class Memo(Generic[Value]):
    """Cache of a function's newest result, with its key."""

    def __init__(self) -> None:
        self._newest: tuple[object, Value] | None = None

    def get(self, key: tuple[object, ...], make: Callable[[], Value]) -> Value:
        """Return the result for a key; call `make` only if the key is not the newest one (`is_same`)."""
        if self._newest is None or not is_same(key, self._newest[0]):
            self._newest = key, make()
        return self._newest[1]
