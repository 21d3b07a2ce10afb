"""Locked states by four methods on the same cell: direct, the paper's scheme, and generic solvers of nonlinear
programmes.

    python -m benchmarks.rve_methods [--out docs/rve_methods.md] [--without-scheme]

The generic solvers (SLSQP and trust-constr of scipy, IPOPT through casadi where it is installed) get the problem in the
form that suits them best: maximise S:E over the nine coordinates with all gaps >= 0, analytic first derivatives, and S,
the second Piola-Kirchhoff load of the answer, for nothing (for a fixed Cauchy load there is no potential). All start
from the slack pose. The residual R of eq. (9) is measured in one way for all: best non-negative forces at contacts
closer than 1e-7 r1. A method has solved a case when R < 1e-6 and E is within 1e-5 of the reference, which is less than
is asked of ours. Each gets two starts: the slack pose, and the answer moved by up to 0.02 in each coordinate. Failures
stay in the table.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from scipy.optimize import NonlinearConstraint, minimize, nnls

from benchmarks.machine import ROOT, describe
from rve import stewart_trinkle as st
from rve.cell import Pose, find_contacts, pair_geometry, start_pose
from rve.compliance import strain
from rve.contact import distance_gradient, local_minima, tangent_frame
from rve.equilibrium import DirectOptions, solve_equilibrium
from rve.files import write_text
from rve.load import cauchy_line_load, green_lagrange, second_pk
from rve.study import paper_grid
from rve.system import Equations
from rve.weave import FOUR_IN_ONE

WIRE = 0.1
EQUATIONS = Equations.of(FOUR_IN_ONE, WIRE)
CASES = ((0.0, 45.0), (20.0, 30.0), (30.0, 60.0), (10.0, 75.0), (40.0, 25.0), (0.0, 90.0))
BOX = (-1.5, 1.5)  # without bounds on the coordinates SLSQP tears the rings apart in its first step
SIDES = (2.2, 12.646069623526 / 5.0)


@dataclass(frozen=True)
class Row:
    """One method on one case: seconds, residual, error of E, calls of the gap function, what the solver says."""

    method: str
    case: str
    seconds: float
    R: float
    error: float
    calls: int
    says: str

    @property
    def solved(self) -> bool:
        """Whether the case counts."""
        return self.R < 1e-6 and self.error < 1e-5


class Programme:
    """Maximise S:E with gaps >= 0 in a chart: x2, y3, t, the offset of ring B, and two numbers for each normal."""

    def __init__(self, S: np.ndarray) -> None:
        """S (3,): second Piola-Kirchhoff load, scaled to the unit cell."""
        self.S = S
        self.start = start_pose(FOUR_IN_ONE, 1)
        self.frames = tangent_frame(self.start.normals[0])
        self.calls = 0

    def pose(self, q: np.ndarray) -> tuple[Pose, np.ndarray]:
        """The pose of q (9,), and the lengths of the unnormalised normals (2,)."""
        e1, e2 = self.frames
        n = self.start.normals[0] + q[5:9:2, None] * e1 + q[6:9:2, None] * e2
        length = np.linalg.norm(n, axis=1)
        centres = self.start.centres.copy()
        centres[0, 1] += q[3:5]
        return Pose(self.start.lattice + q[:3], centres, (n / length[:, None])[None]), length

    def coordinates(self, pose: Pose, case: int) -> np.ndarray:
        """The q of a pose, moved so that ring A is at the origin as in the start pose."""
        e1, e2 = self.frames
        n, up = pose.normals[case], self.start.normals[0]
        n = n / (n * up).sum(axis=1, keepdims=True)
        q = np.zeros(9)
        q[:3] = pose.lattice[case] - self.start.lattice[0]
        q[3:5] = pose.centres[case, 1] - pose.centres[case, 0] - self.start.centres[0, 1] + self.start.centres[0, 0]
        q[5:9:2], q[6:9:2] = (n * e1).sum(axis=1), (n * e2).sum(axis=1)
        return q

    def strain(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """E (3,) and its derivative (3, 9)."""
        x2, y3, t = self.start.lattice[0] + q[:3]
        bx, by = SIDES
        E = np.array(
            [((1 + t * t) * x2 * x2 / bx**2 - 1) / 2, t * x2 * y3 / bx / by, ((1 + t * t) * y3 * y3 / by**2 - 1) / 2]
        )
        d = np.zeros((3, 9))
        d[0, 0], d[0, 2] = (1 + t * t) * x2 / bx**2, t * x2 * x2 / bx**2
        d[1, :3] = t * y3 / bx / by, t * x2 / bx / by, x2 * y3 / bx / by
        d[2, 1], d[2, 2] = (1 + t * t) * y3 / by**2, t * y3 * y3 / by**2
        return E, d

    def loss(self, q: np.ndarray) -> float:
        """-S:E."""
        return -float((self.S * [1, 2, 1]) @ self.strain(q)[0])

    def slope(self, q: np.ndarray) -> np.ndarray:
        """Derivative of the loss."""
        return -(self.S * [1, 2, 1]) @ self.strain(q)[1]

    def gaps(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gaps (c,) and derivatives (c, 9): two for each linked pair, the smallest for every other."""
        self.calls += 1
        pose, length = self.pose(q)
        d, n_a, n_b = (part[0] for part in pair_geometry(pose, FOUR_IN_ONE))
        found = local_minima(d, n_a, n_b, 1.0)
        g = np.matmul(distance_gradient(found)[:, None, :], EQUATIONS.maps[found.pair])[:, 0]
        full = np.zeros((10 + 2, 9))
        x2, y3, t = pose.lattice[0]
        full[0, 0], full[1, 0], full[1, 2] = 1.0, t, x2
        full[3, 1], full[2, 1], full[2, 2] = 1.0, t, y3
        full[4, 3] = full[5, 4] = 1.0
        for k in range(2):
            n = pose.normals[0, k]
            for i, e in enumerate(self.frames):
                full[6 + 3 * k : 9 + 3 * k, 5 + 2 * k + i] = np.cross(n, e[k]) / length[k]
        gap, slope = np.ones(len(FOUR_IN_ONE.pairs) + 4), np.zeros((len(FOUR_IN_ONE.pairs) + 4, 9))
        row = 0
        for pair, linked in enumerate(FOUR_IN_ONE.linked):
            mine = np.flatnonzero(found.pair == pair)
            # In an order that does not swap where both are equally near, as they are in the answer.
            mine = mine[np.argsort(found.rho_a[mine, 0] if linked else found.distance[mine])]
            # A far pair may have no isolated minimum; a linked one whose minima have merged has its only one twice.
            for k in range(2 if linked else 1):
                if len(mine):
                    best = mine[min(k, len(mine) - 1)]
                    gap[row], slope[row] = found.distance[best] - 2.0 * WIRE, (g @ full)[best]
                row += 1
        return gap, slope


def residual(pose: Pose, s: np.ndarray) -> float:
    """R of eq. (9) with the best non-negative forces at contacts closer than 1e-7 r1."""
    if not (np.isfinite(pose.lattice).all() and np.abs(pose.lattice).max() < 10.0):
        return float("nan")
    contacts = find_contacts(pose, FOUR_IN_ONE, WIRE, 0.1)
    system = EQUATIONS.assemble(pose, contacts, np.zeros(contacts.gap.shape), s[None])
    touching = contacts.present.ravel() & (contacts.gap.ravel() < 1e-7)
    root = np.linalg.cholesky(np.linalg.inv(system.M[0]))
    if not touching.any():
        return 1.0
    _, left = nnls(root.T @ system.G[0][touching].T, -root.T @ system.f[0])
    return float(left / np.linalg.norm(root.T @ system.f[0]))


def run_scipy(programme: Programme, method: str, q0: np.ndarray) -> tuple[np.ndarray, str]:
    """Answer and message of a scipy solver."""
    if method == "SLSQP":
        bound = {"type": "ineq", "fun": lambda q: programme.gaps(q)[0], "jac": lambda q: programme.gaps(q)[1]}
        options = {"ftol": 1e-14, "maxiter": 1000}
    else:
        bound = NonlinearConstraint(lambda q: programme.gaps(q)[0], 0.0, np.inf, jac=lambda q: programme.gaps(q)[1])
        options = {"gtol": 1e-9, "xtol": 1e-11, "barrier_tol": 1e-9, "maxiter": 2000}
    found = minimize(
        programme.loss, q0, jac=programme.slope, method=method, constraints=[bound], bounds=[BOX] * 9, options=options
    )
    return found.x, str(found.message)


def run_ipopt(programme: Programme, q0: np.ndarray) -> tuple[np.ndarray, str]:
    """Answer and status of IPOPT with exact first derivatives and a limited-memory Hessian."""
    import casadi

    size = len(programme.gaps(np.zeros(9))[0])

    class Jacobian(casadi.Callback):
        def __init__(self, name: str) -> None:
            casadi.Callback.__init__(self)
            self.construct(name, {})

        def get_n_in(self) -> int:
            return 2

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, i: int):
            return casadi.Sparsity.dense(9 if i == 0 else size, 1)

        def get_sparsity_out(self, i: int):
            return casadi.Sparsity.dense(size, 9)

        def eval(self, arguments):
            return [programme.gaps(np.array(arguments[0]).ravel())[1]]

    class Gaps(Jacobian):
        def get_n_in(self) -> int:
            return 1

        def get_sparsity_out(self, i: int):
            return casadi.Sparsity.dense(size, 1)

        def eval(self, arguments):
            return [programme.gaps(np.array(arguments[0]).ravel())[0]]

        def has_jacobian(self) -> bool:
            return True

        def get_jacobian(self, name, inames, onames, options):
            self.derivative = Jacobian(name)
            return self.derivative

    q = casadi.MX.sym("q", 9)
    x2, y3, t = (q[i] + float(programme.start.lattice[0, i]) for i in range(3))
    bx, by = SIDES
    E = [((1 + t * t) * x2 * x2 / bx**2 - 1) / 2, t * x2 * y3 / bx / by, ((1 + t * t) * y3 * y3 / by**2 - 1) / 2]
    loss = -(programme.S[0] * E[0] + 2 * programme.S[1] * E[1] + programme.S[2] * E[2])
    gaps = Gaps("gaps")
    options = {
        "print_time": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "tol": 1e-9,
            "max_iter": 2000,
            "hessian_approximation": "limited-memory",
        },
    }
    solver = casadi.nlpsol("cell", "ipopt", {"x": q, "f": loss, "g": gaps(q)}, options)
    answer = solver(x0=q0, lbx=BOX[0], ubx=BOX[1], lbg=0.0)
    return np.array(answer["x"]).ravel(), solver.stats()["return_status"]


def generic(name: str, solve: Callable[[Programme, np.ndarray], tuple[np.ndarray, str]], reference) -> list[Row]:
    """Rows of one generic solver on all cases, from the slack pose and from a pose near the answer."""
    s, found = reference
    F = np.stack([found.pose.a1 / SIDES[0], found.pose.a2 / SIDES[1]], axis=2)
    S, E = second_pk(F, s) * SIDES[0] * SIDES[1], green_lagrange(F)
    rows = []
    rng = np.random.default_rng(0)
    for i, case in enumerate(CASES):
        answer = Programme(S[i]).coordinates(found.pose, i)
        for start, q0 in (("slack", np.zeros(9)), ("near", answer + rng.uniform(-0.02, 0.02, 9))):
            programme = Programme(S[i])
            began = time.process_time()
            q, says = solve(programme, q0)
            seconds = time.process_time() - began
            pose, _ = programme.pose(q)
            error = float(np.abs(strain(pose, SIDES) - E[i]).max())
            label = f"{name}, {start} start"
            rows.append(Row(label, str(case), seconds, residual(pose, s[i]), error, programme.calls, says))
    return sorted(rows, key=lambda row: row.method)


def direct_alone(reference) -> list[Row]:
    """Rows of the direct solver, one case at a time, at the paper's tolerance."""
    s, found = reference
    E = strain(found.pose, SIDES)
    rows = []
    for i, case in enumerate(CASES):
        times = []
        for _ in range(3):
            began = time.process_time()
            one = solve_equilibrium(s[i : i + 1], EQUATIONS, DirectOptions(tolerance=1e-9))
            times.append(time.process_time() - began)
        error = float(np.abs(strain(one.pose, SIDES) - E[i]).max())
        R = residual(one.pose, s[i])
        rows.append(Row("direct, alone", str(case), min(times), R, error, int(one.iterations[0]), str(one.status[0])))
    return rows


def both_sweeps(options: st.StewartTrinkleOptions) -> list[str]:
    """Processor times of the paper's 190 cases by direct solver and paper's scheme, both batched, R < 1e-9."""
    s = cauchy_line_load(*paper_grid())
    began = time.process_time()
    direct = solve_equilibrium(s, EQUATIONS, DirectOptions(tolerance=1e-9))
    between = time.process_time()
    rest = st.solve(s, EQUATIONS, options)
    ended = time.process_time()
    slow, fast = ended - between, between - began
    alone = slice(24, 25)
    began = time.process_time()
    one = st.solve(s[alone], EQUATIONS, options)
    one_scheme = time.process_time() - began
    began = time.process_time()
    solve_equilibrium(s[alone], EQUATIONS, DirectOptions(tolerance=1e-9))
    one_direct = time.process_time() - began
    usual = rest.steps < 3000
    return [
        f"- direct, 190 cases in one batch: {fast:.2f} s, {(direct.status == 'converged').sum()} converged, "
        f"{direct.iterations.sum()} Newton iterations",
        f"- paper's scheme, 190 cases in one batch: {slow:.1f} s, {(rest.status == 'converged').sum()} converged, "
        f"{rest.steps.sum()} accepted and {rest.rejected.sum()} rejected steps "
        f"({(~usual).sum()} cases with more than 3000 steps have {rest.steps[~usual].sum()} of them)",
        f"- **ratio: {slow / fast:.0f}**",
        f"- one case alone, (5, 25): scheme {one_scheme:.2f} s in {one.steps[0]} steps, direct {one_direct:.3f} s; "
        f"ratio {one_scheme / one_direct:.0f}",
    ]


def report(rows: list[Row], batched: float) -> list[str]:
    """Markdown table of all rows, and seconds per solved case of each method over the direct one in a batch."""
    lines = [
        "| method | alpha, beta | s | R | error of E | calls | solved | message |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        mark = "yes" if row.solved else "no"
        lines.append(
            f"| {row.method} | {row.case} | {row.seconds:.3f} | {row.R:.1e} | {row.error:.1e} | {row.calls} | {mark} "
            f"| {row.says.splitlines()[0][:60]} |"
        )
    lines += [
        "",
        "| method | solved | median s per case | s per solved case | over direct alone | over direct in a batch |",
        "|---|---|---|---|---|---|",
    ]
    alone = float(np.median([row.seconds for row in rows if row.method == "direct, alone"]))
    for name in dict.fromkeys(row.method for row in rows):
        mine = [row for row in rows if row.method == name]
        middle = float(np.median([row.seconds for row in mine]))
        solved = sum(row.solved for row in mine)
        # A solver that fails on half of the cases has to be paid for all of them.
        each = sum(row.seconds for row in mine) / solved if solved else float("inf")
        ratios = f"{each:.3f} | {each / alone:.1f} | {each / batched:.0f}"
        lines.append(f"| {name} | {solved} of {len(mine)} | {middle:.3f} | {ratios} |")
    return lines


@click.command()
@click.option("--out", type=click.Path(path_type=Path), default=ROOT / "docs" / "rve_methods.md")
@click.option("--without-scheme", is_flag=True, help="Leave out the paper's scheme: a minute or two.")
def main(out: Path, without_scheme: bool) -> None:
    """Run everything and write the report."""
    s = cauchy_line_load(*np.array(CASES).T)
    reference = s, solve_equilibrium(s, EQUATIONS)
    everything = cauchy_line_load(*paper_grid())
    began = time.process_time()
    solve_equilibrium(everything, EQUATIONS, DirectOptions(tolerance=1e-9))
    batched = (time.process_time() - began) / len(everything)
    rows = direct_alone(reference)
    for method in ("SLSQP", "trust-constr"):
        rows += generic(method, lambda programme, q0, method=method: run_scipy(programme, method, q0), reference)
    try:
        import casadi
    except ImportError:
        print("casadi is not installed: no IPOPT")
    else:
        rows += generic(f"IPOPT (casadi {casadi.__version__})", run_ipopt, reference)
    text = ["# Locked states: direct, paper's scheme, generic solvers", "", *report(rows, batched), ""]
    if not without_scheme:
        text += ["## The paper's scheme", "", *both_sweeps(st.StewartTrinkleOptions()), ""]
    text += [
        f"Seconds are processor time on one thread. Direct in a batch of 190: {1e3 * batched:.1f} ms per case.",
        "",
        describe(),
        "",
    ]
    text += ["Repeat with `OMP_NUM_THREADS=1 python -m benchmarks.rve_methods`.", ""]
    write_text(out, "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
