"""The fit of modules' poses: each module's least squares over all its pokes.

**A poke's place.** A poke lies where the answers say, not at each of the taxels that answered: at the middle
c = sum k_j P_j / sum k_j of the module's pads, off by a little in the skin (`offset_squares`). Its two rows are those of
`skincal.taxels.contact_table`, with c in the taxel's place: e_1.(c - a), e_2.(c - a). So a module is drawn to places that
are poked often no more than to others. A poke counts for the module that answers most.

**Its rows**, r = E (a - c), have the covariance

    D = E N E' + s^2 (I - o o'),   o = E n,

N the sensor's noise at the lever l of c (`uncertainty.h`), s how far a contact lies beside the middle, in the skin with the
normal n. Written as sums, so that nothing cancels where a lever is long or a push grazes the skin: with J a quarter turn,

    D = q I + p p' + r r',   q = (moment/|f|)^2 + (force/|f|)^2 (u.l)^2 + s^2 (u.n)^2,   p = force/|f| E l,   r = s J o,

and its determinant is q^2 + q (|p|^2 + |r|^2) + (p x r)^2. The rows are L^-1 r with D = L L'.

**The start** of the search is the pose that fits the estimates of the module's taxels, by other methods. With q_j the
estimates, b_j the pads in the module's plane and w_j = 1/(rms_j^2 + FLOOR^2), the turn that makes sum w |q - R b - t|^2
least in the plane across the mean normal is that of the complex number sum w conj(b - mean b)(q - mean q). Where its own
uncertainty, 1/sqrt(sum w |b - mean b|^2), is too large, the plan's turn is taken.

**The search.** The sum of squares of the whitened rows A, b is minimised over the module's unknowns, the noise taken as it is
at the pose. Gauss and Newton's step comes from QR of the rows (their condition is never squared), with the singular values of
the small factor giving the directions that the pokes determine. Alone it converges by a constant share each time, and goes to
and fro by millimetres where the pokes hardly determine a module's tilt. So the change of the rows with the pose is used as
well, B (`bends_of`), of the misses that the step would leave:

    step = R^-1 (I - R'^-1 B R^-1)^-1 Q'b,   A = Q R,

where that matrix is positive, else R^-1 Q'b. Both are zero at the same pose, where A'b is: B has no say in the answer, only
in how soon it is found.

**Trust** is that of `trust.h`, for the whole module: a poke far off what the others say counts less, measured against the
module's own spread. The others are those of the same arm pose, where they are enough: a pose that is reported wrong shifts
all its pokes, and none of them is to blame.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray, cross_matrix
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import LEVER, ModuleGround, ModuleModel, ModulePoses, ModulesOnSurface, Pads, crossed, joined
from skincal.taxels.contact_table import Evidence, across
from skincal.taxels.result import Estimate
from skincal.taxels.solve import triangle

MIDDLE = 1.6
"""The middle of n pads is off the contact by this many `NoiseSettings.contact` over n, each direction: measured on the
simulated forearm, 2.4, 1.5, 0.8 and 0.5 mm for one to four pads."""
ACROSS = 0.001
"""m: by how much more where another module answers too: the tip stands on both."""
SHARE_MIN = 0.5
"""A poke counts for a module that has at least this share of the answers."""


@dataclass(frozen=True, slots=True, eq=False)
class Touches:
    """m pokes on b modules, ordered by module, then by the poke's number."""

    modules: IntArray
    """(b,) indices in the layout, ascending."""
    of: IntArray
    """(m,) which of `modules` was touched, 0 to b - 1."""
    rows: IntArray
    """(m,) an answer of each poke in `evidence`."""
    evidence: Evidence
    offsets: FloatArray
    """(m,) float, m^2: `offset_squares`."""
    answers: IntArray
    """(a,) pads that answered, indices into the pads of all `modules`, one module after another."""
    shares: FloatArray
    """(a,) float: of its poke's middle; those of a poke sum to 1."""
    channels: IntArray
    """(n,) the channels of the pads of all `modules`, one module after another."""
    starts: IntArray
    """(m,) where the answers of each poke begin."""

    def channels_of(self, touch: int) -> IntArray:
        """Return the channels that answered a poke, those of its module."""
        end = self.starts[touch + 1] if touch + 1 < len(self.starts) else len(self.answers)
        return self.channels[self.answers[self.starts[touch] : end]]

    def middles(self, pads: Pads) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the places (m, 3), metres, gradients (m, 3, d) and normals (m, 3), unit, of the pokes' middles."""
        shares = self.shares[:, None]
        points = np.add.reduceat(shares * pads.points[self.answers], self.starts, axis=0)
        gradients = np.add.reduceat(shares[:, None] * pads.gradients[self.answers], self.starts, axis=0)
        normals = np.add.reduceat(shares * pads.normals[self.answers], self.starts, axis=0)
        return points, gradients, normals / np.sqrt(np.sum(normals * normals, axis=1, keepdims=True))


def offset_squares(answering: IntArray, across: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return (m,) the variance of a contact about the middle of the pads that answered, each direction, m^2.

    Parameters
    ----------
    answering : (m,) pads of the module that answered
    across : (m,) float, 0 to 1: share of the answers that other modules gave
    """
    return np.asarray((MIDDLE * noise.contact / answering) ** 2 + np.where(across > 1e-9, ACROSS**2, 0.0))


def find_touches(
    evidence: Evidence, totals: FloatArray, model: ModuleModel, noise: NoiseSettings, wanted: Collection[int]
) -> Touches:
    """Return the pokes on the modules `wanted`; one that touches several modules counts where most answered.

    Parameters
    ----------
    evidence : of channels of the layout, all of a module's that are used or none
    totals : (n,) float, the sum of the weights of all answers of an answer's poke, of other channels too
    wanted : indices of modules
    """
    channels = evidence.channels[evidence.taxels]
    owners = model.layout.module_of[channels]
    order = np.lexsort((channels, evidence.pokes, owners))
    ordered, pokes = owners[order], evidence.pokes[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]) | (pokes[1:] != pokes[:-1])
    firsts = np.flatnonzero(new)
    sums = np.add.reduceat(evidence.weights[order], firsts) if len(firsts) else np.empty(0)
    share = sums / totals[order[firsts]]
    sizes = np.diff(np.append(firsts, len(order)))
    kept = (share > SHARE_MIN) & np.isin(ordered[firsts], list(wanted))
    answers = order[np.repeat(kept, sizes)]
    rows, sizes, sums, share = order[firsts[kept]], sizes[kept], sums[kept], share[kept]
    modules = np.unique(owners[rows])
    indices: list[int] = modules.tolist()
    begins = np.cumsum([0, *(len(model.pads[module]) for module in indices)])
    return Touches(
        modules=modules,
        of=np.searchsorted(modules, owners[rows]),
        rows=rows,
        evidence=evidence,
        offsets=offset_squares(sizes, 1.0 - share, noise),
        answers=begins[np.searchsorted(modules, owners[answers])] + model.place_of[channels[answers]],
        shares=evidence.weights[answers] / np.repeat(sums, sizes),
        channels=np.array(model.channels_of(indices), dtype=np.int64),
        starts=np.cumsum(np.append(0, sizes))[:-1],
    )


@dataclass(frozen=True, slots=True, eq=False)
class RowSpread:
    """The covariance D of each of m pokes: even I + swing swing' + skin skin'."""

    even: FloatArray
    """(m,) float, m^2: q."""
    swing: FloatArray
    """(m, 2) float, metres: p, of the force's noise at the lever."""
    skin: FloatArray
    """(m, 2) float, metres: r, of the contact's place in the skin."""
    push: FloatArray
    """(m, 2) float, metres: the roots of q's parts that change with the pose, force/|f| u.l and s u.n."""
    share: FloatArray
    """(m,) float: force/|f|."""


@dataclass(frozen=True, slots=True, eq=False)
class ModuleRows:
    """The whitened rows of m pokes."""

    slopes: FloatArray
    """(m, 2, d) float, 1/m: change of the middle across the push with the module's unknowns, in standard deviations."""
    misses: FloatArray
    """(m, 2) float: how far the axis passes the middle, in standard deviations."""
    pitches: FloatArray
    """(m,) float: squared pitch, in standard deviations."""
    whiten: FloatArray
    """(m, 2, 2) float, 1/m: L^-1."""
    distances: FloatArray
    """(m,) float, metres: how far the axis passes the middle."""
    levers: FloatArray
    """(m, 3) float, metres: from the sensor to the middle."""
    gradients: FloatArray
    """(m, 3, d) float: change of the middle with the module's unknowns."""
    normals: FloatArray
    """(m, 3) float, unit, outward: of the skin at the middle."""
    spread: RowSpread


def whitened(touches: Touches, pads: Pads, noise: NoiseSettings) -> ModuleRows:
    """Return the rows of pokes whose modules have their pads at `pads`."""
    evidence, at = touches.evidence, touches.rows
    places, gradients, normals = touches.middles(pads)
    pairs, pushes, forces = evidence.pairs[at], evidence.directions[at], evidence.forces[at]
    lever, share, beside = places - evidence.sensors[at], noise.force / forces, np.sqrt(touches.offsets)
    moment = (noise.moment / forces) ** 2
    swing, out = (np.sum(pairs * v[:, None], axis=2) for v in (share[:, None] * lever, beside[:, None] * normals))
    push = np.stack([share * np.sum(pushes * lever, axis=1), beside * np.sum(pushes * normals, axis=1)], axis=1)
    skin = np.stack([-out[:, 1], out[:, 0]], axis=1)
    spread = RowSpread(moment + np.sum(push * push, axis=1), swing, skin, push, share)
    whiten = _inverse_root(spread)
    off = np.sum(pairs * (evidence.nearest[at] - places)[:, None], axis=2)
    slopes = np.sum(pairs[:, :, :, None] * gradients[:, None], axis=2)
    return ModuleRows(
        slopes=np.sum(whiten[:, :, :, None] * slopes[:, None], axis=2),
        misses=np.sum(whiten * off[:, None], axis=2),
        pitches=evidence.pitches[at] ** 2 / (moment + np.sum(swing * swing, axis=1)),
        whiten=whiten,
        distances=np.sqrt(np.sum(off * off, axis=1)),
        levers=lever,
        gradients=gradients,
        normals=normals,
        spread=spread,
    )


def _inverse_root(spread: RowSpread) -> FloatArray:
    """Return (m, 2, 2) L^-1 of D = L L', L lower triangular."""
    even, p, r = spread.even, spread.swing, spread.skin
    xx = even + p[:, 0] ** 2 + r[:, 0] ** 2
    xy = p[:, 0] * p[:, 1] + r[:, 0] * r[:, 1]
    cross = p[:, 0] * r[:, 1] - p[:, 1] * r[:, 0]
    determinant = even * (even + np.sum(p * p + r * r, axis=1)) + cross * cross
    l11 = np.sqrt(xx)
    l22 = np.sqrt(determinant) / l11
    inverse = np.zeros((len(xx), 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 0], inverse[:, 1, 1] = 1.0 / l11, -xy / (xx * l22), 1.0 / l22
    return inverse


def bends_of(touches: Touches, rows: ModuleRows, ground: ModuleGround) -> FloatArray:
    """Return (m, d, d): how A'b of each poke changes with the unknowns but for -A'A, A its slopes and b its misses.

    With w = D^-1 E (a - c) that is w'E d2c - (D^-1 E dc)' dD w; a turn about an axis changes dc by axis x dc, n by axis x n.
    """
    spread, at = rows.spread, touches.rows
    pairs, pushes = touches.evidence.pairs[at], touches.evidence.directions[at]
    back = rows.whiten.transpose(0, 2, 1)
    slopes, w = back @ rows.slopes, back @ rows.misses[:, :, None]
    axes = ground.axes(rows.normals) / LEVER
    turns = axes.shape[1]
    swing = spread.share[:, None, None] * rows.gradients
    pushed, parts = spread.push[:, 0, None, None] * swing, [(spread.swing, pairs @ swing)]
    if turns > 1:
        # Without a surface the module's normal turns, too.
        skin = np.zeros_like(rows.gradients)
        tilted = crossed(axes, rows.normals[:, None]).transpose(0, 2, 1)
        skin[:, :, -turns:] = np.sqrt(touches.offsets)[:, None, None] * tilted
        out = pairs @ skin
        pushed = pushed + spread.push[:, 1, None, None] * skin
        parts.append((spread.skin, np.stack([-out[:, 1], out[:, 0]], axis=1)))
    bent = -2.0 * (slopes.transpose(0, 2, 1) @ w) @ (pushes[:, None] @ pushed)
    for part, change in parts:
        row = part[:, None]
        bent -= slopes.transpose(0, 2, 1) @ change * (row @ w)
        bent -= (row @ slopes).transpose(0, 2, 1) @ (w.transpose(0, 2, 1) @ change)
    # w'E . (axis x dc) = (w'E x axis) . dc
    pull = crossed(w.transpose(0, 2, 1) @ pairs, axes)
    bent[:, -turns:, -turns:] += pull @ rows.gradients[:, :, -turns:]
    return bent


FLOOR = 0.002
"""m: no estimate is taken for better known than this, so that one does not outvote the rest."""
TURN_SD_MAX = 0.35
"""rad: where estimates determine the turn worse than this, the plan's is taken; a search finds its way back from 60 degrees."""
FAR = 0.004
"""m: estimates farther than this from where the others put them count less."""
ROUNDS = 3
"""Of weighing the estimates anew."""


def start_of(model: ModuleModel, module: int, others: Sequence[Mapping[int, Estimate]]) -> ModulePoses | None:
    """Return where the search for a module's pose begins, one pose; None where neither estimates nor plan say.

    Parameters
    ----------
    others : estimates by channel, the best method first
    """
    plan = model.plan(module)
    for estimates in others:
        begun = _from_estimates(model, module, estimates, plan)
        if begun is not None:
            return begun
    return plan


def _from_estimates(
    model: ModuleModel, module: int, estimates: Mapping[int, Estimate], plan: ModulePoses | None
) -> ModulePoses | None:
    channels = model.layout.modules[module].channels.tolist()
    found = [(pad, estimates[channel]) for pad, channel in enumerate(channels) if channel in estimates]
    known = [(pad, est) for pad, est in found if est.position is not None and est.normal is not None and est.rms is not None]
    if not known:
        return None
    pads = model.pads[module][[pad for pad, _ in known]]
    places = np.array([estimate.position for _, estimate in known])
    weights = np.array([1.0 / ((estimate.rms or 0.0) ** 2 + FLOOR**2) for _, estimate in known])
    normal = np.sum(weights[:, None] * np.array([estimate.normal for _, estimate in known]), axis=0)
    if plan is not None and (not np.any(normal) or not isinstance(model.ground, ModulesOnSurface)):
        # Against the pushes is worse known than the plan where there is no surface.
        normal = plan.normals[0]
    length = float(np.sqrt(normal @ normal))
    return None if length == 0 else _fitting(model, pads, places, weights, normal / length, plan)


def _fitting(
    model: ModuleModel, pads: FloatArray, places: FloatArray, weights: FloatArray, normal: FloatArray, plan: ModulePoses | None
) -> ModulePoses | None:
    """Return the pose that fits places (n, 3) of pads (n, 2), seen along `normal`."""
    x, y = _axes(normal, plan)
    # Points of a plane as complex numbers: to turn is to multiply.
    flat, own = places @ (x + 1j * y), pads @ np.array([1.0, 1j])
    counts, turn, shift = weights, 1.0 + 0.0j, 0.0j
    for _ in range(ROUNDS):
        middle, centre = counts @ own / counts.sum(), counts @ flat / counts.sum()
        product = np.sum(counts * np.conj(own - middle) * (flat - centre))
        known = np.sum(counts * np.abs(own - middle) ** 2) * TURN_SD_MAX**2 > 1.0 and abs(product) > 0
        if not known and plan is None:
            return None
        turn = product / abs(product) if known else 1.0 + 0.0j
        shift = centre - turn * middle
        counts = weights / (1.0 + np.abs(flat - turn * own - shift) ** 2 / FAR**2)
    height = float(counts @ (places @ normal) / counts.sum())
    origin = shift.real * x + shift.imag * y + height * normal
    return _on_ground(model.ground, origin, turn.real * x + turn.imag * y, normal)


def _axes(normal: FloatArray, plan: ModulePoses | None) -> tuple[FloatArray, FloatArray]:
    """Return two directions across `normal`, the plan's x as far as it is across."""
    x = across(normal[None])[0, 0] if plan is None else plan.x[0] - (plan.x[0] @ normal) * normal
    length = float(np.sqrt(x @ x))
    x = x / length if length > 0.1 else across(normal[None])[0, 0]
    return x, np.asarray(np.cross(normal, x), dtype=np.float64)


def _on_ground(ground: ModuleGround, origin: FloatArray, x: FloatArray, normal: FloatArray) -> ModulePoses | None:
    """Return a pose brought onto the surface, where there is one; None where the surface faces away or along x."""
    if not isinstance(ground, ModulesOnSurface):
        return ModulePoses(origin[None], x[None], normal[None], np.full(1, -1, dtype=np.int64))
    # Imported only now: a scene without a mesh loads nothing of it.
    from skincal.mesh.search import nearest_points

    point, triangle = nearest_points(ground.surface, origin[None])
    facing = ground.surface.normals[triangle]
    x = x - (x @ facing[0]) * facing[0]
    length = float(np.sqrt(x @ x))
    if facing[0] @ normal <= 0 or length < 0.1:
        return None
    return ModulePoses(point, (x / length)[None], facing, triangle)


FULL, NONE = 2.8, 3.8
"""Standard deviations up to which a poke counts fully, and from which on not at all: as in `trust.h`."""
FEWEST = 4
"""Pokes of a module below which all count fully."""
OF_POSE = 8
"""Pokes of a module in one arm pose from which on they are judged by themselves: twice the fewest."""
LEFT = 2.0
"""Sum of the trust below which all count fully: nobody can say which poke is right."""
ALIKE = 2.0
"""Standard deviations up to which all pokes pull alike while the pose is sought."""
SEEKING = 4
"""Steps of that search before trust is given."""
SMALL = 6.0
"""A spread found from few misses is raised by this over its 2 n - 3 degrees of freedom."""
USUAL_MISS, USUAL_PITCH = 1.3863, 0.4549
"""Medians of chi-square with two degrees of freedom and with one."""
STEP_MAX = 0.015
"""m, of one step in each direction: half a module. Farther off the rows say little of where the minimum is."""
SETTLED = 1e-7
"""m: steps below it that no longer shrink to half are rounding."""
DONE = 2e-17
"""m: where the next step would be below this, it is none: the last digit of a place two decimetres away."""
HOLDS = 0.25
"""The least curvature, over that of the rows alone, at which it shapes the step: below, a saddle is near."""
BACK = 0.25
"""A step that takes back this share of the one before is halved: both go too far."""
STEPS_MAX = 20
"""A pose that moves after so many steps goes to and fro over an edge of the surface, by micrometres; or, without a surface,
runs off where few pokes hardly determine how the module is tilted."""
NO_RANK = 1e-9
"""Singular values below this share of the largest: what they belong to, the pokes do not determine."""


def trust_of(squares: FloatArray) -> FloatArray:
    """Return how far pokes count, 0 to 1, by their squared distances in standard deviations: as in `trust.h`, smoothly."""
    rest = np.clip((NONE - np.sqrt(squares)) / (NONE - FULL), 0.0, 1.0)
    return np.where(squares > FULL**2, rest * rest * (3.0 - 2.0 * rest), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The poses of b modules."""

    poses: ModulePoses
    pads: Pads
    """Of all modules, one after another."""
    of: IntArray
    """(n,) the module of each pad, 0 to b - 1."""
    covariances: FloatArray
    """(b, d, d) float, m^2, of the unknowns (a turn as the way at `LEVER`); infinite along `blind`."""
    blind: tuple[FloatArray, ...]
    """For each module (k, d) the directions of its unknowns that the pokes do not determine."""
    misses: FloatArray
    """(b,) float, metres: at what distance the axes pass the middles, the root mean square by trust."""
    trust: FloatArray
    """(m,) float, 0 to 1, of each poke."""
    moving: FloatArray
    """(b,) float, metres: the last step of a pose that has not settled; 0 of one that has."""


def fit_poked(
    evidence: Evidence,
    totals: FloatArray,
    model: ModuleModel,
    noise: NoiseSettings,
    others: Sequence[Mapping[int, Estimate]],
    doubting: bool = True,
) -> tuple[Touches, Fitted] | None:
    """Find the poses of all modules that pokes touched, from where `start_of` puts them; None where there is none.

    Parameters
    ----------
    evidence, totals : as for `find_touches`
    others : estimates by channel, the best method first
    doubting : whether pokes far off the others count less
    """
    begun = {module: start_of(model, module, others) for module in model.modules_of(evidence.channels.tolist())}
    starts = {module: pose for module, pose in begun.items() if pose is not None}
    touches = find_touches(evidence, totals, model, noise, starts)
    if not len(touches.modules):
        return None
    start = joined([starts[module] for module in touches.modules.tolist()])
    return touches, fit_modules(touches, model, start, noise, doubting)


def fit_modules(
    touches: Touches, model: ModuleModel, start: ModulePoses, noise: NoiseSettings, doubting: bool = True
) -> Fitted:
    """Find the poses of the modules of `touches`.

    Parameters
    ----------
    start : of each module; within half a module and 60 degrees
    doubting : whether pokes far off the others count less
    """
    search = _Search(touches, model, start, noise)
    if doubting:
        search.trust = np.concatenate([_trust_of(search.rows, span, touches) for span in search.spans])
    for _ in range(STEPS_MAX):
        search.step()
        if not search.going.any():
            break
    held = search.found()
    return Fitted(
        search.poses,
        search.pads,
        search.of,
        np.stack([_covariance(touches, module, search.trust, noise) for module in held]),
        tuple(module.blind for module in held),
        np.array([_miss(module, search.trust) for module in held]),
        search.trust,
        search.moving,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """How the rows hold one module where it stands, in the k directions of its unknowns that they determine."""

    singular: FloatArray
    """(k,) float, 1/m: how firmly."""
    axes: FloatArray
    """(k, d) float, unit: these directions."""
    right: FloatArray
    """(k,) float: how far off along them, in standard deviations."""
    blind: FloatArray
    """(d - k, d) float, unit: the others."""
    rows: ModuleRows
    """Of all modules."""
    span: slice
    """Its own among them."""

    @property
    def inverse(self) -> FloatArray:
        """(d, k) float, metres: its square is the covariance of the unknowns."""
        return self.axes.T / self.singular

    def left(self) -> FloatArray:
        """Return (m, 2) what would be left of the module's misses if its rows were linear, however far it had to go."""
        return self.rows.misses[self.span] - np.sum(self.rows.slopes[self.span] * (self.inverse @ self.right), axis=2)


class _Search:
    """Modules on their way to where the rows hold them best; those that have settled stay, however long others take."""

    def __init__(self, touches: Touches, model: ModuleModel, start: ModulePoses, noise: NoiseSettings) -> None:
        ends = np.searchsorted(touches.of, np.arange(len(touches.modules) + 1)).tolist()
        self.spans = [slice(a, b) for a, b in pairwise(ends)]
        modules: list[int] = touches.modules.tolist()
        own = [model.pads[module] for module in modules]
        self.of, self._flat = np.repeat(np.arange(len(own)), [len(pads) for pads in own]), np.concatenate(own)
        self._touches, self._ground, self._noise = touches, model.ground, noise
        self.trust = np.ones(len(touches.of))
        self.poses, self.pads = start, self._laid(start)
        self.rows = whitened(touches, self.pads, noise)
        self.going = np.ones(len(own), dtype=bool)
        self._before, self._last = np.zeros((len(own), model.ground.unknowns)), np.full(len(own), STEP_MAX)
        self._held: list[_Held | None] = [None] * len(own)

    def _laid(self, poses: ModulePoses) -> Pads:
        return self._ground.laid(poses.take(self.of), self._flat)

    def step(self) -> None:
        """Move the modules that have not settled, each by one step; the last one is too short to be walked."""
        held = self.found()
        left = np.concatenate([module.left() for module in held])
        bends = bends_of(self._touches, replace(self.rows, misses=left), self._ground)
        steps = np.stack([_newton(module, bends[module.span], self.trust[module.span]) for module in held])
        back = np.sum(steps * self._before, axis=1) < -BACK * np.sum(self._before * self._before, axis=1)
        steps = np.where(back[:, None], 0.5, 1.0) * steps
        sizes = np.abs(steps).max(axis=1)
        settled = (sizes <= SETTLED) & ((sizes * sizes <= DONE * self._last) | (2.0 * sizes >= self._last))
        # A module that has settled stays as it was found there, whatever another step would be.
        settled |= ~self.going
        ended = self.going & settled
        self.poses = _chosen(self.going, self._ground.moved(self.poses, steps), self.poses)
        self.pads = _chosen(ended[self.of], _shifted(self.pads, steps[self.of]), self.pads)
        self._held = [module if end else None for module, end in zip(held, settled, strict=True)]
        self.going, self._before, self._last = self.going & ~settled, steps, sizes
        if self.going.any():
            self.pads = _chosen(self.going[self.of], self._laid(self.poses), self.pads)
            self.rows = whitened(self._touches, self.pads, self._noise)

    @property
    def moving(self) -> FloatArray:
        """(b,) float, metres: the last step of modules that have not settled, 0 of the others."""
        return np.where(self.going, self._last, 0.0)

    def found(self) -> list[_Held]:
        """Return how each module is held; of those that have settled, at their last step."""
        return [
            _holding(self.rows, span, self.trust[span]) if module is None else module
            for module, span in zip(self._held, self.spans, strict=True)
        ]


_Rows = TypeVar("_Rows", ModulePoses, Pads)


def _chosen(first: NDArray[np.bool_], here: _Rows, there: _Rows) -> _Rows:
    """Return the rows of `here` where `first` (n,), else those of `there`."""
    if first.all() or not first.any():
        return here if first.all() else there
    own, other = ([np.asarray(getattr(rows, field.name)) for field in fields(here)] for rows in (here, there))
    pairs = zip(own, other, strict=True)
    return type(here)(*(np.where(first.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs))


def _shifted(pads: Pads, steps: FloatArray) -> Pads:
    """Return the pads (n,) after steps (n, d) of their modules that are too short for more than the gradient."""
    return replace(pads, points=pads.points + np.sum(pads.gradients * steps[:, None], axis=2))


def _trust_of(rows: ModuleRows, span: slice, touches: Touches) -> FloatArray:
    """Return the trust of one module's pokes, each judged among those of its arm pose, or among all that are left over."""
    poses = touches.evidence.poses[touches.rows[span]]
    names, owner, sizes = np.unique(poses, return_inverse=True, return_counts=True)
    group = np.where(sizes >= OF_POSE, np.arange(len(names)), -1)[owner]
    trust = np.ones(len(poses))
    for own in np.unique(group):
        some = np.flatnonzero(group == own)
        at = some + span.start
        trust[some] = _found_trust(rows.slopes[at], rows.misses[at], rows.pitches[at])
    return trust if trust.sum() >= LEFT else np.ones(len(poses))


def _found_trust(slopes: FloatArray, misses: FloatArray, pitches: FloatArray) -> FloatArray:
    """Return the trust of some of a module's pokes, by steps from its pose in which far pokes pull little."""
    count = len(misses)
    if count < FEWEST:
        return np.ones(count)
    raised = 1.0 + SMALL / max(2 * count - 3, 1)
    pitches = pitches / max(1.0, raised * float(np.median(pitches)) / USUAL_PITCH)
    left = misses
    for _ in range(SEEKING):
        squares = np.sum(left * left, axis=1) + pitches
        move = _step(slopes, left, 1.0 / np.maximum(squares, ALIKE**2))
        left = left - np.sum(slopes * move, axis=2)
    squares = np.sum(left * left, axis=1)
    squares = squares / max(1.0, raised * float(np.median(squares)) / USUAL_MISS) + pitches
    trust = trust_of(squares)
    return trust if trust.sum() >= LEFT else np.ones(count)


def _step(slopes: FloatArray, misses: FloatArray, trust: FloatArray) -> FloatArray:
    """Return (d,) Gauss and Newton's step, of the smallest norm where the rows do not determine one, and not too long."""
    singular, axes, right = _decomposed(slopes, misses, trust)
    good = singular > NO_RANK * singular[0]
    return axes[good].T @ _short(right[good] / singular[good])


def _by_size(slopes: FloatArray) -> IntArray:
    """Return an order of pokes in which sums do not depend on how the pokes are numbered."""
    return np.argsort(-np.sum(slopes * slopes, axis=(1, 2)), kind="stable")


def _holding(rows: ModuleRows, span: slice, trust: FloatArray) -> _Held:
    slopes, misses = rows.slopes[span], rows.misses[span]
    order = _by_size(slopes)
    singular, axes, right = _decomposed(slopes[order], misses[order], trust[order])
    good = singular > NO_RANK * singular[0]
    return _Held(singular[good], axes[good], right[good], axes[~good], rows, span)


def _newton(held: _Held, bends: FloatArray, trust: FloatArray) -> FloatArray:
    """Return (d,) the step of one module, which uses how its rows change, `bends` (m, d, d), where that leaves it held."""
    inverse, right, order = held.inverse, held.right, _by_size(held.rows.slopes[held.span])
    bend = np.sum(trust[order][:, None, None] * bends[order], axis=0)
    curvature = np.eye(len(right)) - inverse.T @ bend @ inverse
    if len(right) and np.linalg.eigvalsh(curvature + curvature.T)[0] > 2.0 * HOLDS:
        right = np.asarray(np.linalg.solve(curvature, right), dtype=np.float64)
    return held.axes.T @ _short(right / held.singular)


def _short(ways: FloatArray) -> FloatArray:
    """Return ways along the directions of singular values, none too long: one hardly known does not hold up the others."""
    return np.clip(ways, -STEP_MAX, STEP_MAX)


def _decomposed(slopes: FloatArray, misses: FloatArray, trust: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return singular values (d,), their directions (d, d) as rows and right sides (d,) of the weighted rows."""
    unknowns = slopes.shape[-1]
    root = np.sqrt(trust)[:, None]
    factor = triangle((root[:, :, None] * slopes).reshape(-1, unknowns), (root * misses).ravel())
    left, singular, axes = np.linalg.svd(factor[:, :unknowns])
    return singular, axes, left.T @ factor[:, unknowns]


def _covariance(touches: Touches, held: _Held, trust: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return the covariance (d, d) of a module's unknowns."""
    covariance = held.inverse @ held.inverse.T
    if noise.pose_turn > 0 or noise.pose_shift > 0:
        slopes, trust = held.rows.slopes[held.span], trust[held.span]
        gain = covariance @ (trust[:, None, None] * slopes).reshape(-1, slopes.shape[-1]).T
        covariance = covariance + _of_poses(touches, held.rows, held.span, gain, noise)
    return covariance


def _miss(held: _Held, trust: FloatArray) -> float:
    weights, distances = trust[held.span], held.rows.distances[held.span]
    return float(np.sqrt(np.sum(weights * distances**2) / max(weights.sum(), 1e-300)))


def _of_poses(touches: Touches, rows: ModuleRows, span: slice, gain: FloatArray, noise: NoiseSettings) -> FloatArray:
    """Return (d, d) what errors of the arm's poses add, each one for all pokes in it (`NoiseSettings.pose_turn`)."""
    evidence, at = touches.evidence, touches.rows[span]
    pairs = evidence.pairs[at]
    # A pose turned by w about the sensor and shifted by t moves the axis by w x lever + t.
    moved = np.concatenate([-noise.pose_turn * (pairs @ cross_matrix(rows.levers[span])), noise.pose_shift * pairs], axis=2)
    moved = (rows.whiten[span] @ moved).reshape(-1, 6)
    added = np.zeros((len(gain), len(gain)))
    owners = np.repeat(evidence.poses[at], 2)
    for pose in np.unique(owners):
        own = owners == pose
        part = gain[:, own] @ moved[own]
        added += part @ part.T
    return added
