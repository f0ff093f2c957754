"""A small part whose taxels measure three axes, for tests of the window."""

from __future__ import annotations

from dataclasses import replace

from skincal.model.skin_axes import ResponseRule, SkinAxes, ValueOrder
from tests.app.window_support import SCENE

AXES = SkinAxes(ValueOrder.BY_TAXEL, (1, 1, -1), (0, 1, 2), ResponseRule.PUSH, "N")
THREE_AXES_SCENE = replace(SCENE, skin=replace(SCENE.skin, axes=AXES))
