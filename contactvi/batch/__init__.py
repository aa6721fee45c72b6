"""Batches: many runs of one scene, in threads of the engine or by an executor, in memory or in a file."""
