"""Derivatives of a run, of its motion and its multipliers, with respect to parameters.

Reading order:

1. :mod:`variants`: all parameters, and the derivatives of the equations with respect to them, by differences between
   mechanisms in which one parameter is slightly larger or smaller; ``run/known.py``: parameters that need no
   such mechanisms, because the derivatives of the equations are known.
2. ``engine/linear.hpp``: the linear equations of one accepted step of Radau IIA, and of the multipliers.
3. :mod:`leg`: the recursion over the accepted steps, and its transpose. The steps themselves are in C++.
   :mod:`laws`: digital controllers, whose torques depend on states at samples.
4. :mod:`starts`: initial derivatives, at the start of a run and after an event.
5. :mod:`passes`: the forward pass over all legs of a run, and the backward pass for one number and many parameters.
6. :mod:`prepare`: the run, and parameters by name; :mod:`sensitivities`: the public functions.

A leg is the part of a run between two starts; a run starts again after each event that changes the state.
"""
