"""What a scene file says: records, mesh, outline, edges, supports, loads."""
