"""Readings of a stream between the reading of a recording and its playing, in temporary files.

A recording with all streams in one file is read once. Its times are decided after the last message, so values wait until they
become records (`skincal.streams.decoders.records`). An hour has millions of times: in files they need no memory.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from itertools import groupby
from tempfile import SpooledTemporaryFile, TemporaryFile
from typing import IO
from weakref import finalize

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.streams.decoders.records import KIND_DTYPES, pack_frame, pack_records

BUFFERED_VALUES_MAX_BYTES = 1 << 20
"""Of the values that are kept before they are written: 20,000 wrenches."""
ROWS_READ_AT_ONCE = 4096
BLOCK_NUMBERS = 1 << 16
"""Numbers that are read from a file at once."""


def _append(file: IO[bytes] | SpooledTemporaryFile[bytes], data: bytes) -> None:
    """Write at the position of a temporary file. Raises InputError: the disk is full."""
    try:
        file.write(data)
        file.flush()
    except OSError as error:
        raise InputError(
            f"The folder for temporary files cannot be written ({error.strerror}); free space there, or name another "
            "one in the variable TMPDIR."
        ) from None


class NumberFile:
    """Column of float64, such as the stamps of a stream; few numbers stay in memory."""

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile[bytes](BUFFERED_VALUES_MAX_BYTES)
        finalize(self, self._file.close)
        self._written = 0
        self._unwritten = array("d")
        self._begin, self._block = 0, np.empty(0)
        """Numbers that were read last, and the index of the first of them."""

    def __len__(self) -> int:
        """Count the numbers."""
        return self._written + len(self._unwritten)

    def append(self, number: float) -> None:
        """Add a number. Raises InputError: the disk is full."""
        self._unwritten.append(number)
        if len(self._unwritten) >= BLOCK_NUMBERS:
            self._write()

    def extend(self, numbers: FloatArray) -> None:
        """Add (n,) numbers. Raises InputError: the disk is full."""
        self._unwritten.frombytes(np.ascontiguousarray(numbers, np.float64).tobytes())
        if len(self._unwritten) >= BLOCK_NUMBERS:
            self._write()

    def _write(self) -> None:
        self._file.seek(self._written * 8)
        _append(self._file, self._unwritten.tobytes())
        self._written += len(self._unwritten)
        self._unwritten = array("d")

    def read(self, begin: int, end: int) -> FloatArray:
        """Read the numbers from `begin` up to but not including `end`, or up to the last one."""
        if self._unwritten:
            self._write()
        end = min(end, self._written)
        if not self._begin <= begin <= end <= self._begin + len(self._block):
            self._file.seek(begin * 8)
            self._begin, self._block = begin, np.frombuffer(self._file.read(8 * max(end - begin, BLOCK_NUMBERS)))
        return self._block[begin - self._begin : end - self._begin]

    def blocks(self) -> Iterator[FloatArray]:
        """Yield all numbers in order, `BLOCK_NUMBERS` at a time."""
        for begin in range(0, len(self), BLOCK_NUMBERS):
            yield self.read(begin, begin + BLOCK_NUMBERS)


class Tape:
    """Values of a stream in the order of their messages. Rows may differ in width."""

    def __init__(self, kind: int = 0) -> None:
        self._kind = kind
        """Of all records; 0 for that of their values."""
        self.rows = 0
        self._file = TemporaryFile()  # noqa: SIM115 - open as long as the recording
        finalize(self, self._file.close)
        self._runs: list[tuple[int, int, int]] = []
        """Rows, values of a row, and kind of record."""
        self._block: list[FloatArray] = []
        self._block_bytes = 0
        self._frames: dict[int, str] = {}
        """Frames of the wrenches, by the row from which each holds."""
        self._frame = ""

    def set_frame(self, name: str) -> None:
        """Note the frame of the wrenches in the rows that follow; empty for none."""
        if name != self._frame:
            self._frames[self.rows] = self._frame = name

    def add(self, values: FloatArray) -> None:
        """Add the (n,) values of a reading. Raises InputError: the disk is full."""
        self.rows += 1
        self._block.append(values)
        self._block_bytes += values.nbytes
        if self._block_bytes >= BUFFERED_VALUES_MAX_BYTES or len(self._block) >= ROWS_READ_AT_ONCE:
            self._write()

    def add_many(self, values: FloatArray) -> None:
        """Add (rows, n) values. Raises InputError: the disk is full."""
        self._write()
        self.rows += len(values)
        self._write_run(values)

    def _write(self) -> None:
        block, self._block, self._block_bytes = self._block, [], 0
        for _, run in groupby(block, len):
            self._write_run(np.array(list(run)))

    def _write_run(self, values: FloatArray) -> None:
        # Half the bytes for skins, whose raw values single precision holds.
        with np.errstate(over="ignore"):
            single = values.astype(np.float32)
        is_single = not self._kind and np.array_equal(single, values, equal_nan=True)
        self._runs.append((*values.shape, self._kind or (2 if is_single else 1)))
        _append(self._file, (single if is_single else values).tobytes())

    def lines(self, seconds: NumberFile) -> Iterator[Sequence[bytes]]:
        """Yield blocks of records with the times of the rows."""
        self._write()
        at, first = 0, 0
        for rows, width, kind in self._runs:
            dtype = np.dtype(KIND_DTYPES[kind])
            step = max(1, BUFFERED_VALUES_MAX_BYTES // max(1, width * dtype.itemsize))
            for begin in range(0, rows, step):
                count = min(step, rows - begin)
                # Another iterator may have moved the file's position.
                self._file.seek(at)
                data = self._file.read(count * width * dtype.itemsize)
                at += len(data)
                last = first + count
                values = np.frombuffer(data, dtype).reshape(count, width)
                records = pack_records(np.arange(first, last), seconds.read(first, last), values, kind)
                for row in range(first, last) if self._frames else ():
                    if (name := self._frames.get(row)) is not None:
                        records[row - first] = pack_frame(name) + records[row - first]
                yield records
                first = last
