"""An instance of the compiled solver. Arrays are copied into its memory, a function runs, results are copied out.

    found = shared().run("trusts", pokes=len(squares), squares=squares, trust=squares.shape)
    found["trust"]

A question has a value for each field of its table (`tables.py`), by name. Addresses are 32-bit offsets into the memory.
Threads take turns on one instance.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import threading
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
import wasmtime
from numpy.typing import NDArray

from skincal.solver.tables import SHARED_TABLES, TABLE_OF_FUNCTION, Field, Table, layout_number

SOLVER_PROGRAM = Path(__file__).with_name("solver.wasm")
Value: TypeAlias = "NDArray[Any] | tuple[int, ...] | Mapping[str, Any] | list[NDArray[Any]] | float | None"
"""What a field gets.

A pointer: an array, which is copied in with its numbers converted; a shape, for which room is made; a table by its fields, or
filled in (`fill_in`); an address, of arrays that were stored before; `None`, the null pointer. Other fields: a number, an array
of numbers, or a table by its fields. An array of pointers: a list of arrays.
"""
_PAGE_BYTES = 1 << 16
"""The memory grows by whole pages."""
_MEMORY_ALIGNMENT_BYTES = 16
_ADDRESS_BYTES = 4


def fill_in(table: str, values: Mapping[str, float]) -> NDArray[Any]:
    """Fill in a table of numbers alone, which several questions hold."""
    of = SHARED_TABLES[table]
    return np.array(tuple(values[name] for name in of.fields), dtype=of.dtype)


@cache
def _module() -> tuple[wasmtime.Engine, wasmtime.Module]:
    config = wasmtime.Config()
    # Compiling takes 90 ms, reading the cached program 3 ms. If the cache folder cannot be made, it compiles.
    with contextlib.suppress(wasmtime.WasmtimeError):
        config.cache = True
    engine = wasmtime.Engine(config)
    return engine, wasmtime.Module(engine, SOLVER_PROGRAM.read_bytes())


class Machine:
    """An instance of the solver with its own memory.

    Tables stored with `store` persist across calls. `initial` is a copy of another instance's stored arrays.
    """

    def __init__(self, initial: NDArray[np.uint8] | None = None) -> None:
        engine, module = _module()
        self._store = wasmtime.Store(engine)
        self._exports: Any = wasmtime.Instance(self._store, module, []).exports(self._store)
        self._memory: wasmtime.Memory = self._exports["memory"]
        self._functions: dict[str, Callable[[], None]] = {}
        self._arguments_at, heap = self.value("asked_at"), self.value("heap")
        self._permanent_from = self._permanent_until = heap + -heap % _MEMORY_ALIGNMENT_BYTES
        self._clone: Machine | None = None
        self._clone_until = 0
        self._memory_view = memoryview(b"")
        self._refresh_view()
        self._lock = threading.Lock()
        if self.value("layout") != layout_number():
            raise RuntimeError(f"{SOLVER_PROGRAM} was built from other tables: run `python -m tools.solver`")
        if initial is not None:
            self._permanent_until = _next_address(self._permanent_until, initial.size)
            self.write(self._permanent_from, initial.tobytes())

    def value(self, name: str) -> int:
        """Call a function of the solver that takes no arguments and returns a whole number."""
        return int(self._exports[name](self._store))

    def store(self, table: str, **values: Value) -> int:
        """Store a table, and the arrays that it points to, for the life of the instance. Return its address.

        Raises TypeError if a field of the table (`tables.py`) has no value, or a value no field.
        """
        with self._lock:
            writer = _Writer(self, self._permanent_until)
            address = writer.copy_in(writer.record(SHARED_TABLES[table], values))
            self._permanent_until = writer.free
            return address

    def run(self, name: str, **values: Value) -> dict[str, NDArray[Any]]:
        """Run a function of the solver. Return the arrays that it may write, by the names of their fields.

        Raises TypeError if a field of its question (`tables.TABLE_OF_FUNCTION`) has no value, or a value no field.
        """
        with self._lock:
            writer = _Writer(self, self._permanent_until)
            question = writer.record(SHARED_TABLES[TABLE_OF_FUNCTION[name]], values)
            at = self._arguments_at
            self.write(at, writer.free.to_bytes(_ADDRESS_BYTES, "little") + question)
            # A look-up by name takes longer than a short solve.
            function = self._functions.get(name)
            if function is None:
                function = self._functions[name] = _direct_call(self._store, self._exports[name])
            try:
                function()
            finally:
                self._refresh_view()
            memory = self._memory_view
            return {
                field: np.ndarray(shape, kind, bytearray(memory[address : address + math.prod(shape) * kind.itemsize]))
                for field, (address, shape, kind) in writer.results.items()
            }

    def clone_for_thread(self) -> Machine:
        """Return the instance for a second thread, with this one's permanent arrays at the same addresses."""
        with self._lock:
            if self._clone is None or self._clone_until != self._permanent_until:
                size = self._permanent_until - self._permanent_from
                self._clone, self._clone_until = Machine(self.read(self._permanent_from, size)), self._permanent_until
            return self._clone

    def write(self, address: int, content: bytes) -> None:
        """Copy bytes to an address. The memory grows if necessary."""
        end = address + len(content)
        if end > len(self._memory_view):
            self._memory.grow(self._store, (end - len(self._memory_view) + _PAGE_BYTES - 1) // _PAGE_BYTES)
            self._refresh_view()
        self._memory_view[address:end] = content

    def read(self, address: int, size: int) -> NDArray[np.uint8]:
        """Copy `size` bytes out of the memory."""
        return np.frombuffer(bytearray(self._memory_view[address : address + size]), dtype=np.uint8)

    def _refresh_view(self) -> None:
        """Renew the view after the memory has grown, which may have moved it."""
        size = self._memory.data_len(self._store)
        if size != len(self._memory_view):
            address = ctypes.addressof(self._memory.data_ptr(self._store).contents)
            # Bytes go into a memoryview in a third of the time that they take into an array of numpy.
            self._memory_view = memoryview((ctypes.c_uint8 * size).from_address(address)).cast("B")


def _direct_call(store: Any, function: Any) -> Callable[[], None]:
    """Make a call of a function without arguments: `Func` asks for its type each time, 40 us where a short solve takes 5.

    Its own calls do the same, by names that a later version of wasmtime may not have: then it is called as usual.
    """
    try:
        from wasmtime import _ffi as bindings

        context, place = store._context(), ctypes.byref(function._func)  # noqa: SLF001
        call_function, trap_type = cast("Any", bindings).wasmtime_func_call, ctypes.POINTER(bindings.wasm_trap_t)
        error_of, trap_of = (cast("Any", of)._from_ptr for of in (wasmtime.WasmtimeError, wasmtime.Trap))  # noqa: SLF001
    except (ImportError, AttributeError):
        return partial(function, store)

    def call() -> None:
        trap = trap_type()
        error = call_function(context, place, None, 0, None, 0, ctypes.byref(trap))
        if error:
            raise error_of(error)
        if trap:
            raise trap_of(trap)

    return call


class _Writer:
    """Tables and arrays that are written one after another into the memory of a machine, from address `free` on."""

    def __init__(self, machine: Machine, free: int) -> None:
        self._machine = machine
        self.free = free
        self.results: dict[str, tuple[int, tuple[int, ...], np.dtype[Any]]] = {}
        """Address, shape and kind of the arrays that the solver may write, by the names of their fields."""

    def copy_in(self, content: bytes) -> int:
        """Copy bytes in. Return their address."""
        address = self.free
        self.free = _next_address(address, len(content))
        self._machine.write(address, content)
        return address

    def record(self, table: Table, values: Mapping[str, Value]) -> bytes:
        """Fill in a table, and write the arrays that it points to."""
        return table.packing.pack(*self._numbers(table, values))

    def _numbers(self, table: Table, values: Mapping[str, Value]) -> list[Any]:
        """List the numbers of a table, those of the tables in it too, in their order."""
        if values.keys() != table.fields.keys():
            wrong = ", ".join(sorted(values.keys() ^ table.fields.keys()))
            raise TypeError(f"{table.name} of the solver: fields missing or unknown: {wrong}")
        numbers: list[Any] = []
        for name, field in table.fields.items():
            value = values[name]
            if field.shape:
                numbers += self._addresses(field, value) if field.is_pointer else np.ravel(np.asarray(value)).tolist()
            elif field.is_pointer:
                numbers.append(self._address(field, value))
            elif field.is_table:
                assert isinstance(value, Mapping)
                numbers += self._numbers(SHARED_TABLES[field.base], value)
            else:
                numbers.append(value)
        return numbers

    def _addresses(self, field: Field, arrays: Value) -> list[int]:
        assert isinstance(arrays, list)
        places = [self.copy_in(array.astype(field.kind, copy=False).tobytes()) for array in arrays]
        return places + [0] * (field.shape[0] - len(places))

    def _address(self, field: Field, value: Value) -> int:
        if isinstance(value, np.ndarray):
            array = value if value.dtype == field.kind else value.astype(field.kind)
            shape, address = value.shape, self.copy_in(array.tobytes())
        elif isinstance(value, tuple):
            shape, address = value, self.free
            self.free = _next_address(address, math.prod(value) * field.kind.itemsize)
        elif isinstance(value, Mapping):
            shape, address = (), self.copy_in(self.record(SHARED_TABLES[field.base], value))
        else:
            assert value is None or isinstance(value, int)
            return value or 0
        if field.is_written:
            self.results[field.name] = address, shape, field.kind
        return address


def _next_address(address: int, size: int) -> int:
    """Return the first aligned address after `size` bytes. An empty array has an address of its own."""
    return address + (size or 1) + -(size or 1) % _MEMORY_ALIGNMENT_BYTES


@cache
def shared() -> Machine:
    """Return the instance for callers that store no permanent arrays."""
    return Machine()
