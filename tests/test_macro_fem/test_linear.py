"""Linear solvers against numpy's dense one, and the sentences they say when they fail."""

import numpy as np
import pytest
import skfem

from macro_fem.fem.assembly import discretize, sparsity, stiffness
from macro_fem.fem.linear import (
    LinearOptions,
    LinearStatus,
    NotPositiveDefiniteError,
    analyze,
    available,
    rigid_motions,
)

DIRECT = ["superlu", pytest.param("cholmod", marks=pytest.mark.skipif(not available()["cholmod"], reason="no CHOLMOD"))]
ITERATIVE = [
    "jacobi",
    pytest.param("multigrid", marks=pytest.mark.skipif(not available()["multigrid"], reason="no pyamg")),
]


@pytest.fixture(scope="module")
def problem():
    """An isotropic sheet held at its left edge, and a function from stiffness per cell to matrix data."""
    ticks = np.linspace(0.0, 1.0, 13)
    disc = discretize(skfem.MeshQuad.init_tensor(ticks, ticks), "Q1")
    pattern = sparsity(disc, 2, disc.nodes[:, 0] > 0.0)
    A = np.zeros((2, 2, 2, 2))
    for i, j in np.ndindex(2, 2):
        A[i, j, i, j] += 1.0
        A[i, j, j, i] += 1.0
        A[i, i, j, j] += 0.5
    return disc, pattern, lambda E: stiffness(disc, pattern, E[:, None, None, None, None] * A)


@pytest.mark.parametrize("method", [*DIRECT, *ITERATIVE])
def test_two_matrices_of_one_pattern_are_each_solved(problem, method):
    disc, pattern, data_of = problem
    rng = np.random.default_rng(0)
    b = rng.standard_normal(pattern.n)
    solver = analyze(pattern, LinearOptions(method=method), rigid_motions(pattern, disc.nodes))
    assert solver.method == method
    first = solver.factorize(data_of(np.ones(disc.n_points)))
    second = solver.factorize(data_of(np.exp(rng.standard_normal(disc.n_points))))
    # The first factor is used after the second was made: nothing is shared.
    for factor, data in ((first, np.ones(disc.n_points)), (second, None)):
        solution = factor.solve(b)
        assert solution.status is LinearStatus.SOLVED
        assert solution.residual < 1e-9
        if data is not None:
            exact = np.linalg.solve(pattern.full(data_of(data)).toarray(), b)
            np.testing.assert_allclose(solution.x, exact, atol=1e-7 * np.abs(exact).max())


@pytest.mark.parametrize("method", [*DIRECT, "jacobi"])
def test_no_blas_threads_are_woken_for_sums(problem, method, monkeypatch):
    """np.linalg.norm and products of two vectors end in BLAS, whose threads cost ten times the solve."""

    class Watched(np.ndarray):
        def __matmul__(self, other):
            raise AssertionError("a product of vectors by BLAS")

    def refused(*_args, **_options):
        raise AssertionError("a norm by BLAS")

    _, pattern, data_of = problem
    factor = analyze(pattern, LinearOptions(method=method)).factorize(data_of(np.ones(problem[0].n_points)))
    monkeypatch.setattr(np.linalg, "norm", refused)
    assert factor.solve(np.ones(pattern.n).view(Watched)).residual < 1e-9


@pytest.mark.parametrize("method", DIRECT)
def test_an_indefinite_matrix_is_refused(problem, method):
    disc, pattern, data_of = problem
    solver = analyze(pattern, LinearOptions(method=method))
    data = data_of(np.ones(disc.n_points))
    data[pattern.diagonal[pattern.n // 2]] = -1.0
    with pytest.raises(NotPositiveDefiniteError, match="not positive"):
        solver.factorize(data)
    with pytest.raises(NotPositiveDefiniteError):
        solver.factorize(data_of(np.zeros(disc.n_points)))
    data[pattern.diagonal[3]] = np.nan
    with pytest.raises(NotPositiveDefiniteError):
        solver.factorize(data)
    assert np.all(np.isfinite(solver.factorize(data_of(np.ones(disc.n_points))).solve(np.ones(pattern.n)).x))


def test_conjugate_gradients_say_when_they_are_not_done(problem):
    disc, pattern, data_of = problem
    data = data_of(np.ones(disc.n_points))
    few = analyze(pattern, LinearOptions(method="jacobi", max_iterations=3)).factorize(data)
    solution = few.solve(np.ones(pattern.n))
    assert solution.status is LinearStatus.NOT_CONVERGED
    assert solution.iterations == 3
    assert solution.residual > 1e-3
    assert "max_iterations" in solution.status.value
    many = analyze(pattern, LinearOptions(method="jacobi")).factorize(data)
    assert many.solve(np.ones(pattern.n)).iterations > 20
    assert many.solve(np.zeros(pattern.n)).iterations == 0
    data[pattern.diagonal[0]] = -1.0
    with pytest.raises(NotPositiveDefiniteError):
        analyze(pattern, LinearOptions(method="jacobi")).factorize(data)


@pytest.mark.skipif(not available()["multigrid"], reason="no pyamg")
def test_multigrid_iterations_hardly_grow_with_the_mesh():
    counts = []
    for n in (24, 96):
        ticks = np.linspace(0.0, 1.0, n + 1)
        disc = discretize(skfem.MeshQuad.init_tensor(ticks, ticks), "Q1")
        pattern = sparsity(disc, 2, disc.nodes[:, 0] > 0.0)
        A = np.eye(4).reshape(2, 2, 2, 2) + 0.5 * np.einsum("ij,kl->ijkl", np.eye(2), np.eye(2))
        data = stiffness(disc, pattern, np.broadcast_to(A, (disc.n_points, 2, 2, 2, 2)))
        solver = analyze(pattern, LinearOptions(method="multigrid"), rigid_motions(pattern, disc.nodes))
        solution = solver.factorize(data).solve(np.ones(pattern.n))
        assert solution.status is LinearStatus.SOLVED
        counts.append(solution.iterations)
    assert counts[1] < 2 * counts[0] < 60


def test_auto_falls_back_to_superlu_and_says_so(problem, monkeypatch):
    _, pattern, _ = problem
    monkeypatch.setattr("macro_fem.fem.linear.find_spec", lambda name: None)
    assert analyze(pattern).method == "superlu"
    assert analyze(pattern, LinearOptions(factor_limit=10)).method == "superlu"
    with pytest.raises(ValueError, match="needs scikit-sparse, which is not installed"):
        analyze(pattern, LinearOptions(method="cholmod"))
    with pytest.raises(ValueError, match="needs pyamg"):
        analyze(pattern, LinearOptions(method="multigrid"))


def test_options_refuse_what_no_solver_knows():
    with pytest.raises(ValueError, match="'pardiso' is not one of"):
        LinearOptions(method="pardiso")
    with pytest.raises(ValueError, match="'rcm' is not one of"):
        LinearOptions(ordering="rcm")
    with pytest.raises(ValueError, match=r"rtol = 0\.0"):
        LinearOptions(rtol=0.0)


def test_no_unknowns_no_trouble():
    disc = discretize(skfem.MeshTri(), "P1")
    pattern = sparsity(disc, 2, np.zeros(disc.n_nodes, dtype=bool))
    solution = analyze(pattern).factorize(np.zeros(0)).solve(np.zeros(0))
    assert solution.x.shape == (0,)
    assert solution.status is LinearStatus.SOLVED


def test_rigid_motions_strain_nothing(problem):
    disc, _, _ = problem
    pattern = sparsity(disc, 2, np.ones(disc.n_nodes, dtype=bool))
    modes = rigid_motions(pattern, disc.nodes)
    A = np.zeros((2, 2, 2, 2))
    for i, j in np.ndindex(2, 2):
        A[i, j, i, j] += 1.0
        A[i, j, j, i] += 1.0
    K = pattern.full(stiffness(disc, pattern, np.broadcast_to(A, (disc.n_points, 2, 2, 2, 2))))
    assert np.abs(K @ modes).max() < 1e-13
    assert np.linalg.matrix_rank(modes) == 3
