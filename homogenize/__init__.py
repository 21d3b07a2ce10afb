"""From a strain-load table to a convex, tension-only membrane law."""
