"""Everything that a calibration file needs, in one frozen value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.formats import NO_OPTIONS, ExportOptions
from skincal.geometry import FloatArray, IntArray
from skincal.mesh.smooth_normals import smooth_normals
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.model.skin import Layout
from skincal.pokes import NO_LANDMARK_POKES, LandmarkPokes
from skincal.rig.closing import Closing
from skincal.rig.correction import UsedCorrection
from skincal.rig.correction_fit import RigAnswer
from skincal.taxels.gains import TaxelGain, taxel_gains
from skincal.taxels.result import Estimate, Method, State
from skincal.taxels.shared_errors import PredictedError, predicted_error
from skincal.words.rig_words import correction_words
from skincal.words.taxel_words import error_words

if TYPE_CHECKING:
    from skincal.axes.axis_results import AxisResults
    from skincal.axes.taxel_frames import TaxelFrame
    from skincal.rig.part_pose import PartPose

DEFAULT_FOOTPRINT_RADIUS_M = 0.002
"""m. Radius of a pad of iCub's skin: for skins whose spacing is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The result of a session, with what it was computed from; link frame, metres."""

    scene: Scene
    channels: Sequence[int] | IntArray
    """Channels that are taxels, ascending."""
    estimates: Mapping[Method, tuple[Estimate, ...]]
    """For each method one estimate a taxel, in the order of `channels`."""
    contacts: tuple[Contact, ...]
    """Accepted contacts, as the rig reported them; those whose poke is in `excluded` did not count."""
    mesh_sha256: str | None
    """Of the mesh file that the surface method used; None without a surface."""
    version: str
    """skincal's version."""
    excluded: tuple[int, ...] = ()
    """Numbers of the pokes that the operator took out."""
    dead: Mapping[int, str] = field(default_factory=dict[int, str])
    """Channels that were not used, with the reason."""
    corrections: tuple[UsedCorrection, ...] = ()
    """Of what the rig reports, applied in this order before the estimates were computed."""
    landmark_pokes: LandmarkPokes = NO_LANDMARK_POKES
    """Pokes at known points of the part, as the rig reported them; those whose poke is in `excluded` did not count."""
    rig: RigAnswer | None = None
    """Fitted rig correction, used or not, with its held-out check; `None` if it was not fitted."""
    closings: tuple[Closing, ...] = ()
    """Whether anything moved since the session began, each time that was checked; the last one counts."""
    verdicts: Mapping[Method, str] = field(default_factory=dict[Method, str])
    """Verdict by method, in a sentence without its full stop; empty if no verdict was asked."""
    unmodelled_rig_error_m: Mapping[Method, float | None] = field(default_factory=dict[Method, "float | None"])
    """m rms, by method: shift from rig errors that the predicted error leaves out (`unchecked_of`)."""

    options: ExportOptions = NO_OPTIONS
    """The operator's choices for the file."""
    mesh_findings: tuple[str, ...] = ()
    """Sentences on the mesh."""
    part_size: float = inf
    """m, see `Snapshot.part_size`."""
    part_pose: PartPose | None = None
    """Pose of the part in the base of a tool's poses; `None` unless it was found from the pokes."""
    tool: tuple[str, ...] = ()
    """Sentences on the tip of a tool and the part's pose, see `session_tool_sentences`; empty for other rigs."""
    axes: AxisResults | None = None
    """Turns of the taxels; `None` for a skin of one axis."""

    def estimates_by(self, method: Method) -> tuple[Estimate, ...]:
        """Return the estimates of one method.

        Raises InputError: the session has no such estimates.
        """
        if method not in self.estimates:
            known = ", ".join(m.value for m in self.estimates)
            raise InputError(
                f"the session has no estimates of the {method.value} method; expected one of: {known or 'none at all'}."
            )
        return self.estimates[method]

    def predicted_error(self, method: Method) -> PredictedError | None:
        """Summarise the predicted error of a method; `None` without an estimate."""
        return predicted_error(self.estimates_by(method), self.part_size)

    @property
    def has_arm(self) -> bool:
        """Whether joints of an arm carry the part."""
        return self.scene.arm is not None

    def correction_comments(self) -> tuple[str, ...]:
        """Describe tip and part's pose of a tool's rig, and the corrections in use, for a file's comments."""
        used = (correction_words(used, has_arm=self.has_arm) for used in self.corrections)
        return *(sentence.removesuffix(".") for sentence in self.tool), *used

    def verdict_comments(self, method: Method) -> tuple[str, ...]:
        """Verdict, predicted error and the part that it leaves out, for a file's comments; empty without a verdict."""
        if method not in self.verdicts:
            return ()
        error = error_words(self.predicted_error(method), self.unmodelled_rig_error_m.get(method), has_arm=self.has_arm)
        return self.verdicts[method], f"predicted error: {error}"

    @property
    def used_contacts(self) -> tuple[Contact, ...]:
        """Contacts that are not excluded, after all corrections."""
        used = [contact for contact in self.contacts if contact.poke not in self.excluded]
        for step in self.corrections:
            used = [step.correction.corrected(contact) for contact in used]
        return tuple(used)

    def gains(self, method: Method) -> tuple[TaxelGain, ...]:
        """Compute the gain of each taxel along a method's normals, in the order of `channels`."""
        return taxel_gains(self.used_contacts, self.estimates_by(method))

    def frame(self, channel: int, method: Method) -> TaxelFrame | None:
        """Return the turn of a taxel; `None` for a skin of one axis."""
        return None if self.axes is None else self.axes.frames(method)[channel]

    def module_id(self, channel: int) -> int | None:
        """Return the id of the module that carries a channel; None where the layout does not say."""
        layout = self.scene.skin.layout
        if layout is None or not 0 <= channel < layout.width:
            return None
        index = int(layout.module_of[channel])
        return None if index < 0 else layout.modules[index].id


class SmoothedEstimates(Mapping[Method, tuple[Estimate, ...]]):
    """Estimates by method, with the normals of the smooth part instead of triangles. Each method is made at its first use."""

    def __init__(
        self, estimates: Mapping[Method, tuple[Estimate, ...]], surface: Surface | None, layout: Layout | None
    ) -> None:
        self._estimates, self._surface = estimates, surface
        spacing_m = np.inf if layout is None else layout.spacing
        self._footprint_m = spacing_m / 2 if np.isfinite(spacing_m) else DEFAULT_FOOTPRINT_RADIUS_M
        self._made: dict[Method, tuple[Estimate, ...]] = {}

    def __getitem__(self, method: Method) -> tuple[Estimate, ...]:
        if method not in self._made:
            self._made[method] = self._smoothed(self._estimates[method])
        return self._made[method]

    def __iter__(self) -> Iterator[Method]:
        return iter(self._estimates)

    def __len__(self) -> int:
        return len(self._estimates)

    def _smoothed(self, estimates: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
        rows = [row for row, each in enumerate(estimates) if each.position is not None and each.triangle is not None]
        if self._surface is None or not rows:
            return estimates
        held = [estimates[row] for row in rows]
        found = smooth_normals(
            self._surface,
            np.array([estimate.position for estimate in held]),
            np.array([estimate.triangle for estimate in held]),
            self._footprint_m,
            np.array([np.zeros((3, 3)) if estimate.covariance is None else estimate.covariance for estimate in held]),
        )
        smoothed = list(estimates)
        for row, normal, sd in zip(rows, found.normals, found.sd.tolist(), strict=True):
            smoothed[row] = replace(estimates[row], normal=normal, normal_sd=sd)
        return tuple(smoothed)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedTaxels:
    """The taxels of one method that have a position."""

    channels: IntArray
    """(n,)"""
    positions: FloatArray
    """(n, 3) float, metres, link frame."""
    normals: FloatArray
    """(n, 3) float, unit, outward; zeros where unknown."""
    sd: FloatArray
    """(n,) float, metres, along the weakest direction; NaN where it is not determined."""
    states: tuple[State, ...]
    """(n,) touched or inferred."""


def placed_taxels(estimates: Sequence[Estimate]) -> PlacedTaxels:
    """Gather the estimates that have a position."""
    known = [estimate for estimate in estimates if estimate.position is not None]
    zero = np.zeros(3)
    return PlacedTaxels(
        channels=np.array([estimate.channel for estimate in known], dtype=np.int64),
        positions=np.array([estimate.position for estimate in known], dtype=float).reshape(-1, 3),
        normals=np.array([zero if e.normal is None else e.normal for e in known], dtype=float).reshape(-1, 3),
        sd=np.array([np.nan if e.sd is None else e.sd for e in known], dtype=float),
        states=tuple(estimate.state for estimate in known),
    )
