"""Constraints: records of loops, couplings, drives and own Φ(t, q), and the rows Φ, J that they stand for."""
