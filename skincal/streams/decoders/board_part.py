"""Part of a board: some channels of its skin frames, as `?channels=0-15` of an address says."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from skincal.devices.rising_columns import RISING_MIN_LINES, RisingColumns
from skincal.model.errors import InputError
from skincal.model.readings import Batch, Loss, Stream
from skincal.streams.decoders.auto_detect import LinkDecoder

CHANNELS_MAX = 65536
_RANGE_RE = re.compile(r"(\d{1,5})(?:-(\d{1,5}))?")


class BoardPart(NamedTuple):
    """Wanted channels of a board."""

    channels: tuple[int, ...]
    """Numbers from 0, in the order of the scene's channels."""
    width: int | None
    """Number of channels of the board; `None` if the address does not say it."""


def read_part(options: Mapping[str, str]) -> BoardPart | None:
    """Read `channels=0-7,16-23` and `of=64`; `None` without them.

    Raises InputError: a number is not valid, or named twice.
    """
    if "channels" not in options:
        if "of" in options:
            raise InputError("'of' is the number of channels of a board, and needs channels, such as channels=0-15.")
        return None
    text, of = options["channels"], options.get("of", "")
    found = [_RANGE_RE.fullmatch(each) for each in text.split(",")]
    ranges = [range(int(each[1]), int(each[2] or each[1]) + 1) for each in found if each]
    channels = tuple(number for each in ranges for number in each)
    is_valid = len(ranges) == len(found) and all(map(len, ranges)) and len({*channels}) == len(channels) <= CHANNELS_MAX
    if not is_valid or (of and not (of.isdigit() and max(channels) < int(of) <= CHANNELS_MAX)):
        raise InputError(
            f"channels={text}{f' of={of}' if of else ''} is not valid; expected numbers from 0, each once, such as "
            "channels=0-15 or channels=0-7,16-23, and of= with the number of all channels of the board."
        )
    return BoardPart(channels, int(of) if of else None)


class PartDecoder(LinkDecoder):
    """Decodes a whole board, and gives a part of its skin.

    Without the board's width the first readings wait: a clock or a number in front must not be taken for a channel.
    """

    def __init__(self, part: BoardPart, format_name: str, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(format_name, part.width, carries)
        self._part, self._expected = part, channels
        self._rising = RisingColumns()
        self._waiting: list[tuple[int, Batch]] | None = None if part.width is not None else []
        self._values: slice | None = None
        """Values of a reading without the clock or number in front."""

    def feed(self, data: bytes, host_ns: int) -> list[tuple[int, Batch]]:
        return self._parts_of(super().feed(data, host_ns))

    def finish(self) -> list[tuple[int, Batch]]:
        found, self._waiting, waiting = super().finish(), None, self._waiting or []
        return self._parts_of([*waiting, *found])

    def feed_many(self, chunks: Sequence[bytes]) -> None:
        """Give no readings at once: each batch is cut."""

    def _parts_of(self, batches: list[tuple[int, Batch]]) -> list[tuple[int, Batch]]:
        others = [each for each in batches if each[1].stream is not Stream.SKIN]
        skins = [each for each in batches if each[1].stream is Stream.SKIN]
        if self._waiting is not None:
            for _, batch in skins:
                for row in batch.values.tolist():
                    self._values = self._rising.add(row) if self._values is None else self._values
            self._waiting += skins
            if sum(len(batch.seq) for _, batch in self._waiting) <= RISING_MIN_LINES:
                return others
            skins, self._waiting = self._waiting, None
        return [*others, *((host_ns, part) for host_ns, batch in skins if (part := self._cut(batch)) is not None)]

    def _cut(self, batch: Batch) -> Batch | None:
        """Take the wanted channels of a batch; count its frames as lost if they do not fit."""
        values = batch.values if self._values is None else batch.values[:, self._values]
        channels = self._part.channels
        if max(channels) >= values.shape[1] or self._expected not in (None, len(channels)):
            self.current.counts[Loss.BAD_WIDTH] += len(batch.seq)
            scene = "" if self._expected is None else f", and the scene has {self._expected}"
            self.current.report_problem(
                f"The address names {len(channels)} channels up to {max(channels)}; the board sends {values.shape[1]}{scene}"
            )
            return None
        return replace(batch, values=values[:, list(channels)])
