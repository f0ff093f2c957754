"""A frozen picture of a session: everything a view may show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from skincal.contacts.outcome import Contact, Outcome, Progress
from skincal.geometry import FloatArray, IntArray
from skincal.journal.documents import WallClock
from skincal.model.actions import AskPoke, MissedLandmark, SkipLandmark, SkipPoke
from skincal.model.readings import LinkHealth
from skincal.model.scene import ContactSettings, Landmark
from skincal.rig.closing import ClosingPlace
from skincal.rig.correction import UsedCorrection
from skincal.session.undo import Deed, Entry
from skincal.taxels.result import Estimate, Method

if TYPE_CHECKING:
    from skincal.modules.distances import TriedDistance


@dataclass(frozen=True, slots=True)
class PokeRecord:
    """One poke as it stands."""

    outcome: Outcome
    excluded: bool
    """The operator took it out; it stays in the journal and can be restored."""
    asked: AskPoke | None = None
    """What was asked for when it was made; None where nothing is known of that."""


@dataclass(frozen=True, slots=True)
class ClosingRound:
    """One closing check as it was asked for."""

    after: int
    """Number of the last poke before it began."""
    skipped: frozenset[ClosingPlace] = frozenset()
    """Places that are asked for no more in it."""
    ended: bool = False
    """The operator ended it."""


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """What a session holds at one moment. Two snapshots with the same generation are the same."""

    generation: int
    pokes: tuple[PokeRecord, ...]
    """In the order of their numbers."""
    estimates: Mapping[Method, tuple[Estimate, ...]]
    """For each method of the scene one estimate a taxel, in the order of `Session.channels`."""
    touched: IntArray
    """Channels whose estimates changed with the last poke or action."""
    pose: str
    """Name of the current arm pose, its streamed angles in words, or empty."""
    link_from_sensor: FloatArray | None
    """(4, 4) float of the current arm pose; None while unknown."""
    dead: Mapping[int, str]
    """Channels that are not used, with the reason."""
    can_undo: str
    """What undo would take back, in words; empty if nothing."""
    can_redo: str = ""
    """What redo would bring again, likewise."""
    history: tuple[Entry, ...] = ()
    """What can be taken back, the newest last, with pokes that were taken out by hand."""
    undone: tuple[Entry, ...] = ()
    """What can be brought again, the next last."""
    deed: Deed | None = None
    """What the operator did last; None before the first."""
    landmarks: tuple[Landmark, ...] = ()
    """Known points of the part: those of the scene, then those that the operator added."""
    at_landmarks: Mapping[int, str] = field(default_factory=dict[int, str])
    """Pokes that were at a landmark: number to its name."""
    missed_landmarks: Mapping[int, MissedLandmark] = field(default_factory=dict[int, MissedLandmark])
    """Pokes that a landmark was asked for and that passed it too far, by their number."""
    corrections: Mapping[str, UsedCorrection] = field(default_factory=dict[str, UsedCorrection])
    """Corrections of the rig in use, by what they are of; the pokes are as they have them."""
    thresholds: ContactSettings = field(default_factory=ContactSettings)
    """Those by which pokes that begin now are judged."""
    closings: tuple[ClosingRound, ...] = ()
    """The closing checks that began, the newest last."""
    distances: tuple[TriedDistance, ...] = ()
    """Of each known distance between modules of the scene, whether the modules method uses it."""
    clocks: tuple[tuple[int, WallClock | None], ...] = ()
    """Of each part of the session the last poke before it, and its clock; None where nobody knows that."""
    skips: tuple[SkipPoke | SkipLandmark, ...] = ()
    """What the operator did not want to be asked for, in that order."""

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The contacts that count, in the order of their numbers."""
        return tuple(record.outcome for record in self.pokes if isinstance(record.outcome, Contact) and not record.excluded)


@dataclass(frozen=True, slots=True, eq=False)
class LiveView:
    """The newest readings, for curves and maps; kept out of the session since nothing depends on it."""

    wrench_s: FloatArray
    """(n,) float, host's monotonic clock, seconds: the last ten seconds."""
    wrench: FloatArray
    """(n, 6) float, N and N m, sensor frame, as the device says it."""
    skin: FloatArray
    """(channels,) float: the last frame's responses above their baselines, raw units; NaN where unusable."""
    skin_s: float
    """Host's monotonic clock of that frame, seconds; 0 before the first."""
    progress: Progress
    links: tuple[LinkHealth, ...]
    losses_unpaired: int
    """Skin frames that found no wrench."""
