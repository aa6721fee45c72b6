"""Optimal control and design: runs and their pieces as functions with exact derivatives, for the solvers of others."""

from contactvi.control.evaluation import Evaluation, Failure
from contactvi.control.inputs import Inputs
from contactvi.control.problem import Problem
from contactvi.control.terms import Constraint, Quadratic, quadratic

__all__ = ["Constraint", "Evaluation", "Failure", "Inputs", "Problem", "Quadratic", "quadratic"]
