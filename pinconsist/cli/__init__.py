"""The command line; :mod:`.app` combines its commands."""

from .app import main

__all__ = ["main"]
