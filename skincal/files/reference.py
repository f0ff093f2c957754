"""Known taxel positions (simulated truth, CAD model, earlier calibration) and the errors of estimates against them."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray, rotation_of_quaternion
from skincal.methods import leading_by
from skincal.model.errors import InputError
from skincal.model.given import MAX_JSON_BYTES, parse_json, read_regular
from skincal.taxels.differences import CommonMotion, ModuleDifference, repeatability
from skincal.taxels.result import Estimate, Method
from skincal.words.units import millimetres

TRUTH_NAME = "truth.json"
"""A simulated session has one next to its segments."""
REFERENCE_FORMS = "a truth.json, a calibration's JSON or CSV, a URDF with a tactile sensor, or an iCub position file"
MAX_AXES_ERROR = 1e-3
"""Largest difference of a rotation's R'R from the identity: three decimals pass."""
SAME_RIG_MAX_DIFFERENCE_M = 1e-6
"""Between true positions of the same rig: other versions of numpy may round differently."""
ROTATION_KEY = "rotation"
"""In a truth file: rows of the rotation from the axes of a taxel to the link, of a skin of three axes."""
RIG_KEY = "rig"
"""In a truth file: `seed` and `errors` of the simulated rig, from which `simulate` makes the same rig."""


def truth_as_json(
    link: str, channels: IntArray, places: FloatArray, normals: FloatArray, axes: FloatArray | None = None
) -> dict[str, Any]:
    """Write true taxels for `truth.json`: link frame, metres, unit normals.

    `axes` (n, 3, 3) are those of taxels that measure three axes, in columns; they are written as rows of a matrix.
    """
    taxels: list[dict[str, Any]] = [
        {"channel": channel, "position_m": place, "normal": normal}
        for channel, place, normal in zip(channels.tolist(), places.tolist(), normals.tolist(), strict=True)
    ]
    if axes is not None:
        taxels = [{**taxel, ROTATION_KEY: turned} for taxel, turned in zip(taxels, axes.tolist(), strict=True)]
    return {"link": link, "taxels": taxels}


class Origin(Enum):
    """Source of known positions."""

    TRUTH = "truth"
    """A simulated rig's: where its taxels are."""
    FILE = "file"
    """A file that the operator chose: as true as it was made."""
    PLAN = "plan"
    """The scene's layout placed on the part: modules stretch and are glued askew, so it may be a few millimetres wrong."""


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Distance of estimates to their reference over the taxels that have both, metres."""

    taxels: int
    mean: float
    sd: float
    p95: float
    max: float
    worst_channel: int


@dataclass(frozen=True, slots=True, eq=False)
class TaxelPositions:
    """Taxel positions from one source, to compare others with."""

    name: str
    """Of the source, for the operator."""
    link: str
    """The frame of the positions; empty if the source names none."""
    places: Mapping[int, FloatArray]
    """Channel to (3,) float, metres, in that frame."""
    modules: Mapping[int, int] = field(default_factory=dict[int, int])
    """Channel to the id of its module; empty if the source names none."""
    method: Method | None = None
    """Method that estimated the positions; `None` if the file names none."""
    origin: Origin = Origin.FILE
    axes: Mapping[int, FloatArray] = field(default_factory=dict[int, FloatArray])
    """Channel to (3, 3) float, the axes of a taxel in columns, in that frame; NaN in those that are unknown."""


def read_reference(path: Path) -> dict[int, FloatArray]:
    """Read known positions, (3,) float in metres by channel, as `read_places`."""
    return dict(read_places(path).places)


def read_places(path: Path, method: Method | None = None) -> TaxelPositions:
    """Read positions from a `truth.json`, a calibration's JSON or CSV, a URDF's tactile sensor, or an iCub position file.

    Parameters
    ----------
    method : whose positions of a JSON or CSV that holds several; `None` for the leading method (`leading_by`)

    Raises
    ------
    InputError
        The file cannot be read, is none of these, or has no such method.
    """
    sets = read_place_sets(path)
    chosen = next((each for each in sets if method in (None, each.method)), None)
    if chosen is None:
        known = ", ".join(each.method.value for each in sets if each.method is not None)
        asked = "" if method is None else method.value
        raise InputError(f"{path}: has no places of the {asked} method; it has {known or 'those of no method'}.")
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Distances between two sets of positions of the same taxels."""

    first: str
    """Name of the first set."""
    second: str
    channel: IntArray
    """(n,) channels known in both sets, ascending."""
    distance: FloatArray
    """(n,) float, metres."""
    motion: CommonMotion | None
    """Rigid motion from the first set to the second (turn in rad, shift in metres), and what it leaves; `None` if fewer than
    three taxels, or taxels on one line, do not determine it."""
    modules: Mapping[int, ModuleDifference]
    """By the id of each module that has a taxel in both sets."""

    @property
    def mean(self) -> float:
        """Mean distance, metres; NaN without a common taxel."""
        return float(self.distance.mean()) if len(self.distance) else float("nan")

    @property
    def rms(self) -> float:
        """Root mean square of the distances, metres; NaN without a common taxel."""
        return float(np.sqrt(np.mean(self.distance * self.distance))) if len(self.distance) else float("nan")

    @property
    def worst(self) -> float:
        """Largest distance, metres; NaN without a common taxel."""
        return float(self.distance.max()) if len(self.distance) else float("nan")

    @property
    def worst_channel(self) -> int | None:
        """Channel of the largest distance; `None` without a common taxel."""
        return int(self.channel[self.distance.argmax()]) if len(self.distance) else None

    def __repr__(self) -> str:
        """Mean and largest distance in a line."""
        return f"Comparison({len(self.channel)} taxels: {millimetres(self.mean, 2)} mean, {millimetres(self.worst, 2)} at most)"


def compare_sets(first: TaxelPositions, second: TaxelPositions) -> Comparison:
    """Compare two sets of positions of the same taxels.

    Raises InputError: the sets are in frames of different names.
    """
    if first.link and second.link and first.link != second.link:
        raise InputError(
            f"{first.name} is in the frame of {first.link!r}, {second.name} in that of {second.link!r}; expected places of "
            "the same part."
        )
    channels = np.array(sorted(first.places.keys() & second.places.keys()), dtype=np.int64)
    module_of = {**second.modules, **first.modules}
    ids = np.array([module_of.get(channel, -1) for channel in channels.tolist()], dtype=np.int64)
    named, owners = np.unique(ids, return_inverse=True)
    # The smallest id is that of taxels without a module, where there are some.
    none = int(len(named) > 0 and named[0] < 0)
    here, there = (_rows(each.places, channels) for each in (first, second))
    found = repeatability(here, there, owners.astype(np.int64) - none)
    modules = {int(named[none + each.module]): each for each in found.modules}
    return Comparison(first.name, second.name, channels, found.lengths, found.motion, modules)


def _rows(places: Mapping[int, FloatArray], channels: IntArray) -> FloatArray:
    return np.array([places[channel] for channel in channels.tolist()], dtype=float).reshape(-1, 3)


def load_reference(path: Path, link: str, channels: Collection[int], origin: Origin = Origin.FILE) -> TaxelPositions:
    """Read known positions (`read_places`) and check that they are of the scene's `link` and `channels`.

    Raises InputError: as for `read_places`; also if the file is of another link or knows none of the channels.
    """
    read = read_places(path)
    require_same_part(read, path, link, channels)
    return replace(read, name=path.name, origin=origin)


def require_same_part(found: TaxelPositions, path: Path, link: str, channels: Collection[int]) -> None:
    """Raise InputError where places read from `path` are of another link than `link`, or know none of `channels`."""
    # An iCub file names no link; the operator answers for it.
    if found.link and found.link != link:
        raise InputError(f"{path}: its places are in the frame of {found.link!r}; the scene calibrates {link!r}.")
    if not found.places.keys() & set(channels):
        raise InputError(f"{path}: it knows none of this skin's {len(channels)} taxels; choose the file of this part.")


def find_truth(folder: Path, link: str, channels: Collection[int]) -> TaxelPositions | None:
    """Read the truth in a session's folder, as `load_reference`; `None` if there is none."""
    path = folder / TRUTH_NAME
    return load_reference(path, link, channels, Origin.TRUTH) if path.is_file() else None


def is_simulated(folder: Path) -> bool:
    """Whether the pokes of a session are simulated."""
    return (folder / TRUTH_NAME).is_file()


def is_same_rig(folder: Path, truth: bytes) -> bool:
    """Whether a simulated rig, by its truth file, has the taxels of a session's rig.

    Raises InputError: the session's truth file cannot be read.
    """
    document = parse_json(truth)
    places = {int(taxel["channel"]): _place(taxel["position_m"]) for taxel in document["taxels"]}
    kept = read_places(folder / TRUTH_NAME).places
    off = [np.abs(places[channel] - kept[channel]).max() for channel in places.keys() & kept.keys()]
    return places.keys() == kept.keys() and max(off, default=0.0) < SAME_RIG_MAX_DIFFERENCE_M


def simulated_rig_options(folder: Path) -> tuple[str, ...]:
    """Give the options of `simulate` that make the rig of a session again; empty if its truth file does not name the rig."""
    try:
        rig = parse_json(read_regular(folder / TRUTH_NAME, MAX_JSON_BYTES))[RIG_KEY]
        seed, errors = rig["seed"], rig["errors"]
    except (InputError, ValueError, KeyError, TypeError):
        return ()
    if not (isinstance(seed, int) and seed >= 0 and isinstance(errors, str) and errors.isalpha()):
        return ()
    return ("--seed", str(seed), "--errors", errors)


def plan_reference(name: str, places: FloatArray) -> TaxelPositions | None:
    """Convert the planned positions of a scene's layout; `None` if it places no taxel.

    `places` are (width, 3) float, metres, link frame; NaN where a channel is no taxel or has no position.
    """
    known = {int(channel): places[channel] for channel in np.flatnonzero(np.isfinite(places).all(axis=1))}
    return TaxelPositions(name, "", known, origin=Origin.PLAN) if known else None


def read_place_sets(path: Path) -> tuple[TaxelPositions, ...]:
    """Read all sets of places in a file, at least one: of several methods the one that leads comes first.

    Raises InputError: as for `read_places`.
    """
    try:
        if path.suffix.lower() == ".json":
            return _json_sets(path)
        if path.suffix.lower() == ".csv":
            return _csv_sets(path)
    except (ValueError, KeyError, TypeError, OverflowError, AttributeError, csv.Error):
        raise InputError(
            f'{path}: not a reference; expected JSON with "taxels": [{{"channel", "position_m"}}], or JSON or CSV as '
            "`skincal export` writes them."
        ) from None
    if path.suffix.lower() == ".urdf":
        from skincal.files.tactile_urdf import read_tactile_sensors

        return tuple(TaxelPositions(f"{path.name}, {each.name}", each.link, each.places) for each in read_tactile_sensors(path))
    from skincal.files.icub import read_icub

    try:
        rows = read_icub(path)
    except InputError as error:
        raise InputError(f"{error} Known places are read from {REFERENCE_FORMS}.") from None
    # Zeros mean "no position" in these files.
    places = {channel: place for channel, place in enumerate(rows[:, :3]) if np.any(place != 0.0)}
    return (TaxelPositions(path.name, "", places),)


def _json_sets(path: Path) -> tuple[TaxelPositions, ...]:
    document: Any = parse_json(read_regular(path, MAX_JSON_BYTES))
    if "estimates" not in document:
        places = {int(taxel["channel"]): _place(taxel["position_m"]) for taxel in document["taxels"]}
        axes = {int(taxel["channel"]): _axes(taxel[ROTATION_KEY]) for taxel in document["taxels"] if ROTATION_KEY in taxel}
        return (TaxelPositions(path.name, str(document.get("link", "")), places, axes=axes),)
    rows = [
        (
            Method(name), taxel["channel"], taxel["module"], taxel["position_m"], taxel["rms_m"],
            taxel.get("turn", {}).get("quaternion_wxyz"),
        )
        for name, taxels in document["estimates"].items()
        for taxel in taxels
    ]  # fmt: skip
    return _method_sets(path, str(document["frame"]), rows)


def _csv_sets(path: Path) -> tuple[TaxelPositions, ...]:
    rows: list[_Row] = []
    with io.StringIO(read_regular(path, MAX_JSON_BYTES).decode("utf-8"), newline="") as file:
        for row in csv.DictReader(file):
            words = [row["x_m"], row["y_m"], row["z_m"]]
            place = [float(word) for word in words] if all(words) else None
            sd = float(row["sd_mm"]) * 1e-3 if row["sd_mm"] else None
            turn = [row.get(f"turn_q{part}") for part in "wxyz"]
            quaternion = [float(word) for word in turn if word] if all(turn) else None
            module = int(row["module"]) if row["module"] else None
            rows.append((Method(row["method"]), int(row["channel"]), module, place, sd, quaternion))
    return _method_sets(path, "", rows)


_Row: TypeAlias = tuple[Method, int, int | None, Any, float | None, Any]
"""Method, channel, id of the module, position as three numbers or `None`, predicted error in metres or `None`, and the turn as
a quaternion w x y z or `None`."""


def _method_sets(path: Path, link: str, rows: Sequence[_Row]) -> tuple[TaxelPositions, ...]:
    methods = list(dict.fromkeys(row[0] for row in rows))
    if not methods:
        raise ValueError
    modules = {int(channel): int(module) for _, channel, module, *_ in rows if module is not None}
    sets: dict[Method, TaxelPositions] = {}
    errors: dict[Method, list[float]] = {}
    for method in methods:
        own = [row for row in rows if row[0] is method and row[3] is not None]
        places = {int(channel): _place(place) for _, channel, _, place, *_ in own}
        axes = {int(channel): _axes_of_quaternion(turn) for _, channel, *_, turn in own if turn is not None}
        sets[method] = TaxelPositions(f"{path.name}, {method.value} method", link, places, modules, method, axes=axes)
        errors[method] = [float(error) for *_, error, _ in own if error is not None]
    leads = leading_by(errors)
    return tuple(sets[method] for method in sorted(methods, key=lambda method: method is not leads))


def _place(numbers: object) -> FloatArray:
    place = np.array(numbers, dtype=float)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ValueError
    return place


def _axes_of_quaternion(numbers: object) -> FloatArray:
    """Read the axes (3, 3), in columns, of a unit quaternion w x y z."""
    quaternion = np.array(numbers, dtype=float)
    if quaternion.shape != (4,) or not abs(float(quaternion @ quaternion) - 1.0) < MAX_AXES_ERROR:
        raise ValueError
    return rotation_of_quaternion(quaternion)


def _axes(rows: object) -> FloatArray:
    axes = np.array(rows, dtype=float)
    if axes.shape != (3, 3) or not np.abs(axes.T @ axes - np.eye(3)).max() < MAX_AXES_ERROR:
        raise ValueError
    return axes


def error_summary(estimates: Iterable[Estimate], reference: Mapping[int, FloatArray]) -> ErrorSummary | None:
    """Summarise the distance of estimated taxels to their reference; None where they share no taxel.

    The sd is that of the distances, as in the paper's figures 4 and 5.
    """
    pairs = [
        (estimate.channel, float(np.linalg.norm(estimate.position - reference[estimate.channel])))
        for estimate in estimates
        if estimate.position is not None and estimate.channel in reference
    ]
    if not pairs:
        return None
    distance = np.array([value for _, value in pairs])
    return ErrorSummary(
        taxels=len(pairs),
        mean=float(distance.mean()),
        sd=float(distance.std()),
        p95=float(np.percentile(distance, 95)),
        max=float(distance.max()),
        worst_channel=pairs[int(distance.argmax())][0],
    )
