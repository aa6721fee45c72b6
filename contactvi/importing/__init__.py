"""Models from files and from Pinocchio, the report of what was used and changed, and the checks they have to pass."""
