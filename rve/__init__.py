"""Rigid interlinked rings in a periodic cell: where a ring mesh locks under each load direction."""

from rve.common.moved import attach_root

__getattr__, __dir__, __all__ = attach_root(
    __name__,
    __file__,
    {
        "rve.directions": "LoadDirections read_loads",
        "rve.finite": "FiniteOptions FiniteSolution HalfSpace RingContacts RingStep RoundBody cell_of_sides "
        "ring_places slack_rings step_rings with_bodies",
        "rve.geometry": "cauchy_line_load cauchy_of deformation_gradient green_lagrange load_angles second_pk",
        "rve.placed": "CellForces DrawnRings Fit LockedArrangements NEAR NearestPoses POSE_MEANINGS axes_of_weave "
        "cell_forces fit_rings largest_forces locked_arrangements nearest_poses offsets reference_shares",
        "rve.support_function": "SupportValue",
        "rve.wire": "PulledRing",
    },
)
"""The public names, listed in `__init__.pyi`: their modules are imported when they are first used. Those that were
public in version 0.2 say where they are; the list goes with version 0.4."""
