"""One open recording, without Qt: its folder, its pipeline, and the readers that feed the pipeline through one queue."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from app.session.opening import OpenRequest, dated_folder
from app.text.message import place_words
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.model.readings import Chunk, LinkEvent
    from skincal.session.pipeline import Pipeline
    from skincal.streams.links import ChunkQueue, LinkSpec, Reader


class SessionFolder:
    """Folder of one recording: the one that was named, else a new dated one under `documents`.

    A dated folder that nobody asked for by name is provisional, such as that of the demo or of a copied session. It stays on
    the disk unless `discard` is called, so that a crash costs nothing.
    """

    def __init__(self, request: OpenRequest, documents: Path) -> None:
        self.shipped = request.session if request.copied else None
        """The shipped session of which this is a copy; `None` otherwise."""
        self._documents = documents
        self._folder = None if request.copied else request.session or request.folder
        self.is_provisional = self._folder is None
        self._discarded = False
        self._made: list[Path] = []
        """Folders that did not exist before, the innermost first."""

    @property
    def folder(self) -> Path:
        """Where the recording lies; a dated folder is known after `prepare`."""
        assert self._folder is not None
        return self._folder

    def prepare(self) -> Path:
        """Choose the dated folder, copy the shipped session into it, and return the folder of the recording.

        Raises
        ------
        InputError
            The shipped session cannot be copied.
        """
        if self._folder is not None:
            return self._folder
        from skincal.session.importing import missing_folders

        self._folder = folder = dated_folder(self._documents, datetime.now().astimezone())
        self._made = missing_folders(folder)
        if self.shipped is None:
            return folder
        try:
            shutil.copytree(self.shipped, folder, copy_function=shutil.copyfile)
            for each in (folder, *filter(Path.is_dir, folder.rglob("*"))):
                # An installation's folders may be read-only.
                each.chmod(0o700)
        except (OSError, shutil.Error) as error:
            raise InputError(
                f"{self.shipped}: cannot be copied to {folder} ({error}). A session that ships with skincal is "
                "opened as a copy. Check that you may write there, and free some space."
            ) from error
        return folder

    def keep(self) -> None:
        """Keep a provisional session."""
        self.is_provisional = False

    def discard(self) -> None:
        """Have `finish` remove a provisional session."""
        self._discarded = self.is_provisional

    def finish(self) -> None:
        """Remove a discarded session. Files that others put into its folder stay. Call it after the journal is closed."""
        if self._discarded and self._folder is not None:
            from skincal.files.reference import TRUTH_NAME
            from skincal.session.importing import take_away

            (self._folder / TRUTH_NAME).unlink(missing_ok=True)
            take_away(self._folder, self._made)

    def sentence(self) -> str:
        """Say where the recording is, for the foot of the window."""
        return place_words(self.folder, provisional=self.is_provisional, copied=self.shipped is not None)


class Recording:
    """One session while it is open, its pipeline with an open journal."""

    def __init__(self, pipeline: Pipeline, storage: SessionFolder) -> None:
        self.pipeline = pipeline
        self.links: tuple[LinkSpec, ...] = pipeline.links
        self.storage = storage
        self._queue = self._new_inbox()
        self._readers: list[Reader] = []
        self.reached_ns = 0
        """Arrival of the newest item that the pipeline has worked on."""

    @staticmethod
    def _new_inbox() -> ChunkQueue:
        from skincal.streams.links import ChunkQueue

        return ChunkQueue()

    def start(self) -> None:
        """Begin to read the links; returns at once."""
        from skincal.streams.links import Reader

        self._readers = [Reader(link, self._queue) for link in self.links]
        for reader in self._readers:
            reader.start()

    def let_go(self) -> list[Reader]:
        """Have the readers halt, and return them for another thread to wait for: that may take longer than a picture."""
        readers, self._readers = self._readers, []
        # Here, not in that thread: it may have other work to do first, and what is read meanwhile would be recorded.
        for reader in readers:
            reader.halt()
        return readers

    @property
    def behind(self) -> bool:
        """Whether readings wait."""
        return not self._queue.empty()

    def seen_ns(self, now_ns: int) -> int:
        """Return the moment that the pipeline has come to: while readings wait it is that of the newest, not now."""
        return self.reached_ns if self.behind and self.reached_ns else now_ns

    def drain(self, limit_s: float = float("inf")) -> bool:
        """Let the pipeline work on what arrived, for at most `limit_s`; return whether there was anything."""
        end = time.perf_counter() + limit_s
        drained = False
        while not self._queue.empty():
            drained = True
            item: Chunk | LinkEvent = self._queue.get()
            self.pipeline.feed(item)
            self.reached_ns = item.host_ns
            # Asked after an item, so that every call gets on.
            if time.perf_counter() > end:
                break
        return drained

    def go_on(self) -> None:
        """Read again, in a new segment of the journal.

        Raises
        ------
        InputError
            The disk takes no new segment. Nothing is read then; the session stays as it is, with its journal open, so that
            what the operator does to it is still recorded.
        """
        # What was read before the pause belongs to the segment that ends; what a reader still brings, to none.
        self._queue.finish()
        self.drain()
        self._queue = self._new_inbox()
        self.pipeline.require_intact_journal()
        if self.pipeline.journal is None:
            raise InputError(f"{self.storage.folder}: is only looked at. Open it again when its recording has ended.")
        # Opened while the old segment is open: where the disk refuses, nothing has happened yet.
        following = self.pipeline.journal.open_next(self.pipeline.scene, self.links)
        self.pipeline.close()
        self.pipeline.begin_segment(self.links, following)
        self.start()

    def end(self) -> None:
        """Stop the readers, take in what they brought, close the journal, and remove a discarded session."""
        stop_all(self.let_go())
        self._queue.finish()
        try:
            self.drain()
        finally:
            self.pipeline.close()
            self.storage.finish()


def stop_all(readers: Sequence[Reader]) -> None:
    """Stop readers; each takes as long as its read."""
    for reader in readers:
        reader.stop()
