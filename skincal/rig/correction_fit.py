"""What moves with the taxels while a rig is fitted: boards where there is a layout, else each taxel alone.

A rig's correction from landmark pokes and skin pokes together, tried on landmark pokes that were held out.

What is asked is frozen, and the answer follows from it alone: it may be worked out anywhere, at any time. The rows and their
mathematics are those of `rig.py`.

A landmark poke that is far off what all others foretell for it, in standard deviations of that (its miss divided by the root
of one less its leverage), counts less, as a taxel's poke does (`trust.h`); which ones is told. One landmark in four is held
out with all its pokes, each quarter in turn: the correction is used only where it foretells the held-out pokes better than the
rig as it tells itself. Without landmarks nothing of the rig is touched: no poke on the skin tells whether the rig is wrong or
the skin lies elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.geometry.wrench import axis_point, move_wrench
from skincal.methods import estimate_from
from skincal.model.scene import NoiseSettings, Scene
from skincal.modules.pose import ModuleModel, ModulePoses, joined, rotations
from skincal.modules.pose_fit import FULL, NONE, Touches, find_touches, fit_modules, start_of
from skincal.rig.correction import Correction, RigPrior, RigReadings, RigRows, RigState, rig_rows
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPokes:
    """Where the m pokes on the skin are, as their clouds lie."""

    places: FloatArray
    """(m, 3) float, metres, link frame."""
    gradients: FloatArray
    """(m, 3, d) float: change of a place with its cloud's unknowns."""
    spread: FloatArray
    """(m, 3, 3) float, m^2: covariance of the contact about its place."""


@dataclass(frozen=True, slots=True, eq=False)
class ModuleGroups:
    """The modules that were poked, each rigid."""

    boards: ModuleModel
    touches: Touches
    poses: ModulePoses
    trust: FloatArray
    """(m,) of each poke, from the fit of the boards alone."""

    @property
    def pokes(self) -> IntArray:
        """(m,) numbers of the pokes."""
        return self.touches.evidence.pokes[self.touches.rows]

    @property
    def of(self) -> IntArray:
        """(m,) cloud of each poke, 0 to `count` - 1."""
        return self.touches.of

    @property
    def count(self) -> int:
        """How many clouds there are."""
        return len(self.touches.boards)

    def placed(self) -> PlacedPokes:
        """Return where the pokes are."""
        modules: list[int] = self.touches.boards.tolist()
        own = [self.boards.pads[module] for module in modules]
        of = np.repeat(np.arange(len(own)), [len(pads) for pads in own])
        pads = self.boards.ground.laid(self.poses.take(of), np.concatenate(own))
        places, gradients, normals = self.touches.middles(pads)
        across = np.eye(3) - normals[:, :, None] * normals[:, None]
        return PlacedPokes(places, gradients, self.touches.offsets[:, None, None] * across)

    def moved(self, moves: FloatArray) -> ModuleGroups:
        """Return them moved by `moves` (count, d)."""
        return ModuleGroups(self.boards, self.touches, self.boards.ground.moved(self.poses, moves), self.trust)


@dataclass(frozen=True, slots=True, eq=False)
class TaxelGroups:
    """The taxels that were poked, each by itself."""

    pokes: IntArray
    of: IntArray
    count: int
    points: FloatArray
    """(count, 3) float, metres."""
    offsets: FloatArray
    """(m,) float, m^2: variance of the contact beside its taxel, each direction."""
    trust: FloatArray

    def placed(self) -> PlacedPokes:
        """Return where the pokes are: at their taxels."""
        eye = np.tile(np.eye(3), (len(self.of), 1, 1))
        return PlacedPokes(self.points[self.of], eye, self.offsets[:, None, None] * eye)

    def moved(self, moves: FloatArray) -> TaxelGroups:
        """Return them moved by `moves` (count, 3)."""
        return TaxelGroups(self.pokes, self.of, self.count, self.points + moves, self.offsets, self.trust)


Clouds: TypeAlias = ModuleGroups | TaxelGroups


def module_groups(
    ledger: ContactTable, boards: ModuleModel, estimates: Mapping[int, Estimate], noise: NoiseSettings, channels: list[int]
) -> ModuleGroups | None:
    """Return the modules that were poked, where the rig as it tells itself puts them; None where none was.

    Parameters
    ----------
    estimates : of taxels, where the search for a board begins
    channels : those that are used
    """
    evidence = ledger.evidence(channels)
    begun = {module: start_of(boards, module, [estimates]) for module in boards.modules_of(evidence.channels.tolist())}
    ready = {module: start for module, start in begun.items() if start is not None}
    touches = find_touches(evidence, ledger.totals(evidence.pokes), boards, noise, ready)
    if not len(touches.boards):
        return None
    fitted = fit_modules(touches, boards, joined([ready[module] for module in touches.boards.tolist()]), noise)
    return ModuleGroups(boards, touches, fitted.poses, fitted.trust)


def taxel_groups(
    ledger: ContactTable, estimates: Mapping[int, Estimate], noise: NoiseSettings, channels: list[int]
) -> TaxelGroups | None:
    """Return the taxels that have an estimate and were poked; None where none was."""
    placed = {channel: estimates[channel] for channel in channels if channel in estimates}
    known = {channel: one.position for channel, one in placed.items() if one.position is not None}
    evidence = ledger.evidence(known)
    if not len(evidence.channels):
        return None
    answered: list[int] = evidence.channels.tolist()
    doubted = [placed[channel].doubted for channel in answered]
    taxels: list[int] = evidence.taxels.tolist()
    pairs = zip(taxels, evidence.pokes.tolist(), strict=True)
    return TaxelGroups(
        pokes=evidence.pokes,
        of=evidence.taxels,
        count=len(evidence.channels),
        points=np.array([known[channel] for channel in answered]),
        offsets=noise.contact**2 - noise.reach**2 * np.log(evidence.weights),
        trust=np.array([doubted[taxel].get(poke, 1.0) for taxel, poke in pairs]),
    )


STEPS = 4
"""Of Gauss and Newton: the rows are nearly straight in the unknowns, and the fourth step moves no taxel by a micrometre."""
ROUNDS = 4
"""How often the trust of landmark pokes is told anew within a step."""
SKIN = 0.1
"""What a poke on the skin counts for the rig: pokes near one place are off by the same, so ten of them do not tell ten times as
much. On the paper's rig with 1,200 skin pokes and 21 at landmarks the modules' error is 2.1 mm with 1, 1.0 with 0.3, 0.65 with
0.1 and 0.65 with 0.03."""
HELD_OUT = 4
"""One landmark in so many is held out, with all its pokes: one whose place is told wrong foretells its own miss."""
FEWEST_POINTS = 4
"""Different landmarks below which nothing is corrected: fewer would be held out one by one, and the rest would tell too little.
With three that are 4 mm off, pokes held out instead of landmarks made a good rig five times worse."""
BETTER = 0.5
"""The held-out pokes must be foretold so much better, in the mean square, for a correction to be used. Six pokes at six
landmarks in one pose, ten rigs each: on good ones whose landmarks are told 4 to 6 mm off it comes to 0.53 and more by chance,
on the paper's to 0.01 to 0.43 in 19 of 20, with landmarks that are right or 4 mm off."""
TOLD = 0.9
"""A landmark poke that counts less than this is named to the operator."""
LEFT = 0.5
"""Share of the landmark pokes that must count, or all of them do: where most are doubted, nobody can tell which are right."""
FEWEST = 6
"""Landmark pokes below which nothing is corrected: from fewer, nothing is left to try a correction on."""


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkPoke:
    """A poke at a known point of the part; no taxel need answer."""

    poke: int
    """Number of the poke."""
    name: str
    """Of the landmark."""
    place: FloatArray
    """(3,) float, metres, link frame: of the landmark."""
    force: FloatArray
    """(3,) float, N, tared, sensor frame, force on the part."""
    moment: FloatArray
    """(3,) float, N m, about the sensor's origin."""
    link_from_sensor: FloatArray
    """(4, 4) float, metres: pose of the arm as told."""
    pose: str
    """Name of the arm pose."""

    @property
    def miss(self) -> float:
        """How far its axis passes the landmark, metres."""
        force, moment = move_wrench(self.link_from_sensor, self.force, self.moment)
        return float(np.linalg.norm(np.cross(self.place - axis_point(force, moment), force / np.linalg.norm(force))))


@dataclass(frozen=True, slots=True, eq=False)
class RigRequest:
    """What a correction is worked out from."""

    scene: Scene
    surface: Surface | None
    contacts: Sequence[Contact]
    """Those on the skin that count."""
    landmarks: Sequence[LandmarkPoke]
    dead: Mapping[int, str] = field(default_factory=dict[int, str])
    prior: RigPrior = field(default_factory=RigPrior)


@dataclass(frozen=True, slots=True, eq=False)
class RigAnswer:
    """What came out."""

    correction: Correction | None
    """None where there is nothing to correct with."""
    used: bool
    """Whether the correction foretells held-out landmark pokes better than the rig as it tells itself."""
    before: float
    """m: at what distance the axes pass the landmarks as the rig tells, root mean square by trust; NaN without pokes."""
    after: float
    """m: the same for held-out pokes under a correction made without them; NaN where there is none."""
    points: int
    """How many different landmarks were poked."""
    trust: Mapping[int, float]
    """Of each landmark poke, 0 to 1."""
    distances: Mapping[int, float]
    """m: of each landmark poke, how far its axis passes the landmark under the correction."""
    unknowns: FloatArray
    """(36 + 6 poses,) float: the correction in standard deviations of the prior."""
    known: FloatArray
    """(36 + 6 poses,) float: sd of each unknown over that of its prior, 0 to 1; 1 is not determined."""

    @property
    def sentences(self) -> tuple[str, ...]:
        """What an operator is told."""
        if self.correction is None:
            needs = f"it needs {FEWEST} pokes at landmarks, {FEWEST_POINTS} different ones"
            return (f"No correction of the rig: {needs}; {len(self.trust)} pokes at {self.points} are there.",)
        before, after = f"{self.before * 1e3:.1f} mm", f"{self.after * 1e3:.1f} mm"
        misses = f"held-out pokes pass their landmarks at {after} with a correction made without them, at {before} without any"
        said = [f"The rig can be corrected: {misses}." if self.used else f"The rig is left as it is: {misses}."]
        said += [
            f"Landmark poke {poke} lies {self.distances[poke] * 1e3:.0f} mm off its landmark and counts "
            + ("for nothing: was it another point?" if trust <= 0 else f"{trust:.0%}.")
            for poke, trust in self.trust.items()
            if trust < TOLD
        ]
        return tuple(said)


def _nothing() -> None:
    pass


def correct_rig(request: RigRequest, between: Callable[[], None] = _nothing) -> RigAnswer:
    """Find what is wrong with a rig, as far as landmark pokes tell.

    Parameters
    ----------
    between : called between the steps, some 50 ms apart; may raise to give up
    """
    names = sorted({one.pose for one in request.contacts} | {one.pose for one in request.landmarks})
    scales = request.prior.scales(len(names))
    if len(request.landmarks) < FEWEST or len({one.name for one in request.landmarks}) < FEWEST_POINTS:
        trust = {one.poke: 1.0 for one in request.landmarks}
        nothing = np.zeros(len(scales))
        points = len({one.name for one in request.landmarks})
        return RigAnswer(None, False, float("nan"), float("nan"), points, trust, {}, nothing, nothing + 1.0)
    fit = _Fit(request, names, scales)
    for _ in range(STEPS):
        between()
        fit.step()
    between()
    return fit.answer(names)


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """One linear solve."""

    step: FloatArray
    """(n,) from the prior's nought."""
    root: FloatArray
    """(n, n) upper triangular: root' root is the information."""


class _Fit:
    """Steps of Gauss and Newton over the rig and what moves with it."""

    def __init__(self, request: RigRequest, names: list[str], scales: FloatArray) -> None:
        self.noise, self.scales = request.scene.noise, scales
        self.clouds = _clouds(request)
        self.landmarks = sorted(request.landmarks, key=lambda one: one.poke)
        order = {name: index for index, name in enumerate(names)}
        self._known = _readings(self.landmarks, order)
        self._places = np.array([one.place for one in self.landmarks])
        self._aim = np.tile(request.prior.landmark**2 * np.eye(3), (len(self.landmarks), 1, 1))
        by_poke = {one.poke: one for one in request.contacts}
        pokes: list[int] = [] if self.clouds is None else self.clouds.pokes.tolist()
        self._skin = _readings([by_poke[poke] for poke in pokes], order) if pokes else None
        self.state = RigState.at_prior(len(names))
        self.trust = np.ones(len(self.landmarks))
        self._last: tuple[RigRows, FloatArray] | None = None

    def step(self) -> None:
        """Move the rig and the clouds to the minimum of the rows as they are here."""
        here = self.state.unknowns(self.scales)
        base, tops = self._without_clouds(here)
        rows = rig_rows(self._known, self.state, self._places, self._aim, self.noise, self.scales)
        for _ in range(ROUNDS):
            solved = _solved(base, rows, self.trust)
            self.trust = _trusted(rows, solved, self.trust)
        solved = _solved(base, rows, self.trust)
        self._last = (rows, base)
        self.state = self.state.moved(solved.step, self.scales)
        if self.clouds is not None:
            self.clouds = self.clouds.moved(np.stack([_cloud_move(top, solved.step) for top in tops]))

    def _without_clouds(self, here: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Return the factor (n + 1, n + 1) of all rows but the landmarks', and each cloud's own rows on top of its factor."""
        kept, tops = [np.column_stack([np.eye(len(here)), here])], list[FloatArray]()
        if self.clouds is not None and self._skin is not None:
            placed = self.clouds.placed()
            rows = rig_rows(self._skin, self.state, placed.places, placed.spread, self.noise, self.scales)
            root = np.sqrt(SKIN * self.clouds.trust)[:, None, None]
            own = rows.of_place @ placed.gradients
            every = root * np.concatenate([own, rows.of_rig, rows.misses[:, :, None]], axis=2)
            for cloud in range(self.clouds.count):
                factor = _factor(every[self.clouds.of == cloud].reshape(-1, every.shape[2]))
                tops.append(factor[: own.shape[2]])
                kept.append(factor[own.shape[2] :, own.shape[2] :])
        return _factor(np.concatenate(kept)), tops

    def answer(self, names: list[str]) -> RigAnswer:
        """Return what came out, tried on held-out pokes where the rows stood last."""
        assert self._last is not None
        rows, base = self._last
        as_told = RigState.at_prior(len(names))
        told = rig_rows(self._known, as_told, self._places, self._aim, self.noise, self.scales)
        now = rig_rows(self._known, self.state, self._places, self._aim, self.noise, self.scales)
        held = self._held_out(rows, base)
        before, after = (np.average(np.sum(one**2, axis=1), weights=self.trust) for one in (told.misses, held))
        # What whitens tells metres: by how much a standard deviation is on average.
        metre = np.sqrt(np.sum(told.distances**2) / np.sum(told.misses**2))
        root = _solved(base, rows, self.trust).root
        known = np.sqrt(np.sum(np.asarray(np.linalg.inv(root), dtype=np.float64) ** 2, axis=1))
        pokes = [one.poke for one in self.landmarks]
        return RigAnswer(
            correction=_correction(self.state, names),
            used=bool(after < BETTER * before),
            before=float(metre * np.sqrt(before)),
            after=float(metre * np.sqrt(after)),
            points=len({one.name for one in self.landmarks}),
            trust=dict(zip(pokes, self.trust.tolist(), strict=True)),
            distances=dict(zip(pokes, now.distances.tolist(), strict=True)),
            unknowns=self.state.unknowns(self.scales),
            known=np.minimum(known, 1.0),
        )

    def _held_out(self, rows: RigRows, base: FloatArray) -> FloatArray:
        """Return (m, 2) the misses of landmark pokes, each under the correction made without its quarter of the landmarks."""
        held = np.empty_like(rows.misses)
        names = sorted({one.name for one in self.landmarks})
        quarter = np.array([names.index(one.name) % HELD_OUT for one in self.landmarks])
        for out in range(HELD_OUT):
            own = quarter == out
            step = _solved(base, rows, np.where(own, 0.0, self.trust)).step
            held[own] = rows.misses[own] + rows.of_rig[own] @ step
        return held


def _clouds(request: RigRequest) -> Clouds | None:
    """Return what moves with the skin pokes, from where the rig as it tells itself puts it."""
    scene, surface = request.scene, request.surface
    ledger = ContactTable(request.contacts)
    layout = scene.skin.layout
    answered = sorted({channel for one in request.contacts for channel in one.channels.tolist()} - request.dead.keys())
    channels = answered if layout is None else [channel for channel in answered if layout.module_of[channel] >= 0]
    method = Method.FREE if surface is None else Method.SURFACE
    estimates = estimate_from(ledger, channels, [method], scene.noise, surface)[method]
    if layout is None:
        return taxel_groups(ledger, estimates, scene.noise, channels)
    return module_groups(ledger, ModuleModel(layout, scene.skin.anchor, surface), estimates, scene.noise, channels)


def _readings(pokes: Sequence[Contact | LandmarkPoke], order: Mapping[str, int]) -> RigReadings:
    return RigReadings(
        np.array([np.concatenate([one.force, one.moment]) for one in pokes]),
        np.array([order[one.pose] for one in pokes]),
        np.array([one.link_from_sensor for one in pokes]),
    )


def _factor(rows: FloatArray) -> FloatArray:
    """Return R of the QR of rows, square or with fewer rows than columns."""
    factor: Any = np.linalg.qr(rows, mode="r")
    return np.asarray(factor, dtype=np.float64)


def _solved(base: FloatArray, rows: RigRows, trust: FloatArray) -> _Solved:
    """Return the minimum of all rows, those of landmarks by their trust."""
    own = np.concatenate([rows.of_rig, rows.misses[:, :, None]], axis=2) * np.sqrt(trust)[:, None, None]
    factor = _factor(np.concatenate([base, own.reshape(-1, own.shape[2])]))
    root = factor[:-1, :-1]
    return _Solved(-np.asarray(np.linalg.solve(root, factor[:-1, -1]), dtype=np.float64), root)


def _trusted(rows: RigRows, solved: _Solved, trust: FloatArray) -> FloatArray:
    """Return the trust of landmark pokes by what all others foretell for each.

    With H = A (root' root)^-1 A' of a poke that counts k, its miss r under the fit has the covariance 1/k - H where all is
    noise: so r' (I - k H)^-1 r is chi-square for one that counts fully, and (I + H) takes the place for one that does not.
    """
    misses = rows.misses + rows.of_rig @ solved.step
    spread = np.asarray(np.linalg.solve(solved.root.T, rows.of_rig.reshape(-1, rows.of_rig.shape[2]).T), dtype=np.float64)
    spread = spread.T.reshape(*misses.shape, -1)
    leverage = spread @ spread.transpose(0, 2, 1)
    counts = (trust > 0.5)[:, None, None]
    total = np.eye(2) + np.where(counts, -trust[:, None, None] * leverage, leverage)
    squares = np.sum(misses * np.asarray(np.linalg.solve(total, misses[:, :, None])[:, :, 0]), axis=1)
    rest = np.clip((NONE - np.sqrt(np.maximum(squares, 0.0))) / (NONE - FULL), 0.0, 1.0)
    found = np.where(squares > FULL**2, rest * rest * (3.0 - 2.0 * rest), 1.0)
    return found if found.sum() >= LEFT * len(found) else np.ones(len(found))


def _cloud_move(top: FloatArray, step: FloatArray) -> FloatArray:
    """Return (d,) how a cloud moves where the rig takes a step; of the smallest norm where its pokes do not tell."""
    unknowns = top.shape[1] - 1 - len(step)
    right = -(top[:, -1] + top[:, unknowns:-1] @ step)
    return np.asarray(np.linalg.lstsq(top[:, :unknowns], right, rcond=1e-9)[0], dtype=np.float64)


def _correction(state: RigState, names: list[str]) -> Correction:
    motions: dict[str, FloatArray] = {}
    for index, name in enumerate(names):
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = rotations(state.turns[index : index + 1])[0], state.shifts[index]
        motions[name] = motion
    return Correction(np.eye(6) + state.matrix, motions=motions)
