"""A frozen picture of a session: everything a view may show."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, PressPhase, Progress, Rejection
from skincal.contacts.poke_columns import PokeColumns
from skincal.contacts.poke_counts import PokeCounts, count_pokes
from skincal.contacts.value_order import OrderOfValues
from skincal.geometry import FloatArray, IntArray
from skincal.journal.documents import WallClock
from skincal.model.actions import AskPoke, AtLandmark, Exclude, Restore
from skincal.model.readings import LinkHealth
from skincal.model.scene import NoiseSettings, Scene
from skincal.model.wrench_frames import WrenchFrame
from skincal.pokes import NO_LANDMARK_POKES, LandmarkPokes
from skincal.rig.correction import FRAME, RIG
from skincal.rig.tip_frame import TipFrame, TipState
from skincal.rig.tip_fusion import TipFusion
from skincal.session.decisions import Decisions
from skincal.session.landmark_pokes import driven_to_leave_out
from skincal.session.undo import History, describe_entry
from skincal.taxels.contact_table import ContactTable, Evidence, TableState
from skincal.taxels.result import Cause, Estimate, Method, State, StateReason

if TYPE_CHECKING:
    from skincal.axes.axis_results import AxisResults
    from skincal.axes.session_turns import SessionTurns, ShownTurn
    from skincal.axes.taxel_frames import FrameState
    from skincal.model.skin import Layout
    from skincal.modules.distances import TriedDistance
    from skincal.rig.mesh_distance import MeshDistance
    from skincal.rig.part_pose import PartPose
    from skincal.rig.part_scale import WrongScale
    from skincal.session.tool_findings import PartMisfit

UNPLACED = StateReason(Cause.PART_UNPLACED)
"""Reason of a taxel whose place on the part is unknown, since that of the part is."""


@dataclass(frozen=True, slots=True)
class PokeRecord:
    """Present state of one poke in the session."""

    outcome: Outcome
    excluded: bool
    """The operator took it out; it stays in the journal and can be restored."""
    asked: AskPoke | None = None
    """Request of the guide at the time of the poke; `None` if unknown."""

    @property
    def is_excluded_contact(self) -> bool:
        """Whether it would count for the taxels if it were not excluded."""
        return self.excluded and isinstance(self.outcome, Contact)


@dataclass(frozen=True, slots=True, eq=False)
class ChangePlace:
    """Place in the list of a session's changed pokes, which only grows."""

    numbers: Sequence[int]
    """Number of each poke that was added or changed, in the order of the changes."""
    count: int
    """Changes so far."""

    def changed_since(self, earlier: ChangePlace | None) -> Sequence[int] | None:
        """List the pokes that changed since an earlier place, ascending; `None` if that is of another list."""
        if earlier is None or earlier.numbers is not self.numbers:
            return None
        return sorted(set(self.numbers[min(earlier.count, self.count) : max(earlier.count, self.count)]))


class ChannelOrder:
    """Order of channels, which snapshots share, and the place of each."""

    def __init__(self, channels: Sequence[int]) -> None:
        self.channels = channels

    @cached_property
    def place_of(self) -> Mapping[int, int]:
        """Place of each channel."""
        return {channel: place for place, channel in enumerate(self.channels)}


def without_excluded(pokes: LandmarkPokes, decisions: Decisions) -> LandmarkPokes:
    """Leave out the pokes that the operator excluded."""
    return pokes[~np.isin(pokes.number, list(decisions.excluded))]


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Everything that a session holds at one moment. Snapshots of the same generation are equal."""

    generation: int
    pokes: tuple[PokeRecord, ...]
    """In the order of their numbers, as the corrections in use have them."""
    estimates: Mapping[Method, tuple[Estimate, ...]]
    """For each method of the scene one estimate a taxel, in the order of `Session.channels`."""
    touched: IntArray
    """Channels whose estimates changed with the last poke or action."""
    dead: Mapping[int, str] = field(default_factory=dict[int, str])
    """Channels that are not used, with the reason."""
    decisions: Decisions = field(default_factory=Decisions)
    history: History = field(default_factory=History)
    at_landmarks: Mapping[int, str] = field(default_factory=dict[int, str])
    """Pokes at landmarks that have a force axis: number to the landmark's name."""
    landmark_pokes: LandmarkPokes = NO_LANDMARK_POKES
    """The same as the rig reported them, excluded ones, too, in the order of their numbers."""
    tried_distances: tuple[TriedDistance, ...] = ()
    """For each known distance between modules, whether the modules method uses it."""
    clocks: tuple[tuple[int, WallClock | None], ...] = ()
    """For each part of the session the last poke before it, and its clock; `None` if the recording does not say."""
    tip_frame: TipFrame | None = None
    """Frame of the tip positions; `None` without a tip stream."""
    part_pose: PartPose | None = None
    """Pose of the part in the base of a tool's poses; `None` unless it is found from the pokes."""
    part_misfit: PartMisfit | None = None
    """Touches that the best pose of the part misses, for a slow search for the mistake; `None` if they fit."""
    typed_pose_error: PartPose | None = None
    """Pose of the part that the pokes show in place of a given one; `None` if they agree with it."""
    wrong_scale: WrongScale | None = None
    """Scale of the part's drawing that a tool's touches contradict; `None` if they agree with it."""
    off_mesh: MeshDistance | None = None
    """Distance of a tool's touches from the mesh that is far beyond their error; `None` if they agree with a given pose."""
    wrench_frames: tuple[WrenchFrame, ...] = ()
    """Frames that the messages of the wrench name; empty without such messages."""
    value_order: OrderOfValues | None = None
    """What the pokes say of the order of the values; `None` for a skin of one axis, and before the first poke."""
    part_size: float = inf
    """m, of `known_error`: of the mesh, else of the layout, else of the box around the estimates."""
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    """Of the scene."""
    table: TableState | None = None
    """Rows of the contacts, shared with the session until it solves again; see `evidence`."""
    columns_now: PokeColumns | None = None
    """Columns of `pokes` if the session keeps them; see `columns`."""
    channels: ChannelOrder | None = None
    """Order of the channels in the estimates, which the session's snapshots share; see `estimate_of`."""
    changes: ChangePlace | None = None
    """Place in the session's list of changes; `None` if it has none."""
    turns: SessionTurns | None = None
    """Turns of taxels that measure three axes, in the frame of the positions; `None` for other skins."""

    def axis_results(self, layout: Layout | None) -> AxisResults | None:
        """Gather the findings on the axes; `None` for a skin of one axis, or while the part is not placed."""
        if self.turns is None:
            return None
        from skincal.axes.axis_results import AxisResults  # other skins do without

        return AxisResults(self.turns, layout, self.estimates, self.value_order)

    def shown_turn(self, channel: int) -> ShownTurn | FrameState | None:
        """Give the turn of a taxel, or why it has none, as `turn_or_reason` does; a dead z is not known here."""
        if self.turns is None:
            return None
        from skincal.axes.taxel_frames import turn_or_reason  # other skins do without

        is_order_wrong = self.value_order is not None and self.value_order.is_wrong
        return turn_or_reason(self.turns, channel, is_order_wrong=is_order_wrong)

    @property
    def is_placed(self) -> bool:
        """Whether positions are in the part's frame; else they are in the base of the tool's poses."""
        return self.part_pose is None or self.part_pose.is_known

    def placed_scene(self, scene: Scene) -> Scene:
        """Give the scene the part's pose in the base if pokes showed it."""
        if scene.tool is None or self.part_pose is None or not self.part_pose.is_known:
            return scene
        return replace(scene, tool=replace(scene.tool, link_from_base=self.part_pose.link_from_base))

    @property
    def on_part(self) -> Snapshot:
        """The snapshot without positions that are in another frame than the part's; itself once these are known."""
        return self if self.is_placed else self._without_positions

    @cached_property
    def _without_positions(self) -> Snapshot:
        estimates = {
            method: tuple(
                each if each.position is None else Estimate(each.channel, method, State.BLIND, each.contacts, reason=UNPLACED)
                for each in of
            )
            for method, of in self.estimates.items()
        }
        return replace(self, estimates=estimates, turns=None)

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The contacts that count, in the order of their numbers."""
        return self._contacts

    @cached_property
    def _contacts(self) -> tuple[Contact, ...]:
        counting = (record.outcome for record in compress(self.pokes, self.columns.counting.tolist()))
        return tuple(outcome for outcome in counting if isinstance(outcome, Contact))

    @property
    def columns(self) -> PokeColumns:
        """Columns of `pokes`."""
        return self._own_columns if self.columns_now is None else self.columns_now

    @cached_property
    def _own_columns(self) -> PokeColumns:
        return PokeColumns.collect((record.outcome, record.excluded) for record in self.pokes)

    @cached_property
    def _place_of_channel(self) -> Mapping[int, int]:
        """Places of the channels in the estimates, which are in one order by all methods."""
        if self.channels is not None:
            return self.channels.place_of
        return ChannelOrder([estimate.channel for estimate in next(iter(self.estimates.values()), ())]).place_of

    def record_of(self, poke: int) -> PokeRecord | None:
        """Find the record of a poke; `None` if there is none."""
        row = int(np.searchsorted(self.columns.numbers, poke))
        return self.pokes[row] if row < len(self.pokes) and self.pokes[row].outcome.poke == poke else None

    def contact(self, poke: int) -> Contact:
        """Find a contact that counts; raise `KeyError` if there is none of that number."""
        record = self.record_of(poke)
        if record is None or record.excluded or not isinstance(record.outcome, Contact):
            raise KeyError(poke)
        return record.outcome

    def changes_since(self, earlier: Snapshot | None) -> dict[int, Outcome | None]:
        """Map the pokes that may have changed since an earlier snapshot, ascending, to outcomes; `None` for excluded contacts.

        Without an earlier snapshot of the same session these are all pokes of both.
        """
        place = None if earlier is None else earlier.changes
        changed = None if self.changes is None else self.changes.changed_since(place)
        if changed is None:
            pokes = () if earlier is None else earlier.pokes
            changed = sorted({record.outcome.poke for record in (*pokes, *self.pokes)})
        records = ((poke, self.record_of(poke)) for poke in changed)
        return {poke: None if record is None or record.is_excluded_contact else record.outcome for poke, record in records}

    def contacts_newest_first(self) -> Iterator[Contact]:
        """Give the contacts that count, one by one: a list of the newest reads no older ones."""
        return (
            record.outcome for record in reversed(self.pokes) if not record.excluded and isinstance(record.outcome, Contact)
        )

    def estimate_of(self, channel: int | None, method: Method) -> Estimate | None:
        """Find a channel's estimate by a method; `None` if it has none."""
        estimates = self.estimates.get(method, ())
        place = len(estimates) if channel is None else self._place_of_channel.get(channel, len(estimates))
        if place < len(estimates) and estimates[place].channel == channel:
            return estimates[place]
        return next((estimate for estimate in estimates if estimate.channel == channel), None)

    def evidence(self, channels: Collection[int]) -> Evidence:
        """Gather the evidence of those of `channels` that answered in a contact that counts, all with full weight.

        Only the session's thread may ask; another one asks the `detached` snapshot.
        """
        table = None if self.table is None else self.table.unchanged_table
        return self._own_evidence.evidence(channels) if table is None else table.evidence(channels)

    @cached_property
    def _own_evidence(self) -> Evidence:
        """Evidence of all channels, gathered from `contacts`."""
        table = ContactTable(self._contacts_with_tips)
        return table.evidence({channel for contact in self.contacts for channel in contact.channels.tolist()})

    @property
    def _contacts_with_tips(self) -> Sequence[Contact]:
        """The contacts; their axes are moved towards the tips if these are used."""
        if self.tip_frame is None or self.tip_frame.state is not TipState.USED:
            return self.contacts
        return TipFusion(self.tip_frame, self.noise).moved_axes(self.contacts)

    def detached(self) -> Snapshot:
        """Copy the snapshot for another thread: it shares no table with the session."""
        return replace(self, table=None)

    @cached_property
    def counting_landmark_pokes(self) -> LandmarkPokes:
        """The landmark pokes that are not excluded, with the corrections in use, in the order of their numbers."""
        pokes = without_excluded(self.landmark_pokes, self.decisions)
        for kind in (FRAME, RIG):
            if kind in self.decisions.corrections:
                pokes = self.decisions.corrections[kind].correction.corrected_pokes(pokes)
        return pokes

    @property
    def driven_to_landmarks(self) -> int:
        """Number of the touches of landmarks that gave the part's pose although a robot drove there by a pose of it."""
        driven, excluded = self.decisions.driven_to_landmarks, self.decisions.excluded
        if not driven:
            return 0
        at = {poke: name for poke, name in self.at_landmarks.items() if poke not in excluded}
        return len(driven & at.keys()) - len(driven_to_leave_out(at, driven))

    @property
    def poke_counts(self) -> PokeCounts:
        """Counts of all pokes."""
        return self._poke_counts

    @cached_property
    def _poke_counts(self) -> PokeCounts:
        return count_pokes(
            (record.outcome, self.is_taken_out(record), record.outcome.poke in self.at_landmarks) for record in self.pokes
        )

    def is_taken_out(self, record: PokeRecord) -> bool:
        """Whether the operator excluded a poke, or took a rejected one from its landmark."""
        taken = isinstance(record.outcome, Rejection) and record.outcome.poke in self.decisions.taken_from_landmarks
        return record.excluded or taken

    def actions_to_exclude(self, pokes: Collection[int]) -> tuple[Exclude | AtLandmark, ...]:
        """List the actions that exclude pokes, by their numbers; a rejected one at a landmark is taken from it."""
        found: list[Exclude | AtLandmark] = []
        for record in self._records_of(pokes):
            number = record.outcome.poke
            if isinstance(record.outcome, Contact) and not record.excluded:
                found.append(Exclude(number))
            elif isinstance(record.outcome, Rejection) and number in self.at_landmarks:
                found.append(AtLandmark(number, ""))
        return tuple(found)

    def actions_to_restore(self, pokes: Collection[int]) -> tuple[Restore, ...]:
        """List the actions that use excluded pokes again, by their numbers."""
        return tuple(Restore(record.outcome.poke) for record in self._records_of(pokes) if record.excluded)

    def _records_of(self, pokes: Collection[int]) -> list[PokeRecord]:
        wanted = set(pokes)
        return [record for record in self.pokes if record.outcome.poke in wanted]

    @cached_property
    def can_undo(self) -> str:
        """Description of the entry that undo reverses; empty without one."""
        at = self.history.undoable(self.decisions.excluded)
        return "" if at < 0 else describe_entry(self.history.entries[at])

    @property
    def can_redo(self) -> str:
        """Description of the entry that redo would do again; empty without one."""
        return describe_entry(self.history.undone[-1]) if self.history.undone else ""


def snapshot_of(contacts: Sequence[Contact], estimates: Mapping[Method, Sequence[Estimate]]) -> Snapshot:
    """Make a snapshot of contacts that all count, in the order of their numbers, and of estimates by them."""
    records = tuple(PokeRecord(contact, excluded=False) for contact in contacts)
    return Snapshot(0, records, {method: tuple(every) for method, every in estimates.items()}, np.empty(0, dtype=np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class LiveView:
    """The newest readings, for curves and maps. Nothing in the session depends on them."""

    wrench_s: FloatArray
    """(n,) float, host's monotonic clock, seconds: the last ten seconds."""
    wrench: FloatArray
    """(n, 6) float, N and N m, sensor frame, as the device reports it."""
    skin: FloatArray
    """(channels,) float: the last frame's responses above their baselines, raw units; NaN where unusable."""
    progress: Progress
    links: tuple[LinkHealth, ...]
    losses_unpaired: int
    """Skin frames that found no wrench."""
    pose: str = ""
    """Name of the current arm pose, chosen or streamed; empty if unknown."""
    link_from_sensor: FloatArray | None = None
    """(4, 4) float of the current arm pose; `None` while unknown."""

    @classmethod
    def at_rest(cls) -> LiveView:
        """Make the readings of no device."""
        none, still = np.empty(0), np.zeros(3)
        progress = Progress(PressPhase.READY, still, still, np.empty(0, dtype=np.int64), none, 0.0)
        return cls(none, np.empty((0, 6)), none, progress, (), 0)
