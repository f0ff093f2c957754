"""Cuts a byte stream at a mark into pieces of limited length, and the decoder that works piece by piece."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from typing import ClassVar

from skincal.model.readings import Batch, Loss, Stream
from skincal.streams.formats.collector import Collector


class Splitter:
    """Cuts bytes at `mark`; what has no mark yet is kept, never more than `limit` bytes."""

    def __init__(self, mark: bytes, limit: int) -> None:
        self._mark = mark
        self._limit = limit
        self._rest = b""
        self._skipping = False

    def split(self, data: bytes) -> list[bytes | None]:
        """Return the pieces that `data` completes, without the mark; None stands for one that was too long."""
        cut = (self._rest + data).split(self._mark)
        self._rest = cut.pop()
        if cut and self._skipping:
            del cut[0]
            self._skipping = False
        pieces: list[bytes | None] = [piece if len(piece) <= self._limit else None for piece in cut]
        if len(self._rest) > self._limit:
            self._rest = b""
            if not self._skipping:
                pieces.append(None)
            self._skipping = True
        return pieces


class PieceFormat(ABC):
    """A decoder of pieces that end with a mark.

    The first piece after opening may have lost its beginning: it counts as nothing, unless it is good.
    """

    name: ClassVar[str]
    mark: ClassVar[bytes]
    limit: ClassVar[int]
    """Bytes. A piece beyond it is dropped whole."""

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        self.counts: Counter[Loss] = Counter()
        self.good: int = 0
        """Records that are surely of this format."""
        self._collector = Collector(channels, carries, self.counts)
        self._splitter = Splitter(self.mark, self.limit)
        self._first = True

    @property
    def note(self) -> str:
        """What the board got wrong or said last, a sentence; empty if nothing."""
        return self._collector.note

    def feed(self, data: bytes) -> list[Batch]:
        """Take the next bytes of the link and return the readings that they complete."""
        for piece in self._splitter.split(data):
            problem = Loss.UNREADABLE if piece is None else self._decode(piece)
            if problem is not None and not self._first:
                self.counts[problem] += 1
            self._first = False
        return self._collector.take()

    @abstractmethod
    def _decode(self, piece: bytes) -> Loss | None:
        """Hand the readings of a piece to the collector; return why it cannot be used."""
