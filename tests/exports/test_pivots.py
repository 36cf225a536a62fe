"""Lines of rotary axes for controls: test moves by 4 x 4 matrices, and the published formula of LinuxCNC."""

from __future__ import annotations

import re

import numpy as np
import pytest
from simulated import five_axis as sim

from metrocli.errors import InputError
from metrocli.exports import export
from metrocli.instruments.axes.rotary import location_names
from metrocli.result import Estimate, Result
from metrocli.table import Table

FORMATS = ("kinematics", "siemens-trafo5", "fanuc", "heidenhain")


def result_of(machine: sim.Machine, undetermined: str = "") -> Result:
    """A result that holds the locations of a machine."""
    letters = [one for one in "ABC" if one in machine.knots]
    left, right = machine.kind.chain.split("b")
    axes = Table.of(
        {
            "axis": letters,
            "place": [(left + right).index(one) + 1 for one in letters],
            "x y z [mm]": np.array([machine.kind.at[one] for one in letters]),
            "sense": [machine.sense.get(one, 1) for one in letters],
            "head": [one in right for one in letters],
        }
    )
    names = [name for one in letters for name in location_names(one)]
    estimates = tuple(
        Estimate(name, machine.place(name), 1e-4, "mm" if name[1] in "XYZ" else "rad")
        for name in names
        if name[1] != name[3]
    )
    balls = Table.of({"ball": ["K1"], "x y z [mm]": np.array([machine.kind.balls[0]])})
    return Result(
        kind="calibrate-machine", title="", estimates=estimates, covariance=np.eye(len(estimates)),
        statistics={"chain": f"w{machine.kind.chain}t", "undetermined": undetermined},
        tables={"rotary_axes": axes, "balls": balls},
    )  # fmt: skip


def located(kind: str, seed: int) -> sim.Machine:
    """A machine whose only errors are where its axes lie, without zero positions."""
    machine = sim.drawn(sim.KINDS[kind], np.random.default_rng(seed), linear=False)
    machine.tables = {}
    machine.places = {name: value for name, value in machine.places.items() if name[1] != name[3] and name[3] != "S"}
    return machine


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("kind", sim.KINDS)
def test_what_the_test_move_shows(kind: str, sense: int) -> None:
    """The control moves by the machine without errors; the ball less the tip is what the true one shows."""
    machine = located(kind, 3)
    machine.sense = dict.fromkeys("ABC", sense)
    text = export("kinematics", result_of(machine))["kinematics.csv"]
    assert isinstance(text, str)
    ball, perfect = np.append(machine.kind.balls[0], 1.0), machine.perfect()
    for letter in (one for one in "ABC" if one in machine.knots):
        true = [machine.joint(letter, angle) for angle in (0.0, np.pi / 2)]
        listed = perfect.joint(letter, np.pi / 2)
        if letter in machine.kind.chain.split("b")[1]:
            tip = true[1] @ ball - listed @ ball - (true[0] @ ball - ball)
            expected = -tip[:3]
        else:
            turned = [np.linalg.inv(one) @ ball for one in (*true, listed)]
            expected = (turned[1] - turned[2] - (turned[0] - ball))[:3]
        shown = re.search(rf"{letter}: \((.*?)\) um before, \((.*?)\) um after", text)
        assert shown is not None
        assert np.fromstring(shown[1], sep=",") == pytest.approx(1e3 * expected, abs=0.06)
        assert np.fromstring(shown[2], sep=",") == pytest.approx(np.zeros(3), abs=0.01)


def test_linuxcnc_turns_about_the_lines_that_were_found() -> None:
    """The forward formula of xyzac-trt-kins, with conventional directions, against the chain of the contract."""
    machine = located("table-table", 4)
    machine.places = {name: value for name, value in machine.places.items() if name[1] in "XYZ"}
    text = export("linuxcnc", result_of(machine))["kinematics.hal"]
    assert isinstance(text, str)
    pins = {name: float(value) for name, value in re.findall(r"xyzac-trt-kins\.([a-z-]+) (\S+)", text)}
    assert pins.pop("conventional-directions") == 1
    rng = np.random.default_rng(5)
    for _ in range(10):
        a, c, joints = rng.uniform(-1.5, 0.5), rng.uniform(0, 6), rng.uniform(-300, 0, 3)
        centre = np.array([pins[f"{axis}-rot-point"] for axis in "xyz"])
        offset = np.array([0.0, pins["y-offset"], pins["z-offset"]])
        # a table turns by minus its coordinate, so the tip turns by plus it: first about A, then about C
        tip = sim.about(2, c)[:3, :3] @ (sim.about(0, a)[:3, :3] @ (joints - centre - offset) + offset) + centre
        pose = {"X": joints[0], "Y": joints[1], "Z": joints[2], "A": a, "C": c}
        assert tip == pytest.approx(machine.tip(pose, np.zeros(3)), abs=1e-4)


@pytest.mark.parametrize("kind", sim.KINDS)
def test_transformations_of_heidenhain_follow_each_other_to_the_lines(kind: str) -> None:
    """Each acts in the coordinates that the ones before it have shifted and turned."""
    held = result_of(located(kind, 9))
    texts = export("kinematics", held)["kinematics.csv"], export("heidenhain", held)["heidenhain-kinematics.txt"]
    listed, shifts = ([line for line in str(text).splitlines() if line[0] not in "#;"] for text in texts)
    lines = {row[0]: np.array(row[3:6] + row[9:12], dtype=float) for row in (line.split(",") for line in listed[1:])}
    frames = {"table": np.eye(4), "head": np.eye(4)}
    for side, letter, *numbers in (line.split(";") for line in shifts):
        shift, turns = np.array(numbers, dtype=float).reshape(2, 3)
        frames[side], axis = frames[side] @ sim.placed(shift, np.radians(turns)), "ABC".index(letter)
        assert frames[side][:3, 3] == pytest.approx(lines[letter][:3], abs=2e-5)
        assert frames[side][:3, axis] == pytest.approx(lines[letter][3:], abs=5e-8)
    assert len(shifts) == len(lines)


@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_written_of_what_is_not_determined(name: str) -> None:
    with pytest.raises(InputError, match="do not determine EY0A"):
        export(name, result_of(located("table-table", 6), "EY0A"))


@pytest.mark.parametrize("kind", sim.KINDS)
def test_an_axis_that_counts_the_other_way_turns_the_other_way_in_the_control(kind: str) -> None:
    """Fanuc: 0 turns the part that moves right-handed (19684, 19689); Siemens: the axis reversed."""
    right, left = located(kind, 10), located(kind, 10)
    left.sense = dict.fromkeys("ABC", -1)
    read = {}
    for sense, machine in ((1, right), (-1, left)):
        held = result_of(machine)
        fanuc, ini = export("fanuc", held)["fanuc-kinematics.txt"], export("siemens-trafo5", held)["trafo5.ini"]
        turns = [int(one) for one in re.findall(r"N196(?:84|89) P(\d)", str(fanuc))]
        axes = np.array(re.findall(r"TRAFO5_AXIS\d_1\[\d\]=(\S+)", str(ini)), dtype=float)
        read[sense] = turns, axes
        for name in FORMATS:
            (text,) = export(name, held).values()
            assert str(text).count("counts the other way") == (2 if sense < 0 else 0)
    heads = kind.split("-").count("head")
    assert read[1][0] == [0] * heads + [1] * (2 - heads)
    assert [1 - one for one in read[1][0]] == read[-1][0]
    assert read[-1][1] == pytest.approx(-read[1][1])


def test_linuxcnc_counts_both_axes_alike() -> None:
    machine = located("table-table", 11)
    machine.sense = {"A": -1, "C": -1}
    assert "conventional-directions 0" in str(export("linuxcnc", result_of(machine))["kinematics.hal"])
    machine.sense = {"A": 1, "C": -1}
    with pytest.raises(InputError, match="both the other way"):
        export("linuxcnc", result_of(machine))


def test_vectors_of_siemens_close() -> None:
    for kind, number in (("table-table", 40), ("head-table", 56), ("head-head", 24)):
        text = export("siemens-trafo5", result_of(located(kind, 7)))["trafo5.ini"]
        assert isinstance(text, str)
        assert f"$MC_TRAFO_TYPE_1={number}" in text
        vectors: dict[str, list[float]] = {}
        for vector, value in re.findall(r"TRAFO5_(\w+)_1\[\d\]=(\S+)", text):
            vectors.setdefault(vector, []).append(float(value))
        offsets = np.array([value for vector, value in vectors.items() if "AXIS" not in vector])
        assert offsets.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-4)
        assert np.linalg.norm(vectors["AXIS1"]) == pytest.approx(1.0, abs=1e-6)


def test_other_machines_have_no_lines_to_write() -> None:
    with pytest.raises(InputError, match="no rotary axes"):
        export("kinematics", Result("calibrate-machine", "", (), np.zeros((0, 0)), {}, {}))
    with pytest.raises(InputError, match="a table C on a tilting table"):
        export("linuxcnc", result_of(located("head-head", 8)))
