"""The modules method may need no more pokes while the method that is shown asks for hundreds: that is said, once."""

from __future__ import annotations

import numpy as np

from app.frame import Frame
from app.running import Running
from skincal.contacts.outcome import Contact
from skincal.estimate.result import Method, State
from skincal.guide.guidance import Phase
from skincal.guide.places import Plan
from skincal.guide.settings import GuideSettings
from skincal.session.snapshot import Snapshot


class ShortWay:
    """Watches what the modules method still needs.

    Parameters
    ----------
    plan : where the layout puts the taxels
    """

    def __init__(self, plan: Plan) -> None:
        self._plan, self._settings = plan, GuideSettings()
        self._seen: int | None = None
        self._told = False

    def news(self, frame: Frame) -> str:
        """Return what the operator is told; empty where there is nothing to tell, or it was told."""
        asked = frame.guidance is not None and frame.guidance.phase is not Phase.ENOUGH
        # Who has seen that method need no more knows it.
        self._told |= frame.method is Method.MODULES and not asked and frame.guidance is not None
        if self._told or not asked or frame.method is Method.MODULES or frame.running is not Running.STREAMING:
            return ""
        if frame.revision == self._seen:
            return ""
        self._seen = frame.revision
        self._told = self._enough(frame.snapshot)
        pokes, wanted = self._settings.module_pokes, 1e3 * self._settings.wanted
        words = f"By the modules method it is enough: {pokes} pokes on every module, predicted errors of at most {wanted:g} mm."
        return f"{words} The box above the map, or V, shows that method; then F leads to the file." if self._told else ""

    def _enough(self, snapshot: Snapshot) -> bool:
        """Return whether each taxel in use meets what `done.needs` asks for by the modules method."""
        used = [one for one in snapshot.estimates.get(Method.MODULES, ()) if one.state is not State.DEAD]
        if not used or not all(one.rms is not None and one.rms <= self._settings.wanted for one in used):
            return False
        counting = [one.outcome for one in snapshot.pokes if isinstance(one.outcome, Contact) and not one.excluded]
        answered = [int(contact.channels[contact.responses.argmax()]) for contact in counting]
        module_of = dict(zip(self._plan.channels.tolist(), self._plan.modules.tolist(), strict=True))
        modules = {module_of[one.channel] for one in used if one.channel in module_of}
        own = np.bincount(
            [module_of[channel] for channel in answered if channel in module_of], minlength=max(modules, default=0) + 1
        )
        return bool((own[sorted(modules)] >= self._settings.module_pokes).all())
