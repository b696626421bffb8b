"""Measurements of the package and of other integrators: ``python -m benchmarks`` in a checkout.

Not part of the wheel. The other packages are installed by ``pip install --group benchmarks``.
"""
