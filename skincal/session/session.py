"""One calibration: its pokes, the operator's decisions, and the estimates.

A taxel is solved from the counting contacts alone, in the order of their numbers. So a poke that is excluded and restored gives
the same numbers to the last bit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.contacts.poke_columns import GrowingPokeColumns
from skincal.contacts.value_order import OrderOfValues, ValueOrderCounts
from skincal.geometry import FloatArray, IntArray
from skincal.journal.documents import WallClock
from skincal.model.actions import Action, AskPoke, FoundAtLandmark, Redo, Undo
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.model.tool_rig import BASE_LINK
from skincal.model.wrench_frames import WrenchFrame
from skincal.pokes import LandmarkPokes
from skincal.rig.correction import FRAME, RIG, Correction, CorrectionErrors, UsedCorrection
from skincal.rig.correction_fit import RigRequest
from skincal.rig.tip_frame import TipFrame, TipState, fit_tip_frame, pokes_of_fit
from skincal.rig.tip_fusion import TipFusion
from skincal.session.decisions import Decisions, apply_action, is_undoable, take_back, with_excluded
from skincal.session.landmark_pokes import (
    LandmarkNames,
    NearestLandmark,
    can_be_at_landmark,
    driven_to_leave_out,
    landmark_pokes,
    name_by_shape,
    nearest_landmarks,
)
from skincal.session.snapshot import ChangePlace, ChannelOrder, PokeRecord, Snapshot, without_excluded
from skincal.session.solving import Solving
from skincal.session.undo import ActionEntry, History
from skincal.taxels.result import POSITION_MAX_SD_M, Estimate, Method
from skincal.taxels.shared_errors import SharedRows
from skincal.version import __version__

if TYPE_CHECKING:
    from skincal.axes.axis_results import AxisResults
    from skincal.files.calibration import Calibration
    from skincal.mesh.surface import Surface
    from skincal.session.tool_findings import ToolFindings

MARKED_DEAD = "marked by the operator"
"""Reason of a channel that the operator left out."""


class Session:
    """Pokes, decisions, and the estimates of every method that the scene has.

    Parameters
    ----------
    surface : the scene's mesh; `None` leaves out the surface method, and modules lie free in space
    methods : methods to solve; `None` for all of the scene
    """

    def __init__(self, scene: Scene, surface: Surface | None, methods: Collection[Method] | None = None) -> None:
        self.scene = scene
        self.surface = surface
        self._solving = Solving(scene, surface, methods)
        self.methods = self._solving.methods
        self.module_model = self._solving.module_model
        """`None` if the modules method is not solved."""
        self.decisions = Decisions.at_start(scene)
        self.history = History()
        self.asked: AskPoke | None = None
        """Requested poke on the skin; `None` before the first request."""
        # By number, in ascending order.
        self._records: dict[int, PokeRecord] = {}
        self._order, self._columns, self._changes = ChannelOrder(()), GrowingPokeColumns(), list[int]()
        self._reported: dict[int, Outcome] = {}
        self._frame: UsedCorrection | None = None
        self._landmark_pokes: LandmarkPokes | None = None
        """As reported; `None` after a change."""
        self._framed: dict[int, tuple[Outcome, Outcome]] = {}
        """Pokes as reported and under the frame's correction `_frame`: what does not change stays the same object."""
        self.found_dead: Mapping[int, str] = {}
        """Channels that the detector found to be dead, also if the operator revived them."""
        self.dead: Mapping[int, str] = {}
        """Channels that are not used, ascending, with the reason."""
        self._answers: Counter[int] = Counter()
        """How many contacts that count each channel answered in."""
        layout = scene.skin.layout
        self._layout = None if layout is None else tuple(int(channel) for channel in layout.channels)
        self._solving.taxels_changed(self.channels)
        self.wrench_frames: tuple[WrenchFrame, ...] = ()
        """Frames that the messages of the wrench named, in their order."""
        self._value_order: OrderOfValues | None = None
        self._axis_results: tuple[Snapshot, AxisResults | None] | None = None
        self.tip_frame: TipFrame | None = None
        """Frame of the tip positions; `None` before the first contact with one."""
        self.tool: ToolFindings | None = None
        """Tip and part's pose by the pokes; `None` without `[tool]` in the scene."""
        if scene.tool is not None:
            from skincal.session.tool_findings import ToolFindings  # other scenes do without

            self.tool = ToolFindings(scene, surface)
            self._solving.is_placed = self.tool.is_placed
            self._use_tool_tip(self.tool)
        self._is_tool_current = True
        self._has_tips = False
        self._tips_fitted: tuple[Contact, ...] = ()
        self._assumed: Correction | None = None
        self._clocks: tuple[tuple[int, WallClock | None], ...] = ()
        self._touched: IntArray = np.empty(0, dtype=np.int64)
        self._generation = 0
        self._last: Snapshot | None = None
        self._snapshot: Snapshot | None = None
        """The last one if nothing changed since; else `None`."""

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The corrected contacts that count: accepted and not excluded, in the order of their numbers."""
        return tuple(self._counting(self._records))

    @property
    def excluded(self) -> tuple[int, ...]:
        """Numbers of the pokes that the operator excluded, ascending."""
        return tuple(sorted(self.decisions.excluded))

    @property
    def channels(self) -> tuple[int, ...]:
        """The taxels: those of the layout, or without one those that answered in a contact that counts."""
        if self._layout is not None:
            return self._layout
        return tuple(sorted(channel for channel, count in self._answers.items() if count))

    @property
    def last_poke(self) -> int:
        """Number of the newest poke, accepted or not; 0 before the first."""
        return next(reversed(self._records), 0)

    @property
    def landmark_pokes(self) -> LandmarkPokes:
        """The landmark pokes that count, in the order of their numbers, after the frame's correction only."""
        self._update_tool()
        pokes, used = without_excluded(self._reported_landmark_pokes(), self.decisions), self.decisions.corrections.get(FRAME)
        return pokes if used is None else used.correction.corrected_pokes(pokes)

    def _reported_landmark_pokes(self) -> LandmarkPokes:
        """Collect the landmark pokes, excluded ones, too, in the order of their numbers, as the rig reported them."""
        if self._landmark_pokes is None:
            named = self.decisions.landmark_of_poke
            outcomes = (self._placed(poke) for poke in sorted(named) if poke in self._reported)
            self._landmark_pokes = landmark_pokes(outcomes, self.decisions.landmarks, named)
        return self._landmark_pokes

    @property
    def shared_errors(self) -> SharedRows | None:
        """Uncertainty of the rig's correction in use; `None` without one, or if it was not recorded."""
        return self._solving.shared

    def rig_request(self) -> RigRequest:
        """Gather the input of a rig's correction."""
        counting = (poke for poke, record in self._records.items() if not record.excluded)
        contacts = [outcome for outcome in self.frame_corrected(counting) if isinstance(outcome, Contact)]
        scene, pokes = self.scene, self.landmark_pokes
        if self.tool is not None:
            if not self.tool.is_placed or not scene.has_sensor:
                pokes = pokes[:0]
            scene = self.snapshot().placed_scene(scene)
        return RigRequest(scene, self.surface, contacts, pokes, self.dead)

    @property
    def has_used_tip(self) -> bool:
        """Whether the tip of a tool is known and used."""
        return self.tool is not None and self.tool.has_used_tip

    def contact_of(self, outcome: Outcome) -> FloatArray | None:
        """Compute the point (3,) that a tool's tip touched at an outcome of `frame_corrected`, metres; `None` if unknown."""
        return None if self.tool is None else self.tool.contact_of(outcome)

    @property
    def part_sd(self) -> float:
        """m, largest sd of a point of the part in the frame of the pokes; 0 if its pose is not found from them."""
        part = None if self.tool is None else self.tool.part
        return 0.0 if part is None or not part.is_known else part.sd

    def contact_at(self, poke: int) -> FloatArray | None:
        """Compute the point (3,) that a tool's tip touched at a poke, as `contact_of`."""
        return None if self.tool is None else self.contact_of(self._placed(poke))

    def nearest_landmarks(self) -> dict[int, NearestLandmark]:
        """Find the landmark nearest to each poke that is not excluded, by poke; empty while the part's pose is unknown."""
        snapshot = self.snapshot()
        if not snapshot.is_placed:
            return {}
        pokes = [record.outcome.poke for record in snapshot.pokes if record.outcome.poke not in self.decisions.excluded]
        return nearest_landmarks(self.frame_corrected(pokes), self.decisions.landmarks, self.surface, self.contact_of)

    def sure_landmarks(self) -> dict[int, str]:
        """Name the landmark of each poke that has none and is surely at one, by poke; not of those that were taken from one."""
        named = {*self.snapshot().at_landmarks, *self.decisions.taken_from_landmarks}
        return {poke: near.name for poke, near in self.nearest_landmarks().items() if near.sure and poke not in named}

    def landmarks_by_shape(self, known: Mapping[int, str]) -> LandmarkNames | None:
        """Name the pokes that no taxel answered by the shape of the touched points; for a part whose pose is unknown.

        Parameters
        ----------
        known : names of pokes in addition to those that have one

        Returns
        -------
        `None` if fewer than three landmarks fit, or the tip is not known.
        """
        excluded, named = self.decisions.excluded, {**self.snapshot().at_landmarks, **known}
        left_out = self.decisions.taken_from_landmarks - named.keys()
        pokes = [poke for poke in self._records if poke not in excluded and poke not in left_out]
        outcomes = [each for each in self.frame_corrected(pokes) if isinstance(each, Rejection) or each.poke in named]
        return name_by_shape(outcomes, self.decisions.landmarks, self.surface, self.contact_of, self.scene.tool, named)

    def frame_corrected(self, pokes: Iterable[int]) -> list[Outcome]:
        """Return pokes with the correction of the sensor's frame, without the correction of the rig's small errors."""
        self._update_tool()
        return self._frame_corrected(pokes)

    def _frame_corrected(self, pokes: Iterable[int]) -> list[Outcome]:
        used = self.decisions.corrections.get(FRAME)
        if used is None:
            return [self._placed(poke) for poke in pokes]
        if used is not self._frame:
            self._frame, self._framed = used, {}
        found: list[Outcome] = []
        for poke in pokes:
            reported, corrected = self._framed.get(poke, (None, None))
            placed = self._placed(poke)
            if corrected is None or reported is not placed:
                corrected = used.correction.corrected(placed)
                self._framed[poke] = placed, corrected
            found.append(corrected)
        return found

    def _placed(self, poke: int) -> Outcome:
        """Find a poke's outcome as reported, in the part's frame if a tool's poses are in the base."""
        reported = self._reported[poke]
        return reported if self.tool is None else self.tool.placed(reported)

    def _update_tool(self) -> None:
        """Find tip and part's pose again if pokes changed, and carry all pokes with them."""
        if self.tool is None or self._is_tool_current:
            return
        self._is_tool_current = True
        excluded, named = self.decisions.excluded, self.decisions.landmark_of_poke
        counting = [poke for poke in self._records if poke not in excluded]
        known = {landmark.name: landmark for landmark in self.decisions.landmarks}
        marked = {poke: self._reported[poke] for poke in counting if named.get(poke) in known}
        marked = {poke: outcome for poke, outcome in marked.items() if can_be_at_landmark(outcome)}
        at = {poke: named[poke] for poke in marked}
        driven = self.decisions.driven_to_landmarks
        left_out = driven_to_leave_out(at, driven, finds_part_pose=self.scene.finds_part_pose) if driven else ()
        marked = {poke: outcome for poke, outcome in marked.items() if poke not in left_out}
        counting = [poke for poke in counting if poke not in left_out]
        contacts = [outcome for poke in counting if isinstance(outcome := self._reported[poke], Contact)]
        if not self.tool.update(contacts, marked, {poke: known[named[poke]] for poke in marked}):
            return
        self._solving.is_placed = self.tool.is_placed
        self._use_tool_tip(self.tool)
        self._landmark_pokes = None
        self._correct_all()
        self._changed()

    def _use_tool_tip(self, tool: ToolFindings) -> None:
        self.tip_frame = tip = tool.used_tip
        self._solving.tips = TipFusion(tip, self.scene.noise) if tip.state is TipState.USED else None

    def add(self, outcome: Outcome) -> None:
        """Add a poke's outcome, in place of an earlier one with its number."""
        poke = outcome.poke
        before = self._records.get(poke)
        was, now = before is not None and isinstance(before.outcome, Contact), isinstance(outcome, Contact)
        asked = self.asked if before is None else before.asked
        self._reported[poke] = outcome
        if poke in self.decisions.landmark_of_poke:
            self._landmark_pokes = None
        self._has_tips |= isinstance(outcome, Contact) and outcome.tip is not None
        self._store_record(PokeRecord(self._corrected(poke), poke in self.decisions.excluded, asked))
        # The tare after a poke can turn an accepted poke into a rejection, which cannot be undone.
        if now and not was:
            self.history = self.history.with_poke(poke)
        if was and not now:
            self.history = self.history.without_poke(poke)

    def set_clock(self, clock: WallClock | None) -> None:
        """Set the clock for the dates of pokes and actions from now on; `None` if unknown."""
        self._clocks = (*self._clocks, (self.last_poke, clock))

    def finalize_outcomes(self) -> None:
        """Mark every outcome as final, since no later sample can change it."""
        for outcome in [outcome for outcome in self._reported.values() if not outcome.final]:
            self.add(replace(outcome, final=True))

    @property
    def reported(self) -> Iterable[Outcome]:
        """Outcome of every poke before corrections of the rig."""
        return self._reported.values()

    def set_value_order(self, counts: ValueOrderCounts | None) -> None:
        """Set the order of the values of a skin of three axes, as the pokes of the whole session show it."""
        axes = self.scene.skin.axes
        if axes is None or counts is None or (self._value_order is not None and self._value_order.counts == counts):
            return
        self._value_order = OrderOfValues(counts, axes.order)
        self._changed()

    def outcome(self, poke: int) -> Outcome | None:
        """Give a poke's outcome as the rig reported it; `None` if there is no such poke."""
        return self._reported.get(poke)

    def corrected_outcome(self, poke: int) -> Outcome | None:
        """Give a poke's outcome as the corrections in use have it; `None` if there is no such poke."""
        record = self._records.get(poke)
        return None if record is None else record.outcome

    def set_detected_dead(self, found: Mapping[int, str]) -> None:
        """Set the channels that the detector found to be dead, in place of those before."""
        if found is self.found_dead or dict(found) == dict(self.found_dead):
            return
        self.found_dead = dict(found)
        self._update_dead()
        self._changed()

    def assume_corrected(self, correction: Correction | None) -> None:
        """Take all contacts as corrected already: estimates carry the uncertainty of `correction`."""
        if correction is not self._assumed:
            self._assumed = correction
            self._share_errors(correction)
            self._changed()

    def act(self, action: Action, at_s: float = math.nan) -> None:
        """Apply an action of the operator, a request of the guide, or a finding of the pipeline.

        Parameters
        ----------
        at_s : host's monotonic clock, seconds, for the history

        Raises
        ------
        InputError
            There is no such poke, pose, landmark or channel, or nothing to undo or redo. The session is unchanged.
        """
        if isinstance(action, Undo):
            self._undo()
        elif isinstance(action, Redo):
            self._redo()
        else:
            before = self.decisions
            self._decide(self._applied(action))
            if isinstance(action, AskPoke):
                self.asked = action
            if is_undoable(action):
                entry = ActionEntry(action, before, self._wall_s(at_s))
                self.history = self.history.with_action(entry, is_operator=not isinstance(action, FoundAtLandmark))
            elif self.decisions is before:
                # A request alone changes nothing that anybody sees.
                return
        self._changed()

    def _applied(self, action: Action) -> Decisions:
        return apply_action(action, self.decisions, self.scene, self._reported)

    def _undo(self) -> None:
        at = self.history.undoable(self.decisions.excluded)
        if at < 0:
            raise InputError("There is nothing to undo: no poke was accepted and nothing was changed.")
        entry = self.history.entries[at]
        if isinstance(entry, ActionEntry):
            self._decide(take_back(entry.action, entry.before, self.decisions))
        else:
            self._decide(with_excluded(self.decisions, entry, out=True))
        self.history = self.history.after_undo(at)

    def _redo(self) -> None:
        if not self.history.undone:
            raise InputError("There is nothing to redo: no action was undone, or another action followed.")
        entry = self.history.undone[-1]
        if isinstance(entry, ActionEntry):
            entry = replace(entry, before=self.decisions)
            self._decide(self._applied(entry.action))
        else:
            self._decide(with_excluded(self.decisions, entry, out=False))
        self.history = self.history.after_redo(entry)

    def _wall_s(self, at_s: float) -> float:
        clock = self._clocks[-1][1] if self._clocks else None
        return math.nan if clock is None else clock.at(at_s)

    def _decide(self, now: Decisions) -> None:
        """Replace the decisions, and mark the results that depend on them as changed."""
        before, self.decisions = self.decisions, now
        if before.landmark_of_poke is not now.landmark_of_poke or before.landmarks is not now.landmarks:
            self._landmark_pokes = None
        for poke in before.excluded ^ now.excluded:
            self._store_record(replace(self._records[poke], excluded=poke in now.excluded))
        if before.marked is not now.marked or before.revived is not now.revived:
            self._update_dead()
        if before.corrections is not now.corrections:
            self._correct_all()

    @property
    def unsolved(self) -> int:
        """Number of taxels to solve before there is a new snapshot."""
        return self._solving.waiting

    def snapshot(self, within_s: float = math.inf) -> Snapshot:
        """Solve the taxels that changed, and give everything a view may show; the same object until something changes.

        Parameters
        ----------
        within_s : s. Solving pauses after this or little later and continues with the next call; until it is done the last
            snapshot is returned. The estimates are the same to the bit. The first snapshot is not limited.
        """
        if self._snapshot is not None:
            return self._snapshot
        self._update_tool()
        channels = self.channels
        self._fit_tips()
        self._solving.solve(
            channels, self._records.keys(), self._counting, self.dead, math.inf if self._last is None else within_s
        )
        if self.unsolved and self._last is not None:
            return self._last
        fresh = self._solving.take_fresh()
        # The first snapshot solves every taxel, which is no poke's doing.
        if len(fresh) and self._generation:
            self._touched = fresh
        pokes, estimates = self._reported_landmark_pokes(), self._solving.estimates(channels)
        if self.tool is not None:
            estimates = self.tool.with_shared_errors(estimates, self.contacts)
        self._last = self._snapshot = Snapshot(
            generation=self._generation,
            pokes=tuple(self._records.values()),
            estimates=estimates,
            touched=self._touched,
            dead=self.dead,
            decisions=self.decisions,
            history=self.history,
            landmark_pokes=pokes,
            at_landmarks=dict(zip(pokes.number.tolist(), pokes.name.tolist(), strict=True)),
            tried_distances=self._solving.tried_distances,
            clocks=self._clocks,
            tip_frame=self.tip_frame,
            part_pose=None if self.tool is None else self.tool.part,
            part_misfit=None if self.tool is None else self.tool.misfit,
            typed_pose_error=None if self.tool is None else self.tool.typed_error,
            off_mesh=None if self.tool is None else self.tool.off_mesh,
            wrong_scale=None if self.tool is None else self.tool.wrong_scale,
            wrench_frames=self.wrench_frames,
            value_order=self._value_order,
            part_size=self._part_size(estimates),
            noise=self.scene.noise,
            table=self._solving.table_state,
            columns_now=self._columns.now(),
            channels=self._channel_order(channels),
            changes=ChangePlace(self._changes, len(self._changes)),
            turns=self._solving.turns,
        )
        return self._snapshot

    def _channel_order(self, channels: Sequence[int]) -> ChannelOrder:
        if self._order.channels is not channels:
            self._order = ChannelOrder(channels)
        return self._order

    def _part_size(self, estimates: Mapping[Method, Sequence[Estimate]]) -> float:
        """Find the part's size, metres, for `Snapshot.part_size`."""
        if self.surface is not None:
            return self.surface.size
        if self.scene.skin.layout is not None:
            return max(self.scene.skin.layout.size, POSITION_MAX_SD_M)
        places = [each.position for each in chain(*estimates.values()) if each.position is not None]
        return max(float(np.ptp(places, axis=0).max()) if places else 0.0, POSITION_MAX_SD_M)

    def _fit_tips(self) -> None:
        """Fit the frame of the tip positions again when enough pokes came, or one of its pokes changed."""
        if not self._has_tips or self.tool is not None:
            return
        contacts = [contact for contact in self.contacts if contact.tip is not None]
        used = tuple(contacts[: pokes_of_fit(len(contacts))])
        if self.tip_frame is not None and list(map(id, used)) == list(map(id, self._tips_fitted)):
            return
        self._tips_fitted, self.tip_frame = used, fit_tip_frame(used, self.scene.noise)
        self._solving.tips = None
        if self.tip_frame.state is TipState.USED:
            self._solving.tips = TipFusion(self.tip_frame, self.scene.noise)
        for contact in contacts:
            self._solving.poke_changed(contact.poke, contact.channels.tolist())

    def axis_results(self) -> AxisResults | None:
        """Gather the findings on the axes of the newest snapshot, once; see `Snapshot.axis_results`."""
        snapshot = self.snapshot()
        if self._axis_results is None or self._axis_results[0] is not snapshot:
            self._axis_results = snapshot, snapshot.axis_results(self.scene.skin.layout)
        return self._axis_results[1]

    def calibration(self) -> Calibration:
        """Gather what the calibration files are written from."""
        from skincal.files.calibration import Calibration, SmoothedEstimates
        from skincal.session.closing_pokes import closings_of
        from skincal.session.tool_sentences import session_tool_sentences

        snapshot, decisions = self.snapshot(), self.decisions
        outcomes = [self._placed(poke) for poke in self._records]
        scene = self.scene if snapshot.is_placed else replace(self.scene, link=BASE_LINK)
        return Calibration(
            scene=replace(scene, contacts=decisions.thresholds),
            channels=self.channels,
            estimates=SmoothedEstimates(snapshot.estimates, self.surface, self.scene.skin.layout),
            contacts=tuple(outcome for outcome in outcomes if isinstance(outcome, Contact)),
            mesh_sha256=None if self.surface is None else self.surface.sha256,
            version=__version__,
            excluded=self.excluded,
            dead=self.dead,
            corrections=tuple(decisions.corrections.values()),
            landmark_pokes=snapshot.landmark_pokes,
            closings=closings_of(snapshot, self.scene.noise),
            part_size=snapshot.part_size,
            part_pose=snapshot.part_pose,
            tool=session_tool_sentences(snapshot, scene),
            axes=self.axis_results(),
        )

    def _counting(self, pokes: Iterable[int]) -> list[Contact]:
        """Select those of `pokes` that count, in the order of their numbers."""
        records = (self._records[poke] for poke in sorted(pokes))
        return [record.outcome for record in records if isinstance(record.outcome, Contact) and not record.excluded]

    def _corrected(self, poke: int) -> Outcome:
        (outcome,) = self._frame_corrected([poke])
        used = self.decisions.corrections.get(RIG)
        return outcome if used is None else used.correction.corrected(outcome)

    def _correct_all(self) -> None:
        if self.tool is not None:
            self.tool.place(self._reported.values())
        for poke, record in self._records.items():
            outcome = self._corrected(poke)
            # A value under an existing key may change while the items are iterated.
            self._records[poke] = replace(record, outcome=outcome)
            self._changes.append(poke)
            if isinstance(outcome, Contact):
                self._solving.poke_changed(poke, ())
        used = self.decisions.corrections.get(RIG)
        self._share_errors(None if used is None else used.correction)

    def _share_errors(self, correction: Correction | None) -> None:
        self._solving.shared = None
        if correction is not None and not correction.exact:
            self._solving.shared = CorrectionErrors(correction, self._contact)
        self._solving.taxels_changed(self.channels)

    def _contact(self, poke: int) -> Contact:
        outcome = self._records[poke].outcome
        assert isinstance(outcome, Contact)
        return outcome

    def _update_dead(self) -> None:
        before, revived = self.dead, self.decisions.revived
        found = {channel: why for channel, why in self.found_dead.items() if channel not in revived}
        found |= dict.fromkeys(self.decisions.marked, MARKED_DEAD)
        self.dead = {channel: found[channel] for channel in sorted(found)}
        known = before.keys() | found.keys()
        self._solving.taxels_changed(channel for channel in known if before.get(channel) != found.get(channel))

    def _store_record(self, record: PokeRecord) -> None:
        """Put a poke's record in place of the one before, and mark its taxels as changed."""
        poke = record.outcome.poke
        before, late = self._records.get(poke), poke < self.last_poke
        self._records[poke] = record
        self._columns.store(record.outcome, record.excluded)
        self._changes.append(poke)
        if before is None and late:
            self._records = dict(sorted(self._records.items()))
        for each, by in ((before, -1), (record, 1)):
            if each is not None and isinstance(each.outcome, Contact):
                channels = each.outcome.channels.tolist()
                self._solving.poke_changed(poke, channels)
                if not each.excluded:
                    for channel in channels:
                        self._answers[channel] += by
        self._changed()

    def _changed(self) -> None:
        self._is_tool_current = False
        # All changes between two snapshots are one generation.
        if self._snapshot is not None:
            self._generation += 1
            self._snapshot = None
