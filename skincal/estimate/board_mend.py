"""The layout put right: what `board_health` finds wrong with modules, as changes of the layout.

A mirrored or turned module gets its mirror and angle changed. A swapped one is right in all but whose channels it has, so the
place where it was found gets its channels; that takes modules that lie in each other's places all around. What a module looks
like in another's place is told only once it is planned there, so the corrected layout is judged again by the same estimates,
until nothing is left. A correction whose plan does not lie nearer to the estimates is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.estimate.board_health import Misfit, MisfitKind, find_misfits, miss_of
from skincal.estimate.boards import Boards
from skincal.estimate.result import Estimate
from skincal.skin import Layout, Module

ROUNDS = 3
"""Corrections one after another: that a swapped module is mirrored, too, is seen after the exchange; the third is spare."""
MOST_NAMED = 4
"""Modules of one sentence that are named; of more the first."""


@dataclass(frozen=True, slots=True)
class Change:
    """What the layout is to say of one module; None where it is right."""

    module: int
    """Its id."""
    angle: float | None = None
    """rad, in (-pi, pi]."""
    mirror: bool | None = None
    first_channel: int | None = None

    @property
    def keys(self) -> dict[str, float | bool | int]:
        """What is to stand in the layout's file, by its keys."""
        degrees = None if self.angle is None else round(float(np.degrees(self.angle)), 6)
        whole = int(degrees) if degrees is not None and degrees == int(degrees) else degrees
        given = {"first_channel": self.first_channel, "angle_deg": whole, "mirror": self.mirror}
        return {key: value for key, value in given.items() if value is not None}

    @property
    def words(self) -> str:
        """A line for the operator: `"module 17: angle_deg = -60, mirror = true"`."""
        said = ", ".join(f"{key} = {str(value).lower()}" for key, value in self.keys.items())
        return f"module {self.module}: {said}"


@dataclass(frozen=True, slots=True, eq=False)
class Mend:
    """How a layout is put right."""

    misfits: tuple[Misfit, ...]
    """What is wrong with it, as `find_misfits` says it."""
    layout: Layout
    """The corrected one; as it was where nothing can be put right."""
    changes: tuple[Change, ...]
    """What it says otherwise, in its order."""
    left: tuple[str, ...]
    """Sentences on what cannot be put right so, and why."""


def mend_boards(boards: Boards, estimates: Mapping[int, Estimate]) -> Mend:
    """Return how the layout of boards is put right so that `find_misfits` finds nothing more.

    Parameters
    ----------
    boards, estimates : as for `find_misfits`
    """
    given, first, left = boards.layout, None, ()
    for more in reversed(range(ROUNDS + 1)):
        misfits = find_misfits(boards, estimates)
        first = misfits if first is None else first
        layout, left = mend_layout(boards.layout, misfits)
        if not changes_of(boards.layout, layout):
            break
        mended = boards.replanned(layout)
        if not more or miss_of(mended, estimates) >= miss_of(boards, estimates):
            left = (*left, _no_nearer(misfits))
            break
        boards = mended
    return Mend(first or (), boards.layout, changes_of(given, boards.layout), left)


def mend_layout(layout: Layout, misfits: Sequence[Misfit]) -> tuple[Layout, tuple[str, ...]]:
    """Return a layout with its misfits put right, and sentences on those that cannot be; the same layout where none can.

    Parameters
    ----------
    misfits : of this layout
    """
    modules = {module.id: module for module in layout.modules}
    swapped = [one for one in misfits if one.kind is MisfitKind.SWAPPED]
    channels, left = _exchanged(layout, swapped)
    # What lies in a place that another was found in is not understood, be it turned or mirrored there.
    unclear = {one.other for one in swapped} - channels.keys()
    for one in misfits:
        if one.kind is MisfitKind.SWAPPED or one.module in unclear:
            continue
        if one.after > _radius(modules[one.module]):
            left = (
                *left,
                f"Module {one.module} lies {one.after * 1e3:.0f} mm off its place even so: poke the modules beside it.",
            )
        else:
            modules[one.module] = _turned(modules[one.module], one)
    changed = tuple(replace(one, first_channel=channels.get(one.id, one.first_channel)) for one in modules.values())
    mended = Layout(changed, layout.width, layout.path, layout.text)
    return (mended if changes_of(layout, mended) else layout), left


def changes_of(before: Layout, after: Layout) -> tuple[Change, ...]:
    """Return what a layout of the same modules says otherwise, in its order."""
    found = [_change(one, other) for one, other in zip(before.modules, after.modules, strict=True)]
    return tuple(one for one in found if one.keys)


def _change(one: Module, other: Module) -> Change:
    return Change(
        one.id,
        None if other.angle == one.angle else other.angle,
        None if other.mirror == one.mirror else other.mirror,
        None if other.first_channel == one.first_channel else other.first_channel,
    )


def _turned(module: Module, misfit: Misfit) -> Module:
    angle = module.angle
    if misfit.turn:
        angle = np.pi - (np.pi - angle - misfit.turn) % (2.0 * np.pi)
    return replace(module, angle=float(angle), mirror=module.mirror != (misfit.kind is MisfitKind.MIRRORED))


def _radius(module: Module) -> float:
    """Return how far a board reaches from its middle, metres: one that lies farther from its place is not there."""
    outline = module.kind.outline - module.kind.outline.mean(axis=0)
    return float(np.sqrt(np.sum(outline * outline, axis=1)).max())


def _exchanged(layout: Layout, swapped: Sequence[Misfit]) -> tuple[dict[int, int], tuple[str, ...]]:
    """Return which module gets which first channel, by ids, and sentences on what is left."""
    goes = {one.module: one.other for one in swapped if one.other is not None}
    modules = {module.id: module for module in layout.modules}
    channels: dict[int, int] = {}
    left: list[str] = []
    for start in goes:
        ring = _ring(start, goes)
        if not ring:
            left.append(
                f"Module {start} lies where module {goes[start]} is planned, but no exchange leads around to it: "
                f"poke modules {start} and {goes[start]} and those beside them, so that it is seen where each of them lies."
            )
        elif _alike([modules[number] for number in ring]):
            channels[goes[start]] = modules[start].first_channel
        elif start == min(ring):
            left.append(
                f"Modules {_named(ring)} lie in each other's places, but their kinds are different boards: exchange what the "
                "layout says of their places by hand."
            )
    return channels, tuple(left)


def _ring(start: int, goes: Mapping[int, int]) -> tuple[int, ...]:
    """Return the modules from `start` on, each in the place of the next, around; empty where there is an end."""
    ring = [start]
    while (after := goes.get(ring[-1])) is not None and after not in ring:
        ring.append(after)
    return tuple(ring) if after == start else ()


def _alike(modules: Sequence[Module]) -> bool:
    """Return whether boards have the same pads, so that one's channels fit the other."""
    first = modules[0].kind.pads
    return all(np.array_equal(first, one.kind.pads, equal_nan=True) for one in modules)


def _no_nearer(misfits: Sequence[Misfit]) -> str:
    numbers = [one.module for one in misfits]
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
