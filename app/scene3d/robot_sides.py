"""The words left, right and front at a robot whose links name its sides."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from app.scene3d.draft_state import ROBOT_STEPS, DraftPicture
from app.scene3d.mesh_actors import Label, Layer
from app.scene3d.scene_state import StaticScene
from skincal.geometry import FloatArray, inverse_pose
from skincal.part.draft_preview import PartPreview
from skincal.part.robot_shape import left_of_robot

SIDE_LABEL_OFFSET_OVER_HALF_SIZE = 1.08  # Distance of the words from the robot's middle, over half its size there
SIDE_LABEL_PRIORITY = 1.0
ROOT_UP_AXIS = np.array([0.0, 0.0, 1.0])


def side_axes(preview: PartPreview) -> FloatArray | None:
    """Return the robot's left, front and up in the frame of its root, (3, 3) float, rows, unit; `None` if unknown."""
    if preview.robot is None:
        return None
    back = inverse_pose(preview.link_poses[preview.robot.root])
    left = left_of_robot({link: back @ pose for link, pose in preview.link_poses.items()})
    return None if left is None else np.stack([left, np.cross(left, ROOT_UP_AXIS), ROOT_UP_AXIS])


class SidesLayer(Layer):
    """Three words around the robot."""

    name = "sides"

    def __init__(self, plotter: pv.BasePlotter, static: StaticScene) -> None:
        super().__init__(plotter, static)

    def show_picture(self, picture: DraftPicture, extent: FloatArray) -> None:
        """Write the words next to a robot with this extent, (n, 3) float, metres, in the part's link."""
        self.labels = ()
        preview = picture.preview
        axes = side_axes(preview)
        if axes is None or preview.robot is None or picture.step not in ROBOT_STEPS or not len(extent):
            return
        root = preview.link_poses[preview.robot.root]
        seen = (extent - root[:3, 3]) @ root[:3, :3] @ axes.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        labels: list[Label] = []
        for word, row, sign in (("left", 0, 1.0), ("right", 0, -1.0), ("front", 1, 1.0)):
            at = middle.copy()
            # The word for the front is at the feet, where it covers nothing.
            at[2] = low[2] if row else middle[2]
            at[row] += sign * SIDE_LABEL_OFFSET_OVER_HALF_SIZE * half[row]
            labels.append(Label(word, root[:3, :3] @ (axes.T @ at) + root[:3, 3], 0.0, SIDE_LABEL_PRIORITY))
        self.labels = labels
