"""What acts on a scene besides contact: constraints, springs and forces, with their signals and functions."""
