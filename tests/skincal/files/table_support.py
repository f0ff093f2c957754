"""A simulated 4 x 4 skin that is poked, as the tables that programs write of it, and the positions that come out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.importers.registry import RECORDING_IMPORTERS, RecordedPlace
from skincal.files.importers.timeline import OpenRecording
from skincal.geometry import FloatArray
from skincal.model.readings import Loss, Stream
from skincal.session.pipeline import Pipeline
from skincal.taxels.result import Method
from tests.skincal.poke_script import small_scene

CHANNELS = 16
RATE = 25.0
POKE_S = 1.6
"""s from poke to poke."""
START_S = 1_714_556_400
"""2024-05-01, 09:40 UTC, seconds since 1970."""
TAXELS = np.array([[x, y, 45.0] for y in (-9, -3, 3, 9) for x in (-9, -3, 3, 9)]) * 1e-3
"""(16, 3) m: true positions."""
TILTS = ((0.5, 0.1), (-0.3, 0.4))
POKED = (0, 1, 2, 5, 10, 15)
"""Taxels that are poked. Sorted as text, backwards, row for column or shifted, they change places."""
POKES = len(POKED) * len(TILTS)
AXES = ("fx", "fy", "fz", "mx", "my", "mz")
TAXEL_NAMES = tuple(f"t{k}" for k in range(CHANNELS))


@dataclass(frozen=True)
class Rows:
    """Times (n,) s, wrenches (n, 6) N and N m, and raw values (n, 16) of a poked skin."""

    times: FloatArray
    wrench: FloatArray
    skin: FloatArray

    def seconds(self, digits: int = 3) -> list[str]:
        return [f"{time:.{digits}f}" for time in self.times]

    def moments(self, form: str) -> list[str]:
        """Dates at these times."""
        found = [datetime.fromtimestamp(START_S + time, UTC) for time in self.times]
        return [each.strftime(form).replace("{ms}", f"{each.microsecond // 1000:03}") for each in found]


def poked_rows(rest: float = 200.0) -> Rows:
    """Press taxels from two sides, 8 N; the largest answer is 400 above rest."""
    rng = np.random.default_rng(8)
    order = [(channel, tilt) for tilt in TILTS for channel in POKED]
    times = np.arange(int((1.0 + POKE_S * len(order)) * RATE)) / RATE
    noise = np.repeat([0.005, 0.00015], 3)
    wrench = np.array([3, -2, 9, 0.1, -0.2, 0.05]) + rng.normal(0, noise, (len(times), 6))
    skin = rest + rng.normal(0, 0.7, (len(times), CHANNELS))
    for k, (channel, tilt) in enumerate(order):
        push = np.array([*tilt, -1.0])
        force = 8.0 * push / np.linalg.norm(push)
        phase = times - 1.0 - POKE_S * k
        level = np.clip(np.minimum(phase - 0.4, 1.2 - phase) / 0.1, 0.0, 1.0)[:, None]
        wrench += level * np.r_[force, np.cross(TAXELS[channel], force)]
        skin[:, channel] += 400 * level[:, 0]
    return Rows(times, np.round(wrench, 5), np.round(skin))


@dataclass(frozen=True)
class Table:
    """Columns of text and how a program writes them."""

    names: tuple[str, ...]
    columns: list[list[str]]
    separator: str = ","
    end: str = ""
    """After each row."""
    before: str = ""
    below_names: str = ""
    encoding: str = "utf-8"

    def write(self, path: Path) -> RecordedPlace:
        def line(fields: tuple[str, ...] | list[str]) -> str:
            quoted = [f'"{each}"' if self.separator in each or "\n" in each else each for each in fields]
            return self.separator.join(quoted)

        rows = "".join(f"{line(list(row))}{self.end}\n" for row in zip(*self.columns, strict=True))
        names = f"{line(self.names)}\n" if self.names else ""
        path.write_bytes((self.before + names + self.below_names + rows).encode(self.encoding))
        return RecordedPlace(path)


def fields(values: FloatArray, form: str) -> list[list[str]]:
    """Columns of (n, k) values as text."""
    return [[form.format(value) for value in column] for column in values.T.tolist()]


def wrench_table(rows: Rows, **changes: object) -> Table:
    return replace(Table(("t_s", *AXES), [rows.seconds(), *fields(rows.wrench, "{:.5f}")]), **changes)


def skin_table(rows: Rows, **changes: object) -> Table:
    return replace(Table(("t_s", *TAXEL_NAMES), [rows.seconds(), *fields(rows.skin, "{:.0f}")]), **changes)


@dataclass(frozen=True)
class Imported:
    """What an import gave."""

    errors_mm: FloatArray
    """Distance of each poked taxel from its true position, NaN if it is not known; infinite for each other one with a place."""
    accepted: int
    losses: dict[str, dict[Loss, int]]
    findings: tuple[str, ...]

    def unknown(self) -> list[int]:
        """Poked taxels without a place."""
        return [channel for channel, error in zip(POKED, self.errors_mm, strict=False) if np.isnan(error)]


def import_tables(wrench: RecordedPlace, skin: RecordedPlace, channels: int = CHANNELS) -> Imported:
    """Import two tables, or one twice, to positions."""
    importer = next(each for each in RECORDING_IMPORTERS if each.name == "csv")
    return positions_of(importer.open_recording({Stream.WRENCH: wrench, Stream.SKIN: skin}, channels=channels), channels)


def positions_of(opened: OpenRecording, channels: int = CHANNELS) -> Imported:
    """Play a recording to positions."""
    scene = small_scene(channels=channels, layout=False)
    pipeline = Pipeline(scene, opened.links, None)
    pipeline.feed_many(list(opened.chunks()))
    pipeline.close()
    snapshot = pipeline.snapshot()
    found = {each.channel: each.position for each in snapshot.estimates[Method.FREE] if each.position is not None}
    errors = [1e3 * np.linalg.norm(found[channel] - TAXELS[channel]) if channel in found else np.nan for channel in POKED]
    errors += [np.inf] * len(found.keys() - set(POKED))
    accepted = sum(isinstance(record.outcome, Contact) for record in snapshot.pokes)
    losses = {link.link: {loss: count for loss, count in link.losses.items() if count} for link in pipeline.live(0).links}
    return Imported(np.array(errors), accepted, losses, opened.findings)
