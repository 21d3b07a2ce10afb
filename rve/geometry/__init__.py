"""Rings and their contacts: circles in space, weaves, cells, poses, kinematics of the membrane."""
