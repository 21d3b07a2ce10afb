"""Which feature tames which extreme, and the test that fails without it."""

from __future__ import annotations

from benchmarks.pages.model import Column, Section, Table

HERE = "tests/test_benchmarks/test_stability_features.py"
EQUILIBRIUM = "tests/test_rve/test_equilibrium.py"
CONTACT = "tests/test_rve/test_contact.py"
# Extreme, feature, where the feature lives, what happens without it, file and name of the test.
FEATURES = (
    (
        "a shallow second minimum in a basin narrower than the samples",
        "a closer look where the slope is least without changing sign",
        "rve/contact.py",
        "the contact is lost",
        CONTACT,
        "test_minima_in_basins_narrower_than_the_samples_are_found",
    ),
    (
        "two contacts of a pair merge (beta near 8 degrees)",
        "both twins of a soft minimum are found, the saddle between them is none",
        "rve/contact.py",
        "stalled",
        EQUILIBRIUM,
        "test_merging_contacts_need_both_twins",
    ),
    (
        "the same in a motion",
        "contact curvature in the time step",
        "rve/stewart_trinkle.py",
        "time-step",
        HERE,
        "test_merging_contacts_of_a_motion_need_their_curvature",
    ),
    (
        "thin wire near a pull along the grain; nearly uniaxial loads",
        "attempts in which mu falls slowly",
        "rve/equilibrium.py",
        "stalled, with as many iterations too",
        HERE,
        "test_narrow_valleys_need_a_slow_fall_of_mu",
    ),
    (
        "second principal load down to 1e-6 of the first",
        "the limit of larger second loads, from inside the tensile cone",
        "rve/uniqueness.py",
        "stalled",
        HERE,
        "test_nearly_uniaxial_loads_need_the_way_from_inside_the_cone",
    ),
    (
        "h_max up to 1e3 s",
        "steps halved until the energy falls",
        "rve/stewart_trinkle.py",
        "time-step",
        HERE,
        "test_large_time_steps_need_halving",
    ),
    (
        "line loads from 1e-8 to 1e8",
        "units of s_hat: only the direction counts",
        "rve/equilibrium.py",
        "stalled",
        HERE,
        "test_loads_of_any_size_need_scaled_units",
    ),
    (
        "wire beyond the jamming limit",
        "refused by name, with both ratios",
        "rve/sweep.py",
        "stalled",
        HERE,
        "test_jammed_wire_needs_its_refusal",
    ),
    (
        "beta just outside 0 to 90 degrees",
        "loads that push are named `compressive`",
        "rve/sweep.py",
        "stalled",
        HERE,
        "test_loads_that_push_need_their_name",
    ),
    (
        "circles that coincide",
        "curvature that is zero to round-off counts as a minimum",
        "rve/contact.py",
        "the contact is lost",
        HERE,
        "test_coinciding_circles_need_the_allowance_for_round_off",
    ),
    (
        "strains and loads that are no numbers",
        "every function of a law refuses them",
        "homogenize/protocol.py",
        "NaN as an answer",
        HERE,
        "test_laws_need_their_check_for_numbers",
    ),
    (
        "supports beyond the largest stretch",
        "the infeasibility certificate",
        "macro_fem/interior.py",
        "stalled or out of iterations, no reason given",
        HERE,
        "test_impossible_supports_need_the_certificate",
    ),
    (
        "slack sheets: a tangent of zero",
        "regularised Newton",
        "macro_fem/descent.py",
        "not_convex",
        HERE,
        "test_slack_sheets_need_regularisation",
    ),
    (
        "hardly extensible sheets, Newton alone",
        "softening with memory of the stress",
        "macro_fem/softened.py",
        "iteration_limit",
        HERE,
        "test_stiff_sheets_need_softening",
    ),
    (
        "rings of 1e9 N/mm",
        "interior points find the taut half-spaces before Newton's method",
        "macro_fem/elastic.py",
        "iteration_limit",
        HERE,
        "test_stiff_rings_need_interior_points",
    ),
)


def measure(full: bool) -> Section:
    """The table; tests/test_benchmarks/test_stability.py checks that every test is there."""
    columns = tuple(Column(name) for name in ("extreme", "tamed by", "in", "without it", "test"))
    rows = tuple(
        (extreme, feature, where, without, f"`{file}::{test}`")
        for extreme, feature, where, without, file, test in FEATURES
    )
    return Section(
        "features",
        "What tames the extremes",
        "Each test solves the extreme, then switches the feature off and asserts that the same input fails: run "
        f"`python -m pytest {HERE} {EQUILIBRIUM} {CONTACT}`, and with `-m slow` the long ones.",
        (Table("Features and their tests", columns, rows),),
        conclusion=f"{len(FEATURES)} features are each shown to be needed by a test that fails without them.",
    )
