"""Sentences on the layout of the skin: modules that do not lie as planned, and known distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.model.errors import plural
from skincal.model.skin import MODULE_KINDS, Layout, SkinKind
from skincal.modules.health import LayoutRepair, MisplacedModule, MisplacementKind, ModuleChange, Unrepaired, UnrepairedKind
from skincal.words.units import count, millimetres

if TYPE_CHECKING:
    from skincal.model.scene import SkinSpec
    from skincal.modules.distances import TriedDistance


SKIN_KIND_WORDS = {SkinKind.BOARD: "rigid boards", SkinKind.SHEET: "a soft sheet"}
"""The skin, in a sentence."""


def layout_size(layout: Layout) -> str:
    """Count modules and taxels of a layout: `"8 modules with 96 taxels"`, `"1 sheet with 48 taxels"`."""
    noun = "sheet" if layout.kind is SkinKind.SHEET else "module"
    return f"{plural(len(layout.modules), noun)} with {plural(len(layout.channels), 'taxel')}"


def unsaid_kind_finding(layout: Layout) -> str:
    """Report a layout that does not say what the skin is; empty if it does, or if its modules are the shipped triangles."""
    if layout.given_kind is not None or all(module.kind is MODULE_KINDS.get(module.kind.name) for module in layout.modules):
        return ""
    return (
        "the layout does not say what the skin is, so its modules are taken for rigid boards: for a soft sheet write "
        'kind = "sheet" at the top of the layout, else kind = "board"'
    )


SHEET_WITHOUT_MESH = (
    "no mesh: a soft sheet has the shape of its part, so each taxel is placed by its own pokes alone (free method). If the "
    'skin is a rigid board, say so (kind = "board" in the layout, or `scene new --kind board`); else name the part\'s mesh'
)


def frame_findings(skin: SkinSpec) -> list[str]:
    """Count the values of a frame of three axes, and report `channels` that counts these values in place of the taxels."""
    if skin.axes is None:
        return []
    unit = "in N" if skin.axes.unit == "N" else "raw values"
    found = [f"a skin frame has {skin.frame_width} values: x, y and z of {plural(skin.channels, 'taxel')}, {unit}"]
    taxels = 0 if skin.layout is None else len(skin.layout.channels)
    if skin.channels == len(skin.axes.places) * taxels:
        found.append(
            f"channels counts taxels, and the layout has {taxels}: if a frame of your skin has {skin.channels} values, "
            f"write channels = {taxels}"
        )
    return found


def kind_findings(layout: Layout, *, is_on_mesh: bool) -> list[str]:
    """List what is unusual about the kind of a skin: it is not given, or a soft sheet lacks a mesh."""
    return [*filter(None, [unsaid_kind_finding(layout)]), *sheet_findings(layout, is_on_mesh=is_on_mesh)]


def sheet_findings(layout: Layout | None, *, is_on_mesh: bool) -> list[str]:
    """Report a soft sheet without a mesh."""
    return [SHEET_WITHOUT_MESH] if layout is not None and layout.kind is SkinKind.SHEET and not is_on_mesh else []


MAX_NAMED_MODULES = 4
"""One sentence names at most the first four modules."""


def misfit_sentence(misfit: MisplacedModule) -> str:
    """Describe a misplaced module, the change to make, and the mean offset of its taxels before and after."""
    turn = f"{np.degrees(misfit.turn):.0f}"
    too = f", and its angle_deg by {turn} degrees" if misfit.turn else ""
    what = {
        MisplacementKind.MIRRORED: f"is mirrored: change its mirror in the layout{too}",
        MisplacementKind.TURNED: f"is turned: change its angle_deg in the layout by {turn} degrees",
        MisplacementKind.SWAPPED: f"is at the position of module {misfit.other}: give that module its first_channel",
    }[misfit.kind]
    off = f"{millimetres(misfit.after, 0)} from the layout instead of {millimetres(misfit.before, 0)}"
    return f"Module {misfit.module} {what}. With this corrected, its taxels are {off}."


def change_words(change: ModuleChange) -> str:
    """Format the changed keys of a module: `"module 17: angle_deg = -60, mirror = true"`."""
    values = ", ".join(f"{key} = {str(value).lower()}" for key, value in change.keys.items())
    return f"module {change.module}: {values}"


def left_sentences(mend: LayoutRepair) -> list[str]:
    """Name the modules that a changed layout does not explain, one sentence each."""
    return [_left_sentence(left) for left in mend.left]


def _left_sentence(left: Unrepaired) -> str:
    numbers = left.modules
    if left.kind is UnrepairedKind.STILL_OFF:
        return (
            f"Module {numbers[0]} is still {millimetres(left.off, 0)} from its planned position. Press the modules around it."
        )
    if left.kind is UnrepairedKind.NO_RING:
        start, other = numbers
        return (
            f"Module {start} is at the position of module {other}, but no exchange of modules explains that. "
            f"Press modules {start} and {other} and their neighbours more."
        )
    if left.kind is UnrepairedKind.UNLIKE:
        return (
            f"Modules {_named(numbers)} are exchanged, but their types differ. Exchange their positions in the layout by hand."
        )
    many = len(numbers) > 1
    return (
        f"Module{'s' if many else ''} {_named(numbers)} {'do' if many else 'does'} not match the layout, and no known change "
        f"of it helps. Press {'them' if many else 'it'} more, and look at {'them' if many else 'it'} on the part."
    )


def _named(numbers: Sequence[int]) -> str:
    named = [str(number) for number in numbers[:MAX_NAMED_MODULES]]
    if len(numbers) > MAX_NAMED_MODULES:
        return f"{', '.join(named)} and {len(numbers) - MAX_NAMED_MODULES} more"
    return " and ".join(filter(None, (", ".join(named[:-1]), named[-1])))


DISTANCE_USE_WORDS = {
    "USED": "used",
    "UNKNOWN": "one of its modules is not determined",
    "OFF": "pokes and other distances contradict it",
    "NO_BETTER": "it does not improve the prediction of test pokes",
}


def distance_sentences(tried: Sequence[TriedDistance]) -> list[str]:
    """Count the used known distances between modules, then say why each other one is not used; empty without any."""
    if not tried:
        return []
    said = [f"{sum(each.used for each in tried)} of {count(len(tried), 'known distance')} between modules used."]
    for each in (each for each in tried if not each.used):
        kind, (one, other) = "taxels" if each.distance.of_taxels else "modules", each.distance.ends
        found, told = "", millimetres(each.distance.length)
        if each.found is not None and each.sd is not None:
            found = f" (pokes give {millimetres(each.found)}, expected within {2e3 * each.sd:.1f} mm)"
        said.append(
            f"The distance between {kind} {one} and {other}, {told}, is not used: {DISTANCE_USE_WORDS[each.use.name]}{found}."
        )
    return said
