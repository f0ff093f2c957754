"""A session in simulated time: the guide asks, the robot pokes, and its bytes go through the pipeline."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

from skincal.following.guided_session import RobotGuide
from skincal.journal.writer import JournalWriter
from skincal.mesh.surface import Surface
from skincal.model.readings import SESSION_START_TIME_NS, Chunk, LinkEvent, LinkState
from skincal.model.scene import Scene
from skincal.physics.devices import RobotDevices
from skincal.physics.rig import SimulatedRobot
from skincal.robot.poking_client import PokeSettings, PokingClient
from skincal.robot.target_lines import Answer, AnswerKind, AskedLine, RobotLine
from skincal.robot.target_server import RobotChange
from skincal.session.pipeline import Pipeline
from skincal.streams.links import SIMULATED_ADDRESS, LinkSpec
from skincal.taxels.result import Method

TRAVEL_SPEED_WITH_CARRIED_PART_M_PER_S = 0.05
"""m/s, travel of a part that the arm carries: its inertia would look like a press."""
ARRIVED_WITHIN_WITH_CARRIED_PART_M = 0.0003
"""Corners are rounded less: a jolt of the part looks like a press, too."""


HELD_WAIT_WITHOUT_SENSOR_S = 0.3
"""s. At a landmark no taxel answers, so nothing says `held`: waiting for it only takes time."""


class TargetQueue:
    """Lines between guide and robot without a port: `Targets` for the guide, and two methods for the robot."""

    def __init__(self) -> None:
        self._asked: deque[AskedLine] = deque()
        self._answers: list[RobotLine | RobotChange | str] = [RobotChange.CAME]
        self.fault = ""
        """Why no more pokes come, from the robot or from the guide; empty while it pokes."""

    def send(self, lines: Sequence[AskedLine]) -> None:
        """Send lines to the robot."""
        self._asked.extend(lines)

    def read_answers(self) -> list[RobotLine | RobotChange | str]:
        """Return the answers since the last call."""
        answers, self._answers = self._answers, []
        return answers

    def refuse(self, reason: str) -> None:
        """End the session: the robot's answer is impossible."""
        self.fault = reason

    def poll(self) -> AskedLine | None:
        """Return the next line for the robot, or `None`."""
        return self._asked.popleft() if self._asked else None

    def answer(self, line: RobotLine) -> None:
        """Answer the guide."""
        if isinstance(line, Answer) and line.kind is AnswerKind.FAULT:
            self.fault = line.text
        self._answers.append(line)


class RobotSession:
    """A guided session that follows the steps of a simulated robot.

    Parameters
    ----------
    journal : open for writing; `None` records nothing
    method : whose needs the guide follows; `None` for the one that the window shows first
    """

    def __init__(
        self,
        scene: Scene,
        surface: Surface,
        robot: SimulatedRobot,
        journal: JournalWriter | None = None,
        method: Method | None = None,
    ) -> None:
        self.robot, self.targets = robot, TargetQueue()
        self._devices = RobotDevices(robot)
        self._links = [LinkSpec(name, f"{SIMULATED_ADDRESS}{name}", (stream,)) for name, stream in self._devices.links.items()]
        self.pipeline = Pipeline(scene, self._links, surface, journal)
        self._guide = RobotGuide(self.pipeline, self.targets, method)
        for link in self._links:
            self.pipeline.feed(LinkEvent(link.name, SESSION_START_TIME_NS, LinkState.OPEN))
        robot.add_listener(self._process_step)

    @property
    def is_enough(self) -> bool:
        """Whether the guide asks for no more pokes."""
        return self._guide.enough

    def _process_step(self) -> None:
        if not self._devices.is_block_full:
            return
        for at_ns, link, data in self._devices.advance():
            self.pipeline.feed(Chunk(link, SESSION_START_TIME_NS + at_ns, data))
        now_ns = SESSION_START_TIME_NS + round(self._devices.now * 1e9)
        self.pipeline.tick(now_ns)
        self._guide.guide_robot(now_ns)

    def close(self) -> None:
        """End the links and the journal."""
        now_ns = SESSION_START_TIME_NS + round(self._devices.now * 1e9)
        for link in self._links:
            self.pipeline.feed(LinkEvent(link.name, now_ns, LinkState.ENDED))
        self.pipeline.close()


def make_client(
    robot: SimulatedRobot, surface: Surface, answer: Callable[[RobotLine], object], *, corrects_aim: bool = True
) -> PokingClient:
    """Make the client of a simulated robot; a robot that carries the part moves slowly."""
    has_tool = robot.scene.tool is not None
    # With a sensor on the tool, or without one, the force axis of a poke goes through the tip wherever the part is.
    settings = PokeSettings(frame=robot.scene.link, corrects_aim=corrects_aim and not has_tool)
    if robot.carries_part:
        settings = replace(
            settings,
            travel_speed=TRAVEL_SPEED_WITH_CARRIED_PART_M_PER_S,
            retreat_speed=TRAVEL_SPEED_WITH_CARRIED_PART_M_PER_S,
            arrive=ARRIVED_WITHIN_WITH_CARRIED_PART_M,
        )
    if not robot.scene.has_sensor:
        settings = replace(settings, held_wait_s=HELD_WAIT_WITHOUT_SENSOR_S)
    client = PokingClient(robot, surface, answer, settings)
    if has_tool:
        client.locate_part, client.prepare_arm = robot.locate_part, robot.prepare_for
    return client
