"""Independent references: slow, obvious NumPy on `pin`, closed forms, DOP853 runs with events.

Nothing here imports contactvi. Each oracle is checked in tests/oracles/test_*.py before the engine is
compared with it.
"""
