"""A calibration as a point cloud that MeshLab, CloudCompare and ParaView open."""

from __future__ import annotations

import math

from skincal.estimate.result import Method
from skincal.files.calibration import Calibration, placed_taxels

METHOD_CODE = {Method.FREE: 0, Method.SURFACE: 1, Method.MODULES: 2}
"""PLY has no text properties."""


def ply_text(calibration: Calibration, method: Method) -> str:
    """Return ASCII PLY: one vertex a taxel with a position, metres, link frame.

    Properties: `x y z`, unit normal `nx ny nz` (0 0 0 where unknown), `channel`, `method` (0 free, 1 surface, 2 modules),
    `sd_mm` (-1 where it is not determined).
    """
    taxels = placed_taxels(calibration.of(method))
    header = [
        "ply",
        "format ascii 1.0",
        f"comment skincal {calibration.version}, {method.value} method, metres, frame {_one_line(calibration.scene.link)}",
        "comment method 0 is free, 1 is surface, 2 is modules; sd_mm -1 is not determined; normal 0 0 0 is not known",
        *(f"comment {one.words}" for one in calibration.corrections),
        f"element vertex {len(taxels.channels)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        "property int channel",
        "property uchar method",
        "property float sd_mm",
        "end_header",
    ]
    rows = [
        f"{_row(position)} {_row(normal)} {channel} {METHOD_CODE[method]} {sd * 1e3 if math.isfinite(sd) else -1.0:.6g}"
        for channel, position, normal, sd in zip(
            taxels.channels.tolist(), taxels.positions.tolist(), taxels.normals.tolist(), taxels.sd.tolist(), strict=True
        )
    ]
    return "\n".join([*header, *rows]) + "\n"


def _row(vector: list[float]) -> str:
    return " ".join(f"{value:.9g}" for value in vector)


def _one_line(text: str) -> str:
    return " ".join(text.split())
