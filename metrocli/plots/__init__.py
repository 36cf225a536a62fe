"""Figures of results. Each figure is one module here and one entry in FIGURES; only this package loads matplotlib.

A figure has `data(result)`, plain values, and `draw(canvas, data)`. `readings` gives the residuals of any result
in one form, `places` its points; `noise_bands` has what pure noise may do, `magnify` what is left out, `style` the
look. Those in `context` show a result in its context: its diagnosis, an earlier result, its lineage.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrocli.errors import UsageError
from metrocli.frozen import dataclass
from metrocli.plots.context import ALONE, ResultContext
from metrocli.words import suggestion

if TYPE_CHECKING:
    from metrocli.plots.style import Canvas
    from metrocli.result import Result

FORMS = ("svg", "pdf", "png")
"""Formats of files, by their ending"""


@dataclass(frozen=True)
class FigureEntry:
    """Module of a figure, and what of it is shown; the module is imported only when it is used."""

    module: str
    summary: str
    about: str = ""
    in_context: bool = False
    """Whether it shows the result in its context"""


FIGURES: dict[str, FigureEntry] = {
    "scene": FigureEntry("scene", "3-D view of the measurement"),
    "residuals": FigureEntry("against", "normalised residuals in the order of the readings", "order"),
    "residuals-radius": FigureEntry("against", "normalised residuals against the radius in the image", "radius"),
    "residuals-time": FigureEntry("against", "normalised residuals against time", "time"),
    "residuals-temperature": FigureEntry("against", "normalised residuals against temperature", "temperature"),
    "residuals-length": FigureEntry("against", "normalised residuals against the length", "length"),
    "residuals-x": FigureEntry("against", "normalised residuals against x", "x"),
    "residuals-y": FigureEntry("against", "normalised residuals against y", "y"),
    "residuals-z": FigureEntry("against", "normalised residuals against z", "z"),
    "residuals-image": FigureEntry("images.vectors", "residual vectors over the image"),
    "residuals-part": FigureEntry("part_vectors", "residuals over the part"),
    "residuals-instrument": FigureEntry("instruments", "normalised residuals by instrument and quantity", "residuals"),
    "two-face": FigureEntry("instruments", "differences of the two faces by station", "faces"),
    "before-after": FigureEntry(
        "context.before_after", "normalised residuals before and after the model was extended", in_context=True
    ),
    "law": FigureEntry(
        "context.law", "law that the diagnosis found, with the readings in which it found it", in_context=True
    ),
    "held-out": FigureEntry(
        "context.held_out", "gain of what the diagnosis found, in each held-out part", in_context=True
    ),
    "normal-plot": FigureEntry("normal_plot", "normal plot of the normalised residuals"),
    "coverage": FigureEntry("images.coverage", "coverage of the image by readings"),
    "projection-error": FigureEntry("images.projection_error", "expected projection error over the image"),
    "lens-difference": FigureEntry(
        "context.lens_difference", "difference of two cameras over the image, after the best rotation", in_context=True
    ),
    "error-curves": FigureEntry("error_curves", "errors of a machine over its axes (actual minus commanded)"),
    "positioning": FigureEntry("positioning", "positioning of the axes by ISO 230-2"),
    "volumetric-error": FigureEntry("volume_map", "error of the machine over the volume", "error"),
    "uncertainty-map": FigureEntry("volume_map", "standard uncertainty over the volume", "uncertainty"),
    "overstock": FigureEntry("overstock", "overstock of the surfaces of a raw part"),
    "budget": FigureEntry("budgets.contributors", "uncertainty budget as a Pareto chart"),
    "trials": FigureEntry("budgets.trials", "Monte Carlo trials with the coverage intervals of both methods"),
    "conformity": FigureEntry("budgets.conformity", "values against tolerance and guard band"),
    "correlation": FigureEntry("correlation", "correlation matrix of the estimates"),
    "lineage": FigureEntry("context.lineage", "files and jobs that the result was made from", in_context=True),
}
"""All figures, in the order in which a page shows them"""
_NEEDS = {
    "before-after": "the result of the job without the extension, with the same readings (--before)",
    "lens-difference": "another result of calibrate-camera with a camera of this name and image size (--before)",
    "law": "a diagnosis of this job that found a law (--diagnosis)",
    "held-out": "a diagnosis of this job that found something (--diagnosis)",
    "lineage": "a record of files that it was made from",
}
"""What a figure needs beside the result"""


def data_of(name: str, result: Result, context: ResultContext = ALONE) -> Any:
    """Return the data of a figure, or None if the result, in its context, cannot show it."""
    entry = FIGURES[name]
    module = import_module(f"metrocli.plots.{entry.module}")
    return module.data(result, context if entry.in_context else entry.about)


def names_of(result: Result, context: ResultContext = ALONE) -> list[str]:
    """Return the names of the figures that a result can show."""
    return [name for name in FIGURES if data_of(name, result, context) is not None]


@contextmanager
def drawn(name: str, data: Any, dark: bool = False) -> Iterator[tuple[Canvas, str]]:
    """Yield a figure with its title, and its caption, which states what is shown, in what unit and magnification."""
    from metrocli.plots import style

    entry = FIGURES[name]
    module = import_module(f"metrocli.plots.{entry.module}")
    with style.canvas(name, module.height(data), style.DARK if dark else style.LIGHT) as canvas:
        caption: str = module.draw(canvas, data)
        yield canvas, caption


def title_of(name: str) -> str:
    """Return the title of a figure: its summary with a capital letter."""
    summary = FIGURES[name].summary
    return f"{summary[0].upper()}{summary[1:]}"


def check(result: Result, name: str, path: Path, context: ResultContext = ALONE) -> None:
    """Raise UsageError if a result has no such figure, or if the ending of the file is not svg, pdf or png."""
    if path.suffix.lower().removeprefix(".") not in FORMS:
        raise UsageError(f"--save {path}: the name of a figure ends in .svg, .pdf or .png")
    if name not in FIGURES or data_of(name, result, context) is None:
        needs = f"it needs {_NEEDS[name]}; " if name in _NEEDS else ""
        others = suggestion(name, names_of(result, context))
        raise UsageError(f"this result of {result.kind} has no figure '{name}'; {needs}{others}")


def save(
    result: Result, name: str, path: Path, ending: str, dark: bool = False, context: ResultContext = ALONE
) -> None:
    """Write a figure that `check` accepts, with title and caption, in the format of an ending such as ".svg"."""
    from metrocli.plots import style

    with drawn(name, data_of(name, result, context), dark) as (canvas, caption):
        style.arrange(canvas, title_of(name), caption)
        style.write(canvas, path, ending.lower().removeprefix("."))
