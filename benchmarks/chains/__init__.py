"""Closed chains made by chance, each from its seed, against equations that share nothing with the package.

`scenes` makes them, `equations` and `reference` are what they are compared with, `campaign` runs and judges them.
"""
