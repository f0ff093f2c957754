"""The simulated rig: true values of the part, skin, arm poses and force/torque sensor.

The true taxels are the layout laid on the surface, displaced as a patch. The sensor reads (I + E) w + weight + offset; the true
arm pose differs slightly from the reported one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from skincal.files.reference import truth_as_json
from skincal.geometry import Arm, FloatArray, IntArray, crossed, inverse_pose, rotation_by
from skincal.mesh.lay import place_layout
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.model.skin import Anchor
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_tool import SimulatedTool


@dataclass(frozen=True, slots=True, eq=False)
class PressedPlaces:
    """n presses, link frame."""

    targets: IntArray
    """(n,) target channel, -1 for none."""
    points: FloatArray
    """(n, 3) float, metres: centre of the tip on the skin."""
    normals: FloatArray
    """(n, 3) float, unit outward normals of the skin."""
    directions: FloatArray
    """(n, 3) float, unit direction of the force on the part."""
    forces: FloatArray
    """(n,) float, N, full force."""
    turns: FloatArray
    """(n,) float, radians: turn of the square tip about the normal."""

    def __len__(self) -> int:
        return len(self.targets)

    def subset(self, rows: slice | IntArray) -> PressedPlaces:
        return PressedPlaces(*(getattr(self, item.name)[rows] for item in fields(self)))


def join(parts: list[PressedPlaces]) -> PressedPlaces:
    """Concatenate presses."""
    return PressedPlaces(*(np.concatenate([getattr(p, item.name) for p in parts]) for item in fields(PressedPlaces)))


def tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit directions (n, 3) across normals (n, 3): e1, the projection of the link's x axis, and e2 = n x e1.

    For normals within 26 degrees of x, e1 is the projection of y.
    """
    steep = np.abs(normals[:, 0]) > 0.9
    axes = np.where(steep[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    e1: FloatArray = axes - np.sum(axes * normals, axis=1, keepdims=True) * normals
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    return e1, np.asarray(np.cross(normals, e1), dtype=np.float64)


def push_directions(normals: FloatArray, tilts: FloatArray, azimuths: FloatArray) -> FloatArray:
    """Return unit pushes (n, 3) with `tilts` (n,) from the inward normal and `azimuths` (n,) from e1 to e2, radians."""
    e1, e2 = tangents(normals)
    sideways = np.cos(azimuths)[:, None] * e1 + np.sin(azimuths)[:, None] * e2
    return np.sin(tilts)[:, None] * sideways - np.cos(tilts)[:, None] * normals


def cone_tilts(count: int, cone: float, rng: np.random.Generator) -> FloatArray:
    """Draw tilts (count,), radians, uniform in solid angle within `cone`."""
    return np.arccos(rng.uniform(np.cos(cone), 1.0, count))


def tip_axes(pokes: PressedPlaces) -> tuple[FloatArray, FloatArray]:
    """Return the unit side directions (n, 3) of the square tips."""
    e1, e2 = tangents(pokes.normals)
    c, s = np.cos(pokes.turns)[:, None], np.sin(pokes.turns)[:, None]
    return c * e1 + s * e2, c * e2 - s * e1


def add_hand_noise(pushes: FloatArray, sd: float, rng: np.random.Generator) -> FloatArray:
    """Add a random tilt to pushes (n, 3), `sd` radians in each direction."""
    e1, e2 = tangents(pushes)
    lean = np.tan(sd * rng.standard_normal((len(pushes), 2)))
    off = pushes + lean[:, :1] * e1 + lean[:, 1:] * e2
    return off / np.linalg.norm(off, axis=1, keepdims=True)


def limit_tilt(pushes: FloatArray, normals: FloatArray, usable: float) -> FloatArray:
    """Limit the tilt of pushes (n, 3) from their inward normals to `usable`, radians; a steeper push slides off."""
    inward = -np.sum(pushes * normals, axis=1, keepdims=True)
    aside = pushes + inward * normals
    length = np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    leaning = np.sin(usable) * aside / length - np.cos(usable) * normals
    return np.where(inward < np.cos(usable), leaning, pushes)


TAXELS_CHECKED_AROUND_TIP = 40
"""Taxels checked around a tip. Fewer are within `Foam.reach` in every shipped layout."""
POINTS_PER_NEIGHBOUR_SEARCH = 256
"""Points per block of the neighbour search: 9 MB of distances to 4,200 taxels."""
DEFAULT_RANGE = (0.0, 255.0)
"""Default raw range of a skin: eight bits."""
REST_SHARE = 240 / 255
"""Untouched reading as a share of the range, from the pressed end (an iCub's: 235 to 244)."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedArmPose:
    """Reported and true values of one arm pose."""

    name: str
    angles: FloatArray
    """(joints,) float, radians, as reported; empty without an arm."""
    reported: FloatArray
    """(4, 4) float: link_from_sensor from the joints."""
    true: FloatArray
    """(4, 4) float: true link_from_sensor."""
    weight: FloatArray
    """(6,) float, N and N m, sensor frame: wrench of the part's weight."""


class Rig:
    """A simulated rig and its sensor readings. `rng` draws all errors that are constant in a session.

    Raises InputError if the scene has no taxel positions, or its taxels measure three axes (see `make_rig`).
    """

    values_shape: tuple[int, ...] = ()
    """Shape of a taxel's answer."""

    @classmethod
    def require_skin(cls, scene: Scene) -> object:
        """Raise InputError for a skin that the rig does not have."""
        if scene.skin.axes is not None:
            raise InputError(f"{scene.path}: this simulation has taxels of one axis; leave out axes = 3.")

    def __init__(self, scene: Scene, surface: Surface | None, errors: RigErrors, rng: np.random.Generator) -> None:
        # Separate random streams: a rig with another sensor has the same skin.
        mount, skin, arm, sensor = rng.spawn(4)
        self.require_skin(scene)
        self.scene, self.surface, self.errors, self.foam = scene, surface, errors, Foam()
        self.channels, self.places, self.normals = _mounted(scene, surface, errors, mount)
        if surface is not None:
            # Builds the search tree now instead of in the first poke.
            nearest_points(surface, self.places[:1])
        self._squares = np.sum(self.places * self.places, axis=1)
        self._row = np.full(scene.skin.channels, -1, dtype=np.int64)
        self._row[self.channels] = np.arange(len(self.channels))
        self._set_up_skin(skin)
        nominal = _nominal(scene)
        self.arm_poses = {name: self._arm_pose(name, angles, pose, arm) for name, (angles, pose) in nominal.items()}
        self._set_up_sensor(sensor)
        self.tool = None if scene.tool is None else SimulatedTool(scene.tool, errors, *rng.spawn(1))
        """The arm that holds the tool; `None` if a hand pokes."""

    def _set_up_skin(self, rng: np.random.Generator) -> None:
        low, high = self.scene.skin.range or DEFAULT_RANGE
        self.polarity = self.scene.skin.polarity
        self.range = (low, high)
        self.counts = (high - low) / 255.0
        """Raw units per count of 255."""
        start = high - REST_SHARE * (high - low) if self.polarity > 0 else low + REST_SHARE * (high - low)
        spread = self.errors.baseline_spread * self.counts
        count = len(self.channels)
        self.baselines = np.clip(start + spread * rng.standard_normal(count), low, high)
        self.gains = np.maximum(1.0 + self.errors.gain_spread * rng.standard_normal(count), 0.1)
        self._idle = np.full(self.scene.skin.channels, low if self.polarity > 0 else high)
        self._idle[self.channels] = self.baselines

    def _set_up_sensor(self, rng: np.random.Generator) -> None:
        # Moments count as forces at `matrix_arm`, so that one relative error is used for all components.
        units = np.repeat([1.0, self.errors.matrix_arm], 3)
        e = self.errors.matrix * rng.standard_normal((6, 6)) * units[:, None] / units[None, :]
        self.matrix = np.eye(6) + e
        scale = np.repeat([self.errors.offset_force, self.errors.offset_moment], 3)
        self.offset = scale * rng.standard_normal(6)

    def _arm_pose(self, name: str, angles: FloatArray, reported: FloatArray, rng: np.random.Generator) -> SimulatedArmPose:
        error = np.eye(4)
        error[:3, :3] = rotation_by(self.errors.pose_turn * rng.standard_normal(3))
        error[:3, 3] = self.errors.pose_shift * rng.standard_normal(3)
        true = reported @ error
        middle = self.places.mean(axis=0)
        down = rng.standard_normal(3)
        pull = self.errors.weight * down / np.linalg.norm(down)
        centre = inverse_pose(true)[:3] @ np.append(middle, 1.0)
        return SimulatedArmPose(name, angles, reported, true, np.concatenate([pull, np.cross(centre, pull)]))

    def row_of(self, channel: int) -> int:
        """Return the index of a channel in `channels`, `places` and `normals`. Raises InputError if it is no taxel."""
        if not 0 <= channel < len(self._row) or self._row[channel] < 0:
            has = f"{len(self.channels)} taxels, channels {self.channels[0]} to {self.channels[-1]} with gaps"
            raise InputError(f"channel {channel} is not a taxel of {self.scene.name}; it has {has}.")
        return int(self._row[channel])

    def truth(self) -> dict[str, Any]:
        """Return the true taxels for `truth.json`."""
        return truth_as_json(self.scene.link, self.channels, self.places, self.normals)

    def arm_pose(self, name: str | None = None) -> SimulatedArmPose:
        """Return an arm pose by its name, or the first one. Raises InputError if the scene has no such pose."""
        if name is None:
            return next(iter(self.arm_poses.values()))
        if name not in self.arm_poses:
            raise InputError(f"arm pose {name!r} is not in {self.scene.name}; it has {', '.join(map(repr, self.arm_poses))}.")
        return self.arm_poses[name]

    def true_wrenches(self, points: FloatArray, forces: FloatArray, arm_pose: SimulatedArmPose) -> FloatArray:
        """Return the true wrenches (..., 6) of pure forces (..., 3), N, at points (..., 3), metres (eqs. 1-2), sensor frame.

        Points and forces on the part are in the link frame.
        """
        sensor_from_link = inverse_pose(arm_pose.true)
        f = forces @ sensor_from_link[:3, :3].T
        c = points @ sensor_from_link[:3, :3].T + sensor_from_link[:3, 3]
        return np.concatenate([f, crossed(c, f)], axis=-1)

    def read_wrenches(self, wrenches: FloatArray) -> FloatArray:
        """Apply the sensor's matrix, (I + E) w, to wrenches (..., 6)."""
        return wrenches @ self.matrix.T

    def answers(self, pokes: PressedPlaces, loads: FloatArray, at_once: int | None = None) -> tuple[IntArray, FloatArray]:
        """Return the responses to n presses with `loads` (n,), N, without noise.

        Taxels are searched for `at_once` successive presses together, or for all: the last bits of a distance depend on it.

        Returns
        -------
        rows : (n, k) int, indices into `channels` of nearby taxels
        answers : (n, k) float >= 0, raw units above the baseline
        """
        rows = self.taxels_near(pokes.points.reshape(-1, at_once or max(len(pokes), 1), 3))
        rows = rows.reshape(len(pokes), rows.shape[-1])
        share = felt_share(self.foam, self.places[rows] - pokes.points[:, None], *tip_axes(pokes))
        normal_load = -loads * np.sum(pokes.directions * pokes.normals, axis=1)
        low, high = self.range
        room = high - self.baselines if self.polarity > 0 else self.baselines - low
        return rows, self.gains[rows] * room[rows] * answer(self.foam, normal_load[:, None], share)

    def taxels_near(self, points: FloatArray) -> IntArray:
        """Return the rows (groups, n, k) of the taxels near each point (groups, n, 3)."""
        near = min(TAXELS_CHECKED_AROUND_TIP, len(self.places))
        groups, count, _ = points.shape
        if near == len(self.places):
            return np.tile(np.arange(near), (groups, count, 1))
        rows = np.empty((groups, count, near), dtype=np.int64)
        each = max(POINTS_PER_NEIGHBOUR_SEARCH // max(min(count, POINTS_PER_NEIGHBOUR_SEARCH), 1), 1)
        for first in range(0, groups, each):
            for start in range(0, count, POINTS_PER_NEIGHBOUR_SEARCH):
                # |p - q|^2 without |p|^2, which is equal for all taxels.
                part = np.s_[first : first + each, start : start + POINTS_PER_NEIGHBOUR_SEARCH]
                distances = self._squares - 2.0 * (points[part] @ self.places.T)
                rows[part] = np.argpartition(distances, near, axis=-1)[..., :near]
        return rows

    def skin_frame(self, answers: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return raw frames (n, width) for responses (n, taxels): with baseline and noise, clipped and rounded."""
        frames: FloatArray = np.tile(self._idle, (len(answers), 1))
        noise = self.errors.skin_noise * self.counts * rng.standard_normal(answers.shape)
        frames[:, self.channels] += self.polarity * answers + noise
        low, high = self.range
        return np.clip(np.rint(frames), low, high, dtype=np.float64)


def _mounted(
    scene: Scene, surface: Surface | None, errors: RigErrors, rng: np.random.Generator
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return channels, true positions and normals of the mounted skin."""
    layout, anchor = scene.skin.layout, scene.skin.anchor
    if layout is None or (anchor is None and all(m.anchor is None for m in layout.modules)):
        raise InputError(f"{scene.path}: a simulated skin needs [skin] modules and an anchor, to know where its taxels are.")
    modules = tuple(m if m.anchor is None else replace(m, anchor=_displaced(m.anchor, errors, rng)) for m in layout.modules)
    laid = place_layout(layout.with_modules(modules), None if anchor is None else _displaced(anchor, errors, rng), surface)
    if laid is None:
        raise InputError(f"{scene.path}: the layout could not be laid; check its anchor.")
    channels = layout.channels
    places, normals = laid.places[channels], laid.normals[channels]
    known = np.isfinite(places).all(axis=1)
    return channels[known], places[known], normals[known]


def _displaced(anchor: Anchor, errors: RigErrors, rng: np.random.Generator) -> Anchor:
    """Return the anchor with a random shift and turn in its plane."""
    angle = errors.mount_turn * rng.standard_normal()
    x = np.cos(angle) * anchor.x + np.sin(angle) * np.cross(anchor.normal, anchor.x)
    return replace(anchor, at=anchor.at + errors.mount_shift * rng.standard_normal(2), x=x)


def _nominal(scene: Scene) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return (angles, link_from_sensor) of every arm pose by name."""
    if scene.arm is None:
        return {"": (np.empty(0), scene.sensor_pose)}
    arm = scene.arm.arm
    poses = scene.arm.poses
    if not poses:
        poses = {"zero": np.zeros(len(arm.joints))} if isinstance(arm, Arm) else {"middle": arm.middle_angles()}
    return {name: (angles, arm.link_from_sensor(angles)) for name, angles in poses.items()}


@dataclass(frozen=True, slots=True)
class Foam:
    """Response of taxels to a flat square tip on foam, SI units.

    The tip's uniform pressure spreads in foam and pad, and decays exponentially outside the tip, as in an elastic layer on
    hard ground. A taxel at tangential distance (x, y) from the tip's centre gets the share g = B(x) B(y) of the load, a box of
    half width a with logistic flanks of width s: B(x) = (tanh((x + a)/2s) - tanh((x - a)/2s)) / (2 tanh(a/2s)). The response
    to the normal load F saturates, because foam stiffens: q (1 - exp(-F g / F0)).

    Not modelled: shear under tilted pushes, pressure at an edge of a tilted tip, creep.
    """

    tip_half: float = 0.002
    """m. Half the side of the paper's 4 x 4 mm tip (section IV)."""
    spread: float = 0.0013
    """m. s; the flank's sd is 1.8 times as much: a 2 to 3 mm layer of foam (section III-B) and pads of about 4 mm. With
    it three taxels answer a poke on average, as in the paper."""
    force_scale: float = 8.0
    """N, F0: the response to an ordinary poke (6 to 12 N) is not yet saturated. Assumed."""
    full_share: float = 0.75
    """q, relative to the range from the baseline to the pressed end. Assumed."""
    reach: float = 0.015
    """m. No response beyond it; g is below 1e-4 there."""
    lag: float = 0.015
    """s, delay of the response after the force: first order, 15 ms."""


def felt_share(foam: Foam, offsets: FloatArray, axis_x: FloatArray, axis_y: FloatArray) -> FloatArray:
    """Return the share g (n, k) of the tip's load at taxels, 0 to 1.

    `offsets` (n, k, 3), metres, point from the tip's centre to the taxels; the axes (n, 3) are the tip's sides.
    """
    x = np.einsum("nki,ni->nk", offsets, axis_x)
    y = np.einsum("nki,ni->nk", offsets, axis_y)
    near = np.einsum("nki,nki->nk", offsets, offsets) < foam.reach**2
    return np.where(near, _blurred_box(foam, x) * _blurred_box(foam, y), 0.0)


def _blurred_box(foam: Foam, x: FloatArray) -> FloatArray:
    half, width = foam.tip_half, 2 * foam.spread
    return (np.tanh((x + half) / width) - np.tanh((x - half) / width)) / (2 * np.tanh(half / width))


def answer(foam: Foam, normal_load: FloatArray, share: FloatArray) -> FloatArray:
    """Return a taxel's response, 0 to `full_share`, to its `felt_share` of a normal load, N."""
    return foam.full_share * -np.expm1(-np.maximum(normal_load, 0.0) * share / foam.force_scale)
