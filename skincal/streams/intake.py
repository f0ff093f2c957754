"""The one facade of the streams: chunks and events of all links in, paired samples out.

What comes out depends on the items fed and nothing else: no wall clock, no thread. So a journal of the items, fed again,
gives the same samples bit for bit.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from typing import assert_never

import numpy as np

from skincal.geometry.arrays import FloatArray
from skincal.model.errors import InputError
from skincal.model.readings import (
    Batch,
    Chunk,
    JointsBatch,
    LinkEvent,
    LinkHealth,
    LinkState,
    Loss,
    Sample,
    SkinBatch,
    Stream,
    WrenchBatch,
)
from skincal.streams.clock import Stamper
from skincal.streams.decoders.detect import LinkDecoder
from skincal.streams.links import LinkSpec
from skincal.streams.pairing import Pairing

RECENT_S = 10.0
"""s. What the live curves show."""
RATE_NS = 2_000_000_000
"""Nanoseconds over which a rate is counted."""
RATE_STEP_NS = 100_000_000
"""Nanoseconds of readings counted together for the rate."""
CLOCKLESS_LOSSES = (Loss.BAD_WIDTH, Loss.UNREADABLE, Loss.BAD_CHECKSUM, Loss.MISSING)
"""Losses after which a count of readings no longer tells the time."""


class Intake:
    """Decodes, dates and pairs what the links of one session send.

    Raises
    ------
    InputError : from the constructor for a format that is not known or two links of one name, from `feed` for an item of a
        link that was not described
    """

    def __init__(self, channels: int, links: Sequence[LinkSpec]) -> None:
        self._links = {spec.name: _LinkIntake(channels, spec) for spec in links}
        if len(self._links) < len(links):
            raise InputError("Two links have the same name; expected a name of its own for each.")
        self._pairing = Pairing()
        self._now_s = -np.inf
        self._last_skin: tuple[float, FloatArray] | None = None

    @property
    def unpaired(self) -> int:
        """Skin frames that found no wrench, LATE or UNPAIRED; the losses of the skin's link count them by reason."""
        return self._pairing.counts.total()

    @property
    def last_skin(self) -> tuple[float, FloatArray] | None:
        """Host's clock (s) and raw values (channels,) of the newest skin frame, paired or not; None before the first."""
        return self._last_skin

    def check(self, item: Chunk | LinkEvent) -> None:
        """Refuse an item of a link that was not described, with an InputError; nothing is taken."""
        if item.link not in self._links:
            raise InputError(f"Bytes of a link named {item.link!r} came; expected one of {', '.join(self._links) or 'none'}.")

    def feed(self, item: Chunk | LinkEvent) -> list[Sample]:
        """Take the next item of the queue or the journal and return the samples that it completes, in order."""
        self.check(item)
        link = self._links[item.link]
        arrived = link.take_chunk(item) if isinstance(item, Chunk) else link.take_event(item)
        for arrival_ns, batch in arrived:
            self._take(link, batch, arrival_ns * 1e-9)
        self._now_s = max(self._now_s, item.host_ns * 1e-9)
        return self._pairing.advance(self._now_s)

    def _take(self, link: _LinkIntake, batch: Batch, arrival_s: float) -> None:
        match batch:
            case WrenchBatch():
                self._pairing.add_wrench(link.stamper.stamp(Stream.WRENCH, batch.device_s, arrival_s), batch)
            case SkinBatch():
                stamps = link.stamper.stamp(Stream.SKIN, batch.device_s, arrival_s).tolist()
                for stamp, values in zip(stamps, batch.values, strict=True):
                    self._pairing.add_frame(stamp, arrival_s, values)
                self._last_skin = stamps[-1], batch.values[-1]
            case JointsBatch():
                stamps = link.stamper.stamp(Stream.JOINTS, batch.device_s, arrival_s).tolist()
                for stamp, angles in zip(stamps, batch.angles, strict=True):
                    if np.isfinite(angles).all():
                        self._pairing.add_joints(stamp, angles)
            case _:
                assert_never(batch)

    def recent_wrench(self) -> tuple[FloatArray, FloatArray]:
        """Return stamps (n,), seconds, and wrenches (n, 6) of the last ten seconds, as the device says them."""
        return self._pairing.ring.since(self._pairing.ring.newest_s - RECENT_S)

    def health(self, now_ns: int) -> tuple[LinkHealth, ...]:
        """Say how each link does, in the order of their description.

        Parameters
        ----------
        now_ns : host's monotonic clock, nanoseconds: the rate counts the last two seconds before it
        """
        none: Counter[Loss] = Counter()
        return tuple(
            link.health(now_ns, self._pairing.counts if Stream.SKIN in link.spec.carries else none)
            for link in self._links.values()
        )


class _LinkIntake:
    """One link: its decoder, its clocks and its figures."""

    def __init__(self, channels: int, spec: LinkSpec) -> None:
        self.spec = spec
        self.stamper = Stamper()
        self._channels = channels
        self._decoder = self._new_decoder()
        self._before: Counter[Loss] = Counter()
        """What the decoders lost that the link had before it was opened anew."""
        self._state, self._text = LinkState.LOST, "not opened yet"
        self._readings = 0
        self._last_ns = 0
        self._rate: deque[tuple[int, int]] = deque(maxlen=RATE_NS // RATE_STEP_NS + 1)

    def _new_decoder(self) -> LinkDecoder:
        return LinkDecoder(self.spec.format, self._channels, self.spec.carries)

    def take_chunk(self, chunk: Chunk) -> list[tuple[int, Batch]]:
        if self._last_ns == 0 and self._state is LinkState.LOST:
            self._state, self._text = LinkState.OPEN, ""
        self._last_ns = chunk.host_ns
        before = self._broken()
        batches = self._decoder.feed(chunk.data, chunk.host_ns)
        if self._broken() > before:
            self.stamper.lost()
        self._count(batches)
        return batches

    def take_event(self, event: LinkEvent) -> list[tuple[int, Batch]]:
        """Follow the link's state; what was held back until the format was sure is let through at the end."""
        batches: list[tuple[int, Batch]] = []
        if event.state is LinkState.ENDED:
            batches = self._decoder.finish()
            self._count(batches)
        elif event.state is LinkState.OPEN and self._last_ns:
            self._before += self._decoder.counts
            self._decoder = self._new_decoder()
            self.stamper.reopened()
        self._state, self._text = event.state, event.text
        return batches

    def _broken(self) -> int:
        counts = self._decoder.counts
        return sum(counts[loss] for loss in CLOCKLESS_LOSSES) if counts else 0

    def _count(self, batches: list[tuple[int, Batch]]) -> None:
        for arrival_ns, batch in batches:
            self._readings += len(batch.seq)
            step_ns = arrival_ns - arrival_ns % RATE_STEP_NS
            if self._rate and self._rate[-1][0] == step_ns:
                step_ns, count = self._rate.pop()
                self._rate.append((step_ns, count + len(batch.seq)))
            else:
                self._rate.append((step_ns, len(batch.seq)))

    def health(self, now_ns: int, pairing: Counter[Loss]) -> LinkHealth:
        """Return the figures of the link; `pairing` holds the losses of the pairing, which count for the skin's link."""
        text = self._text or (self._decoder.note if self._state is LinkState.OPEN else "")
        losses = self._before + self._decoder.counts + pairing
        return LinkHealth(
            self.spec.name,
            self._state,
            text,
            self.spec.carries,
            self._decoder.name,
            self._readings,
            self._rate_until(now_ns),
            self._last_ns,
            losses,
        )

    def _rate_until(self, now_ns: int) -> float:
        """Return readings per second over the last two seconds, or since the first reading where that is less."""
        now_step_ns = now_ns - now_ns % RATE_STEP_NS
        counted = [(step_ns, count) for step_ns, count in self._rate if now_step_ns - RATE_NS <= step_ns < now_step_ns]
        if not counted:
            return 0.0
        return sum(count for _, count in counted) / ((now_step_ns - counted[0][0]) * 1e-9)
