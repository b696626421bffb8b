"""The paper: exact and numerically consistent initial values of index-3 equations, in readable Python.

C. Arévalo, *A note on numerically consistent initial values for high index DAEs*, ETNA 34 (2008), generalised to BDF of
orders 1 to 6. Fixed steps, plain Newton, explicit matrices, scipy for everything else; in reading order:

* ``formula.py``: the weights of BDF,
* ``step.py``: the matrix of a step, and Newton's iteration,
* ``index1.py``: accelerations, starting values and reference solutions by scipy,
* ``consistency.py``: numerically consistent values, and the correction of every step,
* ``solve.py``: the run,
* ``problems.py``, ``compare.py``: the problems and tables of the paper.

It solves any :class:`~pinconsist.engine.problem.Index3System`, among them mechanisms; systems without bodies do not
need Pinocchio. :func:`pinconsist.simulate` uses a separate, adaptive implementation, whose fixed steps are tested
against this one.
"""

from .compare import Comparison, Run, compare
from .consistency import consistent_initial_velocity
from .figure import plot_comparison
from .index1 import Reference, reference_solution
from .problems import ReferenceProblem, reference_problem
from .solve import FixedStepRun, solve

__all__ = [
    "Comparison",
    "FixedStepRun",
    "Reference",
    "ReferenceProblem",
    "Run",
    "compare",
    "consistent_initial_velocity",
    "plot_comparison",
    "reference_problem",
    "reference_solution",
    "solve",
]
