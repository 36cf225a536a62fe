"""The hints of the program: for each an input that provokes it, and a similar one in which it must not appear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hints.bases import STATIONS, axis_alone, board, budget, charuco, fisheye, part, points_at_rest, two_cameras
from hints.edits import Edit, by, cells, exchanged, first, more, put, reordered, rows, then, times, whole, without
from tasks.shared.images import small_jobs

DONE = "status: done"


@dataclass(frozen=True)
class Row:
    """One hint, as it stands in the code with {} for what is filled in."""

    hint: str
    base: str
    """A sample project, or files of BASES"""
    command: str
    provoked: dict[str, Edit]
    similar: dict[str, Edit]
    instead: str
    """What is shown for the similar input"""
    shows: str = ""
    """What is filled in"""
    slow: bool = False


BASES: dict[str, dict[str, str] | Callable[[Path], object]] = {
    "board": board(), "stations": STATIONS, "budget": {"job.yaml": budget("a + b*0")}, "fisheye": fisheye(), "relief": board(relief=15.0),
    "two-cameras": two_cameras(), "part": part(), "at-rest": points_at_rest(), "charuco": charuco,
    "axis-alone": axis_alone(), "align": small_jobs.align, "network": small_jobs.network, "nothing": {},
}  # fmt: skip

FIT = "fit-points jobs/fit.yaml"
HALL = "multilaterate jobs/hall.yaml"
NETWORK = "adjust-network jobs/hall.yaml"
CUBE = "selfcal-grid jobs/views.yaml"
TIP = "multilaterate jobs/tip3.yaml"
AXES = "calibrate-machine jobs/after.yaml"
MEASURED, POINTS, LENGTHS, VIEWS = "data/measured.csv", "data/points.csv", "data/lengths.csv", "data/views.csv"

NAMES = [
    Row(
        "did you mean '{}'?",
        "best-fit",
        FIT,
        {"jobs/fit.yaml": put("nominal:", "nominel:")},
        {"jobs/fit.yaml": put("nominal:", "drawing:")},
        "allowed: ",
        "'nominal'",
    ),
    Row(
        "did you mean '{}'?",
        "laboratory-effects",
        HALL,
        {LENGTHS: put("P28,LT1", "p28,LT1")},
        {LENGTHS: put("P28,LT1", "P99,LT1")},
        "'P99' is not in",
        "'P28'",
    ),
    Row(
        "did you mean '{}'?",
        "best-fit",
        FIT,
        {"jobs/fit.yaml": put("measured.csv", "mesured.csv")},
        {"jobs/fit.yaml": put("measured.csv", "tracker.csv")},
        "no such file",
        "'measured.csv'",
    ),
    Row(
        "did you mean '{}'?",
        "gear-m3d3",
        TIP,
        {"jobs/tip3.yaml": put("{sigma0:", "{sigma_0:")},
        {"jobs/tip3.yaml": put('{sigma0: ["> 0.8", "< 1.2"]}', "{LT9.x: '< 1 m'}")},
        "no value 'LT9.x'",
        "'sigma0'",
    ),
    Row(
        "did you mean '{}'?",
        "gear-m3d3",
        TIP,
        {"jobs/tip3.yaml": more("effects: [{name: tracer-scales}]")},
        {"jobs/tip3.yaml": more("effects: [{name: earthquake}]")},
        "unknown effect 'earthquake'",
        "'tracer-scale'",
    ),
    Row(
        "did you mean '{}'?",
        "best-fit",
        FIT,
        {"jobs/fit.yaml": more("noise: 5 Mm")},
        {"jobs/fit.yaml": more("noise: 5 kmm")},
        "allowed: mm",
        "'mm'",
    ),
    Row(
        "did you mean '{}'?",
        "gauge-block",
        "check jobs/gum.yaml",
        {"jobs/gum.yaml": put("unit: mm}", "unit: millimetre}")},
        {"jobs/gum.yaml": put("unit: mm}", "unit: Nmm}")},
        "see docs/conventions.md",
        "'mm'",
    ),
    Row(
        "it is a key of '{}': {}",
        "board",
        "calibrate-camera job.yaml",
        {"job.yaml": more("pixel_size: 6 um")},
        {"job.yaml": more("pixel_sizes: 6 um")},
        "unknown key 'pixel_sizes'",
        "camera.pixel_size",
    ),
    Row(
        "is it the column '{}'?",
        "best-fit",
        FIT,
        {MEASURED: put("point,", "points,")},
        {MEASURED: without("point")},
        "the column 'point' is missing",
        "'points'",
    ),
    Row(
        "is it the column '{}'?",
        "laboratory-effects",
        HALL,
        {POINTS: put("z_mm", "Z")},
        {POINTS: without("z_mm")},
        "the column 'z_mm' is missing",
        "'Z'",
    ),
    Row(
        "; did you mean '{}'?",
        "best-fit",
        FIT,
        {MEASURED: put("sigma_mm", "sigmas_um")},
        {MEASURED: put("sigma_mm", "remark")},
        "the column 'remark' is not used",
        "'sigma_um'",
    ),
    Row(
        "; are these one point each: {}?",
        "best-fit",
        FIT,
        {MEASURED: by("^P", "p0")},
        {MEASURED: first(2)},
        "2 points are in both lists",
        "'p01' and 'P1'",
    ),
]

FILES = [
    Row("is there a decimal comma? write 0.1, not 0,1", "best-fit", FIT, {MEASURED: by(r"(\d)\.(\d)", r"\1,\2")},
        {MEASURED: put("P1,", "P1,A,")}, "cells in this row: 6"),
    Row("this is not the header, which is line {}", "best-fit", FIT, {MEASURED: lambda text: "AT960\n" + text.split("\n", 1)[1]},
        {MEASURED: put("P1,", "P1,A,")}, "cells in this row: 6", "line 2"),
    Row("keep the columns that a job reads; is it a table with rows and columns exchanged?", "best-fit", FIT,
        {MEASURED: whole("point," + ",".join(f"P{n}" for n in range(5001)) + "\nx_mm" + ",1.0" * 5001 + "\n")},
        {MEASURED: put("sigma_mm", "sigma_mm,remark,status,operator")}, "columns in the header: 8"),
    Row("is it an overload marker of the instrument? leave the row out", "laboratory-effects", HALL,
        {LENGTHS: put("1118.478923", "9.9e37")}, {LENGTHS: put("1118.478923", "11184789230")}, "if it is right, allow it in the job"),
]  # fmt: skip

LENGTHS_OF_TRACERS = [
    Row("they fit with the other sign: lengths grow with the distance", "laboratory-effects", HALL,
        {LENGTHS: times(-1, "length_mm", only="LT1")}, {LENGTHS: reordered("length_mm", "LT1", sorted)}, "do not belong to these points"),
    Row("they fit if they are multiplied by {}, as {} are: check the units of both files", "laboratory-effects", HALL,
        {LENGTHS: times(1e-3, "length_mm", only="LT1")}, {LENGTHS: reordered("length_mm", "LT1", sorted)}, "do not belong to these points", "1000, as numbers in m under a heading in mm are"),
    Row("they fit in the reverse order of its rows", "laboratory-effects", HALL,
        {LENGTHS: reordered("length_mm", "LT1", lambda old: old[::-1])}, {LENGTHS: reordered("length_mm", "LT1", sorted)}, "do not belong to these points"),
    Row("they fit if they are moved {} by one of its rows", "laboratory-effects", HALL,
        {LENGTHS: reordered("length_mm", "LT1", lambda old: [*old[1:], old[0]])}, {LENGTHS: reordered("length_mm", "LT1", sorted)},
        "no other unit, sign or order", "down"),
    Row("all lengths are equal: is this the right column?", "laboratory-effects", HALL,
        {LENGTHS: cells("length_mm", lambda _: 1000.0)}, {LENGTHS: reordered("length_mm", "LT1", sorted)}, "do not belong to these points"),
    Row("all lengths are equal: is this the right column?", "stations", "multilaterate job.yaml",
        {"lengths.csv": cells("length_mm", lambda _: 1000.0)}, {"lengths.csv": put("999.8", "1000.1")}, DONE),
    Row("are axes and signs of both lists the same?", "laboratory-effects", HALL,
        {"data/tracers.csv": times(-1, "x_mm", "y_mm", "z_mm")}, {"data/tracers.csv": put("LT1,-499.5", "LT1,-3499.5")}, "correct these places", slow=True),
]  # fmt: skip

FITS = [
    Row("the measured points are a mirror image of the nominal ones: mirrored, they fit to {} mm (root mean square), and to {} mm as they are",
        "best-fit", FIT, {MEASURED: times(-1, "y_mm")}, {MEASURED: then(times(-1, "y_mm"), times(-1, "x_mm"))}, DONE),
    Row("points {} and {} are exchanged in one of the lists", "best-fit", FIT, {MEASURED: exchanged("point", "P2", "P5")},
        {MEASURED: put("P2,-931.838", "P2,-831.838")}, "P2", "P5 and P2", slow=True),
]  # fmt: skip

GRID = [
    Row("the balls{} are read {} mm apart, the pitch is {} mm: is the pitch or a unit of the file wrong?", "ball-cube", CUBE,
        {"jobs/views.yaml": put("pitch: 65 mm", "pitch: 32.5 mm")}, {"jobs/views.yaml": put("pitch: 65 mm", "pitch: 65.1 mm")}, DONE, slow=True),
    Row("{} are exchanged: the readings fit the balls the other way round", "ball-cube", CUBE, {VIEWS: put("view,i,j,k", "view,j,i,k")},
        {VIEWS: put("1,-2,-2,-1", "1,-2,-1,-2")}, "where ball (-2, -2, -1) stands", "i and j", slow=True),
    Row("{} {}: the readings fit balls of the opposite sign", "ball-cube", CUBE, {VIEWS: times(-1, "z_mm")},
        {VIEWS: times(1.0001, "z_mm")}, DONE, "z", slow=True),
    Row("views '{}' and '{}' are exchanged", "ball-cube", CUBE, {VIEWS: exchanged("view", "1", "2")},
        {VIEWS: cells("view", lambda name: "1" if name == "2" else name)}, "may have readings of two set-ups", slow=True),
    Row("; is the sense of its rotation wrong?", "ball-cube", CUBE, {"jobs/views.yaml": put("axis: z, angle: 90", "axis: z, angle: -90")},
        {"jobs/views.yaml": put("axis: z, angle: 90", "axis: z, angle: 180")}, "stands turned", slow=True),
]  # fmt: skip

ROTARY = [
    Row("is it in degrees? then write `{}_deg`", "five-axis", AXES, {"data/after.csv": then(times(0.1, "a_deg"), put("a_deg", "a_rad"))},
        {"data/after.csv": put("-32.546", "-132.546")}, "give a a wider range", "`a_deg`"),
    Row("are they in {}? then write `{}_{}`", "axis-alone", "calibrate-machine job.yaml", {"lines.csv": times(0.0174532925, "c_deg")},
        {"lines.csv": times(0.25, "c_deg")}, "no reading is near", "`c_rad`"),
    Row("{} {} in {}", "five-axis", f"{AXES} --set estimate=rotary", {"data/after.csv": then(times(0.0174532925, "a_deg", "c_deg"))},
        {"data/after.csv": times(0.3, "c_deg")}, "no reading is near", "a_deg and c_deg are in rad"),
    Row("{} and {} are exchanged: the probe finds each at the listed place of the other", "five-axis", AXES,
        {"data/balls.csv": exchanged("ball", "K1", "K3")}, {"data/after.csv": put("K1,47.0733", "K2,47.0733")}, "the probe is at K1, not at K2", "K3 and K1"),
    Row("is the name of the ball right?", "five-axis", AXES, {"data/after.csv": put("K1,47.0733", "K2,47.0733")},
        {"data/after.csv": put("K1,47.0733", "K1,47.1733")}, "K1", "the probe is at K1, not at K2", slow=True),
    Row("{} is {} from that of the job: is `at` right?", "five-axis", AXES, {"jobs/after.yaml": put("at: [0 mm, 12 mm", "at: [0 mm, 15 mm")},
        {"jobs/after.yaml": put("at: [0 mm, 12 mm", "at: [0 mm, 12.2 mm")}, DONE, "y of the place of A"),
    Row("{} has the wrong sign: it is off by {}; write at: [{}]", "five-axis", AXES, {"jobs/after.yaml": put("at: [0 mm, 12 mm", "at: [0 mm, -12 mm")},
        {"jobs/after.yaml": put("at: [0 mm, 12 mm", "at: [0 mm, -5 mm")}, "is `at` right?", "[0 mm, 12 mm, -520 mm]"),
    Row("{} counts the other way", "five-axis", AXES, {"jobs/after.yaml": put("at: [0 mm, 0 mm, -560 mm]}", "at: [0 mm, 0 mm, -560 mm], sense: -1}")},
        {"jobs/after.yaml": put("at: [0 mm, 0 mm, -560 mm]}", "at: [0 mm, 400 mm, -560 mm]}")}, "error", "C counts", slow=True),
    Row("tables and heads are exchanged", "five-axis", AXES, {"jobs/after.yaml": put("wCAbXYZt", "wbXYZACt")},
        {"jobs/after.yaml": put("at: [0 mm, 0 mm, -560 mm]}", "at: [0 mm, 400 mm, -560 mm]}")}, "error", slow=True),
]  # fmt: skip

OTF = "calibrate-machine jobs/feed-15000.yaml"
TRACK = "data/track-15000.csv"
PLACES = "station,x_mm,y_mm,z_mm\nS1,840,-468,-450\nS2,-240,-416,-100\nS3,-180,468,-500\nS4,840,416,0\n"
"""Stations of the sample, mirrored in x about the middle of its travel"""
MACHINE = [
    Row("is their unit right? a column mx_m or x_m is in metres", "otf-tracker", OTF, {TRACK: times(1e-3, "x_mm", "y_mm", "z_mm")},
        {TRACK: then(times(1e-3, "x_mm", "y_mm", "z_mm"), by("_mm", "_m"))}, "status: "),
    Row("the track is a mirror image of the path", "otf-tracker", OTF, {TRACK: times(-1, "z_mm")},
        {TRACK: then(times(-1, "z_mm"), times(-1, "x_mm"))}, "status: ", slow=True),
    Row("two of mx, my, mz are swapped, or one of them has the wrong sign", "otf-tracker", OTF, {TRACK: by("x_mm,y_mm", "y_mm,x_mm")},
        {TRACK: then(times(-1, "z_mm"), times(-1, "x_mm"))}, "status: ", slow=True),
    Row("is this the track of another path, or are vertices missing or in another order?", "otf-tracker", OTF,
        {"data/path.csv": reordered("y_mm", "", sorted)}, {TRACK: times(-1, "z_mm")}, "mirror image", slow=True),
    Row("the lengths place the stations {} mm from their list, and {} mm from it if {} counts the other way", "machine-lengths", "calibrate-machine jobs/one-tool.yaml",
        {"jobs/one-tool.yaml": put("lengths-T1.csv}", "lengths-T1.csv, stations: ../stations.csv}"), "stations.csv": whole(PLACES)},
        {"jobs/one-tool.yaml": put("lengths-T1.csv}", "lengths-T1.csv, stations: ../stations.csv}"), "stations.csv": then(whole(PLACES), times(-1, "x_mm"), cells("x_mm", lambda x: 600 + float(x)))}, DONE, "if X counts"),
]  # fmt: skip

LAUNCH = "locate-launch-unit jobs/table.yaml"
TABLE = "data/table.csv"
PHI = ("phi1_rad", "phi2_rad", "phi3_rad", "phi4_rad")
UNITS = [
    Row("they would if {}", "xm60-launch-unit", LAUNCH, {TABLE: by("_rad", "_deg")}, {TABLE: times(1.05, "phi1_rad", "phi3_rad")}, "error", "hold radians, not degrees", slow=True),
    Row("they would if {}", "xm60-launch-unit", LAUNCH, {TABLE: then(times(63.66197724, *PHI), by("phi(.)_rad", r"phi\1_deg"))}, {TABLE: times(1.05, *PHI)}, "error", "gon", slow=True),
    Row("{} are swapped", "xm60-launch-unit", LAUNCH, {TABLE: put("phi1_rad,phi2_rad", "phi2_rad,phi1_rad")}, {TABLE: times(1.05, *PHI)}, "error", "phi1 and phi2", slow=True),
    Row("{} count the other way round", "xm60-launch-unit", LAUNCH, {TABLE: times(-1, "phi2_rad")}, {TABLE: times(1.05, *PHI)}, "error", "phi2", slow=True),
    Row("the spindle's angle counts the other way round", "xm60-launch-unit", LAUNCH, {TABLE: times(-1, "spindle_rad")}, {TABLE: times(1.05, *PHI)}, "error", slow=True),
    Row("z has the wrong sign", "xm60-launch-unit", LAUNCH, {TABLE: times(-1, "z_mm")}, {TABLE: times(1.05, *PHI)}, "error", slow=True),
    Row("(the mirror solution)", "xm60-launch-unit", LAUNCH, {TABLE: then(times(-1, "phi3_rad"), cells("phi4_rad", lambda c: float(c) + 3.141592653589793))},
        {TABLE: times(1.05, *PHI)}, "error", slow=True),
]  # fmt: skip

CAMERA = "calibrate-camera job.yaml"
SEEN = "observations.csv"
FOLDED = board(k1=-1.2)[SEEN]
CAMERAS = [
    Row("{} {}: the board is seen from the other side than in the others; mirrored?", "board", CAMERA, {SEEN: cells("u_px", lambda u: 639 - float(u), "view3.png")},
        {SEEN: then(cells("u_px", lambda u: 639 - float(u), "view3.png"), cells("v_px", lambda v: 479 - float(v), "view3.png"))}, "status: ", slow=True),
    Row("{} fits no view of a flat board, by {} px: are its targets in another order?", "board", CAMERA,
        {SEEN: reordered("target", "view3.png", lambda old: [*old[1:], old[0]])}, {SEEN: put("view3.png,A0,", "view3.png,F8,")}, "view3.png", slow=True),
    Row("{} and {} are exchanged in image {}", "network", CAMERA, {SEEN: exchanged("target", "T2", "T17", "view02.png")},
        {SEEN: exchanged("target", "T2", "T17", "view02.png"), "job.yaml": more("outliers: remove")}, "view02.png/T2", "T2 and T17", slow=True),
    Row("use fewer distortion parameters", "board", CAMERA,
        {"observations.csv": whole(FOLDED)}, {"observations.csv": whole(FOLDED), "job.yaml": put("k1, k2]", "k1]")}, "estimate further radial terms"),
    Row("{}; with u and v exchanged all would lie inside", "board", CAMERA, {SEEN: then(cells("u_px", lambda u: float(u) + 120), put("u_px,v_px", "v_px,u_px"))}, {SEEN: times(2, "u_px")}, "outside"),
    Row("are the columns u and v exchanged?", "board", CAMERA, {SEEN: put("u_px,v_px", "v_px,u_px")}, {SEEN: cells("u_px", lambda u: float(u) + 100)}, "check image_size"),
    Row("{} turned by 180 degrees, or the {} others are", "board", CAMERA,
        {SEEN: then(*(cells(n, lambda c, s=s: s - float(c), f"view{i}.png") for i in (1, 3, 6) for n, s in (("u_px", 639), ("v_px", 479))))}, {}, DONE),
    Row("{}: with {} free the squared residuals are {} times as large; estimate what is held, or correct it", "board", CAMERA,
        {"job.yaml": put("cx, cy, k1, k2]", "cx, cy], k1: -0.1")}, {"job.yaml": put("cx, cy, k1, k2]", "cx, cy], k1: -0.2")}, DONE),
    Row("the readings fit no pose", "align", "align-part job.yaml", {"poses.csv": times(-1, "y_mm")}, {"observations.csv": cells("u_px", lambda u: float(u) + 0.01)}, "status: "),
    Row("half of the points of image {} are off by more than {} px", "relief", CAMERA, {SEEN: cells("u_px", lambda u: 639 - float(u), "view3.png")},
        {SEEN: cells("u_px", lambda u: float(u) + 0.2, "view3.png")}, "status: ", slow=True),
    Row("the lens is a fisheye: that model leaves residuals of {} px (rms), this one {} px", "fisheye", CAMERA, {}, {"job.yaml": put("camera: {", "camera: {model: fisheye, ")}, DONE, slow=True),
    Row("Did a camera move?", "two-cameras", CAMERA, {SEEN: then(*(cells("u_px", lambda u, k=k: float(u) + 9 * k, f"right{k}.png") for k in range(10)))},
        {SEEN: then(by(r"right8\.png", "right.png"), by(r"right9\.png", "right8.png"), by(r"right\.png", "right9.png"))}, "were not taken with", slow=True),
    Row("check the dictionary, or is there no board?", "charuco", CAMERA, {"job.yaml": put("view*", "blank*")}, {"job.yaml": put("4x4_50", "5x5_50")}, "with `dictionary: 4x4_250`", slow=True),
    Row("markers of {}: is it type: charuco, dictionary: {}?", "charuco", CAMERA, {"job.yaml": put("{type: charuco, columns: 7, rows: 5, pitch: 35 mm, marker_size: 24 mm, dictionary: 4x4_50}", "{type: circles, columns: 7, rows: 5, pitch: 35 mm}")},
        {"job.yaml": put("columns: 7, rows: 5", "columns: 5, rows: 7")}, "with `columns: 7, rows: 5`", "4x4_", slow=True),
]  # fmt: skip

MESH = {"job.yaml": put("part.yaml", "part.stl")}
PARTS = [
    Row("the points of {} lie on the wrong side of the surface", "part", "fit-part job.yaml", {"part.yaml": put("normal: [0, 0, 1]", "normal: [0, 0, -1]")},
        {"points.csv": put(",top,", ",top,")}, DONE, "top"),
    Row("the points of every surface lie on the wrong side", "part", "fit-part job.yaml", {"part.yaml": then(by(r"normal: \[", "normal: [-"), by(r"--", ""), by("(?<=[ ,])1(?=[],])", "-1"))}, {}, DONE, slow=True),
    Row("the mesh of the ideal part is inverted", "part", "fit-part job.yaml", {"job.yaml": put("part.yaml", "inverted.stl")}, MESH, DONE),
    Row("the coordinates of the mesh are in {}, not in {}: write `nominal_unit: {}`", "part", "fit-part job.yaml", {"job.yaml": put("part.yaml", "cm.stl")},
        {"job.yaml": then(put("part.yaml", "cm.stl"), more("nominal_unit: cm"))}, DONE, "`nominal_unit: cm`"),
    Row("the coordinates of the points are in {}, though they are read as mm: multiply them by {}", "part", "fit-part job.yaml", {**MESH, "points.csv": times(0.001, "x_mm", "y_mm", "z_mm")},
        {**MESH, "points.csv": then(times(0.001, "x_mm", "y_mm", "z_mm"), by("([xyz])_mm", r"\1_m"))}, DONE, "in m,"),
]  # fmt: skip

REST = "calibrate-machine job.yaml"
AT = "points.csv"
LISTS = [
    Row("the measured coordinates are {} times as large as the commanded ones", "at-rest", REST, {AT: times(0.001, "mx_mm", "my_mm", "mz_mm")},
        {AT: then(times(0.001, "mx_mm", "my_mm", "mz_mm"), by("m([xyz])_mm", r"m\1_m"))}, DONE, "0.001 times"),
    Row("the measured points are a mirror image of the commanded ones", "at-rest", REST, {AT: times(-1, "mz_mm")}, {AT: times(-1, "mz_mm", "my_mm")}, DONE),
    Row("is this the measurement of another path or list, or are rows missing or reordered?", "at-rest", REST, {AT: reordered("mx_mm", "", sorted)}, {AT: times(-1, "mz_mm", "my_mm")}, DONE),
    Row("{}, use fewer knots, give the axes different knots, or leave errors out of `estimate`", "at-rest", REST,
        {"job.yaml": by("estimate: .*", "estimate: all"), AT: rows(lambda head, body: [row for row in body if row[3] == "0" or row[1:3] == ["0", "0"]])}, {}, DONE),
    Row("give `plan: {time: ...}` more, or use fewer knots", "machine-lengths", "plan jobs/lengths.yaml --out plan", {"jobs/lengths.yaml": put("plan: {time: 6 h}", "plan: {time: 3 min}")},
        {"jobs/lengths.yaml": put("plan: {time: 6 h}", "plan: {time: 6 h, uncertainty: 1 mm}")}, "proposed"),
    Row("the points found are {} times as far apart as those of the list", "laboratory-effects", HALL, {"jobs/hall.yaml": put("  tracers: ../data/tracers.csv\n", ""), LENGTHS: times(0.7, "length_mm")},
        {"jobs/hall.yaml": put("  tracers: ../data/tracers.csv\n", "")}, "status: ", "0.7 times", slow=True),
]  # fmt: skip

ROS = """image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [300, 0, 320, 0, 300, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 4, data: [-0.1, 0.2, 0.5, -0.6]}
"""
CORRECTED = [
    Row("with this corrected, the job has a solution that fits, which it does not have as it stands ({})", "five-axis", AXES, {"data/after.csv": then(times(0.0174532925, "a_deg", "c_deg"))},
        {"data/after.csv": times(0.3, "c_deg")}, "error", slow=True),
    Row("is it in degrees? then write {}_deg", "five-axis", AXES, {"data/after.csv": put("a_deg", "a_rad")}, {"data/after.csv": put("-32.546", "-32546")}, "if it is right, allow it"),
    Row("few degrees of freedom", "budget", "report-uncertainty job.yaml", {"job.yaml": whole(budget("a*b", "3", "1e-5"))}, {"job.yaml": whole(budget("a/b", std="0.2"))}, "a pole near the value"),
    Row("one is too large, or has the wrong sign", "budget", "report-uncertainty job.yaml", {"job.yaml": then(whole(budget("a*b*c")), put("measurands:", "  c: {value: 1, std: 0.1}\ncorrelations: [{between: [a, b], value: 0.9}, {between: [a, c], value: 0.9}, {between: [b, c], value: -0.9}]\nmeasurands:"))},
        {"job.yaml": then(whole(budget("a*b*c")), put("measurands:", "  c: {value: 1, std: 0.1}\ncorrelations: [{between: [a, b], value: 0.9}, {between: [a, c], value: 0.9}, {between: [b, c], value: 0.9}]\nmeasurands:"))}, "status: "),
    Row("four coefficients of a fisheye are k1 to k4: for such a lens write `distortion_model: equidistant`", "nothing", "import cam.yaml --from ros --out x", {"cam.yaml": whole(ROS)}, {"cam.yaml": then(whole(ROS), put("0.5, -0.6]", "0.002, -0.001]"))}, "camera.yaml"),
]  # fmt: skip

MISTAKES, REFUSED = "diagnosis/test_mistakes.py", "diagnosis/test_refused_files.py"
OF_NETWORKS, OF_MACHINES = "tasks/adjust_network/test_mistakes.py", "tasks/calibrate_machine/test_other_settings.py"
FITTING = (REFUSED, "test_gross_errors_alone_are_no_wrong_heading")
RIGHT = (OF_NETWORKS, "test_nothing_is_proposed_for_readings_that_fit")
SOUND = (OF_MACHINES, "test_right_settings_are_not_doubted")
JOINED = "tasks/fit_points/test_joined.py"
BLUNDERS = "tasks/multilaterate/test_blunders.py"
STRANGE = "tasks/calibrate_camera/test_strange_images.py"
POSES, MISREAD = "tasks/align_part/test_exchanged_poses.py", "tasks/fit_part/test_misread.py"
IN_IMAGES = "tasks/calibrate_camera/test_exchanged_targets.py"
ELSEWHERE = {
    "the names of targets in the rows of {} stand one row too {}": (
        (IN_IMAGES, "test_names_that_stand_one_row_too_high_are_named"), (IN_IMAGES, "test_exchanged_names_are_found_in_one_image_and_in_two")),
    "u and v of {} are exchanged": (
        (STRANGE, "test_an_image_whose_u_and_v_are_exchanged_is_named"),
        (STRANGE, "test_a_diagnosis_has_images_that_no_residual_shows")),
    "the points of station {} are a mirror image of the others": (
        (JOINED, "test_what_cannot_be_joined_is_refused"), (JOINED, "test_stations_that_share_points")),
    "{} and {} are swapped": ((REFUSED, "test_a_list_with_a_wrong_heading_is_refused"), FITTING),
    "{} are in the order {}": ((REFUSED, "test_a_list_with_a_wrong_heading_is_refused"), FITTING),
    "{} has the wrong sign": ((REFUSED, "test_a_mirrored_list_is_refused"), FITTING),
    "turned by 180 degrees about": ((REFUSED, "test_each_correction_undoes_its_mistake"), FITTING),
    "{} and {} with the other sign": ((REFUSED, "test_each_correction_undoes_its_mistake"), FITTING),
    "{} for {} and {} for {} in the headings, {} with the other sign": (
        (REFUSED, "test_each_correction_undoes_its_mistake"), FITTING),
    "with this corrected, the readings fit {} times better (ratio of squared misfits)": (
        (REFUSED, "test_a_mirrored_list_is_refused"), FITTING),
    "{} and {} are exchanged at station {}": (
        (OF_NETWORKS, "test_exchanged_points_are_proposed_at_their_station"), RIGHT),
    "dh has the wrong sign": ((OF_NETWORKS, "test_a_height_of_the_wrong_sign_is_proposed_with_its_line"), RIGHT),
    "the height difference from {} has the wrong sign{}": (
        (OF_NETWORKS, "test_a_height_of_the_wrong_sign_is_proposed_with_its_line"), RIGHT),
    "{} are in {}": ((OF_NETWORKS, "test_a_mistake_is_found_and_its_correction_fits"), RIGHT),
    "{} of {} has the wrong sign": ((OF_MACHINES, "test_a_tool_with_the_wrong_sign_is_refused"), SOUND),
    "{} of {} with the other sign": ((OF_MACHINES, "test_a_tool_with_the_wrong_sign_is_refused"), SOUND),
    "{} {} times {}": (
        (MISTAKES, "test_rows_in_another_unit_are_named"),
        ("tasks/calibrate_machine/test_channels.py", "test_a_line_with_large_errors_is_in_no_other_unit")),
    "{}: with this corrected, {}; write {}": (
        (OF_MACHINES, "test_a_wrong_setting_makes_the_result_doubtful"), SOUND),
    "; they fit {}: correct the name": (
        (BLUNDERS, "test_lengths_under_another_name_are_named"), (BLUNDERS, "test_no_name_is_offered_for_lengths_that_fit_no_point")),
    "the poses of images {} and {} are exchanged: with this corrected": (
        (POSES, "test_both_images_are_named"), (POSES, "test_no_exchange_is_offered_where_none_mends_the_poses")),
    "the points are a mirror image of the part: mirrored, they lie {} mm from its surfaces": (
        (MISREAD, "test_a_mirror_image_that_fits_far_better_is_named"), (MISREAD, "test_right_coordinates_are_not_doubted")),
    "multiplied by {}, the points fit: they then lie {} mm from their surfaces": (
        (MISREAD, "test_another_unit_is_named"), (MISREAD, "test_right_coordinates_are_not_doubted")),
    "multiplied by {}, the points fit the surfaces as well": (
        (MISREAD, "test_a_flat_column_that_fits_alike_is_named"), (MISREAD, "test_right_coordinates_are_not_doubted")),
    "a mirror image of the points fits the surfaces as well": (
        (MISREAD, "test_a_mirror_image_that_fits_alike_is_doubtful"), (MISREAD, "test_right_coordinates_are_not_doubted")),
    "the imaged sizes of the targets fit no one diameter": (
        ("tasks/shared/images/test_imaged_size.py", "test_sizes_that_fit_no_one_diameter_do_not_blame_it"),
        ("tasks/shared/images/test_imaged_size.py", "test_the_right_diameter_of_the_sample_is_accepted")),
}  # fmt: skip
"""Hints that a run offers after many adjustments: the test that provokes each, and one in which it must not appear"""

ROWS = [
    *NAMES,
    *FILES,
    *LENGTHS_OF_TRACERS,
    *FITS,
    *GRID,
    *ROTARY,
    *MACHINE,
    *UNITS,
    *CAMERAS,
    *PARTS,
    *LISTS,
    *CORRECTED,
]
