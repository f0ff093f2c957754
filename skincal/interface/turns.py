"""Turns of the taxels of a session, for scripts and notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.axes.module_axes import AxisFindings, ModulePlan, find_axes
from skincal.axes.skin_turns import SkinTurns
from skincal.geometry import FloatArray, fit_rotation
from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.model.skin import Layout, Module
    from skincal.session.session import Session
    from skincal.taxels.result import Estimate

MIN_TAXELS_OF_PLAN = 3
"""Taxels with a position from which the turn of a module's plan is known."""


def turns_of_session(session: Session, estimates: Sequence[Estimate]) -> tuple[SkinTurns, AxisFindings]:
    """Find the turns of a session's taxels, and what they say of modules and of the scene.

    Raises InputError: the skin has one axis, or no poke has a reading.
    """
    scene = session.scene
    if scene.skin.axes is None:
        raise InputError(f"{scene.path}: the turn of a taxel needs its three axes; set axes = 3 in [skin].")
    turns = session.snapshot().turns
    if turns is None or not turns.skin.taxels:
        raise InputError(f"{scene.path}: no accepted poke has a reading of three axes; poke the skin first.")
    plans = () if scene.skin.layout is None else _module_plans(scene.skin.layout, estimates)
    return turns.skin, find_axes(turns.skin, plans, modules=list(turns.modules.values()))


def _module_plans(layout: Layout, estimates: Sequence[Estimate]) -> list[ModulePlan]:
    by_channel = {
        each.channel: (each.position, each.normal)
        for each in estimates
        if each.position is not None and each.normal is not None
    }
    return [
        ModulePlan(module.id, tuple(module.channels.tolist()), _plan_rotation(module, by_channel)) for module in layout.modules
    ]


def _plan_rotation(module: Module, by_channel: dict[int, tuple[FloatArray, FloatArray]]) -> FloatArray | None:
    """Fit the rotation (3, 3) from the plan of a module to its estimated taxels; `None` if they do not determine it."""
    pads = module.kind.pads[~np.isnan(module.kind.pads[:, 0])] * np.array([-1.0 if module.mirror else 1.0, 1.0])
    known = [
        (pad, by_channel[channel]) for pad, channel in zip(pads, module.channels.tolist(), strict=True) if channel in by_channel
    ]
    if len(known) < MIN_TAXELS_OF_PLAN:
        return None
    flat = np.array([[*pad, 0.0] for pad, _ in known])
    places = np.array([place for _, (place, _) in known])
    normal = np.array([each for _, (_, each) in known]).sum(axis=0)
    size = float(np.abs(flat - flat.mean(axis=0)).max())
    # The side is that of the normals.
    flat = np.concatenate([flat - flat.mean(axis=0), [[0.0, 0.0, size]]])
    places = np.concatenate([places - places.mean(axis=0), [size * normal / np.linalg.norm(normal)]])
    products = flat.T @ places
    if np.linalg.svd(products, compute_uv=False)[1] < 0.01 * size**2:
        return None
    return np.ascontiguousarray(fit_rotation(products).T)
