"""An instance of the compiled solver. Arrays are copied into its memory, a function runs, results are copied out.

    with shared().call() as call:
        matrix, answer = call.put(array), call.reserve((3,))
        call.run("function", [matrix, answer])
        result = call.get(answer)

Addresses are 32-bit offsets into the memory. Threads take turns on one instance.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import threading
from collections.abc import Generator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import wasmtime
from numpy.typing import NDArray

PROGRAM = Path(__file__).with_name("solver.wasm")
FLOAT, INTEGER, WORD = np.dtype(np.float64), np.dtype(np.int32), np.dtype(np.uint32)
"""The kinds of numbers that the solver reads."""
_PAGE_BYTES = 1 << 16
"""The memory grows by whole pages."""
_MEMORY_ALIGNMENT_BYTES = 16


@cache
def _module() -> tuple[wasmtime.Engine, wasmtime.Module]:
    config = wasmtime.Config()
    # Compiling takes 90 ms, reading the cached program 3 ms. If the cache folder cannot be made, it compiles.
    with contextlib.suppress(wasmtime.WasmtimeError):
        config.cache = True
    engine = wasmtime.Engine(config)
    return engine, wasmtime.Module(engine, PROGRAM.read_bytes())


class Machine:
    """An instance of the solver with its own memory.

    Arrays stored with `put_permanent` persist across calls. `initial` is a copy of another instance's stored arrays.
    """

    def __init__(self, initial: NDArray[np.uint8] | None = None) -> None:
        engine, module = _module()
        self._store = wasmtime.Store(engine)
        self._exports: Any = wasmtime.Instance(self._store, module, []).exports(self._store)
        self._memory: wasmtime.Memory = self._exports["memory"]
        self._functions: dict[str, Any] = {}
        self._arguments_at, heap = self.value("asked_at"), self.value("heap")
        self._permanent_from = self._permanent_until = heap + -heap % _MEMORY_ALIGNMENT_BYTES
        self._clone: Machine | None = None
        self._clone_until = 0
        self._bytes: NDArray[np.uint8] = np.empty(0, dtype=np.uint8)
        self._refresh_view()
        self._lock = threading.Lock()
        if initial is not None:
            self.put_permanent(initial)

    def value(self, name: str) -> int:
        """Call a function of the solver that takes no arguments and returns a whole number."""
        return int(self._exports[name](self._store))

    def put_permanent(self, array: NDArray[Any]) -> int:
        """Copy an array into the memory for the life of the instance. Return its address."""
        with self._lock:
            address = self._permanent_until
            self._permanent_until = _next_address(address, array.nbytes)
            self.write(address, array, array.dtype)
            return address

    def clone_for_thread(self) -> Machine:
        """Return the instance for a second thread, with this one's permanent arrays at the same addresses."""
        with self._lock:
            if self._clone is None or self._clone_until != self._permanent_until:
                size = self._permanent_until - self._permanent_from
                self._clone, self._clone_until = Machine(self.read(self._permanent_from, size)), self._permanent_until
            return self._clone

    @contextlib.contextmanager
    def call(self) -> Generator[Call]:
        """Reserve the memory behind the permanent arrays for one call."""
        with self._lock:
            yield Call(self, self._permanent_until)

    def write(self, address: int, array: NDArray[Any], kind: np.dtype[Any]) -> None:
        """Copy an array to an address, its numbers converted to `kind`. The memory grows if necessary."""
        end = address + array.size * kind.itemsize
        if end > len(self._bytes):
            self._memory.grow(self._store, (end - len(self._bytes) + _PAGE_BYTES - 1) // _PAGE_BYTES)
            self._refresh_view()
        self._bytes[address:end].view(kind).reshape(array.shape)[...] = array

    def read(self, address: int, size: int) -> NDArray[np.uint8]:
        """Copy `size` bytes out of the memory."""
        return self._bytes[address : address + size].copy()

    def run(self, name: str, words: Sequence[int], free: int) -> None:
        """Run a function of the solver with arguments `words`. It may use the memory from address `free` on."""
        self.write(self._arguments_at, np.array([free, *words]), WORD)
        # A look-up by name takes longer than a short solve.
        function = self._functions.get(name)
        if function is None:
            function = self._functions[name] = self._exports[name]
        try:
            function(self._store)
        finally:
            self._refresh_view()

    def _refresh_view(self) -> None:
        """Renew the numpy view after the memory has grown, which may have moved it."""
        size = self._memory.data_len(self._store)
        if size != len(self._bytes):
            address = ctypes.addressof(self._memory.data_ptr(self._store).contents)
            self._bytes = np.frombuffer(memoryview((ctypes.c_uint8 * size).from_address(address)), dtype=np.uint8)


class Call:
    """One call of the solver and the memory that its arrays use."""

    def __init__(self, machine: Machine, free: int) -> None:
        self._machine = machine
        self._free = free
        self._results: dict[int, tuple[tuple[int, ...], np.dtype[Any]]] = {}

    def put(self, array: NDArray[Any], kind: np.dtype[Any] = FLOAT) -> int:
        """Copy an array in, its numbers converted to `kind`. Return its address."""
        address = self._free
        self._machine.write(address, array, kind)
        self._free = _next_address(address, array.size * kind.itemsize)
        return address

    def reserve(self, shape: tuple[int, ...], kind: np.dtype[Any] = FLOAT) -> int:
        """Reserve an address for a result. The solver makes the memory large enough."""
        address = self._free
        self._results[address] = (shape, kind)
        self._free = _next_address(address, math.prod(shape) * kind.itemsize)
        return address

    def put_inout(self, array: NDArray[Any], kind: np.dtype[Any] = FLOAT) -> int:
        """Copy in an array that the solver changes, to be read with `get`. Return its address."""
        address = self.put(array, kind)
        self._results[address] = (array.shape, kind)
        return address

    def run(self, name: str, words: Sequence[int]) -> None:
        """Run the solver's function `name` with numbers and addresses as its arguments."""
        self._machine.run(name, words, self._free)

    def get(self, address: int) -> NDArray[Any]:
        """Copy out the result at an address."""
        shape, kind = self._results[address]
        return self._machine.read(address, math.prod(shape) * kind.itemsize).view(kind).reshape(shape)


def _next_address(address: int, size: int) -> int:
    """Return the first aligned address after `size` bytes. An empty array has an address of its own."""
    return address + (max(size, 1) + _MEMORY_ALIGNMENT_BYTES - 1) // _MEMORY_ALIGNMENT_BYTES * _MEMORY_ALIGNMENT_BYTES


@cache
def shared() -> Machine:
    """Return the instance for callers that store no permanent arrays."""
    return Machine()
