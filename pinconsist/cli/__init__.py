"""The command line: its commands, put together by :mod:`.app`."""

from .app import main

__all__ = ["main"]
