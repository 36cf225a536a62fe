"""Small measurements with a camera, at the truth, in which effects can be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from simulated import camera as sim

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model, Place
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments import spindle_camera as spindle
from metrocli.tasks.align_part.problem import places_of

LENS = {"f": 2600.0, "cx": 1210.0, "cy": 885.0, "k1": -0.12, "k2": 0.09}
TAPER = np.array([[-2.1, 0.8, -320.0, 0.003, -0.002, 0.04]])


def calibration(effect: Effect) -> Model:
    """A board in eight views; for effects on a list of targets that is not a board, points in space in eight views.

    What the effect frees is not free before; poses are known where the effect is the scale, which they would take in.
    """
    rig = "network" if effect.link and effect.link("", {"target": ""}).takes is Quantity.POINT_ON_TARGETS else "board"
    rng = np.random.default_rng(3)
    points = rng.uniform(-120, 120, (30, 3)) if rig == "network" else sim.board()
    seen = sim.look(points, 8, 5)
    views = poses.inverse(seen.poses) if rig == "network" else seen.poses
    own = [p.name for p in effect.parameters]
    view = camera.view_block(views, [f"V{i}" for i in range(8)], 700.0)
    blocks = {
        "lens": camera.lens_block(LENS, [name for name in LENS if name not in own], sim.SIZE),
        "view": view.fixed() if effect.name == "scale-of-targets" else view,
        "target": camera.target_block(points, [f"T{i}" for i in range(len(points))], False, 200.0),
    }
    index = {"view": seen.view, "target": seen.target, "turn": seen.view % 2, "series": seen.view % 2}
    group = _images(camera.chain(rig, "forward"), index, seen.view)
    places = {"image": Place(blocks["view"].members, "view"), "target": Place(blocks["target"].members, "target")}
    places |= {"turn": Place(("0", "90"), "turn"), "series": Place(("a_", "b_"), "series")}
    return with_predicted(Model(blocks, (group,), None, ("images",), places))


def alignment(effect: Effect) -> Model:
    """Twelve images of six targets of a part, with the spindle turned between them; 6D for the clamping angle."""
    rng = np.random.default_rng(6)
    points = rng.uniform(-90, 90, (6, 3)) * [1, 1, 0.5]
    turned = np.column_stack([np.zeros((12, 2)), np.tile([0, np.pi / 2, np.pi, -np.pi / 2], 3)])
    places = np.column_stack([rng.uniform(-60, 60, (12, 2)), np.linspace(-350, -100, 12)])
    held = poses.pose_from_euler(places, turned)
    part = poses.pose_from_euler(np.array([10.0, -15.0, 500.0]), np.array([0.1, -0.05, 0.3]))
    names = ["lens", "camera", "part", "coupling", "target", "spindle"]
    made = (
        camera.lens_block(LENS, (), sim.SIZE),
        Block("camera", TAPER, poses.COLUMNS, free=np.array(False), space=Space.POSE),
        spindle.part_block(part, 200.0, 800.0),
        spindle.coupling_block(0.01, effect.name != "clamping-angle"),
        camera.target_block(points, [f"C{i}" for i in range(6)], False, 200.0),
        spindle.spindle_block(held, [f"I{i}" for i in range(12)]),
    )
    blocks = dict(zip(names, made, strict=True))
    view, target = np.repeat(np.arange(12), 6), np.tile(np.arange(6), 12)
    index = {"target": target, "spindle": view, "view": view}
    group = _images(spindle.chain("forward"), index, view)
    return with_predicted(
        Model(blocks, (group,), None, ("images",), places_of(blocks["spindle"].members, blocks["target"].members))
    )


def _images(chain: Chain, index: dict[str, Array], view: Array) -> Group:
    rng = np.random.default_rng(9)
    conditions = {
        "t": 60.0 * view + 17.0,
        "temp": 20 + 0.1 * rng.normal(size=8 + 12)[view],
        "radius": np.full(len(view), 6.0),
    }
    observations = Observations(
        np.zeros((2, len(view))), np.array(0.05), index, conditions=conditions, components=("u", "v")
    )
    return Group("images", chain, observations)


def with_predicted(model: Model) -> Model:
    """The model with the readings that it predicts."""
    groups = tuple(
        group.with_observations(group.observations.with_readings(group.chain.predict(model.blocks, group.observations)))
        for group in model.groups
    )
    return replace(model, groups=groups)
