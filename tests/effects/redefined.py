"""Effects of the catalogue written as user-defined effects: one line of `define:` for each."""

from __future__ import annotations

from dataclasses import dataclass

_DRIFT = "{vx: {unit: um/min, plausible: 1 um/min}, vy: {unit: um/min, plausible: 1 um/min}, vz: {unit: um/min, plausible: 1 um/min}}"
_SHIFT = "{dx: {unit: mm, plausible: 5 mm}, dy: {unit: mm, plausible: 5 mm}, dz: {unit: mm, plausible: 5 mm}}"
_SCALE = "{scale: {unit: ppm, plausible: 5 ppm}}"
_RATIO = "{scale: {unit: ppm, plausible: 500 ppm}}"
_GROW = "{x: scale*x, y: scale*y, z: scale*z}"
_TURN = "(c1*cos(azimuth) + s1*sin(azimuth))"
_TWO = "{c1: {unit: arcsec, plausible: 20 arcsec}, s1: {unit: arcsec, plausible: 20 arcsec}}"


@dataclass(frozen=True)
class Redefined:
    """An effect of the catalogue and its definition; places are those of the built-in one and of the own one."""

    kind: str
    name: str
    acts_on: str
    adds: str
    parameters: str
    where: str = ""
    built: tuple[str, ...] = ()
    own: tuple[str, ...] | None = None
    by: str = ""
    scan: str = ""

    @property
    def text(self) -> str:
        """The definition as YAML."""
        more = f", where: [{self.where}]" if self.where else ""
        more += f", scan: {self.scan}" if self.scan else ""
        return (
            f"define: [{{name: own-{self.name}, acts_on: {self.acts_on}, adds: {self.adds}, "
            f"parameters: {self.parameters}{more}}}]"
        )

    @property
    def at(self) -> tuple[str, ...]:
        """The place of the user-defined effect."""
        return self.built if self.own is None else self.own


def _wave(name: str) -> str:
    return f"{{{name}: 'amplitude*sin(2*pi*position/period + phase)'}}"


REDEFINED = (
    Redefined("multilaterate", "dead-path-drift", "length", "rate*t", "{rate: {unit: um/min, plausible: 1 um/min}}",
              "tracer", ("second",)),
    Redefined("multilaterate", "tracer-scale", "point-in-machine",
              "{x: scale*beam_x, y: scale*beam_y, z: scale*beam_z}", _SCALE, "tracer", ("second",)),
    Redefined("multilaterate", "length-scale", "length", "scale*distance", _RATIO),
    Redefined("multilaterate", "length-offset", "length", "offset", "{offset: {unit: mm, plausible: 1 m}}"),
    Redefined("multilaterate", "refraction-drift", "length", "rate*T*distance",
              "{rate: {unit: 1/K, plausible: 2e-6 1/K}}", by="T"),
    Redefined("multilaterate", "tracer-drift", "point-in-machine", "{x: -vx*t, y: -vy*t, z: -vz*t}", _DRIFT,
              "tracer", ("second",)),
    Redefined("multilaterate", "sphere-form", "length", "c2*cos(2*azimuth) + s2*sin(2*azimuth)",
              "{c2: {unit: um, plausible: 10 um}, s2: {unit: um, plausible: 10 um}}", "tracer", ("second",)),
    Redefined("multilaterate", "reflector-incidence", "length", "c*(1 + sin(elevation))",
              "{c: {unit: um, plausible: 20 um}}"),
    Redefined("locate-launch-unit", "encoder-offset", "angle", "offset", "{offset: {unit: deg, plausible: 1 deg}}",
              "encoder", ("phi2",)),
    Redefined("locate-launch-unit", "encoder-eccentricity", "angle", "c1*cos(angle) + s1*sin(angle)", _TWO,
              "encoder", ("phi2",)),
    Redefined("locate-launch-unit", "axis-nonorthogonality", "launch-angles", "{base: angle*tan(tilt)}",
              "{angle: {unit: deg, plausible: 1 deg}}", built=("launch",), own=()),
    Redefined("locate-launch-unit", "distance-scale", "distance", "scale*distance", _RATIO),
    Redefined("locate-launch-unit", "bad-pose", "point-in-machine", "{x: dx, y: dy, z: dz}", _SHIFT, "pose", ("second",)),
    Redefined("selfcal-grid", "artefact-expansion", "point-in-artefact", _GROW, _RATIO, "view", ("2",)),
    Redefined("selfcal-grid", "drift-in-view", "coordinates", "{x: vx*t, y: vy*t, z: vz*t}", _DRIFT, "view", ("2",)),
    Redefined("selfcal-grid", "axis-expansion", "coordinates", "{y: scale*y}", _RATIO, "view", ("2", "y"), ("2",)),
    Redefined("calibrate-machine", "backlash", "error-motion", "{along: width*approach/2}",
              "{width: {unit: um, plausible: 20 um}}", "axis", ("y",)),
    Redefined("calibrate-machine", "thermal-growth", "error-motion", "{along: rate*t*position}",
              "{rate: {unit: ppm/h, plausible: 60 ppm/h}}", "axis", ("y",)),
    Redefined("calibrate-machine", "load-sag", "error-motion", "{z: c*first*second}",
              "{c: {unit: 1/mm, plausible: 1e-6 1/mm}}", "pair", ("xz",)),
    Redefined("calibrate-machine", "screw-pitch-error", "error-motion", _wave("along"),
              "{phase: {unit: rad, plausible: 6.3 rad}, amplitude: {unit: um, plausible: 10 um}}", "axis", ("y",),
              scan="{period: {from: 2 mm, to: 50 mm, steps: 100}}"),
    Redefined("calibrate-machine", "tracker-eccentricity", "point-in-tracker",
              f"{{x: 'x*(cos{_TURN} - 1) - y*sin{_TURN}', y: 'y*(cos{_TURN} - 1) + x*sin{_TURN}'}}", _TWO),
    Redefined("calibrate-machine", "tracker-scale", "coordinates", _GROW, _SCALE),
    Redefined("calibrate-machine", "tracker-drift", "point-in-machine", "{x: -vx*t, y: -vy*t, z: -vz*t}", _DRIFT),
    Redefined("calibrate-machine", "dead-path-drift", "length", "rate*t", "{rate: {unit: um/min, plausible: 1 um/min}}",
              "tracer", ("second",)),
    Redefined("calibrate-machine", "tracer-scale", "point-in-machine",
              "{x: scale*beam_x, y: scale*beam_y, z: scale*beam_z}", _SCALE, "tracer", ("second",)),
    Redefined("calibrate-machine", "sphere-form", "length", "c2*cos(2*azimuth) + s2*sin(2*azimuth)",
              "{c2: {unit: um, plausible: 10 um}, s2: {unit: um, plausible: 10 um}}", "tracer", ("second",)),
    Redefined("align-part", "part-expansion", "point-in-part", _GROW, _RATIO),
    Redefined("align-part", "coupling-shift", "point-in-taper", "{x: -dx, y: -dy}",
              "{dx: {unit: mm, plausible: 0.2 mm}, dy: {unit: mm, plausible: 0.2 mm}}"),
    Redefined("align-part", "bad-pose", "point-in-machine", "{x: -dx, y: -dy, z: -dz}", _SHIFT, "image", ("second",)),
    Redefined("align-part", "focal-change", "image", "{u: ratio*off_u, v: ratio*off_v}",
              "{ratio: {unit: percent, plausible: 1 percent}}"),
    Redefined("align-part", "part-drift", "point-in-machine", "{x: vx*t, y: vy*t, z: vz*t}", _DRIFT),
    Redefined("calibrate-camera", "principal-point-drift", "image", "{u: rate_u*t, v: rate_v*t}",
              "{rate_u: {unit: px/h, plausible: 20 px/h}, rate_v: {unit: px/h, plausible: 20 px/h}}"),
    Redefined("calibrate-camera", "target-plane-bend", "point-on-board", "{z: bxx*x**2 + bxy*x*y + byy*y**2}",
              "{bxx: {unit: 1/mm, plausible: 1e-4 1/mm}, bxy: {unit: 1/mm, plausible: 1e-4 1/mm}, "
              "byy: {unit: 1/mm, plausible: 1e-4 1/mm}}"),
    Redefined("calibrate-camera", "focal-drift", "image", "{u: rate*t*off_u, v: rate*t*off_v}",
              "{rate: {unit: 1/h, plausible: 1e-3 1/h}}", by="t"),
    Redefined("calibrate-camera", "moved-target", "point-on-board", "{x: dx, y: dy, z: dz}", _SHIFT, "target",
              ("second",)),
)  # fmt: skip
