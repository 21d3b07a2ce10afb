"""How time and memory of one load step grow with the mesh: `python -m benchmarks.scaling [--largest 1e6]`.

Problem: clamped neo-Hookean square, Q1, stretched to 1.05 in one load step, Newton to 1e-9; the sizes run from 1e3 to
1e6 unknowns in half decades. Each run is a process of its own, so that its peak memory is its own; 1 BLAS thread.
Methods: CHOLMOD, SuperLU, conjugate gradients with smoothed aggregation (`multigrid`), conjugate gradients with the
diagonal (`jacobi`). A method is not asked for more once a run took longer than `--patience` seconds.

The rigid curtain beside it: a square metre of rings (default law, thousands of half-spaces) hung by its corners, solved
to a relative gap of 1e-9 with CHOLMOD and with SuperLU; unknowns are about as many as triangles.

Writes `--out` (Markdown, default docs/scaling.md) and a picture of the same name (SVG).
"""

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import click
import numpy as np

from benchmarks.machine import ROOT, describe

RIGID = {"rigid, cholmod": "cholmod", "rigid, superlu": "superlu"}
METHODS = ("cholmod", "superlu", "multigrid", "jacobi")


def run_here(n: int, method: str) -> dict:
    """One load step on n x n cells: seconds by part, peak memory, iterations."""
    import skfem

    from macro_fem.assembly import discretize
    from macro_fem.linear import LinearOptions
    from macro_fem.materials import NeoHookeanSheet
    from macro_fem.newton import Membrane, NewtonOptions, solve

    start = time.perf_counter()
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    ticks = np.linspace(0.0, 1.0, n + 1)
    disc = discretize(skfem.MeshQuad.init_tensor(ticks, ticks), "Q1")
    x = disc.nodes[:, 0]
    fixed = np.repeat(((x == 0.0) | (x == 1.0))[:, None], 2, axis=1)
    displacement = np.outer(x == 1.0, [0.05, 0.0])
    ready = time.perf_counter()
    sheet = Membrane(disc, NeoHookeanSheet(), fixed, displacement, 0.0 * displacement)
    linear = LinearOptions(method=method, rtol=1e-8, max_iterations=5000)
    solution = solve(sheet, NewtonOptions(rtol=1e-9, linear=linear))
    statistics = solution.statistics
    return {
        "unknowns": statistics.unknowns,
        "ok": solution.status.name == "CONVERGED",
        "mesh_s": ready - start,
        "assembly_s": statistics.assembly_s,
        "linear_s": statistics.linear_s,
        "wall_s": time.perf_counter() - start,
        "peak_mb": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) / 1024,
        "newton": statistics.iterations,
        "reaction": float(solution.reactions[x == 1.0, 0].sum()),
    }


def run_rigid_here(unknowns: int, method: str) -> dict:
    """The rigid corner-hung square with about as many unknowns: seconds, peak memory, steps, relative gap."""
    from homogenize.law import default_law
    from macro_fem import linear
    from macro_fem.scene import read_scene
    from macro_fem.solvers import solve_scene

    has = linear.available()
    linear.available = lambda: has | {"cholmod": has["cholmod"] and method == "cholmod"}
    start = time.perf_counter()
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    scene = read_scene(
        {
            "curtain": {"width": 1000.0, "height": 1000.0},
            "mesh": {"cells": max(4, round(np.sqrt(unknowns / 3.5)))},
            "support": {"kind": "corners"},
        }
    )
    solution = solve_scene(scene, default_law())
    size = float(np.abs(solution.problem.force).sum()) * solution.problem.mesh.size
    return {
        "unknowns": solution.problem.fem.n,
        "cells": solution.problem.disc.n_cells,
        "ok": solution.status == "converged",
        "wall_s": time.perf_counter() - start,
        "cpu_s": time.process_time(),
        "peak_mb": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) / 1024,
        "steps": solution.iterations,
        "gap": (solution.primal - solution.dual) / size,
        "height": solution.mean_height(),
    }


def run(n: int, method: str, patience: float) -> dict:
    """The same in a process of its own; {"absent": why} if it failed or took three times too long."""
    env = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "benchmarks.scaling", "--one", str(n), method]
    try:
        process = subprocess.run(
            command, capture_output=True, text=True, env=env, cwd=ROOT, check=False, timeout=3.0 * patience
        )
    except subprocess.TimeoutExpired:
        return {"absent": f"more than {3.0 * patience:.0f} s"}
    if process.returncode != 0:
        return {"absent": process.stderr.strip().splitlines()[-1][:100]}
    return json.loads(process.stdout.strip().splitlines()[-1])


def table(results: dict[str, list[dict]]) -> str:
    """Markdown rows, and the exponent of growth over the last decade of each method."""
    rows = [
        "| method | unknowns | wall s | mesh s | assembly s | linear s | peak MB | Newton | reaction |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    growth = []
    for method, answers in results.items():
        done = [a for a in answers if "absent" not in a]
        for a in answers:
            if "absent" in a:
                rows.append(f"| {method} | - | - | - | - | - | - | - | {a['absent']} |")
                continue
            rows.append(
                f"| {method} | {a['unknowns']:,} | {a['wall_s']:.2f} | {a['mesh_s']:.2f} | {a['assembly_s']:.2f} "
                f"| {a['linear_s']:.2f} | {a['peak_mb']:.0f} | {a['newton']} "
                f"| {a['reaction']:.9f}{'' if a['ok'] else ' (did not converge)'} |"
            )
        if len(done) >= 3:
            a, b = done[-3], done[-1]
            decades = np.log10(b["unknowns"] / a["unknowns"])
            time_power = np.log10(b["wall_s"] / a["wall_s"]) / decades
            memory_power = np.log10(max(b["peak_mb"], 1.0) / max(a["peak_mb"], 1.0)) / decades
            growth.append(f"{method}: time n^{time_power:.2f}, memory n^{memory_power:.2f}")
    return "\n".join(rows) + "\n\nGrowth between the last three sizes: " + "; ".join(growth) + "."


def rigid_table(results: dict[str, list[dict]]) -> str:
    """Markdown rows of the rigid curtain."""
    rows = [
        "| solver | triangles | unknowns | wall s | processor s | steps | peak MB | relative gap | mean height mm |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for method, answers in results.items():
        for a in answers:
            if "absent" in a:
                rows.append(f"| {method} | - | - | - | - | - | - | - | {a['absent']} |")
                continue
            rows.append(
                f"| {method} | {a['cells']:,} | {a['unknowns']:,} | {a['wall_s']:.2f} | {a['cpu_s']:.2f} "
                f"| {a['steps']} | {a['peak_mb']:.0f} | {a['gap']:.1e} "
                f"| {a['height']:.4f}{'' if a['ok'] else ' (did not converge)'} |"
            )
    return "\n".join(rows)


def draw(results: dict[str, list[dict]], target: Path) -> None:
    """Time and peak memory over the unknowns, log-log."""
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    plt.rcParams["svg.hashsalt"] = "scaling"
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    for method, answers in results.items():
        done = [a for a in answers if "absent" not in a]
        size = [a["unknowns"] for a in done]
        axes[0].loglog(size, [a["wall_s"] for a in done], "o-", label=method)
        axes[1].loglog(size, [max(a["peak_mb"], 1.0) for a in done], "o-", label=method)
    for ax, label in zip(axes, ("time (s)", "peak memory above the imports (MB)"), strict=True):
        ax.set_xlabel("unknowns")
        ax.set_ylabel(label)
        ax.grid(visible=True, which="both", alpha=0.3)
        ax.legend()
    figure.savefig(target, metadata={"Date": None})
    plt.close(figure)


@click.command()
@click.option("--largest", default=1e6, show_default=True, help="most unknowns")
@click.option("--patience", default=60.0, show_default=True, help="seconds after which a method is not asked for more")
@click.option("--out", default="docs/scaling.md", show_default=True, help="Markdown file; the SVG lies beside it")
@click.option("--one", nargs=2, default=None, help="internal: run one size with one method and print it")
def main(largest: float, patience: float, out: str, one: tuple[str, str] | None) -> None:
    """Run the ladder and write table and picture."""
    if one:
        rigid = one[1] in RIGID
        print(json.dumps(run_rigid_here(int(one[0]), RIGID[one[1]]) if rigid else run_here(int(one[0]), one[1])))
        return
    unknowns = [round(m) for m in 10.0 ** np.arange(3.0, np.log10(largest) + 0.01, 0.5)]
    results: dict[str, list[dict]] = {}
    for method in (*METHODS, *RIGID):
        results[method] = []
        for m in unknowns:
            answer = run(m if method in RIGID else round(np.sqrt(0.5 * m)), method, patience)
            print(method, m, answer, flush=True)
            results[method].append(answer)
            if "absent" in answer or answer["wall_s"] > patience:
                break
    rigid_results = {method: results[method] for method in RIGID}
    load_step = {method: results[method] for method in METHODS}
    target = Path(out)
    story = (__doc__ or "").split("\n", 2)[2].strip()
    text = (
        f"# Scaling of one load step\n\n{story}\n\n{table(load_step)}\n\n"
        f"## The rigid curtain\n\n{rigid_table(rigid_results)}\n\n"
        f"![time and memory]({target.stem}.svg)\n\n"
        "Mesh: scikit-fem mesh and arrays. Assembly: sparsity pattern, all calls of the law, tangents. Linear: "
        f"factors and solves. Memory above what the imports take.\n\n{describe()}\n"
        f"Repeat: `python -m benchmarks.scaling --largest {largest:g}`.\n"
    )
    picture = target.with_suffix(".part.svg")
    draw(results, picture)
    os.replace(picture, target.with_suffix(".svg"))
    part = target.with_suffix(".part")
    part.write_text(text)
    os.replace(part, target)


if __name__ == "__main__":
    main()
