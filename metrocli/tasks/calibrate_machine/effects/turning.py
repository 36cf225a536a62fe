"""Effects on the rotary axes of a machine, and on balls on its workpiece; docs/effects describes each of them."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Space
from metrocli.effects.effect import Effect, Parameter, change_points, sizes
from metrocli.effects.links.motions import TURNING, Backlash
from metrocli.effects.links.turning import (
    AxisJump,
    BallMoves,
    EncoderEccentricity,
    LoadUnbalance,
    PivotDrift,
    Wobble,
    WormError,
)

_FEWEST, _MOST = 12, 720
"""Periods of a worm gear in a turn"""
_WOBBLES = 6
_OF_WORM = Parameter("periods", grid=lambda conditions: np.arange(_FEWEST, _MOST + 1.0), tried=_MOST, whole=True)
_OF_WOBBLE = Parameter("periods", grid=lambda conditions: np.arange(1.0, _WOBBLES + 1), tried=_WOBBLES, whole=True)
_AT = (Parameter("at", "time", grid=change_points),)
_LETTERS = tuple(TURNING)
TILTED = ("ac", "bc", "ab", "ca", "cb", "ba")
"""Pairs of tables, the one that tilts the other first"""
_ISO = "ISO 230-7:2015, axis of rotation error motions"


def _across(letter: str, names: str, dimension: str, plausible: str) -> tuple[Parameter, ...]:
    """Return a parameter for each direction across an axis: x and y for C."""
    kept = [name for name, own in zip(names.split(), TURNING, strict=True) if own != letter]
    return sizes(" ".join(kept), dimension, plausible)


def _listed(letter: str, names: str) -> str:
    return ", ".join(parameter.name for parameter in _across(letter, names, "length", "1 mm"))


def _jump(letter: str) -> Effect:
    return Effect(
        "axis-jump",
        "the line of a rotary axis was displaced at one time: a crash, or a clamp that gave way",
        _across(letter, "dx dy dz", "length", "1 mm"),
        lambda block, where: AxisJump(block, axis=where["axis"]),
        where=("axis",),
        among=(letter,),
        scanned=_AT,
        needs=("t",),
        confused_with=("pivot-drift", "moved-ball"),
        formula=f"o += ({_listed(letter, 'dx dy dz')})    where t >= at; o: place of the axis, across it",
        usual="1 to 100 um",
        reveal="the first poses again at the end, and a ball probed at several tilts throughout the run",
        source=_ISO,
    )


def _drift(letter: str) -> Effect:
    return Effect(
        "pivot-drift",
        "the line of a rotary axis moves while it warms up",
        _across(letter, "vx vy vz", "speed", "1 um/min"),
        lambda block, where: PivotDrift(block, axis=where["axis"]),
        where=("axis",),
        among=(letter,),
        needs=("t",),
        confused_with=("axis-jump", "machine-drift"),
        formula=f"o += ({_listed(letter, 'vx vy vz')}) t    # o: place of the axis, across it",
        usual="1 to 60 um/h",
        reveal="balls probed at several tilts throughout the run: a drift of the machine moves all of them alike",
        source="ISO 230-3:2020, thermal distortion caused by rotating components",
    )


OF_ROTARY_AXES: tuple[Effect, ...] = (
    Effect(
        "backlash",
        "the axis stops at another place when it arrives from the other side: play, friction and wind-up of its drive",
        sizes("width", "angle", "20 arcsec"),
        lambda block, where: Backlash(block, axis=where["axis"]),
        where=("axis",),
        among=_LETTERS,
        needs=("from_{axis}",),
        formula="angle += width/2    where from_axis = +1\nangle -= width/2    where from_axis = -1",
        usual="0.5 to 20 arcsec",
        reveal="the same poses approached from both sides",
        source="ISO 230-2:2014, reversal value B",
    ),
    Effect(
        "worm-error",
        "the angle of a rotary axis errs periodically: its worm gear, or the pitch of its encoder's lines",
        # steps of the phase go across the phasor (`Space.WAVE`), so their size is that of the amplitude
        sizes("amplitude phase", "angle", "20 arcsec"),
        lambda block, where: WormError(block, axis=where["axis"]),
        where=("axis",),
        among=_LETTERS,
        scanned=(_OF_WORM,),
        space=Space.WAVE,
        formula="angle += amplitude sin(periods s + phase)    # s: commanded angle",
        note="At equal steps a period that divides them is not seen: steps of 30 deg hide 36 and 72 periods.",
        usual="0.5 to 20 arcsec",
        reveal="poses at uneven steps: at equal steps a period that divides them is not seen",
        source="ISO 230-2:2014 (targets not at multiples of a period)",
    ),
    Effect(
        "encoder-eccentricity",
        "the graduation of a rotary encoder is off centre: the angle errs once a turn",
        sizes("c1 s1", "angle", "100 arcsec"),
        lambda block, where: EncoderEccentricity(block, axis=where["axis"]),
        where=("axis",),
        among=_LETTERS,
        confused_with=("worm-error",),
        formula="angle += c1 (cos s - cos s0) + s1 (sin s - sin s0)    # s0: zero of the table of the axis",
        note="The table of the angle contains it where that is estimated.",
        usual="1 to 100 arcsec",
        reveal="`estimate: rotary`, whose table of the angle contains it",
        source="Heidenhain, Angle encoders: eccentricity of the graduation",
    ),
    Effect(
        "wobble",
        "a rotary axis tilts periodically while it turns: its bearings, or a table that is screwed down unevenly",
        sizes("c1 s1 c2 s2", "angle", "20 arcsec"),
        lambda block, where: Wobble(block, axis=where["axis"]),
        where=("axis",),
        among=_LETTERS,
        scanned=(_OF_WOBBLE,),
        formula="first tilt += c1 cos ns + s1 sin ns    # EA of B and C, EB of A; n: periods\n"
        "other tilt += c2 cos ns + s2 sin ns    # EB of C, EC of A and B",
        note="The tables of the tilts contain it where they are estimated.",
        usual="0.2 to 20 arcsec",
        reveal="`estimate: rotary`, whose tables of the tilts contain it",
        source=_ISO,
    ),
    *(_jump(letter) for letter in TURNING),
    *(_drift(letter) for letter in TURNING),
    Effect(
        "load-unbalance",
        "a mass beside the axis of a table twists the drive of the axis that tilts it",
        sizes("c1 s1", "angle", "50 arcsec"),
        lambda block, where: LoadUnbalance(block, axis=where["pair"][0], carried=where["pair"][1]),
        where=("pair",),
        among=TILTED,
        formula="a += cos a (c1 cos c + s1 sin c)    # a: angle of the tilting table, c: of the other",
        usual="0.5 to 50 arcsec",
        reveal="poses at several angles of both tables, with the workpiece clamped and without it",
        source="ISO 230-1:2012, rotary axes under load",
    ),
    Effect(
        "moved-ball",
        "one ball or reflector on the workpiece was touched, and stands elsewhere from a time on",
        sizes("dx dy dz", "length", "1 mm"),
        lambda block, where: BallMoves(block),
        where=("ball",),
        scanned=_AT,
        needs=("t",),
        confused_with=("axis-jump",),
        formula="b += (dx, dy, dz)    where t >= at",
        usual="1 to 100 um",
        reveal="each ball probed again at the end",
        source="Baarda 1968 (mean shift of some readings)",
    ),
)
"""Effects on rotary axes and on what they carry"""
