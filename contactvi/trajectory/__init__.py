"""The result of a run: arrays, polynomials of the steps, the ledger of what is conserved, files and plots."""
