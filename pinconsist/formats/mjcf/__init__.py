"""MJCF, the XML of MuJoCo: read by the package itself.

Pinocchio's own reader parses only the first body of the world, binds a closure by sites to the world, ignores
``active="false"``, ``<equality><joint>``, ``inertiagrouprange`` and ``settotalmass``, takes every ``eulerseq`` for one
that turns with the frame, and makes composite joints, whose derivatives are wrong.

What is read: bodies, frames, hinge, slide, ball and free joints (several in a body too), inertials and inertias from
geoms, defaults, includes, sites; connect, weld and joint equalities; damping, dry friction, springs and armature of
joints, gravity and its compensation. What acts on the bodies in MuJoCo and is not computed here is refused with its
reason. Limits of joints, contacts, sensors and solver settings have no effect; actuators give names only.
"""
