"""A small curved part with three modules, and calibrations of it, for the tests of `skincal.files`."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skincal.axes.module_axes import AxisFindings
from skincal.axes.session_turns import SessionTurns
from skincal.axes.skin_turns import SkinTurns
from skincal.axes.taxel_frames import FrameState, TaxelFrame
from skincal.axes.turn_fit import AxisNoise
from skincal.contacts.outcome import Contact
from skincal.files.calibration import Calibration
from skincal.geometry import FloatArray
from skincal.model.scene import Scene, load_scene
from skincal.model.skin_axes import ResponseRule, SkinAxes, ValueOrder
from skincal.taxels.result import Cause, Estimate, Method, Rival, State, StateReason

CHANNELS = 48
RADIUS = 0.040
SCENE = """
name = "bent-part"
link = "r_forearm_dh_frame"
[skin]
channels = 48
modules = "modules.toml"
[skin.anchor]
at_mm = [0, 0]
point_mm = [0, 100, 40]
x = [1, 0, 0]
normal = [0, 0, 1]
[surface]
mesh = "tube.obj"
unit = "mm"
[noise]
force = 0.2
"""
MODULES = """
[[modules]]
id = 17
kind = "triangle_12"
first_channel = 0
[[modules]]
id = 21
kind = "triangle_10pad"
first_channel = 12
place_mm = [0, 40]
angle_deg = 30
mirror = true
[[modules]]
id = 25
kind = "triangle_12"
first_channel = 36
place_mm = [0, -40]
angle_deg = 90
"""


@dataclass(frozen=True)
class Part:
    """A scene on the disk and where its taxels truly are."""

    scene: Scene
    places: FloatArray
    normals: FloatArray


def make_part(folder: Path) -> Part:
    """Write scene, modules and a tube of 40 mm radius along y into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "tube.obj").write_text(_tube())
    (folder / "modules.toml").write_text(MODULES)
    (folder / "scene.toml").write_text(SCENE)
    scene = load_scene(folder / "scene.toml")
    layout = scene.skin.layout
    assert layout is not None
    # On a tube a straight geodesic is a straight line of the unrolled plane: an exact answer, without the mesh.
    around = layout.places[:, 0] / RADIUS
    side = np.stack([np.sin(around), np.zeros(CHANNELS), np.cos(around)], axis=1)
    places = RADIUS * side
    places[:, 1] = 0.1 + layout.places[:, 1]
    return Part(scene, places, side)


def _tube(segments: int = 72) -> str:
    angles = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    lines = [f"v {40 * np.sin(a):.9f} {y} {40 * np.cos(a):.9f}" for y in (0, 200) for a in angles]
    for i in range(segments):
        j = (i + 1) % segments
        lines += [f"f {i + 1} {j + 1} {segments + i + 1}", f"f {j + 1} {segments + j + 1} {segments + i + 1}"]
    return "\n".join(lines) + "\n"


def estimate(channel: int, method: Method, position: FloatArray, normal: FloatArray | None, sd: float = 0.001) -> Estimate:
    """Return an estimate with a plausible covariance."""
    covariance = np.diag([1e-8, 2e-8, sd * sd])
    return Estimate(
        channel,
        method,
        State.TOUCHED,
        7,
        position,
        normal,
        covariance,
        np.array([0.0, 0.0, 1.0]),
        sd,
        float(covariance.trace()) ** 0.5,
    )


def make_calibration(part: Part, unseen: tuple[int, ...] = (), blind: tuple[int, ...] = (), shift: float = 0.0) -> Calibration:
    """Return a calibration at the true places, moved by `shift` along the normals, for both methods."""
    layout = part.scene.skin.layout
    assert layout is not None
    estimates: dict[Method, tuple[Estimate, ...]] = {}
    for method in Method:
        items: list[Estimate] = []
        for channel in layout.channels.tolist():
            if channel in unseen:
                items.append(Estimate(channel, method, State.UNSEEN, 0, reason=StateReason(Cause.UNPOKED)))
            elif channel in blind:
                items.append(
                    Estimate(
                        channel,
                        method,
                        State.BLIND,
                        1,
                        worst_direction=np.array([0.0, 0.0, 1.0]),
                        reason=StateReason(Cause.ONE_AXIS),
                        line_point=np.array([0.01, 1 / 3, -0.02]),
                        rival=Rival(np.array([0.0, 1 / 7, 0.1]), 5, 1.5),
                        doubted={7: 1 / 3},
                    )
                )
            else:
                items.append(
                    estimate(channel, method, part.places[channel] + shift * part.normals[channel], part.normals[channel])
                )
        estimates[method] = tuple(items)
    mesh = part.scene.surface
    assert mesh is not None
    sha256 = hashlib.sha256(mesh.path.read_bytes()).hexdigest()
    return Calibration(
        part.scene, layout.channels, estimates, make_contacts(part, 60), sha256, "0.1.0", (3,), {40: "always on"}
    )


def make_contacts(part: Part, count: int, seed: int = 1) -> tuple[Contact, ...]:
    """Return noisy pokes on random taxels, with an arm pose that changes."""
    rng = np.random.default_rng(seed)
    known = np.flatnonzero(~np.isnan(part.places[:, 0]))
    contacts: list[Contact] = []
    for poke in range(1, count + 1):
        channel = int(rng.choice(known[:6]))
        push = -part.normals[channel] + 0.4 * rng.normal(size=3)
        pose = np.eye(4)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        pose[:3, :3] = turn * np.linalg.det(turn)
        pose[:3, 3] = rng.normal(size=3) * 0.1
        force = rng.uniform(4, 12) * pose[:3, :3].T @ (push / np.linalg.norm(push))
        place_sensor = pose[:3, :3].T @ (part.places[channel] - pose[:3, 3])
        moment = np.cross(place_sensor, force) + 0.005 * rng.normal(size=3)
        channels = np.unique([channel, int(rng.choice(known[:6]))])
        answers = rng.uniform(10, 90, size=len(channels))
        change = np.nan if poke % 5 == 0 else float(rng.normal())
        contacts.append(
            Contact(
                poke,
                poke * 1.1,
                poke * 1.1 + 0.3,
                force,
                moment,
                channels,
                answers,
                pose,
                f"pose {poke % 3}",
                change,
                poke % 7 != 0,
            )
        )
    return tuple(contacts)


NO_FINDINGS = AxisFindings((), 0.0, ())
NO_TURNS = SessionTurns(SkinTurns({}, AxisNoise(0.1, 0.0), {}), {}, {})


@dataclass(frozen=True)
class KnownAxes:
    """Turns that are known, in place of `AxisResults`."""

    known: dict[int, TaxelFrame]
    found: AxisFindings = NO_FINDINGS
    turns: SessionTurns = NO_TURNS

    def frames(self, _method: Method) -> dict[int, TaxelFrame]:
        return self.known

    def findings(self, _method: Method) -> AxisFindings:
        return self.found


READ_AXES = SkinAxes(ValueOrder.BY_TAXEL, (1, -1, -1), (1, 0, 2), ResponseRule.PUSH, "N")


def with_turns(calibration: Calibration, unknown: dict[int, FrameState], seed: int = 1) -> tuple[Calibration, FloatArray]:
    """Give the taxels of a calibration random turns, but those of `unknown`; return also rotations (width, 3, 3), else NaN."""
    rng, scene = np.random.default_rng(seed), calibration.scene
    rotations = np.full((scene.skin.channels, 3, 3), np.nan)
    frames: dict[int, TaxelFrame] = {}
    for channel in (int(channel) for channel in calibration.channels):
        turned = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        rotation = turned * np.sign(np.linalg.det(turned))
        state = unknown.get(channel, FrameState.KNOWN)
        frames[channel] = TaxelFrame(channel, state)
        if state is FrameState.KNOWN:
            rotations[channel] = rotation
            frames[channel] = TaxelFrame(channel, state, rotation, np.diag([1e-4, 4e-4, 9e-4]), 5)
    skin = replace(scene.skin, axes=READ_AXES)
    return replace(calibration, scene=replace(scene, skin=skin), axes=KnownAxes(frames)), rotations
