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
well, B (`ModuleRows.bends`), of the misses that the step would leave:

    step = R^-1 (I - R'^-1 B R^-1)^-1 Q'b,   A = Q R,

where that matrix is positive, else R^-1 Q'b. Both are zero at the same pose, where A'b is: B has no say in the answer, only
in how soon it is found.

**Trust** is that of `trust.h`, for the whole module: a poke far off what the others say counts less, measured against the
module's own spread. The others are those of the same arm pose, where they are enough: a pose that is reported wrong shifts
all its pokes, and none of them is to blame.

Touches, starts and thresholds are found here; rows, trust and search are done in `skincal/solver/source/modules.h`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import LEVER, ModuleGround, ModuleModel, ModulePoses, ModulesOnSurface, Pads, join_poses
from skincal.solver.machine import INTEGER, Call, Machine, shared
from skincal.taxels.contact_table import Evidence, orthonormal_pair
from skincal.taxels.result import Estimate

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

    def contact_centres(self, pads: Pads) -> tuple[FloatArray, FloatArray, FloatArray]:
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


def assign_pokes(
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
class ModuleRows:
    """The whitened rows of m pokes."""

    slopes: FloatArray
    """(m, 2, d) float, 1/m: change of the middle across the push with the module's unknowns, in standard deviations."""
    misses: FloatArray
    """(m, 2) float: how far the axis passes the middle, in standard deviations."""
    whiten: FloatArray
    """(m, 2, 2) float, 1/m: L^-1."""
    normals: FloatArray
    """(m, 3) float, unit, outward: of the skin at the middle."""
    bends: FloatArray
    """(m, d, d) float: how A'b of each poke changes with the unknowns but for -A'A, A its slopes and b its misses."""


def whitened_rows(touches: Touches, pads: Pads, noise: NoiseSettings) -> ModuleRows:
    """Return the rows of pokes whose modules have their pads at `pads`."""
    count, unknowns = len(touches.of), pads.gradients.shape[2]
    with shared().call() as call:
        asked = _asked(call, touches, noise, unknowns)
        laid = [call.give(pads.points), call.give(pads.gradients), call.give(pads.normals)]
        shapes = ((count, 2, unknowns), (count, 2), (count, 2, 2), (count, 3), (count, unknowns, unknowns))
        places = [call.room(shape) for shape in shapes]
        call.run("module_rows", [*asked, *laid, *places])
        return ModuleRows(*map(call.taken, places))


def _asked(call: Call, touches: Touches, noise: NoiseSettings, unknowns: int) -> list[int]:
    """Return what `Touches` in `skincal/solver/source/modules.h` begins with, up to the pads."""
    evidence, at = touches.evidence, touches.rows
    rules = (
        LEVER, FULL, NONE, FEWEST, OF_POSE, LEFT, ALIKE, SEEKING, SMALL, USUAL_MISS, USUAL_PITCH, STEP_MAX, SETTLED, DONE,
        HOLDS, BACK, STEPS_MAX, NO_RANK,
    )  # fmt: skip
    return [
        len(at),
        unknowns,
        call.give(np.append(touches.starts, len(touches.answers)), INTEGER),
        call.give(touches.answers, INTEGER),
        call.give(touches.shares),
        call.give(evidence.columns.take(at, axis=1)),
        call.give(evidence.poses[at], INTEGER),
        call.give(touches.offsets),
        call.give(np.array([noise.force, noise.moment, noise.pose_turn, noise.pose_shift])),
        call.give(np.array(rules)),
    ]


FLOOR = 0.002
"""m: no estimate is taken for better known than this, so that one does not outvote the rest."""
TURN_SD_MAX = 0.35
"""rad: where estimates determine the turn worse than this, the plan's is taken; a search finds its way back from 60 degrees."""
FAR = 0.004
"""m: estimates farther than this from where the others put them count less."""
ROUNDS = 3
"""Of weighing the estimates anew."""


def find_start(model: ModuleModel, module: int, others: Sequence[Mapping[int, Estimate]]) -> ModulePoses | None:
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
    x = orthonormal_pair(normal[None])[0, 0] if plan is None else plan.x[0] - (plan.x[0] @ normal) * normal
    length = float(np.sqrt(x @ x))
    x = x / length if length > 0.1 else orthonormal_pair(normal[None])[0, 0]
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


def trust_from_squares(squares: FloatArray) -> FloatArray:
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
    """(b, d, d) float, m^2, of the unknowns (a turn as the way at `LEVER`); without meaning along `blind`."""
    blind: FloatArray
    """(b, d, d) float: of each module the directions of its unknowns that the pokes do not determine, the other rows zero."""
    misses: FloatArray
    """(b,) float, metres: at what distance the axes pass the middles, the root mean square by trust."""
    trust: FloatArray
    """(m,) float, 0 to 1, of each poke."""
    moving: FloatArray
    """(b,) float, metres: the last step of a pose that has not settled; 0 of one that has."""


def fit_modules_from_pokes(
    evidence: Evidence,
    totals: FloatArray,
    model: ModuleModel,
    noise: NoiseSettings,
    others: Sequence[Mapping[int, Estimate]],
    doubting: bool = True,
) -> tuple[Touches, Fitted] | None:
    """Find the poses of all modules that pokes touched, from where `find_start` puts them; None where there is none.

    Parameters
    ----------
    evidence, totals : as for `assign_pokes`
    others : estimates by channel, the best method first
    doubting : whether pokes far off the others count less
    """
    begun = {module: find_start(model, module, others) for module in model.modules_of(evidence.channels.tolist())}
    starts = {module: pose for module, pose in begun.items() if pose is not None}
    touches = assign_pokes(evidence, totals, model, noise, starts)
    if not len(touches.modules):
        return None
    start = join_poses([starts[module] for module in touches.modules.tolist()])
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
    modules: list[int] = touches.modules.tolist()
    own = [model.pads[module] for module in modules]
    sizes, count, unknowns = [len(pads) for pads in own], len(own), model.ground.unknowns
    machine, ground = _machine(model.ground)
    with machine.call() as call:
        asked = _asked(call, touches, noise, unknowns)
        pads = [call.room(shape) for shape in ((sum(sizes), 3), (sum(sizes), 3, unknowns), (sum(sizes), 3))]
        spans = np.searchsorted(touches.of, np.arange(count + 1))
        cut = [call.give(spans, INTEGER), call.give(np.cumsum([0, *sizes]), INTEGER), call.give(np.concatenate(own)), ground]
        trust = call.changed(np.ones(len(touches.of)))
        poses = [call.changed(vectors) for vectors in (start.points, start.x, start.normals)]
        poses.append(call.changed(start.triangles, INTEGER))
        under, of_unknowns = call.room((sum(sizes),), INTEGER), (count, unknowns, unknowns)
        held = [call.room(shape) for shape in (of_unknowns, of_unknowns, (count,), (count,))]
        call.run("place_modules", [*asked, *pads, count, int(doubting), *cut, trust, *poses, under, *held])
        points, gradients, normals = map(call.taken, pads)
        at, x, outward, triangles = map(call.taken, poses)
        covariances, blind, misses, moving = map(call.taken, held)
        return Fitted(
            poses=ModulePoses(at, x, outward, triangles.astype(np.int64)),
            pads=Pads(points, gradients, normals, call.taken(under).astype(np.int64)),
            of=np.repeat(np.arange(count), sizes),
            covariances=covariances,
            blind=blind,
            misses=misses,
            trust=call.taken(trust),
            moving=moving,
        )


def _machine(ground: ModuleGround) -> tuple[Machine, int]:
    """Return the machine that places modules, and the place of what they lie on there; 0 for no surface."""
    if not isinstance(ground, ModulesOnSurface):
        return shared(), 0
    # Imported only now: a scene without a mesh loads nothing of it.
    from skincal.mesh.geodesics import geodesics_of

    known = geodesics_of(ground.surface)
    return known.machine, known.ground
