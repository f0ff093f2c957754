"""The modules method may need no more pokes while the method that is shown asks for hundreds: that is said, once a session."""

from __future__ import annotations

from collections import Counter

from app.frame import Frame
from app.running import Running
from skincal.contacts.outcome import Contact
from skincal.guide.guidance import GuidePhase
from skincal.guide.places import PlannedPlaces
from skincal.guide.progress import Facts, GuideSettings, Need, needs
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method, State


class ShortWay:
    """Watches what the modules method still needs.

    Parameters
    ----------
    plan : where the layout puts the taxels
    """

    def __init__(self, plan: PlannedPlaces) -> None:
        self._plan, self._settings = plan, GuideSettings()
        self._seen: int | None = None
        self._told = False

    def news(self, frame: Frame) -> str:
        """Return what the operator is told; empty where there is nothing to tell, or it was told."""
        asked = frame.guidance is not None and frame.guidance.phase is not GuidePhase.ENOUGH
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
        """Return whether no taxel of the plan needs anything by the modules method."""
        module_of = dict(zip(self._plan.channels.tolist(), self._plan.modules.tolist(), strict=True))
        known = [one for one in snapshot.estimates.get(Method.MODULES, ()) if one.channel in module_of]
        if all(one.state is State.DEAD for one in known) or any(self._needs(one, self._settings.module_pokes) for one in known):
            return False  # whatever was poked where
        counting = [one.outcome for one in snapshot.pokes if isinstance(one.outcome, Contact) and not one.excluded]
        own = Counter(module_of.get(int(contact.channels[contact.responses.argmax()])) for contact in counting)
        return not any(self._needs(one, own[module_of[one.channel]]) for one in known)

    def _needs(self, estimate: Estimate, pokes: int) -> tuple[Need, ...]:
        """Return what a taxel needs whose module has so many pokes; nothing else of the facts is looked at."""
        nothing = float("nan")
        return needs(estimate, Facts(pokes, nothing, nothing, nothing), Method.MODULES, self._settings)
