"""Checks that the readings of three axes give: dead x or y, pokes with another shear than the wrench, z off the mesh.

**Dead axis.** Let L be the least rms of the pokes' forces along any direction across their mean. Each axis along the skin
then reads at least (g rho L) rms, however the taxel is turned: g is the gain across the skin and rho the usual ratio of gains.
An axis that reads less than `WEAK_MAX_SHARE` of it does not answer.

A taxel with a dead z never answers where the push counts. It shows in pokes that its x and y answer, and its z never does.

**Another shear.** The skin and the force/torque sensor measure the same force. All pressed taxels of a poke read it in another
direction than their other pokes say: the tip slipped, something else was touched, or the tare is wrong. Taxels have the noise
of the whole skin, so a miss of `ZERO_TRUST_SDS` is rare (1 in 1400), and material that bulges stays below `MIN_SHEAR_MISS`.

**z off the mesh.** A taxel has its z across its own surface, so it lies near the normal of the mesh. Taxels that report in the
axes of a housing do not: they are left out.

**Unit.** Taxels in newtons that push more together than the force are in another unit.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.axes.module_axes import AXIS_NAMES
from skincal.axes.skin_turns import SkinTurns
from skincal.axes.turn_fit import AxisPokes
from skincal.contacts.outcome import Contact
from skincal.contacts.value_order import ValueOrderCounts
from skincal.geometry import FloatArray
from skincal.solver.tables import ZERO_TRUST_SDS

MIN_POKES_OF_DEAD_AXIS = 6
STUCK_MAX_SHARE = 1e-6
"""Range of a stuck value over the largest reading: only rounding of the mean."""
WEAK_MAX_SHARE = 0.15
"""Of the least reading that an axis has. Gains of one batch differ by 10 %, their ratios by a factor of two at most."""
EXPECTED_MIN_NOISES = 4.0
EXPECTED_MIN_SHARE = 0.05
"""Of a reading. Pokes that lean less say nothing about x and y."""
MIN_POKES_OF_UNIT = 6
MAX_SHARE_OF_FORCE = 2.0
"""Push of all taxels over the force: calibrations of single taxels are off by some tens of percent."""
MIN_SHEAR_MISS = float(np.radians(12.0))
"""rad, between a reading and the force. Bulging material and crosstalk turn readings by some degrees."""
MIN_OTHER_POKES_OF_MISS = 4
"""Of each pressed taxel: fewer do not say what its turn is."""
MAX_LEAN_FROM_MESH = float(np.radians(15.0))
"""rad, of z from the normal of the mesh: taxels are glued within 3 to 5 degrees, and coarse meshes bend by 5 to 10."""
LEAN_MIN_SDS = 4.0


@dataclass(frozen=True, slots=True)
class DeadAxis:
    """An axis of a taxel that does not answer."""

    channel: int
    axis: str
    """`"x"`, `"y"` or `"z"`."""
    is_stuck: bool
    """It keeps one value; else it answers much less than the pokes lean."""
    pokes: int


@dataclass(frozen=True, slots=True)
class ShearMiss:
    """A poke whose shear on the skin is not that of the wrench."""

    poke: int
    angle: float
    """rad, median over its taxels of the angle between reading and force."""
    taxels: int


@dataclass(frozen=True, slots=True)
class MeshLean:
    """Taxels whose z is not along the normal of the mesh."""

    channels: tuple[int, ...]
    angle: float
    """rad, their median angle."""
    judged: int
    """Taxels that were compared."""


def find_dead_axes(turns: SkinTurns) -> tuple[DeadAxis, ...]:
    """Find x and y of taxels that do not answer, by channel."""
    ratio = float(np.exp(turns.noise.log_ratio))
    return tuple(
        found
        for channel, pokes in turns.pokes.items()
        if len(pokes) >= MIN_POKES_OF_DEAD_AXIS
        for found in _dead_axes_of(channel, pokes, ratio, turns.noise.reading)
    )


def find_dead_z(counts: ValueOrderCounts) -> tuple[DeadAxis, ...]:
    """Find taxels whose z never answers, in pokes that their x and y answer, by channel."""
    each = zip(counts.pushed or (), counts.sheared or (), strict=True)
    return tuple(
        DeadAxis(channel, "z", is_stuck=False, pokes=sheared)
        for channel, (pushed, sheared) in enumerate(each)
        if not pushed and sheared >= MIN_POKES_OF_DEAD_AXIS
    )


def _dead_axes_of(channel: int, pokes: AxisPokes, ratio: float, noise: float) -> list[DeadAxis]:
    """Find the dead axes of one taxel; `ratio` of the gains, `noise` of a value, raw units."""
    lengths = np.linalg.norm(pokes.readings, axis=1)
    gain = float(np.median(lengths / np.linalg.norm(pokes.forces, axis=1)))
    expected = gain * ratio * _least_shear(pokes.forces)
    if expected < max(EXPECTED_MIN_NOISES * noise, EXPECTED_MIN_SHARE * float(np.median(lengths))):
        return []
    sizes = np.sqrt(np.mean(pokes.readings[:, :2] ** 2, axis=0))
    is_stuck = np.ptp(pokes.readings[:, :2], axis=0) <= STUCK_MAX_SHARE * float(lengths.max())
    return [
        DeadAxis(channel, AXIS_NAMES[axis], bool(is_stuck[axis]), len(pokes))
        for axis in range(2)
        if sizes[axis] < WEAK_MAX_SHARE * expected
    ]


def _least_shear(forces: FloatArray) -> float:
    """Compute the least rms, N, of forces (n, 3) along any direction across their mean."""
    mean = forces.mean(axis=0)
    mean = mean / max(float(np.linalg.norm(mean)), 1e-12)
    across = forces - np.outer(forces @ mean, mean)
    # The third singular value is that along the mean: zero.
    return float(np.linalg.svd(across / np.sqrt(len(forces)), compute_uv=False)[1])


def find_unit_excess(contacts: Sequence[Contact]) -> float:
    """Compute how many times the force, N, the taxels of a poke push together, if they cannot be newtons; 0 otherwise.

    The taxels carry at most the whole force, so the median over the pokes is at most 1, if readings are in newtons.
    """
    shares = [float(each.responses.sum() / np.linalg.norm(each.force)) for each in contacts]
    excess = float(np.median(shares)) if len(shares) >= MIN_POKES_OF_UNIT else 0.0
    return excess if excess > MAX_SHARE_OF_FORCE else 0.0


def find_shear_misses(turns: SkinTurns) -> tuple[ShearMiss, ...]:
    """Find pokes that all their taxels read from another direction than the wrench, by number."""
    hand = int(turns.is_mirrored)
    seen: dict[int, list[tuple[float, bool]]] = {}
    for channel, turn in turns.taxels.items():
        fit, pokes = turn.fits[hand], turns.pokes[channel]
        if len(pokes) <= MIN_OTHER_POKES_OF_MISS or not fit.is_in_plane_known:
            continue
        is_far = (fit.misses > MIN_SHEAR_MISS) & (fit.misses > ZERO_TRUST_SDS * np.sqrt(fit.variances)) & (fit.trust == 0.0)
        for poke, angle, far in zip(pokes.pokes.tolist(), fit.misses.tolist(), is_far.tolist(), strict=True):
            seen.setdefault(poke, []).append((angle, far))
    return tuple(
        ShearMiss(poke, float(np.median([angle for angle, _ in each])), len(each))
        for poke, each in sorted(seen.items())
        if all(far for _, far in each)
    )


def find_mesh_lean(turns: SkinTurns, normals: Mapping[int, FloatArray], excluded: Collection[int]) -> MeshLean | None:
    """Compare z of taxels, by their own pokes, with the outward normals (3,), unit, of the mesh; `None` if they agree.

    Parameters
    ----------
    excluded : taxels that share the turn of their module, which need not be across their own surface
    """
    hand, off, judged = int(turns.is_mirrored), dict[int, float](), 0
    for channel, turn in turns.taxels.items():
        fit = turn.fits[hand]
        if channel not in normals or channel in excluded or not fit.is_in_plane_known:
            continue
        judged += 1
        angle = float(np.arccos(np.clip(fit.rotation[:, 2] @ normals[channel], -1.0, 1.0)))
        if angle > max(MAX_LEAN_FROM_MESH, LEAN_MIN_SDS * fit.normal_sd):
            off[channel] = angle
    return MeshLean(tuple(off), float(np.median(list(off.values()))), judged) if off else None
