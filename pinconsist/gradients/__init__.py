"""Derivatives of a run by parameters: those of its motion and of its multipliers.

To be read in this order:

1. :mod:`varied`: all parameters, and what they change in the equations; :mod:`variants`: the mechanisms beside the one
   that was run, one parameter a little larger or smaller;
   :mod:`known`: parameters that need none, as their derivatives of the equations are known.
2. :mod:`linear`: the linear equations of one accepted step, and of its hidden constraint.
3. :mod:`forward`: the recursion over the accepted steps, and its transpose.
4. :mod:`stages` and :mod:`stage_leg`: the same of Radau IIA, whose steps have no history.
5. :mod:`starts`: the derivatives with which a run begins, and begins again after an event; :mod:`history`: those of
   the first points of BDF.
6. :mod:`redundant`: the multipliers of rows that depend on each other.
7. :mod:`lead`: all legs of a run; :mod:`named`: parameters by name; :mod:`sensitivities`: what users call.
8. :mod:`gradient`: the same backwards, for one number and many parameters, and what users call.
"""
