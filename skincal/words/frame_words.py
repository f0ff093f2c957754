"""Sentences on the frame that messages name for the wrench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.model.wrench_frames import FrameKind, WrenchFrame
from skincal.rig.setup_check import distances_from_sensor, is_point_doubted
from skincal.words.units import count, millimetres

TCP_FRAME = "tool0_controller"
"""Frame of Universal Robots' driver: the tool centre point that is set at the robot. No URDF has it."""
SHOWN_TURN_MIN_DEG, SHOWN_SHIFT_MIN_MM = 0.05, 0.05


def frame_words(readings: Mapping[str, int]) -> str:
    """Name the frames of a recorded wrench by their numbers of readings, to follow the name of its topic; empty for none."""
    named = {name: number for name, number in readings.items() if name}
    if len(readings) < 2:
        return "".join(f", in the frame {name}" for name in named)
    each = [f"{name or 'no named frame'} ({count(number, 'reading')})" for name, number in readings.items()]
    return f", in {len(readings)} frames: {', '.join(each)}"


def frame_sentences(frames: Sequence[WrenchFrame], contacts: Sequence[Contact] = ()) -> tuple[str, ...]:
    """Describe the frames of the wrench by the sensor's frame, and the conversion; empty if there is nothing to say.

    `contacts` show, if the frame is far from the sensor, about which of both points its moments are.
    """
    changes = _change_sentence(frames)
    return (*([changes] if changes else []), *(said for each in frames if (said := _frame_sentence(each, contacts))))


def _change_sentence(frames: Sequence[WrenchFrame]) -> str:
    if len(frames) < 2:
        return ""
    names = " and ".join(each.name for each in frames)
    both = all(each.kind in (FrameKind.SAME, FrameKind.RIGID) and not each.taken_as for each in frames)
    return (
        f"The wrench's messages name {len(frames)} frames, {names}: two programs publish on its topic, or its frame changed. "
        + (
            "Each reading is taken in its own frame."
            if both
            else f"Only readings in {frames[0].name} are used. Record the topic of one publisher."
        )
    )


def _frame_sentence(frame: WrenchFrame, contacts: Sequence[Contact]) -> str:
    if frame.taken_as:
        as_frame = "" if frame.taken_as == frame.name else f"; it is taken as {frame.taken_as}, as [wrench] of the scene says"
        return f"The wrench's messages name the frame {frame.name}{as_frame}." if as_frame and frame.name else ""
    match frame.kind:
        case FrameKind.RIGID:
            return _rigid_sentence(frame, contacts)
        case FrameKind.MOVING:
            joints = ", ".join(frame.joints)
            return (
                f"The wrench is in the frame {frame.name}, and {joints} may move between it and the sensor {frame.sensor}: "
                "positions are wrong if the readings are really in it. Publish them in a frame that is fixed to the sensor. "
                f"{_own_frame_advice(frame)}"
            )
        case FrameKind.UNKNOWN:
            return _unknown_sentence(frame)
        case FrameKind.SAME | FrameKind.UNCHECKED:
            return ""


def _rigid_sentence(frame: WrenchFrame, contacts: Sequence[Contact]) -> str:
    degrees, shift_mm = float(np.degrees(frame.turn)), frame.shift * 1e3
    moves = [f"turned by {degrees:.1f} degrees"] if degrees >= SHOWN_TURN_MIN_DEG else []
    moves += [f"moved by {shift_mm:.1f} mm"] if shift_mm >= SHOWN_SHIFT_MIN_MM else []
    said = (
        f"The wrench is in the frame {frame.name}; it is {' and '.join(moves) or 'converted'} into that of the sensor "
        f"{frame.sensor}, by {frame.robot}."
    )
    if frame.about:
        return f"{said} Its moments are taken about {frame.about}, as [wrench] of the scene says."
    if shift_mm < SHOWN_SHIFT_MIN_MM:
        return said
    doubt, other = f"if positions are off by about {shift_mm:.0f} mm", ""
    if is_point_doubted(contacts, frame):
        far, near = distances_from_sensor(contacts, frame)
        doubt = (
            f"by the rule the pokes pass the sensor at {millimetres(far, 0)} (median), with moments about the sensor at "
            f"{millimetres(near, 0)}. If that is right"
        )
        other = f'If they are about {frame.name}, write about = "{frame.name}"; a layout or landmarks show which. '
    return (
        f"{said} Its moments are taken about the origin of {frame.name}, the rule of ROS. Some programs turn the axes alone "
        f'(tf2 before ROS 2 Iron): {doubt}, write about = "{frame.sensor}" in [wrench] of the scene. '
        f"{other}{_own_frame_advice(frame)}"
    )


def _unknown_sentence(frame: WrenchFrame) -> str:
    if frame.name == TCP_FRAME:
        return (
            f"The wrench is in the frame {TCP_FRAME}, which is not in {frame.robot}: the tool centre point that is set at the "
            f"robot. It is taken for the frame of the sensor {frame.sensor}: positions are off by the distance between them. "
            f"Add a link {TCP_FRAME} at the tool centre point to the URDF, rigid to the sensor. {_own_frame_advice(frame)}"
        )
    return (
        f"The wrench is in the frame {frame.name}, which is not in {frame.robot}. It is taken for the frame of the sensor "
        f"{frame.sensor}: positions are wrong if it is another one. Then add a link {frame.name} to the URDF at its place. "
        f"{_own_frame_advice(frame)}"
    )


def _own_frame_advice(frame: WrenchFrame) -> str:
    return (
        f'If the readings are in the frame of the sensor under another name, write frame = "{frame.sensor}" in [wrench] of the '
        "scene."
    )
