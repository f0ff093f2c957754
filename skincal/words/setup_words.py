"""Sentences of the setup check: how far pokes miss, the likely mistake of the scene, and its remedy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skincal.geometry import FloatArray
from skincal.rig.setup_check import Mistake, MistakeKind, SetupDiagnosis
from skincal.words.rig_words import axes_words, moment_unit_words
from skincal.words.units import millimetres

CORRECT_SENSOR = (
    "correct the sensor's pose in the scene or its origin in the URDF, or press three landmarks and use the correction that is "
    "then offered"
)


def setup_sentences(found: SetupDiagnosis | None) -> tuple[str, ...]:
    """Name the likely mistakes of a scene with their remedies; empty if there is no sign of one."""
    if found is None or not found.mistakes:
        return ()
    first, *others = found.mistakes
    if first.kind is MistakeKind.WRENCH_FRAME:
        return (
            f"{found.pokes} pokes miss the taxels that answer by {millimetres(first.miss, 0)} (median), and it is not known in "
            f"which frame the wrench is: its messages name {first.names[0]}. Settle that first, then other mistakes are looked "
            "for.",
        )
    what, remedy = mistake_words(first)
    misses = (
        ""
        if _is_reaction(first)
        else f" {found.pokes} pokes miss the taxels that answer by {millimetres(found.miss, 0)} (median), and with this change "
        f"by {millimetres(first.miss, 0)}."
    )
    return (
        f"The scene does not fit the pokes: {what}. To mend it, {remedy}.{misses}",
        *(f"Also possible: {what}. Then {remedy}." for what, remedy in map(mistake_words, others)),
    )


def _is_reaction(mistake: Mistake) -> bool:
    return mistake.kind is MistakeKind.AXES and np.array_equal(mistake.axes, -np.eye(3))


_MISTAKE_WORDS: Mapping[MistakeKind, tuple[str, str]] = {
    MistakeKind.FLANGE: ("the sensor is turned by about {degrees:.0f} degrees about its {names[0]} axis", CORRECT_SENSOR),
    MistakeKind.JOINTS_EXCHANGED: (
        "the columns of {names[0]} and {names[1]} are exchanged",
        "exchange them in joints of the scene",
    ),
    MistakeKind.JOINT_UNIT: ("the joint angles are in {names[0]}", "send degrees"),
    MistakeKind.JOINT_SIGN: ("joint {names[0]} turns the other way", "invert it in the joint stream, or its axis in the URDF"),
    MistakeKind.JOINT_ANGLE: (
        "joint {names[0]}, which the scene holds fixed, is at about {degrees:.0f} degrees",
        "correct it in [robot.fixed], or stream it: name it in joints",
    ),
    MistakeKind.OTHER_ARM: (
        "this is the arm on the other side, with the sensor {names[0]}",
        "use that sensor and the link {names[1]}",
    ),
    MistakeKind.MODULES: ("modules {names[0]} and {names[1]} are exchanged", "exchange their first_channel in the layout"),
    MistakeKind.CHANNELS: ("{names[0]}", "{names[1]}"),
    MistakeKind.WRENCH_POINT: (
        "the moments of the wrench are about {names[1]}, not about the origin of {names[0]}",
        'write about = "{names[1]}" in [wrench] of the scene',
    ),
    MistakeKind.WRENCH_LABEL: (
        "the wrench is in the frame of the sensor {names[1]}, though its messages name {names[0]}",
        'write frame = "{names[1]}" in [wrench] of the scene',
    ),
}
"""Mistake and remedy."""


def mistake_words(mistake: Mistake) -> tuple[str, str]:
    """Name a mistake, and its remedy as an order; neither has a full stop."""
    if _is_reaction(mistake):
        return "the sensor reports the reaction force, so pokes seem to push from inside", "change [wrench] sign in the scene"
    if mistake.kind in (MistakeKind.AXES, MistakeKind.UNITS):
        words = filter(None, (_turn_words(mistake.axes), moment_unit_words(mistake.scale)))
        remedy = CORRECT_SENSOR if mistake.kind is MistakeKind.AXES else "set the sensor's unit in its address or its program"
        return "; ".join(words), remedy
    if mistake.kind is MistakeKind.LAYOUT:
        return _layout_words(mistake)
    if mistake.kind is MistakeKind.MESH_ORIGIN:
        shift = ", ".join(f"{value * 1e3:.0f}" for value in mistake.shift)
        return (
            f"mesh and layout must move by ({shift}) mm along the link's axes",
            "correct the origin of the mesh, or the position of the sensor or of [skin.anchor]",
        )
    what, remedy = _MISTAKE_WORDS[mistake.kind]
    return what.format(names=mistake.names, degrees=mistake.degrees), remedy.format(names=mistake.names)


def _turn_words(axes: FloatArray) -> str:
    """Describe wrong axes: a turn about one of them, or their order and signs; empty for right ones."""
    fixed = [axis for axis in range(3) if axes[axis, axis] == 1.0]
    if np.linalg.det(axes) > 0 and len(fixed) == 1:
        first, second = (fixed[0] + 1) % 3, (fixed[0] + 2) % 3
        degrees = round(float(np.degrees(np.arctan2(axes[second, first], axes[first, first]))))
        return f"the sensor is turned by {180 if degrees == -180 else degrees} degrees about its {'xyz'[fixed[0]]} axis"
    words = axes_words(axes)
    return f"the sensor: {words}" if words else ""


def _layout_words(mistake: Mistake) -> tuple[str, str]:
    turned = f"turned by {mistake.degrees:.0f} degrees" if mistake.degrees else ""
    what = " and ".join(filter(None, ("mirrored" if mistake.mirrored else "", turned)))
    turn = f"turn x of [skin.anchor] by {mistake.degrees:.0f} degrees about its normal" if mistake.degrees else ""
    flip = "change mirror of every module, and the signs of its x of place_mm and its angle_deg" if mistake.mirrored else ""
    return f"the layout of the skin is {what}", ", and ".join(filter(None, (flip, turn)))
