#!/usr/bin/env bash
# haptix 0.2.0 drops tactile channels from a table without a message: untouched taxels, and a BioTac's temperature.
#
# haptix converts recordings of tactile sensors to one format. Its README promises raw data that is "preserved verbatim"; the
# reader of capacitive arrays says that each column is a taxel. Expected: as many channels as the table has, in its order. Seen:
# a taxel that no one touched in a recording, or that is dead, has a constant column and is left out. All taxels behind it move
# up by one, so two recordings of one skin have different taxels at one index. In a BioTac table whose first column is TDC, the
# temperature, that column is taken for the time because its name begins with "t". No names of columns come with the array.
# Remedy: compare the array's width with the table's; put another column (E1) first in tables of a BioTac.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check haptix==0.2.0 numpy==2.4.6
cat > try.py <<'P'
import csv
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from haptix import get_sensor
from haptix.core import InteractionMeta, Labels

FRAMES = 4
ABOUT = {"interaction": InteractionMeta(type="pressing"), "labels": Labels()}


def write(path: Path, names: list[str], rows: np.ndarray) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([names, *rows.tolist()])


def seen_channels(kind: str, place: Path, rows: np.ndarray) -> list[int]:
    """Columns of the table that the array holds, in the array's order."""
    array = get_sensor(kind).load(place, **ABOUT).raw.array
    return [int(np.flatnonzero((rows == column[:, None]).all(axis=0))[0]) for column in array.T]


print("haptix", version("haptix"))
# A skin of six taxels. Taxel 2 is not touched; each other one has values of its own.
taxels = np.arange(FRAMES)[:, None] * 10.0 + np.arange(6)
taxels[:, 2] = 0.0
skin = Path("skin")
skin.mkdir()
write(skin / "Flat_Real_Abaqus.csv", [f"taxel_{k}" for k in range(6)], taxels)
found_taxels = seen_channels("CoroCapacitive", skin, taxels)
print("skin: the table has taxels  [0, 1, 2, 3, 4, 5], taxel 2 untouched; the array has", found_taxels)

names = ["TDC", "TAC", "PDC", "PAC", *(f"E{k}" for k in range(1, 20))]
readings = np.arange(FRAMES)[:, None] * 100.0 + np.arange(len(names))
write(Path("biotac.csv"), names, readings)
found_channels = [names[k] for k in seen_channels("BioTac", Path("biotac.csv"), readings)]
print(f"BioTac: the table has {len(names)} channels; the array has {len(found_channels)}, without", set(names) - set(found_channels))
seen = found_taxels == [0, 1, 3, 4, 5] and found_channels == names[1:]
print("behaviour: channels are lost" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py
