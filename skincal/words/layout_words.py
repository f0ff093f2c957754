"""Sentences on the layout of the skin: modules that do not lie as planned, and known distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.model.errors import plural
from skincal.modules.health import LayoutMend, Misfit, MisfitKind, ModuleChange, Unmended, UnmendedKind

if TYPE_CHECKING:
    from skincal.modules.distances import TriedDistance


MOST_NAMED = 4
"""Modules that one sentence names; of more the first."""


def misfit_sentence(misfit: Misfit) -> str:
    """Return what is wrong with a module, what would put it right, and how far its taxels lie off then and now."""
    turn = f"{np.degrees(misfit.turn):.0f}"
    too = f", and its angle_deg by {turn} degrees" if misfit.turn else ""
    what = {
        MisfitKind.MIRRORED: f"is mirrored against the layout: change its mirror{too}",
        MisfitKind.TURNED: f"is turned by {turn} degrees: change its angle_deg by that",
        MisfitKind.SWAPPED: f"lies where module {misfit.other} is planned: give that one its first_channel",
    }[misfit.kind]
    off = f"{misfit.after * 1e3:.0f} mm off, not {misfit.before * 1e3:.0f} mm"
    return f"Module {misfit.module} {what}. Its taxels then lie {off}."


def change_words(change: ModuleChange) -> str:
    """Return what a layout is to say of one module: `"module 17: angle_deg = -60, mirror = true"`."""
    values = ", ".join(f"{key} = {str(value).lower()}" for key, value in change.keys.items())
    return f"module {change.module}: {values}"


def left_sentences(mend: LayoutMend) -> list[str]:
    """Return what another layout cannot put right, and why, one sentence each."""
    return [_unmended_sentence(left) for left in mend.left]


def _unmended_sentence(left: Unmended) -> str:
    numbers = left.modules
    if left.kind is UnmendedKind.STILL_OFF:
        return f"Module {numbers[0]} lies {left.off * 1e3:.0f} mm off its place even so: poke the modules beside it."
    if left.kind is UnmendedKind.NO_RING:
        start, other = numbers
        return (
            f"Module {start} lies where module {other} is planned, but no exchange leads around to it: "
            f"poke modules {start} and {other} and those beside them, so that it is seen where each of them lies."
        )
    if left.kind is UnmendedKind.UNLIKE:
        return (
            f"Modules {_named(numbers)} lie in each other's places, but they are of different kinds: exchange what the "
            "layout says of their places by hand."
        )
    many = len(numbers) > 1
    return (
        f"Module{'s' if many else ''} {_named(numbers)} {'do' if many else 'does'} not lie as planned, but no change of the "
        f"layout lies nearer to {'their' if many else 'its'} taxels: poke {'them' if many else 'it'} more, and look at "
        f"{'them' if many else 'it'} on the part."
    )


def _named(numbers: Sequence[int]) -> str:
    named = [str(number) for number in numbers[:MOST_NAMED]]
    if len(numbers) > MOST_NAMED:
        return f"{', '.join(named)} and {len(numbers) - MOST_NAMED} more"
    return " and ".join(filter(None, (", ".join(named[:-1]), named[-1])))


def distance_sentences(tried: Sequence[TriedDistance]) -> list[str]:
    """Return how many known distances between modules are used, then of each other one why not; none where none is known."""
    if not tried:
        return []
    said = [f"{sum(each.used for each in tried)} of {plural(len(tried), 'known distance')} between modules used."]
    for each in (each for each in tried if not each.used):
        kind, (one, other) = "taxels" if each.told.of_taxels else "modules", each.told.ends
        found, told = "", f"{each.told.length * 1e3:.1f} mm"
        if each.found is not None and each.sd is not None:
            found = f" (pokes alone make it {each.found * 1e3:.1f} mm, and should lie within {2e3 * each.sd:.1f} mm of it)"
        said.append(f"The distance between {kind} {one} and {other}, {told}, is not used: {each.use.value}{found}.")
    return said
