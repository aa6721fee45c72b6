"""Optimal control: runs and their pieces as functions with exact derivatives, for solvers of other packages."""
