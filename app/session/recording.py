"""A session while it is open, without Qt: its pipeline, the readers that feed it through one queue, its place on the disk.

That place is in the operator's documents, or a temporary folder until the session is kept.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from app.session.opening import OpenRequest, dated_folder
from app.text.message import place_words
from skincal.journal.lock import LOCK_NAME
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.model.readings import Chunk, LinkEvent
    from skincal.session.pipeline import Pipeline
    from skincal.streams.links import Inbox, LinkSpec, Reader


class Storage:
    """The folder of one recording.

    A recording without a folder of its own goes into a temporary one, and so does the copy of a session that ships. `keep`
    copies it at once into a folder of its date and time under `documents`, and `finish` copies what was recorded after that
    and removes the temporary folder.
    """

    def __init__(self, request: OpenRequest, documents: Path) -> None:
        self._documents = documents
        self._temporary = Path(tempfile.mkdtemp(prefix="skincal-")) if request.temporary else None
        self.kept: Path | None = None
        """Where the whole of it was copied to."""
        self._target: Path | None = None
        """Where it is to be copied to: also while that was tried in vain."""
        self.shipped = request.session if request.copied else None
        """The session of which this is a copy."""
        given = None if request.copied else request.session or request.folder
        self.folder = given or (self._temporary or documents) / "session"

    def fetch(self) -> None:
        """Copy a session that ships to where it may be gone on with; do nothing for any other.

        Raises
        ------
        InputError
            It cannot be copied.
        """
        if self.shipped is None:
            return
        try:
            shutil.copytree(self.shipped, self.folder, copy_function=shutil.copyfile, dirs_exist_ok=True)
            for folder in (self.folder, *filter(Path.is_dir, self.folder.rglob("*"))):
                # An installation's folders may let nobody write.
                folder.chmod(0o700)
        except (OSError, shutil.Error) as error:
            raise InputError(
                f"{self.shipped}: cannot be copied to {self.folder} ({error}), and a session that ships is opened as a copy "
                "alone. Look whether it is there, and free some space."
            ) from error

    @property
    def can_keep(self) -> bool:
        """Whether the recording is temporary and not kept yet."""
        return self._temporary is not None and self.kept is None

    @property
    def lasting(self) -> Path | None:
        """Where the recording, or a copy of it, is found again; None where it goes with the window."""
        return self.folder if self._temporary is None else self.kept

    def keep(self) -> Path:
        """Copy a temporary recording into the documents and return the new folder.

        Raises
        ------
        InputError
            The folder cannot be written.
        """
        self._target = self._target or dated_folder(self._documents, datetime.now().astimezone())
        self._copy(self._target)
        self.kept = self._target
        return self.kept

    def finish(self) -> None:
        """Bring the copy that was asked for up to date, then remove the temporary folder; call after the journal is closed.

        Raises
        ------
        InputError
            The copy cannot be written; the temporary folder stays.
        """
        if self._temporary is None:
            return
        if self._target is not None and self.folder.exists():
            self._copy(self._target)
        shutil.rmtree(self._temporary, ignore_errors=True)
        self._temporary = None

    def _copy(self, target: Path) -> None:
        try:
            # Lines before the bytes that they vouch for, as they are read: the recording goes on meanwhile.
            for other in ("*.mcap", "*.jsonl"):
                left_out = shutil.ignore_patterns(LOCK_NAME, other)
                shutil.copytree(self.folder, target, ignore=left_out, dirs_exist_ok=True)
        except (OSError, shutil.Error) as error:
            raise InputError(
                f"{target}: the session cannot be kept there ({error}). It stays in {self.folder}; free some space."
            ) from error

    def words(self) -> str:
        """Return where the recording is, for the foot of the window."""
        return place_words(self.folder, self.kept, temporary=self._temporary is not None, copied=self.shipped is not None)


class Recording:
    """One session while it is open, its pipeline with an open journal."""

    def __init__(self, pipeline: Pipeline, storage: Storage) -> None:
        self.pipeline = pipeline
        self.links: tuple[LinkSpec, ...] = pipeline.links
        self.storage = storage
        self._queue = self._new_inbox()
        self._readers: list[Reader] = []
        self.reached_ns = 0
        """Arrival of the newest item that the pipeline has worked on."""

    @staticmethod
    def _new_inbox() -> Inbox:
        from skincal.streams.links import Inbox

        return Inbox()

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
        self.pipeline.demand_record()
        if self.pipeline.journal is None:
            raise InputError(f"{self.storage.folder}: is only looked at. Open it again when its recording has ended.")
        # Opened while the old segment is open: where the disk refuses, nothing has happened yet.
        following = self.pipeline.journal.open_next(self.pipeline.scene, self.links)
        self.pipeline.close()
        self.pipeline.begin_segment(self.links, following)
        self.start()

    def end(self) -> None:
        """Stop the readers, take in what they brought, close the journal, and clear the temporary folder.

        Raises
        ------
        InputError
            The kept copy cannot be brought up to date.
        """
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
