"""Networks of GNU Gama against its own results: how far adjusted coordinates and their standard deviations differ.

    python -m benchmarks gama FOLDER     # NAME.gkf (input of gama-local) beside NAME.xml (its --xml output)

Where Gama scales its standard deviations by the variance factor, those of metrocli are scaled by it too.
No file of Gama is part of the project.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from metrocli.formats import hdf5
from metrocli.result import Result

Element = ElementTree.Element
JOB = """\
metrocli: 1
job: adjust-network
instruments: {TS1: {type: total-station}}
output: result.h5
inputs: {INPUTS}
ranges: {x: 9000 km, y: 9000 km}
"""
DOUBTFUL = 6
"""Exit code of a result whose residuals are larger than the declared noise"""
TOWARDS = {"e": (0, 1), "w": (0, -1), "n": (1, 1), "s": (1, -1)}


def tree(path: Path) -> Element:
    """Return a file with the names of its elements without their namespace."""
    root = ElementTree.parse(path).getroot()
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def metrocli(*words: object) -> None:
    """Run a command; raises RuntimeError with the first line of its errors."""
    ran = subprocess.run(
        [sys.executable, "-m", "metrocli", *map(str, words)], capture_output=True, text=True, check=False
    )
    if ran.returncode not in (0, DOUBTFUL):
        lines = [line for line in ran.stderr.splitlines() if line.strip()]
        raise RuntimeError(f"exit {ran.returncode}: {' '.join(lines[:3])}")


def adjusted(network: Path, folder: Path) -> Result:
    """Return our adjustment of a network: its constrained points take the datum."""
    metrocli("import", network, "--from", "gama-xml", "--out", folder)
    points = tree(network).iter("point")
    datum = [point.get("id") for point in points if any(letter in point.get("adj", "") for letter in "XYZ")]
    inputs = ", ".join(f"{path.stem}: {path.name}" for path in sorted(folder.glob("*.csv")))
    more = f"datum_points: {datum}\n" if datum else ""
    (folder / "job.yaml").write_text(JOB.replace("INPUTS", inputs) + more)
    metrocli("adjust-network", folder / "job.yaml")
    return hdf5.read(folder / "result.h5")[0]


def compared(network: Path, folder: Path) -> str:
    """Return degrees of freedom, sums of squares and the largest differences, in words."""
    ours, theirs = adjusted(network, folder), tree(network.with_suffix(".xml"))
    number = {
        name: float(theirs.findtext(f".//{name}", "nan"))
        for name in ("apriori", "degrees-of-freedom", "sum-of-squares")
    }
    squares, dof = ours.statistics["chi2"] * number["apriori"] ** 2, ours.statistics["dof"]
    scale = (ours.statistics["chi2"] / dof) ** 0.5 if theirs.findtext(".//used") == "aposteriori" and dof else 1.0
    axes = theirs.find("network-general-parameters").get("axes-xy")  # type: ignore[union-attr]
    table = ours.tables["points"]
    places, spreads, names = table.stacked("xyz"), table.stacked(["sx", "sy", "sz"]), table.texts("point")
    off, rows = [], []
    for point in theirs.iterfind(".//adjusted/point"):
        row = names.index(point.findtext("id", "").strip())
        for value in point:
            if value.tag.lower() in ("x", "y", "z"):
                column, sign = (2, 1) if value.tag in "zZ" else TOWARDS[axes["xyXY".index(value.tag) % 2]]
                off.append(places[row, column] * sign - float(value.text or "nan") * 1000)
                rows.append(spreads[row, column] * scale)
    return (
        f"dof {dof:.0f} of {number['degrees-of-freedom']:.0f}, "
        f"squares {squares:.8g} of {number['sum-of-squares']:.8g}, "
        f"{len(off)} coordinates within {np.abs(off).max():.2g} mm, "
        f"standard deviations {_of_spreads(theirs, np.array(rows))}"
    )


def _of_spreads(theirs: Element, ours: np.ndarray) -> str:
    """Return the largest relative difference of standard deviations; the matrix stands as upper rows of its band."""
    band, size = (int(theirs.findtext(f".//cov-mat/{name}", "0")) for name in ("band", "dim"))
    values = [float(value.text or "nan") for value in theirs.iterfind(".//cov-mat/flt")]
    starts = np.cumsum([0, *(min(band + 1, size - row) for row in range(size - 1))])
    count = min(len(ours), int((starts < len(values)).sum()))
    if not count:
        return "not given"
    spreads = np.sqrt(np.array(values)[starts[:count]])
    return f"of {count} within {np.abs(ours[:count] / spreads - 1).max():.1g}"


def main(folder: Path) -> None:
    """Compare the networks of a folder, those with results; print what is refused with the reason."""
    for network in sorted(folder.glob("*.gkf")):
        if network.with_suffix(".xml").exists():
            with tempfile.TemporaryDirectory() as scratch:
                try:
                    print(f"{network.stem}: {compared(network, Path(scratch))}", flush=True)
                except RuntimeError as error:
                    print(f"{network.stem}: {error}", flush=True)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        print("no folder with files of GNU Gama is given: python -m benchmarks gama FOLDER")
    else:
        main(Path(sys.argv[1]))
