"""Pipeline from bytes to session: journal, decoding, pairing, pokes, landmarks.

Real, replayed and simulated devices differ only in the source of the items. The result depends on the sequence of items and
actions alone, never on a clock: a replay is the same bit for bit.

After a request for a landmark (`AskLandmark`) the pipeline finds which poke was there and adds an action (`FoundAtLandmark` or
`MissedLandmark`).
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.detector import ContactDetector
from skincal.contacts.outcome import BeforePokes, Contact, Outcome, PressPhase
from skincal.contacts.pose_delays import PoseDelays
from skincal.contacts.skin_condition import SkinCondition
from skincal.geometry import FloatArray
from skincal.journal.documents import DetectorResult, Item, Result, SessionClosed, Totals
from skincal.journal.writer import JournalFailure, JournalWriter
from skincal.model.actions import Action, AskLandmark, AskPoke, SkipLandmark, TimedAction, UseSkinUnit
from skincal.model.errors import InputError
from skincal.model.readings import TEMPERATURE_NAME, Chunk, LinkEvent, LinkHealth, LinkState, Sample, Stream, Tick, is_silent
from skincal.model.scene import Scene
from skincal.model.skin import RESPONSE_MIN_OF_UNIT
from skincal.model.wrench_frames import FrameKind, WrenchFrame, WrenchPlace
from skincal.session.arm_poses import ArmPoses, CurrentPose
from skincal.session.corrections import corrected_progress
from skincal.session.landmark_pokes import LandmarkFinder
from skincal.session.session import Session
from skincal.session.snapshot import LiveView, Snapshot
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import Intake
from skincal.streams.links import LinkSpec
from skincal.words.link_words import BINARY_LEVELS, binary_skin, freeze_sentences

if TYPE_CHECKING:
    from skincal.contacts.pose_delay_watch import PoseDelayWatch
    from skincal.mesh.lay import PlacedLayout
    from skincal.mesh.surface import Surface

WRENCH_RECORD_PERIOD_NS = 500_000_000
"""ns between decoded wrenches in the journal."""
DELAY_REFIT_RATIO = 1.25
"""The delay of a tool's poses is found again when its presses grow by a quarter."""
READING_COUNTS_RECORD_PERIOD_NS = 5_000_000_000
"""ns between counts of readings in the journal; the last come at the end."""
_LOST_STATES = (LinkState.LOST, LinkState.FAILED)


def _detector_of(scene: Scene) -> type[ContactDetector]:
    """Choose the detector of a rig with a force/torque sensor, or of one without."""
    if scene.has_sensor:
        return ContactDetector
    from skincal.contacts.touch_detector import TouchDetector  # other rigs do without

    return TouchDetector


def _delay_watch_of(scene: Scene) -> PoseDelayWatch | None:
    """Make the watch of the delay of a tool's poses; `None` for a rig without them."""
    if scene.tool is None:
        return None
    from skincal.contacts.pose_delay_watch import PoseDelayWatch  # other rigs do without

    return PoseDelayWatch(has_sensor=scene.has_sensor)


class Pipeline:
    """Processes items and actions, and holds the session.

    Parameters
    ----------
    surface : the scene's mesh; `None` leaves out the surface method
    journal : open for writing; `None` records nothing
    laid : the layout on the part; if missing it is laid for the first landmark poke
    """

    def __init__(
        self,
        scene: Scene,
        links: Sequence[LinkSpec],
        surface: Surface | None,
        journal: JournalWriter | None = None,
        laid: PlacedLayout | None = None,
    ) -> None:
        self.scene = scene
        self.session = Session(scene, surface)
        self.journal = journal
        self.journal_failure = ""
        """Why recording has ended, for the operator; empty without a failure."""
        self.findings: tuple[str, ...] = ()
        """Sentences about damage of the replayed session."""
        self._detector = _detector_of(scene)(scene)
        self._dead = self._detector.dead
        self.laid = laid
        """The layout on the part; `None` if it is not laid."""
        self._earlier = Totals()
        self._frame_names: tuple[str, ...] = ()
        self.reads_frames = True
        """Wrenches are converted from the frames that messages name; in sessions of old formats they are not."""
        self.finds_skin_unit = True
        """The default of `response_min` follows the unit of the skin. A replay has the recorded action in its place."""
        self._now_ns = 0
        self._unwritten: list[Chunk | Tick | Sample] = []
        """Entries of the journal without results, which are written together."""
        self._found_dead = False
        self.poses = ArmPoses(scene)
        self.session.set_clock(None if journal is None else journal.clock)
        self._connect(links)

    def _connect(self, links: Sequence[LinkSpec]) -> None:
        self.links = tuple(links)
        self.links_without_skin = frozenset(link.name for link in links if link.carries and Stream.SKIN not in link.carries)
        """Names of the links whose readings complete a sample only if a frame waits for them."""
        self._intake = Intake(ExpectedReadings.of_scene(self.scene), links, self._find_frame)
        self._delay_watch = _delay_watch_of(self.scene)
        self._delay_fitted = 0
        self._frozen = frozenset[str]()
        self.poses.forget_stream()
        session = self.session
        self._landmarks = LandmarkFinder(self._taxel_places, session.surface, session.contact_at, lambda: session.part_sd)
        self._totals_ns: int | None = None
        self._begin_ns = 0
        self._ended_links = set[str]()
        self._decoded_ns, self._decoded_s = 0, -np.inf
        self._current_pose(None)

    def feed(self, item: Chunk | LinkEvent) -> None:
        """Process the next item of the queue, the journal or a recording; `InputError` for an unknown link."""
        self._intake.check(item)  # before anything is recorded
        self._begin_ns = self._begin_ns or item.host_ns
        outcomes: list[Outcome] = []
        try:
            samples = self._intake.feed(item)
            self._note_devices(item.host_ns)
            for sample in samples:
                outcomes += self._process_sample(sample)
            if self._interrupts_samples(item):
                ended = isinstance(item, LinkEvent) and item.state is LinkState.ENDED
                outcomes += self._detector.reset(item.host_ns * 1e-9, is_loss=not ended)
        finally:
            self._commit(item, outcomes)  # also where the work fails: these bytes are worth keeping
        self._decoded_wrenches(item.host_ns)

    def feed_many(self, items: Sequence[Chunk | LinkEvent | Tick]) -> None:
        """Process successive items together. The results are those of `feed` and `tick` for each, to the last bit."""
        at = 0
        while at < len(items):
            run = self._run_from(items, at)
            if len(run) > 1:
                self._feed_run(run)
                at += len(run)
                continue
            item = items[at]
            at += 1
            if isinstance(item, Tick):
                self.tick(item.host_ns)
            else:
                self.feed(item)

    def _run_from(self, items: Sequence[Chunk | LinkEvent | Tick], begin: int) -> list[Chunk | Tick]:
        """Return the ticks and chunks of known links from `begin` on at which the journal counts no readings."""
        totals_due_ns = np.inf if self.journal is None else -np.inf
        if self.journal is not None and self._totals_ns is not None:
            totals_due_ns = self._totals_ns + READING_COUNTS_RECORD_PERIOD_NS
        run: list[Chunk | Tick] = []
        for item in islice(items, begin, None):
            if isinstance(item, LinkEvent):
                break
            if isinstance(item, Chunk) and (item.host_ns >= totals_due_ns or not self._intake.knows(item.link)):
                break
            run.append(item)
        return run

    def _feed_run(self, items: Sequence[Chunk | Tick]) -> None:
        """Process chunks of known links at which the journal counts no readings."""
        chunks = [item for item in items if isinstance(item, Chunk)]
        self._begin_ns = self._begin_ns or (chunks[0].host_ns if chunks else 0)
        unwritten, decoded_due_ns = self._unwritten, self._decoded_due_ns
        fed, rest = self._intake.feed_many(chunks), deque(items)
        try:
            while rest:
                if isinstance(item := rest[0], Tick):
                    unwritten.append(rest.popleft())
                    continue
                samples, changes_frozen = next(fed)
                rest.popleft()
                has_news = self._intake.has_new_frames or (self.finds_skin_unit and self._intake.skin_unit)
                if samples or changes_frozen or has_news:
                    self._process_decoded(item, samples, changes_frozen=changes_frozen)
                else:
                    unwritten.append(item)
                if item.host_ns >= decoded_due_ns:
                    self._write_waiting()
                    self._decoded_wrenches(item.host_ns)
                    decoded_due_ns = self._decoded_due_ns
        finally:
            unwritten.extend(rest)  # where the work fails: these bytes are worth keeping
            self._now_ns = max([self._now_ns, *(item.host_ns for item in chunks)])
            self._write_waiting()

    def _process_decoded(self, chunk: Chunk, samples: Sequence[Sample], *, changes_frozen: bool) -> None:
        """Process the samples of a chunk of a run."""
        outcomes: list[Outcome] = []
        try:
            self._note_devices(chunk.host_ns)
            for sample in samples:
                outcomes += self._process_sample(sample)
            if changes_frozen:
                self._frozen = self._intake.frozen
                outcomes += self._detector.reset(chunk.host_ns * 1e-9)
        finally:
            if outcomes or self._found_dead:
                self._commit(chunk, outcomes)
            else:
                self._unwritten.append(chunk)

    @property
    def _decoded_due_ns(self) -> float:
        """Time of the next item after which decoded wrenches are written; infinite if none are."""
        return self._decoded_ns + WRENCH_RECORD_PERIOD_NS if self._wants_decoded and self.scene.has_sensor else np.inf

    def apply_note(self, note: Result) -> None:
        """Apply what a detector made of an item: outcomes and dead channels, or counts of readings."""
        if isinstance(note, Totals):
            self._earlier = note
            self._note_frames()
            self._note_value_order()
            return
        if note.dead is not None:
            self.session.set_detected_dead(note.dead)
        for outcome in note.outcomes:
            self.session.add(outcome)
            self.poses.add_used(outcome.pose, outcome.link_from_sensor)

    def _note_value_order(self) -> None:
        """Give the session the order of the values that all pokes show."""
        earlier, now = self._earlier.skin.value_order, self._detector.value_order
        self.session.set_value_order(now if earlier is None else earlier.plus(now))

    def _use_skin_unit(self, unit: str, host_ns: int) -> None:
        """Use the default of `response_min` for a unit, unless the scene or the operator chose one, or a poke was made."""
        self.finds_skin_unit = False
        response_min = RESPONSE_MIN_OF_UNIT.get(unit, 0.0)
        is_default = self.session.decisions.thresholds.response_min == self.scene.contacts.response_min != response_min
        if response_min and is_default and not self.scene.states_response_min and not self.session.last_poke:
            self.act(UseSkinUnit(unit, response_min), host_ns)

    def _find_frame(self, name: str) -> WrenchFrame:
        is_named = self.scene.wrench_place != WrenchPlace()
        return self.scene.wrench_frame(name) if self.reads_frames or is_named else WrenchFrame(name, FrameKind.SAME)

    def _note_devices(self, host_ns: int) -> None:
        """Note new frames of the wrench, and the unit of the skin."""
        if self._intake.has_new_frames:
            self._intake.has_new_frames = False
            self._note_frames()
        if self.finds_skin_unit and (unit := self._intake.skin_unit):
            self._use_skin_unit(unit, host_ns)

    def _note_frames(self) -> None:
        """Find new frames of the wrench in the scene's robot."""
        earlier = (name for link in self._earlier.links for name in link.frames)
        names = tuple(dict.fromkeys((*earlier, *self._intake.wrench_frames)))
        if names != self._frame_names:
            self._frame_names = names
            self.session.wrench_frames = tuple(map(self._find_frame, names))

    def act(self, action: Action, host_ns: int) -> None:
        """Apply an action and record it; `InputError` if it is impossible, and then nothing changes."""
        self.session.act(action, host_ns * 1e-9)
        if isinstance(action, AskLandmark):
            self._landmarks.ask(action.name, host_ns * 1e-9)
        self.note_skipped_pose(action)
        self._current_pose(None)
        self._detector.use_thresholds(self.session.decisions.thresholds)
        self._commit(TimedAction(host_ns, action), self._detector.ignore_channels(self.session.dead.keys()))
        # A request needs no fsync: without the bytes after it, it is useless.
        if not isinstance(action, AskLandmark | AskPoke):
            self.sync()

    def note_skipped_pose(self, action: Action) -> None:
        """Remember the arm pose of a skipped landmark."""
        if isinstance(action, SkipLandmark) and action.link_from_sensor:
            self.poses.add_used(action.pose, np.reshape(action.link_from_sensor, (4, 4)))

    @property
    def asked_landmark(self) -> str:
        """Name of the requested landmark; empty without one."""
        return self._landmarks.asked

    def tick(self, now_ns: int) -> None:
        """Write the journal's buffers if they are due; call it regularly."""
        self._record(lambda journal: journal.tick(now_ns))

    def snapshot(self, within_s: float = np.inf) -> Snapshot:
        return self.session.snapshot(within_s)

    def live(self, now_ns: int) -> LiveView:
        detector = self._detector
        name, link_from_sensor = self.poses.current
        if link_from_sensor is not None and self.session.tool is not None:
            link_from_sensor = self.session.tool.placed_pose(link_from_sensor)
        used = self.session.decisions.corrections
        progress = corrected_progress(detector.progress(link_from_sensor), link_from_sensor, name, used)
        if self.session.tool is not None:
            progress = self.session.tool.through_tip(progress, link_from_sensor)
        if not self._has_samples(now_ns):
            progress = replace(progress, phase=PressPhase.NO_DATA)
        times, wrench = self._intake.recent_wrench()
        return LiveView(
            wrench_s=times,
            wrench=wrench,
            skin=detector.responses,
            progress=progress,
            links=self._links(now_ns),
            losses_unpaired=self._intake.unpaired,
            pose=name,
            link_from_sensor=link_from_sensor,
        )

    def _links(self, now_ns: int) -> tuple[LinkHealth, ...]:
        """State of the links, with a warning: an angle lies outside the limits of the URDF, or the skin is binary."""
        delay = self._pose_delay_words()
        return tuple(
            replace(link, warning=self._warning(link), pose_delay=delay if Stream.TOOL in link.carries else "")
            for link in self._intake.health(now_ns)
        )

    def _pose_delay_words(self) -> str:
        delays = self._own_pose_delays()
        if delays is None:
            return ""
        from skincal.words.tool_words import pose_delay_sentence  # other rigs do without

        # Before enough presses of this part of the session those of earlier parts show it.
        return pose_delay_sentence(delays) or pose_delay_sentence(self.pose_delays)

    def _warning(self, link: LinkHealth) -> str:
        # The noise of a skin at rest may have two values as well.
        is_binary = link.levels in BINARY_LEVELS or bool(self.session.last_poke)
        binary = binary_skin(link.levels) if is_binary else ""
        if Stream.TOOL in link.carries and (delays := self._own_pose_delays()) is not None:
            from skincal.words.tool_words import pose_stream_faults  # other rigs do without

            return binary or " ".join(pose_stream_faults(delays))
        return binary or (self.poses.limit_warning if Stream.JOINTS in link.carries else "")

    def freeze_findings(self) -> list[str]:
        """Say when the sensor or the skin repeated one reading, since the devices began."""
        freezes = [each for link in self._intake.health(0) for each in link.freezes]
        return freeze_sentences(sorted(freezes, key=lambda each: each.from_ns), self._begin_ns)

    @property
    def before_pokes(self) -> BeforePokes:
        """Statistics of the samples until the first poke, since the devices began."""
        return self._detector.before_pokes

    @property
    def phase(self) -> PressPhase:
        """State of the poke in progress."""
        return self._detector.phase

    @property
    def is_frame_waiting(self) -> bool:
        """Whether a skin frame waits for its wrench."""
        return self._intake.is_frame_waiting

    def awaits_outcome(self, *, final: bool) -> bool:
        """Whether the next sample may bring an outcome, or a `final` one."""
        return self._detector.awaits_outcome(final=final)

    def can_measure(self, now_ns: int) -> bool:
        """Whether a poke would be measured now: samples come from working links, in a known arm pose."""
        # A chosen pose needs no joints.
        unneeded = {Stream.TIP}
        if self.session.decisions.pose or self.scene.arm is None:
            unneeded.add(Stream.JOINTS)
        needed = {link.name for link in self.links if set(link.carries) - unneeded}
        _, link_from_sensor = self.poses.current
        return self._has_samples(now_ns) and not needed & self._intake.down and link_from_sensor is not None

    def _has_samples(self, now_ns: int) -> bool:
        return self._detector.phase is not PressPhase.NO_DATA and not is_silent(self._detector.last_s, now_ns * 1e-9)

    def totals(self) -> Totals:
        """Count the readings and losses of the whole session."""
        health, delays = self._intake.health(0), self._own_pose_delays()
        return self._earlier.plus(health, self._intake.unpaired, self._detector.condition, delays)

    @property
    def skin_condition(self) -> SkinCondition:
        """Condition of the skin over the whole session."""
        return self._earlier.skin.plus(self._detector.condition)

    def require_intact_journal(self) -> None:
        """Raise `InputError` after a journal failure: the pipeline holds data that is on no disk, so no segment may follow."""
        if self.journal_failure:
            raise InputError(
                "What happened since the disk refused is not recorded, so this session cannot be recorded on as it stands: "
                "export its calibration, then open the session again."
            )

    def begin_segment(self, links: Sequence[LinkSpec] | None = None, journal: JournalWriter | None = None) -> None:
        """Continue after a break with a new detector. A poke in progress is lost.

        The rest depends on the session alone, so it does not matter whether it was recorded here, replayed or loaded.

        Parameters
        ----------
        links : new sources of items; `None` for the same
        journal : the new segment, checked by `require_intact_journal`; `None` records nothing
        """
        # Closing the new segment releases the folder's lock.
        if journal is not None and self.journal_failure:
            with contextlib.suppress(JournalFailure):
                journal.close()
            self.require_intact_journal()
        # Before the new intake, which counts from zero.
        self._earlier = self.totals()
        self.session.finalize_outcomes()
        self._connect(self.links if links is None else links)
        self.poses.are_grouped = self.reads_frames = self.finds_skin_unit = True
        self.journal = journal
        self.session.set_clock(None if journal is None else journal.clock)
        self.renew_detector()

    def renew_detector(self) -> None:
        """Replace the detector by a new one that knows the session."""
        session = self.session
        self._detector = _detector_of(self.scene)(
            self.scene, session.last_poke, session.found_dead, session.reported, self._earlier.skin.range_end
        )
        self._dead = self._detector.dead
        self._detector.use_thresholds(session.decisions.thresholds)
        for outcome in self._detector.ignore_channels(session.dead.keys()):
            session.add(outcome)
        # In a loaded session the last chosen pose holds.
        self._current_pose(None)

    def end_session(self, host_ns: int) -> None:
        """End a poke in progress and finalize those that wait; `host_ns` is of the items' clock."""
        self._commit(SessionClosed(host_ns), self._detector.reset(host_ns * 1e-9, is_loss=False))

    def close(self) -> None:
        """Finish the journal; the session stays."""
        # The rest becomes due.
        self._decoded_wrenches(self._decoded_ns + WRENCH_RECORD_PERIOD_NS)
        self.end_session(self._now_ns)
        self._record(lambda journal: journal.close())
        self.journal = None

    def _process_sample(self, sample: Sample) -> list[Outcome]:
        if self._wants_decoded:
            self._unwritten.append(sample)
        if self.scene.wrench_sign < 0:
            sample = replace(sample, wrench=-sample.wrench)
        if sample.has_late_angles and self.session.decisions.pose:
            # A chosen pose holds without the joints.
            sample = replace(sample, angles_max_age_s=np.inf)
        sample, (name, link_from_sensor) = self._place_sample(sample)
        outcomes = self._detector.feed(sample, link_from_sensor, name)
        if self._delay_watch is not None and link_from_sensor is not None and not sample.has_late_tool:
            self._watch_delay(self._delay_watch, sample, link_from_sensor)
        if self._detector.dead is not self._dead:
            self._dead = self._detector.dead
            self.session.set_detected_dead(self._dead)
            self._found_dead = True
            outcomes += self._detector.ignore_channels(self.session.dead.keys())
        return outcomes

    def _watch_delay(self, watch: PoseDelayWatch, sample: Sample, link_from_sensor: FloatArray) -> None:
        """Measure the delay of the tool's poses at a sample, and correct for it once presses show it.

        Each segment of a recording is corrected by its own presses: a replay knows no others at the same time.
        """
        assert sample.tool is not None
        detector, place = self._detector, link_from_sensor[:3, 3] if sample.tip is None else sample.tip
        if not watch.feed(sample.host_s, place, detector.signals, sample.tool.delay_s, presses=detector.is_pressing):
            return
        found = watch.delays.leading
        if found is None or not found.is_usable or found.presses < self._delay_fitted * DELAY_REFIT_RATIO:
            return
        self._delay_fitted = found.presses
        self._intake.use_tool_delay(found.delay_s)

    @property
    def pose_delays(self) -> PoseDelays | None:
        """Delays of the tool's poses that presses of the whole session show; `None` without a tool."""
        return self.totals().pose_delays

    def _own_pose_delays(self) -> PoseDelays | None:
        if self._delay_watch is None:
            return None
        return replace(self._delay_watch.delays, repeated_s=self._intake.tool_change_s)

    def _place_sample(self, sample: Sample) -> tuple[Sample, CurrentPose]:
        """Find the pose of the sensor at a sample; on a tool with a known tip, the tip's position too."""
        tool, reading = self.scene.tool, sample.tool
        if tool is None:
            return sample, self._current_pose(sample.angles)
        if reading is None:
            return sample, (tool.arm_pose, None)
        pose = self.poses.at_tool(reading.base_from_tool)
        tip = None if sample.has_late_tool else tool.tip_in_link(reading.base_from_tool)
        return (sample if tip is None else replace(sample, tip=tip)), pose

    def _commit(self, item: Item, outcomes: Sequence[Outcome]) -> None:
        """Apply the outcomes of an item, write both to the journal, and find new landmark pokes."""
        # The second outcome of a poke is no new poke.
        last = self.session.last_poke
        self._journal_item(item, outcomes)
        # In the order of their numbers, since a decision depends on the pokes before.
        new = sorted({outcome.poke for outcome in outcomes if outcome.poke > last})
        if new and self._landmarks.asked:
            session = self.session
            decisions, fresh = session.decisions, session.frame_corrected(new)
            missed, by_hand = decisions.missed_landmarks.keys(), decisions.named_by_hand
            found_now = self._landmarks.find_landmark_pokes(
                fresh, session.landmark_pokes, decisions.landmarks, missed, by_hand, self.scene.noise
            )
            for found in found_now:
                self.act(found, item.host_ns)

    def _journal_item(self, item: Item, outcomes: Sequence[Outcome]) -> None:
        self._now_ns = max(self._now_ns, item.host_ns)
        notes: list[Result] = []
        if outcomes or self._found_dead:
            dead = self._dead if self._found_dead else None
            taken = DetectorResult(outcomes, dead)
            self.apply_note(taken)
            self._note_value_order()
            self._found_dead = False
            notes.append(taken)
        if self.journal is None:
            return
        if self._totals_due(item):
            notes.append(self.totals())
        self._write_waiting()
        self._record(lambda journal: journal.write(item, notes))
        if any(isinstance(outcome, Contact) for outcome in outcomes):
            self.sync()

    def _taxel_places(self) -> Mapping[int, FloatArray]:
        """Planned places of the taxels, (3,) float, metres, by channel."""
        layout = self.scene.skin.layout
        if self.laid is None and layout is not None:
            from skincal.mesh.lay import place_layout  # it costs a second on a large mesh, and few sessions need it

            self.laid = place_layout(layout, self.scene.skin.anchor, self.session.surface)
        if self.laid is None or layout is None:
            return {}
        places = self.laid.places
        return {channel: places[channel] for channel in layout.channels.tolist() if np.isfinite(places[channel]).all()}

    def _totals_due(self, item: Item) -> bool:
        if self._totals_ns is None:
            self._totals_ns = item.host_ns
        if not isinstance(item, SessionClosed) and item.host_ns - self._totals_ns < READING_COUNTS_RECORD_PERIOD_NS:
            return False
        self._totals_ns = item.host_ns
        return True

    def _interrupts_samples(self, item: Chunk | LinkEvent) -> bool:
        """Whether an item interrupts the samples: a sensor froze or works again, or a needed link ended."""
        before, self._frozen = self._frozen, self._intake.frozen
        return self._frozen != before or (isinstance(item, LinkEvent) and self._ends_samples(item))

    def _ends_samples(self, event: LinkEvent) -> bool:
        """Whether a needed link was lost, or the last one of a recording ended."""
        needed = {link.name for link in self.links if {Stream.WRENCH, Stream.SKIN} & set(link.carries)}
        if event.link not in needed:
            return False
        if event.state is LinkState.OPEN:
            self._ended_links.discard(event.link)
        if event.state is LinkState.ENDED:
            self._ended_links.add(event.link)
        return event.state in _LOST_STATES or (event.state is LinkState.ENDED and self._ended_links >= needed)

    def _current_pose(self, angles: FloatArray | None) -> tuple[str, FloatArray | None]:
        return self.poses.at(self.session.decisions.pose, angles)

    def _decoded_wrenches(self, host_ns: int) -> None:
        """Write the wrenches of the last half second and the temperature to the journal, for other programs."""
        if host_ns < self._decoded_due_ns:
            return
        self._decoded_ns = host_ns
        times, wrenches = self._intake.recent_wrench(self._decoded_s)
        if len(times):
            self._decoded_s = float(times[-1])
            self._record(lambda journal: journal.write_wrenches(times, wrenches))
        for link, beside in self._intake.side_readings().items():
            if (found := beside.get(TEMPERATURE_NAME)) is not None:
                self._record(partial(JournalWriter.write_temperature, host_ns=host_ns, link=link, celsius=found.now))

    @property
    def _wants_decoded(self) -> bool:
        return self.journal is not None and self.journal.wants_decoded

    def _write_waiting(self) -> None:
        """Write the entries of the journal that wait."""
        if self._unwritten:
            self._record(lambda journal: journal.write_run(self._unwritten))
            self._unwritten.clear()

    def sync(self) -> None:
        """Flush the journal to the disk; on failure recording ends and `journal_failure` says why."""
        self._record(JournalWriter.sync)

    def _record(self, work: Callable[[JournalWriter], None]) -> None:
        """Run `work` on the journal, if there is one; a full disk ends the recording and nothing else."""
        if self.journal is None:
            return
        try:
            work(self.journal)
        except JournalFailure as failure:
            self.journal_failure = str(failure)
            self.journal = None
