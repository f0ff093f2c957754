"""The one frozen value that a tick hands to all views: numbers, and what may be done now; every sentence is made from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from app.scene3d.camera import PLAIN_POSE, CameraPose
from app.state.policies import Allowed, Offer
from app.state.running import Running
from skincal.guide.guidance import Guidance, PokeError, Target
from skincal.guide.progress import AxisDiversity
from skincal.model.readings import LinkAnswer, LinkHealth, LinkState, is_silent
from skincal.model.scene import Scene
from skincal.session.error_history import ModulesFound
from skincal.session.review import Review
from skincal.session.snapshot import LiveView, Snapshot
from skincal.taxels.result import Estimate, Method
from skincal.words.units import ChannelNames


class LinkLook(Enum):
    """How a link is doing; an icon's shape shows it."""

    STREAMING = "streaming"
    WAITING = "waiting for data"
    WRONG = "no good readings"
    FROZEN = "frozen"
    SILENT = "silent"
    LOST = "lost"
    ENDED = "ended"
    AWAY = "not read"
    """The program reads no devices now: paused, or only looking at a recording."""


_LOOKS = {
    LinkAnswer.GOOD: LinkLook.STREAMING,
    LinkAnswer.LISTENING: LinkLook.WAITING,
    LinkAnswer.NO_ANSWER: LinkLook.SILENT,
    LinkAnswer.FROZEN: LinkLook.FROZEN,
}
"""Of a link that is open and brings bytes."""
FAULTS = (LinkLook.LOST, LinkLook.FROZEN)
"""A device is away, or does not measure any more."""


def link_look(health: LinkHealth, now_ns: int, *, connected: bool = True) -> LinkLook:
    """Return how a link is doing, by the host's monotonic clock; `connected` where the program reads its devices."""
    if not connected:
        return LinkLook.AWAY
    if health.state in (LinkState.LOST, LinkState.FAILED):
        return LinkLook.LOST
    if health.state is LinkState.ENDED:
        return LinkLook.ENDED
    # Nothing came yet: silence is counted from the first bytes on.
    if health.last_host_ns == 0:
        return LinkLook.WAITING
    if is_silent(health.last_host_ns * 1e-9, now_ns * 1e-9):
        return LinkLook.SILENT
    return _LOOKS.get(health.verdict.answer, LinkLook.WRONG)


def looked_at(selected: int | None, guidance: Guidance | None) -> int | None:
    """Return the channel of the taxel that is selected, else of the one that is asked for; None where there is neither."""
    if selected is not None or guidance is None or guidance.target is None:
        return selected
    return guidance.target.channel


@dataclass(frozen=True, slots=True, eq=False)
class ViewState:
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
    """Host's monotonic clock; while readings wait, the arrival of the newest that was worked on."""
    may: Allowed
    """What the operator may do now."""
    behind_s: float = 0.0
    """How long ago that was, while readings wait; else 0."""
    clock_offset: float = 0.0
    """s to add to the monotonic clock for the time of day."""
    guidance: Guidance | None = None
    """What to poke next and what each taxel still needs; None where nobody guides."""
    diversity: AxisDiversity | None = None
    """What the contacts of the taxel that is looked at are like; None where nobody guides, or nothing is known of it."""
    coaching: PokeError | None = None
    """The poke in progress beside the one that is asked for; None while nothing presses, or nobody guides."""
    review: Review | None = None
    """What pokes at landmarks say of the rig, and the places with and without its correction; None while nothing does."""
    offers: tuple[Offer, ...] = ()
    """What could put the rig right; none of it happens by itself."""
    modules: ModulesFound | None = None
    """Whether modules lie as planned; None while that was not worked out."""
    unsolved: int = 0
    """How many taxels are being solved anew; what is shown is from before. 0 too where that takes no time to speak of."""
    simulated: str = ""
    """What is said of a rig that is none: empty of a real one."""
    costs: Mapping[Method, int] = field(default_factory=dict[Method, int])
    """About how many pokes each method takes from the first to enough; none where no layout says."""
    eye: CameraPose = PLAIN_POSE
    """How the 3D view's camera stands: small pictures stand upright beside it."""

    @property
    def revision(self) -> int:
        """Counter that changes whenever pokes, estimates or decisions change."""
        return self.snapshot.generation

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

    @property
    def looked_at(self) -> int | None:
        """Channel of the taxel that is selected, else of the one that is asked for; None where there is neither."""
        return looked_at(self.selected, self.guidance)

    @property
    def connected(self) -> bool:
        """Whether the program reads its devices."""
        return self.running is Running.STREAMING

    @property
    def lacks_pose(self) -> bool:
        """Whether the arm's pose is not known, so that no poke counts."""
        return self.scene.arm is not None and self.live.link_from_sensor is None

    def look(self, link: LinkHealth) -> LinkLook:
        """Return how one of `live.links` is doing."""
        return link_look(link, self.now_ns, connected=self.connected)

    def by_channel(self) -> Mapping[int, Estimate]:
        """Return the shown method's estimates by their channel."""
        return {estimate.channel: estimate for estimate in self.estimates}
