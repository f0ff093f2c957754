"""Readings of a stream between the reading of a recording and its playing: values on the disk, times in memory.

A recording with all streams in one file is read once. Its times are decided after the last message, so values wait in a
temporary file until they become records (`skincal.streams.decoders.records`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from tempfile import TemporaryFile
from weakref import finalize

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.streams.decoders.records import KIND_DTYPES, pack_records

BLOCK_BYTES = 1 << 20
"""Of the values that are kept before they are written: 20,000 wrenches."""
BLOCK_ROWS = 4096


class Tape:
    """Values of a stream in the order of their messages. Rows may differ in width."""

    def __init__(self) -> None:
        self.rows = 0
        self._file = TemporaryFile()  # noqa: SIM115 - open as long as the recording
        finalize(self, self._file.close)
        self._runs: list[tuple[int, int, int]] = []
        """Rows, values of a row, and kind of record."""
        self._block: list[FloatArray] = []
        self._block_bytes = 0

    def add(self, values: FloatArray) -> None:
        """Add the (n,) values of a reading. Raises InputError: the disk is full."""
        self.rows += 1
        self._block.append(values)
        self._block_bytes += values.nbytes
        if self._block_bytes >= BLOCK_BYTES or len(self._block) >= BLOCK_ROWS:
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
        is_single = np.array_equal(single, values, equal_nan=True)
        self._runs.append((*values.shape, 2 if is_single else 1))
        try:
            self._file.write((single if is_single else values).tobytes())
            self._file.flush()
        except OSError as error:
            raise InputError(
                f"The folder for temporary files cannot be written ({error.strerror}); free space there, or name another "
                "one in the variable TMPDIR."
            ) from None

    def lines(self, seconds: FloatArray) -> Iterator[Sequence[bytes]]:
        """Yield blocks of records with the (rows,) times."""
        self._write()
        at, first = 0, 0
        for rows, width, kind in self._runs:
            dtype = np.dtype(KIND_DTYPES[kind])
            step = max(1, BLOCK_BYTES // max(1, width * dtype.itemsize))
            for begin in range(0, rows, step):
                count = min(step, rows - begin)
                # Another iterator may have moved the file's position.
                self._file.seek(at)
                data = self._file.read(count * width * dtype.itemsize)
                at += len(data)
                last = first + count
                values = np.frombuffer(data, dtype).reshape(count, width)
                yield pack_records(np.arange(first, last), seconds[first:last], values)
                first = last
