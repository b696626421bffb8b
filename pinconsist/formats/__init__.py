"""File formats: files → Mechanism, and back."""

from .catalogue import models
from .load import load

__all__ = ["load", "models"]
