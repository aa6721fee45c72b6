"""The scene: parts, pairs, joints and elements, assembled into one model and handed to the engine."""
