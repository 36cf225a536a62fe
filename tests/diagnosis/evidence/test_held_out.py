"""What held-out rows take with them, against dense matrices, and the search about another solution."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden import images
from benchmarks.hidden.scenes import board_scene
from metrocli.cli.commands import run
from metrocli.diagnosis.evidence.held_out import Others, _variances
from metrocli.diagnosis.evidence.likelihood import Products, fit_at
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.reweighted import _hidden_directions, directions_without
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.rounds import searched
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load


def test_rows_of_members_are_left_out_as_in_dense_matrices() -> None:
    """Some rows have no member, and of the last member all rows are left out."""
    rng = np.random.default_rng(3)
    member = rng.permutation(np.repeat([-1, 0, 1, 2, 3], [3, 4, 6, 5, 2]))
    local = rng.normal(size=(len(member), 2))
    whole = np.zeros((len(member), 8))
    for number in range(4):
        rows = np.flatnonzero(member == number)
        local[rows] = np.linalg.qr(local[rows])[0]
        whole[rows, 2 * number : 2 * number + 2] = local[rows]
    basis = Basis(local, member, 4, np.zeros((len(member), 0)))
    out = np.flatnonzero((member == 3) | (np.arange(len(member)) % 4 == 0))
    directions, turn = directions_without(basis, out)
    left = np.eye(len(member)) - whole @ whole.T
    inverse = np.linalg.pinv(left[np.ix_(out, out)], rcond=1e-9, hermitian=True)
    np.testing.assert_allclose(directions @ directions.T, left[:, out] @ inverse @ left[out], atol=1e-12)
    np.testing.assert_allclose((turn @ turn.T).toarray(), inverse, atol=1e-12)


def test_directions_that_no_other_reading_shows_are_those_of_the_singular_values() -> None:
    rng = np.random.default_rng(4)
    for shape in ((5, 9), (9, 5)):
        inside = rng.normal(size=shape)
        inside[:2] *= 1e5
        _, values, vectors = np.linalg.svd(inside, full_matrices=False)
        own = vectors[values**2 > 100]
        found = _hidden_directions(inside, 100.0)
        np.testing.assert_allclose(found @ found.T, own.T @ own, atol=1e-9)


def test_an_image_is_predicted_with_the_uncertainty_of_the_lens_of_the_others() -> None:
    """Where two of three images hardly determine the lens, what they predict of the third shows no gain."""
    rng = np.random.default_rng(5)
    m = measurement_of(images.read(board_scene(rng, 3, (5, 4)), rng).adjusted())
    others, shared = Others.of_fold(State.of(m), 0), m.system.basis.shared
    held = others.fold.mask
    assert others.fold.whole
    inverse = np.linalg.inv(shared[~held].T @ shared[~held])
    variances = others.predicted().variances
    np.testing.assert_allclose(variances, 1 + np.einsum("rp,pq,rq->r", shared[held], inverse, shared[held]), rtol=1e-6)


def test_what_no_other_reading_shows_is_no_uncertainty_of_a_prediction() -> None:
    """Such are the errors of a held-out image, of which the job states the deviation: their prior leaves with them."""
    rng = np.random.default_rng(6)
    vectors, rows = np.linalg.qr(rng.normal(size=(8, 8)))[0], rng.normal(size=(4, 8))
    for hidden in (1e-11, 1e-14):
        values = np.array([hidden, hidden, 0.05, 0.3, 0.5, 0.8, 0.9, 1.0])
        gram, none = (vectors * values) @ vectors.T, np.full(8, -1)
        products = Products(gram, np.zeros(8), 1.0, 20.0, 8, none, none[:0], np.zeros((0, 0, 0)), np.zeros((0, 0, 9)))
        shown = (rows @ vectors)[:, 2:] ** 2 @ (1 / values[2:])
        np.testing.assert_allclose(_variances(fit_at(products, np.zeros(0)), rows, rows[:, 8:], {}), shown, rtol=1e-2)


def test_fits_of_a_fold_share_what_their_first_columns_give() -> None:
    """With two fixed columns and with one of them, the variances are those of dense matrices."""
    rng = np.random.default_rng(7)
    columns, rows, none, cache = rng.normal(size=(30, 8)), rng.normal(size=(4, 8)), np.full(8, -1), dict[object, Any]()
    parts = (("unknowns", 6), ("a", 1), ("b", 1))
    empty = np.zeros((0, 0, 0)), np.zeros((0, 0, 9))
    products = Products(columns.T @ columns, np.zeros(8), 1.0, 20.0, 6, none, none[:0], *empty, parts)
    fit = fit_at(products, np.zeros(0))
    for of, at in ((fit, [0, 1, 2, 3, 4, 5, 6, 7]), (fit.keeping([1], 2), [0, 1, 2, 3, 4, 5, 7])):
        dense = np.einsum("np,pq,nq->n", rows[:, at], np.linalg.inv(products.gram[np.ix_(at, at)]), rows[:, at])
        np.testing.assert_allclose(_variances(of, rows[:, :6], rows[:, at[6:]], cache), dense, rtol=1e-9)


def test_a_term_of_a_lens_is_chosen_anew_about_another_solution(tmp_path: Path) -> None:
    """The camera of the sample has k2, p1 and p2. About the first solution a thin prism looks like p1 and p2."""
    assert run(["init", str(tmp_path / "lab"), "--sample", "board-camera"]) == 0
    path = tmp_path / "lab/jobs/calibrate.yaml"
    path.write_text(re.sub(r"estimate: \[[^\]]*\]", "estimate: [f, cx, cy, k1]", path.read_text()))
    _, state = searched(adjusted_job_of(load(path)), quick=True)
    named = {state.measurement.alternative(part.key).effect.name for part in state.named}
    assert named == {"radial-distortion", "decentring-distortion"}
