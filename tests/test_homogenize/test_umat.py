"""The exported user material, compiled and run, against our own numbers."""

import shutil
import subprocess

import numpy as np
import pytest

from homogenize import diagonal_net
from homogenize.export import data_statements, even_law, umat_source
from homogenize.fitting import outer_law, refined_half_spaces
from homogenize.laws import polyhedral_law
from rve import InputError

from .conftest import disc_grid, rows_of

DRIVER = """\
      PROGRAM DRIVER
      IMPLICIT NONE
      DOUBLE PRECISION S(3),D(3,3),F(3,3),PROPS(1),SSE,Z,V(3),W(3,3),PN
      CHARACTER*80 NAME
      INTEGER I,K,COUNT
      READ(*,*) COUNT, PROPS(1)
      DO 10 I=1,COUNT
      F = 0.0D0
      F(3,3) = 1.0D0
      READ(*,*) F(1,1),F(1,2),F(2,1),F(2,2)
      PN = 1.0D0
      CALL UMAT(S,V,D,SSE,Z,Z,Z,V,V,Z,V,V,V,Z,Z,Z,V,V,NAME,2,1,3,0,
     1 PROPS,1,V,W,PN,Z,W,F,1,1,1,1,1,1)
   10 WRITE(*,'(14ES25.16)') S,((D(K,COUNT_COL),COUNT_COL=1,3),K=1,3),SSE,PN
      END
"""
USER_DRIVER = """\
program driver
  implicit none
  double precision props(2), e(6), s(6), c(21), z(100), pn
  integer i, n, k(10)
  z = 0.0d0; k = 0; props = (/ 10.0d0, 0.02d0 /)
  read(*,*) n
  do i = 1, n
    read(*,*) e
    call umat_user('RINGS', 1, 1, 0, props, e, z, z, z, 1.0d0, z, 1.0d0, k, 0.0d0, 1.0d0, 0.4d0, 0.6d0, 0, 0, k, 0, &
      z, z, s, c, 0, z, z, pn, k)
    write(*, '(27es25.16)') s, c
  end do
end program
"""
STIFFNESS = np.array([[900.0, 80.0, 200.0], [40.0, 250.0 * 2.0, 15.0], [200.0, 30.0, 600.0]])


def cauchy_line_load_of(law, F):
    """s = F S F^T / J and the energy at deformation gradients F (n, 2, 2)."""
    C = np.einsum("nki,nkj->nij", F, F)
    answer = law.response(0.5 * (C[:, [0, 0, 1], [0, 1, 1]] - [1.0, 0.0, 1.0]))
    S = answer.S[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    J = np.linalg.det(F)
    return F @ S @ np.swapaxes(F, 1, 2) / J[:, None, None], answer.energy


def jaumann_tangent(law, F, step=1e-7):
    """(1/J) d(Kirchhoff)/d(engineering strain) for spin-free increments, by central differences, (n, 3, 3)."""
    J = np.linalg.det(F)
    columns = []
    for e in (np.diag([1.0, 0.0]), np.diag([0.0, 1.0]), np.array([[0.0, 0.5], [0.5, 0.0]])):
        tau = []
        for sign in (1.0, -1.0):
            G = (np.eye(2) + sign * step * e) @ F
            tau.append(cauchy_line_load_of(law, G)[0] * np.linalg.det(G)[:, None, None])
        d = (tau[0] - tau[1]) / (2.0 * step * J[:, None, None])
        columns.append(d[:, [0, 1, 0], [0, 1, 1]])
    return np.stack(columns, axis=2)


@pytest.mark.skipif(shutil.which("gfortran") is None, reason="gfortran is not installed")
def test_compiled_material_gives_our_numbers(tmp_path, ellipsoid):
    hessian = 0.5 * (STIFFNESS * [[1.0], [2.0], [1.0]] + (STIFFNESS * [[1.0], [2.0], [1.0]]).T)
    rows = rows_of(ellipsoid, disc_grid(5, 20))
    law = polyhedral_law(*refined_half_spaces(rows), hessian / [[1.0], [2.0], [1.0]])
    (tmp_path / "umat.f").write_text(umat_source(law, "test"))
    driver = DRIVER.replace("\n     1 ", " &\n ").replace("COUNT_COL", "L").replace("I,K,COUNT\n", "I,K,L,COUNT\n")
    (tmp_path / "driver.f90").write_text(driver)
    command = "gfortran -O1 -std=legacy -w -ffree-line-length-none driver.f90 umat.f -o driver"
    subprocess.run(command.split(), cwd=tmp_path, check=True, capture_output=True, text=True)
    F = np.eye(2) + np.random.default_rng(11).normal(scale=0.3, size=(300, 2, 2))
    F = F[np.linalg.det(F) > 0.3]
    thickness = 0.8
    lines = [f"{len(F)} {thickness}"] + [" ".join(f"{x:.17g}" for x in f.ravel()) for f in F]
    run = subprocess.run([tmp_path / "driver"], input="\n".join(lines), check=True, capture_output=True, text=True)
    out = np.array([[float(x) for x in line.split()] for line in run.stdout.splitlines()])
    s, energy = cauchy_line_load_of(law, F)
    assert np.allclose(out[:, :3], s[:, [0, 1, 0], [0, 1, 1]] / thickness, atol=1e-11 * np.abs(s).max())
    assert np.allclose(out[:, 12], energy / thickness, rtol=1e-11, atol=1e-11)
    assert np.all(out[:, 13] == 1.0)
    error = np.abs(out[:, 3:12].reshape(-1, 3, 3) - jaumann_tangent(law, F) / thickness).max(axis=(1, 2))
    assert (energy > 0.0).sum() > 100
    assert np.quantile(error, 0.97) < 1e-5 * np.abs(out[:, 3:12]).max()  # the rest straddles a face of the normal fan


@pytest.mark.skipif(shutil.which("gfortran") is None, reason="gfortran is not installed")
def test_material_of_whole_sheets_locks_where_the_law_does_and_has_its_own_tangent(tmp_path, ellipsoid):
    law = even_law(polyhedral_law(*refined_half_spaces(rows_of(ellipsoid, disc_grid(5, 20)))), np.eye(3))
    (tmp_path / "umat.f").write_text(umat_source(law, "test"))
    (tmp_path / "driver.f90").write_text(USER_DRIVER)
    command = "gfortran -O1 -std=legacy -w -ffree-line-length-none driver.f90 umat.f -o driver"
    subprocess.run(command.split(), cwd=tmp_path, check=True, capture_output=True, text=True)
    E = np.random.default_rng(5).normal(scale=0.4, size=(200, 3))  # 11, 22, 12
    step = 1e-6 * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    lines = [f"{x} {y} 0 {z} 0 0" for x, y, z in (E[:, None] + step).reshape(-1, 3)]
    text = "\n".join([str(len(lines)), *lines])
    run = subprocess.run([tmp_path / "driver"], input=text, check=True, capture_output=True, text=True)
    out = np.array([line.split() for line in run.stdout.splitlines()], float).reshape(200, 7, 27)
    thickness, line_load = 10.0, 0.02
    S, C = thickness * out[:, 0, [0, 3, 1]], out[:, 0, 6:]
    slack, stiffness = 1.5 * 0.0033 * line_load, 1500.0 * line_load
    pulled = S - slack * np.array([1.0, 0.0, 1.0])
    is_taut = np.abs(pulled).max(axis=1) > 0.02 * stiffness
    locked = E[:, [0, 2, 1]] - pulled / stiffness
    assert is_taut.sum() > 50
    beyond = law.cut(locked[is_taut]).violation
    assert beyond.max() < 1e-12
    assert beyond.min() > -0.01  # edges are round, by a radius of 0.03
    assert abs(np.median(beyond)) < 1e-12
    tangent = (out[:, 1:4, :6] - out[:, 4:, :6])[:, :, [0, 1, 3]].swapaxes(1, 2) / 2e-6
    given = C[:, [[0, 1, 6], [1, 2, 7], [6, 7, 9]]] * [1.0, 1.0, 2.0]
    error = np.abs(tangent - given).max(axis=(1, 2))
    assert np.quantile(error, 0.95) < 1e-5 * np.abs(given).max()


def test_source_keeps_to_fixed_form_and_to_the_digits(ellipsoid):
    source = umat_source(outer_law(rows_of(ellipsoid, disc_grid(3, 8))))
    assert max(len(line) for line in source.splitlines()) <= 72
    assert source.isascii()
    assert max(statement.count("\n     1") for statement in source.split("\n      ")) <= 19
    values = np.random.default_rng(12).normal(size=45)
    text = " ".join(line[6:] for line in data_statements("P", values) if line[5] == "1")
    numbers = [float(x.replace("D", "e")) for x in text.replace("/", ",").replace(" ", "").split(",") if x]
    assert np.array_equal(numbers, values)


def test_other_laws_are_refused():
    with pytest.raises(InputError, match="only polyhedral laws"):
        umat_source(diagonal_net())
