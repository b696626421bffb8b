"""Runs: from the options to the solution and what it says of itself."""
