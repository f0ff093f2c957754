"""Mistakes that a scene may have, and what each changes of the pokes; one list for two checks.

`frame_check` weighs them by the distance of force axes from landmarks, `setup_check` by the distance from the taxels that
answered. Both try the same readings of the sensor (`sensor_mistakes`); joints, layouts and channels show on the skin alone.
`skincal.words.mistake_words` names each mistake and its remedy. Why there are two weighings: docs/decisions/scene-mistakes.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import lru_cache
from itertools import permutations, product

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.pose_form import PoseForm
from skincal.rig.correction import Correction

STANDARD_GRAVITY = 9.80665
"""m/s^2: newtons in a kilogram-force."""
UNIT_FACTORS = ((1.0, 1.0), (1.0, 1e-3), (1.0, 1e-2), (1.0, STANDARD_GRAVITY), (STANDARD_GRAVITY, 1.0))
"""Factors of force and moment: none, moments in N mm, in N cm and in kgf m, forces in kgf."""


class MistakeKind(Enum):
    """Kinds of mistakes of a scene."""

    NONE = "none"
    """The scene is right."""
    AXES = "axes"
    """The sensor's axes, their signs, or all of them (the reaction)."""
    UNITS = "units"
    MOUNT = "mount"
    """The sensor sits elsewhere on the arm."""
    FLANGE = "flange"
    """The sensor is turned about one of its axes."""
    MESH_ORIGIN = "mesh origin"
    JOINTS_EXCHANGED = "joints exchanged"
    JOINT_UNIT = "joint unit"
    JOINT_SIGN = "joint sign"
    JOINT_ANGLE = "joint angle"
    """A joint that the scene fixes has another angle."""
    OTHER_ARM = "other arm"
    LAYOUT = "layout"
    """The whole layout is mirrored or turned."""
    MODULES = "modules"
    """Two modules are exchanged."""
    CHANNELS = "channels"
    """Channels are connected in another order: blocks, rows or columns exchanged."""
    WRENCH_FRAME = "wrench frame"
    """The frame of the wrench is not known; everything else may follow from that."""
    WRENCH_POINT = "wrench point"
    """The moments are about another point than the origin of the frame that the messages name."""
    WRENCH_LABEL = "wrench label"
    """The wrench is in the sensor's frame, and its messages name another one."""
    TOOL_INVERSE = "tool inverse"
    """The poses of a tool with the sensor are those of the base in the tool's frame."""
    TOOL_BASE = "tool base"
    """They are in a base that is turned by half a turn."""
    TOOL_FORM = "tool form"
    """Their rotation has another form."""
    TOOL_WRENCH = "tool wrench"
    """The wrench has the axes of the base."""
    TOOL_TIP = "tool tip"
    """The tip is elsewhere in the frame of the tool."""
    TOOL_AXES = "tool axes"
    """The poses have left-handed axes, or the positions other axes than the rotations."""
    TOOL_PART = "tool part"
    """The part lies elsewhere in the base of the tool's poses."""
    TOOL_POSE_OF_TIP = "tool pose of tip"
    """The poses are those of the tip, and the scene gives the tip again."""
    TOOL_OTHER_TIP = "tool other tip"
    """The tip lies elsewhere in the tool's frame; `names` are the three numbers of its shift, mm."""
    TOOL_MIRRORED = "tool mirrored"
    """Two axes of the positions are exchanged."""
    TOOL_PART_MOVED = "tool part moved"
    """The part moved once; `names` are the first poke after it, and the way, mm."""
    TOOL_SENSOR_TURNED = "tool sensor turned"
    """The sensor is turned on the flange; `motion` is its turn."""
    TOOL_UNEXPLAINED = "tool unexplained"
    """The pokes of a tool miss, and no known mistake explains it."""


@dataclass(frozen=True, slots=True, eq=False)
class Mistake:
    """A likely mistake of the scene, or none."""

    kind: MistakeKind
    miss: float = 0.0
    """m, median distance of the pokes from the taxels that answered, if it is put right; 0 if it was found at landmarks."""
    axes: FloatArray = field(default_factory=lambda: np.eye(3))
    """(3, 3) float, one entry of 1 or -1 in each row: right axes = axes @ reported ones, of force and moment."""
    force_scale: float = 1.0
    """Right forces over reported ones."""
    moment_scale: float = 1.0
    """Right moments over reported ones."""
    motion: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) float, metres: right link_from_sensor = reported @ motion."""
    names: tuple[str, ...] = ()
    """Joints, sensor and link of the other arm, ids of modules, channels and remedy, the wrench's frame and its right
    point, or the force that the scene names and its opposite."""
    form: PoseForm | None = None
    """Right form of the poses of a tool; `None` if the mistake is another one."""
    degrees: float = 0.0
    mirrored: bool = False
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) float, m, link frame: from where the mesh is to where it belongs; of `TOOL_TIP` of the tip, sensor frame."""

    @property
    def is_reaction(self) -> bool:
        """Whether the sensor reports the reaction in place of the action."""
        return self.kind is MistakeKind.AXES and bool((self.axes == -np.eye(3)).all())

    @property
    def correction(self) -> Correction:
        """The correction of every poke that puts a mistake of the sensor's frame right."""
        matrix = np.zeros((6, 6))
        matrix[:3, :3], matrix[3:, 3:] = self.force_scale * self.axes, self.moment_scale * self.axes
        return Correction(matrix, self.motion)


@lru_cache(maxsize=1)
def sensor_mistakes() -> tuple[Mistake, ...]:
    """List every order and sign of the sensor's axes in every unit; the first is the right one."""
    found: list[Mistake] = []
    for order, signs, units in product(permutations(range(3)), product((1.0, -1.0), repeat=3), UNIT_FACTORS):
        axes = np.array(signs)[:, None] * np.eye(3)[list(order)]
        is_same = np.array_equal(axes, np.eye(3))
        of_units = MistakeKind.NONE if units == (1.0, 1.0) else MistakeKind.UNITS
        kind = of_units if is_same else MistakeKind.AXES
        found.append(Mistake(kind, axes=axes, force_scale=units[0], moment_scale=units[1]))
    return tuple(found)
