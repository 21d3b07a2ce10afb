"""Finite pieces of ring mesh, every ring a rigid body: layout, contacts of near pairs, equilibrium under dead loads."""
