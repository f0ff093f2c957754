"""The controller of the window: owns what is open and the one timer, and does what the operator wants.

Each tick takes what arrived, lets the pipeline work on it for a bounded time, and hands it on once, and only if something
changed. Thirty ticks a second, fewer while there is work, none for nothing. Everything slow is done in the background and
comes back in a tick.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from PySide6.QtCore import QObject, QTimer, Signal

from app.session.opening import (
    Addresses,
    OpenRequest,
    begin_session,
    find_scene,
    find_truth_of,
    link_specs,
    load_mesh_part,
    look_at,
    resume_pipeline,
    rig_again,
)
from app.session.recording import Recording, SessionFolder, stop_all
from app.state.running import Running
from app.text.message import NO_SESSION, STILL_SOLVING, Message, copy_words, kept_words, refused_words
from app.workers.device_process import DeviceProcess
from app.workers.threads import ThreadService
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from app.workers.processes import JobService, ProcessService, ReviewClient
    from skincal.files.reference import TaxelPositions
    from skincal.guide.verdict import Verdict
    from skincal.model.actions import Action
    from skincal.rig.correction_fit import RigAnswer
    from skincal.robot.target_server import TargetServer
    from skincal.session.guided_session import GuidedSession
    from skincal.session.part import Part
    from skincal.session.pipeline import Pipeline
    from skincal.session.session import Session
    from skincal.session.snapshot import LiveView, Snapshot
    from skincal.session.undo import HistoryEntry
    from skincal.streams.links import LinkSpec
    from skincal.taxels.contact_table import Evidence
    from skincal.taxels.result import Method

T = TypeVar("T")
LOG = logging.getLogger(__name__)
TICK_MS = 33
"""One picture a tick: 30 a second."""
BEHIND_MS = 4
"""The next tick comes this soon while readings still wait, or taxels to be solved."""
DRAW_S = 0.010
"""s. Pictures come no faster than this. Well below a tick: after a long one the timer comes early, to keep its pace, and that
picture must not be left out."""
DRAW_BEHIND_S = 0.1
"""s. While there is work, pictures come no faster than this: readings go before pictures."""
IDLE_S = 0.5
"""s. While nothing arrives the links are looked at this often, to say that one fell silent."""
SOLVING_S = 0.4
"""s. Solving that lasts longer is said."""
DRAIN_S = 0.012
"""s. Readings are worked on for at most this long a tick; the rest waits, so that the window answers."""
FAR_BEHIND_NS = 1_000_000_000
"""ns. Readings that wait for so long are about to be dropped: they go before pictures."""
FAR_DRAIN_S = 0.060
"""s. So long then: the window still answers within a tenth of a second."""
SOLVE_S = 0.012
"""s. Taxels are solved for about as long a tick: a poke's few at once, all of them, as under a correction of the rig, in
several ticks, in which the window answers."""
AT_ONCE = 200
"""While more taxels than this are unsolved, an action is refused: the window shows a state from before the last change."""


PACES = (1, 2, 4)
"""How many times as quick as a careful hand a simulated operator may be between pokes."""
BRISK = 2
"""Of the demo: a poke takes 1.5 s, and the modules method comes to its end in two minutes."""


ANY_PORT = 0
"""For the simulated operator: whichever is free."""


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another folder.") from error


def _had(pipeline: Pipeline) -> tuple[tuple[HistoryEntry, ...], int]:
    """Return what was done in a session, and how many pokes it has, rejected ones as well."""
    return pipeline.session.history.entries, len(pipeline.snapshot().pokes)


def _drop(pipeline: Pipeline, storage: SessionFolder) -> None:
    """Close a session that was opened too late."""
    pipeline.close()
    storage.discard()
    storage.finish()


def _with_sentence(work: Callable[[], T]) -> Callable[[], T]:
    """Make every failure of `work` an `InputError`, so that its dialog can show it."""

    def run() -> T:
        try:
            return work()
        except InputError:
            raise
        except Exception as error:
            LOG.exception("work beside the window failed")
            raise InputError(f"It is not done: {error!r}; details are in the log.") from error

    return run


class TickSchedule:
    """Knows when the last picture was shown, and since when taxels wait to be solved; host's monotonic clock."""

    def __init__(self) -> None:
        self._shown_ns = 0
        self._solving_ns = 0
        """0 where none do."""

    def is_due(self, now_ns: int, *, behind: bool, news: bool) -> bool:
        """Return whether a picture is due that shows what is shown already.

        Parameters
        ----------
        behind : readings wait, or taxels
        news : something arrived
        """
        pause_s = DRAW_BEHIND_S if behind else DRAW_S if news else IDLE_S
        return (now_ns - self._shown_ns) * 1e-9 >= pause_s

    def show(self, now_ns: int) -> None:
        """Note that a picture is shown now."""
        self._shown_ns = now_ns

    def worth_saying(self, unsolved: int, now_ns: int) -> int:
        """Return how many taxels wait to be solved, once some have waited for long."""
        self._solving_ns = (self._solving_ns or now_ns) if unsolved else 0
        return unsolved if (now_ns - self._solving_ns) * 1e-9 >= SOLVING_S else 0


@dataclass(frozen=True, slots=True, eq=False)
class Tick:
    """What a tick found."""

    snapshot: Snapshot
    live: LiveView
    now_ns: int
    """Host's monotonic clock; while readings wait, the arrival of the newest that was worked on."""
    behind_s: float
    """How long ago that was, while readings wait; else 0."""
    evidence: Callable[[Collection[int]], Evidence]
    """What the contacts of the newest snapshot say of some channels; holds until the next tick."""
    unsolved: int = 0
    """How many taxels are still to be solved before there is a newer snapshot; 0 too where that takes no time to speak of."""


class Controller(QObject):
    """What happens between devices and window.

    Parameters
    ----------
    documents : folder under which sessions are kept
    """

    part_loaded = Signal(object)
    """`Part`: the scene is known, views can be built."""
    session_opened = Signal(object)
    """`Snapshot` of the session as it was opened."""
    ticked = Signal(object)
    """`Tick`."""
    running_changed = Signal(object)
    """`Running`."""
    said = Signal(object)
    """`Message`."""
    reviewed = Signal(object)
    """`Review`: what landmark pokes say of the rig; None where there is none any more."""
    truth_found = Signal(object)
    """`TaxelPositions`: where the taxels of a simulated rig are."""
    recorded_elsewhere = Signal(object, str)
    """`Path` of a session that was to be opened, and a sentence: another process records it."""
    confirmation_due = Signal(object)
    """Addresses that a recorded session names: `go_on(confirmed=True)` connects them."""
    stored = Signal(str)
    """Where the recording is, in words."""

    pace = 1
    """Of a simulated operator, one of `PACES`."""
    demo = False
    simulated = False
    """The rig is, or was, a simulated one."""
    _targets: TargetServer | None = None
    """Where a robot, or the simulated operator, is asked."""
    guided: GuidedSession | None = None
    """Guide, coach and checks of what is open; `None` before its part is loaded."""
    _pose = ""
    """Of the arm, in which a new session begins."""
    _again: tuple[str, ...] = ()
    """Serves the simulated rig of a recorded session again."""
    _opened_with: tuple[tuple[HistoryEntry, ...], int] = (), 0
    """What had been done in the session when it was opened, and how many pokes it had."""

    def __init__(self, documents: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._documents = documents
        self._threads = ThreadService("background", self)
        self._endings = ThreadService("ending", self)
        """Ends recordings. Closing the window waits for it."""
        self._applying = ThreadService("applying", self)
        """Brings positions to a robot, which may be slow, and is never left half way."""
        self._processes: ProcessService | None = None
        """Made with the first review."""
        self._jobs: JobService | None = None
        """Made with the first job."""
        self._news = False
        """The background brought something that is not shown yet."""
        self._server: DeviceProcess | None = None
        self._links: tuple[LinkSpec, ...] = ()
        self._truth = b""
        self._storage: SessionFolder | None = None
        self._part: Part | None = None
        self._recording: Recording | None = None
        self._reviewing: ReviewClient | None = None
        self._shown: Snapshot | None = None
        self._schedule = TickSchedule()
        self.running = Running.OPENING
        self.prepare: Callable[[], object] = lambda: None
        """Imports what shows a session; called beside the window, before a part is loaded."""
        self._confirmed = True
        """The links were named by the operator, or agreed to."""
        self._timer = QTimer(self)
        self._timer.setInterval(TICK_MS)
        self._timer.timeout.connect(self.tick)

    # Opening and closing

    def open(self, request: OpenRequest) -> None:
        """Open something in place of what is open; returns at once, `part_loaded` and `session_opened` follow."""
        self._release()
        self._set_running(Running.OPENING)
        self._storage = storage = SessionFolder(request, self._documents)
        self.demo, self.pace = request.demo, BRISK if request.demo else 1
        self._pose = request.pose
        self._timer.start()
        if request.session is not None:
            self._serve_targets(request.targets)
            links = None if request.look_on else link_specs(request.addresses)
            self._links = links or ()
            self._confirmed = bool(links)
            self.compute(
                lambda: self._load_session(storage, links),
                lambda found: self._take_session(storage, found),
                # Its journal is open and its folder locked.
                dropped=lambda found: None if isinstance(found, str) else _drop(found[1], storage),
            )
            return
        self._confirmed = True
        if request.addresses:
            self._links = link_specs(request.addresses)
            self._serve_targets(request.targets)
        elif request.server:
            self._start_server(request.server)
        self.compute(lambda: self._load_scene(request), self._take_part)

    def _release(self) -> None:
        """Let go of what is open; its end takes too long for the window and happens in the background."""
        self._threads.renew()
        if self._jobs is not None:
            self._jobs.renew()
        server, self._server = self._server, None
        if server is not None:
            server.release()
        reviewing, self._reviewing = self._reviewing, None
        if reviewing is not None:
            reviewing.stop()
            reviewing.deleteLater()
        self._part = self._shown = self.guided = None
        self._links, self._truth, self._schedule = (), b"", TickSchedule()
        self._close_targets()
        self._again, self.simulated = (), False
        self._end_recording()

    def _end_recording(self) -> None:
        """End the recording in the background. A provisional one without changes is discarded."""
        if self._recording is not None and not self.would_lose:
            self._recording.storage.discard()
        recording, self._recording, self._storage = self._recording, None, None
        if recording is not None:
            self._endings.submit(recording.end, lambda _: None, self._say_failure)

    def stop(self) -> None:
        """Stop the timer, then the readers: nothing comes to the window any more."""
        self._timer.stop()
        self._threads.renew()
        if self._recording is not None:
            stop_all(self._recording.let_go())

    def close(self) -> None:
        """Stop, end the process behind the links, and close the journal, in that order."""
        self.stop()
        self._end_recording()
        self._close_targets()
        if self._server is not None:
            self._server.stop()
            self._server = None
        if self._reviewing is not None:
            self._reviewing.stop()
            self._reviewing = None
        if self._processes is not None:
            self._processes.close()
        if self._jobs is not None:
            self._jobs.close()
        self._threads.close()
        # Without a limit: a slow disk must not cost what the operator recorded or keeps.
        self._endings.wait()
        self._endings.deliver()
        self._endings.close()
        # A robot that falls silent ends it within an answer's time.
        self._applying.wait()
        self._applying.close()

    def _start_server(self, command: tuple[str, ...]) -> None:
        if self._server is not None:
            self._server.release()
        self._server = DeviceProcess(self)
        self._server.said_truth.connect(self._take_truth)
        self._server.served.connect(self._take_links)
        self._server.failed.connect(self._fail)
        if self._targets is None:
            self._serve_targets(f"{ANY_PORT}")
        targets = self._targets
        # Its operator is asked as any robot is, and by nothing else.
        self._server.start(command if targets is None else (*command, "--targets", f"{targets.host}:{targets.port}"))

    def _serve_targets(self, port: str) -> None:
        """Ask robots at a port, where one is named; say why not where it cannot be had."""
        if not port:
            return
        from skincal.robot.target_server import TargetServer, parse_port

        try:
            self._targets = TargetServer(*parse_port(port))
        except InputError as error:
            self._say_failure(str(error))

    def _close_targets(self) -> None:
        targets, self._targets = self._targets, None
        if targets is not None:
            targets.close()

    def _take_truth(self, truth: bytes) -> None:
        self._truth = truth

    def _take_links(self, links: tuple[LinkSpec, ...]) -> None:
        self._links = links
        self.simulated = True
        if self.pace != 1:
            self.set_pace(self.pace)
        if self._recording is None:
            self._start_recording()
            return
        # The rig of a recorded session, served again.
        self._recording.links, self._confirmed = links, True
        self._connect(self._recording)

    def set_pace(self, pace: int) -> None:
        """Have a simulated operator be so many times as quick between pokes; real devices are sent nothing."""
        self.pace = pace
        if self._server is not None:
            self._server.tell(f"pace {pace}")
        if self._recording is not None:
            self.running_changed.emit(self.running)

    @property
    def served(self) -> bool:
        """Whether a simulated rig is there, or can be served again."""
        return self._server is not None or bool(self._again)

    def _hear_robot(self, recording: Recording) -> None:
        """Handle the answers of robots. A skip has to wait while an action would."""
        if self._targets is None or self.guided is None or recording.pipeline.session.unsolved > AT_ONCE:
            return
        sentences = self.guided.handle_answers(recording.pipeline, self._targets, time.monotonic_ns())
        for sentence in () if self.simulated else sentences:
            self.said.emit(Message(sentence, found=True))

    def _take_part(self, part: Part, *, record: bool = True) -> None:
        from skincal.session.guided_session import GuidedSession

        self._part, self.guided = part, GuidedSession(part, self.compute)
        self.part_loaded.emit(part)
        for finding in part.findings:
            self.said.emit(Message(finding, found=True))
        if record and not self._links and self._server is None:
            self._set_running(Running.OFFLINE)
        elif record:
            self._start_recording()

    def _start_recording(self) -> None:
        part, links, storage, truth = self._part, self._links, self._storage, self._truth
        if part is not None and links and storage is not None:
            self.compute(
                lambda: begin_session(part, links, storage.prepare(), truth),
                lambda pipeline: self._take_new(Recording(pipeline, storage)),
                dropped=lambda pipeline: _drop(pipeline, storage),
            )

    def _take_new(self, recording: Recording) -> None:
        """Start with a new recording, in the arm pose that was named for it."""
        if self._pose:
            from skincal.model.actions import SetPose

            recording.pipeline.act(SetPose(self._pose), time.monotonic_ns())
        self._take_recording(recording)

    def _take_session(self, storage: SessionFolder, found: tuple[Part, Pipeline, tuple[str, ...]] | str) -> None:
        if isinstance(found, str):
            self._set_running(Running.OFFLINE)
            self.recorded_elsewhere.emit(storage.folder, found)
            return
        part, pipeline, again = found
        self.simulated = bool(again)
        # Where nothing can be recorded, no rig is served.
        self._again = again if pipeline.journal is not None else ()
        self._take_part(part, record=False)
        self._take_recording(Recording(pipeline, storage), connect=bool(self._links))
        if storage.shipped is not None:
            self.said.emit(Message(copy_words(storage.shipped), found=True))

    def _take_recording(self, recording: Recording, *, connect: bool = True) -> None:
        self._recording = recording
        self._links, self._opened_with = recording.links, _had(recording.pipeline)
        if connect:
            recording.start()
        self._set_running(Running.STREAMING if connect else Running.OFFLINE)
        self.session_opened.emit(recording.pipeline.snapshot())
        self._publish_storage()
        self._publish(recording, recording.pipeline.snapshot(), time.monotonic_ns())
        part = self._part
        if part is not None:
            self.compute(lambda: find_truth_of(recording.storage.folder, part), self._publish_truth)

    def _publish_truth(self, truth: TaxelPositions | None) -> None:
        if truth is not None:
            self.truth_found.emit(truth)

    @property
    def links(self) -> tuple[LinkSpec, ...]:
        """The links of what is open."""
        return self._links

    # The tick

    def tick(self) -> None:
        """Take what arrived, and publish it if something changed."""
        recording = self._recording
        if recording is None:
            return
        self._hear_robot(recording)
        drained = self._take_in(recording)
        snapshot = recording.pipeline.snapshot(SOLVE_S)
        behind = recording.behind or recording.pipeline.session.unsolved > 0
        wanted = BEHIND_MS if behind else TICK_MS
        # Qt starts a running timer anew with every interval that is set, also with the one that it has.
        if self._timer.interval() != wanted:
            self._timer.setInterval(wanted)
        now_ns = time.monotonic_ns()
        if self._schedule.is_due(now_ns, behind=behind, news=drained or self._news) or snapshot is not self._shown:
            self._publish(recording, snapshot, now_ns)

    def _take_in(self, recording: Recording) -> bool:
        far = recording.behind and 0 < recording.reached_ns < time.monotonic_ns() - FAR_BEHIND_NS
        drained = recording.drain(FAR_DRAIN_S if far else DRAIN_S)
        recording.pipeline.tick(time.monotonic_ns())
        if recording.pipeline.journal_failure and self.running is Running.STREAMING:
            self._say_failure(refused_words(recording.pipeline.journal_failure))
            self.pause()
        return drained

    def _publish(self, recording: Recording, snapshot: Snapshot, now_ns: int) -> None:
        self._schedule.show(now_ns)
        self._shown, self._news = snapshot, False
        if snapshot.decisions.landmarks:
            self._review(recording.pipeline.session, snapshot)
        reached_ns = recording.seen_ns(now_ns)
        pipeline, guided = recording.pipeline, self.guided
        live = pipeline.live(reached_ns)
        if guided is not None:
            streaming = self.running is Running.STREAMING
            guided.follow(pipeline, snapshot, now_ns, self._targets, is_recording=streaming, seen_ns=reached_ns)
            target = None if guided.guidance is None else guided.guidance.target
            guided.coach.follow(live.progress, target)
        unsolved = self._schedule.worth_saying(pipeline.session.unsolved, now_ns)
        self.ticked.emit(Tick(snapshot, live, reached_ns, (now_ns - reached_ns) * 1e-9, pipeline.session.evidence, unsolved))

    def publish_again(self) -> None:
        """Publish the newest snapshot again: what the operator wants of the guide or the panels changed."""
        if self._recording is not None and self._shown is not None:
            self._publish(self._recording, self._shown, time.monotonic_ns())

    def _review(self, session: Session, snapshot: Snapshot) -> None:
        """Let another process work out what landmark pokes say of the rig."""
        if self._reviewing is None:
            from app.workers.processes import ProcessService, ReviewClient

            self._processes = self._processes or ProcessService()
            self._reviewing = ReviewClient(session, self._processes, self)
            self._reviewing.reviewed.connect(self.reviewed)
            self._reviewing.failed.connect(self._review_failed)
        self._reviewing.follow(snapshot)

    def _review_failed(self, sentence: str) -> None:
        self._say_failure(sentence)
        self.reviewed.emit(None)

    # What the operator wants

    def toggle(self) -> None:
        """Do the obvious thing: pause what streams, go on with what is paused, connect what is not."""
        if self.running is Running.STREAMING:
            self.pause()
        elif self.running in (Running.PAUSED, Running.OFFLINE):
            self.go_on()

    def pause(self) -> None:
        """Let go of the devices; nothing is recorded until it goes on."""
        if self._recording is not None and self.running is Running.STREAMING:
            readers = self._recording.let_go()
            self._set_running(Running.PAUSED)
            self.compute(lambda: stop_all(readers))

    def go_on(self, *, confirmed: bool = False) -> None:
        """Take the devices, in a new segment of the recording; those of a recorded session once they are `confirmed`."""
        if self._recording is None or self.running is Running.STREAMING:
            return
        self._confirmed |= confirmed
        # What is only looked at has nothing to connect, and says so.
        if self._confirmed or self._recording.pipeline.journal is None:
            self._connect(self._recording)
        elif not self._again:
            self.confirmation_due.emit(tuple(link.address for link in self._links))
        elif self._server is None or not self._server.running:
            # Its own links follow; until then those that the file names are a stranger's.
            self._start_server(self._again)

    def change_addresses(self, addresses: Addresses) -> None:
        """Read the devices at these addresses from now on, in a new segment of the recording, which says so."""
        recording = self._recording
        if recording is None:
            return
        self.pause()
        recording.links = self._links = link_specs(addresses)
        self._confirmed = True
        # After the readers of the pause have ended: a serial port has one reader.
        self.compute(lambda: None, lambda _: self._connect(recording))

    def _connect(self, recording: Recording) -> None:
        # The operator may have gone on by a key while this was waited for.
        if self.running is Running.STREAMING:
            return
        try:
            recording.go_on()
        except InputError as failure:
            self._say_failure(str(failure))
            return
        self._set_running(Running.STREAMING)

    def act(self, action: Action) -> bool:
        """Do an action on the session; return whether it could be done."""
        if self._recording is None or self._is_solving():
            return False
        try:
            self._recording.pipeline.act(action, time.monotonic_ns())
        except InputError as error:
            self._say_failure(str(error))
            return False
        pipeline = self._recording.pipeline
        # Where all taxels are to be solved, that begins in the next tick.
        shown = self._shown if pipeline.session.unsolved > AT_ONCE else None
        self._publish(self._recording, shown or pipeline.snapshot(SOLVE_S), time.monotonic_ns())
        return True

    def _is_solving(self) -> bool:
        """Return whether so many taxels are unsolved that an action has to wait, and say so."""
        if self._recording is None or self._recording.pipeline.session.unsolved <= AT_ONCE:
            return False
        self._say_failure(STILL_SOLVING)
        return True

    def act_all(self, actions: Iterable[Action]) -> None:
        """Do several actions, and stop at the first that cannot be done."""
        for action in actions:
            if not self.act(action):
                return

    def keep(self) -> None:
        """Keep a provisional session."""
        if self._recording is not None and self.can_keep:
            self._recording.storage.keep()
            self.said.emit(Message(kept_words(self._recording.storage.folder)))
            self._publish_storage()

    def discard(self) -> None:
        """Have a provisional session removed from the disk once it is closed."""
        if self._recording is not None:
            self._recording.storage.discard()

    @property
    def can_keep(self) -> bool:
        """Whether the operator has not decided yet to keep the session."""
        return self._recording is not None and self._recording.storage.is_provisional

    @property
    def folder(self) -> Path | None:
        """Folder of the session; `None` while it is provisional, or nothing is open."""
        return None if self._recording is None or self.can_keep else self._recording.storage.folder

    @property
    def would_lose(self) -> int:
        """Number of pokes that would be discarded with a provisional session; 0 if nothing changed since it was opened."""
        if self._recording is None or not self.can_keep or _had(self._recording.pipeline) == self._opened_with:
            return 0
        return len(self._recording.pipeline.snapshot().pokes)

    def export(
        self,
        format_: str,
        path: Path,
        method: Method,
        rig: RigAnswer | None,
        done: Callable[[tuple[Verdict, tuple[str, ...]]], None],
        failed: Callable[[str], None],
        ended: Callable[[], None] | None = None,
    ) -> None:
        """Write a calibration file in the background.

        Parameters
        ----------
        rig : what landmark pokes say; `None` if they were not reviewed
        done : gets the verdict by `method` and the sentences of the file's lint
        failed : gets a sentence if there is no file, whatever the reason is
        ended : called last in every case, also if another session was opened meanwhile
        """
        if self._recording is None or self._part is None:
            failed(NO_SESSION)
            return
        if self._recording.pipeline.session.unsolved > AT_ONCE:
            failed(STILL_SOLVING)
            return
        # Made here, not in the thread: the session goes on while the file is written.
        session, part = self._recording.pipeline.session, self._part
        calibration, snapshot = session.calibration(), session.snapshot()

        def write() -> tuple[Verdict, tuple[str, ...]]:
            from skincal.files.export import write_calibration
            from skincal.files.formats import ExportFormat
            from skincal.session.results import checked, verdicts_of

            methods = session.methods if ExportFormat(format_).holds_all_methods else (method,)
            verdicts = verdicts_of(part, snapshot, methods, rig)
            _make_folder(path.parent)
            return verdicts[method], write_calibration(checked(calibration, rig, verdicts), format_, path, method)

        self.compute(_with_sentence(write), done, failed, ended=ended)

    def apply(self, address: str, method: Method, done: Callable[..., None], ended: Callable[[], None] | None = None) -> None:
        """Bring positions to a running robot in the background.

        Parameters
        ----------
        done : gets a sentence, every question with its answer, and `good`: whether all went well
        ended : called last in every case
        """
        if self._recording is None:
            done(NO_SESSION, (), good=False)
            return
        if self._recording.pipeline.session.unsolved > AT_ONCE:
            done(STILL_SOLVING, (), good=False)
            return
        calibration = self._recording.pipeline.session.calibration()
        # The robot's own positions are written beside the recording, and must not go with it.
        self.keep()
        folder = self._recording.storage.folder
        lines: list[str] = []

        def send() -> str:
            from skincal.robot.skin_manager import ANSWER_MAX_S, apply_positions, calibrated_positions, result_text

            positions = calibrated_positions(calibration, method, None)
            _make_folder(folder)
            before = folder / f"before-{positions.part}.txt"
            words = result_text(apply_positions(address, positions, before, ANSWER_MAX_S, lines.append), positions.part)
            return f"{words[:1].upper()}{words[1:]}."

        self._applying.submit(
            _with_sentence(send),
            lambda words: done(words, lines, good=True),
            lambda words: done(words, lines, good=False),
            ended=ended,
        )

    def report(self, path: Path, method: Method, done: Callable[[str], None], failed: Callable[[str], None]) -> None:
        """Write the report of what is recorded, in a process of its own.

        Parameters
        ----------
        done : gets the verdict
        failed : gets why there is no report
        """
        if self._recording is None:
            return
        from app.workers.processes import report_job

        # What is still buffered is in no file that could be read.
        self._recording.pipeline.sync()
        self._start_job(report_job, (self._recording.storage.folder, path, method), done, failed)

    def find_places(self, path: Path, done: Callable[[tuple[TaxelPositions, ...]], None]) -> None:
        """Read the places in a file or another session, in a process of its own, and hand them to `done`."""
        from app.workers.processes import places_job

        if self._part is not None:
            scene, channels = self._part.scene, self._part.channels.tolist()
            self._start_job(places_job, (path, scene.link, channels), done, self._say_failure)

    def _start_job(
        self, job: Callable[..., Any], arguments: tuple[Any, ...], done: Callable[[Any], None], failed: Callable[[str], None]
    ) -> None:
        from app.workers.processes import JobService

        self._jobs = self._jobs or JobService(self)
        self._jobs.submit(job, arguments, done, failed)

    def compute(
        self,
        work: Callable[[], Any],
        done: Callable[[Any], None] | None = None,
        failed: Callable[[str], None] | None = None,
        dropped: Callable[[Any], None] | None = None,
        ended: Callable[[], None] | None = None,
    ) -> None:
        """Do `work` in the background; see `ThreadService.submit`.

        Parameters
        ----------
        failed : by default the window says what failed
        dropped : gets the result where something else was opened meanwhile
        """

        def take(result: Any) -> None:
            self._news = True
            if done is not None:
                done(result)

        self._threads.submit(work, take, failed or self._fail, dropped, ended)

    # Helpers

    def _load_scene(self, request: OpenRequest) -> Part:
        """Load a scene, and import what shows it, beside the window."""
        self.prepare()
        from skincal.session.part import load_part

        return load_part(find_scene(request.scene)) if request.mesh is None else load_mesh_part(request.mesh, self._documents)

    def _load_session(
        self, storage: SessionFolder, links: tuple[LinkSpec, ...] | None
    ) -> tuple[Part, Pipeline, tuple[str, ...]] | str:
        """Return what a folder holds, to be looked at where there are no `links`; a sentence where another records it."""
        self.prepare()
        # It may be the session that was open until now.
        self._endings.wait()
        folder = storage.prepare()
        from skincal.journal.lock import RecordedElsewhereError

        try:
            part, pipeline = look_at(folder) if links is None else resume_pipeline(folder, links)
        except RecordedElsewhereError as error:
            return str(error)
        except InputError:
            storage.discard()
            storage.finish()
            raise
        again = () if links else rig_again(folder, pipeline.session.last_poke + 1)
        return part, pipeline, again

    def _say_failure(self, sentence: str) -> None:
        self.said.emit(Message(sentence, error=True))

    def _fail(self, sentence: str) -> None:
        self._say_failure(sentence)
        if self._recording is None:
            self._set_running(Running.OFFLINE)

    def _set_running(self, running: Running) -> None:
        if running is not self.running:
            self.running = running
            self.running_changed.emit(running)

    def _publish_storage(self) -> None:
        if self._recording is not None:
            self.stored.emit(self._recording.storage.sentence())
