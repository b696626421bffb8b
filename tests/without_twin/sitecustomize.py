"""On the path of child processes when the suite runs on the Python method: the compiled part is not found."""

import sys

sys.modules["pinconsist._core.twin"] = None
