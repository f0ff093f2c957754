"""The public iCub with taxels in it, and kinematics that share no code with the program or with a consumer."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.files.export import write_calibration
from skincal.files.formats import ExportOptions
from skincal.taxels.result import Method
from tests.skincal.files.files_support import Part, make_calibration, make_part

LINK = "r_forearm_dh_frame"
"""Has no mass, and hangs on `r_forearm` by a fixed joint."""


def icub_urdf() -> Path:
    """Return the path of iCubGenova11: 214 links, 32 moving joints."""
    models = pytest.importorskip("icub_models")
    return Path(models.get_model_file("iCubGenova11"))


@dataclass(frozen=True)
class Skin:
    """A calibration whose taxels are known, and a way to write it."""

    part: Part

    @property
    def channels(self) -> list[int]:
        layout = self.part.scene.skin.layout
        assert layout is not None
        return layout.channels.tolist()

    def write(self, format_: str, path: Path, options: ExportOptions | None = None) -> Path:
        write_calibration(make_calibration(self.part), format_, path, Method.SURFACE, options or ExportOptions())
        return path

    def names(self, prefix: str = f"{LINK}_") -> list[str]:
        return [f"{prefix}taxel_{channel}" for channel in self.channels]

    def poses(self, prefix: str = f"{LINK}_") -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Position (metres) and normal of each taxel in the link, by its name."""
        return {
            name: (self.part.places[channel], self.part.normals[channel])
            for name, channel in zip(self.names(prefix), self.channels, strict=True)
        }


def make_skin(folder: Path) -> Skin:
    return Skin(make_part(folder))


@dataclass(frozen=True)
class Kinematics:
    """Forward kinematics of a URDF, after its XML reference alone."""

    root: ET.Element

    @property
    def moving(self) -> list[str]:
        return [joint.get("name") for joint in self.root.findall("joint") if joint.get("type") != "fixed"]

    @property
    def mass(self) -> float:
        return sum(float(each.get("value")) for each in self.root.findall("link/inertial/mass"))

    @property
    def base(self) -> str:
        children = {joint.find("child").get("link") for joint in self.root.findall("joint")}
        return next(link.get("name") for link in self.root.findall("link") if link.get("name") not in children)

    def random_angles(self, seed: int) -> dict[str, float]:
        rng, angles = np.random.default_rng(seed), {}
        for joint in self.root.findall("joint"):
            if joint.get("type") != "fixed":
                limit = joint.find("limit")
                angles[joint.get("name")] = float(rng.uniform(float(limit.get("lower")), float(limit.get("upper"))))
        return angles

    def pose(self, link: str, angles: Mapping[str, float]) -> np.ndarray:
        """Compute the (4, 4) pose of a link in the root, metres."""
        above = {joint.find("child").get("link"): joint for joint in self.root.findall("joint")}
        pose = np.eye(4)
        while link in above:
            joint, step = above[link], np.eye(4)
            origin = joint.find("origin")
            if origin is not None:
                # Fixed axes: roll about x, then pitch about y, then yaw about z.
                step[:3, :3] = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0"))).as_matrix()
                step[:3, 3] = _numbers(origin.get("xyz", "0 0 0"))
            if joint.get("type") in ("revolute", "continuous"):
                axis = np.array(_numbers(joint.find("axis").get("xyz")))
                turn = np.eye(4)
                turn[:3, :3] = Rotation.from_rotvec(axis / np.linalg.norm(axis) * angles[joint.get("name")]).as_matrix()
                step = step @ turn
            elif joint.get("type") == "prismatic":
                step[:3, 3] += step[:3, :3] @ np.array(_numbers(joint.find("axis").get("xyz"))) * angles[joint.get("name")]
            pose, link = step @ pose, joint.find("parent").get("link")
        return pose


def read_kinematics(path: Path) -> Kinematics:
    return Kinematics(ET.parse(path).getroot())


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def assert_taxels_are_right(
    found: Mapping[str, np.ndarray], skin: Skin, link_pose: np.ndarray, prefix: str = f"{LINK}_"
) -> None:
    """Compare (4, 4) poses of all taxels, by name, with the skin on a link at a pose."""
    expected = skin.poses(prefix)
    assert set(expected) <= set(found), f"lost: {sorted(set(expected) - set(found))[:5]}"
    for name, (position, normal) in expected.items():
        np.testing.assert_allclose(found[name][:3, 3], link_pose[:3, :3] @ position + link_pose[:3, 3], atol=1e-6)
        np.testing.assert_allclose(found[name][:3, 2], link_pose[:3, :3] @ normal, atol=1e-6)


def without_shapes(path: Path, out: Path) -> Path:
    """Write a robot without meshes: programs then need no folder of packages."""
    root = ET.parse(path).getroot()
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    out.write_bytes(ET.tostring(root))
    return out


def without_massless_leaves(path: Path, out: Path, keep: str = LINK) -> Path:
    """Write a robot without the frames that carry nothing: PyBullet has room for 127 links."""
    root = copy.deepcopy(ET.parse(path).getroot())
    while True:
        parents = {joint.find("parent").get("link") for joint in root.findall("joint")}
        leaves = {
            link.get("name")
            for link in root.findall("link")
            if link.find("inertial") is None and link.get("name") not in {*parents, keep}
        }
        if not leaves:
            break
        for joint in [each for each in root.findall("joint") if each.find("child").get("link") in leaves]:
            root.remove(joint)
        for link in [each for each in root.findall("link") if each.get("name") in leaves]:
            root.remove(link)
    out.write_bytes(ET.tostring(root))
    return out
