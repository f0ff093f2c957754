"""The second simulator: contact and sensor from first principles, independent of the first one and of the program.

It shares types with the program: it reads a `Scene`, and puts its session into `Contact`, `Pokes` and `LandmarkPokes`, which
carry arrays. What these types compute is not used here, so no truth is made with the code that it tries. An import contract and
a test check it.

A tip presses the outer face of a foam on a curved part. The taxels lie under the foam, on the mesh. The force/torque (F/T)
sensor reads, in its own frame, through an arm that is not where its joints put it:

    w = (f, c x f),   read = (I + E) w + Q(w, w) + hysteresis + slow noise + white noise.

Contact: a round tip of radius R on a foam of independent columns (Winkler; K. L. Johnson, Contact Mechanics, 4.3):
p = K (d - r^2/2R), so F = pi R K d^2 and the patch has the radius a = sqrt(2 R d). At the taxels, the foam and the taxel's own
pad have spread this to about a Gaussian. A taxel reads the compression of the foam above it, under the tip, while the force
acts on the outer face, along the push. So the axis of a leaning push crosses the taxels' layer off the answering point, by
thickness x tan(lean), and farther after shear of the foam. (A flat tip parallel to the skin would carry half of that moment by
its own pressure: this is the worse case.)

Everything is drawn from a seed. Lengths are metres, forces newtons, angles radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.outcome import Contact
from skincal.geometry import Arm, FloatArray, IntArray
from skincal.pokes import LandmarkPokes, Pokes

if TYPE_CHECKING:
    from skincal.model.scene import Scene

MM, DEGREE = 1e-3, float(np.radians(1.0))

SURFACE_PATH_STEPS = 50
"""Steps of a straight way on the part. A way of 40 mm on a radius of 25 mm errs by 0.01 mm."""
TRIANGLES_CHECKED_FOR_NEAREST_POINT = 12
"""Triangles looked at for the nearest point: those that meet at a corner, and their neighbours."""
TYPICAL_PRESS_FORCE_N = 10.0
"""N: an operator presses with 6 to 12 N; errors of the sensor that grow with the load are given at this."""
TYPICAL_LEVER_ARM_M = 0.2
"""m, from the forearm's sensor to its skin (0.1 to 0.25 m): the typical moment is `TYPICAL_PRESS_FORCE_N` times this."""
SKIN_FORCES = (6.0, 12.0)
"""N: between the gates of 4 and 15 N, as operators are asked to press."""
LANDMARK_FORCES = (8.0, 13.0)
"""N: a tip on a screw head is pressed harder than one on foam."""
LANDMARK_CONE = 28 * DEGREE
"""Pushes at a landmark lean at most this far from its normal."""
FOAM_STIFFNESS_PA_PER_M = 3e8
"""Pa/m: of the foam's columns, K. Foam of 0.75 MPa, 2.5 mm thick: 8 N on a tip of 3 mm press it in by 1.7 mm."""
TAXEL_ELECTRODE_RADIUS_M = 0.002
"""m: radius of a taxel's electrode (Maiolino et al. 2013: about 4 mm across)."""
FOAM_PRESSURE_SPREAD_M = 0.0013
"""m: the foam spreads pressure by about half its thickness, as an elastic layer on hard ground does."""
LOAD_FOR_63_PERCENT_RESPONSE_N = 2.5
"""Load on a pad for 63 % of `MAX_TAXEL_RESPONSE_COUNTS`: foam stiffens. On average three taxels answer a poke."""
MAX_TAXEL_RESPONSE_COUNTS = 180.0
"""Counts of 255 that a taxel falls at most: from about 240 at rest to some 60 (iCub)."""
FRAME_VARIANCE_SHARE = 1 / 15 + 1 / 10
"""A still window of 0.3 s has 15 frames, a quiet one 10, at 50 Hz: the variance of their difference is this share."""
COUNT_VARIANCE = 1.0 + 1 / 12
"""Counts^2, variance of one frame: one count of noise and the rounding to whole counts, which that noise blurs."""
MOMENT_OVER_FORCE_NOISE_M = 0.1
"""m: noise of a moment over noise of a force, 0.010 N m and 0.10 N as in the scene's `[noise]`."""
FORCE_MOMENT_CROSSTALK_ARM_M = 0.35
"""m: entries of E between force and moment count a moment as a force times this, as `RigPrior` assumes."""
SLOW_NOISE_CORRELATION_POKES = 30.0
"""Pokes over which slow noise remembers: about a minute, as a sensor that warms up in a moving room."""
MESH_BUMP_CORRELATION_LENGTH_M = 0.020
"""m: how far bumps of a mesh reach: it bends between the points it was scanned or drawn at."""
FINGER_WIDTH_M = 0.008
"""m between the two places that a finger touches: its breadth, a little more than the pitch of the taxels."""
SIMULATED_LANDMARK_POKES_PER_POSE = 10
"""Pokes at landmarks in each arm pose, if the scene has landmarks."""
GUIDED_LANDMARK_POKES = (6, 3, 3, 3, 2, 2, 2)
"""Landmark pokes in each arm pose that the guide asks for: 21 in seven poses."""


@dataclass(frozen=True, slots=True)
class RigModel:
    """Errors of a rig, its skin, its landmarks and its operator. The defaults are those that the program models.

    `RigModel()` has the paper's rig errors by the sizes of `RigPrior`: 2 %, 1 degree, 2 mm, 0.7 mm.
    """

    # ---- force/torque sensor
    matrix: float = 0.02
    """sd of each entry of E, cross-talk included."""
    quadratic: float = 0.0
    """Rms of Q(w, w) over w, both as vectors in units of `TYPICAL_PRESS_FORCE_N` and its moment, where |w| is these."""
    hysteresis: float = 0.0
    """Share of its load that the sensor keeps after a poke: the tares before and after each see a part of it."""
    force_noise: float = 0.10
    """N, white, of a poke's tared mean; moments `MOMENT_OVER_FORCE_NOISE_M` times as much. FT45: 0.25 N a reading, and slow
    noise."""
    slow_force: float = 0.0
    """N rms, noise that successive pokes share (`SLOW_NOISE_CORRELATION_POKES`); moments as above. It is creep of the strain
    gauges under load, which a tare around every poke does not remove."""
    # ---- arm
    pose_turn: float = DEGREE
    """sd about each axis through the sensor, of each arm pose."""
    pose_shift: float = 2 * MM
    """sd along each axis."""
    wander_turn: float = 0.0
    """Rms about each axis of the arm's random walk within a pose: servos creep under the hand."""
    wander_shift: float = 0.0
    """Rms along each axis."""
    flex: float = 0.0
    """rad per N m: the arm bends under the poke, about the sensor. A joint of 100 N m/rad gives by 0.6 degrees at 1 N m.
    (What a pose's own weight bends is the same for all its pokes: an error of the pose.)"""
    # ---- landmarks
    aim: float = 0.7 * MM
    """sd in each direction of the skin of a poke beside its landmark: by hand."""
    landmarks: float = 0.0
    """m, sd in each direction of a landmark's place as reported about where it is, the same for all its pokes."""
    # ---- mesh: the taxels are on the true one, the program is given another
    mesh_shift: float = 0.0
    """m, the whole mesh in some direction."""
    mesh_inflate: float = 0.0
    """m, outward."""
    mesh_bumps: float = 0.0
    """m rms along the normal, smooth over `MESH_BUMP_CORRELATION_LENGTH_M`."""
    # ---- skin
    mount_shift: float = 3 * MM
    """sd in each direction of the skin's offset from its plan: the calibration has to find it, it is no error."""
    mount_turn: float = 2 * DEGREE
    """sd of the skin's turn in its plane."""
    pads: float = 0.0
    """m, sd in each direction of a pad beside its module's plan."""
    gains: float = 0.10
    """sd of the logarithm of a taxel's sensitivity: foam is glued by hand."""
    thickness: float = 0.0
    """m, from the taxels' layer to the outer face, on which the force acts. iCub: 2 to 3 mm of foam or fabric."""
    shear: float = 0.0
    """m/N: how far the outer face moves aside under a tangential force. Foam of 0.1 mm/N: 30 mm^2 of 0.8 MPa, 2.5 mm thick."""
    spread: float = 1.0
    """How many times wider than `FOAM_PRESSURE_SPREAD_M` the foam spreads pressure."""
    tip: float = 3 * MM
    """Radius of the tip: a pen's end or a finger nail."""
    scatter: float = 0.7 * MM
    """sd in each direction of the skin between the middle of the tip and where the force acts: an uneven patch."""
    # ---- operator
    beside: float = 2 * MM
    """sd in each direction of a poke about its target taxel."""
    cone: float = 30 * DEGREE
    """Pushes lean at most this far from the normal, evenly in solid angle: somebody careful."""
    arc: float = 2 * np.pi
    """Pushes come from an arc of this breadth alone, about one side of the part; all sides by default."""
    lean: float = 0.0
    """All pushes are turned by this towards one side: a right hand."""
    friction: float = 0.75
    """Tangential over normal force at which the tip slides: rubber or plastic on fabric, 0.6 to 0.9. Pushes stay below it."""
    two: float = 0.0
    """Share of the pokes that touch two places at once (`FINGER_WIDTH_M`)."""


NOISY_RIG = RigModel(matrix=0.0, pose_turn=0.0, pose_shift=0.0)
"""A rig that is only noisy."""
PAPER_RIG = RigModel()
CASES: Mapping[str, RigModel] = {
    "nothing": PAPER_RIG,
    "quadratic_2": replace(PAPER_RIG, quadratic=0.02),
    "quadratic_5": replace(PAPER_RIG, quadratic=0.05),
    "correlated_0.2N": replace(PAPER_RIG, slow_force=0.2),
    "wander": replace(PAPER_RIG, wander_turn=DEGREE, wander_shift=2 * MM),
    "landmarks_1.5mm": replace(PAPER_RIG, landmarks=1.5 * MM),
    "landmarks_3mm": replace(PAPER_RIG, landmarks=3 * MM),
    "mesh_shifted": replace(PAPER_RIG, mesh_shift=1.5 * MM),
    "mesh_inflated": replace(PAPER_RIG, mesh_inflate=1.5 * MM),
    "mesh_bumpy": replace(PAPER_RIG, mesh_bumps=1.5 * MM),
    "moderate": RigModel(
        quadratic=0.01, hysteresis=0.005, slow_force=0.1, wander_turn=0.3 * DEGREE, wander_shift=0.5 * MM,
        flex=0.1 * DEGREE, landmarks=0.7 * MM, mesh_bumps=0.7 * MM, gains=0.2, thickness=1 * MM, shear=0.05 * MM, pads=0.1 * MM,
    ),
    "bad": RigModel(
        quadratic=0.05, hysteresis=0.01, slow_force=0.2, wander_turn=DEGREE, wander_shift=2 * MM, flex=0.3 * DEGREE,
        landmarks=1.5 * MM, mesh_bumps=1.5 * MM, gains=0.4, thickness=2.5 * MM, shear=0.1 * MM, pads=0.3 * MM,
    ),
    "gaussian": NOISY_RIG,
    "drift_0.1N": replace(NOISY_RIG, slow_force=0.1),
    "lean": replace(NOISY_RIG, lean=15 * DEGREE, thickness=2.5 * MM),
    "wide_foam": replace(NOISY_RIG, spread=2.0),
    "gains": replace(NOISY_RIG, gains=0.4),
    **{
        f"{taxels}_taxels_aim_{aim}mm": replace(PAPER_RIG, spread=spread, beside=aim * MM)
        for taxels, spread in ((2, 0.5), (4, 2.0), (5, 4.0)) for aim in (1, 3)
    },
}  # fmt: skip
"""`nothing` is the paper's rig without further errors. From `gaussian` to `gains`, a rig without an error of its own.
The last cases are skins that spread a press over 2 to 5 taxels on average, and aims (sd in each direction)."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSession:
    """A session on a rig, and the truth."""

    contacts: list[Contact]
    known: LandmarkPokes
    """Pokes at the landmarks, as recorded."""
    planned: NDArray[np.bool_]
    """Of each of them, whether it is among the few that the guide asks for (`GUIDED_LANDMARK_POKES`)."""
    channels: IntArray
    """(n,) the taxels, ascending."""
    places: FloatArray
    """(n, 3) float, metres: their true positions."""
    vertices: FloatArray
    """(nv, 3) float, metres: the mesh that the program gets."""


# ---- geometry


def turns(vectors: FloatArray) -> FloatArray:
    """Make rotations (n, 3, 3) about `vectors` (n, 3) by their lengths, radians: cos I + sin S + (1 - cos) u u'."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.where(angle > 0, angle, 1.0)[:, None]).T
    cross = np.moveaxis(np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]), 2, 0)
    along = np.stack([x, y, z], axis=1)
    c, s = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    return c * np.eye(3) + s * cross + (1 - c) * along[:, :, None] * along[:, None]


def motions(turn: FloatArray, shift: FloatArray) -> FloatArray:
    """Make poses (n, 4, 4) that turn by `turn` (n, 3), then shift by `shift` (n, 3)."""
    poses = np.tile(np.eye(4), (len(turn), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns(turn), shift
    return poses


def forward_kinematics(scene: Scene) -> dict[str, FloatArray]:
    """Compute link_from_sensor (4, 4) of each arm pose of a scene, as its joints report it.

    Each joint turns about z, shifts by d along it, shifts by a along x and turns by alpha about it: four motions after another.
    """
    if scene.arm is None:
        return {"": scene.sensor_pose}
    arm = scene.arm.arm
    if not isinstance(arm, Arm):
        raise ValueError("the independent simulator walks DH chains only")
    found: dict[str, FloatArray] = {}
    x, z, none = np.eye(3)[0], np.eye(3)[2], np.zeros((1, 3))
    for name, angles in scene.arm.poses.items():
        base_from_link = np.eye(4)
        for joint, angle in zip(arm.chain, angles, strict=True):
            about_z = motions((angle + joint.offset) * z[None], joint.d * z[None])[0]
            about_x = motions(none, joint.a * x[None])[0] @ motions(joint.alpha * x[None], none)[0]
            base_from_link = base_from_link @ about_z @ about_x
        found[name] = np.asarray(np.linalg.solve(base_from_link, arm.base_from_sensor), dtype=np.float64)
    return found


def unit(vectors: FloatArray) -> FloatArray:
    """Scale vectors (..., 3) to length one."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def dot(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the scalar products (n, 1) of vectors (n, 3)."""
    return np.sum(first * second, axis=1, keepdims=True)


def sideways(normals: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw vectors (n, 3) in the plane of the skin, with a variance of one in each direction."""
    drawn = rng.standard_normal(normals.shape)
    return drawn - dot(drawn, normals) * normals


class SmoothSurface:
    """A part's smooth skin, from the triangles of its mesh.

    Parameters
    ----------
    vertices : (nv, 3) float, metres
    triangles : (nt, 3) int, counter-clockwise seen from outside
    """

    def __init__(self, vertices: FloatArray, triangles: IntArray) -> None:
        self.vertices, self.triangles = vertices, triangles
        spatial: Any = import_module("scipy.spatial")
        self._tree: Any = spatial.cKDTree(vertices[triangles].mean(axis=1))

    @cached_property
    def normals(self) -> FloatArray:
        """(nv, 3) float, unit, outward: of each corner, by the areas of its triangles."""
        a, b, c = np.moveaxis(self.vertices[self.triangles], 1, 0)
        areas = np.zeros_like(self.vertices)
        np.add.at(areas, self.triangles.ravel(), np.repeat(np.cross(b - a, c - a), 3, axis=0))
        return unit(areas)

    def nearest(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the nearest points (n, 3) of points (n, 3), and the unit normals there, smooth across triangles."""
        rows: IntArray = self._tree.query(points, k=TRIANGLES_CHECKED_FOR_NEAREST_POINT)[1]
        corners = self.triangles[rows]
        a, b, c = np.moveaxis(self.vertices[corners], 2, 0)
        u, v, w = b - a, c - a, points[:, None] - a
        uu, uv, vv, wu, wv = (np.sum(p * q, axis=2) for p, q in ((u, u), (u, v), (v, v), (w, u), (w, v)))
        s, t = (vv * wu - uv * wv) / (uu * vv - uv**2), (uu * wv - uv * wu) / (uu * vv - uv**2)
        # Outside its triangle a foot is moved onto it: not the nearest point of that triangle, but another one has that.
        shares = np.maximum(np.stack([1 - s - t, s, t], axis=2), 0.0)
        shares /= shares.sum(axis=2, keepdims=True)
        feet = np.einsum("nks,nksi->nki", shares, self.vertices[corners])
        best = np.sum((feet - points[:, None]) ** 2, axis=2).argmin(axis=1)
        row = np.arange(len(points))
        return feet[row, best], unit(np.einsum("ns,nsi->ni", shares[row, best], self.normals[corners[row, best]]))

    def march(self, starts: FloatArray, ways: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Walk straight on along the part.

        Parameters
        ----------
        starts : (n, 3) float, on the part; ways are along it there
        ways : (n, 3) float, metres: how far each walks, and which way

        Returns
        -------
        (n, 3) the ends, (n, 3) the ways as they arrive there, as long as before, and (n, 3) the normals there
        """
        points, normals = self.nearest(starts)
        for _ in range(SURFACE_PATH_STEPS):
            before = normals
            points, normals = self.nearest(points + ways / SURFACE_PATH_STEPS)
            # The shortest turn that takes the one normal to the other.
            ways = ways - dot(ways, normals) / (1.0 + dot(before, normals)) * (before + normals)
        return points, ways, normals

    def wrong(self, world: RigModel, rng: np.random.Generator) -> FloatArray:
        """Draw the vertices (nv, 3) of the mesh that the program gets."""
        shift = world.mesh_shift * unit(rng.standard_normal(3))
        waves, phases = rng.standard_normal((200, 3)) / MESH_BUMP_CORRELATION_LENGTH_M, rng.uniform(0, 2 * np.pi, 200)
        # Many waves of drawn lengths: a smooth field of variance one whose correlation is exp(-r^2 / 2 l^2), l that length.
        bumps = np.cos(self.vertices @ waves.T + phases).sum(axis=1) * np.sqrt(2 / len(waves))
        return self.vertices + shift + (world.mesh_inflate + world.mesh_bumps * bumps)[:, None] * self.normals


def taxels(scene: Scene, part: SmoothSurface, world: RigModel, rng: np.random.Generator) -> tuple[IntArray, FloatArray]:
    """Return channels (n,) and positions (n, 3) of the taxels: the plan on the part, each module bent but not stretched.

    A module's middle lies straight from its anchor, its pads straight from there.
    """
    layout = scene.skin.layout
    assert layout is not None
    anchors = [(module, anchor) for module in layout.modules if (anchor := module.anchor or scene.skin.anchor) is not None]
    shift, turn = world.mount_shift * rng.standard_normal(2), world.mount_turn * rng.standard_normal()
    c, s = np.cos(turn), np.sin(turn)
    plan = np.array([module.place - anchor.at for module, anchor in anchors])
    # A way of no length has no direction: the little that is added gives it one.
    flat = plan @ np.array([[c, s], [-s, c]]) + shift + 1e-9
    feet, up = part.nearest(np.array([anchor.point for _, anchor in anchors]))
    x = np.array([anchor.x for _, anchor in anchors])
    x = unit(x - dot(x, up) * up)
    middles, ahead, up = part.march(feet, flat[:, :1] * x + flat[:, 1:] * np.cross(up, x))
    # From the way as it arrives to the module's own x and y.
    ahead, angle = unit(ahead), turn - np.arctan2(flat[:, 1:], flat[:, :1])
    left = np.cross(up, ahead)
    x, y = np.cos(angle) * ahead + np.sin(angle) * left, np.cos(angle) * left - np.sin(angle) * ahead
    of = np.repeat(np.arange(len(anchors)), [len(module.channels) for module, _ in anchors])
    pads = np.concatenate([module.pads - module.place for module, _ in anchors])
    places, _, normals = part.march(middles[of], pads[:, :1] * x[of] + pads[:, 1:] * y[of])
    places, _ = part.nearest(places + world.pads * sideways(normals, rng))
    channels = np.concatenate([module.channels for module, _ in anchors])
    order = np.argsort(channels)
    return channels[order], places[order]


# ---- contact


@dataclass(frozen=True, slots=True, eq=False)
class Presses:
    """n pokes, each with two touched places; the second place of most pokes carries no load."""

    feet: FloatArray
    """(2, n, 3) float, metres: on the taxels' layer, under the middle of the tip."""
    points: FloatArray
    """(2, n, 3) float, metres: where the force acts."""
    forces: FloatArray
    """(2, n, 3) float, N, link frame, on the part."""
    normal_loads: FloatArray
    """(2, n) float, N."""

    def select(self, rows: IntArray) -> Presses:
        return Presses(self.feet[:, rows], self.points[:, rows], self.forces[:, rows], self.normal_loads[:, rows])


class Operator:
    """Pushing habits of one operator, drawn once for a session.

    Parameters
    ----------
    world : sizes
    up : (3,) float, unit, outward: of the skin on average
    rng : draws the side to which the operator leans
    """

    def __init__(self, world: RigModel, up: FloatArray, rng: np.random.Generator) -> None:
        self.world = world
        self.side = unit(sideways(up[None], rng)[0])

    def pushes(self, normals: FloatArray, cone: float, rng: np.random.Generator) -> FloatArray:
        """Draw unit pushes (n, 3) on skin with outward `normals` (n, 3), inside the cone of friction."""
        count = len(normals)
        ahead = self.side - (normals @ self.side)[:, None] * normals
        ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        left = np.cross(normals, ahead)
        tilt = np.arccos(rng.uniform(np.cos(cone), 1.0, count))
        azimuth = self.world.arc * (rng.uniform(size=count) - 0.5)
        aside = np.tan(tilt)[:, None] * (np.cos(azimuth)[:, None] * ahead + np.sin(azimuth)[:, None] * left)
        aside = aside + np.tan(self.world.lean) * ahead
        steep = np.linalg.norm(aside, axis=1, keepdims=True)
        return unit(aside * np.minimum(1.0, self.world.friction / np.maximum(steep, 1e-9)) - normals)

    def press(self, part: SmoothSurface, places: FloatArray, rng: np.random.Generator) -> Presses:
        """Poke at places (n, 3) of the skin."""
        world, count = self.world, len(places)
        _, normals = part.nearest(places)
        meant, normals = part.nearest(places + world.beside * sideways(normals, rng))
        push = self.pushes(normals, world.cone, rng)
        load = rng.uniform(*SKIN_FORCES, count)
        both = rng.uniform(size=count) < world.two
        share = np.where(both, rng.uniform(0.3, 0.7, count), 1.0)
        apart = np.where(both, FINGER_WIDTH_M / 2, 0.0)[:, None] * unit(sideways(normals, rng))
        touches = [
            self._touch(part, meant + way * apart, push, load * bears, rng) for way, bears in ((1, share), (-1, 1.0 - share))
        ]
        feet, points, forces, loads = (np.stack(some) for some in zip(*touches, strict=True))
        return Presses(feet, points, forces, loads)

    def _touch(
        self, part: SmoothSurface, places: FloatArray, push: FloatArray, load: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return foot, point and force of one touch, and the load along the normal."""
        world = self.world
        feet, normals = part.nearest(places)
        forces = load[:, None] * push
        along = dot(forces, normals)
        moved = world.shear * (forces - along * normals)
        points = feet + world.thickness * normals + moved + world.scatter * sideways(normals, rng)
        return feet, points, forces, -along[:, 0]

    def press_landmarks(
        self, part: SmoothSurface, places: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Poke at known points (n, 3) on hard ground. Return points and forces (n, 3)."""
        _, normals = part.nearest(places)
        points = places + self.world.aim * sideways(normals, rng)
        return points, rng.uniform(*LANDMARK_FORCES, len(places))[:, None] * self.pushes(normals, LANDMARK_CONE, rng)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """Taxels at `places` (n, 3), metres, with their `gains` (n,)."""

    world: RigModel
    places: FloatArray
    gains: FloatArray

    def responses(self, presses: Presses, rng: np.random.Generator) -> FloatArray:
        """Compute the responses (n, taxels) to presses, in counts of 255 above their baseline."""
        world = self.world
        total = np.zeros((presses.feet.shape[1], len(self.places)))
        for feet, load in zip(presses.feet, presses.normal_loads, strict=True):
            depth = np.sqrt(load / (np.pi * world.tip * FOAM_STIFFNESS_PA_PER_M))
            # The variance in each direction of a paraboloid over a disc of radius a is a^2/6, of a flat one over the pad a^2/4.
            spread = 2 * world.tip * depth / 6 + TAXEL_ELECTRODE_RADIUS_M**2 / 4 + (world.spread * FOAM_PRESSURE_SPREAD_M) ** 2
            away = np.sum((self.places[None] - feet[:, None]) ** 2, axis=2)
            total += (load * TAXEL_ELECTRODE_RADIUS_M**2 / (2 * spread))[:, None] * np.exp(-away / (2 * spread[:, None]))
        clean = MAX_TAXEL_RESPONSE_COUNTS * (1.0 - np.exp(-self.gains * total / LOAD_FOR_63_PERCENT_RESPONSE_N))
        return clean + np.sqrt(COUNT_VARIANCE * FRAME_VARIANCE_SHARE) * rng.standard_normal(clean.shape)


# ---- sensor and arm


def slow_noise(count: int, width: int, rng: np.random.Generator) -> FloatArray:
    """Draw noise (count, width) of variance one whose correlation falls to 1/e over `SLOW_NOISE_CORRELATION_POKES` pokes."""
    kept = np.exp(-1.0 / SLOW_NOISE_CORRELATION_POKES)
    fresh = rng.standard_normal((count, width))
    fresh[1:] *= np.sqrt(1.0 - kept**2)
    for i in range(1, count):
        fresh[i] += kept * fresh[i - 1]
    return fresh


class Sensor:
    """An F/T sensor with its errors, drawn once for a session.

    Parameters
    ----------
    world : sizes
    rng : draws what stays
    """

    def __init__(self, world: RigModel, rng: np.random.Generator) -> None:
        self.world = world
        arm = np.repeat([1.0, FORCE_MOMENT_CROSSTALK_ARM_M], 3)
        self.matrix = np.eye(6) + world.matrix * rng.standard_normal((6, 6)) * arm[:, None] / arm
        self.scale = np.repeat([TYPICAL_PRESS_FORCE_N, TYPICAL_PRESS_FORCE_N * TYPICAL_LEVER_ARM_M], 3)
        # Of unit numbers Q has a variance of |u|^4 in each of six components; force and moment together make |u|^2 = 2.
        self.quadratic = world.quadratic * np.sqrt(2 / 6) / 2 * rng.standard_normal((6, 6, 6))
        self.keeps = world.hysteresis * rng.uniform(0.5, 1.5, 6)

    def read(self, wrenches: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Read successive pokes (n, 6), tared by the mean of before and after, N and N m.

        Parameters
        ----------
        wrenches : (n, 6) float, N and N m, sensor frame, about its origin
        """
        world, count = self.world, len(wrenches)
        units = wrenches / self.scale
        bent = self.scale * np.einsum("ijk,nj,nk->ni", self.quadratic, units, units)
        # Half of what the last poke left, and of what this one leaves, is taken for the sensor's zero.
        left = self.keeps * (wrenches + np.concatenate([np.zeros((1, 6)), wrenches[:-1]])) / 2
        of_force = np.repeat([1.0, MOMENT_OVER_FORCE_NOISE_M], 3)
        noise = world.force_noise * rng.standard_normal((count, 6)) + world.slow_force * slow_noise(count, 6, rng)
        return wrenches @ self.matrix.T + bent - left + of_force * noise


def sensor_wrenches(poses: FloatArray, points: FloatArray, forces: FloatArray, flex: float) -> FloatArray:
    """Compute wrenches (n, 6) in the frame and about the origin of a sensor that carries the part.

    Parameters
    ----------
    poses : (n, 4, 4) float: link_from_sensor without load
    points, forces : (k, n, 3) float, link frame: of the k places that each poke touches at once
    flex : rad per N m: the part turns about the sensor by this times the moment
    """
    turned, origin = poses[:, :3, :3], poses[:, :3, 3]
    at = np.einsum("nji,knj->kni", turned, points - origin)
    force = np.einsum("nji,knj->kni", turned, forces)
    bent = turns(flex * np.cross(at, force).sum(axis=0))
    at, force = np.einsum("nij,knj->kni", bent, at), np.einsum("nij,knj->kni", bent, force)
    return np.concatenate([force, np.cross(at, force)], axis=2).sum(axis=0)


# ---- a session

POKE_CYCLE_S = 2.5
"""From one poke to the next."""
MAX_ATTEMPTS_PER_TARGET = 4
"""Attempts at a target that no taxel answers, or too many."""


def _skin_pokes(
    scene: Scene,
    part: SmoothSurface,
    who: Operator,
    skin: Skin,
    targets: IntArray,
    rng: np.random.Generator,
) -> tuple[Presses, FloatArray]:
    """Poke at `targets` (n,), each up to `MAX_ATTEMPTS_PER_TARGET` times. Return counted pokes, responses (n, taxels)."""
    presses = who.press(part, skin.places[np.tile(targets, MAX_ATTEMPTS_PER_TARGET)], rng)
    responses = skin.responses(presses, rng)
    count = (responses > scene.contacts.response_min).sum(axis=1)
    good = ((count > 0) & (count <= scene.contacts.taxels_max)).reshape(MAX_ATTEMPTS_PER_TARGET, -1)
    rows = (good.argmax(axis=0) * len(targets) + np.arange(len(targets)))[good.any(axis=0)]
    return presses.select(rows), responses[rows]


def simulate_session(
    scene: Scene, vertices: FloatArray, triangles: IntArray, world: RigModel, seed: int, per_pose: int = 72
) -> SimulatedSession:
    """Poke a rig in all its arm poses: in each first its landmarks in turn, then its skin.

    Parameters
    ----------
    scene : with a layout, an anchor and a mesh
    vertices, triangles : (nv, 3) float, metres, and (nt, 3) int, outward: the true part
    per_pose : pokes at the skin in each arm pose
    """
    mesh, mount, skin, arm, sensor, hand, wrong, noise = np.random.default_rng([seed, 12]).spawn(8)
    part = SmoothSurface(vertices, triangles)
    channels, places = taxels(scene, part, world, mount)
    pads = Skin(world, places, np.exp(world.gains * skin.standard_normal(len(channels))))
    reported = forward_kinematics(scene)
    operator = Operator(world, unit(part.nearest(places)[1].mean(axis=0)), hand)
    targets = np.concatenate([hand.permutation(len(places)) for _ in range(-(-per_pose * len(reported) // len(places)))])
    landmarks = np.array([landmark.place for landmark in scene.landmarks]).reshape(-1, 3)
    known = SIMULATED_LANDMARK_POKES_PER_POSE if len(landmarks) else 0
    parts: list[tuple[Any, ...]] = []
    for pose in range(len(reported)):
        # Each arm pose continues after the last landmark that the guide asked for.
        marks = (sum(GUIDED_LANDMARK_POKES[:pose]) + np.arange(known)) % max(len(landmarks), 1)
        at, push = operator.press_landmarks(part, landmarks[marks], hand)
        own = targets[pose * per_pose : (pose + 1) * per_pose]
        presses, answered = _skin_pokes(scene, part, operator, pads, own, hand)
        parts.append((
            np.concatenate([np.stack([at, at]), presses.points], axis=1),
            np.concatenate([np.stack([push, 0 * push]), presses.forces], axis=1),
            np.concatenate([np.zeros((known, len(places))), answered]),
            np.concatenate([marks, np.full(len(answered), -1)]), np.full(known + len(answered), pose),
        ))  # fmt: skip
    points, forces = (np.concatenate([own[i] for own in parts], axis=1) for i in range(2))
    responses, marks, poses = (np.concatenate([own[i] for own in parts]) for i in range(2, 5))
    true = _true_poses(np.array(list(reported.values())), world, poses, arm)
    read = Sensor(world, sensor).read(sensor_wrenches(true, points, forces, world.flex), noise)
    given = [landmark.place + world.landmarks * wrong.standard_normal(3) for landmark in scene.landmarks]
    names, at_landmark = list(reported), np.flatnonzero(marks >= 0)
    every = Pokes(
        np.arange(1, len(read) + 1), read[:, :3], read[:, 3:], np.array(list(reported.values()))[poses], np.array(names)[poses]
    )
    own_marks: list[int] = marks[at_landmark].tolist()
    guided = np.zeros(max(len(names), len(GUIDED_LANDMARK_POKES)), dtype=np.int64)
    guided[: len(GUIDED_LANDMARK_POKES)] = GUIDED_LANDMARK_POKES
    session = SimulatedSession(
        contacts=[],
        known=LandmarkPokes.at(every[at_landmark], [scene.landmarks[k].name for k in own_marks], [given[k] for k in own_marks]),
        planned=np.arange(len(at_landmark)) % max(known, 1) < guided[poses[at_landmark]],
        channels=channels,
        places=places,
        vertices=part.wrong(world, mesh),
    )
    rows: list[tuple[int, int]] = list(zip(poses.tolist(), marks.tolist(), strict=True))
    for i, (pose, mark) in enumerate(rows):
        name, force, moment = names[pose], read[i, :3], read[i, 3:]
        if mark >= 0:
            continue
        own = np.flatnonzero(responses[i] > scene.contacts.response_min)
        session.contacts.append(
            Contact(
                poke=i + 1, start_s=POKE_CYCLE_S * i, end_s=POKE_CYCLE_S * i + scene.contacts.still_s, force=force,
                moment=moment, channels=channels[own], responses=responses[i, own], link_from_sensor=reported[name], pose=name,
                tare_change=0.0, final=True,
            )
        )  # fmt: skip
    return session


def _true_poses(reported: FloatArray, world: RigModel, poses: IntArray, rng: np.random.Generator) -> FloatArray:
    """Draw the true link_from_sensor (n, 4, 4) of each poke, from `reported` (poses, 4, 4)."""
    off, slow = rng.standard_normal((len(reported), 6)), np.zeros((len(poses), 6))
    for pose in range(len(reported)):
        own = np.flatnonzero(poses == pose)[1:]
        # The variance of a walk's step k is k: over n steps after the first point it is (n + 1)/2 on average.
        slow[own] = np.cumsum(rng.standard_normal((len(own), 6)), axis=0) / np.sqrt((len(own) + 1) / 2)
    true = reported @ motions(world.pose_turn * off[:, :3], world.pose_shift * off[:, 3:])
    return true[poses] @ motions(world.wander_turn * slow[:, :3], world.wander_shift * slow[:, 3:])
