"""SDF files (sdformat.org), read without libsdformat, which the pip builds of Pinocchio do not have.

The specification is that of versions 1.4 to 1.12. What a file says is carried over in these words:

* ``<joint>`` elements make a net of links, of which a tree is taken; the joints that are left over close loops
  (:mod:`.closing` says which, and how). The poses of a file describe it closed, at q = 0.
* A link without ``<inertial>`` has 1 kg and 1 kg·m², as the specification has it.
* A model that no joint ties to the world floats in SDF. Here it is fixed where it stands unless
  ``load(..., free_flyer=True)`` lets it float: as with URDF files and Pinocchio's own readers, so that one scene in two
  formats is one mechanism. ``<static>`` models never move.
* The name of the only model of a file is left away; else links, joints and frames are ``model::name``. Before version
  1.7 a link and a joint may have one name: the joint is then ``name_joint``.
* Damping and friction of a ball joint act about all its axes. Position limits are kept in the model and do not act.
* Contacts, sensors, plugins and lights are left out. What would change the motion and cannot be carried over is
  refused: ``<include>``, kinematic links, inertias from shapes, fluid added mass, gravity on some links only.
* A screw is one joint of Pinocchio's (helical), a universal joint two hinges ``name_axis``, ``name_axis2`` with a
  massless body between them: Pinocchio's own universal joint has wrong ``computeRNEADerivatives``.
"""
