"""The method around its steps: numpy and scipy only. Pinocchio is not needed here. The steps are made in ``_core``.

Read them in this order, from the problem to its integration:

1. :mod:`problem` and :mod:`hessenberg`: what a system must provide, and the general form built from callables.
2. :mod:`bdf`, :mod:`radau_table`, :mod:`charts`: the formulas as small matrices; rotations as coordinates in a chart.
3. :mod:`consistency`: numerically consistent initial values, and the correction of every step.
4. :mod:`kkt` and :mod:`index1`: the equations of index 1, for starts and events.
5. :mod:`control`: fixed steps, or the accuracy of a run; :mod:`rounding`: runs that make no progress.
6. :mod:`segments`, :mod:`events`, :mod:`dense`, :mod:`output`: an accepted step and its polynomial; events and recorded
   rows.
7. :mod:`integrate`: the loop. :mod:`tuning` holds the constants, :mod:`failure` the report of a run that could not
   continue.
"""
