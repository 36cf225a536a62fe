"""Small results whose figures can be worked out by hand."""

from __future__ import annotations

import numpy as np

from metrocli.result import Estimate, Result
from metrocli.table import Table


def camera(uv: np.ndarray, residuals: np.ndarray, sigma: float = 0.1, **columns: np.ndarray) -> Result:
    """A camera result with readings (n, 2) and residuals (n, 2), all with redundancy 1; image 640 x 480, centre (320, 240)."""
    n = len(uv)
    table = {
        "image": np.repeat([f"i{k // 10}" for k in range(n)], 2),
        "target": np.repeat([f"t{k % 10}" for k in range(n)], 2),
        "component": np.tile(["u", "v"], n),
        "reading": uv.ravel(),
        "residual": residuals.ravel(),
        "sigma": np.full(2 * n, sigma),
        "normalised": residuals.ravel() / sigma,
        "redundancy": np.ones(2 * n),
        **{name: np.repeat(values, 2) for name, values in columns.items()},
    }
    units = dict.fromkeys(("reading", "residual", "sigma"), "px")
    estimates = (Estimate("f", 1000.0, 0.2, "px"), Estimate("cx", 320.0, 0.1, "px"), Estimate("cy", 240.0, 0.4, "px"))
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.01, -0.036], [0.0, -0.036, 0.16]])
    statistics = {"image_width": 640, "image_height": 480, "sigma0": 1.0, "dof": 2 * n}
    return Result("calibrate-camera", "Lens", estimates, covariance, statistics, {"residuals": Table(table, units)})


def network() -> Result:
    """Three points and two tracers; the residuals of the lengths are known."""
    points = Table(
        {
            "point": np.array(["A", "B", "C"]),
            "x": np.array([0.0, 100.0, 0.0]), "y": np.array([0.0, 0.0, 200.0]), "z": np.zeros(3),
            "sx": np.full(3, 1e-3), "sy": np.full(3, 2e-3), "sz": np.full(3, 3e-3),
            "error_x": np.array([0.0, 0.003, 0.0]), "error_y": np.array([0.001, 0.004, 0.0]), "error_z": np.zeros(3),
        },
        dict.fromkeys(("x", "y", "z", "sx", "sy", "sz", "error_x", "error_y", "error_z"), "mm"),
    )  # fmt: skip
    tracers = Table(
        {
            "tracer": np.array(["L1", "L2"]),
            "x": np.array([-100.0, 0.0]),
            "y": np.array([0.0, -100.0]),
            "z": np.zeros(2),
        },
        dict.fromkeys("xyz", "mm"),
    )
    residual = np.array([0.001, 0.002, -0.003, 0.0, 0.0, 0.004])
    residuals = Table(
        {
            "point": np.repeat(["A", "B", "C"], 2), "tracer": np.tile(["L1", "L2"], 3),
            "reading": np.arange(6.0), "residual": residual, "sigma": np.full(6, 0.001),
            "normalised": residual / 0.001, "redundancy": np.full(6, 0.5), "t": np.arange(6.0) * 10,
        },
        {"reading": "mm", "residual": "mm", "sigma": "mm", "t": "s"},
    )  # fmt: skip
    estimates = (Estimate("L1.x", -100.0, 0.01, "mm"),)
    tables = {"points": points, "tracers": tracers, "residuals": residuals}
    return Result("multilaterate", "Net", estimates, np.array([[1e-4]]), {"sigma0": 1.0, "dof": 3}, tables)


def machine() -> Result:
    """A machine with two tables, one of them undetermined, and its error on a grid of two heights."""
    curve = {"position": np.array([0.0, 100.0])}
    tables = {
        "tables/EXX": Table({**curve, "value": np.array([0.0, 0.02]), "std": np.array([0.0, 1e-3])}, dict.fromkeys(("position", "value", "std"), "mm")),
        "tables/ECX": Table({**curve, "value": np.full(2, np.nan), "std": np.full(2, np.inf)}, {"position": "mm", "value": "rad", "std": "rad"}),
        "errors": Table({"error": np.array(["EXX", "ECX"]), "status": np.array(["determined", "undetermined"])}),
    }  # fmt: skip
    grid = np.array([[x, y, z] for z in (0.0, 50.0) for y in (0.0, 40.0) for x in (0.0, 100.0)])
    error = np.stack([grid[:, 0] * 2e-4, np.zeros(8), grid[:, 2] * 3e-4], axis=1)
    columns = {"tool": np.full(8, "T1"), **dict(zip("xyz", grid.T, strict=True))}
    columns |= dict(zip(("ex", "ey", "ez"), error.T, strict=True))
    columns |= {name: np.full(8, size) for name, size in (("s_ex", 2e-3), ("s_ey", 3e-3), ("s_ez", 6e-3))}
    tables["volume"] = Table(columns, dict.fromkeys(("x", "y", "z", "ex", "ey", "ez", "s_ex", "s_ey", "s_ez"), "mm"))
    estimates = (Estimate("C0Y", 1e-5, 2e-6, "rad"),)
    return Result("calibrate-machine", "Mill", estimates, np.array([[4e-12]]), {"sigma0": 1.0, "dof": 8}, tables)


def raw_part() -> Result:
    """A raw part with two surfaces and a chip on one of them."""
    lengths = {"least": [1.5, 0.6], "s_least": [0.01, 0.02], "mean": [2.0, 1.0], "largest": [2.5, 1.5]}
    names = {"surface": np.array(["side", "top"]), "least_at": np.array(["P3", "P9"])}
    surfaces = Table(
        {**names, **{name: np.array(values) for name, values in lengths.items()}}, dict.fromkeys(lengths, "mm")
    )
    rejected = Table({"surface": np.array(["side"]), "overstock": np.array([-3.0])}, {"overstock": "mm"})
    tables = {"surfaces": surfaces, "rejected": rejected}
    return Result("fit-part", "Casting", (Estimate("x", 1.0, 0.1, "mm"),), np.array([[0.01]]), {"minimum": 0.5}, tables)


def budget() -> Result:
    """A measurand with three contributors and a tolerance."""
    table = Table(
        {
            "measurand": np.array(["l"] * 4), "contributor": np.array(["small", "none", "large", "middle"]),
            "share": np.array([10.0, 0.0, 60.0, 30.0]),
        },
        {"share": "percent"},
    )  # fmt: skip
    decision = {"limits": [49.999, 50.001], "acceptance": [49.9992, 50.0008], "zone": "conforming"}
    details = {"l": {"U": 2e-4, "k": 2.0, "tolerance": decision}}
    return Result(
        "report-uncertainty", "Block", (Estimate("l", 50.0005, 1e-4, "mm"),), np.array([[1e-8]]), {},
        {"budget": table}, details=details,
    )  # fmt: skip


def instruments() -> Result:
    """Two stations of two instruments: S1 of A reads azimuths with w = -1, 1, 3, S2 of B distances with w = 2, 2."""
    residuals = Table(
        {
            "station": np.array(["S1"] * 3 + ["S2"] * 2),
            "quantity": np.array(["az"] * 3 + ["d"] * 2),
            "residual": np.zeros(5),
            "normalised": np.array([-1.0, 1.0, 3.0, 2.0, 2.0]),
        }
    )
    stations = Table(
        {"station": np.array(["S1", "S2"]), "instrument": np.array(["A", "B"]), **dict.fromkeys("xyz", np.arange(2.0))}
    )
    faces = {"station": np.array(["S1", "S1", "S2"]), "point": np.array(["P", "Q", "P"])}
    halves = {"azimuth": np.array([0.002, 0.004, np.nan]), "elevation": np.zeros(3), "distance": np.full(3, np.nan)}
    tables = {"residuals": residuals, "stations": stations, "two_face": Table({**faces, **halves})}
    return Result("adjust-network", "Hall", (), np.zeros((0, 0)), {}, tables)
