"""Findings in a mesh file, with their sentences."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from skincal.mesh.surface import SLIVER_MIN_LENGTH_OVER_HEIGHT

VERTEX_MERGE_DISTANCE_M = 1e-6
"""Vertices this near are one: a hundredth of a cover's tolerance, far above the rounding of a 32-bit file."""
MIN_TRIANGLE_HEIGHT_M = 1e-7
"""A flatter triangle has no direction: a 32-bit file in millimetres rounds 0.5 m to 3e-8 m."""
FLAT_POLYGON_MAX_OFFSET = 0.05
"""Largest distance of a corner from the polygon's plane, over the polygon's radius, that counts as flat."""


class FindingKind(Enum):
    """Finding in a mesh; the value is its sentence, with a gap for the count or words."""

    SIZE = "The part is {}."
    BYTES_AFTER_END = "Bytes after the last triangle that the file announces, not read: {}."
    NO_END = "The file ends without endsolid: compare the part with the drawing, its last triangles may be missing."
    NOT_FLAT = (
        f"Polygons with a corner off their plane by over {FLAT_POLYGON_MAX_OFFSET * 100:.0f} % of their radius: {{}}. Their "
        "triangles may differ from those of other programs; export triangles to fix them."
    )
    CROSSING = "Polygons that cross themselves, left out: {}. Export the part as triangles."
    TOO_LARGE = "Polygons with too many corners to be cut here, left out: {}. Export the part as triangles."
    SHORT_LISTS = (
        "Elements that announce more faces than they have: {}. Compare the part with the drawing, faces may be missing."
    )
    UNIT_WITHOUT_LENGTH = "The file's unit has no length; COLLADA takes {}. Check the size of the part."
    UNIT_REPLACED = "The file says that its unit is {}; the unit that the scene names is used."
    UP_AXIS = (
        "In this file the {} axis points up. Its axes are used unturned, as RViz and Gazebo use those of COLLADA. If the part "
        "is drawn sideways, turn it: by the pose in [surface], or by rpy of the visual's origin in the URDF."
    )
    GLTF_AXES = (
        "In glTF the y axis points up. The axes are used unturned, as Pinocchio and yourdfpy use them; Drake, and RViz since "
        "2025, turn them. If the part is drawn sideways, turn it: by the pose in [surface], or by rpy of the visual's origin "
        "in the URDF."
    )
    MERGED = f"Vertices within {VERTEX_MERGE_DISTANCE_M * 1e6:.0f} um of another, merged: {{}}."
    ZERO_AREA = f"Triangles without area (flatter than {MIN_TRIANGLE_HEIGHT_M * 1e9:.0f} nm), dropped: {{}}."
    DUPLICATES = "Triangles that were there twice, dropped: {}."
    SLIVERS = f"Slivers (over {SLIVER_MIN_LENGTH_OVER_HEIGHT:.0f} times as long as high), used unchanged: {{}}."
    OPEN_EDGES = "The mesh has open rims, as covers have ({} edges); it is used unchanged."
    NON_MANIFOLD = "Edges shared by three or more triangles, across which no taxel is laid: {}."
    COMPONENTS = "Pieces that share no edge: {}."
    WINDING = "Triangles wound against their neighbours, turned: {}."
    TURNED = "Triangles that pointed inward, by the shape of the part, turned: {}."
    ONE_SIDED = "Pieces with one side only, normals as in the file: {}."
    FLAT = "Pieces whose shape does not tell inside from outside, normals as in the file: {}."


@dataclass(frozen=True, slots=True)
class MeshFinding:
    """One finding in a mesh, with what was done about it."""

    kind: FindingKind
    count: int
    sentence: str


def count_finding(kind: FindingKind, count: int) -> MeshFinding:
    """Make a finding that is a count."""
    return MeshFinding(kind, count, kind.value.format(count))


def words_finding(kind: FindingKind, words: str) -> MeshFinding:
    """Make a finding that is described by words."""
    return MeshFinding(kind, 0, kind.value.format(words))


def box_words(sides_mm: Iterable[float]) -> str:
    """Write the sides of a box in mm, the longest first: `"251.7 x 116.2 x 107.6 mm"`."""
    return " x ".join(f"{side:.4g}" for side in sorted(sides_mm, reverse=True)) + " mm"
