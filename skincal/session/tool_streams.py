"""Whether the streams of a session fit where its force/torque sensor sits: on the tool, or below the part."""

from __future__ import annotations

from collections.abc import Mapping

from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.model.scene import Scene


def check_tool_streams(scene: Scene, addresses: Mapping[Stream, str | None]) -> None:
    """Refuse streams that do not fit where the sensor of a scene sits: on the tool, or below the part.

    Raises InputError: the tool's poses are missing, or a stream is named that the scene has no use for.
    """
    named = {stream for stream, address in addresses.items() if address}
    if scene.tool is None:
        if Stream.TOOL in named:
            raise InputError(
                f"A link of the tool's poses is named, and {scene.name} has no [tool]; a scene has it if the sensor sits on "
                "the tool (docs/tool.md)."
            )
        return
    if Stream.TOOL not in named:
        raise InputError(f"In {scene.name} the sensor sits on the tool; expected the link of the tool's poses: add --tool.")
    for stream, word in ((Stream.JOINTS, "joint angles"), (Stream.TIP, "the tip")):
        if stream in named:
            raise InputError(
                f"A link of {word} is named, and in {scene.name} the sensor sits on the tool, whose poses say where it is; "
                f"leave out --{stream.value}."
            )
