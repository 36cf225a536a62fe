"""Smooth random errors count as noise: they get no names of causes, and effects stay found beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated.network import network

from benchmarks.hidden import grids, launch, lengths
from benchmarks.hidden.foreign import planted
from benchmarks.hidden.rest import Size, _shown, _together, of_each, of_images
from benchmarks.hidden_effects import KINDS as KINDS_OF_EFFECTS
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.diagnosis.correlated_error import CorrelatedError
from metrocli.diagnosis.diagnose import _left, diagnose
from metrocli.diagnosis.evidence.folds import gain_between
from metrocli.diagnosis.evidence.functions import process_bases
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.explanations import correlated_errors
from metrocli.diagnosis.extended_fit import extended_fit
from metrocli.diagnosis.findings import Diagnosis, Verdict
from metrocli.diagnosis.job_entries import proposed_noise
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.verdict import as_data
from metrocli.effects.correlated import StatedCorrelation, requests_of
from metrocli.effects.covariates import around_circle, between_knots
from metrocli.project.diagnosed import Extended, adjusted_job_of
from metrocli.project.job import load
from metrocli.project.until_clean import End, _end
from metrocli.project.yaml_text import parse
from metrocli.tasks import KINDS
from tests.diagnosis.evidence.test_dense import with_residual


def wavering(seed: int, effect: str = "", times: float = 3.0) -> tuple[Diagnosis, str]:
    """Return the diagnosis of a network whose tracers each waver, with an effect; and the place of this effect."""
    rng = np.random.default_rng([77, seed])
    m, place = lengths.measurement(rng, int(rng.integers(60, 101))), ""
    if effect:
        m, hidden = lengths.planted(m, rng, effect, times)
        place = " ".join(hidden.where.values())
    return diagnose(replace(m, length=m.length + of_each(rng, m.t[:, None], m.tracer)[0] * m.sigma).adjusted()), place


def test_what_wavers_gets_no_name_and_is_reported() -> None:
    """Beside white noise alone these three have five false names."""
    for seed in (1,):
        found, _ = wavering(seed)
        assert not found.findings
        assert found.correlated_errors[0].by == "tracer"
        # beside white noise alone it would be 1.2, 1.4 and 1.04
        assert found.noise.low < 1 < found.noise.high
        assert 0.3e-4 < found.correlated_errors[0].std < 4e-4
        shown = as_data(found)["processes"][0]
        assert shown["of_each"] == "tracer"
        assert shown["std"]["value"] == pytest.approx(1e3 * found.correlated_errors[0].std)


def test_a_correlated_error_that_explains_more_than_a_name_is_listed_instead_of_it() -> None:
    """A jump is preferred, since it says what is wrong, but the report does not hide that a smooth error fits better."""
    found, _ = wavering(23)
    (jump,) = found.findings
    assert jump.instead == ("an error that varies smoothly with t_s of each tracer",)
    assert found.verdict is Verdict.INDISTINCT
    (other,) = as_data(found)["effects"][0]["alternatives"]
    assert other["name"] == "correlated-error" and other["where"] == {"depends_on": "t_s", "of_each": "tracer"}
    assert 1 < other["odds"] < 20 and other["words"] == jump.instead[0]
    drift, place = wavering(4, "dead-path-drift", 4.0)
    (own,) = (one for one in drift.findings if place in str(one))
    assert not own.errors


@pytest.mark.parametrize(
    ("std", "unit", "dimension", "text"),
    [(37.4, "mm", "length", "37 mm"), (2.14e-4, "", "length", "0.21 um"), (0.31, "px", "pixel", "0.31 px")],
)
def test_its_size_is_in_the_unit_that_suits_it(std: float, unit: str, dimension: str, text: str) -> None:
    """Radio ranges are read in mm: 37000 um helps nobody."""
    assert CorrelatedError("t", "tracer", 0.1, std, 0.0, 1.0, unit, 0.0, 1.0).sized(dimension) == text


def test_what_the_unknowns_absorb_of_its_size_is_stated() -> None:
    """A shift of each image along the images is nearly all absorbed by the poses: 13 px beside residuals of 0.3 px."""
    text = CorrelatedError("order of the images", "", 0.1, 13.2, 4.0, 0.013, "px", 0.0, 1.0).sized("pixel")
    assert text == "13 px, of which the unknowns leave 0.17 px"
    for seed in (1,):
        found, _ = wavering(seed)
        own = found.correlated_errors[0]
        system = linearised(found.job.model)
        (basis,) = (one for one in process_bases(found.job, system) if (one.name, one.by) == (own.covariate, own.by))
        apart = np.sqrt(3) * basis.distances / own.length
        root = np.linalg.cholesky((1 + apart) * np.exp(-apart) + 1e-9 * np.eye(len(apart)))
        drawn = np.kron(np.eye(basis.components * basis.count), root) @ np.random.default_rng(seed).normal(
            size=(basis.columns.shape[1], 300)
        )
        error = basis.columns @ drawn
        left = np.sqrt((system.seen(error) ** 2).sum() / (error**2).sum())
        # variances of the tracers differ, and between knots the functions have a little less
        assert own.visible == pytest.approx(left, rel=0.15)


@pytest.mark.slow
def test_what_wavers_fast_in_a_long_measurement_gets_no_names() -> None:
    """Errors of a fiftieth of the measurement: with no length below a sixteenth the first has a jump that is chance."""
    for seed, drift in ((1, 0.0), (2, 4e-3)):
        rng = np.random.default_rng([78, seed])
        m = lengths.measurement(rng, 900)
        apart = np.subtract.outer(m.t, m.t)[m.tracer == 0][:, m.tracer == 0] / np.ptp(m.t)
        root = np.linalg.cholesky(np.exp(-((apart / 0.02) ** 2) / 2) + 1e-9 * np.eye(len(apart)))
        error = np.zeros(len(m.t))
        for tracer in np.unique(m.tracer):
            error[m.tracer == tracer] = 0.7 * root @ rng.normal(size=len(root))
        creep = drift * (m.tracer == 1) * (m.t - m.t.min()) / np.ptp(m.t)
        found = diagnose(replace(m, length=m.length + error * m.sigma + creep).adjusted())
        named = [one.effect.alternative.effect.name for one in found.findings]
        assert named == (["dead-path-drift"] if drift else []), named
        assert found.correlated_errors[0].length <= 1 / 32


def test_a_clean_report_states_that_uncertainties_are_without_the_smooth_error() -> None:
    """Too weak to be called structure, it still makes intervals for white noise too short: `structured` is proposed."""
    for seed in (4,):
        found, _ = wavering(seed)
        assert found.verdict == "clean"
        assert found.correlated_errors
        assert proposed_noise(found) == "structured"
        report = of_diagnosis(found, Extended(Path("job.extended.yaml"), None))
        first, *_, last = report.splitlines()[0], *[line for line in report.splitlines() if line.startswith("next")]
        covariate = found.correlated_errors[0].covariate
        smooth = f"an error that varies smoothly with {covariate} of each tracer by itself"
        assert first.startswith("verdict: clean, but ")
        assert first.endswith(f"{smooth} is not in the uncertainties of the result")
        assert last.endswith("the job with `noise: structured`: its uncertainties include the smooth error")
        assert "those of the extended job, with `noise: structured`, include it" in report
        assert "extended job" not in of_diagnosis(found, None), "none was written"
        assert as_data(found)["processes"][0]["in_uncertainties"] is False
        by_chance = tuple(replace(error, log_level=np.log(0.25)) for error in found.correlated_errors)
        assert of_diagnosis(replace(found, correlated_errors=by_chance), None).splitlines()[0] == "verdict: clean"
        taken = replace(found, job=replace(found.job, noise_model="structured"))
        assert proposed_noise(taken) == ""
        assert of_diagnosis(taken, None).splitlines()[0] == "verdict: clean"
        assert "The standard uncertainties of the result include it." in of_diagnosis(taken, None)
        assert as_data(taken)["processes"][0]["in_uncertainties"] is True
        # nothing is declared where the noise follows the residuals
        assert as_data(found)["noise"]["as_declared"] is True and as_data(taken)["noise"]["as_declared"] is None


def test_names_before_processes_are_raced_may_be_chance_and_the_report_states_it() -> None:
    found, _ = wavering(5, "dead-path-drift", 6.0)
    assert found.findings
    stated = "Smooth random errors are tested last: some of the effects found may be spurious."
    assert stated in of_diagnosis(replace(found, limited=5.0, correlated_errors=()), None).splitlines()
    assert stated not in of_diagnosis(replace(found, limited=5.0), None)
    assert stated not in of_diagnosis(replace(found, correlated_errors=()), None)


def test_an_extended_job_without_effects_is_not_said_to_have_them() -> None:
    """What held-out readings do not confirm is in no extended job."""
    found, _ = wavering(5, "dead-path-drift", 6.0)
    written = Extended(Path("job.extended.yaml"), None)
    assert "the job extended by the named effects and with `noise: structured`" in of_diagnosis(found, written)
    lost = tuple(replace(one, gain=replace(one.gain, log_score=-0.1)) for one in found.findings)
    assert "extended by the named effects" not in of_diagnosis(replace(found, findings=lost), written)


def test_a_little_beside_the_effects_of_an_extended_job_is_explained() -> None:
    """They are named no more, since the job has them; what remains is a share of the errors that it has with them."""
    rng = np.random.default_rng([77, 4])
    m, _ = lengths.planted(lengths.measurement(rng, int(rng.integers(60, 101))), rng, "tracer-scale", 6.0)
    off = 0.7 * of_each(rng, m.t[:, None], m.tracer)[0] * m.sigma
    found = diagnose(replace(m, length=m.length + off).adjusted())
    kept = {group.name: np.ones(group.observations.count, dtype=bool) for group in found.job.model.readings}
    extended = extended_fit(found.job, [one.effect for one in found.findings], kept)
    assert extended is not None and found.left is not None and found.left.share is not None
    after = diagnose(extended)
    assert not after.findings and after.left is not None and after.left.share is not None
    # of fewer errors than before: a stricter rule
    assert found.left.share < after.left.share < 0.05 and after.verdict == Verdict.EXPLAINED
    # nor does the loop that extends jobs end with it as unexplained
    assert _end(after, after, False) is End.NOTHING_GAINED


def test_a_little_beside_a_stated_smooth_error_alone_is_not_explained() -> None:
    """The job has no effect: what it states over the temperature is not a cause of what varies with the time."""
    rng = np.random.default_rng([77, 22])
    m = lengths.measurement(rng, 100)
    off = rng.uniform(0.45, 0.54) * of_each(rng, m.t[:, None], m.tracer)[0] * m.sigma
    stated = StatedCorrelation("temp_degC", 0.5, "0.03 um")
    requests = requests_of(
        [stated], [parse("{covariate: temp_degC}", "job.yaml", Path())], KINDS["multilaterate"].task().covariates
    )
    found = diagnose(replace(m, length=m.length + off).adjusted(requests))
    assert found.job.model.added and not found.findings and found.left is not None
    assert found.verdict == Verdict.UNEXPLAINED


@pytest.mark.slow
def test_what_wavers_is_no_law() -> None:
    """Beside white noise alone a law was found in both."""
    for seed in (1, 6):
        rng = np.random.default_rng([77, seed])
        m = lengths.measurement(rng, int(rng.integers(60, 101)))
        read = replace(m, length=m.length + of_each(rng, m.t[:, None], m.tracer)[0] * m.sigma)
        found = diagnose(replace(read.adjusted(), places=KINDS["multilaterate"].task().places))
        assert found.correlated_errors
        assert found.laws == ()


@pytest.mark.slow
def test_a_step_is_a_law_and_no_process() -> None:
    """A process along the time can imitate it, but has far less evidence."""
    one = planted("calibrate-machine", 24)
    found = diagnose(one.job())
    assert (one.form, found.correlated_errors, found.findings) == ("step", (), ())
    assert found.law is not None and found.law.part_of_structure > 0.9
    assert {name for term in found.law.terms for name in term.form.variables} == one.variables


def test_an_effect_is_named_beside_what_wavers() -> None:
    found, place = wavering(5, "sphere-form")
    assert [str(one.effect.alternative) for one in found.findings] == [f"sphere-form {place}"]


def test_what_wavers_beside_an_effect_is_a_share_of_the_misfit() -> None:
    """Lengths are reported in um and held in mm: their errors are of one unit all the same."""
    found, _ = wavering(1, "tracer-scale", 4.0)
    (error,) = found.correlated_errors
    assert found.left is not None and found.gain is not None
    assert found.left.share == pytest.approx((error.std * error.visible / found.gain.before) ** 2)
    assert found.left.share > 0.05 and found.verdict == Verdict.UNEXPLAINED
    assert "um that vary with t_s remain" in of_diagnosis(found, None)
    # bars and heights of a network have no time: what its other readings share goes by no covariate of all
    unsought = "Errors that vary smoothly are not sought"
    assert unsought in of_diagnosis(replace(found, job=replace(found.job, covariates=())), None)
    assert unsought not in of_diagnosis(found, None)


def test_what_wavers_is_in_the_uncertainty_of_an_effect_beside_it() -> None:
    """Its standard uncertainty is near that of generalised least squares with the covariance of all errors."""
    for seed in (0,):
        rng = np.random.default_rng([92, seed])
        m = lengths.measurement(rng, 70)
        off, covariance = of_each(rng, m.t[:, None], m.tracer)
        wavers = replace(m, length=m.length + off * m.sigma)
        read, hidden = lengths.planted(wavers, rng, "refraction-drift", 2.0, covariance)
        (found,) = diagnose(read.adjusted()).findings
        known = abs(hidden.values["rate"]) / lengths.size_beside(m, read.length - wavers.length, covariance)
        assert np.sqrt(found.effect.covariance[0, 0]) == pytest.approx(known, rel=0.2)


def test_a_drift_stands_before_an_error_of_its_tracer() -> None:
    """An error of one tracer that varies smoothly with the time explains more, and the drift is named all the same."""
    rng = np.random.default_rng([91, 2])
    m, hidden = lengths.planted(lengths.measurement(rng, 40), rng, "tracer-drift", 1.2)
    found = diagnose(m.adjusted())
    (one,) = found.findings
    assert (one.effect.alternative.effect.name, one.effect.alternative.where) == ("tracer-drift", hidden.where)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draw", "number", "name"), [(78, 4, "axis-skew"), (78, 1043, "rolling-shutter"), (81, 4, "axis-skew")]
)
def test_an_effect_is_named_beside_errors_of_each_image(draw: int, number: int, name: str) -> None:
    """What acts in all images alike, and what a shift of each image could be taken for.

    Beside the second skew seven processes have larger scores than the one of the largest likelihood.
    """
    case = of_images(np.random.default_rng([draw, 20, 0, number]), number, Size(2.0))
    assert case is not None and case.hidden[0].name == name
    found = diagnose(case.adjusted())
    assert [one.effect.alternative.effect.name for one in found.findings] == [name]
    assert found.correlated_errors


def test_a_process_varies_within_its_units() -> None:
    """The time and the temperature of an image are one value each: along them no error of that image can vary."""
    case = of_images(np.random.default_rng(5), 0, Size(0.0))
    assert case is not None
    job = case.adjusted()
    found = {(one.name, one.by) for one in process_bases(job, linearised(job.model))}
    assert {("t_s", ""), ("place in the image", "image")} <= found
    assert not {("t_s", "image"), ("temp_degC", "image")} & found


def with_wavering_distances(effect: str = "") -> Diagnosis:
    """Return the diagnosis of a launch unit whose distances waver by three times their noise, and its encoders do not."""
    rng = np.random.default_rng([93, 0])
    m = launch.measurement(rng, True)
    if effect:
        m, _ = launch.planted(m, rng, effect, 20.0)
    wave = np.cos(2 * np.pi * (m.t - m.t.min()) / np.ptp(m.t) + rng.uniform(0, 6))
    off = np.zeros_like(m.read)
    off[4] = 3 * launch.DISTANCE * wave / np.std(wave)
    return diagnose(replace(m, read=m.read + off).adjusted())


def test_the_size_of_a_process_is_in_the_unit_of_the_readings_that_show_it() -> None:
    (shown,) = as_data(with_wavering_distances())["processes"]
    assert shown["std"]["unit"] == "um"
    assert shown["std"]["value"] == pytest.approx(3e3 * launch.DISTANCE, abs=3 * shown["std"]["std"])


@pytest.mark.parametrize("station", [-1, 1])
def test_the_size_of_a_process_is_that_of_the_readings_that_have_it(station: int, tmp_path: Path) -> None:
    """Errors over the azimuth of all stations, or of one of three: distances and angles, of which angles show more."""
    m = measurement_of(adjusted_job_of(load(network(np.random.default_rng(61), 3, 40, faces=2).write(tmp_path))))
    part, shares = m.correlated(0, m.lengths(0)[-1], station), []
    assert m.knots[0].by == "station" and part.columns.any(axis=1).mean() > (0.9 if station < 0 else 0.3)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        off = 3 * part.columns @ rng.normal(size=part.columns.shape[1])
        drawn = with_residual(m, rng.normal(size=m.system.rows) + off)
        (found,) = correlated_errors(State.of(drawn, (), [m.correlated(0, m.lengths(0)[-1], station)], [2.0]))
        groups = [group for group in m.job.model.readings if group.observations.unit == found.unit]
        rows = np.any([m.system.rows_of(group) for group in groups], axis=0) & (off != 0)
        left = m.system.seen(off)
        sizes = [np.sqrt(np.mean((one * m.system.scale)[rows] ** 2)) for one in (off, left)]
        shares.append([found.std / sizes[0], found.std * found.visible / sizes[1]])
    # of a single draw the first has a standard deviation of 23 %: it includes what the unknowns absorb
    assert np.median(shares, axis=0) == pytest.approx([1, 1], abs=0.15)


def test_what_wavers_in_another_unit_than_the_misfit_is_no_small_share_of_it() -> None:
    """Beside an encoder that is named, errors of distances are left: they are not urad, and not 0 % of those."""
    found = with_wavering_distances("encoder-eccentricity")
    assert found.findings and found.left is not None
    assert found.verdict == Verdict.UNEXPLAINED and found.left.share is None
    size = as_data(found)["unexplained"]["size"]
    assert size["unit"] == "um" and size["value"] == pytest.approx(3e3 * launch.DISTANCE, rel=0.3)
    assert f"varies with t_s, {size['value']:.1f} um (root mean square)" in of_diagnosis(found, None)


def test_a_wave_of_angles_is_no_small_share_of_errors_of_displacements() -> None:
    """Lines of a laser: a wave of angles of five times their noise is left in rad, and not 0 % of errors in mm."""
    job = replace(KINDS_OF_EFFECTS["six-dof"].case(0, True).adjusted(), effects=())
    m = measurement_of(job, quick=True)
    number = next(number for number, family in enumerate(m.families) if family.unknown)
    wave = 5 * m.whole(number, 7).sum(axis=1) * m.system.rows_in_units["rad"]
    state = State.of(with_residual(m, m.system.residual + wave), [m.effect(number, 7)])
    left = _left(state, (), (), gain_between(state, state), ())
    assert left is not None and (left.unit, left.share) == ("rad", None)
    shown = (m.system.seen(wave) * m.system.scale)[m.system.rows_in_units["rad"]]
    assert left.size == pytest.approx(np.sqrt(np.mean(shown**2)), rel=0.1)


def test_white_noise_has_no_process() -> None:
    assert not diagnose(lengths.measurement(np.random.default_rng(3), 30).adjusted()).correlated_errors


def test_knots_add_up_to_one() -> None:
    turns, chords = around_circle([np.linspace(-4, 9, 50)[None]], 16)
    plane, apart = between_knots([np.random.default_rng(1).uniform(size=(2, 40))], [np.zeros(40, dtype=np.intp)], 5)
    for (functions, numbers), distances in ((turns[0], chords), (plane[0], apart)):
        np.testing.assert_allclose(functions.sum(axis=1), 1.0)
        assert set(numbers.ravel()) <= set(range(len(distances)))
        np.testing.assert_allclose(distances, distances.T)


def test_views_that_are_measured_one_after_the_other_each_have_all_knots() -> None:
    once = np.linspace(0.0, 30.0, 20)
    labels = np.repeat([0, 1], [20, 20])
    ((values, numbers),), distances = between_knots([np.concatenate([once, 500.0 + once])[None]], [labels], 9)
    functions = np.zeros((40, 9))
    np.add.at(functions, (np.arange(40)[:, None], numbers), values)
    np.testing.assert_allclose(functions[:20], functions[20:], atol=1e-12)
    assert (functions[:20].max(axis=0) > 0.5).all() and distances.max() == 1.0


def test_what_shows_beside_a_known_covariance_is_that_of_weighted_least_squares() -> None:
    rng = np.random.default_rng(2)
    errors, covariance = _together([of_each(rng, rng.random((9, 1)), np.arange(9) // 5) for _ in range(2)])
    assert errors.shape == (9, 2)
    assert not covariance.reshape(9, 2, 9, 2)[:, 0, :, 1].any()
    taken, change = rng.normal(size=(18, 3)), rng.normal(size=18)
    weight = np.linalg.inv(np.eye(18) + covariance)
    left = weight - weight @ taken @ np.linalg.solve(taken.T @ weight @ taken, taken.T @ weight)
    white, beside = _shown(taken, change, covariance)
    assert beside == pytest.approx(float(np.sqrt(change @ left @ change)))
    assert white == pytest.approx(float(np.linalg.norm(change - taken @ np.linalg.lstsq(taken, change, rcond=None)[0])))


@pytest.mark.parametrize("name", ["_oscillation", "drift-in-view"])
def test_a_first_answer_names_no_effect_that_stands_for_a_smooth_error(name: str) -> None:
    """It named a reseated artefact of two views, which the whole answer excludes."""
    rng = np.random.default_rng([3, 6])
    m, hidden = grids.planted(grids.measurement(rng, "1234"), rng, name, 3.0)
    found = diagnose(m.adjusted(), quick=True)
    assert [one.effect.alternative.effect.name for one in found.findings] == [hidden.name] * (name[0] != "_")
    assert bool(found.correlated_errors) is (name[0] == "_")
