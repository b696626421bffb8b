"""``python -m benchmarks``."""

from .app import main

main()
