"""Files → Mechanism."""

from .catalogue import load, models

__all__ = ["load", "models"]
