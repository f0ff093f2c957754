"""Synthesised samples for tests of contacts and sessions: pokes at known points, written down as a script."""

from __future__ import annotations

import binascii
import contextlib
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from skincal.contacts.detector import ContactDetector
from skincal.contacts.outcome import Outcome
from skincal.following.error_history import ErrorCourse
from skincal.geometry import FloatArray
from skincal.journal.lock import SessionLock
from skincal.journal.writer import open_segment
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Sample, Stream
from skincal.model.scene import ArmSpec, ContactSettings, NoiseSettings, Scene, SkinSpec, load_scene
from skincal.model.skin import MODULE_KINDS, Layout, Module
from skincal.session.snapshot import Snapshot
from skincal.streams.links import LinkSpec
from skincal.taxels.result import Estimate

PERIOD_S = 0.02


def small_layout(width: int = 24) -> Layout:
    """Two triangles side by side: channels 0-11 and 12-23."""
    kind = MODULE_KINDS["triangle_12"]
    return Layout(
        (Module(0, kind, 0, np.zeros(2), 0.0, False), Module(1, kind, 12, np.array([0.0151, 0.0087]), np.pi, False)), width
    )


def small_scene(
    *,
    channels: int = 24,
    layout: bool = True,
    polarity: int = 1,
    arm: ArmSpec | None = None,
    limits: tuple[float, float] | None = None,
    settings: ContactSettings | None = None,
) -> Scene:
    return Scene(
        name="script",
        link="link",
        skin=SkinSpec(channels, polarity, small_layout(channels) if layout else None, None, limits),
        surface=None,
        arm=arm,
        sensor_pose=np.eye(4),
        wrench_sign=1,
        contacts=settings or ContactSettings(),
        noise=NoiseSettings(),
        path=Path("script.toml"),
    )


@dataclass
class Script:
    """Builds a list of samples step by step; what is not said stays as it was."""

    scene: Scene
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    force_noise: float = 0.0
    moment_noise: float = 0.0
    skin_noise: float = 0.0
    offset: FloatArray = field(default_factory=lambda: np.array([3.0, -2.0, 20.0, 0.1, -0.3, 0.05]))
    drift: FloatArray = field(default_factory=lambda: np.zeros(6))
    resting: float = 100.0
    now: float = 1000.0
    samples: list[Sample] = field(default_factory=list)
    angles: FloatArray | None = None

    def step(
        self, wrench: FloatArray | None = None, responses: dict[int, float] | None = None, *, saturated: bool = False
    ) -> None:
        wrench = np.zeros(6) if wrench is None else wrench
        noise = np.r_[self.rng.normal(0, 1, 3) * self.force_noise, self.rng.normal(0, 1, 3) * self.moment_noise]
        skin = (
            np.full(self.scene.skin.channels, self.resting) + self.rng.normal(0, 1, self.scene.skin.channels) * self.skin_noise
        )
        for channel, value in (responses or {}).items():
            skin[channel] += self.scene.skin.polarity * value
        raw = self.offset + self.drift * (self.now - 1000.0) + wrench + noise
        self.samples.append(Sample(self.now, skin, raw, 20, saturated, self.angles))
        self.now += PERIOD_S

    def quiet(self, seconds: float = 1.0) -> Script:
        for _ in range(round(seconds / PERIOD_S)):
            self.step()
        return self

    def gap(self, seconds: float) -> Script:
        self.now += seconds
        return self

    def press(
        self,
        force: FloatArray,
        point: FloatArray,
        responses: dict[int, float],
        *,
        hold_s: float = 0.6,
        ramp_s: float = 0.06,
        wobble: float = 0.0,
        slide: FloatArray | None = None,
        torque: FloatArray | None = None,
    ) -> Script:
        """Press at `point` with `force`, ramping up and down; `wobble` is a relative spread, `slide` m/s of the point."""
        ramp = max(1, round(ramp_s / PERIOD_S))
        hold = round(hold_s / PERIOD_S)
        shares = [*(np.arange(1, ramp) / ramp), *([1.0] * hold), *(np.arange(ramp - 1, 0, -1) / ramp)]
        for index, share in enumerate(shares):
            f = force * share * (1 + wobble * (-1) ** index * (share == 1.0))
            at = point + (np.zeros(3) if slide is None else slide * index * PERIOD_S)
            m = np.cross(at, f) + (np.zeros(3) if torque is None else torque * share)
            self.step(np.r_[f, m], {c: v * share for c, v in responses.items()})
        return self

    def run(self, detector: ContactDetector | None = None, link: FloatArray | None = None, pose: str = "") -> list[Outcome]:
        detector = detector or ContactDetector(self.scene)
        outcomes: list[Outcome] = []
        for sample in self.samples:
            outcomes += detector.feed(sample, np.eye(4) if link is None else link, pose)
        return outcomes


def skt_line(body: str) -> bytes:
    """A record of SKT/1: the body, a star, its CRC-16/CCITT-FALSE."""
    raw = body.encode()
    return raw + b"*%04X\n" % binascii.crc_hqx(raw, 0xFFFF)


LINKS = (LinkSpec("wrench", "file:none", (Stream.WRENCH,), "skt"), LinkSpec("skin", "file:none", (Stream.SKIN,), "skt"))


def as_chunks(samples: list[Sample], per_frame: int = 4) -> list[Chunk | LinkEvent]:
    """Write samples as two SKT/1 devices would send them: a skin frame each, and `per_frame` wrenches before it."""
    start_ns = round(samples[0].host_s * 1e9) - 1_000_000_000
    items: list[Chunk | LinkEvent] = [LinkEvent(link.name, start_ns, LinkState.OPEN) for link in LINKS]
    step_us = round(PERIOD_S * 1e6) // per_frame
    for k, sample in enumerate(samples):
        now_us = round((sample.host_s - samples[0].host_s) * 1e6) + 1_000_000
        lines = []
        for j in range(per_frame):
            at = now_us - step_us * (per_frame - 1 - j)
            values = ",".join(f"{value:.6f}" for value in sample.wrench)
            lines.append(skt_line(f"F,{(k * per_frame + j) & 0xFFFF},{at},{values},{int(sample.saturated)}"))
        host_ns = round(sample.host_s * 1e9)
        items.append(Chunk("wrench", host_ns + 1_000_000, b"".join(lines)))
        skin = ",".join("nan" if np.isnan(value) else f"{value:.2f}" for value in sample.skin)
        items.append(Chunk("skin", host_ns + 1_200_000, skt_line(f"T,{k & 0xFFFF},{now_us},{skin}")))
    return items


def write_scene(folder: Path) -> Scene:
    """Write a scene file with two triangles, as `small_scene` has them, and load it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "modules.toml").write_text(
        '[[modules]]\nid = 0\nkind = "triangle_12"\nfirst_channel = 0\n'
        '[[modules]]\nid = 1\nkind = "triangle_12"\nfirst_channel = 12\nplace_mm = [15.1, 8.7]\nangle_deg = 180.0\n'
    )
    path = folder / "patch.toml"
    path.write_text('name = "patch"\nlink = "table"\n[skin]\nchannels = 24\nmodules = "modules.toml"\n')
    return load_scene(path)


SPOTS = {
    0: np.array([0.00, 0.00, 0.10]),
    1: np.array([0.01, -0.01, 0.10]),
    2: np.array([-0.01, 0.01, 0.10]),
}
ANSWERS = {0: {3: 80.0, 7: 40.0}, 1: {3: 30.0, 2: 70.0, 1: 50.0}, 2: {7: 60.0, 8: 90.0}}


def some_pokes(scene: Scene, count: int, seed: int = 5, quiet_s: float = 0.6) -> Script:
    """Noisy pokes on three spots from changing sides, with drift."""
    script = Script(
        scene,
        rng=np.random.default_rng(seed),
        force_noise=0.02,
        moment_noise=0.002,
        skin_noise=0.8,
        drift=np.array([0.01, -0.02, 0.01, 1e-3, 0.0, 1e-3]),
    )
    script.quiet(1.0)
    for k in range(count):
        lean = script.rng.normal(0, 2.0, 2)
        script.press(np.array([*lean, -8.0]), SPOTS[k % 3], ANSWERS[k % 3], hold_s=0.4, ramp_s=0.08).quiet(quiet_s)
    return script


def same_estimates(first: Snapshot, second: Snapshot) -> bool:
    """Every number of every estimate is the same, to the last bit."""
    if first.estimates.keys() != second.estimates.keys():
        return False
    for method in first.estimates:
        ours, theirs = first.estimates[method], second.estimates[method]
        if [estimate_key(estimate) for estimate in ours] != [estimate_key(estimate) for estimate in theirs]:
            return False
    return True


def estimate_key(estimate: Estimate) -> tuple[object, ...]:
    """All fields of an estimate in a form that `==` compares bit for bit."""
    return tuple(
        value.tobytes() if isinstance(value, np.ndarray) else value
        for value in (getattr(estimate, name) for name in Estimate.__slots__)
    )


def outcome_key(outcome: Outcome) -> tuple[object, ...]:
    """All fields of an outcome in a form that `==` compares bit for bit."""
    values = (getattr(outcome, name) for name in type(outcome).__slots__ if name not in ("press", "tare_after"))
    return tuple(np.asarray(value).tobytes() if isinstance(value, np.ndarray | float) else value for value in values)


def killed(pipeline):
    """What was buffered is on the disk, and nothing more comes: what the system does to a process that dies."""
    pipeline.journal.sync()
    pipeline.journal._abandon()
    pipeline.journal._lock._file.close()
    return pipeline


def torn(folder, size, number=1):
    """Cut a segment's MCAP file off at `size`, and its lines where they speak of more: they are written after it."""
    path = folder / f"segment-{number:04d}.mcap"
    path.write_bytes(path.read_bytes()[:size])
    found, items = 0, set()
    with contextlib.suppress(McapError, struct.error), path.open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Channel) and (record.topic == "/events" or record.topic.startswith("/raw/")):
                items.add(record.id)
            found += isinstance(record, Message) and record.channel_id in items
    beside = path.with_suffix(".jsonl")
    lines = beside.read_bytes().splitlines(keepends=True)
    beside.write_bytes(b"".join(line for line in lines if json.loads(line)[1] <= found and b'"closed"' not in line[-12:]))


def next_segment(folder, scene, links):
    """The journal of a session that goes on, as `resume` opens it."""
    lock = SessionLock(folder)
    try:
        return open_segment(folder, scene, links, lock)
    except InputError:
        lock.release()
        raise


def error_series(scene, surface, snapshot, known):
    """Return the whole course of errors of a session at once; parameters as for `ErrorCourse`."""
    course = ErrorCourse(scene, surface, known)
    course.update(snapshot)
    course.add_points(*course.work())
    return course.series()
