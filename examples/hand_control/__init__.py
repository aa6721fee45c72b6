"""What hand_throw.py and hand_roll.py share: the scene, and a cost of its runs with the gradient."""
