"""The setup check of an open session: made after a few pokes, and again as they grow in number."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from skincal.following.background import BackgroundJob, Run
from skincal.following.tool_check import check_tool_setup
from skincal.journal.documents import Totals
from skincal.model.wrench_frames import WrenchFrame
from skincal.part.part import Part
from skincal.rig.correction import UsedCorrection
from skincal.rig.scene_mistakes import MistakeKind
from skincal.rig.setup_check import SETUP_CHECK_MIN_POKES, SetupDiagnosis, check_setup
from skincal.session.skin_findings import session_skin_sentences
from skincal.session.snapshot import Snapshot
from skincal.words.frame_words import frame_sentences
from skincal.words.mistake_words import setup_sentences

SKIN_CHECK_EACH_POKES = 6
"""New pokes from which the skin is judged again."""
CHECK_AT_POKES = (SETUP_CHECK_MIN_POKES, 8, 10, 13, 16, 20, 26, 32, 40)
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
        self._told: tuple[str, ...] = ()
        """Sentences of a check that the operator got, and that are still true."""
        self._untrue: list[str] = []
        self._corrections: Mapping[str, UsedCorrection] = {}
        """In use when the last check began."""
        self._is_due = False
        """Whether the corrections have changed since the last check."""
        self._frames: Sequence[WrenchFrame] = ()
        self._of_frames: tuple[str, ...] = ()
        self._of_pokes: tuple[str, ...] = ()
        self._of_skin: tuple[str, ...] = ()
        self._skin_at = 0

    @property
    def sentences(self) -> tuple[str, ...]:
        """On the wrench's frame, the skin, then of the last check."""
        return self._of_frames + self._of_skin + self._of_pokes

    def check_skin(self, snapshot: Snapshot, read_totals: Callable[[], Totals]) -> None:
        """Look for faults of the skin and of a tool's poses after each few pokes, and in a session that was opened."""
        pokes = len(snapshot.pokes)
        if pokes < self._skin_at + SKIN_CHECK_EACH_POKES:
            return
        self._skin_at = pokes
        before = {_first_words(sentence) for sentence in self._of_skin}
        totals = read_totals()
        self._of_skin = session_skin_sentences(snapshot, totals.skin, self._part.scene, totals.pose_delays)
        self._news += [sentence for sentence in self._of_skin if _first_words(sentence) not in before]

    def check_snapshot(self, snapshot: Snapshot, frames: Sequence[WrenchFrame] = ()) -> None:
        """Check a snapshot if enough pokes were added since the last check, or if a correction began or ended.

        Parameters
        ----------
        frames : that the messages of the wrench name
        """
        if frames is not self._frames:
            self._frames, self._of_frames = frames, frame_sentences(frames)
            self._news += self._of_frames
        part, corrections = self._part, snapshot.decisions.corrections
        count = int(np.count_nonzero(snapshot.columns.counting))
        if part.scene.tool is not None:
            count += len(snapshot.at_landmarks)  # touches of landmarks show its mistakes, too
        if corrections != self._corrections:
            # The finding is of pokes as they were: its remedy would be applied on top of the correction.
            self._corrections, self._is_due = corrections, True
            self._replace_finding((), None)
        enough = self._next < len(CHECK_AT_POKES) and count >= CHECK_AT_POKES[self._next]
        can_check = part.laid is not None or part.scene.tool is not None
        if not can_check or self._job.is_busy or not (enough or self._is_due):
            return
        self._is_due = False
        while self._next < len(CHECK_AT_POKES) and count >= CHECK_AT_POKES[self._next]:
            self._next += 1
        scene = part.scene
        if snapshot.value_order is not None and snapshot.value_order.is_wrong:
            # The answers are those of other taxels: they say nothing about the scene.
            self._replace_finding((), None)
            return

        def finish(diagnosis: SetupDiagnosis | None) -> None:
            if corrections == self._corrections:
                self._finish(diagnosis)

        if scene.tool is not None:
            seen = snapshot.detached()
            self._job.start(lambda: check_tool_setup(seen, scene, part.laid, part.surface, frames), finish)
            return
        contacts = snapshot.contacts
        self._job.start(lambda: check_setup(contacts, scene, part.laid, part.surface, frames), finish)

    def _finish(self, diagnosis: SetupDiagnosis | None) -> None:
        first = diagnosis.mistakes[0] if diagnosis is not None and diagnosis.mistakes else None
        named = None if first is None else (first.kind, first.names)
        self._replace_finding(setup_sentences(diagnosis), named)

    def _replace_finding(self, sentences: tuple[str, ...], named: tuple[MistakeKind, tuple[str, ...]] | None) -> None:
        if named != self._named:
            self._untrue += self._told
            self._news = [sentence for sentence in self._news if sentence not in self._told]
            self._news += sentences
            self._told = sentences
        self._of_pokes, self._named = sentences, named

    def take_untrue(self) -> list[str]:
        """Return sentences that the operator got and that are no longer true, once."""
        untrue, self._untrue = self._untrue, []
        return untrue

    def take_news(self) -> list[str]:
        """Return new sentences for the operator, once."""
        news, self._news = self._news, []
        return news


def _first_words(sentence: str) -> str:
    """Beginning of a sentence without its numbers: the same fault is named once."""
    return re.sub("[-0-9.,]+", "", sentence)[:40]
