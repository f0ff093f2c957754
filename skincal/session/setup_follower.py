"""The setup check of an open session: made after a few pokes, and again as they grow in number."""

from __future__ import annotations

from collections.abc import Sequence

from skincal.model.wrench_frames import WrenchFrame
from skincal.rig.setup_check import MistakeKind, SetupDiagnosis, check_setup
from skincal.session.background import BackgroundJob, Run
from skincal.session.part import Part
from skincal.session.snapshot import Snapshot
from skincal.words.frame_words import frame_sentences
from skincal.words.setup_words import setup_sentences

CHECK_AT_POKES = (6, 8, 10, 13, 16, 20, 26, 32, 40)
"""Numbers of accepted pokes on the skin."""


class SetupFollower:
    """Looks for mistakes in the scene file by the newest pokes. Without a layout on the part it does nothing."""

    def __init__(self, part: Part, run: Run) -> None:
        self._part, self._job = part, BackgroundJob(run)
        self._next = 0
        """Index in `CHECK_AT_POKES`."""
        self._news: list[str] = []
        self._named: tuple[MistakeKind, tuple[str, ...]] | None = None
        """Mistake that the last check named first."""
        self._frames: Sequence[WrenchFrame] = ()
        self._of_frames: tuple[str, ...] = ()
        self._of_pokes: tuple[str, ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """On the wrench's frame, then of the last check."""
        return self._of_frames + self._of_pokes

    def check_snapshot(self, snapshot: Snapshot, frames: Sequence[WrenchFrame] = ()) -> None:
        """Check a snapshot if enough pokes were added since the last check; `frames` are those of the wrench's messages."""
        if frames is not self._frames:
            self._frames, self._of_frames = frames, frame_sentences(frames)
            self._news += self._of_frames
        part, count = self._part, len(snapshot.contacts)
        if part.laid is None or self._job.is_busy or self._next >= len(CHECK_AT_POKES) or count < CHECK_AT_POKES[self._next]:
            return
        while self._next < len(CHECK_AT_POKES) and count >= CHECK_AT_POKES[self._next]:
            self._next += 1
        contacts = snapshot.contacts
        self._job.start(lambda: check_setup(contacts, part.scene, part.laid, part.surface, frames), self._finish)

    def _finish(self, diagnosis: SetupDiagnosis | None) -> None:
        first = diagnosis.mistakes[0] if diagnosis is not None and diagnosis.mistakes else None
        named = None if first is None else (first.kind, first.names)
        sentences = setup_sentences(diagnosis)
        if named != self._named:
            self._news += sentences
        self._of_pokes, self._named = sentences, named

    def take_news(self) -> list[str]:
        """Return new sentences for the operator, once."""
        news, self._news = self._news, []
        return news
