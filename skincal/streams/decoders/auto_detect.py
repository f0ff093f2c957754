"""Decoders by the names of their formats, and detection of the format of a link.

The format is found from the bytes and the host's stamps of its chunks alone, so that a replay decides alike. One record of
SKB/1 or SKT/1 with a good checksum decides. The checksummed formats of devices are tried as well, once bytes come that no text
has. Delimited text is decoded at the same time; 300 ms after the first bytes its readings are passed on. Text is final only
once it has given a reading, because a device may send words first and records later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from skincal.devices.decoding import FrameDecoder
from skincal.devices.family import AUTO_FORMAT
from skincal.devices.registry import CHECKSUMMED_FORMATS, DEVICE_FORMATS, find_decoder
from skincal.model.errors import InputError
from skincal.model.readings import Batch, Loss, Stream
from skincal.model.wrench_frames import WrenchFrames
from skincal.streams.decoders.delimited import TextDecoder
from skincal.streams.decoders.records import RecordsDecoder
from skincal.streams.decoders.skb import SkbDecoder
from skincal.streams.decoders.skt import SktDecoder
from skincal.streams.decoders.yarp_log import CsvDecoder, YarpDecoder, YarpRxDecoder, YarpTxRxDecoder
from skincal.streams.expected_readings import ExpectedReadings

_DECODER_OF_FORMAT: dict[str, type[FrameDecoder]] = {
    "skb": SkbDecoder,
    "skt": SktDecoder,
    "text": TextDecoder,
    "yarp": YarpDecoder,
    "yarp-tx-rx": YarpTxRxDecoder,
    "yarp-rx": YarpRxDecoder,
    "csv": CsvDecoder,
    "records": RecordsDecoder,
}
"""Formats that belong to no device, by the name in a link's description."""
NAMES = (AUTO_FORMAT, *_DECODER_OF_FORMAT, *DEVICE_FORMATS)
_TEXT_BYTES = bytes([*range(9, 14), *range(32, 127)])
"""Bytes that a text may have."""
ASSUME_TEXT_AFTER_NS = 300_000_000
"""ns of bytes without a good checksum before text is believed: six frames at 20 Hz, ten at 35 Hz."""
ASSUME_TEXT_AFTER_BYTES = 65536
"""Bytes after which text is believed at once: a file is read faster than it was recorded."""


def decoder_class(name: str) -> type[FrameDecoder]:
    """Find the decoder of a format. Raises InputError: no format has this name."""
    found = _DECODER_OF_FORMAT.get(name) or find_decoder(name)
    if found is None:
        raise InputError(f"A link's format is {name!r}; expected one of {', '.join(NAMES)}.")
    return found


def make_decoder(name: str, channels: int | None, carries: tuple[Stream, ...]) -> FrameDecoder:
    """Make the decoder of a format. Raises InputError: no format has this name."""
    return decoder_class(name)(channels, carries)


class _Undecided(FrameDecoder):
    """Placeholder for the decoder while the format is unknown: no name, no units, no losses."""

    mark: ClassVar[bytes] = b""
    limit: ClassVar[int] = 0

    def __init__(self) -> None:
        super().__init__(None, ())
        self.units = {}

    def _decode(self, frame: bytes) -> Loss | None: ...


class LinkDecoder:
    """Decodes a link's bytes, in a format that is given or found."""

    def __init__(self, format_name: str, channels: int | None, carries: tuple[Stream, ...]) -> None:
        self.current: FrameDecoder = _Undecided()
        """Decoder of the format; without a name while the format is unknown."""
        self._probes: list[FrameDecoder] = []
        """Decoders that are tried; none once the format is sure."""
        self._link = channels, carries
        self._text = TextDecoder(channels, carries)
        self._held: list[tuple[int, Batch]] = []
        self._first_ns: int | None = None
        self._bytes = 0
        self._has_binary = False
        self._wrench_frames = WrenchFrames()
        if format_name == AUTO_FORMAT:
            self._probes = [SkbDecoder(channels, carries), SktDecoder(channels, carries)]
        else:
            self.current = make_decoder(format_name, channels, carries)

    def use_scene(self, expected: ExpectedReadings, wrench_frames: WrenchFrames) -> None:
        """Give all decoders what the scene says of the readings, and the frames of the link's wrenches."""
        for each in {id(each): each for each in (self.current, self._text, *self._probes)}.values():
            each.joint_names, each.wrench_frames = expected.joint_names, wrench_frames
            if expected.pose_form is not None:
                each.set_pose_form(*expected.pose_form)
        self._wrench_frames = wrench_frames

    def feed(self, data: bytes, host_ns: int) -> list[tuple[int, Batch]]:
        """Return the readings that `data` completes, each batch with the arrival of its last bytes."""
        if not self._probes:
            return [(host_ns, batch) for batch in self.current.feed(data)]
        if not self._has_binary and data.translate(None, _TEXT_BYTES):
            self._has_binary = True
            added = [make_decoder(name, *self._link) for name in CHECKSUMMED_FORMATS]
            for each in added:
                each.wrench_frames = self._wrench_frames
            self._probes += added
        for probe in self._probes:
            batches = probe.feed(data)
            if probe.valid_records:
                self._settle(probe)
                return [(host_ns, batch) for batch in batches]
        self._held += [(host_ns, batch) for batch in self._text.feed(data)]
        self._bytes += len(data)
        if self._first_ns is None:
            self._first_ns = host_ns
        if host_ns - self._first_ns >= ASSUME_TEXT_AFTER_NS or self._bytes >= ASSUME_TEXT_AFTER_BYTES:
            return self._believe_text()
        return []

    def feed_many(self, chunks: Sequence[bytes]) -> tuple[Batch, list[int]] | None:
        """Decode several chunks at once. Return one batch and the end of each chunk's readings, or `None` if not possible."""
        return None if self._probes else self.current.feed_many(chunks)

    def finish(self) -> list[tuple[int, Batch]]:
        """Assume text if no other format was found, because no more bytes come. Return its readings."""
        return self._believe_text() if self._probes else []

    def _believe_text(self) -> list[tuple[int, Batch]]:
        self.current = self._text
        held, self._held = self._held, []
        # Without a reading the search goes on: the device may send words first and its records later.
        if held:
            self._settle(self._text)
        return held

    def _settle(self, chosen: FrameDecoder) -> None:
        self.current = chosen
        self._probes = []
        # The text decoder's readings of the same bytes must not come twice.
        self._held = []
