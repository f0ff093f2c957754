"""The simulated rig: a part with its skin, its arm pose and its force/torque sensor, and what each really is.

A poke is geometry here: where a tip presses, which way and how hard. The true places of the taxels are the plan's layout laid
on the surface, displaced as a patch. The sensor reads (I + E) w + weight + offset; the arm really is a little beside the
pose that its joints report.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from skincal.geometry import FloatArray, IntArray, cross_matrix, inverse_pose
from skincal.mesh.lay import place_layout
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.model.skin import Anchor, Layout
from skincal.simulate.rig_errors import RigErrors


@dataclass(frozen=True, slots=True, eq=False)
class PressedPlaces:
    """n places pressed, link frame."""

    targets: IntArray
    """(n,) channel that was aimed at."""
    points: FloatArray
    """(n, 3) float, metres: the middle of the tip, on the skin."""
    normals: FloatArray
    """(n, 3) float, unit, outward, of the skin at the point."""
    directions: FloatArray
    """(n, 3) float, unit: which way the tip pushes the part."""
    forces: FloatArray
    """(n,) float, N, while held."""
    turns: FloatArray
    """(n,) float, radians: how the square tip is turned about the normal."""

    def __len__(self) -> int:
        """Return the number of places."""
        return len(self.targets)

    def take(self, rows: slice | IntArray) -> PressedPlaces:
        """Return some of the places."""
        return PressedPlaces(*(getattr(self, item.name)[rows] for item in fields(self)))


def join(parts: list[PressedPlaces]) -> PressedPlaces:
    """Return all places of several as one."""
    return PressedPlaces(*(np.concatenate([getattr(p, item.name) for p in parts]) for item in fields(PressedPlaces)))


def tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit directions in the plane of the skin: e1 along the link's x where that is in the plane, e2 = n x e1.

    Where the normal (n, 3) lies within 26 degrees of x, y takes its place.
    """
    steep = np.abs(normals[:, 0]) > 0.9
    axes = np.where(steep[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    e1: FloatArray = axes - np.sum(axes * normals, axis=1, keepdims=True) * normals
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    return e1, np.asarray(np.cross(normals, e1), dtype=np.float64)


def push_directions(normals: FloatArray, tilts: FloatArray, azimuths: FloatArray) -> FloatArray:
    """Return (n, 3) unit pushes that lean from the inward normal by `tilts` (n,), towards `azimuths` (n,) from e1 to e2."""
    e1, e2 = tangents(normals)
    sideways = np.cos(azimuths)[:, None] * e1 + np.sin(azimuths)[:, None] * e2
    return np.sin(tilts)[:, None] * sideways - np.cos(tilts)[:, None] * normals


def cone_tilts(count: int, cone: float, rng: np.random.Generator) -> FloatArray:
    """Return (count,) tilts, radians, of directions that are uniform in solid angle within `cone` of the normal."""
    return np.arccos(rng.uniform(np.cos(cone), 1.0, count))


def tip_axes(pokes: PressedPlaces) -> tuple[FloatArray, FloatArray]:
    """Return the (n, 3) unit sides of the square tips, in the plane of the skin."""
    e1, e2 = tangents(pokes.normals)
    c, s = np.cos(pokes.turns)[:, None], np.sin(pokes.turns)[:, None]
    return c * e1 + s * e2, c * e2 - s * e1


def add_hand_noise(pushes: FloatArray, sd: float, rng: np.random.Generator) -> FloatArray:
    """Return the pushes (n, 3) that a hand makes of those it means, `sd` about them in each direction, radians."""
    e1, e2 = tangents(pushes)
    lean = np.tan(sd * rng.standard_normal((len(pushes), 2)))
    off = pushes + lean[:, :1] * e1 + lean[:, 1:] * e2
    return off / np.linalg.norm(off, axis=1, keepdims=True)


def limit_tilt(pushes: FloatArray, normals: FloatArray, usable: float) -> FloatArray:
    """Return the pushes (n, 3), each that leans more taken back to `usable` from its inward normal: it would slide off."""
    inward = -np.sum(pushes * normals, axis=1, keepdims=True)
    aside = pushes + inward * normals
    length = np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    leaning = np.sin(usable) * aside / length - np.cos(usable) * normals
    return np.where(inward < np.cos(usable), leaning, pushes)


NEIGHBOURS = 40
"""Taxels looked at around a tip: within `Foam.reach` of a point of any layout here there are fewer."""
NEAR_BLOCK = 256
"""Points whose neighbours are looked up at once: 9 MB of distances to 4,200 taxels."""
DEFAULT_RANGE = (0.0, 255.0)
"""Raw range of a skin whose scene names none: eight bits."""
REST_SHARE = 240 / 255
"""Untouched reading, as a share of the range away from the end that pressure drives to (an iCub's: 235 to 244)."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedArmPose:
    """One arm pose: what the joints report and what is."""

    name: str
    angles: FloatArray
    """(joints,) float, radians, as reported; empty without an arm."""
    reported: FloatArray
    """(4, 4) float: link_from_sensor by the chain."""
    true: FloatArray
    """(4, 4) float: link_from_sensor as it is."""
    weight: FloatArray
    """(6,) float, N and N m, sensor frame: what the part's weight adds."""


class Rig:
    """What a simulated rig is, and what its sensors say of pokes; `rng` draws everything that stays for a session.

    Raises
    ------
    InputError
        The scene does not say where taxels lie.
    """

    def __init__(self, scene: Scene, surface: Surface | None, errors: RigErrors, rng: np.random.Generator) -> None:
        # Each part draws by itself: a rig with another sensor has the same skin.
        mount, skin, arm, sensor = rng.spawn(4)
        self.scene, self.surface, self.errors, self.foam = scene, surface, errors, Foam()
        self.channels, self.places, self.normals = _mounted(scene, surface, errors, mount)
        if surface is not None:
            # Builds the surface's search tree now rather than in the middle of the first poke.
            nearest_points(surface, self.places[:1])
        self._squares = np.sum(self.places * self.places, axis=1)
        self._row = np.full(scene.skin.channels, -1, dtype=np.int64)
        self._row[self.channels] = np.arange(len(self.channels))
        self._set_up_skin(skin)
        nominal = _nominal(scene)
        self.arm_poses = {name: self._arm_pose(name, angles, pose, arm) for name, (angles, pose) in nominal.items()}
        self._set_up_sensor(sensor)

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
        # Moments count as forces at `matrix_arm`: so one relative error holds for all six components.
        units = np.repeat([1.0, self.errors.matrix_arm], 3)
        e = self.errors.matrix * rng.standard_normal((6, 6)) * units[:, None] / units[None, :]
        self.matrix = np.eye(6) + e
        scale = np.repeat([self.errors.offset_force, self.errors.offset_moment], 3)
        self.offset = scale * rng.standard_normal(6)

    def _arm_pose(self, name: str, angles: FloatArray, reported: FloatArray, rng: np.random.Generator) -> SimulatedArmPose:
        error = np.eye(4)
        error[:3, :3] = _rotation(self.errors.pose_turn * rng.standard_normal(3))
        error[:3, 3] = self.errors.pose_shift * rng.standard_normal(3)
        true = reported @ error
        middle = self.places.mean(axis=0)
        down = rng.standard_normal(3)
        pull = self.errors.weight * down / np.linalg.norm(down)
        centre = inverse_pose(true)[:3] @ np.append(middle, 1.0)
        return SimulatedArmPose(name, angles, reported, true, np.concatenate([pull, np.cross(centre, pull)]))

    def row_of(self, channel: int) -> int:
        """Return the index of a channel in `channels`, `places` and `normals`.

        Raises
        ------
        InputError
            The channel is not a taxel.
        """
        if not 0 <= channel < len(self._row) or self._row[channel] < 0:
            has = f"{len(self.channels)} taxels, channels {self.channels[0]} to {self.channels[-1]} with gaps"
            raise InputError(f"channel {channel} is not a taxel of {self.scene.name}; it has {has}.")
        return int(self._row[channel])

    def truth(self) -> dict[str, Any]:
        """Return where the taxels really are: link frame, metres, unit normals."""
        taxels = zip(self.channels.tolist(), self.places.tolist(), self.normals.tolist(), strict=True)
        return {
            "link": self.scene.link,
            "taxels": [{"channel": channel, "position_m": place, "normal": normal} for channel, place, normal in taxels],
        }

    def arm_pose(self, name: str | None = None) -> SimulatedArmPose:
        """Return an arm pose by its name; the first one for None.

        Raises
        ------
        InputError
            The scene has no such pose.
        """
        if name is None:
            return next(iter(self.arm_poses.values()))
        if name not in self.arm_poses:
            raise InputError(f"arm pose {name!r} is not in {self.scene.name}; it has {', '.join(map(repr, self.arm_poses))}.")
        return self.arm_poses[name]

    def true_wrenches(self, points: FloatArray, forces: FloatArray, arm_pose: SimulatedArmPose) -> FloatArray:
        """Return (n, 6) the wrenches of pure forces at points (eqs. 1-2), sensor frame, before the sensor's errors.

        Parameters
        ----------
        points : (n, 3) float, metres, link frame
        forces : (n, 3) float, N, link frame, on the part
        arm_pose : the arm pose; its true one counts
        """
        sensor_from_link = inverse_pose(arm_pose.true)
        f = forces @ sensor_from_link[:3, :3].T
        c = points @ sensor_from_link[:3, :3].T + sensor_from_link[:3, 3]
        return np.concatenate([f, np.cross(c, f)], axis=1)

    def read_wrenches(self, wrenches: FloatArray) -> FloatArray:
        """Return (n, 6) wrenches as the sensor's matrix gives them, (I + E) w."""
        return wrenches @ self.matrix.T

    def answers(self, pokes: PressedPlaces, loads: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return which taxels answer each of n places under `loads` (n,), N, and by how much, without noise.

        Returns
        -------
        rows : (n, k) int, indices into `channels`
        answers : (n, k) float >= 0, raw units above the baseline
        """
        rows = self._near(pokes.points)
        share = felt_share(self.foam, self.places[rows] - pokes.points[:, None], *tip_axes(pokes))
        normal_load = -loads * np.sum(pokes.directions * pokes.normals, axis=1)
        low, high = self.range
        room = high - self.baselines if self.polarity > 0 else self.baselines - low
        return rows, self.gains[rows] * room[rows] * answer(self.foam, normal_load[:, None], share)

    def _near(self, points: FloatArray) -> IntArray:
        """Return (n, k) the taxels that may feel a tip at each point."""
        near = min(NEIGHBOURS, len(self.places))
        if near == len(self.places):
            # numpy parts a few from more, not all from all.
            return np.tile(np.arange(near), (len(points), 1))
        rows = np.empty((len(points), near), dtype=np.int64)
        for start in range(0, len(points), NEAR_BLOCK):
            # |p - q|^2 without |p|^2, which is the same for all taxels of a point.
            block = points[start : start + NEAR_BLOCK]
            distances = self._squares - 2.0 * (block @ self.places.T)
            rows[start : start + NEAR_BLOCK] = np.argpartition(distances, near, axis=1)[:, :near]
        return rows

    def skin_frame(self, answers: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return (n, width) raw frames of answers (n, taxels) above the baselines, with noise, clipped and rounded."""
        frames: FloatArray = np.tile(self._idle, (len(answers), 1))
        noise = self.errors.skin_noise * self.counts * rng.standard_normal(answers.shape)
        frames[:, self.channels] += self.polarity * answers + noise
        low, high = self.range
        return np.clip(np.rint(frames), low, high, dtype=np.float64)


def _mounted(
    scene: Scene, surface: Surface | None, errors: RigErrors, rng: np.random.Generator
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return channels, places and normals of the skin as it really is mounted."""
    layout, anchor = scene.skin.layout, scene.skin.anchor
    if layout is None or (anchor is None and all(m.anchor is None for m in layout.modules)):
        raise InputError(f"{scene.path}: a simulated skin needs [skin] modules and an anchor, to know where its taxels are.")
    modules = tuple(m if m.anchor is None else replace(m, anchor=_displaced(m.anchor, errors, rng)) for m in layout.modules)
    laid = place_layout(Layout(modules, layout.width), None if anchor is None else _displaced(anchor, errors, rng), surface)
    if laid is None:
        raise InputError(f"{scene.path}: the layout could not be laid; check its anchor.")
    channels = layout.channels
    places, normals = laid.places[channels], laid.normals[channels]
    known = np.isfinite(places).all(axis=1)
    return channels[known], places[known], normals[known]


def _displaced(anchor: Anchor, errors: RigErrors, rng: np.random.Generator) -> Anchor:
    """Return the anchor of a skin that was stuck on beside its plan: shifted and turned in its own plane."""
    angle = errors.mount_turn * rng.standard_normal()
    x = np.cos(angle) * anchor.x + np.sin(angle) * np.cross(anchor.normal, anchor.x)
    return replace(anchor, at=anchor.at + errors.mount_shift * rng.standard_normal(2), x=x)


def _nominal(scene: Scene) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return name to (angles, link_from_sensor) of every pose there is."""
    if scene.arm is None:
        return {"": (np.empty(0), scene.sensor_pose)}
    poses = scene.arm.poses or {"zero": np.zeros(len(scene.arm.arm.joints))}
    return {name: (angles, scene.arm.arm.link_from_sensor(angles)) for name, angles in poses.items()}


def _rotation(vector: FloatArray) -> FloatArray:
    """Return the (3, 3) turn about `vector` by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    s = cross_matrix(vector / angle)
    return np.eye(3) + np.sin(angle) * s + (1 - np.cos(angle)) * (s @ s)


@dataclass(frozen=True, slots=True)
class Foam:
    """Tip and foam, SI units: what a taxel answers when a flat square tip presses the foam above it.

    The tip's pressure is uniform over its square; foam and the taxel's own pad spread it, and it dies away exponentially
    beyond the tip, as it does in an elastic layer on a hard ground. So the share of the load that a taxel at tangential
    distance (x, y) from the tip's middle feels is g = B(x) B(y), a box of half width a with logistic flanks of width s:
    B(x) = (tanh((x + a)/2s) - tanh((x - a)/2s)) / (2 tanh(a/2s)), one under the tip, smoothly nothing beyond. The answer
    rises with the normal load F g and saturates mildly, as foam stiffens: q (1 - exp(-F g / F0)).

    Not modelled: shear of the foam under tilted pushes, pressure that gathers at an edge of a tilted tip, creep.
    """

    tip_half: float = 0.002
    """m. Half the side of the paper's 4 x 4 mm tip (section IV)."""
    spread: float = 0.0013
    """m. s; the flank's sd is 1.8 times as much: a 2 to 3 mm layer of foam (section III-B) and pads of about 4 mm. With
    it three taxels answer a poke on average, as in the paper."""
    force_scale: float = 8.0
    """N. F0: at the force of an ordinary poke (6 to 12 N) the answer is bent but not flat. Assumed."""
    full_share: float = 0.75
    """q as a share of the way from the baseline to the end of the device's range. Assumed."""
    reach: float = 0.015
    """m. Beyond it a taxel feels nothing; g is below 1e-4 there."""
    lag: float = 0.015
    """s. The foam answers later than the force by this much: a first-order response of 15 ms."""


def felt_share(foam: Foam, offsets: FloatArray, axis_x: FloatArray, axis_y: FloatArray) -> FloatArray:
    """Return (n, k) the share g of the tip's load that taxels feel, 0 to 1.

    `offsets` (n, k, 3), metres, go from the middle of the tip to the taxels; the axes (n, 3) are the tip's sides.
    """
    x = np.einsum("nki,ni->nk", offsets, axis_x)
    y = np.einsum("nki,ni->nk", offsets, axis_y)
    near = np.einsum("nki,nki->nk", offsets, offsets) < foam.reach**2
    return np.where(near, _blurred_box(foam, x) * _blurred_box(foam, y), 0.0)


def _blurred_box(foam: Foam, x: FloatArray) -> FloatArray:
    half, width = foam.tip_half, 2 * foam.spread
    return (np.tanh((x + half) / width) - np.tanh((x - half) / width)) / (2 * np.tanh(half / width))


def answer(foam: Foam, normal_load: FloatArray, share: FloatArray) -> FloatArray:
    """Return a taxel's answer to a load along the inward normal, N, of which it feels `felt_share`: 0 to `full_share`."""
    return foam.full_share * -np.expm1(-np.maximum(normal_load, 0.0) * share / foam.force_scale)
