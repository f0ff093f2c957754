"""The decoders by their names, and which of them a link needs.

That is found from the bytes and the host's stamps of its chunks alone, so that a replay decides alike. SKB/1 and SKT/1
prove themselves: one record with a good checksum decides, as it does for makers' devices that have one, which are tried,
too, once bytes come that are no text. Until then all are tried side by side, and delimited text with them; 300 ms after the
first bytes the readings of the text are let through. A device that sends words first and records later is still found: text
is final only when it has given a reading.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from skincal.model.errors import InputError
from skincal.model.readings import Batch, Loss, SideReading, Stream
from skincal.streams.decoders.base import PieceDecoder
from skincal.streams.decoders.delimited import TextDecoder
from skincal.streams.decoders.skb import SkbDecoder
from skincal.streams.decoders.skt import SktDecoder
from skincal.streams.decoders.yarp_log import CsvDecoder, YarpDecoder, YarpRxDecoder, YarpTxRxDecoder

AUTO = "auto"
_CLASSES: dict[str, type[PieceDecoder]] = {
    "skb": SkbDecoder,
    "skt": SktDecoder,
    "text": TextDecoder,
    "yarp": YarpDecoder,
    "yarp-tx-rx": YarpTxRxDecoder,
    "yarp-rx": YarpRxDecoder,
    "csv": CsvDecoder,
}
"""By the name in a link's description."""
_MAKERS = {
    "rdt": ("rdt", "RdtDecoder"),
    "yarp-port": ("yarp_port", "YarpPortDecoder"),
    "bota": ("bota", "BotaDecoder"),
    "robotiq": ("robotiq", "RobotiqDecoder"),
    "robotiq-text": ("robotiq", "RobotiqTextDecoder"),
    "rtde": ("rtde", "RtdeDecoder"),
    "xela": ("xela", "XelaDecoder"),
    "papillarray": ("papillarray", "PapillArrayDecoder"),
}
"""File and class of the decoders of makers' devices: imported where a link needs one."""
_SELF_PROVING = ("bota", "robotiq", "papillarray")
"""Those whose checksum proves them; tried where bytes come that no text has."""
NAMES = (AUTO, *_CLASSES, *_MAKERS)
OWN_PROBES = 2
"""SKB/1 and SKT/1, which are always tried."""
_TEXT = bytes([*range(9, 14), *range(32, 127)])
"""Bytes that a text has."""
TEXT_AFTER_NS = 300_000_000
"""Nanoseconds of bytes without a good checksum before text is believed: six frames at 20 Hz, ten at 35 Hz."""
TEXT_AFTER_BYTES = 65536
"""Bytes after which text is believed at once: a file is read faster than it was recorded."""


def make_decoder(name: str, channels: int | None, carries: tuple[Stream, ...]) -> PieceDecoder:
    """Return a new decoder by its name.

    Raises InputError: no format has this name.
    """
    if name in _MAKERS:
        file, kind = _MAKERS[name]
        made: Any = getattr(import_module(f"skincal.streams.decoders.{file}"), kind)
        decoder: PieceDecoder = made(channels, carries)
        return decoder
    if name not in _CLASSES:
        raise InputError(f"A link's format is {name!r}; expected one of {', '.join(NAMES)}.")
    return _CLASSES[name](channels, carries)


class LinkDecoder:
    """Decodes a link's bytes, in a format that is given or found."""

    def __init__(self, format_name: str, channels: int | None, carries: tuple[Stream, ...]) -> None:
        self._chosen: PieceDecoder | None = None
        self._probes: tuple[PieceDecoder, ...] | None = None
        self._link = channels, carries
        self._text = TextDecoder(channels, carries)
        self._held: list[tuple[int, Batch]] = []
        self._first_ns: int | None = None
        self._bytes = 0
        if format_name == AUTO:
            self._probes = SkbDecoder(channels, carries), SktDecoder(channels, carries)
        else:
            self._chosen = make_decoder(format_name, channels, carries)

    @property
    def name(self) -> str:
        """Name of the format; empty while unknown."""
        return "" if self._chosen is None else self._chosen.name

    @property
    def counts(self) -> Counter[Loss]:
        """What the decoder lost; nothing while the format is unknown."""
        return Counter() if self._chosen is None else self._chosen.counts

    @property
    def note(self) -> str:
        """What the device got wrong or said last, a sentence; empty if nothing."""
        return "" if self._chosen is None else self._chosen.note

    @property
    def units(self) -> dict[Stream, str]:
        """What the values of a reading are; nothing while the format is unknown."""
        return {} if self._chosen is None else self._chosen.units

    @property
    def beside(self) -> dict[str, SideReading]:
        """What else the device measured, by name and unit."""
        return {} if self._chosen is None else self._chosen.beside

    def feed(self, data: bytes, host_ns: int) -> list[tuple[int, Batch]]:
        """Return the readings that `data` completes, each batch with the arrival of its last bytes."""
        if self._probes is None:
            return [] if self._chosen is None else [(host_ns, batch) for batch in self._chosen.feed(data)]
        if len(self._probes) == OWN_PROBES and data.translate(None, _TEXT):
            self._probes += tuple(make_decoder(name, *self._link) for name in _SELF_PROVING)
        for probe in self._probes:
            batches = probe.feed(data)
            if probe.good:
                self._settle(probe)
                return [(host_ns, batch) for batch in batches]
        self._held += [(host_ns, batch) for batch in self._text.feed(data)]
        self._bytes += len(data)
        if self._first_ns is None:
            self._first_ns = host_ns
        if host_ns - self._first_ns >= TEXT_AFTER_NS or self._bytes >= TEXT_AFTER_BYTES:
            return self.finish()
        return []

    def feed_many(self, pieces: Sequence[bytes]) -> tuple[Batch, list[int]] | None:
        """Return the readings of the next pieces as one batch, and where those of each end; None, nothing taken, if not."""
        return None if self._probes is not None or self._chosen is None else self._chosen.feed_many(pieces)

    def finish(self) -> list[tuple[int, Batch]]:
        """Settle for text where nothing was found yet: no more bytes come, or enough came."""
        if self._probes is None:
            return []
        self._chosen = self._text
        held, self._held = self._held, []
        # Without a reading the search goes on: the device may send words first and its records later.
        if held:
            self._settle(self._text)
        return held

    def _settle(self, chosen: PieceDecoder) -> None:
        self._chosen = chosen
        self._probes = None
        # What the text decoder made of the same bytes must not come twice.
        self._held = []
