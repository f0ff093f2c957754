"""Names of the columns of a pose: what they state on the order of its numbers and on their units.

A scene states the form of the numbers, too. Where both do and differ, one is wrong, and the poses would be plausible: lengths
in mm read as m, degrees as radians, a rotation read as the place.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.pose_form import QUATERNION_FORMS, PoseForm, RotationForm

_UNIT_WORDS = "mm|cm|um|\u00b5m|m|inch(?:es)?|in|degrees?|deg|\u00b0|radians?|rad"
POSE_UNIT = rf"(?:[ _]*[\[(]?(?:{_UNIT_WORDS})[\])]?)?"
"""Pattern of a unit behind a name, or nothing."""
QUATERNION_LETTERS = "wxyz"
POSE_WITH_QUATERNION_VALUES = 7
POSE_WITH_MATRIX_VALUES_MIN = 12
_SHORT_UNITS = (("d", "deg"), ("\u00b0", "deg"), ("r", "rad"), ("in", "in"))
_AXIS_LETTER_RE = re.compile(rf".*?([xyzw]){POSE_UNIT}")
_UNIT_RE = re.compile(rf".*?(?:[xyzw]|[^a-z])[ _]*[\[(]?({_UNIT_WORDS})[\])]?")
_ROTATION_RE = re.compile(
    rf"(?:.*[./_ ])?(?:(?:q|quat|quaternion|rot|r|orientation|rotation)[._]?[xyzw]|roll|pitch|yaw|w|[abc]){POSE_UNIT}"
)

Clash: TypeAlias = tuple[str, str, str]
"""What the names state, in words; the key of `[tool]` that states something else, and its value."""


@dataclass(frozen=True, slots=True)
class PoseNames:
    """What the names of a pose's columns state; empty texts where they state nothing."""

    quaternion_order: str = ""
    """Such as `wxyz`."""
    length_unit: str = ""
    angle_unit: str = ""
    is_rotation_first: bool = False
    """Whether the rotation comes before x y z, which no form has."""

    @classmethod
    def read(cls, names: Sequence[str]) -> PoseNames:
        """Read the names, in small letters, of the columns of one pose."""
        letters = [axis_letter(name) for name in names]
        if len(names) >= POSE_WITH_MATRIX_VALUES_MIN or len(names) < POSE_WITH_QUATERNION_VALUES - 1:
            return cls()
        is_turn = [_ROTATION_RE.fullmatch(name) is not None for name in names]
        if all(is_turn[:3]) and not any(is_turn[-3:]) and letters[-3:] == ["x", "y", "z"]:
            return cls(is_rotation_first=True)
        order = "".join(letters[3:])
        is_quaternion = letters[:3] == ["x", "y", "z"] and len(names) == POSE_WITH_QUATERNION_VALUES and all(letters)
        return cls(
            order if is_quaternion and "".join(sorted(order)) == QUATERNION_LETTERS else "",
            _unit_of(names[:3]),
            _unit_of(names[3:]),
        )

    def clash(self, form: PoseForm | None, metres_per_unit: float) -> Clash | None:
        """Compare with the form of a scene; `None` if nothing differs.

        Parameters
        ----------
        form : `None` if it is not known
        metres_per_unit : of the lengths
        """
        unit = next((name for name, metres in METRES_PER_UNIT.items() if metres == metres_per_unit), "")
        if self.length_unit and self.length_unit != unit:
            return f"the lengths in {self.length_unit}", "unit", unit
        if form is None:
            return None
        if self.quaternion_order and form.rotation in QUATERNION_FORMS and form.rotation.value != self.quaternion_order:
            return f"the quaternion in the order {' '.join(self.quaternion_order)}", "rotation", form.rotation.value
        has_angles = form.rotation.has_angles or form.rotation is RotationForm.AXIS_ANGLE
        if has_angles and self.angle_unit and self.angle_unit != ("deg" if form.degrees else "rad"):
            return f"the angles in {self.angle_unit}", "degrees", "true" if form.degrees else "false"
        return None


NO_POSE_NAMES = PoseNames()
"""States nothing."""


def axis_letter(name: str) -> str:
    """Return x, y, z or w with which a column's name ends, before its unit; empty without one."""
    found = _AXIS_LETTER_RE.fullmatch(name)
    return "" if found is None else found[1]


def clash_in_scene(clash: Clash, scene: str) -> str:
    """Return a clash with `[tool]` of a scene as the rest of a sentence, behind the place of the names."""
    seen, key, value = clash
    quoted = f'"{value}"' if key != "degrees" else value
    return f"{seen}, and {scene} has {key} = {quoted} in [tool]: correct the one that is wrong"


def _unit_of(names: Sequence[str]) -> str:
    """Return the unit of columns, as `mm`, `deg` and so on; several joined by `and`; empty without."""
    found = [_UNIT_RE.fullmatch(name) for name in names]
    units = [each[1] for each in found if each is not None]
    short = [next((short for begin, short in _SHORT_UNITS if unit.startswith(begin)), unit) for unit in units]
    return " and ".join(dict.fromkeys(short))
