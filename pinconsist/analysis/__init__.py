"""Analysis without integration: equilibria, linearisation, modes, inverse dynamics, actuation."""
