"""The tip of a tool whose poses are streamed, as the views draw it."""

from __future__ import annotations

import numpy as np

from app.state.view_state import ViewState
from skincal.geometry import FloatArray
from skincal.rig.tip_frame import TipState
from skincal.rig.tool_tip import ToolTip


def tip_in_sensor(state: ViewState) -> FloatArray | None:
    """Find the tip (3,) in the sensor's frame, metres: as the pokes show it, else as the scene gives it; `None` if unknown."""
    tool, found = state.scene.tool, state.snapshot.tip_frame
    if tool is None:
        return None
    if not tool.has_sensor:
        return np.zeros(3)
    if isinstance(found, ToolTip) and found.state is TipState.USED:
        return found.shift
    return tool.tip_in_sensor
