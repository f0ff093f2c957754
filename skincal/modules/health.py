"""Whether modules lie as the layout plans them: mirrored, turned and swapped ones named, and how far taxels lie apart.

All of it follows from the estimates of single taxels, which know nothing of modules. A module's estimates, seen along their
mean normal, are fitted by its pads, as planned and mirrored, moved and turned as may be; that pose is compared with the plan's,
less the rigid motion that most modules share. Modules are wrong by ten millimetres where one of these mistakes was made, and by
two where none was. What it says is an offer (`board_mend` makes a layout of it); nothing is changed by it.

The layout put right: what `board_health` finds wrong with modules, as changes of the layout.

A mirrored or turned module gets its mirror and angle changed. A swapped one is right in all but whose channels it has, so the
place where it was found gets its channels; that takes modules that lie in each other's places all around. What a module looks
like in another's place is told only once it is planned there, so the corrected layout is judged again by the same estimates,
until nothing is left. A correction whose plan does not lie nearer to the estimates is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.model.skin import Layout, Module
from skincal.modules.pose import ModuleModel, module_pads
from skincal.taxels.contact_table import across
from skincal.taxels.differences import places_of
from skincal.taxels.result import Estimate

FEWEST = 5
"""Taxels of a module with an estimate below which nothing is said of it."""
MIRRORED = 0.6
"""The mirrored pads must fit this much better: the paper's modules fit to 2.1 mm straight and 10.4 mm mirrored."""
TURN_MIN = float(np.radians(30.0))
"""rad: a module that is turned by less against most others is laid badly, not mounted wrongly."""
TURN_ABOUT = float(np.radians(25.0))
"""rad: a turn that lays the board on itself is meant by turns that are seen so near to it."""
TURN_STEP, TURN_NEAR = float(np.radians(30.0)), float(np.radians(8.0))
"""rad: other mistakes are made in such steps, and are seen so near to them: a board's turn is seen to 3 degrees (sd)."""
TURNED = 0.6
"""The turned pads must fit this much better than the planned ones, moved alone: few estimates that lie close together fit any
turn."""
SWAP_SHARE = 0.3
"""A module lies where another one is planned when it is nearer to that place than this share of its way from its own."""
FAR = 0.008
"""m: modules farther than this from where the others put them count less for what all are moved by alike."""
ARM = 0.02
"""m: a module's normal counts as a point so far above it, lest a flat skin be turned upside down."""
ROUNDS = 5
ALIKE = 1e-3
"""m: corners of an outline that lie nearer than this are the same."""
NEIGHBOUR = 1.3
"""Taxels of one module within this many spacings are neighbours: 1.0 apart, the next ring is 1.7."""


class MisfitKind(Enum):
    """What is wrong with a module; the value says it in a word."""

    MIRRORED = "mirrored"
    TURNED = "turned"
    SWAPPED = "swapped"


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """One module that does not lie as planned, and what would put it right."""

    module: int
    """Its id."""
    kind: MisfitKind
    before: float
    """m, rms: how far its taxels lie from the plan, less what all modules are moved by alike."""
    after: float
    """m, rms: the same with the correction."""
    turn: float = 0.0
    """rad: what the layout's angle is to be changed by; of a mirrored one once its mirror is changed."""
    other: int | None = None
    """Id of the module in whose place it lies."""

    @property
    def words(self) -> str:
        """A sentence for the operator."""
        turn = f"{np.degrees(self.turn):.0f}"
        too = f", and its angle_deg by {turn} degrees" if self.turn else ""
        what = {
            MisfitKind.MIRRORED: f"is mirrored against the layout: change its mirror{too}",
            MisfitKind.TURNED: f"is turned by {turn} degrees: change its angle_deg by that",
            MisfitKind.SWAPPED: f"lies where module {self.other} is planned: give that one its first_channel",
        }[self.kind]
        return (
            f"Module {self.module} {what}. Its taxels then lie {self.after * 1e3:.0f} mm off, not {self.before * 1e3:.0f} mm."
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A module as its estimates show it."""

    places: FloatArray
    """(n, 3) float, metres, of `pads`."""
    planned: FloatArray
    """(n, 3) float, metres: where the plan puts them."""
    straight: float
    mirrored: float
    """m, rms from the pads as planned and mirrored, moved and turned as may be."""
    turn: float
    """rad, of the better one against the plan."""
    normals: FloatArray
    """(2, 3) float, unit: of the plan, and of the estimates."""

    def replanned(self, motion: FloatArray) -> _Seen:
        """Return it with the plan moved by `motion` (4, 4)."""
        return replace(self, planned=self.planned @ motion[:3, :3].T + motion[:3, 3])


def judged_modules(boards: ModuleModel, estimates: Mapping[int, Estimate]) -> int:
    """Return of how many modules enough is known for `find_misfits` to judge them; parameters as there."""
    return sum(_known(boards, index, estimates) is not None for index in range(len(boards.pads)))


def find_misfits(boards: ModuleModel, estimates: Mapping[int, Estimate]) -> tuple[Misfit, ...]:
    """Return the modules that are mirrored, turned or swapped, in the layout's order.

    Parameters
    ----------
    estimates : of single taxels by channel, of the surface method where there is a surface
    """
    seen, motion = _all_seen(boards, estimates)
    elsewhere = _in_place_of(boards, seen, motion)
    usual = _usual([one.turn for index, one in seen.items() if index not in elsewhere])
    found = (_misfit(boards, index, one, elsewhere.get(index), usual) for index, one in seen.items())
    return tuple(one for one in found if one is not None)


def miss_of(boards: ModuleModel, estimates: Mapping[int, Estimate]) -> float:
    """Return how far taxels lie from the plan, less what most modules are moved by alike: rms, m; 0 where nothing is known."""
    seen, _ = _all_seen(boards, estimates)
    return _rms(np.concatenate([one.places - one.planned for one in seen.values()])) if seen else 0.0


def _all_seen(boards: ModuleModel, estimates: Mapping[int, Estimate]) -> tuple[dict[int, _Seen], FloatArray]:
    """Return the modules of which enough is known, their plans moved by what most are moved by, and that motion (4, 4)."""
    seen = {index: one for index in range(len(boards.pads)) if (one := _seen(boards, index, estimates)) is not None}
    if not seen:
        return {}, np.eye(4)
    motion = _common(list(seen.values()))
    return {index: one.replanned(motion) for index, one in seen.items()}, motion


def _usual(turns: Sequence[float]) -> float:
    """Return the turn that is nearest to all, the smallest of those equally near; 0 of none."""
    every = np.array(sorted(turns, key=abs), dtype=np.float64)
    apart = np.abs(np.angle(np.exp(1j * (every[:, None] - every)))).sum(axis=1)
    # To a billionth of a radian: which of two comes first must not hang on their last digit.
    return float(every[int(np.argmin(apart.round(9)))]) if len(every) else 0.0


def _common(seen: Sequence[_Seen]) -> FloatArray:
    """Return the rigid motion (4, 4) from the plan to the places that most modules share; a shift where they are two or one."""
    here, there = np.array([one.planned.mean(axis=0) for one in seen]), np.array([one.places.mean(axis=0) for one in seen])
    up, outward = (ARM * np.array([one.normals[row] for one in seen]) for row in range(2))
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


def _known(boards: ModuleModel, module: int, estimates: Mapping[int, Estimate]) -> dict[int, Estimate] | None:
    """Return the estimates of a module's pads that have a position and a normal; None where they or the plan do not tell."""
    told = {row: estimates[channel] for row, channel in enumerate(boards.channels_of([module])) if channel in estimates}
    known = {row: one for row, one in told.items() if one.position is not None and one.normal is not None}
    return None if len(known) < FEWEST or boards.plan(module) is None else known


def _seen(boards: ModuleModel, module: int, estimates: Mapping[int, Estimate]) -> _Seen | None:
    plan, planned = boards.plan(module), boards.planned(module)
    known = _known(boards, module, estimates)
    if plan is None or planned is None or known is None:
        return None
    rows, points = list(known), np.array([one.position for one in known.values()], dtype=np.float64)
    normal: FloatArray = np.sum(np.array([one.normal for one in known.values()], dtype=np.float64), axis=0)
    normal = normal / np.sqrt(normal @ normal)
    pads = boards.pads[module][rows]
    x = plan.x[0] - (plan.x[0] @ normal) * normal
    length = float(np.sqrt(x @ x))
    x = x / length if length > 0.1 else across(normal[None])[0, 0]
    y = np.asarray(np.cross(normal, x), dtype=np.float64)
    flat = np.stack([points @ x, points @ y], axis=1)
    straight, turn = _fit(pads, flat)
    mirrored, other = _fit(pads * np.array([-1.0, 1.0]), flat)
    return _Seen(points, planned[rows], straight, mirrored, turn if straight <= mirrored else other,
                 np.array([plan.normals[0], normal]))  # fmt: skip


def _fit(pads: FloatArray, flat: FloatArray) -> tuple[float, float]:
    """Return how far places (n, 2) in the plane lie from pads moved and turned to them, rms, and the turn."""
    own, there = pads - pads.mean(axis=0), flat - flat.mean(axis=0)
    turn = float(np.arctan2(np.sum(own[:, 0] * there[:, 1] - own[:, 1] * there[:, 0]), np.sum(own * there)))
    c, s = np.cos(turn), np.sin(turn)
    return _rms(there - own @ np.array([[c, s], [-s, c]])), turn


def _rms(off: FloatArray) -> float:
    """Return the root mean square of the lengths of (n, d)."""
    return float(np.sqrt(np.sum(off * off) / len(off)))


def _misfit(boards: ModuleModel, index: int, one: _Seen, elsewhere: tuple[int, float] | None, usual: float) -> Misfit | None:
    """Return what is wrong with a module; the largest mistake first.

    Parameters
    ----------
    elsewhere : the module in whose place it lies and how far from it; None for its own place
    usual : the turn that most have
    """
    number = boards.layout.modules[index].id
    before = _rms(one.places - one.planned)
    if elsewhere is not None:
        other, way = elsewhere
        return Misfit(number, MisfitKind.SWAPPED, before, float(np.hypot(way, one.straight)),
                      other=boards.layout.modules[other].id)  # fmt: skip
    beside = float(np.linalg.norm(one.places.mean(axis=0) - one.planned.mean(axis=0)))
    turn = float(np.angle(np.exp(1j * (one.turn - usual))))
    if one.mirrored < MIRRORED * one.straight:
        turn = _meant(turn, boards.layout.modules[index], mirrored=True)
        return Misfit(number, MisfitKind.MIRRORED, before, float(np.hypot(beside, one.mirrored)), turn=turn)
    if abs(turn) > TURN_MIN and one.straight < TURNED * _unturned(one):
        turn = _meant(turn, boards.layout.modules[index], mirrored=False)
        return Misfit(number, MisfitKind.TURNED, before, float(np.hypot(beside, one.straight)), turn=turn)
    return None


def _unturned(one: _Seen) -> float:
    """Return how far a module's estimates lie from its plan that is moved to them and not turned, metres, rms."""
    return _rms((one.places - one.places.mean(axis=0)) - (one.planned - one.planned.mean(axis=0)))


def _in_place_of(boards: ModuleModel, seen: Mapping[int, _Seen], motion: FloatArray) -> dict[int, tuple[int, float]]:
    """Return the modules that lie in another's planned place: that one, and how far from it.

    Modules of which too little is known are looked at, too, but only where one lies so far off that it may be in their place:
    on a large skin their plans cost more than all else.
    """
    here = {index: one.places.mean(axis=0) for index, one in seen.items()}
    there = {index: one.planned.mean(axis=0) for index, one in seen.items()}
    far = any(_apart(here[index], there[index]) > _rms(one.planned - there[index]) for index, one in seen.items())
    if far:
        there |= {
            index: planned.mean(axis=0) @ motion[:3, :3].T + motion[:3, 3]
            for index in range(len(boards.pads))
            if index not in seen and (planned := boards.planned(index)) is not None
        }
    nearest = {index: _nearest(place, there) for index, place in here.items()} if far else {}
    astray = {index: one for index, one in nearest.items() if one[0] != index}
    found = {index: one for index, one in astray.items() if one[1] < SWAP_SHARE * _apart(here[index], there[index])}
    # Who has another in its place lies in the place of one that is astray, too, if less surely so.
    while more := [other for other, _ in found.values() if other in astray and other not in found]:
        found |= {one: _nearest(here[one], {index: there[index] for index in astray if index != one}) for one in more}
    return found


def _nearest(place: FloatArray, centres: Mapping[int, FloatArray]) -> tuple[int, float]:
    """Return which of some places is nearest to one, and how far from it."""
    apart = np.sqrt(np.sum((np.array(list(centres.values())) - place) ** 2, axis=1))
    row = int(np.argmin(apart))
    return list(centres)[row], float(apart[row])


def _apart(place: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(place - other))


def _meant(turn: float, module: Module, *, mirrored: bool) -> float:
    """Return the turn that is meant by one that is seen.

    That is one that lays the board, mirrored or not, on its own outline, else one in steps of `TURN_STEP`, else whole degrees.
    Of a mirrored board a turn that none would be told of alone counts for none.
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

        Least squares draws taxels together to where they are poked: below 1 tells of it; scatter widens, above 1.

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
    channels = np.array([one.channel for one in estimates], dtype=np.int64)
    ratio = float(neighbours_of(layout).ratios(channels, places_of(estimates))[-1])
    return ratio if ratio == ratio else None


MEND_ROUNDS = 3
"""Corrections one after another: that a swapped module is mirrored, too, is seen after the exchange; the third is spare."""
MOST_NAMED = 4
"""Modules of one sentence that are named; of more the first."""


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

    @property
    def words(self) -> str:
        """A line for the operator: `"module 17: angle_deg = -60, mirror = true"`."""
        said = ", ".join(f"{key} = {str(value).lower()}" for key, value in self.keys.items())
        return f"module {self.module}: {said}"


@dataclass(frozen=True, slots=True, eq=False)
class LayoutMend:
    """How a layout is put right."""

    misfits: tuple[Misfit, ...]
    """What is wrong with it, as `find_misfits` says it."""
    layout: Layout
    """The corrected one; as it was where nothing can be put right."""
    changes: tuple[ModuleChange, ...]
    """What it says otherwise, in its order."""
    left: tuple[str, ...]
    """Sentences on what cannot be put right so, and why."""


def mend_modules(boards: ModuleModel, estimates: Mapping[int, Estimate]) -> LayoutMend:
    """Return how the layout of boards is put right so that `find_misfits` finds nothing more.

    Parameters
    ----------
    boards, estimates : as for `find_misfits`
    """
    given, first, left = boards.layout, None, ()
    for more in reversed(range(MEND_ROUNDS + 1)):
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
    return LayoutMend(first or (), boards.layout, changes_of(given, boards.layout), left)


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


def changes_of(before: Layout, after: Layout) -> tuple[ModuleChange, ...]:
    """Return what a layout of the same modules says otherwise, in its order."""
    found = [_change(one, other) for one, other in zip(before.modules, after.modules, strict=True)]
    return tuple(one for one in found if one.keys)


def _change(one: Module, other: Module) -> ModuleChange:
    return ModuleChange(
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
