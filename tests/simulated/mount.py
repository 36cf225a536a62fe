"""A mount of two rotary axes, targets on it, and a tracker network that sees these: by 3 x 3 rotations alone.

Nobody reads the encoders: what the file has of the positions is some degrees off.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
JOB = """metrocli: 1
job: calibrate-machine
method: standstill
machine:
  chain: wbCAt
  axes:
    c: {{range: [0 deg, 360 deg], knots: 5, at: [0 mm, 0 mm, 0 mm], positions: {positions}}}
    a: {{range: [0 deg, 90 deg], knots: 3, at: [0 mm, 0 mm, 0 mm], positions: {positions}}}
estimate: locations
instrument: {{on: bed}}
inputs: {{points: targets.csv, network: network.h5, reflectors: reflectors.csv}}
output: mount.h5
"""
NETWORK = """metrocli: 1
job: adjust-network
inputs: {readings: readings.csv, stations: stations.csv, points: points.csv}
instruments:
  LT: {type: tracker, noise: {azimuth: 5 urad, elevation: 5 urad, distance: {constant: 10 um, proportional: 0 um/m}}}
output: network.h5
"""


def about(axis: int, angle: float) -> Array:
    """Return the rotation about x, y or z."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = c
    turn[i, j], turn[j, i] = -s, s
    return turn


@dataclass(frozen=True)
class Mount:
    """A mount in the frame of its network: where C is nearest to A, its axes, and its targets."""

    invariant: Array
    frame: Array
    """Columns: the axes of the machine in the frame of the network"""
    offset: float
    """Distance of A from C, along y at position 0 [mm]"""
    tilt: float
    """Turn of A about y [rad]: the angle between the axes is 90 deg plus it"""
    targets: Array
    poses: list[tuple[str, float, float]] = field(default_factory=list)
    """Run, C and A [rad], as they are"""

    def seen(self, number: int, c: float, a: float) -> Array:
        """Return where a target is in a pose."""
        arm = about(1, self.tilt) @ about(0, a) @ self.targets[number] + [0.0, self.offset, 0.0]
        return np.asarray(self.invariant + self.frame @ (about(2, c) @ arm))


def drawn(rng: np.random.Generator) -> Mount:
    """Return a random mount with runs of each axis."""
    frame = about(2, rng.uniform(-0.5, 0.5)) @ about(0, rng.normal() * 0.01) @ about(1, rng.normal() * 0.01)
    targets = rng.uniform(-1, 1, (4, 3)) * [900.0, 900.0, 600.0]
    runs = [("turn", c, 0.3) for c in np.radians(np.arange(0, 360, 40.0))]
    runs += [(name, at, a) for name, at in (("low", 0.4), ("high", 2.1)) for a in np.radians(np.arange(0, 90, 15.0))]
    place = rng.uniform([4000, -3000, 500], [6000, -1000, 1500])
    return Mount(place, frame, float(rng.normal() * 2), float(rng.normal() * 3e-4), targets, runs)


def write(folder: Path, mount: Mount, rng: np.random.Generator, positions: str = "estimated") -> Path:
    """Write the jobs of network and mount with their files; return that of the mount."""
    off = {key: rng.normal() * 0.03 for run, c, a in mount.poses for key in (("c", run, c), ("a", run, a))}
    points, rows = {f"M{i}": rng.uniform([0, -5000, 0], [9000, 2000, 3000]) for i in range(6)}, []
    marks = {name: place + rng.normal(size=3) * 0.02 for name, place in points.items()}
    for number, (run, c, a) in enumerate(mount.poses):
        stated = [np.degrees(at + off[name, run, at] * (positions == "estimated")) for name, at in (("c", c), ("a", a))]
        for j in range(len(mount.targets)):
            name = f"P{number:02d}T{j}"
            points[name] = mount.seen(j, c, a)
            rows.append(f"{name},{run},{stated[0] % 360:.6f},{np.clip(stated[1], 0, 90):.6f},T{j}")
    listed = [np.round(target + rng.normal(size=3) * 5) for target in mount.targets]
    texts = {
        "targets.csv": ["point,run,c_deg,a_deg,tool", *rows],
        "reflectors.csv": [
            "reflector,on,x_mm,y_mm,z_mm,sigma_mm",
            *(f"T{j},tool,{x},{y},{z}," for j, (x, y, z) in enumerate(listed)),
        ],
        "points.csv": [
            "point,x_mm,y_mm,z_mm,sigma_mm",
            *(f"{name},{x:.4f},{y:.4f},{z:.4f},0.02" for name, (x, y, z) in marks.items()),
        ],
        "stations.csv": ["station,instrument,x_mm,y_mm,z_mm", "S1,LT,0,0,0", "S2,LT,8000,500,200"],
        "readings.csv": ["station,point,az_rad,el_rad,d_mm", *_shots(points, rng)],
        "network.yaml": [NETWORK.rstrip()],
        "mount.yaml": [JOB.format(positions=positions).rstrip()],
    }
    for file, lines in texts.items():
        (folder / file).write_text("\n".join(lines) + "\n")
    return folder / "mount.yaml"


def _shots(points: dict[str, Array], rng: np.random.Generator) -> list[str]:
    """Return the readings of two levelled stations; the second sees the marks and every second target."""
    lines = []
    for station, place, turn in (("S1", np.zeros(3), 0.0), ("S2", np.array([8000.0, 500.0, 200.0]), 1.0)):
        for number, (name, point) in enumerate(points.items()):
            if station == "S1" or name[0] == "M" or number % 2:
                x, y, z = about(2, turn).T @ (point - place)
                d = np.sqrt(x * x + y * y + z * z)
                read = np.array([np.arctan2(y, x), np.arcsin(z / d), d]) + rng.normal(size=3) * [5e-6, 5e-6, 0.01]
                lines.append(f"{station},{name},{read[0]:.9f},{read[1]:.9f},{read[2]:.5f}")
    return lines
