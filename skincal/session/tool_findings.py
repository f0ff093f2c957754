"""What the pokes of a session show of a tool's rig: the tip in the sensor's frame, and the part's pose in the base.

Both follow from the pokes that count, in the order of their numbers, and from nothing else. They are fitted again when a
landmark poke changes, and when the number of pokes on the skin grows by a quarter: each fit moves every taxel.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from skincal.contacts.outcome import Contact, Outcome, Progress
from skincal.geometry import FloatArray, IntArray, crossed, mean_rows, orthonormal_pair
from skincal.mesh.lay import PlacedLayout, place_layout
from skincal.model.scene import Landmark, Scene
from skincal.pokes import Pokes
from skincal.rig.mesh_distance import MeshDistance, find_mesh_distance
from skincal.rig.part_pose import MISFIT_MIN_RATIO, NO_PART_POSE, PartPose, PartPoseState, fit_part_pose, start_at
from skincal.rig.part_pose_starts import closed_start
from skincal.rig.part_scale import UNKNOWNS_OF_POSE, WrongScale
from skincal.rig.part_touches import MESH_SD_M, PartShape, PartTouches, motion_rows
from skincal.rig.scene_mistakes import Mistake
from skincal.rig.tip_frame import REFIT_AT_POKE_COUNT_RATIO, TipState, pokes_of_fit
from skincal.rig.tip_fusion import CHI2_2DOF_QUANTILE_9999
from skincal.rig.tool_tip import ToolTip, find_tool_tip, used_tip
from skincal.taxels.noise import row_precision
from skincal.taxels.result import Estimate, Method

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

FIRST_FIT_POKES = 6
TOUCHES_MAX = 150
"""Pokes on the skin in a fit; of more an even selection is used."""
CORNERS_MAX = 200
"""Vertices of the mesh at which an error of the part's pose is measured."""
PART_POSE_MISMATCH_CHI2 = 27.9
"""A given pose of the part disagrees with the touches above it: one in 10,000 (chi-square, six degrees of freedom)."""
TYPED_POSE_LEVER_M = 0.1
"""m. The sd of a given pose over this length is that of its turn: 1.1 degrees for 2 mm."""
PART_POSE_MISMATCH_MIN_M = 0.003
"""m, rms over the part. A smaller error of a given pose is never named."""
LEAN_MIN_COSINE = 0.5
"""Cosine between a push and the normal of the mesh, against it, from which the normal gives the contact of the ball: beyond 60
degrees the push does not touch this face."""
ROBOT_SCALE_SD = 0.002
"""sd of the scale of a robot's lengths: issue 41 counts 0.2 % among a cobot's usual errors."""


@dataclass(frozen=True, slots=True, eq=False)
class PartMisfit:
    """Touches of a part that its best pose misses."""

    findings: ToolFindings
    """With tip and pose of that moment; nothing changes them."""
    pokes: Pokes
    """On the skin, then at landmarks, in the base."""
    skin: tuple[Contact, ...]
    """Those on the skin."""
    landmarks: tuple[Landmark, ...]
    """Landmark of each of the others."""
    shape: PartShape

    def explain(self) -> Mistake | None:
        """Find the mistake of the tool's poses or tip that explains it; `None` without one. It takes seconds: ten fits."""
        return self.findings.explain(self)


class ToolFindings:
    """Tip and part's pose of a session whose scene has `[tool]`.

    Parameters
    ----------
    surface : the scene's mesh; `None` without one
    """

    def __init__(self, scene: Scene, surface: Surface | None) -> None:
        assert scene.tool is not None
        self._scene, self._surface, self._tool = scene, surface, scene.tool
        self.tip: ToolTip = find_tool_tip((), scene.noise, self._tool.tip_in_sensor, self._tool.tip_sd)
        self.part: PartPose | None = NO_PART_POSE if scene.finds_part_pose else None
        """Pose of the part; `None` if the scene gives it, or has none."""
        self.typed_error: PartPose | None = None
        """Pose that the touches show, in place of the given one; `None` if they agree, or show nothing."""
        self._typed: PartPose | None = None
        """A given pose with the error that the touches leave it; `None` before the first poke, and without one."""
        self.wrong_scale: WrongScale | None = None
        """Scale of the part's drawing that the touches contradict; `None` if they agree with it."""
        self.off_mesh: MeshDistance | None = None
        """Distance of the touches from the mesh if it is far beyond their error and the scene gives the part's pose."""
        self.misfit: PartMisfit | None = None
        """Touches that the best pose of the part misses; `None` if they fit."""
        self._tip_fitted: tuple[Contact, ...] = ()
        self._part_fitted: tuple[object, ...] = ()
        self._placed: dict[int, tuple[Outcome, PartPose | None, ToolTip, Outcome]] = {}
        """By poke: the outcome as reported, the pose and the tip that placed it, and the placed outcome."""
        self._with_error: dict[tuple[Method, int], tuple[Estimate, Estimate]] = {}

    @property
    def is_placed(self) -> bool:
        """Whether positions are in the part's frame, or in the base because the scene wants that."""
        return self.part is None or self.part.is_known

    @property
    def version(self) -> tuple[object, ...]:
        """Findings on which placed outcomes depend: other objects after a change."""
        return self.tip, self.part

    def update(self, contacts: Sequence[Contact], marked: Mapping[int, Outcome], landmarks: Mapping[int, Landmark]) -> bool:
        """Fit again what has new pokes; tells whether anything changed.

        Parameters
        ----------
        contacts : accepted and not excluded, in the order of their numbers, as reported
        marked : outcomes of the pokes at landmarks that count, as reported, by number, ascending
        landmarks : landmark of each of these
        """
        before = self.version
        if self._tool.has_sensor:
            used = tuple(contacts[: pokes_of_fit(len(contacts))])
            if list(map(id, used)) != list(map(id, self._tip_fitted)):
                self._tip_fitted = used
                self.tip = find_tool_tip(used, self._scene.noise, self._tool.tip_in_sensor, self._tool.tip_sd)
        self._update_part(contacts, marked, landmarks)
        return any(one is not other for one, other in zip(before, self.version, strict=True))

    def _update_part(
        self, contacts: Sequence[Contact], marked: Mapping[int, Outcome], landmarks: Mapping[int, Landmark]
    ) -> None:
        if self.part is None and not self._tool.has_part_pose:
            return
        skin = [contact for contact in contacts if contact.poke not in marked]
        used = skin[: _pokes_of_part_fit(len(skin))]
        key = (self.tip, *used, *marked.values(), *landmarks.values())
        if list(map(id, key)) == list(map(id, self._part_fitted)):
            return
        self._part_fitted = key
        if len(used) > TOUCHES_MAX:
            rows: list[int] = np.linspace(0, len(used) - 1, TOUCHES_MAX).round().astype(np.int64).tolist()
            used = [used[row] for row in rows]
        pokes, marks = Pokes.collect([*used, *marked.values()]), [landmarks[poke] for poke in marked]
        touches = self._touches(pokes, used, marks)
        error = self.tip.covariance[3:, 3:] if self.tip.state is TipState.USED else np.zeros((3, 3))
        shape = PartShape(self._surface, self._corners(marks, touches), self._scene.noise, error)
        if self.part is None:
            found = self._below_balls(fit_part_pose(touches, shape, start_at(np.eye(4))), touches, shape)
            self.typed_error = found if _contradicts_typed_pose(found, shape) else None
            self._typed = _typed_pose_errors(found, shape, self._tool.part_pose_sd)
            self.wrong_scale = found.wrong_scale
            self._with_error.clear()
            surface = self._surface
            self.off_mesh = None if surface is None else find_mesh_distance(touches, surface, self._scene.noise)
            return
        self.part, self.misfit = self._below_balls(fit_part_pose(touches, shape), touches, shape), None
        self.wrong_scale = self.part.wrong_scale
        self._with_error.clear()
        if self.part.ratio > MISFIT_MIN_RATIO:
            # A copy keeps the tip of now.
            self.misfit = PartMisfit(copy(self), pokes, tuple(used), tuple(marks), shape)
            # Beyond, the pose is refused without an explanation, too.
            if self.part.state is not PartPoseState.DISAGREES and self.explain(self.misfit, is_quick=True) is not None:
                self.part = replace(self.part, state=PartPoseState.DISAGREES)

    def _below_balls(self, found: PartPose, touches: PartTouches, shape: PartShape) -> PartPose:
        """Fit again with the contacts below the middle of the ball: where that is, a first pose and its mesh say."""
        if not found.is_known or not self._is_placed_by_tip or self._surface is None or not self._tool.tip_radius:
            return found
        turn, shift = found.link_from_base[:3, :3], found.link_from_base[:3, 3]
        centres = touches.place - self._tool.tip_radius * touches.push
        ways = self._ways_to_contact(centres @ turn.T + shift, touches.push @ turn.T)
        places = centres + self._tool.tip_radius * ways @ turn
        again = fit_part_pose(replace(touches, place=places), shape, start_at(found.link_from_base))
        return again if again.is_known else found

    def explain(self, misfit: PartMisfit, *, is_quick: bool = False) -> Mistake | None:
        """Find the mistake that explains a misfit of this tool; see `PartMisfit.explain`.

        Parameters
        ----------
        is_quick : begin each fit at the closed solution for landmarks and planned taxels alone, where there is one
        """
        from skincal.rig.part_mistakes import explain_misfit  # rarely needed

        def fit(other: Pokes, tip_error: FloatArray | None) -> PartPose:
            of_tip = misfit.shape.tip_covariance if tip_error is None else tip_error
            touches = self._touches(other, misfit.skin, misfit.landmarks)
            starts = closed_start(touches) if is_quick else None
            return fit_part_pose(touches, replace(misfit.shape, tip_covariance=of_tip), starts)

        assert self.part is not None
        return explain_misfit(misfit.pokes, self._tool, self.part, fit)

    def _touches(self, pokes: Pokes, skin: Sequence[Contact], marks: Sequence[Landmark]) -> PartTouches:
        """Gather touches of the part: pokes on the skin with the plan of their strongest taxel, then those at landmarks."""
        places, precision = self._measured(pokes)
        nowhere = np.full((len(pokes), 3), np.nan)
        landmark, planned, normal, module = nowhere, nowhere.copy(), nowhere.copy(), np.full(len(pokes), -1)
        landmark[len(skin) :] = np.reshape([mark.place for mark in marks], (-1, 3))
        layout, laid = self._scene.skin.layout, self._placed_layout
        if laid is not None and layout is not None and skin:
            channels: IntArray = np.array([contact.strongest_channel for contact in skin], np.int64)
            planned[: len(skin)], normal[: len(skin)] = laid.places[channels], laid.normals[channels]
            module[: len(skin)] = layout.module_of[channels]
        turns = pokes.link_from_sensor[:, :3, :3]
        return PartTouches(pokes.number, places, precision, pokes.direction, turns, landmark, planned, normal, module)

    def _measured(self, pokes: Pokes) -> tuple[FloatArray, FloatArray]:
        """Compute the place (n, 3) that each poke touched and its precision (n, 3, 3), from the force axis and the tip."""
        pairs, noise = orthonormal_pair(pokes.direction), self._scene.noise
        tips, place_sd = self._tips(pokes), self._tool.tip_sd
        of_tip = np.broadcast_to(np.eye(3) / place_sd**2, (len(pokes), 3, 3))
        if tips is not None and self._is_placed_by_tip:
            return tips, np.array(of_tip)
        # The point of each axis nearest to the tip, or to the sensor.
        near = pokes.sensor if tips is None else tips
        along = np.sum((near - pokes.axis_point) * pokes.direction, axis=1, keepdims=True)
        points = pokes.axis_point + along * pokes.direction
        across = row_precision(pairs, points - pokes.sensor, pokes.force_size, np.zeros(len(pokes)), noise)
        of_axis = pairs.transpose(0, 2, 1) @ across @ pairs
        if tips is None:
            return points, of_axis
        off = np.asarray((pairs @ (tips - points)[:, :, None])[:, :, 0], dtype=np.float64)
        turned = pairs @ pokes.link_from_sensor[:, :3, :3]
        error = (
            np.linalg.inv(across) + place_sd**2 * np.eye(2) + turned @ self.tip.covariance[3:, 3:] @ turned.transpose(0, 2, 1)
        )
        squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(error), off)
        agrees = squares < CHI2_2DOF_QUANTILE_9999
        both = of_axis + np.where(agrees[:, None, None], of_tip, 0.0)
        pulled = (of_axis @ points[:, :, None] + of_tip @ tips[:, :, None])[:, :, 0]
        joined = np.asarray(np.linalg.solve(of_axis + of_tip, pulled[:, :, None])[:, :, 0], dtype=np.float64)
        return np.where(agrees[:, None], joined, points), both

    def _tips(self, pokes: Pokes) -> FloatArray | None:
        """Compute the contacts (n, 3) at the tip, metres, link frame as of the pokes; `None` while the tip is not used."""
        if self.tip.state is not TipState.USED:
            return None
        centres = (pokes.link_from_sensor[:, :3, :3] @ self.tip.shift) + pokes.sensor
        return centres + self._tool.tip_radius * pokes.direction

    @cached_property
    def _placed_layout(self) -> PlacedLayout | None:
        layout = self._scene.skin.layout
        return None if layout is None else place_layout(layout, self._scene.skin.anchor, self._surface)

    def _corners(self, landmarks: Iterable[Landmark], touches: PartTouches) -> FloatArray:
        """Gather points all over the part: of the mesh, else of the layout and the landmarks, else the touches."""
        if self._surface is not None:
            vertices = self._surface.vertices
            return vertices[:: -(-len(vertices) // CORNERS_MAX)]
        places = [np.reshape([each.place for each in landmarks], (-1, 3))]
        if self._placed_layout is not None:
            places.append(self._placed_layout.places[np.isfinite(self._placed_layout.places).all(axis=1)])
        found = np.concatenate(places)
        return found if len(found) else touches.place

    def placed(self, outcome: Outcome) -> Outcome:
        """Carry an outcome into the part's frame once that is known, and give it the place of the tip."""
        self.place([outcome])
        return self._placed[outcome.poke][-1]

    def place(self, outcomes: Iterable[Outcome]) -> None:
        """Place outcomes that are not yet, together, for `placed`."""
        new: list[Outcome] = []
        for outcome in outcomes:
            reported, part, tip, _ = self._placed.get(outcome.poke, (None, None, None, outcome))
            if reported is outcome and part is self.part and tip is self.tip:
                continue
            self._placed[outcome.poke] = outcome, self.part, self.tip, outcome
            if outcome.link_from_sensor is not None and outcome.force is not None and outcome.moment is not None:
                new.append(outcome)
        if not new:
            return
        pokes = Pokes.collect(new)
        pokes = replace(pokes, link_from_sensor=self.placed_pose(pokes.link_from_sensor))
        contacts = self._contact_points(pokes)
        moments = pokes.moment
        if contacts is not None and self._is_placed_by_tip:
            lever = (pokes.link_from_sensor[:, :3, :3].transpose(0, 2, 1) @ (contacts - pokes.sensor)[:, :, None])[:, :, 0]
            moments = crossed(lever, pokes.force)
        for row, outcome in enumerate(new):
            found = replace(outcome, link_from_sensor=pokes.link_from_sensor[row], moment=moments[row])
            if isinstance(found, Contact):
                found = replace(found, tip=None if contacts is None else contacts[row])
            self._placed[outcome.poke] = outcome, self.part, self.tip, found

    def through_tip(self, progress: Progress, link_from_sensor: FloatArray | None) -> Progress:
        """Move the axis of a press in progress through the contact of the tip, as that of a finished poke.

        `link_from_sensor` (4, 4), metres, is as `placed_pose` gives it.
        """
        if link_from_sensor is None or not self._tool.has_sensor or not self._is_placed_by_tip or not progress.force.any():
            return progress
        centre = link_from_sensor[:3] @ np.append(self._tip_with_part, 1.0)
        push = progress.force / np.linalg.norm(progress.force)
        return replace(progress, axis_point=self._below_centres(centre[None], push[None])[0])

    @property
    def has_used_tip(self) -> bool:
        """Whether the tip is known and used."""
        return self.tip.state is TipState.USED

    def contact_of(self, outcome: Outcome) -> FloatArray | None:
        """Compute the touched point (3,) of a placed outcome, metres, link frame; `None` while the tip is not used."""
        touched = self._contact_points(Pokes.collect([outcome])) if self.has_used_tip else None
        return None if touched is None or not len(touched) else touched[0]

    @property
    def _tip_with_part(self) -> FloatArray:
        """(3,) float, metres, sensor's frame: the tip, less its error that the part's pose shows; without a sensor zero."""
        is_found_with_part = self._tool.has_sensor and self.part is not None and self.part.is_known
        return self.tip.shift + self.part.tip_shift if is_found_with_part and self.part is not None else self.tip.shift

    def placed_pose(self, link_from_sensor: FloatArray) -> FloatArray:
        """Carry poses of the sensor, (..., 4, 4) float, metres, into the part's frame; themselves while its pose is unknown."""
        if self.part is None or not self.part.is_known:
            return link_from_sensor
        placed = self.part.link_from_base @ link_from_sensor
        if not self._tool.has_sensor:
            # Its origin is the tip.
            placed[..., :3, 3] += placed[..., :3, :3] @ self.part.tip_shift
        return placed

    def _contact_points(self, pokes: Pokes) -> FloatArray | None:
        """Compute where the tip touches the part, (n, 3), metres, link frame, for pokes that are carried; `None` without a tip.

        A ball touches below its middle, against the normal of the mesh. While that is unknown it is along the push.
        """
        if self.tip.state is not TipState.USED:
            return None
        centres = pokes.link_from_sensor[:, :3, :3] @ self._tip_with_part + pokes.sensor
        return self._below_centres(centres, pokes.direction)

    def _below_centres(self, centres: FloatArray, pushes: FloatArray) -> FloatArray:
        """Compute the contacts (n, 3) of a ball with its middle at centres (n, 3) that is pushed along (n, 3), link frame."""
        is_in_part = self._tool.has_part_pose if self.part is None else self.part.is_known
        ways = self._ways_to_contact(centres, pushes) if is_in_part else pushes
        return centres + self._tool.tip_radius * ways

    def _ways_to_contact(self, centres: FloatArray, pushes: FloatArray) -> FloatArray:
        """Compute the directions (n, 3), unit, from the middle of the ball to the contact; all in the link frame."""
        if self._surface is None or not self._tool.tip_radius:
            return pushes
        from skincal.mesh.search import nearest_pushed_points  # a part without a mesh does without

        normals = self._surface.normals[nearest_pushed_points(self._surface, centres, pushes)[1]]
        faces = np.sum(normals * pushes, axis=1, keepdims=True) < -LEAN_MIN_COSINE
        return np.where(faces, -normals, pushes)

    @property
    def _is_placed_by_tip(self) -> bool:
        """Whether the tip alone says where a poke is: without a sensor, or with a tip that the scene gives.

        A given tip is right to a millimetre in all directions. The axes of a sensor with 2 % of cross-talk miss it by several,
        alike in all pokes.
        """
        return not self._tool.has_sensor or (self.tip.state is TipState.USED and self.tip.known is not None)

    @property
    def used_tip(self) -> ToolTip:
        """The tip as the methods use it: the error of a part's pose that is found with it contains the tip's."""
        is_counted = self.part is not None and self.part.is_known and self.tip.state is TipState.USED
        return used_tip(self.tip, self.tip.shift, np.zeros((3, 3))) if is_counted else self.tip

    def with_shared_errors(
        self, estimates: Mapping[Method, Sequence[Estimate]], contacts: Sequence[Contact]
    ) -> dict[Method, tuple[Estimate, ...]]:
        """Add what all taxels share to estimates: errors of the part's pose, of the tip, of the robot's scale, and the skin.

        The tip touches the skin's outer face, by h above the taxels. Surface and modules are bound to the mesh. Estimates of
        the free method move inward by the h that the touches show (`PartPose.height`). Else h has the scene's `skin` (sd).

        Parameters
        ----------
        contacts : that count, in the part's frame
        """
        every = [each for of in estimates.values() for each in of]
        new = [each for each in every if self._with_error.get((each.method, each.channel), (None,))[0] is not each]
        if new:
            changed = self._add_errors(new, _MeanPokes.collect(contacts, is_placed_by_tip=self._is_placed_by_tip))
            self._with_error.update(
                ((each.method, each.channel), (each, found)) for each, found in zip(new, changed, strict=True)
            )
        return {method: tuple(self._with_error[method, each.channel][1] for each in of) for method, of in estimates.items()}

    def _add_errors(self, estimates: Sequence[Estimate], pokes: _MeanPokes) -> list[Estimate]:
        found, part = list(estimates), self.part if self.part is not None and self.part.is_known else None
        rows = [row for row, each in enumerate(estimates) if each.position is not None and each.covariance is not None]
        if not rows:
            return found
        some = [estimates[row] for row in rows]
        places, of = (
            np.array([each.position for each in some], dtype=np.float64),
            pokes.rows_of([each.channel for each in some]),
        )
        is_free = np.array([each.method is Method.FREE for each in some])
        height, height_sd = 0.0, self._scene.noise.skin
        if part is not None and part.height_sd < height_sd:
            height, height_sd = part.height, math.hypot(part.height_sd, MESH_SD_M)
        inward = np.where(is_free[:, None], pokes.pushes[of], 0.0)
        moves = [height_sd * inward[:, :, None]]
        places = places + height * inward
        if part is not None:
            normals = np.array([_mesh_normal(each) for each in some])
            moves += [
                part.error_shifts(places, pokes.tip_moves[of], normals),
                ROBOT_SCALE_SD * (places - part.centre)[:, :, None],
            ]
        elif self.part is None:
            moves += self._errors_in_base(places, pokes.tip_moves[of])
            if self._typed is not None:
                normals = np.array([_mesh_normal(each) for each in some])
                moves.append(self._typed.error_shifts(places, pokes.tip_moves[of], normals))
        shifts = np.concatenate(moves, axis=2)
        for row, each, place, own in zip(rows, some, places, shifts, strict=True):
            found[row] = add_shared_error(replace(each, position=place) if each.method is Method.FREE else each, own)
        return found

    def _errors_in_base(self, places: FloatArray, tip_moves: FloatArray) -> list[FloatArray]:
        """Compute shifts (n, 3, k), metres, of places (n, 3) by errors that no fit of the part's pose contains.

        They are those of the tip, of the robot's scale from its base on, and of its position, which is smooth over a part.
        """
        root = np.zeros((3, 3))
        if self.tip.state is TipState.USED:
            root = np.linalg.cholesky(self.tip.covariance[3:, 3:])
        lever = places - self._tool.link_from_base[:3, 3]
        smooth = np.broadcast_to(self._tool.tip_sd * np.eye(3), (len(places), 3, 3))
        return [tip_moves @ root, ROBOT_SCALE_SD * lever[:, :, None], smooth]


class _MeanPokes(NamedTuple):
    """Means over the pokes of each of c taxels, and of all taxels as the last row."""

    channels: IntArray
    """(c,) ascending."""
    tip_moves: FloatArray
    """(c + 1, 3, 3) float: derivative of a contact by an error of the tip: only along the push where a force axis places it."""
    pushes: FloatArray
    """(c + 1, 3) float, link frame: of the pokes with a tip; of all taxels zero."""

    @classmethod
    def collect(cls, contacts: Sequence[Contact], *, is_placed_by_tip: bool) -> _MeanPokes:
        """Collect contacts, in the part's frame."""
        if not contacts:
            return cls(np.empty(0, np.int64), np.zeros((1, 3, 3)), np.zeros((1, 3)))
        turns = np.array([contact.link_from_sensor[:3, :3] for contact in contacts])
        along = np.array([contact.force for contact in contacts], dtype=np.float64)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        has_tip = np.array([contact.tip is not None for contact in contacts])
        pushes = np.where(has_tip[:, None], (turns @ along[:, :, None])[:, :, 0], 0.0)
        moves = turns if is_placed_by_tip else pushes[:, :, None] * along[:, None]
        counts = [len(contact.channels) for contact in contacts]
        channels, of = np.unique(np.concatenate([contact.channels for contact in contacts]), return_inverse=True)
        order, rows = of.argsort(kind="stable"), np.repeat(np.arange(len(contacts)), counts)
        starts = np.searchsorted(of[order], np.arange(len(channels)))
        rows = rows[order]
        answers = np.diff(np.append(starts, len(rows)))
        with_tip = np.maximum(np.add.reduceat(has_tip[rows].astype(np.int64), starts), 1)
        mean_moves = np.add.reduceat(moves[rows], starts) / answers[:, None, None]
        mean_pushes = np.add.reduceat(pushes[rows], starts) / with_tip[:, None]
        return cls(
            channels,
            np.concatenate([mean_moves, mean_moves.mean(axis=0, keepdims=True)]),
            np.concatenate([mean_pushes, np.zeros((1, 3))]),
        )

    def rows_of(self, channels: Sequence[int]) -> IntArray:
        """Find the rows of channels; the last one for those without a poke."""
        wanted: IntArray = np.array(channels, dtype=np.int64)
        rows = np.searchsorted(self.channels, wanted)
        is_known = np.append(self.channels, -1)[rows] == wanted
        return np.where(is_known, rows, len(self.channels))


def add_shared_error(estimate: Estimate, moves: FloatArray) -> Estimate:
    """Add shifts (3, k), metres, by independent errors to an estimate; one without a position is not changed."""
    if estimate.position is None or estimate.covariance is None:
        return estimate
    if estimate.method is Method.SURFACE and estimate.normal is not None:
        moves = moves - np.outer(estimate.normal, estimate.normal @ moves)
    covariance = estimate.covariance + moves @ moves.T
    values, axes = np.linalg.eigh(covariance)
    worst = axes[:, -1]
    return replace(
        estimate,
        covariance=covariance,
        worst_direction=worst * np.copysign(1.0, worst[np.abs(worst).argmax()]),
        sd=float(np.sqrt(values[-1])),
        rms=float(np.sqrt(np.trace(covariance))),
        moved=moves if estimate.moved is None else np.concatenate([estimate.moved, moves], axis=1),
    )


def _mesh_normal(estimate: Estimate) -> FloatArray:
    """Give the normal (3,) of the mesh that an estimate is bound to; zero without one."""
    is_bound = estimate.triangle is not None and estimate.normal is not None
    return np.asarray(estimate.normal, dtype=np.float64) if is_bound else np.zeros(3)


def _pokes_of_part_fit(count: int) -> int:
    """Count the first pokes on the skin that a fit uses: 0 below `FIRST_FIT_POKES`, then in steps of a quarter."""
    used = 0 if count < FIRST_FIT_POKES else FIRST_FIT_POKES
    while used and int(np.ceil(used * REFIT_AT_POKE_COUNT_RATIO)) <= count:
        used = int(np.ceil(used * REFIT_AT_POKE_COUNT_RATIO))
    return used


def _contradicts_typed_pose(found: PartPose, shape: PartShape) -> bool:
    """Tell whether the pose that touches show, `found`, contradicts the given one, which is the identity here."""
    if found.state in (PartPoseState.FEW_TOUCHES, PartPoseState.DISAGREES):
        return False
    change = found.motion_to(np.eye(4))
    moves = motion_rows(shape.corners - found.centre) @ change
    far = float(np.linalg.norm(moves)) / len(moves) ** 0.5
    chi2 = float(change @ np.linalg.solve(found.scales.moment[:6, :6], change))
    return far > PART_POSE_MISMATCH_MIN_M and chi2 > PART_POSE_MISMATCH_CHI2


def _typed_pose_errors(found: PartPose, shape: PartShape, sd: float) -> PartPose:
    """Make the given pose with its error: of the sd that the scene gives it, less what the touches show of it.

    With the prior P of the given pose's error, about the middle of the part, and the second moment C of the error of the pose
    that the touches show, their difference D has the covariance P + C. So the given pose is wrong by P (P + C)^-1 D on average.

    Parameters
    ----------
    found : pose that the touches show where the given one is the identity
    sd : m, of the given pose, each direction
    """
    middle = mean_rows(shape.corners)
    prior = np.diag(np.repeat([sd / TYPED_POSE_LEVER_M, sd], 3) ** 2.0)
    moment = np.zeros_like(found.scales.moment)
    moment[:6, :6] = prior
    if found.state in (PartPoseState.FEW_TOUCHES, PartPoseState.DISAGREES):
        return replace(NO_PART_POSE, centre=middle, scales=replace(found.scales, moment=moment))
    to_middle = np.eye(6)
    to_middle[3:, :3] = motion_rows((middle - found.centre)[None])[0, :, :3]
    of_touches = to_middle @ found.scales.moment[:6, :6] @ to_middle.T
    share = np.asarray(np.linalg.solve(prior + of_touches, prior), dtype=np.float64).T
    shown = share @ to_middle @ found.motion_to(np.eye(4))
    moment[:6, :6] = prior - share @ prior + shown[:, None] * shown
    moment[UNKNOWNS_OF_POSE:, UNKNOWNS_OF_POSE:] = found.scales.moment[UNKNOWNS_OF_POSE:, UNKNOWNS_OF_POSE:]
    return replace(found, centre=middle, scales=replace(found.scales, moment=moment))
