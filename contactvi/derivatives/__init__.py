"""Exact derivatives of steps and of the equations of motion."""
