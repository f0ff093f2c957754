"""The choice of a simulated robot for a scene."""

from __future__ import annotations

from skincal.mesh.surface import Surface
from skincal.model.scene import Scene
from skincal.physics.effects import Effects
from skincal.physics.layouts import moving_part, poking_arm
from skincal.physics.rig import SimulatedRobot


def make_robot(scene: Scene, surface: Surface, effects: Effects, seed: int) -> SimulatedRobot:
    """Make the rig that fits the scene: a cobot with `[tool]`, a moving part with a URDF, else an arm that pokes the part.

    Raises InputError: MuJoCo is missing, or the scene does not say where its taxels or its sensor are.
    """
    if scene.tool is not None:
        from skincal.physics.tool_robot import ToolRobot  # other scenes do without

        return ToolRobot(scene, surface, effects, seed)
    layout = poking_arm(scene, surface) if scene.robot is None else moving_part(scene, surface)
    return SimulatedRobot(scene, surface, layout, effects, seed)
