"""Health of modules: find modules that are not as planned, and correct the layout.

**Misplaced modules.** Mirrored, turned and swapped modules follow from the estimates of single taxels, which know nothing of
modules. A module's estimates, seen along their mean normal, are fitted by its pads, as planned and mirrored, moved and turned
freely. That pose is compared with the plan's, less the rigid motion that most modules share. One of these mistakes moves a
module by ten millimetres; without one it is off by two.

**Repair.** A mirrored or turned module gets its mirror and angle changed. Two or more modules that lie in each other's places
exchange their first channels. This needs a complete cycle. How a module lies in another's place is seen only once it is planned
there, so the corrected layout is judged again by the same estimates, until nothing is left. A correction is dropped if its plan
is not nearer to the estimates.

**Spacing**: distance of neighbouring taxels over the planned distance.

The results are offers; nothing is changed by them. The sentences are made by `skincal.words`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from skincal.geometry import FloatArray, IntArray, fit_rotation, tangent_axes
from skincal.model.skin import Layout, Module
from skincal.modules.pose import ModuleModel, module_pads
from skincal.taxels.differences import places_of
from skincal.taxels.result import Estimate

MIN_DISTINCT_TAXEL_POSITIONS = 5
"""Of a module's taxels: those that answered only one poke are all estimated in its place."""
SAME_POSITION_MAX_DISTANCE_M = 1e-4
MIRRORED_FIT_MAX_RESIDUAL_RATIO = 0.6
"""The mirrored pads must fit better by it: the paper's modules fit to 2.1 mm straight and 10.4 mm mirrored."""
MIN_TURN_RAD = float(np.radians(30.0))
"""A module turned by less against most others is placed badly, not mounted wrongly."""
SYMMETRY_TOLERANCE_RAD = float(np.radians(25.0))
"""A turn this near to a symmetry of the module's outline means that symmetry."""
TURN_STEP_RAD, TURN_STEP_TOLERANCE_RAD = float(np.radians(30.0)), float(np.radians(8.0))
"""Other mistakes are made in such steps, and are seen this near to them: a module's turn is seen to 3 degrees (sd)."""
TURNED_FIT_MAX_RESIDUAL_RATIO = 0.6
"""The turned pads must fit better by it than the planned ones, shifted: few estimates close together fit any turn."""
SWAP_MAX_DISTANCE_RATIO = 0.3
"""A module is in another one's place if it is nearer to that than this share of its distance from its own."""
ROBUST_RESIDUAL_SCALE_M = 0.008
"""Modules with a larger residual count less for the common motion."""
NORMAL_POINT_HEIGHT_M = 0.02
"""A module's normal counts as a point this far above it, so that a flat skin is not turned upside down."""
REWEIGHTING_STEPS = 5
SAME_CORNER_MAX_DISTANCE_M = 1e-3
"""Corners of an outline that are nearer are the same."""
NEIGHBOUR_MAX_SPACINGS = 1.3
"""Taxels of one module within this many spacings are neighbours; the next ring is at 1.7."""
MAX_LAYOUT_REPAIR_ROUNDS = 3
"""Corrections in turn: whether a swapped module is mirrored, too, is seen after the exchange; the third is spare."""


class MisplacementKind(Enum):
    """Mistake of a module; the value is a word for it."""

    MIRRORED = "mirrored"
    TURNED = "turned"
    SWAPPED = "swapped"


@dataclass(frozen=True, slots=True, eq=False)
class MisplacedModule:
    """A module that is not as planned, and its correction."""

    module: int
    """Its id."""
    kind: MisplacementKind
    before: float
    """m, rms distance of its taxels from the plan, without the common motion."""
    after: float
    """m, the same with the correction."""
    turn: float = 0.0
    """rad: change of the layout's angle; of a mirrored module after its mirror is changed."""
    other: int | None = None
    """Id of the module in whose place it is."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Pose of a module by its estimates."""

    places: FloatArray
    """(n, 3) float, metres, estimated."""
    planned: FloatArray
    """(n, 3) float, metres, of the same taxels."""
    straight: float
    """m, rms distance from the pads as planned, moved and turned freely."""
    mirrored: float
    """m, the same from the mirrored pads."""
    turn: float
    """rad, of the better fit, relative to the plan."""
    normals: FloatArray
    """(2, 3) float, unit: of the plan, and of the estimates."""


def count_judged_modules(model: ModuleModel, estimates: Mapping[int, Estimate]) -> int:
    """Count the modules that `find_misplaced_modules` can judge; parameters as there."""
    return sum(_known_pads(model, index, estimates) is not None for index in range(len(model.pads)))


def find_misplaced_modules(model: ModuleModel, estimates: Mapping[int, Estimate]) -> tuple[MisplacedModule, ...]:
    """Find the modules that are mirrored, turned or swapped, in the layout's order.

    Parameters
    ----------
    estimates : of single taxels by channel, by the surface method if there is a surface
    """
    seen, motion = _all_seen(model, estimates)
    elsewhere = _in_place_of(model, seen, motion)
    usual = _most_central_turn([module.turn for index, module in seen.items() if index not in elsewhere])
    found = (_misfit(model, index, module, elsewhere.get(index), usual) for index, module in seen.items())
    return tuple(misfit for misfit in found if misfit is not None)


def miss_of(model: ModuleModel, estimates: Mapping[int, Estimate]) -> float:
    """Compute the rms distance of taxels from the planned layout after the best rigid fit, m; 0 if no taxel is known."""
    seen, _ = _all_seen(model, estimates)
    return _rms(np.concatenate([module.places - module.planned for module in seen.values()])) if seen else 0.0


def _all_seen(model: ModuleModel, estimates: Mapping[int, Estimate]) -> tuple[dict[int, _Seen], FloatArray]:
    """Find the modules with enough estimates, their plans moved by the common motion, and that motion (4, 4)."""
    each = {index: _fit_known_module(model, index, estimates) for index in range(len(model.pads))}
    seen = {index: module for index, module in each.items() if module is not None}
    if not seen:
        return {}, np.eye(4)
    motion = _common(list(seen.values()))
    turn, shift = motion[:3, :3], motion[:3, 3]
    return {index: replace(module, planned=module.planned @ turn.T + shift) for index, module in seen.items()}, motion


def _most_central_turn(turns: Sequence[float]) -> float:
    """Find the turn with the smallest sum of differences from all, the smallest of equal ones; 0 of none."""
    every = np.array(sorted(turns, key=abs), dtype=np.float64)
    apart = np.abs(np.angle(np.exp(1j * (every[:, None] - every)))).sum(axis=1)
    # Rounded: the order of two must not depend on their last digit.
    return float(every[int(np.argmin(apart.round(9)))]) if len(every) else 0.0


def _common(seen: Sequence[_Seen]) -> FloatArray:
    """Fit the rigid motion (4, 4) from plan to estimates that most modules share; a shift for one or two modules."""
    here = np.array([module.planned.mean(axis=0) for module in seen])
    there = np.array([module.places.mean(axis=0) for module in seen])
    up, outward = (NORMAL_POINT_HEIGHT_M * np.array([module.normals[row] for module in seen]) for row in range(2))
    weights, motion = np.ones(len(here)), np.eye(4)
    motion[:3, 3] = np.median(there - here, axis=0)
    for _ in range(REWEIGHTING_STEPS if len(here) > 2 else 0):
        off = there - here @ motion[:3, :3].T - motion[:3, 3]
        weights = 1.0 / (1.0 + np.sum(off * off, axis=1) / ROBUST_RESIDUAL_SCALE_M**2)
        middle, centre = weights @ here / weights.sum(), weights @ there / weights.sum()
        weighed = weights[:, None]
        turn = fit_rotation((weighed * (there - centre)).T @ (here - middle) + (weighed * outward).T @ up)
        motion[:3, :3], motion[:3, 3] = turn, centre - turn @ middle
    return motion


def _known_pads(model: ModuleModel, module: int, estimates: Mapping[int, Estimate]) -> dict[int, Estimate] | None:
    """Find the estimates of a module's pads with a position and a normal; `None` if they are too few or there is no plan."""
    own = {row: estimates[channel] for row, channel in enumerate(model.channels_of([module])) if channel in estimates}
    known = {row: estimate for row, estimate in own.items() if estimate.position is not None and estimate.normal is not None}
    places = {
        tuple(np.round(estimate.position / SAME_POSITION_MAX_DISTANCE_M))
        for estimate in known.values()
        if estimate.position is not None
    }
    return None if len(places) < MIN_DISTINCT_TAXEL_POSITIONS or model.plan(module) is None else known


def _fit_known_module(model: ModuleModel, module: int, estimates: Mapping[int, Estimate]) -> _Seen | None:
    plan, planned = model.plan(module), model.planned(module)
    known = _known_pads(model, module, estimates)
    if plan is None or planned is None or known is None:
        return None
    rows, points = list(known), np.array([estimate.position for estimate in known.values()], dtype=np.float64)
    normal: FloatArray = np.sum(np.array([estimate.normal for estimate in known.values()], dtype=np.float64), axis=0)
    normal = normal / np.sqrt(normal @ normal)
    (straight, turn), (mirrored, other) = _fit_both(model.pads[module][rows], points, plan.x[0], normal)
    better = turn if straight <= mirrored else other
    return _Seen(points, planned[rows], straight, mirrored, better, np.array([plan.normals[0], normal]))


def fits_better_mirrored(pads: FloatArray, points: FloatArray, normal: FloatArray) -> bool:
    """Whether the mirrored pads of a module fit its taxels clearly better, seen from outside.

    Parameters
    ----------
    pads : (n, 2) float, metres, as planned
    points : (n, 3) float, metres: the same taxels as estimated
    normal : (3,) float, unit, outward
    """
    (straight, _), (mirrored, _) = _fit_both(pads, points, np.eye(3)[np.abs(normal).argmin()], normal)
    return mirrored < MIRRORED_FIT_MAX_RESIDUAL_RATIO * straight


def _fit_both(
    pads: FloatArray, points: FloatArray, x: FloatArray, normal: FloatArray
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Fit pads as planned and mirrored to points (n, 3), seen along the normal; each with its rms distance and its turn."""
    x, y = tangent_axes(x, normal, fallback=True)
    flat = np.stack([points @ x, points @ y], axis=1)
    return _fit(pads, flat), _fit(pads * np.array([-1.0, 1.0]), flat)


def _fit(pads: FloatArray, flat: FloatArray) -> tuple[float, float]:
    """Fit pads to positions (n, 2) by a shift and a turn; return the rms distance and the turn."""
    own, there = pads - pads.mean(axis=0), flat - flat.mean(axis=0)
    turn = float(np.arctan2(np.sum(own[:, 0] * there[:, 1] - own[:, 1] * there[:, 0]), np.sum(own * there)))
    c, s = np.cos(turn), np.sin(turn)
    return _rms(there - own @ np.array([[c, s], [-s, c]])), turn


def _rms(off: FloatArray) -> float:
    """Root mean square of the lengths of (n, d)."""
    return float(np.sqrt(np.sum(off * off) / len(off)))


def _misfit(
    model: ModuleModel, index: int, seen: _Seen, elsewhere: tuple[int, float] | None, usual: float
) -> MisplacedModule | None:
    """Find the mistake of a module, the largest one first.

    Parameters
    ----------
    elsewhere : the module in whose place it is, and the distance from it; None in its own place
    usual : turn of most modules
    """
    module = model.layout.modules[index]
    before = _rms(seen.places - seen.planned)
    if elsewhere is not None:
        other, way = elsewhere
        after = float(np.hypot(way, seen.straight))
        return MisplacedModule(module.id, MisplacementKind.SWAPPED, before, after, other=model.layout.modules[other].id)
    beside = _distance(seen.places.mean(axis=0), seen.planned.mean(axis=0))
    # Neither change is advised where it leaves the taxels farther off.
    mirrored, straight = (float(np.hypot(beside, own)) for own in (seen.mirrored, seen.straight))
    turn = float(np.angle(np.exp(1j * (seen.turn - usual))))
    if seen.mirrored < MIRRORED_FIT_MAX_RESIDUAL_RATIO * seen.straight and mirrored < before:
        turn = _intended_turn(turn, module, mirrored=True)
        return MisplacedModule(module.id, MisplacementKind.MIRRORED, before, mirrored, turn=turn)
    unturned = _rms((seen.places - seen.places.mean(axis=0)) - (seen.planned - seen.planned.mean(axis=0)))
    if abs(turn) > MIN_TURN_RAD and seen.straight < TURNED_FIT_MAX_RESIDUAL_RATIO * unturned and straight < before:
        turn = _intended_turn(turn, module, mirrored=False)
        return MisplacedModule(module.id, MisplacementKind.TURNED, before, straight, turn=turn)
    return None


def _in_place_of(model: ModuleModel, seen: Mapping[int, _Seen], motion: FloatArray) -> dict[int, tuple[int, float]]:
    """Find the modules in another one's planned place: that one, and the distance from it.

    The plans of modules without enough estimates are computed only if a module is so far off that it may be in their place: on
    a large skin they take most of the time.
    """
    here = {index: module.places.mean(axis=0) for index, module in seen.items()}
    there = {index: module.planned.mean(axis=0) for index, module in seen.items()}
    far = any(_distance(here[index], there[index]) > _rms(module.planned - there[index]) for index, module in seen.items())
    if far:
        there |= {
            index: planned.mean(axis=0) @ motion[:3, :3].T + motion[:3, 3]
            for index in range(len(model.pads))
            if index not in seen and (planned := model.planned(index)) is not None
        }
    nearest = {index: _nearest(place, there) for index, place in here.items()} if far else {}
    displaced = {index: place for index, place in nearest.items() if place[0] != index}
    found = {
        index: place
        for index, place in displaced.items()
        if place[1] < SWAP_MAX_DISTANCE_RATIO * _distance(here[index], there[index])
    }
    # A module with another in its place is in the place of one that is off, too, if less surely.
    while more := [other for other, _ in found.values() if other in displaced and other not in found]:
        found |= {index: _nearest(here[index], {k: there[k] for k in displaced if k != index}) for index in more}
    return found


def _nearest(place: FloatArray, centres: Mapping[int, FloatArray]) -> tuple[int, float]:
    """Find the nearest of the module centres to a place, and its distance."""
    apart = np.sqrt(np.sum((np.array(list(centres.values())) - place) ** 2, axis=1))
    row = int(np.argmin(apart))
    return list(centres)[row], float(apart[row])


def _distance(place: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(place - other))


def _intended_turn(turn: float, module: Module, *, mirrored: bool) -> float:
    """Guess the exact turn from the measured one.

    It is a symmetry of the module's outline, mirrored or not, else a multiple of `TURN_STEP_RAD`, else whole degrees. Of a
    mirrored module a small turn counts as none.
    """
    outline = module.kind.outline @ np.array([-1.0 if module.mirror else 1.0, 1j])
    before = outline - outline.mean()
    after = -before.conj() if mirrored else before
    for angle in np.radians([0.0, 60.0, 90.0, 120.0, 180.0, -60.0, -90.0, -120.0]).tolist():
        gap = np.abs(after[:, None] * np.exp(1j * angle) - before[None]).min(axis=1).max()
        if gap < SAME_CORNER_MAX_DISTANCE_M and abs(np.angle(np.exp(1j * (angle - turn)))) < SYMMETRY_TOLERANCE_RAD:
            return float(angle)
    if abs(turn) < MIN_TURN_RAD:
        return 0.0
    step = TURN_STEP_RAD * round(turn / TURN_STEP_RAD)
    return step if abs(turn - step) < TURN_STEP_TOLERANCE_RAD else float(np.radians(round(np.degrees(turn))))


class UnrepairedKind(Enum):
    """Reason why a change of the layout does not correct modules."""

    STILL_OFF = "off its place all the same"
    NO_RING = "in another's place, with no exchange that leads around"
    UNLIKE = "in each other's places, with other pads"
    NO_NEARER = "no change lies nearer to the taxels"


@dataclass(frozen=True, slots=True)
class Unrepaired:
    """Modules that cannot be corrected, and why."""

    kind: UnrepairedKind
    modules: tuple[int, ...]
    """Their ids; for `NO_RING` the module and the one in whose place it is."""
    off: float = 0.0
    """m, rms, `STILL_OFF`: distance of the taxels with the correction."""


@dataclass(frozen=True, slots=True)
class ModuleChange:
    """New values of one module in the layout; `None` for unchanged ones."""

    module: int
    """Its id."""
    angle: float | None = None
    """rad, in (-pi, pi]."""
    mirror: bool | None = None
    first_channel: int | None = None

    @property
    def keys(self) -> dict[str, float | bool | int]:
        """New values in the layout's file, by its keys."""
        degrees = None if self.angle is None else round(float(np.degrees(self.angle)), 6)
        whole = int(degrees) if degrees is not None and degrees == int(degrees) else degrees
        given = {"first_channel": self.first_channel, "angle_deg": whole, "mirror": self.mirror}
        return {key: value for key, value in given.items() if value is not None}


@dataclass(frozen=True, slots=True, eq=False)
class LayoutRepair:
    """Correction of a layout."""

    misfits: tuple[MisplacedModule, ...]
    """Result of `find_misplaced_modules`."""
    layout: Layout
    """Corrected; unchanged if nothing can be corrected."""
    changes: tuple[ModuleChange, ...]
    """In its order."""
    left: tuple[Unrepaired, ...]
    """Modules that cannot be corrected."""


def repair_layout(model: ModuleModel, estimates: Mapping[int, Estimate]) -> LayoutRepair:
    """Correct the layout of a model until `find_misplaced_modules` finds nothing more; parameters as there."""
    given, first, left = model.layout, None, ()
    for more in reversed(range(MAX_LAYOUT_REPAIR_ROUNDS + 1)):
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
    """Correct the misplaced modules of a layout; return it with those that cannot be corrected."""
    modules = {module.id: module for module in layout.modules}
    swapped = [misfit for misfit in misfits if misfit.kind is MisplacementKind.SWAPPED]
    channels, left = _exchanged(layout, swapped)
    # A module whose place holds another one is not understood, even if it looks turned or mirrored.
    unclear = {misfit.other for misfit in swapped} - channels.keys()
    for misfit in misfits:
        if misfit.kind is MisplacementKind.SWAPPED or misfit.module in unclear:
            continue
        if misfit.after > _radius(modules[misfit.module]):
            left.append(Unrepaired(UnrepairedKind.STILL_OFF, (misfit.module,), misfit.after))
        else:
            modules[misfit.module] = _turned(modules[misfit.module], misfit)
    changed = (replace(module, first_channel=channels.get(module.id, module.first_channel)) for module in modules.values())
    mended = layout.with_modules(tuple(changed))
    return (mended if changes_of(layout, mended) else layout), tuple(left)


def changes_of(before: Layout, after: Layout) -> tuple[ModuleChange, ...]:
    """List the differences of a layout of the same modules, in its order."""
    changes = list[ModuleChange]()
    for module, other in zip(before.modules, after.modules, strict=True):
        change = ModuleChange(
            module.id,
            None if other.angle == module.angle else other.angle,
            None if other.mirror == module.mirror else other.mirror,
            None if other.first_channel == module.first_channel else other.first_channel,
        )
        if change.keys:
            changes.append(change)
    return tuple(changes)


def _turned(module: Module, misfit: MisplacedModule) -> Module:
    angle = module.angle
    if misfit.turn:
        angle = np.pi - (np.pi - angle - misfit.turn) % (2.0 * np.pi)
    return replace(module, angle=float(angle), mirror=module.mirror != (misfit.kind is MisplacementKind.MIRRORED))


def _radius(module: Module) -> float:
    """Largest distance of a module's outline from its centre, metres: a module that is farther off is not in its place."""
    outline = module.kind.outline - module.kind.outline.mean(axis=0)
    return float(np.sqrt(np.sum(outline * outline, axis=1)).max())


def _exchanged(layout: Layout, swapped: Sequence[MisplacedModule]) -> tuple[dict[int, int], list[Unrepaired]]:
    """Exchange first channels: the new one of each module, by id, and the modules that cannot be corrected."""
    goes = {misfit.module: misfit.other for misfit in swapped if misfit.other is not None}
    modules = {module.id: module for module in layout.modules}
    channels: dict[int, int] = {}
    left: list[Unrepaired] = []
    for start in goes:
        ring = _ring(start, goes)
        if not ring:
            left.append(Unrepaired(UnrepairedKind.NO_RING, (start, goes[start])))
        elif _have_same_pads([modules[number] for number in ring]):
            channels[goes[start]] = modules[start].first_channel
        elif start == min(ring):
            left.append(Unrepaired(UnrepairedKind.UNLIKE, ring))
    return channels, left


def _ring(start: int, goes: Mapping[int, int]) -> tuple[int, ...]:
    """List the cycle of modules from `start` on, each in the place of the next; empty without a cycle."""
    ring = [start]
    while (after := goes.get(ring[-1])) is not None and after not in ring:
        ring.append(after)
    return tuple(ring) if after == start else ()


def _have_same_pads(modules: Sequence[Module]) -> bool:
    first = modules[0].kind.pads
    return all(np.array_equal(first, module.kind.pads, equal_nan=True) for module in modules)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedNeighbours:
    """Pairs of neighbouring taxels of one module by the layout."""

    pairs: IntArray
    """(n, 2) channels."""
    modules: IntArray
    """(n,) indices in the layout."""
    planned: FloatArray
    """(n,) float, metres: planned distance."""
    width: int
    """Channels of a skin frame."""
    count: int
    """Modules of the layout."""

    def ratios(self, channels: IntArray, places: FloatArray) -> FloatArray:
        """Compute (modules + 1,) the distance of neighbours over the planned one, the last over all; NaN without a known pair.

        Least squares draws taxels together to where they are poked (below 1), and scatter widens (above 1).

        Parameters
        ----------
        channels, places : (n,) int and (n, 3) float, metres; NaN if unknown
        """
        apart = self._distances(channels, places)
        known = np.isfinite(apart)
        sums = [np.bincount(self.modules[known], weights=each[known], minlength=self.count) for each in (apart, self.planned)]
        apart, planned = (np.append(each, each.sum()) for each in sums)
        return np.divide(apart, planned, out=np.full(self.count + 1, np.nan), where=planned > 0.0)

    def pair_ratios(self, channels: IntArray, places: FloatArray) -> FloatArray:
        """Compute the distance over the planned one of each pair whose places are known; parameters as of `ratios`."""
        ratios = self._distances(channels, places) / self.planned
        return ratios[np.isfinite(ratios)]

    def _distances(self, channels: IntArray, places: FloatArray) -> FloatArray:
        found = np.full((self.width, 3), np.nan)
        found[channels] = places
        ways = found[self.pairs[:, 0]] - found[self.pairs[:, 1]]
        return np.sqrt(np.sum(ways * ways, axis=1))


def neighbours_of(layout: Layout) -> PlannedNeighbours:
    """Find the neighbouring taxels of a layout. It looks at every pair of a module, so keep the result."""
    pairs, modules, planned = [np.empty((0, 2), dtype=np.int64)], [np.empty(0, dtype=np.int64)], [np.empty(0)]
    for index, module in enumerate(layout.modules):
        pads = module_pads(module)
        apart = np.sqrt(np.sum((pads[:, None] - pads[None]) ** 2, axis=2))
        first, second = np.nonzero(np.triu(apart <= NEIGHBOUR_MAX_SPACINGS * layout.spacing, 1))
        pairs.append(module.channels[np.stack([first, second], axis=1)])
        modules.append(np.full(len(first), index, dtype=np.int64))
        planned.append(apart[first, second])
    ends = np.concatenate(pairs), np.concatenate(modules), np.concatenate(planned)
    return PlannedNeighbours(*ends, layout.width, len(layout.modules))


def spacing_ratio(layout: Layout, estimates: Sequence[Estimate]) -> float | None:
    """Compute the distance of neighbours over the planned one, over all modules; `None` without a known pair."""
    channels = np.array([estimate.channel for estimate in estimates], dtype=np.int64)
    ratio = float(neighbours_of(layout).ratios(channels, places_of(estimates))[-1])
    return ratio if ratio == ratio else None
