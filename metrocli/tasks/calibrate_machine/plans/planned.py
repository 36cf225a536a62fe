"""What a planned measurement of a machine will determine, and what is wanted of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.axes.kinematics import reach
from metrocli.instruments.machine import TOOL, Machine
from metrocli.instruments.machine_path import Path
from metrocli.instruments.tracker import LEG, TRACKER, leg_block, path_chain, tracker_block
from metrocli.nc_program import Block as NcBlock
from metrocli.nc_program import Dwell, Feed, Rapid, Stop, program
from metrocli.plan import Plan
from metrocli.result import Estimate, ShownTable
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import KIND
from metrocli.tasks.calibrate_machine.described import error_blocks, machine_of, tool_prior
from metrocli.tasks.calibrate_machine.methods.on_the_fly import READINGS, path_of
from metrocli.tasks.calibrate_machine.plans.path_search import ChosenPath, PathRequirements, edges_and_diagonals, search
from metrocli.tasks.calibrate_machine.plans.settings import PathPlan
from metrocli.tasks.calibrate_machine.problem import MachineProblem, conditions, model_of, tool_column, tools_used
from metrocli.tasks.calibrate_machine.rank.identifiability import Identifiability, identify
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.tables import Determination, Tables, tables_of, unit_of
from metrocli.tasks.calibrate_machine.volume_report import volume_tables
from metrocli.tasks.calibrate_machine.warnings import identifiability_notes

_MARGIN = 0.97
"""The search stops at this share of the wanted ratio, since the ratio of the final path differs a little"""
REST = 0.5
"""Rest at each vertex or point [s]"""
PLACES = ("positions are machine coordinates of the spindle reference point, no length offset",)
_GAUSS = np.sqrt(0.6)
_NODES, _WEIGHTS = np.array([-_GAUSS, 0.0, _GAUSS]) / 2 + 0.5, np.array([5.0, 8.0, 5.0]) / 18.0


def planned_problem(settings: Settings, path: Path) -> MachineProblem:
    """Return the adjustment problem of a planned path, with readings at the three Gauss nodes of each cell."""
    machine, plan = machine_of(settings), settings.plan
    pose = tracker_pose(machine.low, machine.high, plan)
    rotation = poses.rotation_of(pose)
    blocks: dict[str, Block] = {
        **error_blocks(machine, settings),
        TRACKER: tracker_block(pose, settings.machine.tool_std),
        LEG: leg_block(path.across @ rotation),
    }
    leg, along, length = _nodes(machine, path, settings.corner)
    position = path.at(leg, along)
    seen = poses.apply(poses.inverse(pose), (position + blocks[TOOL].values[path.tool[leg]].T).T).T
    across = blocks[LEG].values[leg].reshape(-1, 2, 3)
    points = length / (plan.feed * plan.sampling)
    covariance = np.einsum("nab,bcn,ndc->adn", across, settings.noise.of_tracker.covariance(seen), across) / points
    observations = Observations(
        np.zeros((2, len(leg))),
        np.ones(1),
        machine.index(position) | {TOOL: path.tool[leg], LEG: leg},
        covariance=covariance,
        conditions=conditions(machine, position),
        components=("a", "b"),
        unit="mm",
    )
    group = Group(READINGS, path_chain(reach(machine)), observations)
    model = model_of(blocks, group, tool_prior(blocks, settings))
    return MachineProblem(model, machine, length, tools_used(settings, path.tool))


def tracker_in_words(low: Array, high: Array, plan: PathPlan) -> str:
    """Return where a plan takes the tracker to stand beside a volume, and what gives another place."""
    at = ", ".join(f"{value:.0f}" for value in tracker_pose(low, high, plan)[:3].tolist())
    taken = "as the job has it" if plan.tracker is not None else "assumed; `plan: {tracker: [..]}` gives another place"
    return f"tracker at ({at}) mm in the machine, {taken}"


def tracker_pose(low: Array, high: Array, plan: PathPlan) -> Array:
    """Return the unrotated pose of the tracker, at the place in the settings or at a default place beside a volume.

    The default place lies beyond the low ends of X and Y, by 1.5 and 1.2 times the longest side.
    """
    size = high - low
    place = low - np.array([1.5, 1.2, -0.5]) * size.max() if plan.tracker is None else np.array(plan.tracker)
    return np.concatenate([place, np.zeros(3)])


def _nodes(machine: Machine, path: Path, corner: float) -> tuple[Index, Array, Array]:
    """Return leg, distance along it and represented length of the three Gauss nodes of every cell.

    The corner lengths at both ends of each leg are left out.
    """
    low, high = path.cells(machine)[:-1], path.cells(machine)[1:]
    leg = path.leg_of((low + high) / 2)
    begin, end = low - path.before[leg], high - path.before[leg]
    begin, end = np.maximum(begin, corner), np.minimum(end, path.lengths[leg] - corner)
    keep = end - begin > 1e-3
    leg, begin, end = leg[keep], begin[keep], end[keep]
    size = (end - begin)[:, None]
    return np.repeat(leg, 3), (begin[:, None] + size * _NODES).ravel(), (size * _WEIGHTS).ravel()


def plan_of_path(settings: Settings, table: Table | None) -> Plan:
    """Return what the path of the job will determine, and propose a path with its NC program."""
    wanted = settings.plan
    machine = machine_of(settings)
    own = []
    if table is not None:
        listed = path_of(settings, machine, table)
        head = f"the path of the job: {len(listed.lengths)} legs, {listed.length:.0f} mm"
        own = judged(head, settings, lambda: planned_problem(settings, listed))
    longest = wanted.length or edges_and_diagonals(machine).length
    asked = PathRequirements(longest, wanted.ratio * _MARGIN, len(settings.tools), wanted.seed)
    chosen = search(machine, lambda path: planned_problem(settings, path), asked)
    path = Path.of(chosen.vertices, chosen.tool)
    worth = worth_of(settings, planned_problem(settings, path))
    time, ratio = float(travelled_time(path, wanted.feed)), worth.identified.ratio
    warnings = (
        []
        if ratio <= wanted.ratio
        else [f"the best path found has a ratio of {ratio:.1f}, more than {wanted.ratio:g}: allow a longer path"]
    )
    notes = [
        *own,
        f"proposed: {len(path.lengths)} legs, {path.length:.0f} mm of at most {longest:.0f} mm, {time:.0f} s",
        tracker_in_words(machine.low, machine.high, wanted),
    ]
    figures = (Estimate("path_length", path.length, 0.0, "mm"), Estimate("duration", time, 0.0, "s"))
    files: dict[str, Table | str] = {
        "path.csv": _path_table(settings, chosen),
        "path.nc": _program(settings, chosen),
    }
    return planned(notes, figures, worth, files, warnings)


@dataclass(frozen=True)
class Worth:
    """What planned readings will determine, and how well."""

    identified: Identifiability
    errors: Table
    volumetric: Table | None
    """None where the positioning of single axes is read alone"""


def worth_of(settings: Settings, problem: MachineProblem) -> Worth:
    """Return what the planned readings will determine; raises UndeterminedError if the volume is not determined."""
    identified = identify(problem)
    solution = covariance_at(identified.blocks.values(), problem.groups)
    if not solution.outcome.good:
        raise UndeterminedError(f"the planned readings do not determine the machine: {solution.outcome.value}")
    tables = tables_of(problem.machine, solution, settings.scales)
    volume = None
    if not problem.positioning_alone:
        volume = volume_tables(tables, identified, settings.volume, problem.tools_used)["volumetric"]
    return Worth(identified, predicted_errors(tables, identified), volume)


def worth_or_lack(settings: Settings, problem: Callable[[], MachineProblem]) -> Worth | UndeterminedError:
    """Return what the readings of a problem will determine, or what they leave open."""
    try:
        return worth_of(settings, problem())
    except UndeterminedError as error:
        return error


def judged(head: str, settings: Settings, problem: Callable[[], MachineProblem]) -> list[str]:
    """Return lines of text on what the readings of the job will determine."""
    worth = worth_or_lack(settings, problem)
    lines = identifiability_notes(worth.identified) if isinstance(worth, Worth) else str(worth).splitlines()
    return [head, *(f"  {line}" for line in lines), ""]


def planned(
    notes: Sequence[str],
    figures: Sequence[Estimate],
    worth: Worth,
    files: Mapping[str, Table | str],
    warnings: Sequence[str],
) -> Plan:
    """Return the plan with the figures, tables, files and warnings of the proposed readings.

    What these will determine follows the other notes.
    """
    volume = {} if worth.volumetric is None else {"volumetric": worth.volumetric}
    ratio = (Estimate("ratio", worth.identified.ratio, 0.0, "1"),) if volume else ()
    return Plan(
        KIND.name,
        (*notes, *identifiability_notes(worth.identified)),
        (*ratio, *figures),
        {"errors": worth.errors, **volume},
        files,
        tuple(warnings),
        (ShownTable("errors"), *(ShownTable(name, ("tool", "uncertainty")) for name in volume)),
    )


def travelled_time(path: Path, feed: float) -> float:
    """Return the duration of a path at a feed [s], including the rests at the vertices."""
    return float(path.length / feed + REST * (len(path.lengths) + 1))


def predicted_errors(tables: Tables, identified: Identifiability) -> Table:
    """Return for each error whether it will be determined, and its largest standard uncertainty."""
    names = [name for name in identified.names if identified.status[name] != Determination.NOT_ESTIMATED]
    std = [tables.of(name)[2].max() for name in names]
    open_ones = np.array([identified.status[name] == Determination.UNDETERMINED for name in names])
    return Table.of(
        {
            "error": names,
            "status": [identified.status[name] for name in names],
            "with": [" ".join(identified.partners.get(name, ())) for name in names],
            "largest_std": np.where(open_ones, np.inf, std),
            "unit": [unit_of(name) for name in names],
        }
    )


def _path_table(settings: Settings, path: ChosenPath) -> Table:
    table = Table.of({"x y z [mm]": path.vertices})
    feed = {"feed [mm/s]": np.full(len(path.tool), settings.plan.feed)}
    return table.joined({**tool_column(settings, path.tool), **feed})


def _program(settings: Settings, path: ChosenPath) -> str:
    """Return the path as an NC program: positions of the spindle's reference point, without tool length offset."""
    names = list(settings.tools)
    blocks: list[NcBlock] = []
    for i, vertex in enumerate(path.vertices):
        to = dict(zip("XYZ", vertex.tolist(), strict=True))
        if i == 0 or path.tool[i] != path.tool[i - 1]:
            blocks += [Stop(f"mount reflector {names[path.tool[i]]}".strip()), Rapid(to), Dwell(REST)]
        else:
            blocks += [Feed(to, settings.plan.feed), Dwell(REST)]
    remarks = [*PLACES, "the reflector faces the tracker; exact stop at every vertex"]
    return program("metrocli path for calibrate-machine", remarks, blocks, settings.plan.control)
