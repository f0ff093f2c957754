"""The frozen value of a tick, which all views show. Texts are made from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from app.state.camera_pose import PLAIN_POSE, CameraPose
from app.state.policies import Allowed, Offer
from app.state.running import Running
from skincal.following.review import Review
from skincal.guide.guidance import Guidance, Target
from skincal.guide.press_coaching import PokeError, max_angle_error
from skincal.guide.progress import AxisDiversity
from skincal.model.readings import LinkAnswer, LinkHealth, LinkState, is_silent
from skincal.model.scene import Scene
from skincal.robot.target_lines import TipPose
from skincal.session.snapshot import LiveView, Snapshot
from skincal.taxels.result import Estimate, Method
from skincal.words.units import ChannelNames


class LinkStatus(Enum):
    """State of a link; the value is its name for the operator."""

    STREAMING = "streaming"
    WAITING = "waiting for data"
    WRONG = "no good readings"
    FROZEN = "frozen"
    SILENT = "silent"
    LOST = "lost"
    ENDED = "ended"
    NOT_READ = "not read"
    """Paused, or only viewing a recording."""


_BY_ANSWER = {
    LinkAnswer.GOOD: LinkStatus.STREAMING,
    LinkAnswer.LISTENING: LinkStatus.WAITING,
    LinkAnswer.NO_ANSWER: LinkStatus.SILENT,
    LinkAnswer.FROZEN: LinkStatus.FROZEN,
}
LINK_FAULTS = (LinkStatus.LOST, LinkStatus.FROZEN)  # The device is lost, or no longer measures


def link_status(health: LinkHealth, now_ns: int, *, connected: bool = True) -> LinkStatus:
    """Return the state of a link at a time of the host's monotonic clock; `connected` while the program reads devices."""
    if not connected:
        return LinkStatus.NOT_READ
    if health.state in (LinkState.LOST, LinkState.FAILED):
        return LinkStatus.LOST
    if health.state is LinkState.ENDED:
        return LinkStatus.ENDED
    # Silence counts from the first bytes on.
    if health.last_host_ns == 0:
        return LinkStatus.WAITING
    if is_silent(health.last_host_ns * 1e-9, now_ns * 1e-9):
        return LinkStatus.SILENT
    return _BY_ANSWER.get(health.verdict.answer, LinkStatus.WRONG)


def focused_channel(selected: int | None, guidance: Guidance | None) -> int | None:
    """Return the channel of the selected taxel, else of the target; `None` if there is neither."""
    if selected is not None or guidance is None or guidance.target is None:
        return selected
    return guidance.target.channel


@dataclass(frozen=True, slots=True, eq=False)
class ViewState:
    """Everything that panels and the 3D view show at one tick.

    The controller makes it from the session and its followers. The session's view adds the selection and what depends on it.
    """

    snapshot: Snapshot
    live: LiveView
    scene: Scene
    """With the thresholds in use."""
    names: ChannelNames
    method: Method
    """The shown method, which the guide serves."""
    running: Running
    now_ns: int
    """Time of the newest processed reading, host's monotonic clock."""
    selected: int | None = None
    """Channel of the selected taxel."""
    may: Allowed = field(default_factory=Allowed)
    behind_s: float = 0.0
    """Age of the newest processed reading while others wait; 0 otherwise."""
    clock_offset: float = 0.0
    """s. Time of day minus monotonic clock."""
    guidance: Guidance | None = None
    """Next target and remaining needs of each taxel; `None` while the guide is off."""
    diversity: AxisDiversity | None = None
    """Contacts of the focused taxel; `None` without guide or focused taxel."""
    coaching: PokeError | None = None
    """Deviation of the current press from the target; `None` while nothing presses or the guide is off."""
    review: Review | None = None
    """Results of landmark pokes, with the positions without and with their correction; `None` before the first."""
    offers: tuple[Offer, ...] = ()
    """Available corrections of sensor and arm."""
    unsolved: int = 0
    """Taxels that are being solved for longer than a moment; the estimates shown are older."""
    tip: TipPose | None = None
    """Tip of the robot that pokes; `None` without one."""
    robot_halted: bool = False
    """The operator has stopped the robot."""
    simulated: str = ""
    """Label shown for a simulated robot; empty for real devices."""
    costs: Mapping[Method, int] = field(default_factory=dict[Method, int])
    """Approximate pokes that each method needs in total; empty without a layout."""
    eye: CameraPose = PLAIN_POSE
    """Camera of the 3D view; small pictures have the same direction up."""

    @property
    def on_part(self) -> ViewState:
        """The state without positions in another frame than the part's; itself once the part's pose is known."""
        return self if self.snapshot.is_placed else replace(self, snapshot=self.snapshot.on_part)

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
        """Estimates of the shown method; empty if the scene lacks it."""
        return self.snapshot.estimates.get(self.method, ())

    @property
    def target(self) -> Target | None:
        return None if self.guidance is None else self.guidance.target

    @property
    def max_angle_error(self) -> float:
        """rad, accepted deviation of the push from the target's; 0 while the guide is off."""
        return 0.0 if self.guidance is None else max_angle_error(self.guidance)

    @property
    def focused_channel(self) -> int | None:
        return focused_channel(self.selected, self.guidance)

    @property
    def connected(self) -> bool:
        """Whether the program reads its devices."""
        return self.running is Running.STREAMING

    @property
    def lacks_pose(self) -> bool:
        """Whether the arm's pose is unknown, so that no poke counts."""
        return (self.scene.arm is not None or self.scene.tool is not None) and self.live.link_from_sensor is None

    def status_of(self, link: LinkHealth) -> LinkStatus:
        return link_status(link, self.now_ns, connected=self.connected)

    def by_channel(self) -> Mapping[int, Estimate]:
        """Return the estimates of the shown method by channel."""
        return {estimate.channel: estimate for estimate in self.estimates}


def state_at_rest(scene: Scene, snapshot: Snapshot, method: Method) -> ViewState:
    """Make the state of a session without devices, for a picture of it."""
    names = ChannelNames(scene.skin.layout)
    return ViewState(snapshot, LiveView.at_rest(), scene, names, method, Running.OFFLINE, now_ns=0)
