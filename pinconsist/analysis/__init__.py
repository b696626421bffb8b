"""Rest and small motions: equilibria, linearisation, modes, inverse dynamics."""
