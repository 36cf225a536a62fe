"""The error motion of rotary axes, against the motion of a point of the axis by matrices that share no code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from simulated import five_axis as sim

from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.tasks.calibrate_machine import task as calibrate_machine


def test_the_ranges_are_those_of_the_turning_part(tmp_path: Path) -> None:
    rng = np.random.default_rng(41)
    machine = sim.drawn(sim.KINDS["table-table"], rng, linear=False)
    machine.tables |= {f"E{d}A": np.zeros(len(machine.knots["A"])) for d in "XYZABC"}
    machine.places = dict.fromkeys(machine.places, 0.0)
    file = load(sim.probed(tmp_path, machine, rng, 150, 2e-4))
    held = calibrate_machine.TASK.job(file.settings, effects=file.effects, **read_inputs(file))
    table = calibrate_machine.run(held).tables["rotary_motion"]
    pose, at = dict.fromkeys(machine.knots, 0.0), np.array(machine.kind.at["C"])
    moved, radial, tilted = [], [], []
    for knot in machine.knots["C"]:
        true, nominal = (one.sides(pose | {"C": float(knot)})[0] for one in (machine, machine.perfect()))
        moved.append((true @ np.append(at, 1.0) - nominal @ np.append(at, 1.0))[:3])
        turn = true[:3, :3] @ nominal[:3, :3].T
        small = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
        radial.append(moved[-1] @ nominal[:3, 0])
        tilted.append(small @ nominal[:3, 0])
    expected = {("radial", "X"): np.array(moved)[:, 0], ("radial", "Y"): np.array(moved)[:, 1]}
    expected |= {("axial", "Z"): np.array(moved)[:, 2]}
    expected |= {("radial", "rotating"): np.array(radial), ("tilt", "rotating"): np.array(tilted)}
    rows = list(zip(table.texts("axis"), table.texts("motion"), table.texts("direction"), strict=True))
    for (motion, direction), values in expected.items():
        row = rows.index(("C", motion, direction))
        found, u = table.numbers("range")[row], table.numbers("U_range")[row]
        assert abs(found - np.ptp(values)) < 1.5 * u, (motion, direction)
        assert u < 0.3 * found
        # the mean is not an error of the motion
        assert abs(table.numbers("high")[row] - (values - values[:-1].mean()).max()) < 2 * u
