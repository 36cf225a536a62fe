"""Effects on what trackers and total stations read : azimuth, elevation and distance, in both faces.

`face` is 1 in face 1 and -1 in face 2. An effect that changes its sign between the faces leaves their mean as it is.
"""

from __future__ import annotations

from collections.abc import Mapping

from metrocli.effects.effect import Effect, Parameter, sizes
from metrocli.effects.links.angles import polar_terms

_MURALIKRISHNAN = (
    "Muralikrishnan et al. 2009, ASME B89.4.19 performance evaluation tests and geometric misalignments in laser "
    "trackers, J. Res. NIST 114, 21-35; ASME B89.4.19-2021"
)
_FACE = "    # face: 1 in face 1, -1 in face 2"
_TWO_FACES = "some points in both faces of the tracker; the same points with the tracker at another height"


def _readings(
    name: str,
    cause: str,
    parameters: tuple[Parameter, ...],
    adds: Mapping[str, str],
    usual: str,
    reveal: str,
    confused_with: tuple[str, ...] = (),
    source: str = _MURALIKRISHNAN,
    note: str = "",
) -> Effect:
    """Return an effect that adds terms to the distance, azimuth or elevation that the tracker reads."""
    names = tuple(parameter.name for parameter in parameters)
    return Effect(
        name,
        cause,
        parameters,
        lambda block, where: polar_terms(block, name, names, adds),
        confused_with=confused_with,
        formula="\n".join(f"{reading} += {term}{_FACE if 'face' in term else ''}" for reading, term in adds.items()),
        note=note,
        usual=usual,
        reveal=reveal,
        source=source,
    )


TRACKER_EFFECTS: tuple[Effect, ...] = (
    _readings(
        "tracker-eccentricity",
        "the horizontal circle of the tracker is not centred on its axis",
        sizes("c1 s1", "angle", "20 arcsec"),
        {"azimuth": "face*(c1*cos(azimuth) + s1*sin(azimuth))"},
        "0.1 to 20 arcsec",
        "the same points from the other side of the machine, or with the tracker turned on its stand; two faces",
        ("tracker-scale", "tracker-azimuth-harmonic"),
        note="Over the azimuths of one machine it is a rotation and a slow bend, which error tables absorb.",
    ),
    _readings(
        "tracker-scale",
        "all distances of the tracker are too long or too short by one factor: wavelength or refractive index of air",
        sizes("scale", "ratio", "5 ppm"),
        {"distance": "scale*distance"},
        "0.1 to 5 ppm",
        "a calibrated length between two nests, measured by the tracker along its beam",
        ("tracker-eccentricity",),
        "the refractive index of air changes by 1 ppm/K and 0.27 ppm/hPa (Birch and Downs 1994)",
        note="With tool vectors that are not exact it is nearly invisible: only the distances between tools differ.",
    ),
    _readings(
        "tracker-range-zero",
        "the home distance of the tracker, or the constant of its reflector, is wrong: all distances are off alike",
        sizes("r0", "length", "0.1 mm"),
        {"distance": "r0"},
        "5 um to 0.1 mm",
        "a length between two nests measured from between them and from outside, in line with them",
        ("tracker-scale", "tracker-beam-offset"),
        note="The two lengths differ by 2 r0. Seen from one place, the tables of the machine absorb most of it.",
    ),
    _readings(
        "tracker-beam-offset",
        "the beam leaves the tracker beside the crossing point of its axes",
        sizes("h v", "length", "0.2 mm"),
        {"azimuth": "face*h/(distance*cos(elevation))", "elevation": "face*v/distance"},
        "5 um to 0.2 mm",
        "some points in both faces of the tracker, near to it and far from it",
        ("tracker-range-zero", "tracker-mirror-tilt"),
    ),
    _readings(
        "tracker-transit-tilt",
        "the tilt axis of the tracker is not square to its vertical axis",
        sizes("angle", "angle", "20 arcsec"),
        {"azimuth": "face*angle*tan(elevation)"},
        "0.5 to 20 arcsec",
        _TWO_FACES,
        ("tracker-mirror-tilt",),
    ),
    _readings(
        "tracker-mirror-tilt",
        "the beam leaves the tracker not square to its tilt axis: mirror or laser are tilted",
        sizes("angle", "angle", "20 arcsec"),
        {"azimuth": "face*angle/cos(elevation)"},
        "0.5 to 20 arcsec",
        _TWO_FACES,
        ("tracker-transit-tilt", "tracker-beam-offset"),
    ),
    _readings(
        "tracker-transit-offset",
        "the tilt axis of the tracker passes beside its standing axis",
        sizes("offset", "length", "0.2 mm"),
        {"distance": "-face*offset*cos(elevation)", "elevation": "face*offset*sin(elevation)/distance"},
        "5 um to 0.2 mm",
        _TWO_FACES,
        ("tracker-range-zero", "tracker-vertical-index"),
    ),
    _readings(
        "tracker-steering-mirror",
        "the mirror that steers the beam of the tracker is not square to its mount",
        sizes("angle", "angle", "20 arcsec"),
        {"azimuth": "face*angle/cos((pi/2 - elevation)/2)"},
        "0.5 to 20 arcsec",
        _TWO_FACES,
        ("tracker-mirror-tilt", "tracker-transit-tilt"),
        "reflection of a beam along the standing axis; Loser and Kyle 1999 (trackers with a beam steering mirror)",
        note="An instrument with its laser in the head has no such mirror: a job names it, `diagnose` does not.",
    ),
    _readings(
        "tracker-vertical-index",
        "the zero of the vertical circle of the tracker is off: all elevations are too large or too small alike",
        sizes("angle", "angle", "20 arcsec"),
        {"elevation": "face*angle"},
        "0.5 to 20 arcsec",
        _TWO_FACES,
        ("tracker-vertical-eccentricity",),
    ),
    _readings(
        "tracker-azimuth-harmonic",
        "the horizontal circle of the tracker has an error of two waves in a turn: its scale is oval or bent",
        sizes("c2 s2", "angle", "10 arcsec"),
        {"azimuth": "c2*cos(2*azimuth) + s2*sin(2*azimuth)"},
        "0.1 to 10 arcsec",
        "the same points with the tracker turned on its stand by a quarter of a turn",
        ("tracker-eccentricity",),
    ),
    _readings(
        "tracker-vertical-eccentricity",
        "the vertical circle of the tracker is not centred on its axis",
        sizes("c1 s1", "angle", "20 arcsec"),
        {"elevation": "c1*cos(elevation) + face*s1*sin(elevation)"},
        "0.1 to 20 arcsec",
        _TWO_FACES,
        ("tracker-vertical-index", "tracker-vertical-harmonic"),
    ),
    _readings(
        "tracker-vertical-harmonic",
        "the vertical circle of the tracker has an error of two waves in a turn: its scale is oval or bent",
        sizes("c2 s2", "angle", "10 arcsec"),
        {"elevation": "face*c2*cos(2*elevation) + s2*sin(2*elevation)"},
        "0.1 to 10 arcsec",
        "the same points with the tracker at another height, so that their elevations differ",
        ("tracker-vertical-eccentricity",),
    ),
    _readings(
        "tracker-air-gradient",
        "the refractive index of the air changes with height: the beam is bent, and its distance off",
        sizes("gradient", "curvature", "5e-9 1/mm"),
        {"distance": "gradient*distance**2*sin(elevation)/2", "elevation": "-gradient*distance*cos(elevation)/2"},
        "2e-10 to 5e-9 1/mm",
        "the temperature of the air at two heights; the same points with the tracker nearer",
        ("tracker-vertical-index", "tracker-scale"),
        "Birch and Downs 1994: -0.955 ppm/K, so 1 K/m is -9.55e-10 1/mm; Torge, Geodesy (refraction of a beam)",
    ),
)
"""The effects, in the order of lists"""
