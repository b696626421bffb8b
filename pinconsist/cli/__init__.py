"""The command line: one module for each command, :mod:`.app` puts them together."""

from .app import main

__all__ = ["main"]
