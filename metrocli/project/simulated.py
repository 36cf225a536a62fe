"""A simulated measurement written as the files that a real one would have."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from metrocli.formats import csv
from metrocli.formats.file_bytes import atomic_write
from metrocli.formats.own_files import inside
from metrocli.simulation import Simulation

TRUTH = "truth.json"
"""The file in which a simulation states what it assumed"""


def write(simulation: Simulation, folder: Path) -> Iterator[Path]:
    """Write tables, images and truth.json into a folder; yield each path once its file is written.

    Raises InputError, before anything is written, if the name of an image leads out of the folder.
    """
    tables = {inside(folder, name): table for name, table in simulation.files.items()}
    pictures = [(inside(folder, name), picture) for name, picture in simulation.pictures]
    for path, table in tables.items():
        csv.write(path, table)
        yield path
    for path, picture in pictures:
        from metrocli.formats import images

        images.write(path, picture())
        yield path
    path = folder / TRUTH
    with atomic_write(path) as aside:
        aside.write_text(json.dumps(dict(simulation.truth), indent=2) + "\n", encoding="utf-8")
    yield path
