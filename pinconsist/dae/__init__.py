"""The methods: numpy and scipy only. Pinocchio is not needed here, nor the compiled method.

Read them in this order, from the problem to its integration:

1. :mod:`problem` and :mod:`hessenberg`: what a system must provide, and the general form built from callables.
2. :mod:`bdf` and :mod:`charts`: the formulas as small matrices; rotations as coordinates in a chart.
3. :mod:`kkt` and :mod:`newton`: the block matrix of a step, and the iteration that solves one.
4. :mod:`consistency`: numerically consistent initial values, and the correction of every step.
5. :mod:`control` and :mod:`rounding`: step and order; when an error is rounding, and when a run makes no progress.
6. :mod:`index1` and :mod:`start`: the equations of index 1, and the history with which a run begins.
7. :mod:`stepper`, :mod:`segments`, :mod:`events`, :mod:`dense`, :mod:`output`: an accepted step and its polynomial;
   events and recorded rows.
8. :mod:`radau` and :mod:`radau_stepper`: the one-step method, its stage equations and its run.
9. :mod:`integrate`: the loop. :mod:`tuning` holds the constants, :mod:`failure` the report of a run that could not
   continue.
"""
