"""Health of modules: whether they lie as the layout plans them, and the layout put right where they do not.

**Misfits.** Mirrored, turned and swapped modules follow from the estimates of single taxels, which know nothing of modules. A
module's estimates, seen along their mean normal, are fitted by its pads, as planned and mirrored, moved and turned freely;
that pose is compared with the plan's, less the rigid motion that most modules share. Modules are wrong by ten millimetres
where one of these mistakes was made, and by two where none was.

**Mending.** A mirrored or turned module gets its mirror and angle changed. A swapped one is right in all but whose channels it
has, so the place where it was found gets its channels; that takes modules that lie in each other's places all around. How a
module lies in another's place is seen only once it is planned there, so the corrected layout is judged again by the same
estimates, until nothing is left. A correction whose plan does not lie nearer to the estimates is none.

**Spacing**: how far neighbouring taxels lie apart over how far the layout plans it.

What it finds is an offer; nothing is changed by it. The sentences on it are made by `skincal.words`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.skin import Layout, Module
from skincal.modules.pose import ModuleModel, module_pads
from skincal.taxels.contact_table import orthonormal_pair
from skincal.taxels.differences import places_of
from skincal.taxels.result import Estimate

FEWEST = 5
"""Places of a module's taxels, `APART` from each other, below which nothing is said of it: taxels that answered to one poke
alone are all estimated where it was."""
APART = 1e-4
"""m: places that differ by less are one."""
MIRRORED = 0.6
"""The mirrored pads must fit this much better: the paper's modules fit to 2.1 mm straight and 10.4 mm mirrored."""
TURN_MIN = float(np.radians(30.0))
"""rad: a module that is turned by less against most others is laid badly, not mounted wrongly."""
TURN_ABOUT = float(np.radians(25.0))
"""rad: a turn that lays the module on its own outline is meant by turns that are seen this near to it."""
TURN_STEP, TURN_NEAR = float(np.radians(30.0)), float(np.radians(8.0))
"""rad: other mistakes are made in such steps, and are seen this near to them: a module's turn is seen to 3 degrees (sd)."""
TURNED = 0.6
"""The turned pads must fit this much better than the planned ones, moved alone: few estimates that lie close together fit any
turn."""
SWAP_SHARE = 0.3
"""A module lies where another one is planned when it is nearer to that place than this share of its way from its own."""
FAR = 0.008
"""m: modules farther than this from where the others put them count less for what all are moved by alike."""
ARM = 0.02
"""m: a module's normal counts as a point this far above it, so that a flat skin is not turned upside down."""
ROUNDS = 5
"""Of weighing the modules anew, for the motion that most of them share."""
ALIKE = 1e-3
"""m: corners of an outline that lie nearer than this are the same."""
NEIGHBOUR = 1.3
"""Taxels of one module within this many spacings are neighbours: 1.0 apart, the next ring is 1.7."""
MEND_ROUNDS = 3
"""Corrections one after another: that a swapped module is mirrored, too, is seen after the exchange; the third is spare."""


class MisplacementKind(Enum):
    """What is wrong with a module; the value says it in a word."""

    MIRRORED = "mirrored"
    TURNED = "turned"
    SWAPPED = "swapped"


@dataclass(frozen=True, slots=True, eq=False)
class MisplacedModule:
    """One module that does not lie as planned, and what would put it right."""

    module: int
    """Its id."""
    kind: MisplacementKind
    before: float
    """m, rms: how far its taxels lie from the plan, less what all modules are moved by alike."""
    after: float
    """m, rms: the same with the correction."""
    turn: float = 0.0
    """rad: what the layout's angle is to be changed by; of a mirrored one once its mirror is changed."""
    other: int | None = None
    """Id of the module in whose place it lies."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A module as its estimates show it."""

    places: FloatArray
    """(n, 3) float, metres, of `pads`."""
    planned: FloatArray
    """(n, 3) float, metres: where the plan puts them."""
    straight: float
    """m, rms from the pads as planned, moved and turned freely."""
    mirrored: float
    """m, rms from the mirrored pads, likewise."""
    turn: float
    """rad, of the better one against the plan."""
    normals: FloatArray
    """(2, 3) float, unit: of the plan, and of the estimates."""


def count_judged_modules(model: ModuleModel, estimates: Mapping[int, Estimate]) -> int:
    """Return of how many modules enough is known for `find_misplaced_modules` to judge them; parameters as there."""
    return sum(_known(model, index, estimates) is not None for index in range(len(model.pads)))


def find_misplaced_modules(model: ModuleModel, estimates: Mapping[int, Estimate]) -> tuple[MisplacedModule, ...]:
    """Return the modules that are mirrored, turned or swapped, in the layout's order.

    Parameters
    ----------
    estimates : of single taxels by channel, of the surface method where there is a surface
    """
    seen, motion = _all_seen(model, estimates)
    elsewhere = _in_place_of(model, seen, motion)
    usual = _usual([module.turn for index, module in seen.items() if index not in elsewhere])
    found = (_misfit(model, index, module, elsewhere.get(index), usual) for index, module in seen.items())
    return tuple(misfit for misfit in found if misfit is not None)


def miss_of(model: ModuleModel, estimates: Mapping[int, Estimate]) -> float:
    """Return how far taxels lie from the plan, less what most modules are moved by alike: rms, m; 0 where nothing is known."""
    seen, _ = _all_seen(model, estimates)
    return _rms(np.concatenate([module.places - module.planned for module in seen.values()])) if seen else 0.0


def _all_seen(model: ModuleModel, estimates: Mapping[int, Estimate]) -> tuple[dict[int, _Seen], FloatArray]:
    """Return the modules of which enough is known, their plans moved by what most are moved by, and that motion (4, 4)."""
    each = {index: _seen(model, index, estimates) for index in range(len(model.pads))}
    seen = {index: module for index, module in each.items() if module is not None}
    if not seen:
        return {}, np.eye(4)
    motion = _common(list(seen.values()))
    turn, shift = motion[:3, :3], motion[:3, 3]
    return {index: replace(module, planned=module.planned @ turn.T + shift) for index, module in seen.items()}, motion


def _usual(turns: Sequence[float]) -> float:
    """Return the turn that is nearest to all, the smallest of those equally near; 0 of none."""
    every = np.array(sorted(turns, key=abs), dtype=np.float64)
    apart = np.abs(np.angle(np.exp(1j * (every[:, None] - every)))).sum(axis=1)
    # To a billionth of a radian: which of two comes first must not hang on their last digit.
    return float(every[int(np.argmin(apart.round(9)))]) if len(every) else 0.0


def _common(seen: Sequence[_Seen]) -> FloatArray:
    """Return the rigid motion (4, 4) from plan to places that most modules share; of one or two modules a shift alone."""
    here = np.array([module.planned.mean(axis=0) for module in seen])
    there = np.array([module.places.mean(axis=0) for module in seen])
    up, outward = (ARM * np.array([module.normals[row] for module in seen]) for row in range(2))
    weights, motion = np.ones(len(here)), np.eye(4)
    motion[:3, 3] = np.median(there - here, axis=0)
    for _ in range(ROUNDS if len(here) > 2 else 0):
        off = there - here @ motion[:3, :3].T - motion[:3, 3]
        weights = 1.0 / (1.0 + np.sum(off * off, axis=1) / FAR**2)
        middle, centre = weights @ here / weights.sum(), weights @ there / weights.sum()
        weighed = weights[:, None]
        left, _, right = np.linalg.svd((weighed * (there - centre)).T @ (here - middle) + (weighed * outward).T @ up)
        turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        motion[:3, :3], motion[:3, 3] = turn, centre - turn @ middle
    return motion


def _known(model: ModuleModel, module: int, estimates: Mapping[int, Estimate]) -> dict[int, Estimate] | None:
    """Return the estimates of a module's pads that have a position and a normal; None where these or the plan do not say."""
    own = {row: estimates[channel] for row, channel in enumerate(model.channels_of([module])) if channel in estimates}
    known = {row: estimate for row, estimate in own.items() if estimate.position is not None and estimate.normal is not None}
    places = {tuple(np.round(estimate.position / APART)) for estimate in known.values() if estimate.position is not None}
    return None if len(places) < FEWEST or model.plan(module) is None else known


def _seen(model: ModuleModel, module: int, estimates: Mapping[int, Estimate]) -> _Seen | None:
    plan, planned = model.plan(module), model.planned(module)
    known = _known(model, module, estimates)
    if plan is None or planned is None or known is None:
        return None
    rows, points = list(known), np.array([estimate.position for estimate in known.values()], dtype=np.float64)
    normal: FloatArray = np.sum(np.array([estimate.normal for estimate in known.values()], dtype=np.float64), axis=0)
    normal = normal / np.sqrt(normal @ normal)
    pads = model.pads[module][rows]
    x = plan.x[0] - (plan.x[0] @ normal) * normal
    length = float(np.sqrt(x @ x))
    x = x / length if length > 0.1 else orthonormal_pair(normal[None])[0, 0]
    y = np.asarray(np.cross(normal, x), dtype=np.float64)
    flat = np.stack([points @ x, points @ y], axis=1)
    straight, turn = _fit(pads, flat)
    mirrored, other = _fit(pads * np.array([-1.0, 1.0]), flat)
    better = turn if straight <= mirrored else other
    return _Seen(points, planned[rows], straight, mirrored, better, np.array([plan.normals[0], normal]))


def _fit(pads: FloatArray, flat: FloatArray) -> tuple[float, float]:
    """Return how far places (n, 2) in the plane lie from pads moved and turned to them, rms, and the turn."""
    own, there = pads - pads.mean(axis=0), flat - flat.mean(axis=0)
    turn = float(np.arctan2(np.sum(own[:, 0] * there[:, 1] - own[:, 1] * there[:, 0]), np.sum(own * there)))
    c, s = np.cos(turn), np.sin(turn)
    return _rms(there - own @ np.array([[c, s], [-s, c]])), turn


def _rms(off: FloatArray) -> float:
    """Return the root mean square of the lengths of (n, d)."""
    return float(np.sqrt(np.sum(off * off) / len(off)))


def _misfit(
    model: ModuleModel, index: int, seen: _Seen, elsewhere: tuple[int, float] | None, usual: float
) -> MisplacedModule | None:
    """Return what is wrong with a module; the largest mistake first.

    Parameters
    ----------
    elsewhere : the module in whose place it lies and how far from it; None for its own place
    usual : the turn that most have
    """
    module = model.layout.modules[index]
    before = _rms(seen.places - seen.planned)
    if elsewhere is not None:
        other, way = elsewhere
        after = float(np.hypot(way, seen.straight))
        return MisplacedModule(module.id, MisplacementKind.SWAPPED, before, after, other=model.layout.modules[other].id)
    beside = _apart(seen.places.mean(axis=0), seen.planned.mean(axis=0))
    turn = float(np.angle(np.exp(1j * (seen.turn - usual))))
    if seen.mirrored < MIRRORED * seen.straight:
        turn = _meant(turn, module, mirrored=True)
        return MisplacedModule(module.id, MisplacementKind.MIRRORED, before, float(np.hypot(beside, seen.mirrored)), turn=turn)
    # Moved to the estimates, and not turned.
    unturned = _rms((seen.places - seen.places.mean(axis=0)) - (seen.planned - seen.planned.mean(axis=0)))
    if abs(turn) > TURN_MIN and seen.straight < TURNED * unturned:
        turn = _meant(turn, module, mirrored=False)
        return MisplacedModule(module.id, MisplacementKind.TURNED, before, float(np.hypot(beside, seen.straight)), turn=turn)
    return None


def _in_place_of(model: ModuleModel, seen: Mapping[int, _Seen], motion: FloatArray) -> dict[int, tuple[int, float]]:
    """Return the modules that lie in another's planned place: that one, and how far from it.

    Modules of which too little is known are looked at, too, but only where one lies so far off that it may be in their place:
    on a large skin their plans cost more than all else.
    """
    here = {index: module.places.mean(axis=0) for index, module in seen.items()}
    there = {index: module.planned.mean(axis=0) for index, module in seen.items()}
    far = any(_apart(here[index], there[index]) > _rms(module.planned - there[index]) for index, module in seen.items())
    if far:
        there |= {
            index: planned.mean(axis=0) @ motion[:3, :3].T + motion[:3, 3]
            for index in range(len(model.pads))
            if index not in seen and (planned := model.planned(index)) is not None
        }
    nearest = {index: _nearest(place, there) for index, place in here.items()} if far else {}
    astray = {index: place for index, place in nearest.items() if place[0] != index}
    found = {index: place for index, place in astray.items() if place[1] < SWAP_SHARE * _apart(here[index], there[index])}
    # A module with another in its place lies in the place of one that is astray, too, if less surely so.
    while more := [other for other, _ in found.values() if other in astray and other not in found]:
        found |= {index: _nearest(here[index], {k: there[k] for k in astray if k != index}) for index in more}
    return found


def _nearest(place: FloatArray, centres: Mapping[int, FloatArray]) -> tuple[int, float]:
    """Return which of some places is nearest to a place, and how far from it."""
    apart = np.sqrt(np.sum((np.array(list(centres.values())) - place) ** 2, axis=1))
    row = int(np.argmin(apart))
    return list(centres)[row], float(apart[row])


def _apart(place: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(place - other))


def _meant(turn: float, module: Module, *, mirrored: bool) -> float:
    """Return the turn that is meant by the one that is seen.

    That is a turn that lays the module, mirrored or not, on its own outline, else one in steps of `TURN_STEP`, else whole
    degrees. Of a mirrored module, a turn too small to be reported by itself counts as none.
    """
    outline = module.kind.outline @ np.array([-1.0 if module.mirror else 1.0, 1j])
    before = outline - outline.mean()
    after = -before.conj() if mirrored else before
    for angle in np.radians([0.0, 60.0, 90.0, 120.0, 180.0, -60.0, -90.0, -120.0]).tolist():
        gap = np.abs(after[:, None] * np.exp(1j * angle) - before[None]).min(axis=1).max()
        if gap < ALIKE and abs(np.angle(np.exp(1j * (angle - turn)))) < TURN_ABOUT:
            return float(angle)
    if abs(turn) < TURN_MIN:
        return 0.0
    step = TURN_STEP * round(turn / TURN_STEP)
    return step if abs(turn - step) < TURN_NEAR else float(np.radians(round(np.degrees(turn))))


class UnrepairedKind(Enum):
    """Why a change of the layout does not put modules right."""

    STILL_OFF = "off its place all the same"
    NO_RING = "in another's place, with no exchange that leads around"
    UNLIKE = "in each other's places, with other pads"
    NO_NEARER = "no change lies nearer to the taxels"


@dataclass(frozen=True, slots=True)
class Unrepaired:
    """Modules that cannot be put right, and why."""

    kind: UnrepairedKind
    modules: tuple[int, ...]
    """Their ids; for `NO_RING` the module and the one in whose place it lies."""
    off: float = 0.0
    """m, rms, `STILL_OFF`: how far the taxels would lie off with the correction."""


@dataclass(frozen=True, slots=True)
class ModuleChange:
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


@dataclass(frozen=True, slots=True, eq=False)
class LayoutRepair:
    """How a layout is put right."""

    misfits: tuple[MisplacedModule, ...]
    """What is wrong with it, by `find_misplaced_modules`."""
    layout: Layout
    """The corrected one; as it was where nothing can be put right."""
    changes: tuple[ModuleChange, ...]
    """Where it differs, in its order."""
    left: tuple[Unrepaired, ...]
    """What cannot be put right so."""


def repair_layout(model: ModuleModel, estimates: Mapping[int, Estimate]) -> LayoutRepair:
    """Return how the layout of a model is put right so that `find_misplaced_modules` finds nothing more.

    Parameters
    ----------
    model, estimates : as for `find_misplaced_modules`
    """
    given, first, left = model.layout, None, ()
    for more in reversed(range(MEND_ROUNDS + 1)):
        misfits = find_misplaced_modules(model, estimates)
        first = misfits if first is None else first
        layout, left = correct_layout(model.layout, misfits)
        if not changes_of(model.layout, layout):
            break
        mended = model.with_layout(layout)
        if not more or miss_of(mended, estimates) >= miss_of(model, estimates):
            left = (*left, Unrepaired(UnrepairedKind.NO_NEARER, tuple(misfit.module for misfit in misfits)))
            break
        model = mended
    return LayoutRepair(first or (), model.layout, changes_of(given, model.layout), left)


def correct_layout(layout: Layout, misfits: Sequence[MisplacedModule]) -> tuple[Layout, tuple[Unrepaired, ...]]:
    """Return a layout with its misfits put right, and those that cannot be; the same layout where none can.

    Parameters
    ----------
    misfits : of this layout
    """
    modules = {module.id: module for module in layout.modules}
    swapped = [misfit for misfit in misfits if misfit.kind is MisplacementKind.SWAPPED]
    channels, left = _exchanged(layout, swapped)
    # What lies in a place that another was found in is not understood, be it turned or mirrored there.
    unclear = {misfit.other for misfit in swapped} - channels.keys()
    for misfit in misfits:
        if misfit.kind is MisplacementKind.SWAPPED or misfit.module in unclear:
            continue
        if misfit.after > _radius(modules[misfit.module]):
            left.append(Unrepaired(UnrepairedKind.STILL_OFF, (misfit.module,), misfit.after))
        else:
            modules[misfit.module] = _turned(modules[misfit.module], misfit)
    changed = (replace(module, first_channel=channels.get(module.id, module.first_channel)) for module in modules.values())
    mended = Layout(tuple(changed), layout.width, layout.path, layout.text)
    return (mended if changes_of(layout, mended) else layout), tuple(left)


def changes_of(before: Layout, after: Layout) -> tuple[ModuleChange, ...]:
    """Return where a layout of the same modules differs, in its order."""
    found = [_change(module, other) for module, other in zip(before.modules, after.modules, strict=True)]
    return tuple(change for change in found if change.keys)


def _change(module: Module, other: Module) -> ModuleChange:
    return ModuleChange(
        module.id,
        None if other.angle == module.angle else other.angle,
        None if other.mirror == module.mirror else other.mirror,
        None if other.first_channel == module.first_channel else other.first_channel,
    )


def _turned(module: Module, misfit: MisplacedModule) -> Module:
    angle = module.angle
    if misfit.turn:
        angle = np.pi - (np.pi - angle - misfit.turn) % (2.0 * np.pi)
    return replace(module, angle=float(angle), mirror=module.mirror != (misfit.kind is MisplacementKind.MIRRORED))


def _radius(module: Module) -> float:
    """Return how far a module reaches from its middle, metres: one that lies farther from its place is not there."""
    outline = module.kind.outline - module.kind.outline.mean(axis=0)
    return float(np.sqrt(np.sum(outline * outline, axis=1)).max())


def _exchanged(layout: Layout, swapped: Sequence[MisplacedModule]) -> tuple[dict[int, int], list[Unrepaired]]:
    """Return which module gets which first channel, by ids, and what is left."""
    goes = {misfit.module: misfit.other for misfit in swapped if misfit.other is not None}
    modules = {module.id: module for module in layout.modules}
    channels: dict[int, int] = {}
    left: list[Unrepaired] = []
    for start in goes:
        ring = _ring(start, goes)
        if not ring:
            left.append(Unrepaired(UnrepairedKind.NO_RING, (start, goes[start])))
        elif _alike([modules[number] for number in ring]):
            channels[goes[start]] = modules[start].first_channel
        elif start == min(ring):
            left.append(Unrepaired(UnrepairedKind.UNLIKE, ring))
    return channels, left


def _ring(start: int, goes: Mapping[int, int]) -> tuple[int, ...]:
    """Return the modules from `start` on, each in the place of the next, around; empty where there is an end."""
    ring = [start]
    while (after := goes.get(ring[-1])) is not None and after not in ring:
        ring.append(after)
    return tuple(ring) if after == start else ()


def _alike(modules: Sequence[Module]) -> bool:
    """Return whether modules have the same pads, so that the channels of each fit the others."""
    first = modules[0].kind.pads
    return all(np.array_equal(first, module.kind.pads, equal_nan=True) for module in modules)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedNeighbours:
    """Pairs of taxels of one module that the layout plans next to each other."""

    pairs: IntArray
    """(n, 2) channels."""
    modules: IntArray
    """(n,) indices in the layout."""
    planned: FloatArray
    """(n,) float, metres: how far apart."""
    width: int
    """Channels of a skin frame."""
    count: int
    """Modules of the layout."""

    def ratios(self, channels: IntArray, places: FloatArray) -> FloatArray:
        """Return how far neighbours lie apart over how far the layout plans it, module by module.

        Least squares draws taxels together to where they are poked: below 1 shows it; scatter widens, above 1.

        Parameters
        ----------
        channels, places : (n,) int and (n, 3) float, metres; NaN where unknown

        Returns
        -------
        (modules + 1,) float, the last over all modules; NaN where no pair is known
        """
        found = np.full((self.width, 3), np.nan)
        found[channels] = places
        ways = found[self.pairs[:, 0]] - found[self.pairs[:, 1]]
        apart = np.sqrt(np.sum(ways * ways, axis=1))
        known = np.isfinite(apart)
        sums = [np.bincount(self.modules[known], weights=each[known], minlength=self.count) for each in (apart, self.planned)]
        apart, planned = (np.append(each, each.sum()) for each in sums)
        return np.divide(apart, planned, out=np.full(self.count + 1, np.nan), where=planned > 0.0)


def neighbours_of(layout: Layout) -> PlannedNeighbours:
    """Return which taxels the layout plans next to each other; once for a layout, since it looks at every pair of a module."""
    pairs, modules, planned = [np.empty((0, 2), dtype=np.int64)], [np.empty(0, dtype=np.int64)], [np.empty(0)]
    for index, module in enumerate(layout.modules):
        pads = module_pads(module)
        apart = np.sqrt(np.sum((pads[:, None] - pads[None]) ** 2, axis=2))
        first, second = np.nonzero(np.triu(apart <= NEIGHBOUR * layout.spacing, 1))
        pairs.append(module.channels[np.stack([first, second], axis=1)])
        modules.append(np.full(len(first), index, dtype=np.int64))
        planned.append(apart[first, second])
    ends = np.concatenate(pairs), np.concatenate(modules), np.concatenate(planned)
    return PlannedNeighbours(*ends, layout.width, len(layout.modules))


def spacing_ratio(layout: Layout, estimates: Sequence[Estimate]) -> float | None:
    """Return how far neighbours lie apart over how far the layout plans it, over all modules; None where no pair is known."""
    channels = np.array([estimate.channel for estimate in estimates], dtype=np.int64)
    ratio = float(neighbours_of(layout).ratios(channels, places_of(estimates))[-1])
    return ratio if ratio == ratio else None
