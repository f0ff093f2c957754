"""A made-up package of the form of paxini-sdk: a dome of 25 points by a formula, and four in a plane."""

import json

import numpy as np


def dome(rows=5, columns=5, radius=12.0):
    """Points on a sphere, mm, 3 mm apart along it: x across, y along, z outward."""
    x, y = np.meshgrid(3.0 * (np.arange(columns) - columns // 2), 3.0 * (np.arange(rows) - rows // 2))
    arc = np.hypot(x, y).ravel()
    scale = np.where(arc > 0, radius * np.sin(arc / radius) / np.maximum(arc, 1e-9), 1.0)
    return np.stack([x.ravel() * scale, y.ravel() * scale + 9.0, radius * (np.cos(arc / radius) - 1.0)], axis=1), np.stack(
        [x.ravel(), y.ravel()], axis=1
    )


def package_files():
    points = dome()[0]
    registry = [
        {"vendor_part_code": "MADE-UP", "sensor_model": "DOME-25", "n_points": 25, "json_file": "dome.json"},
        {"vendor_part_code": "FLAT-4", "sensor_model": "FLAT", "n_points": 4, "json_file": "flat.json"},
    ]
    flat = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [4.0, 4.0, 0.0]]
    return {
        "registry.json": {"sensors": registry},
        **{
            name: {"points": [{"index": k, "x_mm": x, "y_mm": y, "z_mm": z} for k, (x, y, z) in enumerate(rows, start=1)]}
            for name, rows in (("dome.json", points.tolist()), ("flat.json", flat))
        },
    }


def write_package(folder):
    """Write the package below a folder; return where it is."""
    data = folder / "sdk" / "paxini_sdk" / "data"
    data.mkdir(parents=True)
    for name, content in package_files().items():
        (data / name).write_text(json.dumps(content))
    return folder / "sdk"
