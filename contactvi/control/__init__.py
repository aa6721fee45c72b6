"""Optimal control and design through contact: whole runs as nonlinear programmes for the solvers of others."""

from contactvi.control.evaluation import Evaluation, Failure
from contactvi.control.inputs import Inputs
from contactvi.control.problem import Problem
from contactvi.control.terms import Constraint, Quadratic, quadratic

__all__ = ["Constraint", "Evaluation", "Failure", "Inputs", "Problem", "Quadratic", "quadratic"]
