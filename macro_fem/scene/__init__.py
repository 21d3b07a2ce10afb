"""Reading of scenes: records, mesh, outline, edges, supports, loads."""
