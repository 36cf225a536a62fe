"""Import files of instruments as CSV that jobs read. Each format is an entry in FORMATS; most have a module of theirs.

- `lines` (the text of a file with its line numbers) is what every format is given
- tables: `columns`, by a mapping file; `proposed_mapping` guesses one; points: `sa_ascii`
- networks: `gama_xml`, `comp3d`, `lgc2`; image points: `colmap_model`, `metashape_markers`, `vnl`
- `cameras`, as YAML: `camera_fields` (keys of a text) -> `camera_readers` (a program each), `splined_camera`,
  `camera_rigs` (several)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from metrocli.errors import UsageError
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from metrocli.imports.lines import TextLines
    from metrocli.nodes import Node

Imported = Mapping[str, str]
"""Texts of CSV files by name"""


@dataclass(frozen=True)
class ImportFormat:
    """A format that can be read; its module is imported only when it is used."""

    module: str
    summary: str
    source: str
    """Where its layout is published"""
    takes: str = ""
    """The option that it uses: mapping or unit"""
    several: bool = False
    """Whether several files belong together"""


@dataclass(frozen=True)
class ImportOptions:
    """What a format may need besides the file."""

    mapping: Node | None = None
    """Root of the mapping file"""
    unit: str = ""
    """Unit of lengths in a file that does not state it"""
    others: tuple[TextLines, ...] = ()
    """Further files of the same format"""


FORMATS: dict[str, ImportFormat] = {
    "columns": ImportFormat(
        "metrocli.imports.columns",
        "any table, with a file that names column, unit and sign (--map)",
        "docs/imports.md",
        "mapping",
    ),
    **dict.fromkeys(
        ("opencv", "opencv-yaml", "ros", "colmap", "kalibr", "mrcal", "metashape", "matlab"),
        ImportFormat(
            "metrocli.imports.cameras",
            "camera of another program, as the camera file of align-part",
            "OpenCV, camera_calibration; and the manuals of the other programs",
            "unit",
            several=True,
        ),
    ),
    "colmap-model": ImportFormat(
        "metrocli.imports.colmap_model",
        "image points and points of COLMAP: images.txt, points3D.txt (--unit)",
        "colmap.github.io/format.html",
        "unit",
    ),
    "comp3d": ImportFormat(
        "metrocli.imports.comp3d",
        "spatial networks of Comp3D (IGN): observations .obs, points .cor",
        "ignf.github.io/Comp3D/doc, OBS File and COR File",
    ),
    "gama-xml": ImportFormat(
        "metrocli.imports.gama_xml",
        "spatial networks of GNU Gama (gama-local)",
        "GNU Gama manual, XML input data format for gama-local",
    ),
    "lgc2": ImportFormat(
        "metrocli.imports.lgc2",
        "spatial networks of LGC2 (CERN): set-ups with angles and distances",
        "LGC2 user manual (github.com/geodetic-metrology-tools/LGC2)",
    ),
    "metashape-markers": ImportFormat(
        "metrocli.imports.metashape_markers",
        "image points of the markers of Metashape, exported as XML; with --unit also their places",
        "files in public repositories, such as kayze/AfterEffects-to-Metashape",
        "unit",
    ),
    "sa-ascii": ImportFormat(
        "metrocli.imports.sa_ascii",
        "points of SpatialAnalyzer (--unit)",
        "SpatialAnalyzer User Manual, Exporting ASCII Formatted Points",
        "unit",
    ),
    "vnl": ImportFormat(
        "metrocli.imports.vnl",
        "corners found by mrgingham for mrcal",
        "manual page mrgingham(1); github.com/dkogan/vnlog",
    ),
}


def imported(name: str, lines: TextLines, options: ImportOptions) -> Imported:
    """Return the CSV files of a file in a format.

    Raises UsageError for an option that the format does not use, InputError that lists all faults with their rows.
    """
    for field, option in (("mapping", "--map"), ("unit", "--unit")):
        if getattr(options, field) and field != FORMATS[name].takes:
            raise UsageError(f"--from {name} takes no {option}: leave it out")
    if options.others and not FORMATS[name].several:
        raise UsageError(f"--from {name} takes one file")
    files: Callable[[TextLines, ImportOptions], Imported] = import_module(FORMATS[name].module).files
    return files(lines, options)
