"""Whether modules lie as planned, worked out beside an open session: asked for nothing, it does nothing."""

from __future__ import annotations

from dataclasses import dataclass

from skincal.modules.health import LayoutMend, judged_modules, mend_modules
from skincal.modules.pose import ModuleModel
from skincal.session.error_history import Run
from skincal.session.part import Part
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method


@dataclass(frozen=True, slots=True, eq=False)
class ModulesFound:
    """What was found in the estimates of one moment."""

    method: Method
    """Whose estimates were judged."""
    mend: LayoutMend
    """What is wrong with the modules, and how the layout is put right."""
    judged: int
    """Modules of which enough is known."""


class ModulesCheck:
    """Looks for mirrored, turned and swapped modules; the newest moment is judged, those that came meanwhile are not.

    Parameters
    ----------
    part : what is calibrated; without a layout there is nothing to look for
    run : does work in the background
    """

    def __init__(self, part: Part, run: Run) -> None:
        self._part = part
        self._run = run
        self._module_model: ModuleModel | None = None
        self._busy = False
        self._asked: int | None = None
        self.found: ModulesFound | None = None
        """None while nothing was judged."""

    def follow(self, snapshot: Snapshot, revision: int) -> None:
        """Judge a session as it stands, unless an older moment is still being judged.

        Parameters
        ----------
        revision : another number where pokes, estimates or dead taxels changed
        """
        layout = self._part.scene.skin.layout
        if layout is None or self._busy or revision == self._asked:
            return
        method = Method.SURFACE if self._part.surface is not None else Method.FREE
        estimates = {estimate.channel: estimate for estimate in snapshot.estimates.get(method, ())}
        if self._module_model is None:
            self._module_model = ModuleModel(layout, self._part.scene.skin.anchor, self._part.surface)
        model = self._module_model

        def work() -> ModulesFound:
            try:
                return ModulesFound(method, mend_modules(model, estimates), judged_modules(model, estimates))
            except BaseException:
                # `run` reports why, and does not call `_take` then.
                self._busy = False
                raise

        self._busy, self._asked = True, revision
        self._run(work, self._take)

    def _take(self, found: ModulesFound) -> None:
        self._busy, self.found = False, found
