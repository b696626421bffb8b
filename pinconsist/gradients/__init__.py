"""Derivatives of a run by parameters: those of its motion and of its multipliers.

To be read in this order:

1. :mod:`variants`: all parameters, and what they change in the equations, by mechanisms beside the one that was run,
   one parameter a little larger or smaller; :mod:`known`: parameters that need none, as their derivatives of the
   equations are known.
2. :mod:`linear`: the linear equations of one accepted step of BDF or Radau IIA, and of the multipliers at a state.
3. :mod:`forward`: the recursion over the accepted steps of BDF, and its transpose; :mod:`stage_leg`: the same of Radau
   IIA, whose steps have no history.
4. :mod:`starts`: the derivatives with which a run begins, and begins again after an event.
5. :mod:`lead`: all legs of a run, forwards, and back for one number and many parameters.
6. :mod:`prepare`: the run, and parameters by name; :mod:`sensitivities`: what users call.
"""
