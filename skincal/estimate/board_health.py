"""Whether modules lie as the layout plans them: mirrored, turned and swapped ones named, and how far taxels lie apart.

All of it follows from the estimates of single taxels, which know nothing of modules. A module's estimates, seen along their
mean normal, are fitted by its pads, as planned and mirrored, moved and turned as may be; that pose is compared with the plan's,
less the rigid motion that most modules share. Modules are wrong by ten millimetres where one of these mistakes was made, and by
two where none was. What it says is an offer; nothing is changed by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from skincal.estimate.boards import Boards, board_pads
from skincal.estimate.compare import places_of
from skincal.estimate.evidence import across
from skincal.estimate.result import Estimate
from skincal.readings import FloatArray, IntArray
from skincal.skin import Layout

FEWEST = 5
"""Taxels of a module with an estimate below which nothing is said of it."""
MIRRORED = 0.6
"""The mirrored pads must fit this much better: the paper's modules fit to 2.1 mm straight and 10.4 mm mirrored."""
TURN_MIN = float(np.radians(30.0))
"""rad: a module that is turned by less against most others is laid badly, not mounted wrongly."""
SWAP_SHARE = 0.3
"""A module lies where another one is planned when it is nearer to that place than this share of its way from its own."""
FAR = 0.008
"""m: modules farther than this from where the others put them count less for what all are moved by alike."""
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
    """rad: what the layout's angle is to be changed by."""
    other: int | None = None
    """Id of the module in whose place it lies."""

    @property
    def words(self) -> str:
        """A sentence for the operator."""
        what = {
            MisfitKind.MIRRORED: "is mirrored against the layout: change its mirror",
            MisfitKind.TURNED: f"is turned by {np.degrees(self.turn):.0f} degrees: change its angle_deg by that",
            MisfitKind.SWAPPED: f"lies where module {self.other} is planned: exchange their first_channel",
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

    def replanned(self, motion: FloatArray) -> _Seen:
        """Return it with the plan moved by `motion` (4, 4)."""
        return replace(self, planned=self.planned @ motion[:3, :3].T + motion[:3, 3])


def judged_modules(boards: Boards, estimates: Mapping[int, Estimate]) -> int:
    """Return of how many modules enough is known for `find_misfits` to judge them; parameters as there."""
    return sum(_known(boards, index, estimates) is not None for index in range(len(boards.pads)))


def find_misfits(boards: Boards, estimates: Mapping[int, Estimate]) -> tuple[Misfit, ...]:
    """Return the modules that are mirrored, turned or swapped, in the layout's order.

    Parameters
    ----------
    estimates : of single taxels by channel, of the surface method where there is a surface
    """
    seen = {index: one for index in range(len(boards.pads)) if (one := _seen(boards, index, estimates)) is not None}
    if not seen:
        return ()
    motion = _common([one.places.mean(axis=0) for one in seen.values()], [one.planned.mean(axis=0) for one in seen.values()])
    seen = {index: one.replanned(motion) for index, one in seen.items()}
    turns = np.array([one.turn for one in seen.values()], dtype=np.float64)
    usual = float(np.arctan2(np.median(np.sin(turns)), np.median(np.cos(turns))))
    elsewhere = _in_place_of(seen)
    found = (_misfit(boards, index, one, seen, elsewhere[index], usual) for index, one in seen.items())
    return tuple(one for one in found if one is not None)


def _common(places: Sequence[FloatArray], planned: Sequence[FloatArray]) -> FloatArray:
    """Return the rigid motion (4, 4) from the plan to the places that most modules share; a shift where they are two or one."""
    here, there = np.array(planned), np.array(places)
    weights, motion = np.ones(len(here)), np.eye(4)
    motion[:3, 3] = np.median(there - here, axis=0)
    for _ in range(ROUNDS if len(here) > 2 else 0):
        off = there - here @ motion[:3, :3].T - motion[:3, 3]
        weights = 1.0 / (1.0 + np.sum(off * off, axis=1) / FAR**2)
        middle, centre = weights @ here / weights.sum(), weights @ there / weights.sum()
        left, _, right = np.linalg.svd((weights[:, None] * (there - centre)).T @ (here - middle))
        turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        motion[:3, :3], motion[:3, 3] = turn, centre - turn @ middle
    return motion


def _known(boards: Boards, module: int, estimates: Mapping[int, Estimate]) -> dict[int, Estimate] | None:
    """Return the estimates of a module's pads that have a position and a normal; None where they or the plan do not tell."""
    told = {row: estimates[channel] for row, channel in enumerate(boards.channels_of([module])) if channel in estimates}
    known = {row: one for row, one in told.items() if one.position is not None and one.normal is not None}
    return None if len(known) < FEWEST or boards.plan(module) is None else known


def _seen(boards: Boards, module: int, estimates: Mapping[int, Estimate]) -> _Seen | None:
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
    return _Seen(points, planned[rows], straight, mirrored, turn if straight <= mirrored else other)


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
    boards: Boards, index: int, one: _Seen, seen: Mapping[int, _Seen], other: int | None, usual: float
) -> Misfit | None:
    """Return what is wrong with a module that lies in the place of an `other`, or of none; the largest mistake first."""
    number = boards.layout.modules[index].id
    before = _rms(one.places - one.planned)
    if other is not None:
        after = float(np.linalg.norm(one.places.mean(axis=0) - seen[other].planned.mean(axis=0)))
        return Misfit(number, MisfitKind.SWAPPED, before, float(np.hypot(after, one.straight)),
                      other=boards.layout.modules[other].id)  # fmt: skip
    beside = float(np.linalg.norm(one.places.mean(axis=0) - one.planned.mean(axis=0)))
    if one.mirrored < MIRRORED * one.straight:
        return Misfit(number, MisfitKind.MIRRORED, before, float(np.hypot(beside, one.mirrored)))
    turn = float(np.angle(np.exp(1j * (one.turn - usual))))
    if abs(turn) > TURN_MIN:
        turn = _symmetric(turn, boards.layout, index)
        return Misfit(number, MisfitKind.TURNED, before, float(np.hypot(beside, one.straight)), turn=turn)
    return None


def _in_place_of(seen: Mapping[int, _Seen]) -> dict[int, int | None]:
    """Return for each module in whose planned place it lies; None where it lies in its own."""
    here = np.array([one.places.mean(axis=0) for one in seen.values()])
    there = np.array([one.planned.mean(axis=0) for one in seen.values()])
    ways = np.sqrt(np.sum((here[:, None] - there) ** 2, axis=2))
    indices = list(seen)
    found: dict[int, int | None] = {}
    for row, nearest in enumerate(np.argmin(ways, axis=1).tolist()):
        elsewhere = nearest != row and ways[row, nearest] < SWAP_SHARE * ways[row, row]
        found[indices[row]] = indices[nearest] if elsewhere else None
    return found


def _symmetric(turn: float, layout: Layout, index: int) -> float:
    """Return the nearest turn within 25 degrees that lays a board's outline on itself; else the turn as it is."""
    outline = layout.modules[index].kind.outline @ np.array([1.0, 1j])
    own = outline - outline.mean()
    for angle in np.radians([60.0, 90.0, 120.0, 180.0, -60.0, -90.0, -120.0]).tolist():
        gap = np.abs(own[:, None] * np.exp(1j * angle) - own[None]).min(axis=1).max()
        if gap < ALIKE and abs(np.angle(np.exp(1j * (angle - turn)))) < np.radians(25.0):
            return float(angle)
    return turn


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
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


def neighbours_of(layout: Layout) -> Neighbours:
    """Return which taxels the layout plans next to each other; once for a layout, since it looks at every pair of a module."""
    pairs, modules, planned = [np.empty((0, 2), dtype=np.int64)], [np.empty(0, dtype=np.int64)], [np.empty(0)]
    for index, module in enumerate(layout.modules):
        pads = board_pads(module)
        apart = np.sqrt(np.sum((pads[:, None] - pads[None]) ** 2, axis=2))
        first, second = np.nonzero(np.triu(apart <= NEIGHBOUR * layout.spacing, 1))
        pairs.append(module.channels[np.stack([first, second], axis=1)])
        modules.append(np.full(len(first), index, dtype=np.int64))
        planned.append(apart[first, second])
    ends = np.concatenate(pairs), np.concatenate(modules), np.concatenate(planned)
    return Neighbours(*ends, layout.width, len(layout.modules))


def spacing_ratio(layout: Layout, estimates: Sequence[Estimate]) -> float | None:
    """Return how far neighbours lie apart over how far the layout plans it, over all modules; None where no pair is known."""
    channels = np.array([one.channel for one in estimates], dtype=np.int64)
    ratio = float(neighbours_of(layout).ratios(channels, places_of(estimates))[-1])
    return ratio if ratio == ratio else None
