"""`contactvi verify`: cases with known answers."""
