"""The part's surface: triangles with outward normals, and what was found in the mesh file.

A robot cover is an open shell with slivers, unshared vertices and now and then a turned panel. It is checked, merged
and turned, and what was done is said; no hole is filled and no vertex moved.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.model.errors import InputError
from skincal.model.scene import UNITS, SurfaceSpec
from skincal.surface.clean import MERGE_DISTANCE, SLIVER_RATIO, ZERO_HEIGHT, duplicate_triangles, heights, merge_vertices
from skincal.surface.edges import find_edges, triangle_normals
from skincal.surface.files import read_mesh
from skincal.surface.resident import resident
from skincal.surface.tree import Fans, Tree, build_tree, find_fans
from skincal.surface.unfold import Unfolded
from skincal.surface.winding import Winding, wind_outward

SIZE_MIN, SIZE_MAX = 0.005, 3.0
"""m. Diagonal of the box of a robot part: a fingertip to a whole torso. Millimetres taken for metres, or metres for
millimetres, miss it by a thousand."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh, link frame, metres. Two copies of a surface are never equal; compare `sha256`."""

    vertices: FloatArray
    """(nv, 3) float."""
    triangles: IntArray
    """(nt, 3) int, counter-clockwise seen from outside."""
    normals: FloatArray
    """(nt, 3) float, unit, outward."""
    sha256: str
    """Of the file's bytes, hexadecimal."""

    @cached_property
    def corners(self) -> FloatArray:
        """(nt, 3, 3) float: the vertices of each triangle."""
        return self.vertices[self.triangles]

    @cached_property
    def centres(self) -> FloatArray:
        """(3, nt) float: centres of balls that hold the triangles."""
        return np.ascontiguousarray(self.corners.mean(axis=1).T)

    @cached_property
    def radii(self) -> FloatArray:
        """(nt,) float: radii of those balls, metres."""
        return np.linalg.norm(self.corners - self.centres.T[:, None], axis=2).max(axis=1)

    @cached_property
    def tree(self) -> Tree:
        """The search tree over the triangles, built once."""
        return build_tree(self.corners, self.normals)

    @cached_property
    def fans(self) -> Fans:
        """The triangles around each vertex."""
        return find_fans(self.triangles, len(self.vertices))

    @cached_property
    def unfolded(self) -> Unfolded:
        """The surface as straight ways over it are worked out."""
        return Unfolded(self)

    def prepare(self) -> None:
        """Build now what the search needs, so that the first poke does not wait for it."""
        resident(self)

    @cached_property
    def slim(self) -> NDArray[np.bool_]:
        """(nt,) whether a triangle is a sliver: over `SLIVER_RATIO` times as long as high."""
        height, longest = heights(self.corners)
        return longest > SLIVER_RATIO * height


def make_surface(vertices: FloatArray, triangles: IntArray, sha256: str = "") -> Surface:
    """Return the surface of `triangles` (nt, 3) as wound over `vertices` (nv, 3), metres, link frame; none has zero area."""
    vertices = np.ascontiguousarray(vertices, dtype=float)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    return Surface(vertices, triangles, triangle_normals(vertices[triangles]), sha256)


class FindingKind(Enum):
    """What is said about a mesh; the value is its short name."""

    SIZE = "size"
    MERGED = "merged vertices"
    ZERO_AREA = "zero-area triangles"
    DUPLICATES = "duplicate triangles"
    SLIVERS = "slivers"
    OPEN_EDGES = "open edges"
    NON_MANIFOLD = "non-manifold edges"
    COMPONENTS = "components"
    WINDING = "inconsistent winding"
    TURNED = "turned normals"
    ONE_SIDED = "one-sided"
    FLAT = "flat"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing found in a mesh, and what was done about it."""

    kind: FindingKind
    count: int
    sentence: str


def load_surface(spec: SurfaceSpec) -> tuple[Surface, tuple[Finding, ...]]:
    """Read a mesh into the link frame with outward normals, and say what was found.

    Raises
    ------
    InputError
        The file is missing, unreadable, of an unknown format, empty, has vertices that are not finite, or is a
        thousand times too large or too small; the message says what was seen and what to do.
    """
    data = _read_bytes(spec.path)
    vertices, triangles = read_mesh(spec.path, data)
    if len(triangles) == 0:
        raise InputError(f"{spec.path}: the mesh is empty ({len(vertices)} vertices, no triangle); export the part again.")
    _check_finite(spec.path, vertices)
    size = _check_size(spec, vertices[triangles.ravel()])
    vertices = vertices * spec.scale @ spec.link_from_mesh[:3, :3].T + spec.link_from_mesh[:3, 3]
    vertices, triangles, merged = merge_vertices(vertices, triangles)
    triangles, dropped = _drop(spec.path, vertices, triangles)
    winding = wind_outward(vertices, triangles)
    surface = make_surface(vertices, winding.triangles, hashlib.sha256(data).hexdigest())
    surface.prepare()
    findings = [size, *_merge_findings(merged), *dropped, *_shape_findings(surface), *_winding_findings(winding)]
    return surface, tuple(findings)


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such mesh file; check [surface] mesh in the scene.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path and its rights.") from None


def _check_finite(path: Path, vertices: FloatArray) -> None:
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path}: {int(bad.sum())} of {len(vertices)} vertices are NaN or infinite (the first is {int(bad.argmax())}); "
            "finite coordinates were expected: export the part again."
        )


def _length(metres: float) -> str:
    return f"{metres * 1e3:.4g} mm" if metres < 1 else f"{metres:.4g} m"


def _check_size(spec: SurfaceSpec, corners: FloatArray) -> Finding:
    box = corners.max(axis=0) - corners.min(axis=0)
    raw = float(np.linalg.norm(box))
    unit = min(UNITS, key=lambda name: abs(UNITS[name] - spec.scale))
    diagonal = raw * spec.scale
    if SIZE_MIN <= diagonal <= SIZE_MAX:
        sides = " x ".join(f"{side * spec.scale * 1e3:.4g}" for side in box)
        sentence = f"The part is {sides} mm (diagonal {_length(diagonal)}, unit {unit}); check that it is so."
        return Finding(FindingKind.SIZE, 0, sentence)
    fitting = {name: raw * scale for name, scale in UNITS.items() if SIZE_MIN <= raw * scale <= SIZE_MAX}
    likely = "; ".join(f"unit {name} would give {_length(size)}" for name, size in fitting.items())
    raise InputError(
        f"{spec.path}: the part's box has a diagonal of {_length(diagonal)} with unit {unit}; {_length(SIZE_MIN)} to "
        f"{_length(SIZE_MAX)} was expected: {likely or 'no known unit makes it fit'}. Correct [surface] unit in the scene."
    )


def _drop(path: Path, vertices: FloatArray, triangles: IntArray) -> tuple[IntArray, list[Finding]]:
    findings: list[Finding] = []
    height, longest = heights(vertices[triangles])
    flat = height < ZERO_HEIGHT
    if flat.any():
        sentence = f"Triangles without area (flatter than {ZERO_HEIGHT * 1e9:.0f} nm), dropped: {int(flat.sum())}."
        findings.append(Finding(FindingKind.ZERO_AREA, int(flat.sum()), sentence))
        triangles, height, longest = triangles[~flat], height[~flat], longest[~flat]
    again = duplicate_triangles(triangles)
    if again.any():
        sentence = f"Triangles that were there twice, dropped: {int(again.sum())}."
        findings.append(Finding(FindingKind.DUPLICATES, int(again.sum()), sentence))
        triangles, height, longest = triangles[~again], height[~again], longest[~again]
    if len(triangles) == 0:
        raise InputError(f"{path}: no triangle of the mesh has an area; a surface was expected: export the part again.")
    slivers = int((longest > SLIVER_RATIO * height).sum())
    if slivers:
        sentence = f"Slivers (over {SLIVER_RATIO:.0f} times as long as high), used as they are: {slivers}."
        findings.append(Finding(FindingKind.SLIVERS, slivers, sentence))
    return triangles, findings


def _merge_findings(merged: int) -> list[Finding]:
    if merged == 0:
        return []
    sentence = f"Vertices within {MERGE_DISTANCE * 1e6:.0f} um of another, merged: {merged}."
    return [Finding(FindingKind.MERGED, merged, sentence)]


def _shape_findings(surface: Surface) -> list[Finding]:
    edges = find_edges(surface.triangles)
    findings: list[Finding] = []
    if len(edges.open):
        sentence = f"The mesh has open rims, as covers have ({len(edges.open)} edges); it is used as it is."
        findings.append(Finding(FindingKind.OPEN_EDGES, len(edges.open), sentence))
    if edges.non_manifold:
        sentence = f"Edges shared by three or more triangles, across which no pad is laid: {edges.non_manifold}."
        findings.append(Finding(FindingKind.NON_MANIFOLD, edges.non_manifold, sentence))
    return findings


def _winding_findings(winding: Winding) -> list[Finding]:
    said = [
        (FindingKind.COMPONENTS, winding.components, "Pieces that share no edge: {}.", 1),
        (FindingKind.WINDING, winding.against, "Triangles wound against their neighbours, turned: {}.", 0),
        (FindingKind.TURNED, winding.turned, "Triangles that pointed inward, by the shape of the part, turned: {}.", 0),
        (FindingKind.ONE_SIDED, winding.one_sided, "Pieces with one side only, normals as in the file: {}.", 0),
        (
            FindingKind.FLAT,
            winding.undecided,
            "Pieces whose shape does not tell inside from outside, normals as in the file: {}.",
            0,
        ),
    ]
    return [Finding(kind, count, sentence.format(count)) for kind, count, sentence, usual in said if count > usual]
