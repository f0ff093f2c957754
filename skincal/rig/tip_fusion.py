"""Force axes and tip positions together.

A tip position x_k, noise sigma^2 and the frame's covariance Sigma (`tip_frame`), adds two things to the force axis of its poke.

**Across the axis** both measure the same two coordinates. The axis moves, parallel, to the better place

    a' = a + E' D (D + T)^-1 E (x - a),   T = sigma^2 I + E G Sigma G' E',

D the sensor's noise, G the gradient of x by the frame's unknowns. All methods use the moved axes. The noise that they assume
for an axis stays the sensor's: predicted errors are upper bounds.

**Along the axis** only the tip measures. With it an answer of a taxel gives a point y_k = a' + u u.x, and

    p = (sum W_k)^-1 sum W_k y_k,   W_k = (E' D E + sigma^2 u u' + s^2 (I - n n'))^-1,

s the offset of the contact from the taxel, each direction, in the skin with the normal n (`uncertainty.h`). An answer without a
tip has W_k = E' (D + ...)^-1 E. Three errors are common to the answers of a taxel: Sigma, the neighbours' offsets
(`uncertainty.h`), and s^2 / radius, the mean depth of an offset contact on a bent skin. This estimate replaces that of the
free method, also where the axes alone leave the depth unknown.

A tip that the scene of a tool gives places its pokes alone (`places_pokes`). The wrench then says nothing about the place, and
its noise is not that of the axis: these pokes are written as forces at the contact, in a frame with its origin there, of the
size that makes the scene's noise of the moment the error of a place, sigma.

A tip that disagrees with its axis (chi-square above `CHI2_2DOF_QUANTILE_9999`) is not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, length_of
from skincal.model.scene import NoiseSettings
from skincal.rig.tip_frame import TipFrame, TipPokes
from skincal.solver.tables import NEIGHBOURS_SHARE_ONE_OFFSET_FROM
from skincal.taxels.contact_table import ContactTable, Evidence
from skincal.taxels.noise import offset_square, row_precision
from skincal.taxels.result import POSITION_MAX_SD_M, Cause, Estimate, Method, State

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

CHI2_2DOF_QUANTILE_9999 = 18.4
"""Exceeded by one in 10,000 (chi-square, two degrees of freedom)."""
UNKNOWN_DEPTH_CAUSES = (Cause.ONE_AXIS, Cause.ALIKE_AXES)


class TipFusion:
    """Tip positions of a session under a frame that is used."""

    def __init__(self, frame: TipFrame, noise: NoiseSettings) -> None:
        self._frame, self._noise = frame, noise
        self._tips: dict[int, tuple[FloatArray, FloatArray]] = {}
        """Position (3,), metres, link frame, and gradient (3, 6), by poke; without outliers."""

    @property
    def places_pokes(self) -> bool:
        """Whether the tip alone says where a poke is, and its wrench does not."""
        return self._frame.places_pokes

    def joined_on_mesh(self, estimates: Sequence[Estimate], table: ContactTable, surface: Surface) -> tuple[Estimate, ...]:
        """Estimate taxels of the surface method again by the centres of the answers; `table` has moved axes."""
        from skincal.rig.answer_centres import join_by_centres  # other rigs do without

        evidence = table.evidence([each.channel for each in estimates if each.position is not None])
        return tuple(join_by_centres(estimates, evidence, surface, self._noise, self._frame.tip_sd))

    def moved_axes(self, contacts: Sequence[Contact]) -> list[Contact]:
        """Move the force axes of contacts towards their tips; contacts without a usable tip are not changed."""
        if self._frame.places_pokes:
            contacts = [self._at_tip(contact) for contact in contacts]
        found = {contact.poke: contact for contact in contacts}
        for poke in found:
            self._tips.pop(poke, None)
        some = [contact for contact in contacts if contact.tip is not None]
        if not some:
            return list(contacts)
        pokes = TipPokes.of_contacts(some)
        places, gradients = self._frame.places(pokes)
        lever = places - pokes.sensor
        misses = (pokes.pairs @ (places - pokes.axis_point)[:, :, None])[:, :, 0]
        sensor = np.linalg.inv(row_precision(pokes.pairs, lever, pokes.force_size, np.zeros(len(some)), self._noise))
        slopes = pokes.pairs @ gradients
        tip = self._frame.tip_sd**2 * np.eye(2) + slopes @ self._frame.covariance @ slopes.transpose(0, 2, 1)
        pulled = np.linalg.solve(sensor + tip, misses[:, :, None])
        shifts = (pokes.pairs.transpose(0, 2, 1) @ sensor @ pulled)[:, :, 0]
        for row in np.flatnonzero(np.sum(misses * pulled[:, :, 0], axis=1) < CHI2_2DOF_QUANTILE_9999).tolist():
            contact = some[row]
            shift = contact.link_from_sensor[:3, :3].T @ shifts[row]
            found[contact.poke] = replace(contact, moment=contact.moment + np.cross(shift, contact.force))
            self._tips[contact.poke] = places[row], gradients[row]
        return list(found.values())

    def _at_tip(self, contact: Contact) -> Contact:
        """Write a poke as a force through its tip, in a frame at the tip."""
        if contact.tip is None:
            return contact
        pose = contact.link_from_sensor.copy()
        pose[:3, 3] = contact.tip
        size = self._noise.moment / self._frame.tip_sd
        force = contact.force * (size / length_of(contact.force))
        return replace(contact, force=force, moment=np.zeros(3), link_from_sensor=pose)

    def with_depth(self, estimates: Sequence[Estimate], evidence: Evidence) -> list[Estimate]:
        """Estimate the taxels of the free method again with their tips; `evidence` has moved axes."""
        rows = dict(zip(evidence.channels.tolist(), range(len(evidence.channels)), strict=True))
        return [
            self._with_tips(estimate, evidence.part(rows[estimate.channel], rows[estimate.channel] + 1))
            if estimate.method is Method.FREE and estimate.channel in rows and _may_gain(estimate)
            else estimate
            for estimate in estimates
        ]

    def _with_tips(self, estimate: Estimate, evidence: Evidence) -> Estimate:
        trust = np.array([estimate.doubted.get(poke, 1.0) for poke in evidence.pokes.tolist()])
        mean_push = evidence.directions.T @ (trust * evidence.weights)
        normal = -mean_push / np.linalg.norm(mean_push) if estimate.normal is None else estimate.normal
        rows = self._rows(evidence, trust, normal)
        if rows is None:
            return estimate
        weights, points, noise, common = rows
        information: FloatArray = weights.sum(axis=0)
        if not np.linalg.eigvalsh(information)[0] > POSITION_MAX_SD_M**-2:
            return estimate
        inverse = np.asarray(np.linalg.inv(information), dtype=np.float64)
        position = inverse @ np.sum(weights @ points[:, :, None], axis=0)[:, 0]
        shifts = np.sum(weights @ common, axis=0)
        covariance: FloatArray = inverse @ (np.sum(weights @ noise @ weights, axis=0) + shifts @ shifts.T) @ inverse
        if estimate.moved is not None:
            covariance += estimate.moved @ estimate.moved.T
        values, axes = np.linalg.eigh(covariance)
        worst = axes[:, -1]
        return Estimate(
            estimate.channel, Method.FREE, State.TOUCHED, estimate.contacts, position=position, normal=normal,
            covariance=covariance, worst_direction=worst * np.sign(worst[np.abs(worst).argmax()]),
            sd=float(np.sqrt(values[-1])), rms=float(np.sqrt(np.trace(covariance))), moved=estimate.moved,
            doubted=estimate.doubted,
        )  # fmt: skip

    def _rows(
        self, evidence: Evidence, trust: FloatArray, normal: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
        """Describe the n contacts of one taxel as measurements of its position; `None` without a tip.

        Returns
        -------
        weights (n, 3, 3) in 1/m^2, points (n, 3) in m, noise (n, 3, 3) in m^2, and the shifts by common errors, (n, 3, 10) in
        m: of the frame, of neighbours, and of the bend.
        """
        tips = [self._tips.get(poke) for poke in evidence.pokes.tolist()]
        has_tip = np.array([tip is not None for tip in tips])
        if not (has_tip & (trust > 0.0)).any():
            return None
        pushes, pairs, noise, count = evidence.directions, evidence.pairs, self._noise, len(trust)
        depths, slopes = np.zeros(count), np.zeros((count, 6))
        for row in np.flatnonzero(has_tip).tolist():
            place, gradient = tips[row] or (np.zeros(3), np.zeros((3, 6)))
            depths[row], slopes[row] = pushes[row] @ place, pushes[row] @ gradient
        points = evidence.nearest + depths[:, None] * pushes
        place = points[has_tip].mean(axis=0)
        turned, zero = pairs.transpose(0, 2, 1), np.zeros(count)
        along = pushes[:, :, None] * pushes[:, None]
        flat = np.eye(3) - np.outer(normal, normal)
        # Neighbours' offsets do not average out: see `uncertainty.h`.
        weakness, share = np.sqrt(-np.log(evidence.weights)), trust * evidence.weights**2
        common = noise.reach * weakness * min(1.0, float(share @ weakness / share.sum()) / NEIGHBOURS_SHARE_ONE_OFFSET_FROM)
        offsets = offset_square(evidence.weights, noise)
        sensor = np.linalg.inv(row_precision(pairs, place - evidence.sensors, evidence.forces, zero, noise))
        measured = turned @ sensor @ pairs + self._frame.tip_sd**2 * along
        own = measured + (offsets - common**2)[:, None, None] * flat
        weights = np.where(
            has_tip[:, None, None],
            np.linalg.inv(measured + offsets[:, None, None] * flat),
            turned @ row_precision(pairs, place - evidence.sensors, evidence.forces, offsets, noise) @ pairs,
        )
        root = np.linalg.cholesky(self._frame.covariance)
        shared = np.concatenate(
            [
                pushes[:, :, None] * (slopes @ root)[:, None],
                common[:, None, None] * flat,
                (offsets / noise.radius)[:, None, None] * normal[:, None],
            ],
            axis=2,
        )
        return trust[:, None, None] * weights, points, own, shared


def _may_gain(estimate: Estimate) -> bool:
    if estimate.position is not None:
        return True
    return estimate.state is State.BLIND and estimate.reason is not None and estimate.reason.cause in UNKNOWN_DEPTH_CAUSES
