"""An open session with what follows it: guide, press coach, dialogue with a robot, course of errors, check of the modules.

All of it follows the session before a tick is published. A view shows what it says, and tells it what the operator wants.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from skincal.contacts.outcome import PressPhase, Progress
from skincal.following.background import Run, run_at_once
from skincal.following.error_history import ErrorFollower, ModulesCheck
from skincal.following.robot_dialogue import RobotDialogue
from skincal.following.session_guide import SessionGuide, asked_poke
from skincal.following.setup_follower import SetupFollower
from skincal.geometry import FloatArray
from skincal.guide.guidance import Guidance, Target
from skincal.guide.press_coaching import PokeError, SmoothedWrench, compare_to_target, smooth_wrench
from skincal.guide.robot_order import RobotPace
from skincal.mesh.surface import Surface, point_on_skin
from skincal.model.actions import AskLandmark, BeginClosing, DroveToLandmark
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.part.part import Part, lay_part
from skincal.robot.ros_targets import RosTargets
from skincal.robot.target_lines import GuidedByHand, NoTarget, TipPose
from skincal.robot.target_server import RobotChange
from skincal.robot.targets import Targets
from skincal.session.solving import methods_of
from skincal.taxels.result import Method
from skincal.words.robot_words import drove_sentence, silent_robot_sentence
from skincal.words.units import ChannelNames

if TYPE_CHECKING:
    from skincal.axes.session_turns import SessionTurns
    from skincal.session.pipeline import Pipeline
    from skincal.session.snapshot import Snapshot

METHOD_ORDER = (Method.SURFACE, Method.FREE, Method.MODULES)
GUIDE_UPDATE_PERIOD_NS = 20_000_000
"""ns between two looks at the guide, without a window."""


def first_method(methods: Sequence[Method], part: Part) -> Method:
    """Choose the method to start with: modules if their layout lies on a mesh, since it takes far fewer pokes."""
    if Method.MODULES in methods and part.surface is not None and part.laid is not None:
        return Method.MODULES
    return Method.SURFACE if Method.SURFACE in methods else methods[0]


class PressCoach:
    """Compares the poke in progress with the target."""

    def __init__(self, surface: Surface | None) -> None:
        self._surface = surface
        self._smoothed: SmoothedWrench | None = None
        self._skin: tuple[Target, FloatArray] | None = None
        """The target and its place on the skin, (3,) float, metres."""
        self.coaching: PokeError | None = None
        """`None` while nothing presses or guidance is off."""

    def follow_reading(self, progress: Progress, target: Target | None) -> None:
        """Follow the newest reading; `target` is `None` while guidance is off."""
        self._smoothed = smooth_wrench(self._smoothed, progress)
        # At a landmark the rig's errors move the tip, and the poke is there to measure them: no one is asked to aim by it.
        if target is None or target.landmark or self._smoothed is None:
            self.coaching = None
            return
        if self._skin is None or self._skin[0] is not target:
            self._skin = target, point_on_skin(self._surface, target.place, target.normal)
        self.coaching = compare_to_target(self._smoothed, progress, target, self._skin[1])


class GuidedSession:
    """An open session with its pipeline, guide, coach, reviews and error history.

    Parameters
    ----------
    run : does the slow work beside the session
    """

    def __init__(self, part: Part, run: Run = run_at_once) -> None:
        self.part, self.names = part, ChannelNames(part.scene.skin.layout)
        self.guide, self.coach = SessionGuide(part), PressCoach(part.surface)
        there = methods_of(part.scene, part.surface)
        self.methods = tuple(method for method in METHOD_ORDER if method in there)
        """Methods of the scene, in the order of the menu."""
        self.method = first_method(there, part)
        """Method that is shown, whose needs the guide follows."""
        self.errors, self.modules = ErrorFollower(part, run), ModulesCheck(part, run)
        self.setup = SetupFollower(part, run)
        self.shows_errors = self.shows_modules = False
        """Whether anybody sees them; else they do no work."""
        self.guidance: Guidance | None = None
        """`None` before the first tick and while guidance is off."""
        self._robot = RobotDialogue(part.scene)
        self._asked: tuple[Snapshot, Method, bool] | None = None
        """Snapshot, method and switch of the newest guidance."""
        self._shown_frames: tuple[SessionTurns, Method] | None = None
        """Turns and method of the frames that a robot knows; `None` before the first."""
        self.tip: TipPose | None = None
        """Tip of the robot as it reports it; `None` without one."""

    def show_errors(self, seen: bool) -> None:
        """Follow the course of errors while somebody sees it."""
        self.shows_errors = seen

    def show_modules(self, seen: bool) -> None:
        """Check the modules while somebody sees the result."""
        self.shows_modules = seen

    def handle_answers(self, pipeline: Pipeline, server: Targets, now_ns: int) -> list[str]:
        """Handle what robots said since the last call; give sentences for the operator."""
        sentences = list[str]()
        for item in server.read_answers():
            if isinstance(item, str):
                sentences.append(item)
                continue
            if isinstance(item, TipPose):
                self.tip = item
                self._robot.note_tip()
                continue
            if isinstance(item, GuidedByHand):
                self._robot.note_hand(item)
                continue
            if isinstance(item, RobotPace | RobotChange):
                self._take_robot(item)
                continue
            meaning = self._robot.handle_answer(item, now_ns * 1e-9)
            if meaning.wants_other_target and (skip := self.guide.skip(meaning.impossible)) is not None:
                pipeline.act(skip, now_ns)
            if meaning.warning:
                sentences.append(meaning.warning)
            if meaning.protocol_error:
                server.refuse(meaning.protocol_error)
        return [*sentences, *self._record_drives(pipeline, now_ns)]

    def _record_drives(self, pipeline: Pipeline, now_ns: int) -> Iterator[str]:
        """Record the landmarks that a robot drove to; give a sentence for the first, and for silence about a touch.

        Only the pose of a part needs that.
        """
        driven, silent = self._robot.take_driven(), self._robot.take_silent(now_ns * 1e-9)
        if pipeline.scene.tool is None:
            return
        if silent:
            yield silent_robot_sentence(silent)
        for name in driven:
            if not pipeline.session.decisions.driven_to_landmarks:
                yield drove_sentence(name)
            pipeline.act(DroveToLandmark(name), now_ns)

    def _take_robot(self, news: RobotPace | RobotChange) -> None:
        if isinstance(news, RobotPace):
            self.guide.robot = news
        else:
            self.guide.robot = self.tip = None
            self._robot.robot_left()
        if news is RobotChange.CAME:
            self._robot.robot_connected()

    @property
    def is_halted(self) -> bool:
        """Whether the operator has stopped the robot."""
        return self._robot.is_halted

    def halt_robot(self, server: Targets) -> None:
        """Stop the robot at once."""
        server.send(self._robot.halt())

    def let_robot_go_on(self) -> None:
        """Ask a stopped robot again, at the next look."""
        self._robot.go_on()

    def follow_session(
        self,
        pipeline: Pipeline,
        snapshot: Snapshot,
        now_ns: int,
        server: Targets | None = None,
        *,
        is_recording: bool = True,
        seen_ns: int | None = None,
    ) -> bool:
        """Choose the next target, record the request, and send it to a robot.

        Parameters
        ----------
        snapshot : the newest that is solved
        now_ns : host's monotonic clock
        server : sends targets to robots
        is_recording : the devices are read; else nothing is recorded and no robot is asked to press
        seen_ns : as `now_ns`, arrival of the newest reading while readings wait

        Returns
        -------
        Whether a robot got the message that it is enough.
        """
        pose = pipeline.poses.current
        asked = snapshot, self.method, self.guide.wanted
        # A robot that carries the part changes the arm's pose on its way, and another pose may have other needs.
        if not (server is not None and self._robot.has_open_request and asked == self._asked):
            self.guidance = self.guide.next_target(snapshot, pose, self.method, now_ns * 1e-9)
            self._asked = asked
        if is_recording:
            record_request(self.guidance, pipeline, now_ns)
        self.setup.check_snapshot(snapshot, pipeline.session.wrench_frames)
        self.setup.check_skin(snapshot, pipeline.totals)
        if self.shows_modules:
            self.modules.check_snapshot(snapshot)
        if self.shows_errors:
            self.errors.update(snapshot)
        if server is None:
            return False
        seen_ns = now_ns if seen_ns is None else seen_ns
        measuring = is_recording and pipeline.can_measure(seen_ns)
        held = measuring and pipeline.phase is PressPhase.HELD
        lines = self._robot.lines_to_send(self.guidance, snapshot, pose[0], now_ns * 1e-9, measuring=measuring, held=held)
        server.send(lines)
        if isinstance(server, RosTargets):
            server.show_taxels(pipeline.scene.link, snapshot.estimates.get(self.method, ()))
            self._show_frames(pipeline.scene, snapshot, server)
        return NoTarget.ENOUGH in lines

    def _show_frames(self, scene: Scene, snapshot: Snapshot, server: RosTargets) -> None:
        """Publish the frames of taxels of three axes, after the turns or the shown method changed."""
        if snapshot.turns is None or self.method not in snapshot.estimates:
            return
        shown = self._shown_frames
        if shown is not None and shown[0] is snapshot.turns and shown[1] is self.method:
            return
        self._shown_frames = snapshot.turns, self.method
        found = snapshot.axis_results(scene.skin.layout)
        if found is not None:
            server.show_frames(scene.link, found.poses(self.method))


def record_request(guidance: Guidance | None, pipeline: Pipeline, now_ns: int) -> None:
    """Record a changed request of the guide: landmark, poke on the skin, or start of a closing check."""
    name = "" if guidance is None or guidance.landmark is None else guidance.landmark.landmark.name
    if name != pipeline.asked_landmark:
        pipeline.act(AskLandmark(name), now_ns)
    asked = asked_poke(guidance)
    if asked != pipeline.session.asked:
        pipeline.act(asked, now_ns)
    # Guidance may be older than the session, and the check has begun meanwhile.
    closing = None if guidance is None else guidance.closing
    if closing is not None and len(pipeline.session.decisions.closings) < closing.number:
        pipeline.act(BeginClosing(), now_ns)


class RobotGuide:
    """Guides a robot through a recording without a window.

    Parameters
    ----------
    method : whose needs the guide follows; `None` for the one that the window shows first
    """

    def __init__(self, pipeline: Pipeline, server: Targets, method: Method | None) -> None:
        part = lay_part(pipeline.scene, pipeline.session.surface, ())
        methods = methods_of(part.scene, part.surface)
        if method is not None and method not in methods:
            known = " or ".join(each.value for each in methods)
            raise InputError(f"the scene has no {method.value} method; expected --method {known}.")
        self._pipeline, self._server, self._guided = pipeline, server, GuidedSession(part)
        self._guided.method = method or self._guided.method
        self._next_ns = 0
        self.enough = False
        """The robot got the message that no more pokes are needed."""

    def guide_robot(self, now_ns: int, seen_ns: int | None = None) -> list[str]:
        """Handle answers and send targets; give sentences for the operator. Parameters as of `GuidedSession.follow_session`."""
        if now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + GUIDE_UPDATE_PERIOD_NS
        sentences = self._guided.handle_answers(self._pipeline, self._server, now_ns)
        self.enough |= self._guided.follow_session(
            self._pipeline, self._pipeline.snapshot(), now_ns, self._server, seen_ns=seen_ns
        )
        return sentences
