"""A cell whose strain or line load is given: the nearest pose, the contact forces, and how placed rings fit."""
