"""A simulated measurement written as the files that a real one would have."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from metrocli.formats import csv
from metrocli.formats.aside import written_aside
from metrocli.simulation import Simulation


def write(simulation: Simulation, folder: Path) -> Iterator[Path]:
    """Write tables, images and truth.json into a folder; yield each path once its file is written."""
    for name, table in simulation.files.items():
        csv.write(folder / name, table)
        yield folder / name
    for name, picture in simulation.pictures:
        from metrocli.formats import images

        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        images.write(folder / name, picture())
        yield folder / name
    path = folder / "truth.json"
    with written_aside(path) as aside:
        aside.write_text(json.dumps(dict(simulation.truth), indent=2) + "\n", encoding="utf-8")
    yield path
