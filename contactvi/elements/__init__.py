"""What acts on a scene besides contact: constraints, springs, forces, drives, and the signals and functions in them."""
