"""Follows the course of errors of an open session for a panel that is open: asked for nothing, it does nothing.

The past is worked out in the background, a moment at a time: other work comes in between, and what no longer holds after
an undo or an exclusion is dropped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from app.frame import Frame
from skincal.files.reference import Reference
from skincal.session.error_history import ErrorHistory, ErrorPoint, ErrorSeries

if TYPE_CHECKING:
    from app.opening import Part

STEP_S = 0.03
"""s. The background works on the past for so long at a time: about a picture, so that the window keeps half of the machine."""

Run = Callable[[Callable[[], Any], Callable[[Any], None]], None]
"""Does work beside the window and hands its result over in a tick."""


class ErrorTracker:
    """The course of errors against what the operator chose.

    Parameters
    ----------
    part : what is calibrated
    run : does work in the background
    """

    def __init__(self, part: Part, run: Run) -> None:
        self._part = part
        self._run = run
        self.sources: list[Reference | None] = [None] if part.plan is None else [part.plan, None]
        """What estimates can be compared with; None for the error that they predict of themselves."""
        self.source = self.sources[0]
        self.version = 0
        """Another number where the course or its source is another."""
        self._history = self._begun()
        self._revision: int | None = None
        self._busy = False
        self._failed_at: tuple[ErrorHistory, int | None] | None = None
        """Course and revision whose work failed: tried again when either is another, and not at every picture."""

    def _begun(self) -> ErrorHistory:
        known = None if self.source is None else self.source.places
        return ErrorHistory(self._part.scene, self._part.surface, known)

    def offer(self, reference: Reference) -> None:
        """Take what was found or chosen, in place of another of its origin, and compare with it."""
        self.sources = [reference, *(one for one in self.sources if one is None or one.origin is not reference.origin)]
        self.choose(0)

    def choose(self, index: int) -> None:
        """Compare with another of `sources`."""
        if self.sources[index] is not self.source:
            self.source = self.sources[index]
            self._history, self._revision = self._begun(), None
            self.version += 1

    def follow(self, frame: Frame) -> None:
        """Take a frame that is on the screen, and let the background go on with what is missing of the past."""
        if frame.revision != self._revision:
            self._revision = frame.revision
            self._history.take(frame.snapshot)
            self.version += 1
        if not self._busy and self._failed_at != (self._history, self._revision):
            self._work()

    def series(self) -> ErrorSeries:
        """Return the course as far as it is known."""
        return self._history.series()

    def _work(self) -> None:
        history, wish = self._history, self._history.wish()
        if wish is None:
            return
        begun = history, self._revision

        def work() -> tuple[ErrorPoint, ...]:
            try:
                return wish.work(STEP_S)
            except BaseException:
                # Who runs the work says why; `take` is not called then.
                self._failed_at = begun
                self._busy = False
                raise

        def take(points: tuple[ErrorPoint, ...]) -> None:
            self._busy = False
            if history is self._history and history.put(wish, points):
                self.version += 1

        self._busy = True
        self._run(work, take)
