"""Independent rows of a matrix."""

from . import required


def pivoted(rows):
    """The order of rows by a pivoted QR factorisation of their transpose, and the sizes of its pivots."""
    return required().pivoted(rows)
