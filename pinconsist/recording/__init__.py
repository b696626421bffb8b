"""Runs that are kept: made from a recipe of plain data, saved as they go, repeated and continued from their file."""
