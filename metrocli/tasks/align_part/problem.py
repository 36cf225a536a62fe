"""The adjustment of a part's alignment, with starting values, and the mirrored pose of targets in one plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index
from metrocli.effects.extension import with_known_effect
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.errors import Fault, InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import spindle_camera as spindle
from metrocli.instruments.camera import LENS, TAPER, TARGET, list_datum, target_block
from metrocli.tasks.align_part.camera import CameraModel
from metrocli.tasks.align_part.effects import EFFECTS, EXPANSION
from metrocli.tasks.align_part.exchanged import refuse_exchanged
from metrocli.tasks.align_part.fitted_targets import TargetList
from metrocli.tasks.align_part.spindle_poses import SpindlePoses, note_of
from metrocli.tasks.shared.images.adjustment import IMAGES, AdjustedImages
from metrocli.tasks.shared.images.eccentricity import corrected
from metrocli.tasks.shared.images.exposures import Exposures
from metrocli.tasks.shared.images.sightings import Sighted, check_inside, placed
from metrocli.tasks.shared.images.simulation import ExactImagePoints, SimulatedCamera, all_images, image_group
from metrocli.tasks.shared.images.target_list import images_needed
from metrocli.tasks.shared.joint_covariance import JointInput
from metrocli.tasks.shared.part import Part
from metrocli.words import counted, in_a_row

_ANGLES = np.linspace(-np.pi, np.pi, 12, endpoint=False)
"""Clamping angles [rad] to start from, if the start at 0 fails"""
_GOOD = 0.01
"""RMS angle between rays and targets [rad] below which a start is accepted"""


@dataclass(frozen=True)
class AlignmentProblem(Modelled):
    """An alignment ready to adjust."""

    camera: CameraModel
    sighted: Sighted
    warnings: tuple[str, ...] = ()
    part: Part | None = None
    """The part in the machine, where its temperature is known"""
    notes: tuple[str, ...] = ()
    sources: Mapping[str, JointInput] = field(default_factory=dict)
    """The calibrated machine, if its errors are unknowns, by the name of its input"""

    def with_part(self, part: Part) -> AlignmentProblem:
        """Return a copy whose part has grown from 20 degC, by an unknown that its temperature observes."""
        expansion = next(effect for effect in EFFECTS if effect.name == EXPANSION)
        size = expansion.parameters[0].name
        model = with_known_effect(self.model, expansion, {size: part.growth}, {size: part.std})
        return replace(self, model=model, part=part)

    @property
    def images(self) -> Group:
        """The image points."""
        return self.model.group(IMAGES)

    @property
    def free_angle(self) -> bool:
        """Whether the clamping angle is estimated (7D)."""
        return bool(self.blocks[spindle.COUPLING].free.any())


def places_of(exposures: Sequence[str], targets: Sequence[str]) -> dict[str, Place]:
    """Return the places where effects can act: exposures, targets, axes and pairs of axes of the machine.

    Those of a single camera are its images.
    """
    return {
        "image": Place(tuple(exposures), "view"),
        "target": Place(tuple(targets), TARGET),
        "axis": Place(("x", "y", "z")),
        "pair": Place(("xy", "xz", "yz")),
    }


def build(
    camera: CameraModel, sighted: Sighted, commanded: SpindlePoses, free_angle: bool, listed: TargetList
) -> AlignmentProblem:
    """Return the adjustment with its starting values, found from the sightings alone.

    Raises InputError if readings do not fit the image size, if an image has no spindle pose, or if the machine's result
    does not give the errors there.
    """
    exposed = camera.exposed(sighted.images)
    sighted = check_inside(sighted, camera.sizes[exposed.camera[sighted.view]].T)
    sighted = placed(sighted, images_needed(sighted.targets))
    rows, warnings, sighted = _with_poses(sighted, exposed, commanded, camera.images)
    motion = commanded.motion(rows)
    spindle_poses = commanded.moved(rows, motion.mean)
    targets = sighted.targets
    seen = np.bincount(sighted.target, minlength=len(targets.names)) > 0
    pose, angle = _start(camera, sighted, exposed, spindle_poses, free_angle)
    extent = float(np.ptp(targets.points[seen], axis=0).max())
    free = (targets.sigma != 0) & seen[:, None]
    distance = float(
        np.linalg.norm(spindle_poses[:, :3] - (poses.apply(pose, targets.points[seen].mean(axis=0))), axis=1).mean()
    )
    made = (
        spindle.part_block(pose, extent, distance),
        spindle.coupling_block(angle, free_angle),
        *camera.blocks().values(),
        target_block(targets.points, targets.names, free, max(extent, 1.0)),
        spindle.spindle_block(spindle_poses, exposed.names),
        *spindle.machine_blocks(motion.spread),
    )
    blocks = {block.name: block for block in made}
    group = Group(IMAGES, camera.chain(motion.spread), _of_exposures(exposed, sighted.observations))
    others: tuple[Group, ...] = (
        *camera.prior(),
        *listed.priors(blocks[TARGET], targets.sigma, free),
        *spindle.machine_priors(motion.spread),
    )
    takes_part = free.any(axis=1).astype(float)
    datum = list_datum(blocks[TARGET], takes_part, spindle.PART, scale=False) if free.any() else None
    if sighted.eccentric:
        group, blocks = corrected(group, blocks, others, datum, targets.radius)
    places = places_of(exposed.names, targets.names)
    places |= {"camera": Place(camera.names, LENS)} if camera.names[1:] else {}
    nominal = {TARGET: targets.points}
    model = Model(blocks, (group, *others), datum, (IMAGES,), places, nominal=nominal)
    notes = () if commanded.machine is None else (note_of(motion),)
    all_warnings = (*camera.warnings, *listed.warnings, *warnings, *commanded.warnings())
    sources = {"machine": JointInput(spindle.MACHINE, motion.turn, motion.digest)} if len(motion.turn) else {}
    return AlignmentProblem(model, camera, sighted, all_warnings, notes=notes, sources=sources)


def _of_exposures(exposed: Exposures, observations: Observations) -> Observations:
    """Return readings of images with their exposure, at which the spindle has one pose for all cameras."""
    observations = exposed.readings(observations)
    return observations.with_index({spindle.SPINDLE: observations.index["view"]})


def _with_poses(
    sighted: Sighted, exposed: Exposures, commanded: SpindlePoses, cameras: Mapping[str, str]
) -> tuple[Index, tuple[str, ...], Sighted]:
    """Return the row of each exposure's pose, warnings, and the sightings with time and temperature of the poses."""
    table, place = commanded.commanded, commanded.rows(cameras)
    missing = [number for number, name in enumerate(exposed.names) if name not in place]
    if missing:
        images = [sighted.images[int(np.argmax(exposed.exposure == number))] for number in missing]
        hint = "add a row with its spindle position"
        raise InputError([Fault(f"there is no pose for image '{name}'", table.file, hint=hint) for name in images])
    rows = np.array([place[name] for name in exposed.names], dtype=np.intp)
    exposures = set(exposed.names)
    unused = [name for name in place if name not in exposures]
    warnings = [f"{counted(len(unused), 'pose', 'have')} no sighting: {', '.join(unused[:8])}"] if unused else []
    warnings += [f"no image is that of {in_a_row(exposed.unused)}"] if exposed.unused else []
    of_reading = rows[exposed.exposure[sighted.view]]
    of_poses = {name: values[of_reading] for name, values in table.conditions("t", "temp").items()}
    conditions = {**of_poses, **sighted.observations.conditions}
    observations = replace(sighted.observations, conditions=conditions)
    return rows, tuple(warnings), replace(sighted, observations=observations)


def _start(
    camera: CameraModel, sighted: Sighted, exposed: Exposures, spindle_poses: Array, free_angle: bool
) -> tuple[Array, float]:
    """Return the starting pose of the part and the starting clamping angle: 0, or the best of twelve if 0 fails."""
    uv, of = sighted.observations.readings, exposed.camera[sighted.view]
    seen = np.full((3, uv.shape[1]), np.nan)
    for number, stated in enumerate(camera.cameras):
        mine = of == number
        seen[:, mine] = stated.direction(uv[:, mine])
    seen = np.where(np.isfinite(seen[0]), seen, [[0.0], [0.0], [1.0]])
    points = sighted.targets.points[sighted.target]
    image, in_taper = exposed.exposure[sighted.view], camera.in_taper[of]

    def tried(angle: float) -> tuple[Array, float]:
        return spindle.start_pose(spindle.rays(spindle_poses[image], in_taper, angle, seen, points))

    best, misfit = tried(0.0)
    chosen = 0.0
    if free_angle and misfit > _GOOD:
        for angle in _ANGLES:
            pose, value = tried(float(angle))
            if value < misfit:
                best, misfit, chosen = pose, value, float(angle)

    def lines(order: Index, some: Index) -> list[spindle.Rays]:
        at = spindle_poses[order][image[some]]
        return [spindle.rays(at, in_taper[some], turn, seen[:, some], points[some]) for turn in {0.0, chosen}]

    if misfit > _GOOD:
        refuse_exchanged(exposed.names, image, misfit, lines)
    return best, chosen


@dataclass(frozen=True)
class AlignmentTruth:
    """True poses and clamping angle of a simulation."""

    part: Array
    """Pose of the part in the machine (6,)"""
    spindle_poses: Mapping[str, Array]
    """Pose of the spindle (6,) at each exposure"""
    angle: float
    """Clamping angle [rad]"""


def true_model(
    camera: CameraModel, shown: Sequence[SimulatedCamera], seen: ExactImagePoints, truth: AlignmentTruth
) -> Model:
    """Return the model of the alignment at the truth, with the exact image points as readings.

    Effects are planted in this model.
    """
    exposed = camera.exposed(all_images(shown))
    made = (
        spindle.part_block(truth.part, 1.0, 1.0),
        spindle.coupling_block(truth.angle, free=False),
        target_block(shown[0].targets.points, shown[0].targets.names, False, 1.0),
        spindle.spindle_block(np.array([truth.spindle_poses[name] for name in exposed.names]), exposed.names),
    )
    blocks = {name: block.fixed() for name, block in camera.blocks().items()}
    blocks |= {block.name: block for block in made}
    group = image_group(shown, seen, camera.chain())
    group = group.with_observations(_of_exposures(exposed, group.observations))
    places = places_of(exposed.names, shown[0].targets.names)
    return Model(blocks, (group,), None, (IMAGES,), places, nominal={TARGET: shown[0].targets.points})


_FLAT = 0.1
"""Targets whose thickness is below this share of their extent lie nearly in one plane"""
_ALIKE = 10.83
"""Difference of chi-square up to which both poses fit alike: 0.1 % of chance, one degree of freedom"""
_APART = 6.0
"""Standard uncertainties from which two poses are not the same"""


def mirrored_pose(problem: AlignmentProblem, adjusted: AdjustedImages) -> AlignmentProblem | None:
    """Return the problem at the mirrored pose of the part where that fits better; None where the pose found is right.

    Raises UndeterminedError if both fit alike.
    """
    solution = adjusted.solution
    points = problem.sighted.targets.points[np.unique(problem.sighted.target)]
    _, thick, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    if not solution.outcome.good or thick[2] > _FLAT * thick[1]:
        return None
    part, angle = solution.blocks[spindle.PART], float(solution.blocks[spindle.COUPLING].values[0, 0])
    camera_poses = spindle.camera_in_machine(
        solution.blocks[spindle.SPINDLE].values, angle, solution.blocks[TAPER].values[0]
    )
    centre = points.mean(axis=0)
    sight = (poses.apply(part.values, centre) - camera_poses[:, :3].mean(axis=0)).reshape(1, 3)
    mirrored = part.with_values(poses.mirrored_about(part.values, sight, centre, axes[2]))
    # mirrored about the mean line of sight only a start: the adjustment finds the second minimum, if there is one
    turned = {**solution.blocks, spindle.PART: mirrored}
    other = adjust(turned.values(), solution.groups, problem.datum, StoppingRule(limit=60, covariance=False))
    step = poses.difference(other.blocks[spindle.PART].values, part.values)[0]
    apart = float(np.linalg.norm(step[3:])) > _APART * float(np.linalg.norm(solution.std(spindle.PART)[0, 3:]))
    # in units of the noise that the residuals show, if that is larger: a wrong sigma must not decide between poses
    change = (other.cost - solution.cost) / max(1.0, float(np.nan_to_num(solution.sigma0, nan=1.0))) ** 2
    if not apart or not np.isfinite(other.cost) or change > _ALIKE:
        return None
    if change < -_ALIKE:
        return replace(problem, model=problem.model.with_blocks({**problem.blocks, **other.blocks}))
    raise UndeterminedError(_alike(part.values[0], other.blocks[spindle.PART].values[0]), 0.0)


def _alike(first: Array, other: Array) -> str:
    angles = (np.degrees(poses.euler_form(pose)[3:]) for pose in (first, other))
    words = (f"alpha {a:.2f}, beta {b:.2f}, gamma {c:.2f} deg" for a, b, c in angles)
    return (
        "the images fit two poses of the part alike, since its targets lie nearly in one plane and are small or far "
        "away:\n" + "\n".join(f"  {text}" for text in words) + "\n  what decides: images from positions further apart "
        "or nearer, or a target out of the plane"
    )
