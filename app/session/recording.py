"""What is open: a road, the readers that feed it through one queue, and its place on the disk. No Qt."""

from __future__ import annotations

import queue
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from app.session.storage import Storage

if TYPE_CHECKING:
    from skincal.model.readings import Chunk, LinkEvent
    from skincal.session.road import Road
    from skincal.streams.links import LinkSpec
    from skincal.streams.reader import Reader


class Recording:
    """One session while it is open.

    Parameters
    ----------
    road : with an open journal
    """

    def __init__(self, road: Road, storage: Storage) -> None:
        self.road = road
        self.links: tuple[LinkSpec, ...] = road.links
        self.storage = storage
        self._queue: queue.SimpleQueue[Chunk | LinkEvent] = queue.SimpleQueue()
        self._readers: list[Reader] = []
        self.reached_ns = 0
        """Arrival of the newest item that the road has worked on."""

    def start(self) -> None:
        """Begin to read the links; returns at once."""
        from skincal.streams.reader import Reader

        self._readers = [Reader(link, self._queue) for link in self.links]
        for reader in self._readers:
            reader.start()

    def let_go(self) -> list[Reader]:
        """Return the readers, for somebody else to stop: that may take longer than a picture."""
        readers, self._readers = self._readers, []
        return readers

    @property
    def behind(self) -> bool:
        """Whether readings wait."""
        return not self._queue.empty()

    def drain(self, limit_s: float = float("inf")) -> bool:
        """Let the road work on what arrived, for at most `limit_s`; return whether there was anything.

        What the disk no longer takes is said by `journal_failure`.
        """
        end = time.perf_counter() + limit_s
        drained = False
        while not self._queue.empty():
            drained = True
            item = self._queue.get()
            self.road.feed(item)
            self.reached_ns = item.host_ns
            if time.perf_counter() > end:
                break
        return drained

    @property
    def journal_failure(self) -> str:
        """Why nothing is recorded any more; empty while all is well."""
        return self.road.journal_failure

    def sync(self) -> None:
        """Force what is recorded onto the medium."""
        if self.road.journal is not None:
            self.road.journal.sync()

    def go_on(self) -> None:
        """Read again, in a new segment of the journal.

        Raises
        ------
        InputError
            The disk takes no new segment. Nothing is read then; the session stays as it is, with its journal open, so that
            what the operator does to it is still recorded.
        """
        self.drain()
        self.road.demand_record()
        assert self.road.journal is not None
        following = self.road.journal.open_next(self.road.scene, self.links)
        self.road.close()
        self.road.begin_segment(self.links, following)
        self.start()

    def end(self) -> None:
        """Stop the readers, take in what they brought, close the journal, and clear the temporary folder.

        Raises
        ------
        InputError
            The kept copy cannot be brought up to date.
        """
        stop_all(self.let_go())
        try:
            self.drain()
        finally:
            self.road.close()
            self.storage.finish()


def stop_all(readers: Sequence[Reader]) -> None:
    """Stop readers; each takes as long as its read."""
    for reader in readers:
        reader.stop()
