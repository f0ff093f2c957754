"""Whether the streams of a session fit its force/torque sensor: on the tool, below the part, or none."""

from __future__ import annotations

from collections.abc import Mapping

from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.model.scene import Scene


def check_tool_streams(scene: Scene, addresses: Mapping[Stream, str | None]) -> None:
    """Refuse streams that do not fit the sensor of a scene: on the tool, below the part, or none.

    Raises InputError: the tool's poses are missing, or a stream is named that the scene has no use for.
    """
    named = {stream for stream, address in addresses.items() if address}
    if scene.has_sensor and Stream.WRENCH in addresses and Stream.WRENCH not in named:
        raise InputError(
            f"In {scene.name} pokes need the force/torque sensor; expected its link (field Force/torque sensor, or --wrench)."
        )
    if scene.tool is None:
        if Stream.TOOL in named:
            raise InputError(
                f"A link of the tool's poses is named, and {scene.name} has no [tool]; a scene has it if the sensor sits on "
                "the tool (docs/tool.md)."
            )
        return
    rig = "the sensor sits on the tool" if scene.tool.has_sensor else "there is no force/torque sensor"
    if Stream.TOOL not in named:
        raise InputError(f"In {scene.name} {rig}; expected the link of the tool's poses (field Tool, or --tool).")
    if Stream.WRENCH in named and not scene.tool.has_sensor:
        raise InputError(
            f"A link of the wrench is named, and in {scene.name} {rig}; leave it out (field Force/torque sensor, or --wrench)."
        )
    for stream, word in ((Stream.JOINTS, "joint angles"), (Stream.TIP, "the tip")):
        if stream in named:
            raise InputError(
                f"A link of {word} is named, and in {scene.name} {rig}: the poses of the tool say where it is; "
                f"leave out --{stream.value}."
            )
