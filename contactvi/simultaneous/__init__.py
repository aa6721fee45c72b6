"""Several impacts at one instant, as sequences of single impacts: all outcomes, and when the order matters."""
