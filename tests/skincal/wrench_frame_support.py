"""A bench with a skin whose true force axes are known, and its recording with the wrench in any frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from skincal.cli import main
from skincal.session.replay import load
from tests.skincal.ros_support import SKIN_TYPE, WRENCH_TYPE, BagFile, skin_message, wrench_message

START_NS = 1_700_000_000 * 10**9
RATE_HZ = 50
SENSOR, LINK = "wrist_ft", "patch"
PADS_M = np.array([[x, y] for y in (-9, -3, 3, 9) for x in (-9, -3, 3, 9)]) * 1e-3
TURN_Z_90 = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TOOL_SHIFT_M = np.array([0.02, -0.03, 0.12])
"""Origin of the link `tool` in the sensor's frame; its axes are turned by 90 degrees about z."""
BASE_TURN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
BASE_SHIFT_M = np.array([0.30, 0.10, 0.40])
"""Pose of the sensor in `base_link`."""
_RPY_90 = "1.5707963267948966"


def write_urdf(path: Path, more: str = "") -> Path:
    """Write the bench: the sensor and its skin on a base that turns on a stand."""
    links = "".join(f'<link name="{name}"/>' for name in ("stand", "base_link", "ft_link", "ft_same_place", "tool", LINK))

    def fixed(name: str, parent: str, child: str, xyz: str, rpy: str = "0 0 0") -> str:
        origin = f'<origin xyz="{xyz}" rpy="{rpy}"/>'
        return f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>{origin}</joint>'

    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f'<robot name="bench">{links}{more}'
        '<joint name="yaw" type="revolute"><parent link="stand"/><child link="base_link"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        + fixed("ft_joint", "base_link", "ft_link", "0.30 0.10 0.40", f"0 {_RPY_90} 0")
        + fixed("same_joint", "ft_link", "ft_same_place", "0 0 0")
        + fixed("tool_joint", "ft_link", "tool", "0.02 -0.03 0.12", f"0 0 {_RPY_90}")
        + fixed("patch_joint", "ft_link", LINK, "0 0 0.045")
        + f'<sensor name="{SENSOR}" type="force_torque"><parent joint="ft_joint"/><force_torque><frame>child</frame>'
        "<measure_direction>child_to_parent</measure_direction></force_torque></sensor></robot>"
    )
    return path


def write_scene(folder: Path, *, with_layout: bool = False, wrench: str = "", more: str = "") -> Path:
    """Write the scene of the bench; `wrench` are lines of its `[wrench]`, `more` is put into the URDF."""
    urdf, out = write_urdf(folder / "bench.urdf", more), folder / "scene.toml"
    skin = ["--grid", "4x4@6mm", "--anchor-mm", "0,0,0"] if with_layout else ["--channels", "16"]
    asked = ["scene", "new", "--urdf", str(urdf), "--link", LINK, "--sensor", SENSOR, *skin, "--out", str(out)]
    assert main(asked) == 0
    if wrench:
        out.write_text(f"{out.read_text()}\n[wrench]\n{wrench}\n")
    return out


def true_readings() -> tuple[np.ndarray, np.ndarray]:
    """Wrenches (n, 6) in the sensor's frame and raw values (n, 16) of 16 pokes, 45 mm above the sensor."""
    rng = np.random.default_rng(5)
    count = RATE_HZ * (2 + 16 * 2)
    t = np.arange(count) / RATE_HZ
    wrench, skin = rng.normal(0, [0.02] * 3 + [0.001] * 3, (count, 6)), 200 + rng.normal(0, 1, (count, 16))
    for number, pad in enumerate(PADS_M):
        place = np.r_[pad + rng.normal(0, 4e-4, 2), 0.045]
        push = np.r_[rng.normal(0, 0.25, 2), -1.0]
        force = 8.0 * push / np.linalg.norm(push)
        ramp = np.clip(np.minimum((t - 2 - 2 * number) / 0.1, (3 + 2 * number - t) / 0.1), 0, 1)[:, None]
        wrench += ramp * np.r_[force, np.cross(place, force)]
        skin += ramp * 400 * np.exp(-np.linalg.norm(PADS_M - place[:2], axis=1) / 2.5e-3)
    return wrench, skin


def seen_from(wrench: np.ndarray, axes: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Convert wrenches (n, 6) of the sensor's frame to other axes (its columns) and another point of the moments."""
    force, moment = wrench[:, :3], wrench[:, 3:] - np.cross(point, wrench[:, :3])
    return np.hstack([force @ axes, moment @ axes])


IN_TOOL = lambda wrench: seen_from(wrench, TURN_Z_90, TOOL_SHIFT_M)  # noqa: E731
IN_BASE = lambda wrench: seen_from(wrench, BASE_TURN.T, -BASE_TURN.T @ BASE_SHIFT_M)  # noqa: E731
IN_BASE_AXES = lambda wrench: seen_from(wrench, BASE_TURN.T, np.zeros(3))  # noqa: E731


def write_bag(
    path: Path,
    frame_of: Callable[[int], str],
    made: Callable[[np.ndarray], np.ndarray] | Sequence[np.ndarray],
    kind: str = "mcap",
) -> Path:
    """Write the recording; `frame_of` names the frame of each message, `made` converts the wrenches, or has them."""
    wrench, skin = true_readings()
    rows = made(wrench) if callable(made) else made
    with BagFile(path, kind) as bag:
        for number, row in enumerate(rows):
            stamp_ns = START_NS + number * 10**9 // RATE_HZ
            message = wrench_message(stamp_ns, row)
            message["header"] = message["header"] | {"frame_id": frame_of(number)}
            bag.add("/ft/wrench", WRENCH_TYPE, stamp_ns + 1000, message)
            if number % 2 == 0:
                bag.add("/skin", SKIN_TYPE, stamp_ns + 2000, skin_message(skin[number]))
    return bag.path


def positions(session: Path) -> dict[tuple[str, int], np.ndarray | None]:
    """Estimated positions of a session, m, by method and channel."""
    found = load(session).snapshot().estimates
    return {(method.value, each.channel): each.position for method, of in found.items() for each in of}


def largest_difference(found: dict, expected: dict) -> float:
    """Largest distance, m, of the same taxels; all must be known in both or in neither."""
    assert found.keys() == expected.keys()
    assert sum(each is not None for each in expected.values()) >= 10
    assert all((found[key] is None) == (expected[key] is None) for key in expected)
    return max(float(np.linalg.norm(found[key] - place)) for key, place in expected.items() if place is not None)
