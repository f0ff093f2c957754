"""Names of the columns of a pose: what they state on the order of its numbers and on their units.

A scene states the form of the numbers, too. Where both do and differ, one is wrong, and the poses would be plausible: lengths
in mm read as m, degrees as radians, a rotation read as the place. The names may also show that the columns are no pose: the
places of two markers have six numbers, too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.pose_form import POSE_WIDTHS, QUATERNION_FORMS, PoseForm, RotationForm

_UNIT_WORDS = "mm|cm|um|\u00b5m|m|inch(?:es)?|in|degrees?|deg|\u00b0|radians?|rad"
POSE_UNIT = rf"(?:[ _]*[\[(]?(?:{_UNIT_WORDS})[\])]?)?"
"""Pattern of a unit behind a name, or nothing."""
QUATERNION_LETTERS = "wxyz"
POSE_WITH_QUATERNION_VALUES = 7
POSE_WITH_MATRIX_VALUES_MIN = 12
_SHORT_UNITS = (("d", "deg"), ("\u00b0", "deg"), ("r", "rad"), ("in", "in"))
_UNIT_RE = re.compile(rf".*?(?:[xyzw]|[^a-z])[ _]*[\[(]?({_UNIT_WORDS})[\])]?")
_UNIT_END_RE = re.compile(rf"(?<=[xyzw]|[^a-z])[ _]*[\[(]?(?:{_UNIT_WORDS})[\])]?$")
_WORD_RE = re.compile("[a-z0-9]+")
_PLACE_WORDS = frozenset(["p", "t", "pos", "position", "trans", "translation", "loc", "location", "coord", "pose", "xyz"])
_ROTATION_WORDS = frozenset(
    (
        *("r", "w", "o", "q", "quat", "quaternion", "rot", "rotation", "rv", "rotvec", "rvec", "orientation", "orient", "ori"),
        *("axis", "axisangle", "aa", "angle", "angles", "ang", "theta", "euler", "eul", "rpy", "att", "attitude"),
        *("roll", "pitch", "yaw"),
    )
)
_AXIS_OF_ANGLE = {"roll": "x", "pitch": "y", "yaw": "z"}
_ORDER_OF_FORM = {
    RotationForm.ROTATION_VECTOR: "xyz",
    RotationForm.RPY: "xyz",
    RotationForm.MOVING_XYZ: "xyz",
    RotationForm.ABC: "zyx",
}
"""Axes of the three numbers of a rotation, where each has its own."""
_QUATERNION_WORDS = frozenset(["q", "quat", "quaternion"])
_KIND_SUFFIX_RE = re.compile("(.+?)(pos|position|translation|rot|rotation|rotvec|orientation|quat|quaternion|euler|angles?)")
"""A word that ends with the kind of its number, as `handrot`."""
_OWN_AXIS_RE = re.compile(rf"({'|'.join(sorted(_PLACE_WORDS | _ROTATION_WORDS))}|)([xyzw])(\d*)")
"""A word that is an axis, such as `x`, `rx`, `quatw` or `x1`."""
_QUATERNION_NUMBER_RE = re.compile("q[0-9]")
_ENDING_AXIS_RE = re.compile(r"(.*?)([xyzw])(\d*)")
_AXES_OF_MATRIX = tuple(map(frozenset, ("noa", "nsa", "xyz", "uvw", "ijk")))
"""Last letters of the columns of a rotation matrix."""
_MATRIX_ROW_RE = re.compile("(?:r|row|c|col)[0-3]")

Clash: TypeAlias = tuple[str, str, str]
"""What the names state, in words; the key of `[tool]` that states something else, and its value."""


class PoseMistake(Enum):
    """Reason why the names of columns are those of no pose: the finding, the expectation, and the remedy."""

    ROTATION_FIRST = "the rotation before the place", "x y z, then the rotation", "order the columns so"
    PLACE_NOT_FIRST = "in another order", "x y z, then the rotation", "order the columns so"
    SEVERAL_PLACES = (
        "the places of several things",
        "the place x y z and the rotation of one tool",
        "choose the columns of one, and name a rotation rx ry rz",
    )
    SEVERAL_THINGS = (
        "the place of one thing and the rotation of another",
        "place and rotation of one tool",
        "choose the columns of one, or name both alike",
    )
    QUATERNION_ON_EITHER_SIDE = (
        "a quaternion x y z w and then a place, or a place and then a quaternion w x y z",
        "names that tell them apart, such as x y z qx qy qz qw",
        "rename the columns",
    )
    QUATERNION_WITHOUT_W = (
        "a quaternion without its w",
        "all four of its numbers, or a rotation vector rx ry rz",
        "add the column, or correct the names",
    )

    @property
    def finding(self) -> str:
        """Columns that the names show, in words."""
        return self.value[0]

    @property
    def advice(self) -> str:
        """Expectation and remedy, as the rest of a sentence."""
        _, expected, action = self.value
        return f"expected {expected}: {action}"


@dataclass(frozen=True, slots=True)
class _Column:
    """A column's name, taken apart."""

    letter: str
    """x, y, z or w; empty without one."""
    kinds: frozenset[str]
    """Words for a rotation."""
    thing: tuple[str, ...]
    """The other words, which name the thing that has the place or the rotation."""

    @classmethod
    def parse(cls, name: str) -> _Column:
        words = _WORD_RE.findall(_UNIT_END_RE.sub("", name))
        own = [(k, each) for k, word in enumerate(words) if (each := _OWN_AXIS_RE.fullmatch(word))]
        at, found = next((each for each in reversed(own) if each[1][2] != "w"), own[-1] if own else (-1, None))
        is_word = bool(words) and words[-1] in _ROTATION_WORDS  # such as yaw
        if found is None and words and not is_word and (found := _ENDING_AXIS_RE.fullmatch(words[-1])) is not None:
            at = len(words) - 1
        if found is not None:
            words[at : at + 1] = [word for word in (found[1], found[3]) if word]
        kinds, thing = set[str](), list[str]()
        for word in words:
            ended = _KIND_SUFFIX_RE.fullmatch(word)
            kind = re.sub("(?<=..)[0-9]+$", "", word)
            thing += [] if ended is None else [ended[1]]
            kind = kind if ended is None else ended[2]
            if kind in _ROTATION_WORDS or _QUATERNION_NUMBER_RE.fullmatch(kind):
                kinds.add(kind[0] if kind[-1].isdigit() else kind)
            elif ended is None and kind not in _PLACE_WORDS:
                thing.append(word)
        if found is None and words and words[-1] in ("a", "b", "c"):
            kinds.add(thing.pop())
        return cls("" if found is None else found[2], frozenset(kinds), tuple(thing))

    @property
    def is_rotation(self) -> bool:
        return bool(self.kinds) or self.letter == "w"


@dataclass(frozen=True, slots=True)
class PoseNames:
    """What the names of a pose's columns state; empty texts where they state nothing."""

    quaternion_order: str = ""
    """Such as `wxyz`."""
    length_unit: str = ""
    angle_unit: str = ""
    angle_order: str = ""
    """Axes of three angles, such as `zyx` for yaw, pitch and roll."""
    mistake: PoseMistake | None = None
    """Why the columns are no pose in any form; `None` if they may be one."""

    @classmethod
    def read(cls, names: Sequence[str]) -> PoseNames:
        """Read the names, in small letters, of the columns of one pose."""
        if len(names) not in POSE_WIDTHS:
            return cls()
        columns = [_Column.parse(name) for name in names]
        letters = axis_letters(names)
        if len(names) >= POSE_WITH_MATRIX_VALUES_MIN:
            return cls(mistake=PoseMistake.SEVERAL_PLACES if _are_markers(columns, letters) else None)
        mistake = _mistake_of(columns, letters)
        if mistake is not None:
            return cls(mistake=mistake)
        order = "".join(letters[3:])
        is_quaternion = letters[:3] == ["x", "y", "z"] and len(names) == POSE_WITH_QUATERNION_VALUES and all(letters)
        return cls(
            order if is_quaternion and "".join(sorted(order)) == QUATERNION_LETTERS else "",
            _unit_of(names[:3]),
            _unit_of(names[3:]),
            _angle_order(columns[3:]),
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
        expected = _ORDER_OF_FORM.get(form.rotation, "")
        if expected and self.angle_order and self.angle_order != expected:
            return f"the angles in the order {' '.join(self.angle_order)}", "rotation", form.rotation.value
        has_angles = form.rotation.has_angles or form.rotation is RotationForm.AXIS_ANGLE
        if has_angles and self.angle_unit and self.angle_unit != ("deg" if form.degrees else "rad"):
            return f"the angles in {self.angle_unit}", "degrees", "true" if form.degrees else "false"
        return None


NO_POSE_NAMES = PoseNames()
"""States nothing."""


def axis_letters(names: Sequence[str]) -> list[str]:
    """Return x, y, z or w that each of some columns names; empty texts without one, and for a numbered vector `x0 x1 x2`.

    `q0` next to `qx qy qz` is w: so NDI names a quaternion.
    """
    letters = [_Column.parse(name).letter for name in names]
    if len(letters) > 1 and len({*letters}) == 1:
        return [""] * len(letters)
    ends = [words[-1] if (words := _WORD_RE.findall(name)) else "" for name in names]
    return ["w" if end == "q0" and {"qx", "qy", "qz"} <= {*ends} else has for has, end in zip(letters, ends, strict=True)]


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


def _angle_order(rotation: Sequence[_Column]) -> str:
    """Return the axes of the angles about x, y and z in the order of their columns; empty if the names do not tell all."""
    order = "".join(
        next((axis for word, axis in _AXIS_OF_ANGLE.items() if word in each.kinds), each.letter if each.kinds else "")
        for each in rotation
    )
    return order if _are_axes(order) and len(rotation) == len(order) else ""


def _mistake_of(columns: Sequence[_Column], letters: Sequence[str]) -> PoseMistake | None:
    """Find why 6 or 7 columns are no pose."""
    place, rotation = columns[:3], columns[3:]
    if (
        all(each.is_rotation for each in place)
        and not any(each.is_rotation for each in columns[-3:])
        and _are_axes(letters[-3:])
    ):
        return PoseMistake.ROTATION_FIRST
    if "".join(letters) == "xyzwxyz" and not any(each.kinds for each in columns):
        return PoseMistake.QUATERNION_ON_EITHER_SIDE
    is_axis_angle = rotation[-1].is_rotation and not letters[-1]
    if "w" not in letters and not is_axis_angle and _count_places(columns, letters) > 1:
        return PoseMistake.SEVERAL_PLACES
    if all(letters[:3]) and letters[:3] != ["x", "y", "z"]:
        return PoseMistake.PLACE_NOT_FIRST
    is_rotation = "w" in letters or all(each.is_rotation for each in rotation)
    if not letters[0] or not is_rotation:
        return None
    if len(columns) < POSE_WITH_QUATERNION_VALUES and all(each.kinds & _QUATERNION_WORDS for each in rotation):
        return PoseMistake.QUATERNION_WITHOUT_W
    return None if _is_one_thing(place, rotation) else PoseMistake.SEVERAL_THINGS


def _are_axes(letters: Sequence[str]) -> bool:
    return sorted(letters) == ["x", "y", "z"]


def _count_places(columns: Sequence[_Column], letters: Sequence[str]) -> int:
    """Count the complete places x y z among columns that do not name a rotation."""
    return min(sum(has == axis and not each.kinds for each, has in zip(columns, letters, strict=True)) for axis in "xyz")


def _are_markers(columns: Sequence[_Column], letters: Sequence[str]) -> bool:
    """Check whether columns as wide as a pose with a matrix are the places of several things."""
    if any(each.kinds for each in columns) or _count_places(columns, letters) < len(columns) // 3 - 1:
        return False
    things = {each.thing[-1] for each in columns if each.thing}
    ends = {thing[-1] for thing in things}
    return not all(map(_MATRIX_ROW_RE.fullmatch, things)) and not any(
        axes <= ends and len(ends) <= len(axes) + 1 for axes in _AXES_OF_MATRIX
    )


def _is_one_thing(place: Sequence[_Column], rotation: Sequence[_Column]) -> bool:
    """Check whether place and rotation name the same thing, or one of them names none."""
    first, second = _common_words(place), _common_words(rotation)
    short = {word for each in rotation for word in each.kinds if len(word) == 1}
    is_vector = len(rotation) == len(place)
    if is_vector and len(first) == 1 and len(first[0]) == 1 and first[0].isalpha() and short and not second:
        return False  # such as l and r, the left and the right one, or the points p and q
    count = min(len(first), len(second))
    return first[:count] == second[:count]


def _common_words(columns: Sequence[_Column]) -> tuple[str, ...]:
    return tuple(word for word in columns[0].thing if all(word in each.thing for each in columns))
