"""Rings drawn to strings beside published tests: nine three-ring chains of rockfall nets, a butted and a riveted ring.

The chains are those of Southwest Jiaotong University: rings of 300 mm, 900 mm of chain, pulled until a ring breaks;
forces and elongations as quoted in this project's notes, the paper itself was not at hand. A ring is a bundle of
windings, of the radius of the smallest circle around as many wires, and inside of it are 300 mm.
"""

from dataclasses import replace

import numpy as np

from benchmarks.frame import Section, table
from benchmarks.measure import Row
from rve import Cell, pulled_ring, reference_cell
from rve.common.materials import STEEL
from rve.locking import string_states
from rve.wire import rupture_stress, straightened_ring

INSIDE = 300.0
"""Diameter of a ring inside of its bundle in mm: three rings in a row are the 900 mm of the tests."""
WIRE = replace(STEEL, name="rope wire", yield_N_per_mm2=1770.0, ultimate_N_per_mm2=1770.0)
CHAINS = (
    (3.0, 4, 30.1, 515.0),
    (3.0, 5, 44.9, 519.0),
    (3.0, 7, 69.7, 509.0),
    (3.0, 9, 80.6, 490.0),
    (3.0, 12, 110.9, 491.0),
    (3.0, 16, 177.7, 476.0),
    (3.0, 19, 209.4, 472.0),
    (2.2, 3, 9.87, 521.0),
    (2.2, 4, 17.57, 517.0),
)
"""Diameter of the wire in mm, windings, force in kN and elongation in mm at which the chain broke."""
BUNDLE = {3: 2.1547, 4: 2.4142, 5: 2.7013, 7: 3.0, 9: 3.6131, 12: 4.0296, 16: 4.6154, 19: 4.8637}
"""Radius of the smallest circle around as many equal circles, over theirs (E. Friedman, Circles in Circles)."""
SHARES = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99)
GAUGES = {"16 awg": 1.291, "16 swg": 1.626}
BORE = 9.0 / 16.0 * 25.4


def chain_row(wire: float, windings: int, force_kN: float, elongation: float) -> Row:
    """A chain beside three rings of its bundle, which lengthen from rings in a row to strings in a row."""
    r2 = BUNDLE[windings] * 0.5 * wire
    r1 = 0.5 * INSIDE + r2
    cell = Cell(r1, r2)
    drawn = string_states(cell, np.array([[0.0, 0.0, 1.0]]), reference_cell(cell).sides_mm)
    pitch = 0.5 * float(np.linalg.norm(drawn.lattice(0)[1]))  # two rings along the grain
    ours, thin = 3.0 * (pitch - INSIDE), 3.0 * (0.5 * np.pi - 1.0) * INSIDE
    band = rupture_stress(WIRE)
    assert band is not None
    area = 2e-3 * windings * 0.25 * np.pi * wire**2  # of both strands, for kN
    low, high = (area * stress for stress in band)
    collapse = 1e-3 * windings * pulled_ring(r1, 0.5 * wire, WIRE).collapse_N
    return {
        "wire, mm": wire,
        "windings": windings,
        "elongation, mm": elongation,
        "strings, mm": ours,
        "difference": ours / elongation - 1.0,
        "without thickness": thin / elongation - 1.0,
        "force, kN": force_kN,
        "band, kN": f"{low:.1f} to {high:.1f}",
        "in the band": low <= force_kN <= high,
        "over 2 A sigma": force_kN / (area * 1770.0),
        "over collapse": force_kN / collapse,
        "work of bending, J": 1e-3 * 3.0 * windings * float(straightened_ring(r1, 0.5 * wire, 1770.0).work_Nmm[-1]),
    }


def ring_row(name: str, wire: float, joint: str, force: float) -> Row:
    """A ring of mild steel, 9/16 inch inside, beside a force at which it opened or broke."""
    r1, r2 = 0.5 * (BORE + wire), 0.5 * wire
    ring = pulled_ring(r1, r2, STEEL, joint)
    band = ring.rupture_N
    return {
        "ring": name,
        "wire, mm": wire,
        "force, N": force,
        "first yield, N": ring.first_yield_N,
        "collapse, N": ring.collapse_N,
        "strings break, N": None if band is None else f"{band[0]:.0f} to {band[1]:.0f}",
        "yield stress at which it collapses, N/mm2": float(STEEL.yield_N_per_mm2 or 0.0) * force / ring.collapse_N,
    }


def hardening_row(share: float) -> Row:
    """Force over that at collapse, and part of the work, once the forces have gone this share of their way."""
    row: Row = {"share of the way": share}
    for forces in (2, 3, 4):
        path = straightened_ring(5.0, 0.5, 1.0, forces, 20_001)
        way = (path.reach_mm - path.reach_mm[0]) / np.ptp(path.reach_mm)
        row[f"{forces} forces"] = float(np.interp(share, way[:-1], path.force_N[:-1]) / path.force_N[0])
        row[f"{forces} forces, work"] = float(np.interp(share, way, path.work_Nmm) / path.work_Nmm[-1])
    return row


def measure(full: bool) -> Section:
    """Both tables; `full` has no more."""
    del full
    chains = [chain_row(*one) for one in CHAINS]
    rings = [
        ring_row(f"{kind}, {gauge}", wire, joint, force)
        for kind, joint, force in (("butted", "butted:90", 27.0), ("riveted", "welded", 400.0))
        for gauge, wire in GAUGES.items()
    ]
    worst, thin = (max(abs(row[key]) for row in chains) for key in ("difference", "without thickness"))
    outside = [f"{row['wire, mm']:g} mm, {row['windings']} windings" for row in chains if not row["in the band"]]
    share = [row["over 2 A sigma"] for row in chains]
    middle, mid_force = (hardening_row(0.5)[key] for key in ("2 forces, work", "2 forces"))
    told = (
        f"Elongation: within {worst:.1%} of all nine chains; strings without thickness miss by up to {thin:.1%}, since "
        "thick bundles take length in their bends. What is left grows with the windings: chains of few lengthen more "
        "than strings, those of many less. That wires stretch before they break is left out.\n\n"
        f"Force: {min(share):.2f} to {max(share):.2f} of 2 A sigma. Outside of the band 0.30 to 0.56: "
        f"{'; '.join(outside) or 'none'}; the stress of the thinner wire is taken to be that of the thicker one. "
        "What decides within the band these tests do not tell.\n\n"
        f"From circle to string: half of the way costs {middle:.0%} of the work of two forces, at {mid_force:.2f} "
        "times the collapse load; the force grows beyond bounds at the end of the way only.\n\n"
        "Single rings: the tests name neither steel nor gauge table; the last column is the yield stress with which "
        "the collapse load is the test's. A riveted ring fails at its rivet, which no model here has: its force is "
        "beyond the collapse of a welded ring, and of the order of that of strings."
    )
    forms = {"elongation, mm": ".0f", "strings, mm": ".1f", "difference": "+.1%", "without thickness": "+.1%"}
    forms |= {"over 2 A sigma": ".2f", "over collapse": ".1f", "force, kN": "g", "windings": "d"}
    tables = (
        table("Chains of three rings", chains, forms),
        table("From circle to string", [*map(hardening_row, SHARES)], {"share of the way": ".0%"}),
        table("Single rings, 9/16 inch inside, S235", rings, {"yield stress at which it collapses, N/mm2": ".0f"}),
    )
    return Section("Rings drawn to strings", TEXT, tables, conclusion=told)


TEXT = """Chains (Southwest Jiaotong University, as quoted in this project's notes): elongation and force at which they
broke; *strings*: three rings of the bundle that are drawn from circles to loops about each other, `h_strings` of 4-in-1
along the grain; *without thickness*: 3 (pi/2 - 1) 300 mm. *band*: 0.30 to 0.56 of 2 A sigma, A of all windings, sigma =
1,770 N/mm2. *over collapse*: force over the sum of the plastic collapse loads of its windings; *work of bending*: 4 pi
M_p a ring and winding. From circle to string: force over the collapse load and part of the work, for forces evenly
spread in the plane of a ring. Single rings: one of 16 gauge that opened at 27 N, a riveted one that broke at 400 N."""
