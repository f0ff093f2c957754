"""A rig with two joints whose recordings have streams that pause, freeze or come in groups, and its true taxels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.model.readings import Stream
from skincal.model.scene import Scene, load_scene
from skincal.session.snapshot import Snapshot
from tests.skincal.ros_support import (
    JOINTS_TYPE,
    SKIN_TYPE,
    WRENCH_TYPE,
    BagFile,
    joints_message,
    skin_message,
    wrench_message,
)

TAXELS = 0.012 * np.array([[0, 0, 3], [1, 0, 3], [2, 0, 3], [0, 1, 3], [1, 1, 3], [2, 1, 3]])
"""(6, 3) float, m, link frame."""
POKES, POKE_S, BEGIN_S = 12, 2.0, 1.0
MOVE_S = BEGIN_S + POKES * POKE_S / 2
"""The arm moves for 0.6 s from here, between two pokes."""
END_S = BEGIN_S + POKES * POKE_S + 1.0
POSES = np.array([(0.3, -0.2), (0.8, 0.6)])
"""rad: angles before and after the move."""
EPOCH = 1_700_000_000.0
NAMES = ("elbow", "wrist")
_SCENE = """
name = "two joints"
link = "part"
[skin]
channels = 6
[arm]
joints = [0, 1]
dh = [[0.02, 0.0, 90.0, 0.0], [0.05, -0.1, 90.0, -90.0]]
base_from_sensor = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.05], [0, 0, 0, 1]]
"""


def write_arm_scene(folder: Path) -> Scene:
    """Write a scene of the rig, and load it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.toml").write_text(_SCENE)
    return load_scene(folder / "scene.toml")


@dataclass
class Recording:
    """Times (n,) s and rows (n, width) of each stream."""

    scene: Scene
    times: dict[Stream, FloatArray] = field(default_factory=dict)
    rows: dict[Stream, FloatArray] = field(default_factory=dict)

    def copy_for(self, scene: Scene) -> Recording:
        """Copy all readings, for a test that changes them or its scene file."""
        times, rows = ({stream: values.copy() for stream, values in each.items()} for each in (self.times, self.rows))
        return Recording(scene, times, rows)

    def keep(self, stream: Stream, which: np.ndarray) -> Recording:
        """Keep some readings of a stream."""
        self.times[stream], self.rows[stream] = self.times[stream][which], self.rows[stream][which]
        return self


def record_rig(scene: Scene) -> Recording:
    """Record 12 pokes of 8 N, two on each taxel, in two arm poses."""
    rng, found = np.random.default_rng(4), Recording(scene)
    assert scene.arm is not None
    order = np.concatenate([rng.permutation(len(TAXELS)) for _ in range(POKES // len(TAXELS))])
    tilts = rng.uniform(-0.5, 0.5, (POKES, 2))
    for stream, rate in ((Stream.WRENCH, 100), (Stream.SKIN, 50), (Stream.JOINTS, 50)):
        times = np.arange(int(END_S * rate)) / rate
        rows: list[np.ndarray] = []
        for time in times:
            poke, phase = divmod(time - BEGIN_S, POKE_S)
            poke = min(max(int(poke), 0), POKES - 1)
            level = float(np.clip(min(phase - 0.8, 1.6 - phase) / 0.1, 0.0, 1.0)) if BEGIN_S <= time < END_S - 1 else 0.0
            share = float(np.clip((time - MOVE_S) / 0.6, 0.0, 1.0))
            angles = (1 - share) * POSES[0] + share * POSES[1]
            if stream is Stream.JOINTS:
                rows.append(angles)
                continue
            if stream is Stream.SKIN:
                rows.append(rng.normal(20, 0.4, len(TAXELS)) + 80 * level * np.eye(len(TAXELS))[order[poke]])
                continue
            link = scene.arm.arm.link_from_sensor(angles)
            force = link[:3, :3].T @ (8 * level * np.array([*tilts[poke], -1.0]) / np.linalg.norm([*tilts[poke], 1.0]))
            place = link[:3, :3].T @ (TAXELS[order[poke]] - link[:3, 3])
            noise = np.r_[rng.normal(0, 0.02, 3), rng.normal(0, 0.0006, 3)]
            rows.append(np.r_[force, np.cross(place, force)] + [2, -3, 5, 0.1, 0.2, -0.1] + noise)
        found.times[stream], found.rows[stream] = times, np.array(rows)
    return found


def arrive_in_groups(times: FloatArray, size: int, step_s: float = 0.001) -> FloatArray:
    """Let readings arrive `size` at a time, `step_s` apart, when the last one of a group was made, (n,) s."""
    index = np.arange(len(times))
    return times[np.minimum(index - index % size + size - 1, len(times) - 1)] + step_s * (index % size)


def write_tables(folder: Path, recording: Recording, digits: str = ".6f") -> list[str]:
    """Write the tables of `import csv`, with times in seconds; return its arguments."""
    folder.mkdir(parents=True, exist_ok=True)
    heads = {Stream.WRENCH: "fx,fy,fz,mx,my,mz", Stream.SKIN: ",".join(f"t{k}" for k in range(6)), Stream.JOINTS: "a_rad,b_rad"}
    arguments = ["csv"]
    for stream, rows in recording.rows.items():
        lines = (
            f"{time + 5:{digits}},{','.join(f'{value:.9g}' for value in row)}\n"
            for time, row in zip(recording.times[stream], rows, strict=True)
        )
        (folder / f"{stream.value}.csv").write_text(f"t_s,{heads[stream]}\n{''.join(lines)}")
        arguments += [f"--{stream.value}", str(folder / f"{stream.value}.csv")]
    return arguments


def write_logs(folder: Path, recording: Recording, digits: str = ".6f") -> list[str]:
    """Write the folders of `import yarp`; return its arguments."""
    arguments = ["yarp"]
    for stream, rows in recording.rows.items():
        (folder / stream.value).mkdir(parents=True)
        (folder / stream.value / "info.log").write_text("Type: Bottle;\nStamp: rx;\n")
        values = np.degrees(rows) if stream is Stream.JOINTS else rows
        lines = (
            f"{k} {EPOCH + time:{digits}} {' '.join(f'{value:.9g}' for value in row)}\n"
            for k, (time, row) in enumerate(zip(recording.times[stream], values, strict=True))
        )
        (folder / stream.value / "data.log").write_text("".join(lines))
        arguments += [f"--{stream.value}", str(folder / stream.value)]
    return arguments


def write_rig_bag(
    folder: Path,
    recording: Recording,
    names: Mapping[int, tuple[str, ...]] | None = None,
    kind: str = "mcap",
    skin_group: int = 1,
    reset_s: float = 1e9,
) -> list[str]:
    """Write the bag of `import rosbag`, its skin without a stamp; return its arguments.

    Parameters
    ----------
    names : joints that a joint state has, by its index, where it has not both
    skin_group : number of skin frames that arrive together, 1 ms apart
    reset_s : when the clock of recorder and senders is set to its beginning
    """
    messages: list[tuple[int, Stream, int]] = []
    for stream, times in recording.times.items():
        arrivals = times if stream is not Stream.SKIN else arrive_in_groups(times, skin_group)
        messages += [(round(time * 1e9), stream, k) for k, time in enumerate(arrivals)]
    with BagFile(folder, kind) as bag:
        for at_ns, stream, k in sorted(messages, key=lambda each: each[0]):
            ns = round(EPOCH * 1e9) + at_ns - (round(reset_s * 1e9) if at_ns >= reset_s * 1e9 else 0)
            row = recording.rows[stream][k]
            if stream is Stream.WRENCH:
                bag.add("/ft", WRENCH_TYPE, ns, wrench_message(ns, row))
            elif stream is Stream.SKIN:
                bag.add("/skin", SKIN_TYPE, ns, skin_message(row))
            else:
                given = (names or {}).get(k, NAMES)
                bag.add("/joint_states", JOINTS_TYPE, ns, joints_message(ns, [row[NAMES.index(n)] for n in given], given))
    joints = ["--joints", f"/joint_states?joints={','.join(NAMES)}"] if Stream.JOINTS in recording.rows else []
    return ["rosbag", str(bag.path), "--wrench", "/ft", "--skin", "/skin", *joints]


def errors_mm(snapshot: Snapshot) -> list[float]:
    """Distances of the force axes of all accepted pokes from the true taxels that answered, mm: wrong in a wrong arm pose."""
    found: list[float] = []
    for outcome in (record.outcome for record in snapshot.pokes):
        if isinstance(outcome, Contact):
            turn, shift = outcome.link_from_sensor[:3, :3], outcome.link_from_sensor[:3, 3]
            force = turn @ outcome.force
            moment = turn @ outcome.moment + np.cross(shift, force)
            miss = moment - np.cross(TAXELS[outcome.strongest_channel], force)
            found.append(1e3 * float(np.linalg.norm(miss) / np.linalg.norm(force)))
    return found
