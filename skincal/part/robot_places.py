"""Taxel positions that a robot's URDF holds: frames of skin modules, such as `l_forearm_skin_3`, or of single taxels."""

from __future__ import annotations

import re

from skincal.files.reference import TaxelPositions
from skincal.geometry import FloatArray
from skincal.model.scene import Scene

_NUMBERED_SKIN_FRAME = re.compile(r"(.*(?:skin|tactile|module|triangle|taxel).*?)(\d+)", re.IGNORECASE)
MODULE_FRAMES_MIN = 2
"""Frames that number the modules: a single one may be the frame of the whole skin."""


def robot_places(scene: Scene) -> TaxelPositions | None:
    """Find the numbered skin frames of the URDF that are fixed to the part's link; `None` if there are none.

    A frame `..._taxel_N` is channel N. Another frame `..._N` is the centre taxel of module N: the directions of its axes differ
    between robots, so the module's other taxels are not placed. Of several series the one with the most taxels is used.
    """
    robot, layout = scene.robot, scene.skin.layout
    if robot is None:
        return None
    centres = {} if layout is None else {module.id: module.centre_channel for module in layout.modules}
    modules = {} if layout is None else {channel: number for number, channel in centres.items()}
    taxels = {channel: channel for channel in (range(scene.skin.channels) if layout is None else layout.channels.tolist())}
    series: dict[str, dict[int, FloatArray]] = {}
    joint = robot.urdf.sensor_named(robot.sensor, str(scene.path)).joint if robot.sensor else ""
    for name, pose in robot.urdf.fixed_frames(scene.link, joint).items():
        match = _NUMBERED_SKIN_FRAME.fullmatch(name)
        known = taxels if match is not None and "taxel" in match[1].lower() else centres
        if match is not None and (channel := known.get(int(match[2]))) is not None:
            series.setdefault(match[1], {})[channel] = pose[:3, 3]
    places = max(series.values(), key=len, default=dict[int, FloatArray]())
    if len(places) < MODULE_FRAMES_MIN:
        return None
    return TaxelPositions(f"{robot.urdf.path.name}, frames", scene.link, places, modules)
