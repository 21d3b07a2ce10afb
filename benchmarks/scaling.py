"""How time and memory of one load step grow with the mesh: `python -m benchmarks.scaling [--largest 1e6]`.

Problem: clamped neo-Hookean square, Q1, stretched to 1.05 in one load step, Newton to 1e-9; the sizes run from 1e3 to
1e6 unknowns in half decades. Each run is a process of its own, so that its peak memory is its own; 1 BLAS thread.
Methods: CHOLMOD, SuperLU, conjugate gradients with smoothed aggregation (`multigrid`), conjugate gradients with the
diagonal (`jacobi`). A method is not asked for more once a run took longer than `--patience` seconds.

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
    for ax, label in zip(axes, ("time of a load step (s)", "peak memory above the imports (MB)"), strict=True):
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
        print(json.dumps(run_here(int(one[0]), one[1])))
        return
    sizes = [round(np.sqrt(0.5 * m)) for m in 10.0 ** np.arange(3.0, np.log10(largest) + 0.01, 0.5)]
    results: dict[str, list[dict]] = {}
    for method in METHODS:
        results[method] = []
        for n in sizes:
            answer = run(n, method, patience)
            print(method, n, answer, flush=True)
            results[method].append(answer)
            if "absent" in answer or answer["wall_s"] > patience:
                break
    target = Path(out)
    story = (__doc__ or "").split("\n", 2)[2].strip()
    text = (
        f"# Scaling of one load step\n\n{story}\n\n{table(results)}\n\n![time and memory]({target.stem}.svg)\n\n"
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
