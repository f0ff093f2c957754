"""Where a session lives on the disk: in the operator's documents, or in a temporary folder until it is kept."""

from __future__ import annotations

import shutil
import tempfile
from datetime import datetime
from pathlib import Path

from app.session.open_request import OpenRequest, dated_folder
from app.text.message import place_words
from skincal.journal.lock import LOCK_NAME
from skincal.model.errors import InputError


class Storage:
    """The folder of one recording.

    A recording without a folder of its own goes into a temporary one. `keep` copies it at once, and `finish` copies what
    was recorded after that and removes the temporary folder.

    Parameters
    ----------
    request : says where the recording goes
    documents : folder under which kept sessions are put, each in a folder of its date and time
    """

    def __init__(self, request: OpenRequest, documents: Path) -> None:
        self._documents = documents
        self._temporary = Path(tempfile.mkdtemp(prefix="skincal-")) if request.temporary else None
        self.kept: Path | None = None
        given = request.session or request.folder
        self.folder = given or (self._temporary or documents) / "session"

    @property
    def can_keep(self) -> bool:
        """Whether the recording is temporary and not kept yet."""
        return self._temporary is not None and self.kept is None

    def keep(self) -> Path:
        """Copy a temporary recording into the documents and return the new folder.

        Raises
        ------
        InputError
            The folder cannot be written.
        """
        target = self.kept or dated_folder(self._documents, datetime.now().astimezone())
        self._copy(target)
        self.kept = target
        return target

    def finish(self) -> None:
        """Bring the kept copy up to date, then remove the temporary folder; call after the journal is closed."""
        if self._temporary is None:
            return
        if self.kept is not None and self.folder.exists():
            self._copy(self.kept)
        shutil.rmtree(self._temporary, ignore_errors=True)
        self._temporary = None

    def _copy(self, target: Path) -> None:
        try:
            # Lines before the bytes that they vouch for, as they are read: the recording goes on meanwhile.
            for other in ("*.mcap", "*.jsonl"):
                left_out = shutil.ignore_patterns(LOCK_NAME, other)
                shutil.copytree(self.folder, target, ignore=left_out, dirs_exist_ok=True)
        except (OSError, shutil.Error) as error:
            raise InputError(f"{target}: the session cannot be kept there ({error}); free some space and try again.") from error

    def words(self) -> str:
        """Return where the recording is, for the foot of the window."""
        return place_words(self.folder, self.kept, temporary=self._temporary is not None)
