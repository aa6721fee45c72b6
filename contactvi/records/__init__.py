"""What a run records of impacts, contacts, works and reactions, as sequences and as arrays."""
