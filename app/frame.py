"""Everything that one picture of the window is a function of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from app.display_units import ChannelNames
from app.rig_offers import Offer
from app.running import Running
from app.scene3d.camera import PLAIN, Eye
from app.words import LinkWords
from skincal.guide.coaching import Coaching
from skincal.guide.guidance import Guidance, Target
from skincal.guide.progress import AxisDiversity
from skincal.model.scene import Scene
from skincal.session.review import Review
from skincal.session.snapshot import LiveView, Snapshot
from skincal.taxels.result import Estimate, Method


def _no_sky(_channel: int) -> AxisDiversity | None:
    return None


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What the panels show; each compares it with what it showed before."""

    snapshot: Snapshot
    live: LiveView
    scene: Scene
    names: ChannelNames
    method: Method
    selected: int | None
    """Channel of the selected taxel."""
    running: Running
    now_ns: int
    """Host's monotonic clock."""
    revision: int
    """Another number where pokes, estimates or dead taxels are others than in the frame before; see `same_results`."""
    links: tuple[LinkWords, ...] = ()
    guidance: Guidance | None = None
    """What to poke next and what each taxel still needs; None where nobody guides."""
    sky: Callable[[int], AxisDiversity | None] = _no_sky
    """What the contacts of a channel are like; None where nobody guides, or nothing is known of it."""
    coaching: Coaching | None = None
    """The poke in progress beside the one that is asked for; None while nothing presses, or nobody guides."""
    review: Review | None = None
    """What pokes at landmarks tell of the rig, and the places with and without its correction; None while nothing does."""
    offers: tuple[Offer, ...] = ()
    """What could put the rig right; none of it happens by itself."""
    unsolved: int = 0
    """How many taxels are being solved anew; what is shown is from before. 0 too where that takes no time to speak of."""
    eye: Eye = PLAIN
    """How the 3D view's camera stands: small pictures stand upright beside it."""

    @property
    def now_s(self) -> float:
        """Host's monotonic clock, seconds."""
        return self.now_ns * 1e-9

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of the method that is shown; empty where the scene has no such method."""
        return self.snapshot.estimates.get(self.method, ())

    @property
    def target(self) -> Target | None:
        """The poke that is asked for; None where none is."""
        return None if self.guidance is None else self.guidance.target

    def by_channel(self) -> Mapping[int, Estimate]:
        """Return the shown method's estimates by their channel."""
        return {estimate.channel: estimate for estimate in self.estimates}


def same_results(first: Snapshot, second: Snapshot) -> bool:
    """Return whether two snapshots tell the same of pokes and taxels.

    Streamed joints make a new snapshot with every frame of the skin; tables and maps must not be made anew for that.
    """
    return first is second or (
        first.generation == second.generation
        or all(getattr(first, name) == getattr(second, name) for name in ("pokes", "estimates", "dead", "at_landmarks"))
    )
