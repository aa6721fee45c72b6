"""Runs: `simulate`, `Simulator`, steps chosen for an accuracy, targets of servos, sensors, messages."""
