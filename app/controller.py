"""Owns what is open and the one timer; its slots are the operator's wishes.

Each tick takes what arrived, lets the road work on it for a bounded time, and tells the window once, and only if
something changed. Everything slow is done in the background and comes back in a tick.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject, QTimer, Signal

from app.pace import BEHIND_MS, TICK_MS, Pace
from app.panels.message_bar import Message
from app.plan import Plan, find_scene, link_specs
from app.recording import Recording, stop_all
from app.running import Running
from app.storage import Storage
from app.workers.device_process import DeviceProcess
from app.workers.processes import ProcessService
from app.workers.threads import ThreadService
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from app.opening import Part
    from app.workers.review_client import ReviewClient
    from skincal.files.calibration import LandmarkCheck
    from skincal.files.reference import Reference
    from skincal.session.actions import Action
    from skincal.session.road import Road
    from skincal.session.session import Session
    from skincal.session.snapshot import LiveView, Snapshot
    from skincal.simulate.orders import Wish
    from skincal.streams.links import LinkSpec
    from skincal.taxels.contact_table import Evidence
    from skincal.taxels.result import Method

DRAIN_S = 0.012
"""s. Readings are worked on for at most this long a tick; the rest waits, so that the window answers."""
SOLVE_S = 0.012
"""s. Taxels are solved for about as long a tick: a poke's few at once, all of them, as under a correction of the rig, in
several ticks, in which the window answers."""

AT_ONCE = 200
"""Taxels that are solved before the next thing is done: 0.1 s at most. Of more, the window waits in its ticks."""
STILL_SOLVING = "All taxels are being solved anew, and what is shown is from before: try again in some seconds."


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What a tick found."""

    snapshot: Snapshot
    live: LiveView
    now_ns: int
    """Host's monotonic clock; while readings wait, the arrival of the newest that was worked on."""
    behind_s: float
    """How long ago that was, while readings wait; else 0."""
    evidence: Callable[[Collection[int]], Evidence]
    """What the contacts of the newest snapshot say of some channels; holds until the next picture."""
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
    """`Picture`."""
    running_changed = Signal(object)
    """`Running`."""
    said = Signal(object)
    """`Message`."""
    reviewed = Signal(object)
    """`Review`: what landmark pokes tell of the rig; None where nobody tells any more."""
    truth_found = Signal(object)
    """`Reference`: where the taxels of a simulated rig are."""
    stored = Signal(str)
    """Where the recording is, in words."""

    def __init__(self, documents: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._documents = documents
        self._threads = ThreadService("background", self)
        self._processes = ProcessService()
        self._news = False
        """The background brought something that is not shown yet."""
        self._server: DeviceProcess | None = None
        self._links: tuple[LinkSpec, ...] = ()
        self._truth = b""
        self._wish = ""
        """Line that a simulated operator was told last."""
        self._storage: Storage | None = None
        self._part: Part | None = None
        self._recording: Recording | None = None
        self._reviewing: ReviewClient | None = None
        self._shown: Snapshot | None = None
        self._pace = Pace()
        self.running = Running.OPENING
        self._timer = QTimer(self)
        self._timer.setInterval(TICK_MS)
        self._timer.timeout.connect(self.tick)

    # Opening and closing

    def open(self, plan: Plan) -> None:
        """Open something in place of what is open; returns at once, `part_loaded` and `session_opened` follow."""
        self._release()
        self._set_running(Running.OPENING)
        self._storage = storage = Storage(plan, self._documents)
        self._timer.start()
        if plan.session is not None:
            folder, self._links = plan.session, link_specs(plan.addresses)
            links = self._links
            self._run(
                lambda: _load_session(folder, links),
                lambda found: self._take_session(storage, found),
                lambda found: found[1].close(),
            )
            return
        if plan.addresses:
            self._links = link_specs(plan.addresses)
        elif plan.server:
            self._start_server(plan.server)
        self._run(lambda: _load_scene(plan.scene), self._take_part)

    def _release(self) -> None:
        """Let go of what is open; its end takes too long for the window and happens in the background."""
        self._threads.renew()
        server, self._server = self._server, None
        if server is not None:
            server.release()
        recording, self._recording = self._recording, None
        reviewing, self._reviewing = self._reviewing, None
        if reviewing is not None:
            reviewing.stop()
            reviewing.deleteLater()
        storage, self._storage = self._storage, None
        self._part = self._shown = None
        self._links, self._truth, self._wish, self._pace = (), b"", "", Pace()
        if recording is not None:
            self._run(recording.end, _nothing)
        elif storage is not None:
            self._run(storage.finish, _nothing)

    def stop(self) -> None:
        """Stop the timer, then the readers: nothing comes to the window any more."""
        self._timer.stop()
        self._threads.renew()
        if self._recording is not None:
            stop_all(self._recording.let_go())

    def close(self) -> None:
        """Stop, end the process behind the links, and close the journal, in that order."""
        self.stop()
        recording, self._recording = self._recording, None
        if self._server is not None:
            self._server.stop()
            self._server = None
        if self._reviewing is not None:
            self._reviewing.stop()
            self._reviewing = None
        self._processes.close()
        self._threads.close()
        try:
            if recording is not None:
                recording.end()
            elif self._storage is not None:
                self._storage.finish()
        finally:
            self._storage = None

    def _start_server(self, command: tuple[str, ...]) -> None:
        self._server = DeviceProcess(self)
        self._server.said_truth.connect(self._take_truth)
        self._server.served.connect(self._take_links)
        self._server.failed.connect(self._fail)
        self._server.start(command)

    def _take_truth(self, truth: bytes) -> None:
        self._truth = truth

    def _take_links(self, links: tuple[LinkSpec, ...]) -> None:
        self._links = links
        from skincal.simulate.orders import NoTarget

        # Nothing is recorded before the session is open.
        self.ask(NoTarget.WAIT)
        self._make_road()

    def ask(self, wish: Wish) -> None:
        """Tell a simulated operator what the guide shows, where that changed; real devices are told nothing."""
        if self._server is None:
            return
        from skincal.simulate.orders import write_wish

        line = write_wish(wish)
        if line != self._wish:
            self._wish = line
            self._server.tell(line)

    def _take_part(self, part: Part, *, make_road: bool = True) -> None:
        self._part = part
        self.part_loaded.emit(part)
        for finding in part.findings:
            self.said.emit(Message(finding, found=True))
        if make_road:
            self._make_road()

    def _make_road(self) -> None:
        part, links, storage, truth = self._part, self._links, self._storage, self._truth
        if part is not None and links and storage is not None:
            self._run(
                lambda: begin_session(part, links, storage.folder, truth),
                lambda road: self._take_recording(Recording(road, storage)),
                lambda road: road.close(),
            )

    def _take_session(self, storage: Storage, found: tuple[Part, Road]) -> None:
        part, road = found
        self._take_part(part, make_road=False)
        self._take_recording(Recording(road, storage), connect=bool(self._links))

    def _take_recording(self, recording: Recording, *, connect: bool = True) -> None:
        self._recording = recording
        self._links = recording.links
        if connect:
            recording.start()
        self._set_running(Running.STREAMING if connect else Running.OFFLINE)
        self.session_opened.emit(recording.road.snapshot())
        self._tell_storage()
        self._publish(recording, recording.road.snapshot(), time.monotonic_ns())
        part = self._part
        if part is not None:
            self._run(lambda: find_truth_of(recording.storage.folder, part), self._tell_truth)

    def _tell_truth(self, truth: Reference | None) -> None:
        if truth is not None:
            self.truth_found.emit(truth)

    @property
    def links(self) -> tuple[LinkSpec, ...]:
        """The links of what is open."""
        return self._links

    # The tick

    def tick(self) -> None:
        """Take what arrived, and tell the window if something changed."""
        recording = self._recording
        if recording is None:
            return
        drained = self._take_in(recording)
        snapshot = recording.road.snapshot(SOLVE_S)
        behind = recording.behind or recording.road.session.unsolved > 0
        wanted = BEHIND_MS if behind else TICK_MS
        if self._timer.interval() != wanted:
            self._timer.setInterval(wanted)
        now_ns = time.monotonic_ns()
        if self._pace.is_due(now_ns, behind=behind, news=drained or self._news) or snapshot is not self._shown:
            self._publish(recording, snapshot, now_ns)

    def _take_in(self, recording: Recording) -> bool:
        drained = recording.drain(DRAIN_S)
        recording.road.tick(time.monotonic_ns())
        if recording.journal_failure and self.running is Running.STREAMING:
            text = f"{recording.journal_failure} Recording is paused; what was recorded until now is safe."
            self.said.emit(Message(text, error=True))
            self.pause()
        return drained

    def _publish(self, recording: Recording, snapshot: Snapshot, now_ns: int) -> None:
        self._pace.show(now_ns)
        self._shown, self._news = snapshot, False
        if snapshot.landmarks:
            self._review(recording.road.session, snapshot)
        reached_ns = recording.reached_ns if recording.behind and recording.reached_ns else now_ns
        live = recording.road.live(reached_ns)
        evidence = recording.road.session.evidence
        unsolved = self._pace.worth_saying(recording.road.session.unsolved, now_ns)
        self.ticked.emit(Picture(snapshot, live, reached_ns, (now_ns - reached_ns) * 1e-9, evidence, unsolved))

    def _review(self, session: Session, snapshot: Snapshot) -> None:
        """Let another process tell what landmark pokes say of the rig."""
        if self._reviewing is None:
            from app.workers.review_client import ReviewClient

            self._reviewing = ReviewClient(session, self._processes, self)
            self._reviewing.reviewed.connect(self.reviewed)
            self._reviewing.failed.connect(self._review_failed)
        self._reviewing.follow(snapshot)

    def _review_failed(self, sentence: str) -> None:
        self.said.emit(Message(sentence, error=True))
        self.reviewed.emit(None)

    # The operator's wishes

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
            self._run(lambda: stop_all(readers), _nothing)

    def go_on(self) -> None:
        """Take the devices, in a new segment of the recording."""
        if self._recording is None or self.running is Running.STREAMING:
            return
        try:
            self._recording.go_on()
        except InputError as failure:
            self.said.emit(Message(str(failure), error=True))
            return
        self._set_running(Running.STREAMING)

    def act(self, action: Action) -> bool:
        """Do an action on the session; return whether it could be done."""
        if self._recording is None or self._is_solving():
            return False
        try:
            self._recording.road.act(action, time.monotonic_ns())
        except InputError as error:
            self.said.emit(Message(str(error), error=True))
            return False
        road = self._recording.road
        # Where all taxels are to be solved, that begins in the next tick.
        shown = self._shown if road.session.unsolved > AT_ONCE else None
        self._publish(self._recording, shown or road.snapshot(SOLVE_S), time.monotonic_ns())
        return True

    def _is_solving(self) -> bool:
        """Tell whether what is shown is not what an action would change, and say so; a few taxels are solved first."""
        if self._recording is None:
            return False
        if self._recording.road.session.unsolved <= AT_ONCE:
            self._recording.road.snapshot()
            return False
        self.said.emit(Message(STILL_SOLVING, error=True))
        return True

    def act_all(self, actions: Iterable[Action]) -> None:
        """Do several actions, and stop at the first that cannot be done."""
        for action in actions:
            if not self.act(action):
                return

    def keep(self) -> None:
        """Copy a temporary recording to where it stays."""
        if self._recording is not None and self.can_keep:
            self._recording.sync()
            self._run(self._recording.storage.keep, self._kept)

    def _kept(self, folder: Path) -> None:
        self.said.emit(
            Message(f"This session is kept in {folder}; what is recorded from now on is added when the window closes.")
        )
        self._tell_storage()

    @property
    def can_keep(self) -> bool:
        """Whether the recording would go with the window."""
        return self._recording is not None and self._recording.storage.can_keep

    def export(
        self,
        format_: str,
        path: Path,
        method: Method,
        check: LandmarkCheck | None,
        done: Callable[[tuple[str, ...]], None],
        failed: Callable[[str], None],
    ) -> None:
        """Write a calibration file in the background.

        Parameters
        ----------
        check : what landmark pokes say of a correction of the rig
        done : gets the sentences of the file's lint
        failed : gets why there is none
        """
        if self._recording is None:
            return
        if self._recording.road.session.unsolved > AT_ONCE:
            failed(STILL_SOLVING)
            return
        calibration = replace(self._recording.road.session.calibration(), landmark_check=check)

        def write() -> tuple[str, ...]:
            from skincal.files.export import write_calibration

            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"{path.parent}: cannot be made ({error.strerror}); choose another folder.") from error
            return write_calibration(calibration, format_, path, method)

        self._run(write, done, failed=failed)

    def compute(
        self, work: Callable[[], Any], done: Callable[[Any], None], failed: Callable[[str], None] | None = None
    ) -> None:
        """Do `work` in the background; its result is dropped where something else was opened meanwhile."""
        self._run(work, done, failed=failed)

    # Helpers

    def _run(
        self,
        work: Callable[[], Any],
        done: Callable[[Any], None],
        dropped: Callable[[Any], None] | None = None,
        failed: Callable[[str], None] | None = None,
    ) -> None:
        """Do `work` in the background; where something else was opened meanwhile, what it brings goes to `dropped`."""

        def take(result: Any) -> None:
            self._news = True
            done(result)

        self._threads.submit(work, take, failed or self._fail, dropped)

    def _fail(self, sentence: str) -> None:
        self.said.emit(Message(sentence, error=True))
        if self._recording is None:
            self._set_running(Running.OFFLINE)

    def _set_running(self, running: Running) -> None:
        if running is not self.running:
            self.running = running
            self.running_changed.emit(running)

    def _tell_storage(self) -> None:
        if self._recording is not None:
            self.stored.emit(self._recording.storage.words())


def _load_scene(scene: Path | None) -> Part:
    """Load a scene, and import what shows it, beside the window."""
    import app.desk  # noqa: F401
    from app.opening import load_part

    return load_part(find_scene(scene))


def _load_session(folder: Path, links: tuple[LinkSpec, ...]) -> tuple[Part, Road]:
    import app.desk  # noqa: F401
    from app.opening import open_road

    return open_road(folder, links)


def begin_session(part: Part, links: tuple[LinkSpec, ...], folder: Path, truth: bytes) -> Road:
    """Start a recording; what a simulated rig says of its taxels is laid beside it."""
    from app.opening import new_road
    from skincal.files.reference import TRUTH_NAME

    road = new_road(part, links, folder)
    if truth:
        (folder / TRUTH_NAME).write_bytes(truth)
    return road


def find_truth_of(folder: Path, part: Part) -> Reference | None:
    """Return the truth that lies beside a recording; None where there is none."""
    from skincal.files.reference import find_truth

    return find_truth(folder, part.scene.link, part.channels.tolist())


def _nothing(_result: Any) -> None:
    pass
