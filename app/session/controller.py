"""The controller of the window. No widgets."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject, QTimer, Signal

from app.session.opening import Addresses, OpenRequest, begin_session, find_scene, link_specs, open_recorded, same_rig_command
from app.session.recording import Recording, SessionFolder, stop_all
from app.state.memo import Memo
from app.state.running import Running
from app.text.demo_text import OTHER_RIG, UNKNOWN_RIG, simulated_words
from app.text.message import NO_SESSION, STILL_SOLVING, Message, copy_words, empty_words, kept_words
from app.workers.device_process import DeviceProcess
from app.workers.threads import ThreadService, raise_sentences
from skincal.files.formats import NO_OPTIONS, ExportOptions
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from app.workers.processes import JobQueue, ReviewClient, WorkerProcess
    from skincal.files.reference import TaxelPositions
    from skincal.following.guided_session import GuidedSession
    from skincal.guide.verdict import Verdict
    from skincal.model.actions import Action
    from skincal.model.scene import Scene
    from skincal.part.part import Part
    from skincal.rig.correction_fit import RigAnswer
    from skincal.robot.targets import OpenTargets
    from skincal.session.pipeline import Pipeline
    from skincal.session.session import Session
    from skincal.session.snapshot import Snapshot
    from skincal.session.undo import HistoryEntry
    from skincal.streams.links import LinkSpec
    from skincal.taxels.result import Method

TICK_PERIOD_MS = 33  # 30 pictures per second
BUSY_TICK_PERIOD_MS = 4  # Until the next tick while readings or taxels wait
MIN_PICTURE_INTERVAL_S = 0.010
"""Between two pictures, at least. Well below a tick, since the timer may fire early after a long tick."""
MIN_BUSY_PICTURE_INTERVAL_S = 0.1  # The same while readings or taxels wait: readings go before pictures
IDLE_PICTURE_INTERVAL_S = 0.5  # Between two pictures without data, to show that a link fell silent
SHOW_SOLVING_AFTER_S = 0.4  # Solving that lasts longer is shown
READINGS_TIME_PER_TICK_S = 0.012  # Time for readings per tick; the rest waits, so that the window stays responsive
PREFER_READINGS_IF_BEHIND_BY_NS = 1_000_000_000  # Readings that wait longer are soon dropped: they go before pictures
BACKLOG_READINGS_TIME_PER_TICK_S = 0.060  # Time for readings per tick then: the window still answers within 0.1 s
SOLVING_TIME_PER_TICK_S = 0.012  # Time for solving per tick. All taxels, as after a correction, take several ticks.
MAX_UNSOLVED_TAXELS = 200
"""With more unsolved taxels an action is refused: the window shows a state from before the last change."""
OPERATOR_PACES = (1, 2, 4)  # Speed of the simulated operator between pokes, relative to a careful person
DEMO_SPEED_FACTOR = 2  # A poke takes 1.5 s, and the modules method finishes in two minutes
DEMO_FIRST_MODULE_POKES = 2
"""The demonstration shows the taxels of a module within seconds; in any other session the landmarks come first."""
EMPTY_SESSION_MAX_S = 300.0
"""s. A new session without a poke that ends earlier is not kept; readings of a longer time may be wanted."""
ANY_PORT = ("127.0.0.1", 0)  # The system chooses a free port, for programs of this machine


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be created ({error.strerror}). Choose another folder.") from error


def _session_size(pipeline: Pipeline) -> tuple[Sequence[HistoryEntry], int]:
    """History and number of pokes, rejected ones included."""
    return pipeline.session.history.entries, len(pipeline.snapshot().pokes)


def _import_targets() -> None:
    """Import what asks a robot: in the window's thread the window would not answer for 0.1 s."""
    import skincal.robot.targets  # noqa: F401


def _load_part(scene: Path | None) -> Part:
    """Load the part of a scene, by default of the default scene."""
    from skincal.part.part import load_part

    return load_part(find_scene(scene))


def _drop(pipeline: Pipeline, storage: SessionFolder) -> None:
    """Close a session whose opening ended after the operator chose another one."""
    pipeline.close()
    storage.discard()
    storage.finish()


class Controller(QObject):
    """Owns the open session and the one timer, and carries out the operator's commands.

    A tick feeds the pipeline for a bounded time and publishes its state if something changed. Slow work runs in the background.

    Parameters
    ----------
    documents : folder of the sessions
    """

    part_loaded = Signal(object)  # `Part`: its picture can be drawn; `guide_part` goes on
    guided_made = Signal(object)  # `GuidedSession`: its panels can be made
    session_opened = Signal(object)  # `Snapshot` of the opened session
    ticked = Signal(object)  # `ViewState` of the session, without what the view of it adds
    running_changed = Signal(object)  # `Running`
    said = Signal(object)  # `Message`
    unsaid = Signal(object)  # `Message` that is no longer true
    reviewed = Signal(object)  # `Review` of sensor and arm; `None` if there is none any more
    truth_found = Signal(object)  # `TaxelPositions`: positions of the taxels of a simulated rig
    recorded_elsewhere = Signal(object, str)  # `Path` of a session that another process records, and a sentence
    confirmation_due = Signal(object)
    """Addresses that a recorded session names: `resume(confirmed=True)` connects them."""
    simulation_due = Signal()  # A session of a simulated hand is to go on: `simulate_again`
    released = Signal()  # The session that was open is closed
    stored = Signal(str)  # Sentence on the folder of the recording

    def __init__(self, documents: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._documents = documents
        self._threads = ThreadService("background", self)
        self._endings = ThreadService("ending", self)  # Ends recordings. Closing the window waits for it.
        self._applying = ThreadService("applying", self)
        """Sends positions to a robot, which may be slow and must not be interrupted."""
        self._review_process: WorkerProcess | None = None
        self._jobs: JobQueue | None = None
        self._server: DeviceProcess | None = None
        self._recording: Recording | None = None
        self._reviewing: ReviewClient | None = None
        self._targets: OpenTargets | None = None  # Sends poke targets to a robot or the simulated operator
        self._listener: socket.socket | None = None  # Port of the targets, until something serves them
        self.running = Running.OPENING
        self.prepare: Callable[[], object] = lambda: None
        """Imports the session's views; called in the background before `guided_made`."""
        self.pace = 1  # Of the simulated operator, one of `OPERATOR_PACES`; 0 if a simulated robot pokes
        self.demo = False
        self._reset()
        self._timer = QTimer(self, interval=TICK_PERIOD_MS)
        self._timer.timeout.connect(self.tick)

    def _reset(self) -> None:
        """Forget everything of the session that was open."""
        self.simulated = False  # The rig is or was simulated
        self._part: Part | None = None
        self._is_guiding = False  # What follows the session is being made, or is there
        self._first_pose = ""
        self._storage: SessionFolder | None = None
        self._pending_links: tuple[LinkSpec, ...] = ()  # Links of a recording that has not started
        self._truth = b""
        self.guided: GuidedSession | None = None  # Guide, press coach and checks; `None` before `guided_made`
        self._size_at_open: tuple[Sequence[HistoryEntry], int] = (), 0
        self._opened_s = 0.0  # Of the host's monotonic clock
        self._links_confirmed = True  # The operator named the links or agreed to them
        self._shown: Snapshot | None = None
        self._shown_ns = self._solving_since_ns = 0
        """Time of the last picture, and since when taxels wait (0: none do); host's monotonic clock."""
        self._has_news = False  # Background work brought something that is not shown yet
        self._scene: Memo[Scene] = Memo()  # With the thresholds in use

    # Opening and closing

    def open(self, request: OpenRequest) -> None:
        """Open a session instead of the present one; returns at once.

        `part_loaded` follows. Then someone calls `guide_part`: after the picture of the part, which would wait for it. Then
        `guided_made` and `session_opened` follow.
        """
        self._release(request.session)
        self._set_running(Running.OPENING)
        self._storage = storage = SessionFolder(request, self._documents)
        self.demo, self.pace = request.demo, 0 if request.robot else DEMO_SPEED_FACTOR if request.demo else 1
        self._timer.start()
        if request.session is not None:
            self._serve_targets(request.targets)
            links = None if request.read_only else link_specs(request.addresses)
            self._links_confirmed = bool(links)
            self.compute(
                lambda: self._load_session(storage, links),
                lambda found: self._take_session(storage, found),
                # Its journal is open and its folder locked.
                dropped=lambda found: None if isinstance(found, str) else _drop(found[1], storage),
            )
            return
        if request.addresses:
            self._pending_links = link_specs(request.addresses)
            self._serve_targets(request.targets)
        self._first_pose = request.pose
        self.compute(lambda: _load_part(request.scene), lambda part: self._take_part(part, request))

    def leave(self) -> None:
        """Close the open session without opening another; slow work ends in the background."""
        self._release()
        self._set_running(Running.OFFLINE)

    def _release(self, following: Path | None = None) -> None:
        """Release the open session; slow work ends in the background. `following` is the session that is opened next."""
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
        self._close_targets()
        self._end_recording(following)
        self._reset()
        self.released.emit()

    def _end_recording(self, following: Path | None = None) -> None:
        """End the recording in the background. A provisional one without changes is discarded, and so is an empty one."""
        if self._recording is not None and not self.unsaved_pokes:
            self._recording.storage.discard()
        if self._recording is not None and self._is_empty(self._recording):
            storage = self._recording.storage
            # It may be the session that is opened next.
            if (following is None or following.absolute() != storage.folder.absolute()) and storage.discard_empty():
                self.said.emit(Message(empty_words(storage.folder), found=True))
        recording, self._recording = self._recording, None
        if recording is not None:
            self._endings.submit(recording.end, lambda _: None, self._say_failure)

    def _is_empty(self, recording: Recording) -> bool:
        """Whether a session ends soon after its beginning, without a poke or an action."""
        pipeline = recording.pipeline
        is_short = time.monotonic() - self._opened_s < EMPTY_SESSION_MAX_S
        return is_short and not pipeline.snapshot().pokes and _session_size(pipeline) == self._size_at_open

    def stop(self) -> None:
        """Stop the timer and the device readers; the window gets no more updates."""
        self._timer.stop()
        self._threads.renew()
        if self._recording is not None:
            stop_all(self._recording.halt_readers())

    def close(self) -> None:
        """Stop, end all processes, and close the journal."""
        self.stop()
        self._end_recording()
        self._close_targets()
        if self._server is not None:
            self._server.stop()
        if self._reviewing is not None:
            self._reviewing.stop()
        for service in (self._review_process, self._jobs, self._threads):
            if service is not None:
                service.close()
        # Without a limit: a slow disk must not cost a recording, and a silent robot ends it within an answer's time.
        self._endings.wait()
        self._endings.deliver()
        self._endings.close()
        self._applying.wait()
        self._applying.close()

    def _start_server(self, command: tuple[str, ...]) -> None:
        self._server = DeviceProcess(self)
        self._server.truth_printed.connect(self._take_truth)
        self._server.served.connect(self._take_links)
        self._server.failed.connect(self._fail)
        # The simulated operator gets targets as a robot does. Its process starts before they are served.
        self._listener = socket.create_server(ANY_PORT)
        host, port = self._listener.getsockname()
        self._server.start((*command, "--targets", f"{host}:{port}"))
        if self.guided is not None:
            self._serve_operator()

    def _serve_operator(self) -> None:
        """Read what the process of the devices prints, if there is one, and send poke targets to its operator."""
        listener, self._listener = self._listener, None
        if listener is not None and self._server is not None:
            from skincal.robot.target_server import TargetServer

            self._targets = TargetServer(listener)
            self._server.listen()

    def _serve_targets(self, port: str) -> None:
        """Send poke targets at a port or by ROS 2, if one is named."""
        if not port:
            return
        from skincal.robot.targets import open_targets

        try:
            self._targets = open_targets(port)
        except InputError as error:
            self._say_failure(str(error))

    def _close_targets(self) -> None:
        for port in (self._targets, self._listener):
            if port is not None:
                port.close()
        self._targets = self._listener = None

    def _take_truth(self, truth: bytes) -> None:
        self._truth = truth

    def _take_links(self, links: tuple[LinkSpec, ...]) -> None:
        self._pending_links = links
        self.simulated = True
        if self.pace > 1:
            self.set_pace(self.pace)
        if self._recording is None:
            self._start_recording()
        else:
            self._go_on_simulated(self._recording, links)

    def _go_on_simulated(self, recording: Recording, links: tuple[LinkSpec, ...]) -> None:
        """Read the simulated rig in a recorded session, if it is the session's own."""
        from skincal.files.reference import is_same_rig

        try:
            is_same = is_same_rig(recording.storage.folder, self._truth)
        except InputError as error:
            self._say_failure(str(error))
            return
        if not is_same:
            self._say_failure(OTHER_RIG)
            return
        recording.links, self._links_confirmed = links, True
        self._connect(recording)

    def set_pace(self, pace: int) -> None:
        """Set the speed of the simulated operator; real devices get nothing."""
        self.pace = pace
        if self._server is not None:
            self._server.send_line(f"pace {pace}")
        if self._recording is not None:
            self.running_changed.emit(self.running)

    @property
    def has_simulator(self) -> bool:
        return self._server is not None and self.pace > 0

    def stop_robot(self) -> None:
        """Stop the robot that pokes, at once; let a stopped one go on."""
        if self.guided is None or self._targets is None:
            return
        if self.guided.is_halted:
            self.guided.let_robot_go_on()
        else:
            try:
                self.guided.halt_robot(self._targets)
            except InputError as error:
                self._say_failure(f"The robot may not have got the stop: {error}")
        self.publish_again()

    @property
    def stop_words(self) -> str:
        """Text of the command that stops the robot, or lets it go on; empty if no robot can poke."""
        if self._targets is None or self.guided is None:
            return ""
        return "Let the robot go on" if self.guided.is_halted else "Stop the robot"

    def _take_robot_answers(self, recording: Recording) -> None:
        """Handle the answers of robots; a skip waits while actions are impossible."""
        if self._targets is None or self.guided is None or recording.pipeline.session.unsolved > MAX_UNSOLVED_TAXELS:
            return
        sentences = self.guided.handle_answers(recording.pipeline, self._targets, time.monotonic_ns())
        for sentence in () if self.simulated else sentences:
            self.said.emit(Message(sentence, found=True))

    def _show_part(self, part: Part) -> None:
        self._part = part
        self.part_loaded.emit(part)
        for finding in part.findings:
            self.said.emit(Message(finding, found=True))

    def _take_part(self, part: Part, request: OpenRequest) -> None:
        self._show_part(part)
        # Not before: until now a trial in a process of its own shows whether the part can be drawn.
        if request.server and not request.addresses:
            self._start_server(request.server)

    def guide_part(self) -> None:
        """Make what follows the session on the loaded part, and begin the session; returns at once.

        A second call does nothing.
        """
        part, recording = self._part, self._recording
        if part is None or self._is_guiding:
            return
        self._is_guiding = True
        self.compute(lambda: self._guide(part, is_recorded=recording is not None), self._take_guided)

    def _take_guided(self, guided: GuidedSession) -> None:
        self.guided = guided
        guided.guide.first_module_pokes = DEMO_FIRST_MODULE_POKES if self.demo else 0
        self.guided_made.emit(guided)
        if self._recording is not None:
            self._begin_reading(self._recording, connect=self._links_confirmed)
        elif self._pending_links:
            self._start_recording()
        elif self._server is None:
            self._set_running(Running.OFFLINE)
        self._serve_operator()

    def _start_recording(self) -> None:
        """Start a new recording once part and links are there."""
        part, links, storage, truth, guided = self._part, self._pending_links, self._storage, self._truth, self.guided
        if part is not None and guided is not None and links and storage is not None:

            def begin_guided() -> Pipeline:
                # Before there is a recording, the window's thread does not ask the guide.
                guided.guide.prepare(guided.method)
                return begin_session(part, links, storage.prepare(), truth)

            self.compute(
                begin_guided,
                lambda pipeline: self._take_new(Recording(pipeline, storage)),
                dropped=lambda pipeline: _drop(pipeline, storage),
            )

    def _take_new(self, recording: Recording) -> None:
        if self._first_pose:
            from skincal.model.actions import SetPose

            recording.pipeline.act(SetPose(self._first_pose), time.monotonic_ns())
        self._take_recording(recording)
        self._begin_reading(recording, connect=True)

    def _take_session(self, storage: SessionFolder, found: tuple[Part, Pipeline] | str) -> None:
        if isinstance(found, str):
            self._set_running(Running.OFFLINE)
            self.recorded_elsewhere.emit(storage.folder, found)
            return
        part, pipeline = found
        # From now on it is closed with the session that is open.
        self._take_recording(Recording(pipeline, storage))
        self._show_part(part)
        if storage.shipped is not None:
            self.said.emit(Message(copy_words(storage.shipped), found=True))

    def _take_recording(self, recording: Recording) -> None:
        self._recording = recording
        self._size_at_open, self._opened_s = _session_size(recording.pipeline), time.monotonic()

    def _begin_reading(self, recording: Recording, *, connect: bool) -> None:
        """Begin to read the devices, unless a recorded session waits for a confirmation."""
        if connect:
            recording.start()
        self._set_running(Running.STREAMING if connect else Running.OFFLINE)
        self.session_opened.emit(recording.pipeline.snapshot())
        self._publish_storage()
        self._publish(recording, recording.pipeline.snapshot(), time.monotonic_ns())
        part = self._part
        if part is not None:
            from skincal.files.reference import find_truth

            folder, link, channels = recording.storage.folder, part.scene.link, part.channels.tolist()
            self.compute(lambda: find_truth(folder, link, channels), self._publish_truth)

    def _publish_truth(self, truth: TaxelPositions | None) -> None:
        if truth is not None:
            # Only a simulated rig has one.
            self.simulated = True
            self.truth_found.emit(truth)

    @property
    def links(self) -> tuple[LinkSpec, ...]:
        return self._pending_links if self._recording is None else self._recording.links

    # The tick

    def tick(self) -> None:
        """Process arrived readings, and publish the state if something changed."""
        recording = self._recording
        if recording is None or self.guided is None:
            return
        self._take_robot_answers(recording)
        drained = self._take_in(recording)
        snapshot = recording.pipeline.snapshot(SOLVING_TIME_PER_TICK_S)
        is_busy = recording.has_backlog or recording.pipeline.session.unsolved > 0
        interval = BUSY_TICK_PERIOD_MS if is_busy else TICK_PERIOD_MS
        # Setting the interval restarts the timer, even with the same value.
        if self._timer.interval() != interval:
            self._timer.setInterval(interval)
        now_ns = time.monotonic_ns()
        pause_s = MIN_PICTURE_INTERVAL_S if drained or self._has_news else IDLE_PICTURE_INTERVAL_S
        pause_s = MIN_BUSY_PICTURE_INTERVAL_S if is_busy else pause_s
        if snapshot is not self._shown or now_ns - self._shown_ns >= 1e9 * pause_s:
            self._publish(recording, snapshot, now_ns)

    def _take_in(self, recording: Recording) -> bool:
        is_far_behind = (
            recording.has_backlog and 0 < recording.reached_ns < time.monotonic_ns() - PREFER_READINGS_IF_BEHIND_BY_NS
        )
        drained = recording.drain(BACKLOG_READINGS_TIME_PER_TICK_S if is_far_behind else READINGS_TIME_PER_TICK_S)
        recording.pipeline.tick(time.monotonic_ns())
        # Also without devices: an action may be what the disk refused.
        if failure := recording.take_failure():
            self._say_failure(failure)
            self.pause()
        return drained

    def _publish(self, recording: Recording, snapshot: Snapshot, now_ns: int) -> None:
        self._shown, self._shown_ns, self._has_news = snapshot, now_ns, False
        pipeline, guided = recording.pipeline, self.guided
        if guided is None:  # Before the part is loaded
            return
        from app.state.view_state import ViewState

        session = pipeline.session
        if snapshot.decisions.landmarks:
            self._review(session, snapshot)
        reached_ns = recording.processed_ns(now_ns)
        live = pipeline.live(reached_ns)
        is_recording = self.running is Running.STREAMING
        guided.follow_session(pipeline, snapshot, now_ns, self._targets, is_recording=is_recording, seen_ns=reached_ns)
        for sentence in guided.setup.take_untrue():
            self.unsaid.emit(Message(sentence, error=True))
        for sentence in reversed(guided.setup.take_news()):  # the newest message is on top
            self.said.emit(Message(sentence, error=True))
        # A press in the base cannot be compared with a target on the part.
        target = None if guided.guidance is None or not snapshot.is_placed else guided.guidance.target
        guided.coach.follow_reading(live.progress, target)
        self._solving_since_ns = (self._solving_since_ns or now_ns) if session.unsolved else 0
        unsolved = session.unsolved if now_ns - self._solving_since_ns >= 1e9 * SHOW_SOLVING_AFTER_S else 0
        scene, thresholds = guided.part.scene, snapshot.decisions.thresholds
        state = ViewState(
            snapshot=snapshot,
            live=live,
            scene=self._scene.get((thresholds,), lambda: replace(scene, contacts=thresholds)),
            names=guided.names,
            method=guided.method,
            running=self.running,
            now_ns=reached_ns,
            behind_s=(now_ns - reached_ns) * 1e-9,
            guidance=guided.guidance,
            coaching=guided.coach.coaching,
            unsolved=unsolved,
            tip=guided.tip,
            robot_halted=guided.is_halted,
            simulated=simulated_words(self.pace, self.running) if self.simulated else "",
            costs=guided.guide.costs,
        )
        self.ticked.emit(state)

    def publish_again(self) -> None:
        """Publish the newest snapshot again after a change of the guide or the panels."""
        if self._recording is not None and self._shown is not None:
            self._publish(self._recording, self._shown, time.monotonic_ns())

    def _review(self, session: Session, snapshot: Snapshot) -> None:
        """Review sensor and arm in another process."""
        if self._reviewing is None:
            from app.workers.processes import ReviewClient, WorkerProcess

            self._review_process = self._review_process or WorkerProcess()
            self._reviewing = ReviewClient(session, self._review_process, self)
            self._reviewing.reviewed.connect(self.reviewed)
            self._reviewing.failed.connect(self._review_failed)
        self._reviewing.follow_session(snapshot)

    def _review_failed(self, sentence: str) -> None:
        self._say_failure(sentence)
        self.reviewed.emit(None)

    # What the operator asks for

    def toggle(self) -> None:
        """Pause, resume, or connect the devices."""
        if self.running is Running.STREAMING:
            self.pause()
        elif self.running in (Running.PAUSED, Running.OFFLINE):
            self.resume()

    def pause(self) -> None:
        """Close the devices; nothing is recorded until `resume`."""
        if self._recording is not None and self.running is Running.STREAMING:
            readers = self._recording.halt_readers()
            self._set_running(Running.PAUSED)
            self.compute(lambda: stop_all(readers))

    def resume(self, *, confirmed: bool = False) -> None:
        """Open the devices, in a new segment of the recording; those of a recorded session only if `confirmed`."""
        if self._recording is None or self.running is Running.STREAMING:
            return
        self._links_confirmed |= confirmed
        # A read-only session connects nothing and says so.
        if self._links_confirmed or self._recording.pipeline.journal is None:
            self._connect(self._recording)
            return
        from skincal.files.reference import is_simulated, simulated_rig_options

        folder = self._recording.storage.folder
        if simulated_rig_options(folder):
            self.simulation_due.emit()
        elif is_simulated(folder) or any(link.is_simulated for link in self.links):
            self.said.emit(Message(UNKNOWN_RIG, found=True))
        else:
            self.confirmation_due.emit(tuple(link.address for link in self.links))

    def simulate_again(self) -> None:
        """Start the simulated rig and hand of a recorded session again, in a new segment of the recording."""
        recording = self._recording
        if recording is None or self.running is Running.STREAMING:
            return
        server, self._server = self._server, None
        if server is not None:
            server.release()
        self._close_targets()
        pipeline = recording.pipeline
        self._start_server(same_rig_command(recording.storage.folder, pipeline.scene.path, len(pipeline.snapshot().clocks)))

    def change_addresses(self, addresses: Addresses) -> None:
        """Read the devices at other addresses from now on, in a new segment of the recording."""
        recording = self._recording
        if recording is None:
            return
        self.pause()
        recording.links = link_specs(addresses)
        self._links_confirmed = True
        # After the readers of the pause have ended: a serial port has one reader.
        self.compute(lambda: None, lambda _: self._connect(recording))

    def _connect(self, recording: Recording) -> None:
        # The operator may have resumed meanwhile.
        if self.running is Running.STREAMING:
            return
        try:
            recording.resume()
        except InputError as failure:
            self._say_failure(str(failure))
            return
        self._set_running(Running.STREAMING)

    def act(self, action: Action) -> bool:
        """Apply an operator's action to the session; return whether it was possible."""
        if self._recording is None:
            return False
        if self._recording.pipeline.session.unsolved > MAX_UNSOLVED_TAXELS:
            self._say_failure(STILL_SOLVING)
            return False
        pipeline = self._recording.pipeline
        try:
            pipeline.act(action, time.monotonic_ns())
        except InputError as error:
            self._say_failure(str(error))
            return False
        # Solving all taxels starts in the next tick.
        shown = self._shown if pipeline.session.unsolved > MAX_UNSOLVED_TAXELS else None
        self._publish(self._recording, shown or pipeline.snapshot(SOLVING_TIME_PER_TICK_S), time.monotonic_ns())
        return True

    def name_landmarks(self) -> dict[int, str] | None:
        """Name the landmark of each poke that is surely at one; return these, or `None` while the part's pose is unknown."""
        if self._recording is None:
            return {}
        from skincal.model.actions import AtLandmark

        session = self._recording.pipeline.session
        if not session.snapshot().is_placed:
            return None
        found = session.sure_landmarks()
        self.act_all(AtLandmark(poke, name) for poke, name in found.items())
        return found

    def act_all(self, actions: Iterable[Action]) -> None:
        """Do several actions up to the first that is impossible."""
        for action in actions:
            if not self.act(action):
                return

    def keep(self) -> None:
        if self._recording is not None and self.can_keep:
            self._recording.storage.keep()
            self.said.emit(Message(kept_words(self._recording.storage.folder)))
            self._publish_storage()

    def discard(self) -> None:
        """Delete a provisional session when it closes."""
        if self._recording is not None:
            self._recording.storage.discard()

    @property
    def can_keep(self) -> bool:
        """Whether the session is not saved yet and can be kept."""
        return self._recording is not None and self._recording.storage.is_provisional

    @property
    def folder(self) -> Path | None:
        """Folder of the session; `None` while it is provisional, or nothing is open."""
        return None if self._recording is None or self.can_keep else self._recording.storage.folder

    @property
    def scene_copy(self) -> Path | None:
        """The open session's own scene file; `None` without a session that may be changed."""
        if self._recording is None or self._recording.pipeline.journal is None:
            return None
        from skincal.journal.writer import SCENE_FILE, SCENE_FOLDER

        return self._recording.storage.folder / SCENE_FOLDER / SCENE_FILE

    @property
    def unsaved_pokes(self) -> int:
        """Number of pokes in a provisional session; 0 if nothing changed since it was opened."""
        if self._recording is None or not self.can_keep or _session_size(self._recording.pipeline) == self._size_at_open:
            return 0
        return len(self._recording.pipeline.snapshot().pokes)

    def _why_no_results(self) -> str:
        """Say why no results can be written now; empty if they can."""
        if self._recording is None or self._part is None:
            return NO_SESSION
        return STILL_SOLVING if self._recording.pipeline.session.unsolved > MAX_UNSOLVED_TAXELS else ""

    def export_work(
        self, format_: str, path: Path, method: Method, rig: RigAnswer | None, options: ExportOptions = NO_OPTIONS
    ) -> Callable[[], tuple[Verdict, tuple[str, ...]]]:
        """Make the work that writes a calibration file of the present moment, for `compute`.

        Parameters
        ----------
        rig : result of the landmark pokes; `None` if they were not reviewed

        Returns
        -------
        Function that writes the file, and returns the verdict by `method` and the sentences of the file's lint

        Raises
        ------
        InputError
            No results can be written now.
        """
        refusal, recording, part = self._why_no_results(), self._recording, self._part
        if refusal or recording is None or part is None:
            raise InputError(refusal)
        # Made here, not in the thread: the session continues while the file is written.
        session = recording.pipeline.session
        calibration, snapshot = session.calibration(), session.snapshot()

        def write() -> tuple[Verdict, tuple[str, ...]]:
            from skincal.files.export import write_calibration
            from skincal.files.formats import ExportFormat
            from skincal.following.results import checked, verdicts_of

            methods = session.methods if ExportFormat(format_).holds_all_methods else (method,)
            with raise_sentences("The file is not written"):
                verdicts = verdicts_of(part, snapshot, methods, rig)
                _make_folder(path.parent)
                return verdicts[method], write_calibration(checked(calibration, rig, verdicts), format_, path, method, options)

        return write

    def apply(self, address: str, method: Method, done: Callable[..., None], ended: Callable[[], None] | None = None) -> None:
        """Send the calibrated taxel positions to a running robot, in the background.

        Parameters
        ----------
        done : gets a sentence, every question with its answer, and `good`: whether all succeeded
        ended : called last in every case
        """
        refusal, recording = self._why_no_results(), self._recording
        if refusal or recording is None:
            done(refusal, (), good=False)
            return
        calibration = recording.pipeline.session.calibration()
        # The robot's own positions are written next to the recording, and must not be deleted with it.
        self.keep()
        folder = recording.storage.folder
        lines: list[str] = []

        def send() -> str:
            from skincal.robot.skin_manager import WAIT_FOR_ANSWER_MAX_S, apply_positions, calibrated_positions, result_text

            with raise_sentences("The positions are not sent"):
                positions = calibrated_positions(calibration, method, None)
                _make_folder(folder)
                before = folder / f"before-{positions.part}.txt"
                words = result_text(
                    apply_positions(address, positions, before, WAIT_FOR_ANSWER_MAX_S, lines.append), positions.part
                )
                return f"{words[:1].upper()}{words[1:]}."

        self._applying.submit(
            send, lambda words: done(words, lines, good=True), lambda words: done(words, lines, good=False), ended=ended
        )

    def report(self, path: Path, method: Method, done: Callable[[str], None], failed: Callable[[str], None]) -> None:
        """Write the report in a process of its own; `done` gets the verdict, `failed` a sentence."""
        if self._recording is None:
            return
        from app.workers.processes import report_job

        # The process reads files, so nothing may be buffered.
        self._recording.pipeline.sync()
        self._start_job(report_job, (self._recording.storage.folder, path, method), done, failed)

    def read_positions(self, path: Path, done: Callable[[tuple[TaxelPositions, ...]], None]) -> None:
        """Read the positions in a file or another session, in a process of its own."""
        from app.workers.processes import positions_job

        if self._part is not None:
            scene, channels = self._part.scene, self._part.channels.tolist()
            self._start_job(positions_job, (path, scene.link, channels), done, self._say_failure)

    def _start_job(
        self, job: Callable[..., Any], arguments: tuple[Any, ...], done: Callable[[Any], None], failed: Callable[[str], None]
    ) -> None:
        from app.workers.processes import JobQueue

        self._jobs = self._jobs or JobQueue(self)
        self._jobs.submit(job, arguments, done, failed)

    def compute(
        self,
        work: Callable[[], Any],
        done: Callable[[Any], None] | None = None,
        failed: Callable[[str], None] | None = None,
        **others: Callable[..., None] | None,
    ) -> None:
        """Do `work` in the background, as `ThreadService.submit`; by default the window shows a failure."""

        def deliver(result: Any) -> None:
            self._has_news = True
            if done is not None:
                done(result)

        self._threads.submit(work, deliver, failed or self._fail, **others)

    # In the background

    def _guide(self, part: Part, *, is_recorded: bool) -> GuidedSession:
        """Make what follows the session on a part. It takes long on a large one, and `compute` is only kept."""
        self.prepare()
        _import_targets()
        from skincal.following.guided_session import GuidedSession

        if part.surface is not None:
            # The ring on the skin asks for these first: computed on demand, they would block the window.
            _ = part.surface.centres, part.surface.radii
        guided = GuidedSession(part, self.compute)
        if is_recorded:
            guided.guide.prepare(guided.method)
        return guided

    def _load_session(self, storage: SessionFolder, links: tuple[LinkSpec, ...] | None) -> tuple[Part, Pipeline] | str:
        """Load a session, read-only if `links` is `None`; return a sentence if another process records it."""
        # It may be the session that was open until now.
        self._endings.wait()
        folder = storage.prepare()
        from skincal.journal.lock import RecordedElsewhereError

        try:
            return open_recorded(folder, links)
        except RecordedElsewhereError as error:
            return str(error)
        except InputError:
            storage.discard()
            storage.finish()
            raise

    # Helpers

    def _say_failure(self, sentence: str) -> None:
        self.said.emit(Message(sentence, error=True))

    def _fail(self, sentence: str) -> None:
        self._say_failure(sentence)
        if self._recording is None or self.guided is None:
            self._set_running(Running.OFFLINE)

    def _set_running(self, running: Running) -> None:
        if running is not self.running:
            self.running = running
            self.running_changed.emit(running)

    def _publish_storage(self) -> None:
        if self._recording is not None:
            self.stored.emit(self._recording.storage.sentence())
