"""mrcal's splined model, by mrcal itself: its errors of fit and of held-out images.

It is run by the Python that has mrcal (Debian: python3-mrcal), takes JSON from its standard input and prints JSON:
image size, pitch, corners (images, rows, columns, 2), and the numbers of knots that are tried.
"""

from __future__ import annotations

import json
import sys

import mrcal
import numpy as np

FIELD = 1.15
"""Angle that the knots span, in that of the image"""


def problem(work, corners, lens, intrinsics, frames):
    """Return the arguments of `mrcal.optimize` for some images."""
    count = len(corners)
    weight = np.ones((*corners.shape[:3], 1))
    return {
        "lensmodel": lens,
        "intrinsics": intrinsics,
        "extrinsics_rt_fromref": np.zeros((0, 6)),
        "frames_rt_toref": frames,
        "points": None,
        "observations_board": np.concatenate([corners, weight], axis=-1),
        "indices_frame_camintrinsics_camextrinsics": np.column_stack(
            [np.arange(count), np.zeros(count), -np.ones(count)]
        ).astype(np.int32),
        "observations_point": None,
        "indices_point_camintrinsics_camextrinsics": None,
        "imagersizes": np.array([work["size"]], dtype=np.int32),
        "calobject_warp": np.zeros(2),
        "do_optimize_intrinsics_core": False,
        "do_optimize_intrinsics_distortions": False,
        "do_optimize_extrinsics": False,
        "do_optimize_frames": True,
        "do_optimize_calobject_warp": False,
        "do_apply_outlier_rejection": False,
        "do_apply_regularization": True,
        "calibration_object_spacing": work["pitch"],
        "verbose": False,
    }


def solved(arguments, **changed):
    """Optimise in place; return the residuals of all corners [px], (images, rows, columns, 2)."""
    arguments.update(changed)
    found = mrcal.optimize(**arguments)
    seen = arguments["observations_board"]
    return found["x"][: seen[..., :2].size].reshape(seen[..., :2].shape)


def fitted(work, corners, knots):
    """Return lens model and intrinsics after all steps of mrcal-calibrate-cameras, frames, and the residuals."""
    indices = np.column_stack([np.arange(len(corners)), np.zeros(len(corners))]).astype(np.int32)
    weighted = np.concatenate([corners, np.ones((*corners.shape[:3], 1))], axis=-1)
    intrinsics, _, frames = mrcal.seed_stereographic(
        np.array([work["size"]], dtype=np.int32), work["focal"], indices, weighted, work["pitch"]
    )
    first = problem(work, corners, "LENSMODEL_STEREOGRAPHIC", np.ascontiguousarray(intrinsics[:, :4]), frames)
    solved(first)
    solved(first, do_optimize_intrinsics_core=True)
    nx, ny = knots
    core = first["intrinsics"]
    field = FIELD * 2 * np.degrees(np.arctan(work["size"][0] / 2 / core[0, 0]))
    lens = f"LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={nx}_Ny={ny}_fov_x_deg={field:.0f}"
    start = np.concatenate([core, np.zeros((1, 2 * nx * ny))], axis=1)
    second = problem(work, corners, lens, start, first["frames_rt_toref"])
    left = solved(second, do_optimize_intrinsics_distortions=True)
    return lens, second["intrinsics"], second["frames_rt_toref"], left


def main():
    """Print the root mean squares [px] of the fit, and of images held out one by one, for each number of knots."""
    work = json.load(sys.stdin)
    corners = np.array(work["corners"])
    rows = []
    for knots in work["knots"]:
        lens, _, frames, left = fitted(work, corners, knots)
        errors = []
        for out in range(len(corners)) if work["held_out"] else ():
            intrinsics = fitted(work, np.delete(corners, out, axis=0), knots)[1]
            held = problem(work, corners[[out]], lens, intrinsics, np.ascontiguousarray(frames[[out]]))
            errors.append(solved(held))
        rows.append(
            [float(np.sqrt(np.mean((one**2).sum(axis=-1)))) if len(one) else None for one in (left, np.array(errors))]
        )
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
