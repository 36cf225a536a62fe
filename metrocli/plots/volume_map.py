"""Maps over the working volume: the volumetric error with its vectors, or the standard uncertainty."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.magnify import in_words, magnification
from metrocli.plots.places import named
from metrocli.plots.style import OUTLINE, SIZES, Canvas, arrows
from metrocli.result import Result
from metrocli.table import Table

ERROR, UNCERTAINTY = "error", "uncertainty"
_LAYERS = 6
"""Most layers that are shown; lowest and highest are always among them"""
_PER_MM = 1e3


@dataclass(frozen=True)
class Layer:
    """The places of one height."""

    z: float
    at: Array
    """(n, 2) mm"""
    size: Array
    """(n,) µm: length of the error, or of the standard uncertainty"""
    vectors: Array | None
    """(n, 2) mm"""


@dataclass(frozen=True)
class VolumeMap:
    """What the figure shows."""

    about: str
    what: str
    layers: tuple[Layer, ...]
    magnification: float
    largest: float
    """mm, over all layers of the volume"""
    largest_at: tuple[float, float, float]
    heights: int


def data(result: Result, about: str) -> VolumeMap | None:
    """Return the map: of errors from a machine or a ball grid, of uncertainty also from report-uncertainty."""
    table = _table(result, about)
    if table is None:
        return None
    what, at, components = table
    size = np.linalg.norm(components, axis=1)
    kept = np.isfinite(size)
    if not kept.any():
        return None
    at, components, size = at[kept], components[kept], size[kept]
    heights = np.unique(at[:, 2].round(6))
    shown = heights[np.unique(np.linspace(0, len(heights) - 1, min(_LAYERS, len(heights))).round().astype(int))]
    extent = float(np.ptp(at[:, :2], axis=0).max())
    factor = magnification(float(np.linalg.norm(components[:, :2], axis=1).max()), extent / 5)
    layers = []
    for z in shown:
        rows = np.flatnonzero(np.isclose(at[:, 2], z, atol=1e-5))
        vectors = components[rows, :2] if about == ERROR else None
        layers.append(Layer(float(z), at[rows, :2], size[rows] * _PER_MM, vectors))
    worst = int(np.argmax(size))
    x, y, height_of_worst = at[worst].tolist()
    return VolumeMap(about, what, tuple(layers), factor, float(size[worst]), (x, y, height_of_worst), len(heights))


def _table(result: Result, about: str) -> tuple[str, Array, Array] | None:
    """Return what is mapped, the places (n, 3) and the components there (n, 3), mm."""
    names = {ERROR: ("ex", "ey", "ez"), UNCERTAINTY: ("s_ex", "s_ey", "s_ez")}[about]
    xyz = ("x", "y", "z")
    volume = result.tables.get("volume")
    if volume is not None and len(volume) and {*xyz, names[0]} <= set(volume):
        first = volume.columns["tool"] == volume.columns["tool"][0]
        own = Table({name: volume.columns[name][first] for name in volume}, volume.units)
        return f"the {named('tool', own.texts('tool')[0])}", own.stacked(xyz), own.stacked(names)
    site, error = result.tables.get("correction"), result.tables.get("machine_error")
    if site is not None and error is not None and len(site) == len(error):
        return "the machine", site.stacked(xyz), error.stacked(names)
    table = result.tables.get("map")
    if about == UNCERTAINTY and table is not None and "u_x" in table:
        return "all contributors", table.stacked(xyz), table.stacked(("u_x", "u_y", "u_z"))
    return None


def _columns(volume: VolumeMap) -> int:
    return min(3, len(volume.layers))


def height(volume: VolumeMap) -> float:
    """Return the height of the figure in inches."""
    columns = _columns(volume)
    wide, high = np.ptp(volume.layers[0].at, axis=0)
    each = float(np.clip(5.0 / columns * high / max(wide, 1e-9), 1.0, 4.0)) + 0.5
    return each * -(-len(volume.layers) // columns) + 0.6


def draw(canvas: Canvas, volume: VolumeMap) -> str:
    """Draw the figure and return its caption."""
    columns = _columns(volume)
    rows = -(-len(volume.layers) // columns)
    panels, bar = canvas.axes_and_bar(rows, columns, len(volume.layers))
    largest = max(float(layer.size.max()) for layer in volume.layers)
    drawn = None
    for axes, layer in zip(panels, volume.layers, strict=True):
        axes.set_aspect("equal")
        axes.set_title(f"z = {layer.z:g} mm", fontsize=8.5)
        drawn = axes.scatter(
            layer.at[:, 0], layer.at[:, 1], c=layer.size, cmap=SIZES, vmin=0, vmax=largest, s=18, zorder=2,
            linewidths=OUTLINE, edgecolors=canvas.theme.muted,
        )  # fmt: skip
        if layer.vectors is not None:
            arrows(axes, layer.at, layer.vectors * volume.magnification, canvas.theme.ink, 0.008)
        axes.margins(0.14)
        axes.locator_params(nbins=4)
    for k, axes in enumerate(panels):
        at_left, at_bottom = k % columns == 0, k + columns >= len(panels)
        axes.set_ylabel("y (mm)" if at_left else "")
        axes.set_xlabel("x (mm)" if at_bottom else "")
        axes.tick_params(labelleft=at_left, labelbottom=at_bottom)
    # short, since the scale of a flat volume is low: the caption has the rest
    canvas.colour_bar(drawn, bar, "error (µm)" if volume.about == ERROR else "u (µm)")
    return _caption(volume)


def _caption(volume: VolumeMap) -> str:
    where = ", ".join(f"{axis} = {value:g}" for axis, value in zip("xyz", volume.largest_at, strict=True))
    parts = [f"For {volume.what}."]
    if volume.about == ERROR:
        factor = in_words(volume.magnification)
        parts.append(f"Arrows: the error in x and y, magnified {factor}; colour: its length in space.")
    else:
        parts.append("Colour: root of the sum of the variances of x, y and z.")
    parts.append(f"The largest is {volume.largest * _PER_MM:.3g} µm at {where} mm.")
    if volume.heights > len(volume.layers):
        parts.append(f"{len(volume.layers)} of {volume.heights} heights are shown.")
    return " ".join(parts)
