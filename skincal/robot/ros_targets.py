"""Targets for a robot by ROS 2 topics, in place of lines over TCP; and the positions of the taxels for RViz.

`/skincal/target` (PoseStamped, latched) is the place of the poke; its z axis points in the direction of the push.
`/skincal/verdict` (String, latched) is JSON: the target's number, channel, force, hold and arm pose; verdicts; wait and stop.
`/skincal/reached` (String) is the robot's answer, a line as over TCP: `reached 7`, `skip 7 REASON`, `fault 7 TEXT`.
`/skincal/taxels` (MarkerArray, latched) has a sphere at each known taxel.
`/tf_static` (TFMessage, latched) has the frame `LINK_taxel_CHANNEL` of each taxel of three axes whose turn is known.

A robot pokes while the last message on `/skincal/verdict` has a target.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skincal.geometry import FloatArray, quaternion_of_rotation
from skincal.model.errors import InputError, plain_text
from skincal.robot.target_lines import (
    AskedLine,
    Held,
    Judged,
    NoTarget,
    PartPlace,
    PokeTarget,
    Refused,
    RobotLine,
    TipPose,
    read_answer_line,
)
from skincal.robot.target_server import (
    REPEAT_SAME_SENTENCE_AFTER_S,
    ROBOT_LINES_PER_S_MAX,
    SAME_SENTENCE_FIRST_CHARS,
    RobotChange,
)
from skincal.ros.dds import DdsError, Message, Participant, TopicWriter, default_domain, read_domain
from skincal.ros.types import MessageError
from skincal.streams.transports.target_tips import report_tip
from skincal.taxels.result import Estimate

ROS_TARGETS = "ros2:"
"""Begin of `--targets` for this way."""
POSE, STRING = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/String"
POINT, MARKERS = "geometry_msgs/msg/Point", "visualization_msgs/msg/MarkerArray"
TRANSFORM, TRANSFORMS = "geometry_msgs/msg/TransformStamped", "tf2_msgs/msg/TFMessage"
MARKER_TYPE_SPHERE_LIST = 7
"""`Marker.MARKER_TYPE_SPHERE_LIST`."""
MARKER_ACTION_DELETE_ALL = 3
"""`Marker.DELETEALL`."""
TAXEL_MARKER_DIAMETER_M = 0.004
TAXEL_COLOR = (0.1, 0.6, 0.3, 1.0)
"""Red, green, blue and opacity."""
ROBOT_ANSWER_MAX_CHARS = 512
DELIVER_STOP_MAX_S = 0.5
"""s for the robot to receive that the session is over."""


def parse_ros_targets(text: str) -> int:
    """Read the domain of `ros2:` or `ros2:?domain=N`. Raises InputError."""
    option = text.removeprefix(ROS_TARGETS)
    if not option:
        return default_domain()
    name, _, number = option.removeprefix("?").partition("=")
    if name != "domain" or not option.startswith("?"):
        raise InputError(f"{text!r} names no targets; expected ros2:, or ros2:?domain=N.")
    return read_domain(number, "The domain of the targets")


def quaternion_along(push: FloatArray) -> tuple[float, float, float, float]:
    """Return x, y, z, w of the shortest turn that brings z to the unit vector `push`, (3,) float."""
    px, py, pz = push.tolist()
    if pz < -1.0 + 1e-9:
        return 1.0, 0.0, 0.0, 0.0
    size = math.sqrt(2.0 * (1.0 + pz))
    return -py / size, px / size, 0.0, (1.0 + pz) / size


def line_as_json(line: AskedLine) -> dict[str, Any]:
    """Write a line as a JSON object; metres, newtons and seconds."""
    match line:
        case PokeTarget():
            return {
                "target": line.number,
                "channel": line.channel,
                "known_point": line.known,
                "frame": line.frame,
                "pose": line.pose,
                "place": line.place.tolist(),
                "push": line.push.tolist(),
                "force": line.force,
                "hold": line.hold,
            }
        case NoTarget():
            return {"state": line.value}
        case Held():
            return {"held": line.number}
        case Judged():
            verdict = "rejected" if line.reason else "accepted"
            return {"verdict": verdict, "number": line.number, "reason": line.reason}
        case Refused():
            return {"refused": line.reason}
        case PartPlace():
            return {"part": line.frame, "base_from_link": line.base_from_link.tolist()}


class RosTargets:
    """Publishes targets and reads a robot's answers, as `TargetServer` does over TCP. For one thread.

    Raises InputError: DDS is not installed, or refuses.
    """

    def __init__(self, domain: int) -> None:
        self._participant = Participant(domain)
        self._types = self._participant.types
        try:
            self._target = self._participant.writer("/skincal/target", POSE, latched=True)
            self._verdict = self._participant.writer("/skincal/verdict", STRING, latched=True)
            self._taxels = self._participant.writer("/skincal/taxels", MARKERS, latched=True)
            self._answers = self._participant.reader("/skincal/reached", STRING, reliable=True)
        except BaseException:
            self._participant.close()
            raise
        self.place = f"/skincal/target of ROS 2 domain {domain}"
        """For sentences."""
        self._has_robot = False
        self._said: list[str] = []
        self._reported_s: dict[str, float] = {}
        """By the beginning of a sentence: when it was last reported, host's monotonic clock, seconds."""
        self._answer_times_ns: deque[int] = deque(maxlen=ROBOT_LINES_PER_S_MAX)
        self._shown: Sequence[Estimate] = ()
        self._frames: TopicWriter | None = None
        """Of `/tf_static`; `None` before the first turn is known."""
        self._shown_frames: Mapping[int, FloatArray] = {}

    def send(self, lines: Sequence[AskedLine]) -> None:
        """Publish lines. `read_answers` reports if DDS refuses."""
        for line in lines:
            if isinstance(line, PokeTarget):
                self._write(self._target, self._pose_of(line))
            self._write(self._verdict, self._types.make(STRING, data=json.dumps(line_as_json(line))))

    def read_answers(self) -> list[RobotLine | RobotChange | str]:
        """Return the answers since the last call, and sentences on robots that connected or left."""
        found: list[RobotLine | RobotChange | str] = []
        has_robot = self._answers.publishers > 0
        if has_robot != self._has_robot:
            self._has_robot = has_robot
            found += (
                [RobotChange.CAME, "A robot connected by ROS 2."]
                if has_robot
                else [RobotChange.LEFT, "The robot disconnected from ROS 2."]
            )
        for message in self._take_messages():
            try:
                text = str(self._types.decode(message.data, STRING).data)
                answer = read_answer_line(text[:ROBOT_ANSWER_MAX_CHARS])
            except (InputError, MessageError) as error:
                self._report(f"A message on /skincal/reached is not used: {error}")
                continue
            if isinstance(answer, TipPose):
                report_tip(answer.place)
            if answer is not None:
                found.append(answer)
        found += self._said
        self._said.clear()
        return found

    def _take_messages(self) -> list[Message]:
        """Take the answers, as many in a second as over TCP."""
        try:
            messages = self._answers.take_messages()
        except DdsError as error:
            self._report(str(error))
            return []
        taken: list[Message] = []
        for message in messages:
            times = self._answer_times_ns
            # By the robot's clock: answers wait here while the program is busy.
            if len(times) == ROBOT_LINES_PER_S_MAX and message.source_ns - times[0] < 10**9:
                self._report(f"The robot sends more than {ROBOT_LINES_PER_S_MAX} lines in a second; those beyond are not used.")
                continue
            times.append(message.source_ns)
            taken.append(message)
        return taken

    def _write(self, writer: TopicWriter, message: Any) -> None:
        try:
            writer.write(message)
        except DdsError as error:
            self._report(str(error))

    def _report(self, sentence: str) -> None:
        kind, now_s = sentence[:SAME_SENTENCE_FIRST_CHARS], time.monotonic()
        if now_s - self._reported_s.get(kind, -REPEAT_SAME_SENTENCE_AFTER_S) >= REPEAT_SAME_SENTENCE_AFTER_S:
            self._reported_s[kind] = now_s
            self._said.append(plain_text(sentence))

    def refuse(self, reason: str) -> None:
        """Tell the robot that its answer is impossible."""
        self.send([Refused(reason)])
        self._said.append(plain_text(f"An answer on /skincal/reached is not used: {reason}"))

    def show_taxels(self, frame: str, estimates: Sequence[Estimate]) -> None:
        """Publish the positions of the taxels in the frame of the part, if they changed."""
        if estimates is self._shown:
            return
        self._shown = estimates
        places = [each.position for each in estimates if each.position is not None]
        self._write(self._taxels, self._types.make(MARKERS, markers=[self._marker(frame, places)]))

    def show_frames(self, link: str, frames: Mapping[int, FloatArray]) -> None:
        """Publish the frames of taxels, poses (4, 4) in the link by channel, metres, if they changed.

        tf2 keeps the last pose of a frame: one that is left out later stays with its listeners.
        """
        if not frames or (
            frames.keys() == self._shown_frames.keys()
            and all(np.array_equal(pose, self._shown_frames[channel]) for channel, pose in frames.items())
        ):
            return
        self._shown_frames = dict(frames)
        try:
            self._frames = self._frames or self._participant.writer("/tf_static", TRANSFORMS, latched=True)
        except DdsError as error:
            self._report(str(error))
            return
        transforms = [self._transform(link, channel, pose) for channel, pose in frames.items()]
        self._write(self._frames, self._types.make(TRANSFORMS, transforms=transforms))

    def _transform(self, link: str, channel: int, pose: FloatArray) -> Any:
        vector = "geometry_msgs/msg/Vector3"
        w, x, y, z = quaternion_of_rotation(pose[:3, :3]).tolist()
        return self._types.make(
            TRANSFORM,
            header=self._header(link),
            child_frame_id=f"{link}_taxel_{channel}",
            transform=self._types.make(
                "geometry_msgs/msg/Transform",
                translation=self._vector(vector, "xyz", pose[:3, 3].tolist()),
                rotation=self._vector("geometry_msgs/msg/Quaternion", "xyzw", (x, y, z, w)),
            ),
        )

    def close(self) -> None:
        """Withdraw the target, tell the robot to stop, and leave the graph."""
        self.send([NoTarget.WAIT, NoTarget.STOP])
        self._verdict.wait_for_readers(DELIVER_STOP_MAX_S)
        self._participant.close()

    def _header(self, frame: str) -> Any:
        seconds, rest_ns = divmod(time.time_ns(), 10**9)
        stamp = self._types.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest_ns)
        return self._types.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _vector(self, type_name: str, names: str, values: Sequence[float]) -> Any:
        return self._types.make(type_name, **dict(zip(names, values, strict=True)))

    def _pose(self, place: Sequence[float], quaternion: tuple[float, float, float, float]) -> Any:
        orientation = self._vector("geometry_msgs/msg/Quaternion", "xyzw", quaternion)
        return self._types.make("geometry_msgs/msg/Pose", position=self._vector(POINT, "xyz", place), orientation=orientation)

    def _pose_of(self, target: PokeTarget) -> Any:
        pose = self._pose(target.place.tolist(), quaternion_along(target.push))
        return self._types.make(POSE, header=self._header(target.frame), pose=pose)

    def _marker(self, frame: str, places: Sequence[FloatArray]) -> Any:
        return self._types.make(
            "visualization_msgs/msg/Marker",
            header=self._header(frame),
            ns="skincal",
            type=MARKER_TYPE_SPHERE_LIST,
            action=0 if places else MARKER_ACTION_DELETE_ALL,
            pose=self._pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
            scale=self._vector("geometry_msgs/msg/Vector3", "xyz", [TAXEL_MARKER_DIAMETER_M] * 3),
            color=self._vector("std_msgs/msg/ColorRGBA", "rgba", TAXEL_COLOR),
            frame_locked=True,
            points=[self._vector(POINT, "xyz", place.tolist()) for place in places],
        )
