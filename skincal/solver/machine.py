"""A memory with the compiled solver in it, to which arrays are given and from which they are taken."""

from __future__ import annotations

import ctypes
import math
import threading
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import wasmtime
from numpy.typing import NDArray

from skincal.solver.compiled import compiled

PROGRAM = Path(__file__).with_name("solver.wasm")
_PAGE = 1 << 16
"""Bytes by which the memory grows."""
_ALIGNED = 16
"""Bytes. Every array begins at a multiple of it."""
FLOAT, INTEGER, WORD = np.dtype(np.float64), np.dtype(np.int32), np.dtype(np.uint32)
"""The kinds of numbers that the solver reads."""


@cache
def _module() -> tuple[wasmtime.Engine, wasmtime.Module]:
    """Return the program, compiled for this machine."""
    engine = wasmtime.Engine()
    return engine, compiled(engine, PROGRAM.read_bytes())


class Machine:
    """A memory of its own, in which the solver runs; threads take turns.

    What is kept in it stays for all calls; what another machine has kept may be `kept` from the first. Its places are offsets
    into the memory, 32 bits.
    """

    def __init__(self, kept: NDArray[np.uint8] | None = None) -> None:
        engine, module = _module()
        self._store = wasmtime.Store(engine)
        exports: Any = wasmtime.Instance(self._store, module, []).exports(self._store)
        self._exports = exports
        self._memory: wasmtime.Memory = exports["memory"]
        self._functions: dict[str, Any] = {}
        self._asked, heap = self.value("asked_at"), self.value("heap")
        self._first = self._kept = heap + -heap % _ALIGNED
        self._twin: Machine | None = None
        self._twin_of = 0
        self._bytes: NDArray[np.uint8] = np.empty(0, dtype=np.uint8)
        self._look()
        self._lock = threading.Lock()
        if kept is not None:
            self.keep(kept)

    def value(self, name: str) -> int:
        """Return what a function of the solver without arguments returns."""
        return int(self._exports[name](self._store))

    @property
    def size(self) -> int:
        """Bytes of the memory, which grows to what the largest call needs and stays."""
        return len(self._bytes)

    def keep(self, array: NDArray[Any]) -> int:
        """Copy an array into the memory for good; return its place."""
        with self._lock:
            place = self._kept
            self._kept = _after(place, array.nbytes)
            self.write(place, array, array.dtype)
            return place

    def twin(self) -> Machine:
        """Return the machine of a second thread, with all that is kept in this one at the same places."""
        with self._lock:
            if self._twin is None or self._twin_of != self._kept:
                self._twin, self._twin_of = Machine(self.read(self._first, self._kept - self._first)), self._kept
            return self._twin

    @contextmanager
    def call(self) -> Generator[Call]:
        """Give a call the memory behind what is kept, for as long as it needs it."""
        with self._lock:
            yield Call(self, self._kept)

    def write(self, place: int, array: NDArray[Any], kind: np.dtype[Any]) -> None:
        """Copy an array to a place, as numbers of another kind if need be."""
        end = place + array.size * kind.itemsize
        if end > len(self._bytes):
            self._memory.grow(self._store, (end - len(self._bytes) + _PAGE - 1) // _PAGE)
            self._look()
        self._bytes[place:end].view(kind).reshape(array.shape)[...] = array

    def read(self, place: int, size: int) -> NDArray[np.uint8]:
        """Return a copy of `size` bytes."""
        return self._bytes[place : place + size].copy()

    def run(self, name: str, words: Sequence[int], free: int) -> None:
        """Run a function of the solver, which is asked `words` and may use the memory from `free` on."""
        self.write(self._asked, np.array([free, *words]), WORD)
        function = self._functions.get(name)
        if function is None:
            function = self._functions[name] = self._exports[name]
        try:
            function(self._store)
        finally:
            # It may have made the memory larger.
            self._look()

    def _look(self) -> None:
        """See where the memory is, and how large."""
        have = self._memory.data_len(self._store)
        # Only growing moves the memory, and then its length is another.
        if have != len(self._bytes):
            address = ctypes.addressof(self._memory.data_ptr(self._store).contents)
            self._bytes = np.frombuffer(memoryview((ctypes.c_uint8 * have).from_address(address)), dtype=np.uint8)


class Call:
    """One call of the solver: arrays are given, room for the answers is taken, it runs, the answers are read."""

    def __init__(self, machine: Machine, free: int) -> None:
        self._machine = machine
        self._free = free
        self._rooms: dict[int, tuple[tuple[int, ...], np.dtype[Any]]] = {}

    def give(self, array: NDArray[Any], kind: np.dtype[Any] = FLOAT) -> int:
        """Return the place of a copy of `array`, of 64-bit floats unless said otherwise."""
        place = self._free
        self._machine.write(place, array, kind)
        self._free = _after(place, array.size * kind.itemsize)
        return place

    def room(self, shape: tuple[int, ...], kind: np.dtype[Any] = FLOAT) -> int:
        """Return a place for an answer; the solver makes the memory large enough."""
        place = self._free
        self._rooms[place] = (shape, kind)
        self._free = _after(place, math.prod(shape) * kind.itemsize)
        return place

    def changed(self, array: NDArray[Any], kind: np.dtype[Any] = FLOAT) -> int:
        """Return the place of a copy of `array` that the solver changes, to be taken back."""
        place = self.give(array, kind)
        self._rooms[place] = (array.shape, kind)
        return place

    def run(self, name: str, words: Sequence[int]) -> None:
        """Run the solver's function `name` with a table of numbers and places."""
        self._machine.run(name, words, self._free)

    def taken(self, place: int) -> NDArray[Any]:
        """Return a copy of the answer at a place."""
        shape, kind = self._rooms[place]
        return self._machine.read(place, math.prod(shape) * kind.itemsize).view(kind).reshape(shape)


def _after(place: int, size: int) -> int:
    """Return the first place after `size` bytes; an array of none has a place of its own, too."""
    return place + (max(size, 1) + _ALIGNED - 1) // _ALIGNED * _ALIGNED


@cache
def shared() -> Machine:
    """Return the machine of all who keep nothing in it."""
    return Machine()
