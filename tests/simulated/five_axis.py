"""Five-axis machines for the tests, written without the engine: exact 4 x 4 transforms of the contract, own draws."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
LINEAR, ROTARY = "XYZ", "ABC"
DEG = np.pi / 180


@dataclass(frozen=True)
class Kind:
    """A machine without errors: its chain, and range, knots and place of each axis."""

    chain: str
    """From workpiece to tool, with b"""
    axes: dict[str, tuple[float, float, int]]
    at: dict[str, tuple[float, float, float]]
    tools: dict[str, tuple[float, float, float]]
    balls: tuple[tuple[float, float, float], ...]


THREE = {"T1": (0.0, 0.0, -120.0), "T2": (0.0, 0.0, -260.0), "T3": (90.0, 40.0, -180.0)}
KINDS = {
    "table-table": Kind(
        "CAbXYZ",
        {"X": (-350, 350, 4), "Y": (-400, 400, 4), "Z": (-700, 0, 3), "A": (-105, 30, 7), "C": (0, 360, 9)},
        {"A": (0.0, 12.0, -520.0), "C": (0.0, 0.0, -560.0)},
        {"T1": THREE["T1"]},
        ((148.0, 36.0, -507.0), (-91.0, 115.0, -452.0), (-50.0, -120.0, -528.0)),
    ),
    "head-table": Kind(
        "CbXYZB",
        {"X": (-700, 700, 4), "Y": (-400, 400, 4), "Z": (-800, 0, 3), "B": (-30, 90, 6), "C": (0, 360, 9)},
        {"B": (0.0, 0.0, 150.0), "C": (20.0, 0.0, -700.0)},
        THREE,
        ((167.0, 26.0, -648.0), (-64.0, 111.0, -587.0), (-33.0, -132.0, -669.0)),
    ),
    "head-head": Kind(
        "bXYZCA",
        {"X": (0, 2000, 4), "Y": (-800, 800, 4), "Z": (-900, 0, 3), "A": (-105, 105, 8), "C": (-180, 180, 9)},
        {"A": (0.0, 0.0, 240.0), "C": (0.0, 0.0, 240.0)},
        THREE,
        ((1413.0, 85.0, -426.0), (738.0, 364.0, -261.0), (1000.0, -200.0, -500.0)),
    ),
}


ROUNDING = 1e-12
"""Gap [mm] below which a tip has met a ball"""


def move(vector: Array) -> Array:
    """Trans."""
    matrix = np.eye(4)
    matrix[:3, 3] = vector
    return matrix


def about(axis: int, angle: float) -> Array:
    """Rotation about x, y or z."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(4)
    c, s = math.cos(angle), math.sin(angle)
    matrix[j, j] = matrix[k, k] = c
    matrix[k, j], matrix[j, k] = s, -s
    return matrix


def rot(angles: Array) -> Array:
    """Rot = Rz Ry Rx, multiplied out."""
    (sa, sb, sc), (ca, cb, cc) = map(math.sin, angles), map(math.cos, angles)
    return np.array(
        [
            [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa, 0.0],
            [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa, 0.0],
            [-sb, cb * sa, cb * ca, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def placed(vector: Array, angles: Array) -> Array:
    """Trans Rot."""
    matrix = rot(angles)
    matrix[:3, 3] = vector
    return matrix


@dataclass
class Machine:
    """A machine with true errors."""

    kind: Kind
    knots: dict[str, Array]
    tables: dict[str, Array] = field(default_factory=dict)
    places: dict[str, float] = field(default_factory=dict)
    """Location errors, zero positions, spindle and squareness"""
    sense: dict[str, int] = field(default_factory=dict)
    disturbed: Callable[[str, float, int], Array] | None = None
    """More errors of an axis: E, theta and a shift of its line, by letter, position and number of the reading"""

    def place(self, name: str) -> float:
        return self.places.get(name, 0.0)

    def joint(self, letter: str, position: float, reading: int = 0) -> Array:
        """The 4 x 4 matrix of a joint, as contract 15A has it."""
        errors = np.array(
            [
                np.interp(position, self.knots[letter], self.tables[f"E{d}{letter}"])
                if f"E{d}{letter}" in self.tables
                else 0
                for d in "XYZABC"
            ]
        )
        more = np.zeros(9) if self.disturbed is None else self.disturbed(letter, position, reading)
        small = placed(errors[:3] + more[:3], errors[3:] + more[3:6])
        if letter in LINEAR:
            a, b, c = (self.place(name) for name in ("A0Z", "B0Z", "C0Y"))
            along = {
                "X": (1.0, 0.0, 0.0),
                "Y": (-math.sin(c), math.cos(c), 0.0),
                "Z": (math.sin(b), -math.sin(a) * math.cos(b), math.cos(a) * math.cos(b)),
            }[letter]
            small[:3, 3] += position * np.array(along)
            return small
        axis = ROTARY.index(letter)
        off = np.array([self.place(f"E{d}0{letter}") for d in "XYZ"]) + more[6:]
        tilt = np.array([self.place(f"E{d}0{letter}") if d != letter else 0.0 for d in "ABC"])
        frame = placed(off, tilt)
        turn = about(axis, self.sense.get(letter, 1) * position + self.place(f"E{letter}0{letter}"))
        head = letter in self.kind.chain.split("b")[1]
        inner = small @ turn if head else turn @ small
        at = np.array(self.kind.at[letter])
        return move(at) @ frame @ inner @ np.linalg.inv(frame) @ move(-at)

    def sides(self, pose: dict[str, float], reading: int = 0) -> tuple[Array, Array]:
        """Bed to workpiece and bed to tool."""
        left, right = self.kind.chain.split("b")
        workpiece, tool = np.eye(4), np.eye(4)
        for letter in left:
            workpiece = workpiece @ self.joint(letter, pose[letter], reading)
        for letter in right:
            tool = tool @ self.joint(letter, pose[letter], reading)
        return np.linalg.inv(workpiece), tool @ rot(np.array([self.place(f"E{d}0S") for d in "ABC"]))

    def tip(self, pose: dict[str, float], tool: Array) -> Array:
        """The tip on the workpiece."""
        workpiece, spindle = self.sides(pose)
        return np.asarray((np.linalg.inv(workpiece) @ spindle @ np.append(tool, 1.0))[:3])

    def perfect(self) -> Machine:
        """The machine without errors."""
        return Machine(self.kind, self.knots, sense=self.sense)

    def drawn_pose(self, rng: np.random.Generator) -> dict[str, float]:
        """A random pose, rounded as a control shows it."""
        pose = {}
        for letter, knots in self.knots.items():
            unit = DEG if letter in ROTARY else 1.0
            pose[letter] = float(np.round(rng.uniform(knots[0], knots[-1]) / unit, 3) * unit)
        return pose


def gauged(machine: Machine, letter: str, tables: Array) -> Array:
    """Tables (6, knots) without the ten conditions of contract 15B, by least squares."""
    knots, head = machine.knots[letter], letter in machine.kind.chain.split("b")[1]
    i, full = ROTARY.index(letter), np.isclose(np.ptp(machine.knots[letter]), 2 * np.pi)
    s = knots[:-1] if full else knots
    j, k, n = (i + 1) % 3, (i + 2) % 3, len(s)
    own = tables[:, :n].copy()
    sign = 1.0 if head else -1.0
    for shift in (0, 3):
        modes = np.zeros((2 * n, 4))
        modes[:n, 0] = modes[n:, 1] = 1.0
        modes[:n, 2], modes[n:, 2] = np.cos(s), sign * np.sin(s)
        modes[:n, 3], modes[n:, 3] = -sign * np.sin(s), np.cos(s)
        both = np.concatenate([own[j + shift], own[k + shift]])
        both -= modes @ np.linalg.lstsq(modes, both, rcond=None)[0]
        own[j + shift], own[k + shift] = both[:n], both[n:]
    own[i] -= own[i].mean()
    zero = 0.0 if s[0] <= 0 <= knots[-1] else s[0]
    own[i + 3] -= np.interp(zero, s, own[i + 3])
    return np.concatenate([own, own[:, :1]], axis=1) if full else own


def drawn(kind: Kind, rng: np.random.Generator, scale: float = 1.0, linear: bool = True) -> Machine:
    """A machine with random errors: tables of micrometres and ten microradians, locations of 30 um and 100 urad."""
    knots = {
        letter: np.linspace(low, high, count) * (DEG if letter in ROTARY else 1.0)
        for letter, (low, high, count) in kind.axes.items()
    }
    machine = Machine(kind, knots)
    size = scale * np.array([3e-3] * 3 + [1e-5] * 3)[:, None]
    for letter, own in knots.items():
        raw = rng.normal(size=(6, len(own))) * size
        if letter in ROTARY:
            if np.isclose(np.ptp(own), 2 * np.pi):
                raw[:, -1] = raw[:, 0]
            raw = gauged(machine, letter, raw)
        elif not linear:
            raw *= 0
        else:
            zero = 0.0 if own[0] <= 0 <= own[-1] else own[0]
            share = (own - own[0]) / np.ptp(own)
            for row in range(6):
                if row < 3 and row != LINEAR.index(letter):
                    raw[row] -= raw[row, 0] + (raw[row, -1] - raw[row, 0]) * share
                else:
                    raw[row] -= np.interp(zero, own, raw[row])
        machine.tables |= {f"E{d}{letter}": row for d, row in zip("XYZABC", raw, strict=True)}
    carries = kind.chain[-1] if kind.chain[-1] in ROTARY else ""
    for letter in (one for one in ROTARY if one in knots):
        for d in "XYZABC":
            if (d != letter and d != LINEAR[ROTARY.index(letter)]) or d == letter == carries:
                machine.places[f"E{d}0{letter}"] = float(rng.normal() * scale * (3e-2 if d in LINEAR else 1e-4))
    if carries:
        machine.places |= {f"E{d}0S": float(rng.normal() * scale * 5e-5) for d in ROTARY if d != carries}
    if linear:
        machine.places |= {name: float(rng.normal() * scale * 2e-5) for name in ("A0Z", "B0Z", "C0Y")}
    return machine


def written_axes(machine: Machine) -> str:
    """The machine of a job file."""
    lines = [f"  chain: w{machine.kind.chain}t", "  axes:"]
    for letter, (low, high, count) in machine.kind.axes.items():
        unit = "deg" if letter in ROTARY else "mm"
        own = f"range: [{low} {unit}, {high} {unit}], knots: {count}"
        if letter in ROTARY:
            own += ", at: [" + ", ".join(f"{x} mm" for x in machine.kind.at[letter]) + "]"
            own += ", periodic: true" * (high - low == 360) + f", sense: {machine.sense.get(letter, 1)}"
        lines.append(f"    {letter.lower()}: {{{own}}}")
    tools = ", ".join(f"{name}: [{', '.join(f'{x} mm' for x in tool)}]" for name, tool in machine.kind.tools.items())
    return "\n".join([*lines, f"  tools: {{{tools}}}"])


def header(machine: Machine) -> str:
    return ",".join(f"{one.lower()}_{'deg' if one in ROTARY else 'mm'}" for one in machine.knots)


def cells(pose: dict[str, float]) -> str:
    return ",".join(f"{value / DEG if letter in ROTARY else value:.9f}" for letter, value in pose.items())


def job(folder: Path, machine: Machine, method: str, rest: str) -> Path:
    """Write a job file and return it."""
    text = f"metrocli: 1\njob: calibrate-machine\nmethod: {method}\nmachine:\n{written_axes(machine)}\n{rest}\noutput: result.h5\n"
    path = folder / "job.yaml"
    path.write_text(text)
    return path


def probed(
    folder: Path,
    machine: Machine,
    rng: np.random.Generator,
    n: int,
    sigma: float,
    estimate: str = "rotary",
    rtest: bool = False,
    balls: int = 3,
    true_balls: Array | None = None,
    tools: dict[str, Array] | None = None,
    when: Callable[[int], str] = lambda i: f"{16.0 * i:.1f}",
) -> Path:
    """Write a probing job: a touch probe, whose position is where it finds the centre, or an R-test."""
    names = list(machine.kind.tools)
    listed = np.array(machine.kind.balls[:balls])
    places = listed + rng.normal(size=listed.shape) if true_balls is None else true_balls
    true_tools = {name: np.array(tool) for name, tool in machine.kind.tools.items()} | (tools or {})
    lines = [
        f"ball,{header(machine)}"
        + ",dx_um,dy_um,dz_um" * rtest
        + ",tool,t_s,from_"
        + ",from_".join(one.lower() for one in machine.knots if one in ROTARY)
    ]
    last = dict.fromkeys(machine.knots, 0.0)
    perfect = machine.perfect()
    i = 0
    while i < n:
        number, tool = int(rng.integers(len(places))), names[int(rng.integers(len(names)))]
        pose = machine.drawn_pose(rng)
        met = _meeting(perfect, pose, listed[number], np.array(machine.kind.tools[tool]))
        if any(not k[0] <= met[letter] <= k[-1] for letter, k in machine.knots.items()):
            continue
        side = ",".join("1" if met[one] >= last[one] else "-1" for one in met if one in ROTARY)
        turned = dict(met)
        if rtest:
            met = {letter: round(value, 3) if letter in LINEAR else value for letter, value in met.items()}
            workpiece, spindle = machine.sides(met, i)
            d = (workpiece @ np.append(places[number], 1) - spindle @ np.append(true_tools[tool], 1))[:3]
            d = d + rng.normal(size=3) * sigma
            lines.append(f"K{number + 1},{cells(met)},{','.join(f'{1e3 * x:.9f}' for x in d)},{tool},{when(i)},{side}")
        else:
            for _ in range(8):
                workpiece, spindle = machine.sides(met, i)
                gap = (workpiece @ np.append(places[number], 1) - spindle @ np.append(true_tools[tool], 1))[:3]
                for axis, letter in enumerate(LINEAR):
                    met[letter] += gap[axis]
                if np.abs(gap).max() < ROUNDING:
                    break
            noise = rng.normal(size=3) * sigma
            for axis, letter in enumerate(LINEAR):
                met[letter] += noise[axis]
            if any(not k[0] <= met[letter] <= k[-1] for letter, k in machine.knots.items()):
                continue
            lines.append(f"K{number + 1},{cells(met)},{tool},{when(i)},{side}")
        last, i = turned, i + 1
    (folder / "probing.csv").write_text("\n".join(lines) + "\n")
    rows = [f"K{i + 1},{x:.1f},{y:.1f},{z:.1f}," for i, (x, y, z) in enumerate(listed)]
    (folder / "balls.csv").write_text("ball,x_mm,y_mm,z_mm,sigma_mm\n" + "\n".join(rows) + "\n")
    rest = f"estimate: {estimate}\ninputs: {{probing: probing.csv, balls: balls.csv}}\nnoise: {{probing: {max(sigma, 1e-4) * 1e3} um}}"
    return job(folder, machine, "probing", rest)


def _meeting(machine: Machine, pose: dict[str, float], ball: Array, tool: Array) -> dict[str, float]:
    """The pose whose linear axes bring the tool to a ball, all linear axes being right of the bed."""
    met = dict(pose)
    for _ in range(3):
        workpiece, spindle = machine.sides(met)
        gap = (workpiece @ np.append(ball, 1) - spindle @ np.append(tool, 1))[:3]
        for axis, letter in enumerate(LINEAR):
            met[letter] += gap[axis]
        if np.abs(gap).max() < ROUNDING:
            break
    return met


def tracked(
    folder: Path,
    machine: Machine,
    rng: np.random.Generator,
    n: int,
    noise: tuple[float, float, float],
    on: str = "workpiece",
    stations: int = 0,
    workpiece: int = 0,
) -> Path:
    """Write a standstill job, or with stations a job of lengths; reflectors on the workpiece for an instrument on the bed.

    noise: along the beam, and constant and proportional across it; of lengths the first, and the third as proportional.
    """
    targets = dict(machine.kind.tools)
    fixed = {f"R{i + 1}": np.array(machine.kind.balls[i]) + rng.normal(size=3) * 0.5 for i in range(workpiece)}
    names = [*targets, *fixed]
    centre = machine.perfect().tip({letter: k.mean() for letter, k in machine.knots.items()}, np.zeros(3))
    places = (
        centre
        + rng.normal(size=(max(stations, 1), 3)) * 150
        + 900
        * np.array([[1, 0.3, 0.2], [-0.7, 0.9, -0.2], [-0.5, -1, 0.5], [0.3, 0.2, 1.1], [0.8, -0.9, -0.6]])[
            : max(stations, 1)
        ]
    )
    turn = rot(np.array([0.05, -0.04, rng.uniform(-3, 3)]))[:3, :3]
    zero = rng.normal(size=len(places)) * 100
    rows = []
    for i in range(n):
        pose, name = machine.drawn_pose(rng), names[int(rng.integers(len(names)))]
        body, spindle = machine.sides(pose)
        if name in fixed:
            q = (body @ np.append(fixed[name], 1))[:3]
        else:
            q = (spindle @ np.append(targets[name], 1))[:3]
            if on == "workpiece":
                q = (np.linalg.inv(body) @ np.append(q, 1))[:3]
        if stations:
            for k, x0 in enumerate(places):
                far = np.linalg.norm(q - x0)
                sigma = np.hypot(noise[0], noise[2] * far)
                rows.append(
                    f"P{i + 1},S{k + 1},{cells(pose)},{far - zero[k] + rng.normal() * sigma:.10f},{name},{4.0 * i}"
                )
        else:
            seen = turn.T @ (q - places[0])
            far = np.linalg.norm(seen)
            beam, across = seen / far, rng.normal(size=3) * np.hypot(noise[1], noise[2] * far)
            seen = seen + across - beam * (beam @ across) + beam * rng.normal() * noise[0]
            rows.append(f"P{i + 1},{cells(pose)},{','.join(f'{x:.10f}' for x in seen)},{name},{4.0 * i}")
    listed = ""
    if fixed:
        lines = [f"{name},workpiece,{','.join(f'{x:.1f}' for x in place)}," for name, place in fixed.items()]
        (folder / "reflectors.csv").write_text("reflector,on,x_mm,y_mm,z_mm,sigma_mm\n" + "\n".join(lines) + "\n")
        listed = ", reflectors: reflectors.csv"
    if stations:
        (folder / "lengths.csv").write_text(
            "\n".join([f"point,station,{header(machine)},length_mm,tool,t_s", *rows]) + "\n"
        )
        lines = [f"S{k + 1},{','.join(f'{x:.0f}' for x in place)}" for k, place in enumerate(places)]
        (folder / "stations.csv").write_text("station,x_mm,y_mm,z_mm\n" + "\n".join(lines) + "\n")
        rest = f"inputs: {{lengths: lengths.csv, stations: stations.csv{listed}}}\n"
        rest += f"noise: {{constant: {max(noise[0], 1e-4) * 1e3} um, proportional: {noise[2] * 1e6} um/m}}"
    else:
        (folder / "points.csv").write_text(
            "\n".join([f"point,{header(machine)},mx_mm,my_mm,mz_mm,tool,t_s", *rows]) + "\n"
        )
        rest = f"inputs: {{points: points.csv{listed}}}\n"
        rest += (
            f"noise: {{beam: {max(noise[0], 1e-4) * 1e3} um, lateral: {{constant: {max(noise[1], 1e-4) * 1e3} um, "
            f"proportional: {noise[2] * 1e6} um/m}}}}"
        )
    return job(
        folder, machine, "lengths" if stations else "standstill", f"estimate: all\ninstrument: {{'on': {on}}}\n{rest}"
    )


def errors_at(machine: Machine, poses: list[dict[str, float]], tool: Array) -> tuple[Array, Array]:
    """The tips without errors, and the errors of the tip on the workpiece, both (poses, 3)."""
    perfect = machine.perfect()
    nominal = np.array([perfect.tip(pose, tool) for pose in poses])
    return nominal, np.array([machine.tip(pose, tool) for pose in poses]) - nominal


def without_motion(places: Array, vectors: Array) -> Array:
    """Vectors at places (n, 3) less the rigid motion that fits them best."""
    centred = places - places.mean(axis=0)
    columns = np.zeros((len(places), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for k in range(3):
        columns[:, :, 3 + k] = np.cross(np.eye(3)[k], centred)
    flat = columns.reshape(-1, 6)
    return np.asarray(vectors - (flat @ np.linalg.lstsq(flat, vectors.ravel(), rcond=None)[0]).reshape(-1, 3))
