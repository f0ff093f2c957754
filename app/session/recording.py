"""An open recording: its folder, its pipeline, and the readers that feed the pipeline through one queue. No Qt."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from app.session.opening import OpenRequest, dated_folder
from app.text.message import missing_end_words, place_words, refused_words
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.model.readings import Chunk, LinkEvent
    from skincal.session.pipeline import Pipeline
    from skincal.streams.links import LinkSpec, Reader


class SessionFolder:
    """Folder of one recording: the named one, else a new dated one under `documents`.

    A dated folder is provisional: the operator did not choose it. It stays on the disk unless `discard` is called, so that a
    crash costs nothing.
    """

    def __init__(self, request: OpenRequest, documents: Path) -> None:
        self.shipped = request.session if request.copied else None
        """Original of a copied session; `None` if it is no copy."""
        self._documents = documents
        self._folder = None if request.copied else request.session or request.folder
        self.is_provisional = self._folder is None
        self._discarded = False
        self._is_new = request.session is None
        self._made: list[Path] = []  # Created folders, the innermost first

    @property
    def folder(self) -> Path:
        """Folder of the recording; a dated one is known after `prepare`."""
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
            if self._is_new:
                from skincal.session.importing import missing_folders

                self._made = missing_folders(self._folder)
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
                f"{self.shipped}: cannot be copied to {folder} ({error}). A session that is part of skincal "
                "opens as a copy. Check that you may write there, and free some space."
            ) from error
        return folder

    def keep(self) -> None:
        self.is_provisional = False

    def discard(self) -> None:
        """Have `finish` remove a provisional session."""
        self._discarded = self.is_provisional

    @property
    def is_discarded(self) -> bool:
        """Whether `finish` removes the session."""
        return self._discarded

    def discard_empty(self) -> bool:
        """Have `finish` remove a new session with a named folder that did not exist before; return whether it will."""
        self._discarded = self._discarded or (self._is_new and bool(self._made))
        return self._discarded

    def finish(self) -> None:
        """Delete a discarded session, but no files of others. Call it after the journal is closed."""
        if self._discarded and self._folder is not None:
            from skincal.files.reference import TRUTH_NAME
            from skincal.session.importing import take_away

            (self._folder / TRUTH_NAME).unlink(missing_ok=True)
            take_away(self._folder, self._made)

    def sentence(self) -> str:
        return place_words(self.folder, provisional=self.is_provisional, copied=self.shipped is not None)


class Recording:
    """One open session with its readers and journal."""

    def __init__(self, pipeline: Pipeline, storage: SessionFolder) -> None:
        self.pipeline = pipeline
        if pipeline.journal is not None:
            pipeline.journal.syncs_in_background = True
        self.links: tuple[LinkSpec, ...] = pipeline.links
        self.storage = storage
        self._new_queue()
        self._readers: list[Reader] = []
        self.reached_ns = 0  # Arrival of the newest processed item, host's monotonic clock
        self._is_failure_taken = False

    def _new_queue(self) -> None:
        from skincal.streams.links import ChunkQueue

        self._queue = ChunkQueue()

    def start(self) -> None:
        """Start to read the links; returns at once."""
        from skincal.streams.links import Reader

        self._readers = [Reader(link, self._queue) for link in self.links]
        for reader in self._readers:
            reader.start()

    def halt_readers(self) -> list[Reader]:
        """Halt the readers; another thread must wait for the returned readers, which may take long."""
        readers, self._readers = self._readers, []
        # Not in that thread: it may start late, and readings until then would be recorded.
        for reader in readers:
            reader.halt()
        return readers

    @property
    def has_backlog(self) -> bool:
        return not self._queue.empty()

    def processed_ns(self, now_ns: int) -> int:
        """Time up to which readings were processed; `now_ns` if none wait."""
        return self.reached_ns if self.has_backlog and self.reached_ns else now_ns

    def drain(self, limit_s: float = float("inf")) -> bool:
        """Process arrived readings for at most `limit_s`; return whether there were any."""
        end = time.perf_counter() + limit_s
        drained = False
        while not self._queue.empty():
            drained = True
            items: list[Chunk | LinkEvent] = self._queue.get_many(0.0)
            self.pipeline.feed_many(items)
            self.reached_ns = items[-1].host_ns
            # After some items, so that every call makes progress.
            if time.perf_counter() > end:
                break
        return drained

    def resume(self) -> None:
        """Read the devices again, in a new segment of the journal.

        Raises
        ------
        InputError
            The disk accepts no new segment. Nothing is read then; the journal stays open and records further actions.
        """
        # Readings before the pause belong to the segment that ends, later ones of the same reader to none.
        self._queue.finish()
        self.drain()
        self._new_queue()
        self.pipeline.require_intact_journal()
        if self.pipeline.journal is None:
            raise InputError(f"{self.storage.folder}: this view is read-only. Open it again after its recording has ended.")
        # Opened while the old segment is open: if the disk refuses, nothing has changed.
        following = self.pipeline.journal.open_next(self.pipeline.scene, self.links)
        self.pipeline.close()
        self.pipeline.begin_segment(self.links, following)
        self.start()

    def take_failure(self) -> str:
        """Return the sentence on a disk that refused the journal, once; empty without one."""
        failure = "" if self._is_failure_taken else self.pipeline.journal_failure
        self._is_failure_taken |= bool(failure)
        return refused_words(failure) if failure else ""

    def end(self) -> None:
        """Stop the readers, process their readings, close the journal, and delete a discarded session.

        Raises InputError: the disk refused the end of a session that is kept.
        """
        stop_all(self.halt_readers())
        self._queue.finish()
        try:
            self.drain()
        finally:
            self.pipeline.close()
            self.storage.finish()
        if self.take_failure() and not self.storage.is_discarded:
            raise InputError(missing_end_words(self.pipeline.journal_failure))


def stop_all(readers: Sequence[Reader]) -> None:
    """Stop readers and wait for them."""
    for reader in readers:
        reader.stop()
