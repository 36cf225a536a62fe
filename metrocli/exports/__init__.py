"""Export results in other formats. Each format is one module here and one entry in FORMATS.

- `csv_errors`: tables; `sa_ascii`: points; `camera_models`, of `expressed_cameras`: cameras
- compensation tables: `error_tables` or `volumetric` (what the measurement determined) -> one module a control ->
  `compensation`, which reads the files back and moves the machine as the control would
- `pivots`: where rotary axes lie
- `dcc`: a certificate, of `dcc_quantities` and `dcc_elements`
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from metrocli.record import Record
    from metrocli.result import Result
    from metrocli.table import Table

Exported = Mapping[str, "Table | str"]
"""Files by name: a table that is written as CSV, or the text of the file"""


@dataclass(frozen=True)
class ExportFormat:
    """Name of the module of a format, and its summary for the help; the module is imported only when it is used."""

    module: str
    summary: str
    recorded: bool = False
    """Whether the files also state what the record of the result holds: job, inputs, certificate"""
    function: str = "files"
    """Name of its function, or of the description of the control that is one"""
    nearest: bool = False
    """Whether it takes the largest difference [px] of a camera that its models can only approach"""


def _of_control(module: str, summary: str) -> ExportFormat:
    return ExportFormat(f"metrocli.exports.{module}", summary, function="CONTROL")


FORMATS: dict[str, ExportFormat] = {
    "csv": ExportFormat("metrocli.exports.csv_errors", "each table of the result, with units in the header"),
    "siemens-lec": _of_control("siemens_lec", "positioning errors for $AA_ENC_COMP"),
    "siemens-cec": _of_control("siemens_cec", "all other errors for $AN_CEC, with multiplied tables"),
    "heidenhain": _of_control("heidenhain", "tables .COM and .CMA"),
    "fanuc": _of_control("fanuc", "increments of pitch error compensation"),
    "linuxcnc": _of_control("linuxcnc", "COMP_FILE of each joint"),
    "isg-csv": _of_control("isg_csv", "volumetric compensation of ISG and Beckhoff"),
    "kinematics": ExportFormat(
        "metrocli.exports.pivots", "lines of rotary axes, with a test move", function="kinematics"
    ),
    "siemens-trafo5": ExportFormat("metrocli.exports.pivots", "5-axis transformation", function="siemens_trafo5"),
    "etalon": _of_control("volumetric", "Etalon exchange format"),
    **{
        name: ExportFormat("metrocli.exports.camera_models", f"camera of {program}", function=name, nearest=True)
        for name, program in (
            ("opencv", "OpenCV (YAML)"),
            ("ros", "ROS (camera_info)"),
            ("colmap", "COLMAP (cameras.txt)"),
            ("kalibr", "Kalibr (camchain)"),
            ("mrcal", "mrcal (cameramodel)"),
            ("metashape", "Metashape (XML)"),
            ("matlab", "MATLAB (cameraIntrinsics)"),
        )
    },
    "opencv-yaml": ExportFormat("metrocli.exports.camera_models", "same as opencv", function="opencv", nearest=True),
    "sa-ascii": ExportFormat("metrocli.exports.sa_ascii", "points for SpatialAnalyzer"),
    "dcc": ExportFormat("metrocli.exports.dcc", "Digital Calibration Certificate of PTB (XML)", recorded=True),
}


def _of_rotary_axes(name: str, files: Callable[..., Exported], result: Result) -> Exported:
    """Return where the rotary axes lie, and the tables of the positioning, as far as the result determines them.

    What the job estimates and the files lack has its reason in a text beside them, or is raised if there are none.
    """
    from metrocli.errors import Fault, InputError
    from metrocli.exports.compensation import has_positioning
    from metrocli.exports.pivots import OF_CONTROLS, wanted

    texts: dict[str, Table | str] = {}
    reasons: list[Fault] = []
    for make, meant in ((OF_CONTROLS[name], wanted(result)), (files, has_positioning(result))):
        try:
            texts |= make(result)
        except InputError as error:
            reasons += [*error.faults] if meant else []
    if not texts:
        raise InputError(reasons or "the result determines no place and no positioning error of a rotary axis")
    lacks = "".join(f"{fault.message}\n" for fault in reasons)
    return texts | ({"not-written.txt": lacks} if lacks else {})


_OF_PIVOTS = ("fanuc", "heidenhain", "linuxcnc")
"""Formats that have the lines of the rotary axes of a machine with such, and their positioning"""
WITHIN = 0.05
"""Largest difference [px] of a camera in a format that can only approach it"""


def export(name: str, result: Result, record: Record | None = None, within: float = WITHIN) -> Exported:
    """Return the files of a result in a format; raises InputError if the result has nothing to export in it.

    Beside the files of a result with doubts, a text states them.
    """
    form = FORMATS[name]
    files: Callable[..., Exported] = getattr(import_module(form.module), form.function)
    doubts = {"doubtful.txt": "\n".join([*result.doubts, ""])} if result.doubts else {}
    if "rotary_axes" in result.tables and name in _OF_PIVOTS:
        return {**_of_rotary_axes(name, files, result), **doubts}
    more = (record,) if form.recorded else (within,) if form.nearest else ()
    return {**files(result, *more), **doubts}
