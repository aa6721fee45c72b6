"""Optimal control: runs as parts of problems that others solve."""
