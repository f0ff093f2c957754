"""Whether modules lie as planned, worked out beside the window for a panel that is open: asked for nothing, it does nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from app.frame import Frame
from skincal.modules.health import LayoutMend, judged_modules, mend_modules
from skincal.modules.pose import ModuleModel
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from app.opening import Part

Run = Callable[[Callable[[], Any], Callable[[Any], None]], None]
"""Does work beside the window and hands its result over in a tick."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What was found in the estimates of one moment."""

    method: Method
    """Whose estimates were judged."""
    mend: LayoutMend
    """What is wrong with the modules, and how the layout is put right."""
    judged: int
    """Modules of which enough is known."""


class BoardWatch:
    """Looks for mirrored, turned and swapped modules; the newest moment is judged, those that came meanwhile are not.

    Parameters
    ----------
    part : what is calibrated; without a layout there is nothing to look for
    run : does work in the background
    """

    def __init__(self, part: Part, run: Run) -> None:
        self._part = part
        self._run = run
        self._boards: ModuleModel | None = None
        self._busy = False
        self._asked: int | None = None
        self.found: Found | None = None
        """None while nothing was judged."""

    def follow(self, frame: Frame) -> None:
        """Take a frame that is on the screen, and judge it unless an older one is still being judged."""
        layout = self._part.scene.skin.layout
        if layout is None or self._busy or frame.revision == self._asked:
            return
        method = Method.SURFACE if self._part.surface is not None else Method.FREE
        estimates = {one.channel: one for one in frame.snapshot.estimates.get(method, ())}
        if self._boards is None:
            self._boards = ModuleModel(layout, self._part.scene.skin.anchor, self._part.surface)
        boards = self._boards

        def work() -> Found:
            try:
                return Found(method, mend_modules(boards, estimates), judged_modules(boards, estimates))
            except BaseException:
                # Who runs the work says why; `take` is not called then.
                self._busy = False
                raise

        self._busy, self._asked = True, frame.revision
        self._run(work, self._take)

    def _take(self, found: Found) -> None:
        self._busy, self.found = False, found
