"""Readings in ROS messages: stamp and values of a message, by the definition of its type.

    types = MessageTypes()
    streams_of(types, "geometry_msgs/msg/WrenchStamped")    # (Stream.WRENCH,): what its messages can be
    reader = MessageReader(types, "geometry_msgs/msg/WrenchStamped", Stream.WRENCH)
    message = types.decode(data, reader.type_name)          # or the JSON object of a rosbridge
    reader.stamp_of(message)                                # 1717.25, seconds of the sender's clock, or None
    reader.values_of(message)                               # array([fx, fy, fz, mx, my, mz]), N and N m

Angles of joints are given in degrees, as every decoder of this program takes them. Without a field path, the values are

    WrenchStamped, Wrench       force and torque
    JointState                  positions, by name; radians in the message
    std_msgs arrays             the data
    ChannelFloat32              the values
    TactileState                the values of all sensors, one after the other
    SensStream (XELA)           z of each taxel: forces if the sensors are calibrated, else raw values
    Image, PointCloud2          pixels by their encoding, a field of the points: see `shaped`
    PointCloud                  the values of the first channel
    Float32, FluidPressure, ... the number, one taxel of a skin on several topics
    another type                its first array of numbers, else all its numbers

A field path chooses others: `cdc`, `wrench.force`, `sensors[0].values`, `sensors.forces`. Without an index, a path goes through
every element of an array; a message at its end gives all its numbers.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.ros.shaped import IMAGE_TYPE, POINT_CLOUD_TYPE, elements_of_array, pixels_of, points_of
from skincal.ros.types import HEADER_TYPE, TIME_TYPES, XELA_PACKAGES, Field, MessageError, MessageTypes, full_type_name

FIELD_PATH_MAX_DEPTH = 12
"""Nested messages in a field path; a type that contains itself has no end."""
LAYOUT_TYPE = "std_msgs/msg/MultiArrayLayout"
JOINT_STATE = "sensor_msgs/msg/JointState"
INTERVALS_OF_JOINT_KEPT = 2
NAMES_LISTED_MAX = 8
"""Names that a sentence lists."""
JOINT_SILENT_MIN_S, JOINT_SILENT_MIN_INTERVALS = 0.2, 5.0
"""A joint whose last position is older than both, while those of other joints come, is silent: it may have moved."""
REPORT_JOINT_SILENT_AFTER_S = 1.0
"""s after which a silent joint is reported on a running robot."""
_XELA_RAW, _XELA_FORCES = "sensors.taxels.z", "sensors.forces.z"
_ANY_STREAM = (Stream.SKIN, Stream.WRENCH, Stream.JOINTS, Stream.TIP)
_SINGLE_TYPES = {
    **{
        f"std_msgs/msg/{kind}": "data"
        for kind in ("Float32", "Float64", *(f"{s}Int{n}" for s in ("", "U") for n in (8, 16, 32, 64)))
    },
    "sensor_msgs/msg/FluidPressure": "fluid_pressure",
    "sensor_msgs/msg/Range": "range",
    "sensor_msgs/msg/Temperature": "temperature",
}
"""Types with one number, and its field: topics of several taxels make a skin."""
_NAMED_TYPES = {IMAGE_TYPE: "data", POINT_CLOUD_TYPE: "", "sensor_msgs/msg/PointCloud": "channels[0].values", **_SINGLE_TYPES}
"""Types that are a skin if the operator or the number of channels says so: most are cameras and states of the robot."""
_KNOWN_TYPES: dict[str, tuple[tuple[Stream, ...], str]] = {
    "geometry_msgs/msg/WrenchStamped": ((Stream.WRENCH,), "wrench"),
    "geometry_msgs/msg/Wrench": ((Stream.WRENCH,), ""),
    "geometry_msgs/msg/PoseStamped": ((Stream.TIP,), "pose.position"),
    "geometry_msgs/msg/PointStamped": ((Stream.TIP,), "point"),
    JOINT_STATE: ((Stream.JOINTS,), "position"),
    "sensor_msgs/msg/ChannelFloat32": ((Stream.SKIN,), "values"),
    **{name: ((Stream.SKIN,), field) for name, field in _NAMED_TYPES.items()},
    "tactile_msgs/msg/TactileState": ((Stream.SKIN,), "sensors.values"),
    **{f"{package}/msg/SensStream": ((Stream.SKIN,), _XELA_RAW) for package in XELA_PACKAGES},
    **{
        f"std_msgs/msg/{kind}MultiArray": (_ANY_STREAM, "data")
        for kind in ("Float32", "Float64", "Byte", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
    },
}
"""Types that devices publish as: the streams that they can be, and the usual field."""
_STEP_RE = re.compile(r"([A-Za-z]\w*)((?:\[\d+\])*)")


@dataclass(frozen=True, slots=True)
class _Step:
    """A step of a field path: a field's name, or the number of an array's element."""

    name: str
    index: int = -1
    many: bool = False
    """The field is an array of messages, and the path goes through all of them."""


@dataclass(slots=True)
class _JointTimes:
    """Times of the positions of one joint, s."""

    last_s: float = math.inf
    """Of the newest one; infinite before the first."""
    intervals: tuple[float, ...] = ()
    """The newest, s."""

    def add(self, time_s: float) -> None:
        """Add a time; NaN if it is not known, which is no time of silence."""
        if not math.isnan(time_s) and time_s != self.last_s:
            step = (time_s - self.last_s,) if math.isfinite(self.last_s) else ()
            self.intervals = (*self.intervals, *step)[-INTERVALS_OF_JOINT_KEPT:]
            self.last_s = time_s

    @property
    def max_age_s(self) -> float:
        """Age from which the joint is silent, s. The shorter of two intervals counts: one of them may be a silence."""
        return max(JOINT_SILENT_MIN_S, JOINT_SILENT_MIN_INTERVALS * min(self.intervals, default=0.0))


@dataclass(slots=True)
class _Silence:
    """Count of the messages without a wanted joint that was silent."""

    since_s: float
    """Time of the last position before the first silence, s."""
    messages: int = 0


def streams_of(types: MessageTypes, type_name: str, field: str = "") -> tuple[Stream, ...]:
    """List the streams that messages of a type can be, the likeliest first; empty if it has no numbers or no definition.

    Standard types that no sensor or skin is published as count only with a field path.
    """
    name = full_type_name(type_name)
    if not field and name in _KNOWN_TYPES:
        return _KNOWN_TYPES[name][0]
    if not field and types.is_standard(name):
        return ()
    try:
        find_field(types, name, field)
    except (MessageError, InputError):
        return ()
    return _ANY_STREAM


def is_seldom_a_skin(type_name: str) -> bool:
    """Return whether a type can be a skin, but mostly is something else, such as a camera."""
    return full_type_name(type_name) in _NAMED_TYPES


def number_fields(types: MessageTypes, type_name: str) -> list[str]:
    """List the field paths of a type that have numbers; empty if it has no definition."""
    try:
        return [path for path, each in _walk(types, full_type_name(type_name)) if each.kind == "number"]
    except (MessageError, InputError):
        return []


def find_field(types: MessageTypes, type_name: str, field: str = "") -> str:
    """Return the field path that is read of a type: `field` itself, or the usual one; empty for all numbers.

    Raises
    ------
    InputError
        The path does not exist, leads to text, or the type has no numbers.
    MessageError
        The type, or a part of it, has no definition.
    """
    name = full_type_name(type_name)
    if not field and name in _KNOWN_TYPES:
        return _KNOWN_TYPES[name][1]
    if name == POINT_CLOUD_TYPE:
        return field
    if field:
        _plan(types, name, field)
        return field
    found = next((path for path, each in _walk(types, name) if each.kind == "number" and each.is_array), None)
    if found is None and not any(each.kind == "number" for _, each in _walk(types, name)):
        raise InputError(f"The type {name} has no numbers; choose a topic with readings.")
    return found or ""


class MessageReader:
    """Extracts the readings of one stream from the messages of one type.

    Parameters
    ----------
    field : path of the values; empty for the usual field
    joints : names of the joints in the wanted order, empty for one that is not used and counts as 0; without names all joints
        of the first message, in its order. For `JointState` only

    Raises InputError: the field does not exist or has no numbers, or the type has no definition.
    """

    def __init__(
        self, types: MessageTypes, type_name: str, stream: Stream, field: str = "", joints: Sequence[str] = ()
    ) -> None:
        self.type_name = full_type_name(type_name)
        self.stream = stream
        self.joints = tuple(joints)
        """Names of the joints, in the order of the values; empty before the first `JointState`, and for other types."""
        self.seen_joints: dict[str, float] = {}
        """Last position of each wanted joint that came, rad, and of a few others."""
        self._joint_times: dict[str, _JointTimes] = {}
        self._clock_offsets: dict[str, float] = {}
        """From the stamps of the publisher of a joint to those of the first one, s."""
        self._now_s = -math.inf
        """Time of the newest joint state."""
        self.silences: dict[str, _Silence] = {}
        """Wanted joints that were silent while others came."""
        self.by_name = self.type_name == JOINT_STATE and stream is Stream.JOINTS and field in ("", "position")
        """Joints are found by their names."""
        try:
            self.field = find_field(types, self.type_name, field)
            """Path of the values; empty for all numbers."""
            self._get = self._find_getter(types)
            self._forces = _getter(types, self.type_name, _XELA_FORCES) if self.field == _XELA_RAW and not field else None
            self._stamp = _stamp_path(types, self.type_name)
            self._header = _header_field(types, self.type_name)
        except MessageError as error:
            raise InputError(f"Messages of {self.type_name} cannot be read: {error}.") from None

    def _find_getter(self, types: MessageTypes) -> Callable[[Any], FloatArray]:
        self.has_layout = self.field == "data" and self.type_name.endswith("MultiArray")
        """Its data is laid out by its field `layout`."""
        self.is_shaped = self.type_name == POINT_CLOUD_TYPE or (self.type_name == IMAGE_TYPE and self.field == "data")
        """Its numbers are in bytes, as other fields say."""
        if self.is_shaped:
            field = self.field
            return pixels_of if self.type_name == IMAGE_TYPE else lambda message: points_of(message, field)
        end = _plan(types, self.type_name, self.field)[1]
        get = _getter(types, self.type_name, self.field)
        if types.ros == 2 and end.kind == "number" and end.type_name in ("byte", "octet"):
            # An octet of ROS 2 has no sign, but `rosbags` gives it one. A byte of ROS 1 has one. JSON has its numbers.
            return lambda message: get(message) if isinstance(message, dict) else np.mod(get(message), 256.0)
        return get

    def elements_of(self, message: Any, count: int) -> NDArray[np.intp] | None:
        """Return the indices of the readings among the `count` numbers of a message; `None` for all. Raises MessageError."""
        # Senders of JSON may leave out the layout.
        if not self.has_layout or (isinstance(message, dict) and "layout" not in message):
            return None
        return elements_of_array(member_of(message, "layout"), count)

    def stamp_of(self, message: Any) -> float | None:
        """Return the stamp that the sender wrote, seconds of its clock; `None` if there is none or it is 0."""
        try:
            stamp = self.find_stamp(message)
            if isinstance(stamp, float):
                seconds = stamp
            elif isinstance(stamp, dict):
                parts = cast("dict[str, Any]", stamp)
                seconds = float(parts.get("sec", parts.get("secs", 0))) + 1e-9 * parts.get("nanosec", parts.get("nsecs", 0))
            else:
                seconds = stamp.sec + 1e-9 * stamp.nanosec
        except (AttributeError, MessageError, TypeError, ValueError, LookupError, OverflowError):
            return None
        return seconds if seconds > 0 and math.isfinite(seconds) else None

    def find_stamp(self, message: Any) -> Any:
        """Return the field with the stamp; `None` if the type has none. Raises MessageError, AttributeError: it is missing."""
        if self._stamp is None:
            return None
        stamp = message
        for step in self._stamp:
            stamp = getattr(stamp, step.name) if step.index < 0 and type(stamp) is not dict else _step_into(stamp, step)
        return stamp

    def frame_of(self, message: Any) -> str:
        """Return the frame that a message's header names, empty for none. ROS 1 may begin it with a slash, which is removed."""
        if not self._header:
            return ""
        try:
            name = member_of(member_of(message, self._header), "frame_id")
        except MessageError:
            return ""
        return name.strip().removeprefix("/") if isinstance(name, str) else ""

    def values_of(self, message: Any, arrival_s: float = math.nan) -> FloatArray | None:
        """Return the values of a message, (n,) float: N and N m, raw values of the skin, or degrees.

        `None` if a `JointState` has none of the wanted joints, or one of them never came; see `missing_joints`. A joint that is
        silent is NaN; see `silent_joints`.

        Parameters
        ----------
        arrival_s : seconds of one clock for all messages, NaN if unknown. Publishers of joints may have several clocks

        Raises MessageError: the message has not the fields of its type.
        """
        try:
            return self._values_of(message, arrival_s)
        except MessageError:
            raise
        except (AttributeError, TypeError, ValueError, LookupError, OverflowError):
            raise MessageError("a field is of another kind than in the definition of its type") from None

    def _values_of(self, message: Any, arrival_s: float) -> FloatArray | None:
        if self.by_name:
            angles = self._angles(message, arrival_s)
            return None if angles is None else np.degrees(angles)
        if self._forces is not None:
            # Only calibrated sensors have forces. The first message decides, since the unit must stay the same.
            if len(self._forces(message)):
                self.field, self._get = _XELA_FORCES, self._forces
            self._forces = None
        values = self._get(message)
        elements = self.elements_of(message, len(values))
        values = values if elements is None else values[elements]
        return np.degrees(values) if self.stream is Stream.JOINTS else values

    def numbers_of(self, message: Any) -> FloatArray:
        """Return the numbers of a message as they are in it, (n,) float; of a `JointState` all positions.

        Raises MessageError: the message has not the fields of its type.
        """
        return _numbers(member_of(message, "position")) if self.by_name else self._get(message)

    def rows_of(self, numbers: FloatArray, names: Sequence[str], times_s: FloatArray) -> FloatArray:
        """Make the values of n messages, one after the other, from their (n, numbers), see `numbers_of`.

        Parameters
        ----------
        names : of the joints of a `JointState`, the same in all messages; `values_of` read one with them before
        times_s : (n,) float, arrival of the messages, as for `values_of`, or else their stamps
        """
        if self.by_name:
            columns = dict(zip(names, range(len(names)), strict=True))
            self._keep_joints(names, numbers[-1].tolist())
            rows = np.empty((len(numbers), len(self.joints)))
            for joint, name in enumerate(self.joints):
                if name in columns:
                    rows[:, joint] = numbers[:, columns[name]]
                    self._note_times(name, times_s)
                else:
                    rows[:, joint] = self._held_position(name, times_s)
            self._now_s = float(times_s[-1])
            return np.degrees(rows)
        return np.degrees(numbers) if self.stream is Stream.JOINTS else numbers

    @property
    def missing_joints(self) -> str:
        """Sentence on the wanted joints that never came; empty if all did."""
        missing = [name for name in self.joints if name and name not in self.seen_joints]
        if not self.by_name or not missing:
            return ""
        seen = ", ".join(list(self.seen_joints)[:NAMES_LISTED_MAX]) or "none"
        return f"No position of {', '.join(missing)} came; the messages have {seen}. Check the joint names of the scene."

    @property
    def silent_joints(self) -> str:
        """Sentence on the wanted joints that are silent while others come, or an empty string."""
        silent = [
            name
            for name, times in self._joint_times.items()
            if self._now_s - times.last_s > max(REPORT_JOINT_SILENT_AFTER_S, times.max_age_s)
        ]
        return (
            f"No position of {', '.join(silent)} comes any more, so the arm pose is unknown. Check its publisher."
            if silent
            else ""
        )

    def _joints_time(self, message: Any, names: Sequence[str]) -> float:
        """Return the time of a joint state by its stamp, s; NaN without one.

        The clocks of several publishers are set to one by the first message of each.
        """
        stamp = self.stamp_of(message)
        if stamp is None:
            return math.nan
        known = next((self._clock_offsets[name] for name in names if name in self._clock_offsets), None)
        offset = known if known is not None else self._now_s - stamp if math.isfinite(self._now_s) else 0.0
        for name in names[:NAMES_LISTED_MAX]:
            self._clock_offsets.setdefault(name, offset)
        return stamp + offset

    def _note_times(self, name: str, times_s: FloatArray) -> None:
        """Note the (n,) times of messages with a joint, s."""
        known = self._joint_times.setdefault(name, _JointTimes())
        for time_s in times_s[-INTERVALS_OF_JOINT_KEPT - 1 :].tolist():
            known.add(time_s)

    def _held_position(self, name: str, times_s: FloatArray) -> FloatArray:
        """Return the last position of a joint for messages without it, (n,) rad: NaN where it is silent, 0 without a name."""
        if not name:
            return np.zeros(len(times_s))
        known = self._joint_times.setdefault(name, _JointTimes())
        is_silent = times_s - known.last_s > known.max_age_s
        if is_silent.any():
            found = self.silences.setdefault(name, _Silence(known.last_s))
            found.messages += int(np.count_nonzero(is_silent))
        return np.where(is_silent, np.nan, self.seen_joints[name])

    def _keep_joints(self, names: Sequence[str], positions: Sequence[float]) -> None:
        for name, position in zip(names, positions, strict=True):
            if name in self.joints or name in self.seen_joints or len(self.seen_joints) < NAMES_LISTED_MAX:
                self.seen_joints[name] = position

    def _angles(self, message: Any, arrival_s: float) -> FloatArray | None:
        """Return the wanted positions, rad. Several nodes may publish parts of a robot: each joint's last position counts."""
        found, positions = list(member_of(message, "name")), _numbers(member_of(message, "position"))
        names = [name for name in found if isinstance(name, str)]
        if len(names) != len(positions):
            if not len(positions):
                return None  # velocities alone
            raise MessageError(f"a joint state has {len(names)} names and {len(positions)} positions")
        self.joints = self.joints or tuple(names)
        self._keep_joints(names, positions.tolist())
        wanted = [name for name in self.joints if name]
        times_s = np.array([self._joints_time(message, names) if math.isnan(arrival_s) else arrival_s])
        for name in wanted:
            if name in names:
                self._note_times(name, times_s)
        if not any(name in names for name in wanted) or any(name not in self.seen_joints for name in wanted):
            return None
        self._now_s = float(times_s[0])
        return np.array(
            [self.seen_joints[name] if name in names else self._held_position(name, times_s)[0] for name in self.joints]
        )


# ------------------------------------------------------------------ paths


def _plan(types: MessageTypes, type_name: str, path: str) -> tuple[list[_Step], Field]:
    """Read a field path of a type. Raises InputError: it does not exist, or leads to text."""
    steps: list[_Step] = []
    at = Field("", "message", type_name, is_array=False)
    for part in path.split(".") if path else []:
        found = _STEP_RE.fullmatch(part)
        fields = {each.name: each for each in types.fields_of(at.type_name)} if at.kind == "message" else {}
        if found is None or found[1] not in fields:
            known = ", ".join(fields) or "no fields"
            raise InputError(f"The field {path!r} of {type_name} does not exist: {part!r} is not among {known}.")
        at = fields[found[1]]
        indices = [int(each) for each in re.findall(r"\d+", found[2])]
        if len(indices) > (1 if at.is_array else 0) or len(steps) > FIELD_PATH_MAX_DEPTH:
            raise InputError(f"The field {path!r} of {type_name} does not exist: {found[1]!r} has no such element.")
        steps.append(_Step(at.name, many=at.is_array and at.kind == "message" and not indices))
        if indices:
            steps.append(_Step("", indices[0]))
            at = Field(at.name, at.kind, at.type_name, is_array=False)
    if at.kind == "text":
        raise InputError(f"The field {path!r} of {type_name} is text; expected numbers.")
    return steps, at


def _walk(types: MessageTypes, type_name: str, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Field]]:
    """Yield path and field of all numbers and texts of a type, outer fields first; headers, times and layouts are left out."""
    inner: list[Field] = []
    for each in types.fields_of(type_name):
        if each.kind != "message":
            yield f"{prefix}{each.name}", each
        elif each.type_name not in (*TIME_TYPES, HEADER_TYPE, LAYOUT_TYPE) and depth < FIELD_PATH_MAX_DEPTH:
            inner.append(each)
    for each in inner:
        yield from _walk(types, each.type_name, f"{prefix}{each.name}.", depth + 1)


def _getter(types: MessageTypes, type_name: str, path: str) -> Callable[[Any], FloatArray]:
    """Make a function that reads the numbers at a path, (n,) float. It raises MessageError."""
    steps, end = _plan(types, type_name, path)
    paths = [steps]
    if end.kind == "message":
        inner = [each for each, field in _walk(types, end.type_name) if field.kind == "number"]
        if not inner:
            raise InputError(f"The field {path!r} of {type_name} has no numbers.")
        tails = [_plan(types, end.type_name, each)[0] for each in inner]
        # Element by element, not field by field: x y z of a taxel stay together.
        if steps and steps[-1].many:
            return lambda message: _joined(
                part for element in _reach(message, steps) for tail in tails for part in _reach(element, tail)
            )
        paths = [[*steps, *tail] for tail in tails]
    if all(step.name and not step.many for each in paths for step in each):
        return _plain_getter([".".join(step.name for step in each) for each in paths])
    return lambda message: _joined(part for each in paths for part in _reach(message, each))


def _plain_getter(names: Sequence[str]) -> Callable[[Any], FloatArray]:
    """Make a getter of fields that are all there once, such as the six of a wrench: the usual case, ten times as fast."""
    read = attrgetter(*names)
    paths = [[_Step(step) for step in name.split(".")] for name in names]

    def get(message: Any) -> FloatArray:
        try:
            found = read(message)
            if len(names) == 1:
                return _numbers(found)
            # Six numbers are converted at once; arrays have other shapes.
            return np.array(found, np.float64) if type(found[0]) is float else _joined(iter(found))
        except (AttributeError, TypeError, ValueError):
            return _joined(part for each in paths for part in _reach(message, each))

    return get


def _reach(value: Any, steps: Sequence[_Step], at: int = 0) -> Iterator[Any]:
    """Yield the fields at the end of a path, one for each element that the path goes through."""
    while at < len(steps):
        step = steps[at]
        value = _step_into(value, step)
        at += 1
        if step.many:
            for element in value:
                yield from _reach(element, steps, at)
            return
    yield value


def _step_into(value: Any, step: _Step) -> Any:
    if step.index < 0:
        return member_of(value, step.name)
    value = _numbers(value) if isinstance(value, str) else value
    if step.index >= len(value):
        raise MessageError(f"an array has {len(value)} elements; the field path wants number {step.index}, counted from 0")
    return value[step.index]


def member_of(value: Any, name: str) -> Any:
    """Return a field of a message, which is an object or a JSON object. Raises MessageError: it is missing."""
    try:
        return cast("dict[str, Any]", value)[name] if isinstance(value, dict) else getattr(value, name)
    except (KeyError, AttributeError):
        # A field with the name of a Python keyword has an underscore.
        found = getattr(cast("Any", value), f"{name}_", None)
        if found is None:
            raise MessageError(f"the field {name} is missing") from None
        return found


def _joined(parts: Iterator[Any]) -> FloatArray:
    arrays = [_numbers(part) for part in parts]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays) if arrays else np.empty(0)


def _numbers(value: Any) -> FloatArray:
    """Convert a number or an array of a message to (n,) float. JSON has null for NaN, and bytes in base64."""
    try:
        if isinstance(value, str):
            return np.frombuffer(base64.b64decode(value, validate=True), np.uint8).astype(np.float64)
        numbers = np.atleast_1d(np.asarray(value, np.float64))
    except (TypeError, ValueError, OverflowError, binascii.Error):
        raise MessageError("a field has no numbers") from None
    if numbers.ndim != 1:
        raise MessageError(f"a field has an array of {numbers.ndim} dimensions; expected one")
    return numbers


def _header_field(types: MessageTypes, type_name: str) -> str:
    """Find the field with a type's header; empty for none."""
    fields = types.fields_of(type_name)
    return next((each.name for each in fields if each.type_name == HEADER_TYPE and not each.is_array), "")


def _stamp_path(types: MessageTypes, type_name: str) -> tuple[_Step, ...] | None:
    """Find the stamp in a type: that of its header, else its first time, else the time of XELA's first sensor."""
    fields = types.fields_of(type_name)
    header = next((each for each in fields if each.type_name == HEADER_TYPE and not each.is_array), None)
    time = next((each for each in fields if each.type_name == TIME_TYPES[0] and not each.is_array), None)
    if header is not None:
        return _Step(header.name), _Step("stamp")
    if time is not None:
        return (_Step(time.name),)
    return (_Step("sensors"), _Step("", 0), _Step("time")) if type_name.endswith("/SensStream") else None
