"""Units of length that a scene, a mesh file or a command names."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

LengthUnit: TypeAlias = Literal["m", "cm", "mm", "in"]
METRES_PER_UNIT: dict[str, float] = dict(zip(get_args(LengthUnit), (1.0, 1e-2, 1e-3, 25.4e-3), strict=True))
"""By `LengthUnit`."""
