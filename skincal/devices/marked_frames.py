"""Frames of one length with a mark between them and no checksum: how their beginning is found, and how damage is noticed.

A payload counts only between two marks that are exactly its length apart. So a lost, doubled or inserted byte costs the frame,
and no reading is shifted. A mark may also stand inside a payload, even at the same place for a long time. So the beginning is
believed only if one place alone has its marks three times in a row; with several such places no payload counts.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

from skincal.devices.decoding import FrameDecoder, FrameSplitter
from skincal.model.readings import Batch, Stream

SEARCHED_MAX_BYTES = 32768
"""Bytes that are searched for another length of the frames."""
MARKS_IN_A_ROW = 3
"""Marks at equal distances that show the beginning of a frame."""
MISSES_BEFORE_OTHER_LENGTH = 4
"""Frame lengths without a beginning after which another length is looked for."""


def always(_: bytes) -> bool:
    """Accept every payload."""
    return True


class MarkedFrameSplitter(FrameSplitter):
    """Cuts payloads of one length from bytes with a `mark` between them.

    Parameters
    ----------
    payload_bytes : length of a payload; `None` if it is to be found
    unit_bytes : a payload that is to be found has a multiple of it
    is_plausible : whether a payload can be one, to tell its place from other places of the mark
    """

    def __init__(
        self, mark: bytes, payload_bytes: int | None, unit_bytes: int = 1, is_plausible: Callable[[bytes], bool] = always
    ) -> None:
        self._mark, self._unit, self._is_plausible = mark, unit_bytes, is_plausible
        self.payload_bytes = payload_bytes
        self.other_payload_bytes: int | None = None
        """Length of the payloads that arrive in place of the expected ones."""
        self.is_ambiguous = False
        """Whether the mark repeats at several places of a frame, so that its beginning is not known."""
        self._is_locked = False
        self._misses = 0
        self._searched = b""

    def split(self, data: bytes) -> list[bytes | None]:
        frames: list[bytes | None] = []
        self._rest += data
        while self._cut(frames):
            pass
        return frames

    def _cut(self, frames: list[bytes | None]) -> bool:
        """Cut the next payload, or search for one; return `False` if more bytes are needed."""
        if self.payload_bytes is None:
            return self._find_length(frames)
        return self._cut_payload(frames, self.payload_bytes) if self._is_locked else self._search(frames, self.payload_bytes)

    def _cut_payload(self, frames: list[bytes | None], size: int) -> bool:
        marked = len(self._mark)
        if len(self._rest) < size + 2 * marked:
            return False
        if self._rest.startswith(self._mark, marked + size):
            frames.append(self._rest[marked : marked + size])
            self._rest, self._lost = self._rest[marked + size :], False
            return True
        self._is_locked, self._misses, self._searched = False, 0, b""
        self._drop(frames, marked)
        return True

    def _search(self, frames: list[bytes | None], size: int) -> bool:
        marked, period = len(self._mark), size + len(self._mark)
        if len(self._rest) < MARKS_IN_A_ROW * period + marked:
            return False
        places = [at for at in range(period) if self._repeats_from(self._rest, at, period)]
        if len(places) > 1:
            places = [at for at in places if self._is_plausible(self._rest[at + marked : at + period])]
        self.is_ambiguous = len(places) > 1
        if len(places) == 1:
            if places[0]:
                self._drop(frames, places[0])
            self._is_locked, self.other_payload_bytes, self._searched = True, None, b""
            return True
        self._misses += not places
        self._searched = (self._searched + self._rest[:period])[-SEARCHED_MAX_BYTES:]
        if self._misses >= MISSES_BEFORE_OTHER_LENGTH:
            self.other_payload_bytes = self._other_length(self._searched) or self.other_payload_bytes
        self._drop(frames, period)
        return True

    def _find_length(self, frames: list[bytes | None]) -> bool:
        found = self._other_length(self._rest)
        if found is None and len(self._rest) > SEARCHED_MAX_BYTES:
            self._drop(frames, len(self._rest) - SEARCHED_MAX_BYTES // 2)
        self.payload_bytes = found
        return found is not None

    def _other_length(self, data: bytes) -> int | None:
        """Find the smallest distance at which the mark repeats; return the bytes between two marks."""
        marked, places = len(self._mark), list[int]()
        at = data.find(self._mark)
        while at >= 0:
            places.append(at)
            at = data.find(self._mark, at + 1)
        distances = sorted({later - first for index, first in enumerate(places) for later in places[index + 1 : index + 9]})
        for distance in distances:
            size = distance - marked
            if size > 0 and size % self._unit == 0 and any(self._repeats_from(data, first, distance) for first in places):
                return size
        return None

    def _repeats_from(self, data: bytes, at: int, period: int) -> bool:
        return all(data.startswith(self._mark, at + period * each) for each in range(MARKS_IN_A_ROW))

    def _drop(self, frames: list[bytes | None], count: int) -> None:
        """Drop bytes that are no frame; a run of them counts once."""
        self._rest = self._rest[count:]
        if not self._lost:
            frames.append(None)
        self._lost = True


class MarkedFrameDecoder(FrameDecoder):
    """Decodes frames of one length with a mark between them."""

    value_bytes: ClassVar[int]
    """Bytes of one value."""
    _splitter: MarkedFrameSplitter

    def feed(self, data: bytes) -> list[Batch]:
        """Decode the next bytes, and say why there are no frames, if there are none."""
        batches, splitter = super().feed(data), self._splitter
        if splitter.is_ambiguous:
            self._problem = (
                "The mark between two frames also repeats inside them, so their beginning is not known; press or release the "
                "skin for a moment"
            )
        elif splitter.other_payload_bytes is not None:
            count, expected = splitter.other_payload_bytes // self.value_bytes, self._width(Stream.SKIN)
            self._problem = f"Frames of {count} values arrive where {expected} are expected; check [skin] channels of the scene"
        elif batches:
            self._problem = ""
        return batches

    @abstractmethod
    def _make_splitter(self) -> MarkedFrameSplitter: ...
