"""The loops of a mechanism as Pinocchio's contact models, which `pin.constraintDynamics` takes.

Of the loop kinds a point and a frame have such a model; two points hold a hinge.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .assembly import assemble
from .checks import frame_of, workspace
from .closing import LoopSolver
from .loops import Loop, unit

KINDS = ("point", "frame", "hinge")
PROXIMAL = (1e-14, 1e-10, 30)  # accuracy, regularisation and iterations of the proximal method


def contact_models(mechanism, tilted=()) -> list:
    """`pin.RigidConstraintModel` of each loop, in their order, in the axes of anchor 1.

    Their forces, in Pinocchio's sign, act on body 1: they are −λ. A hinge is a point, and a second one 0.1 m along its
    axis if it is among the names `tilted`. Raises InputError for loops that are none of these.
    """
    found = []
    for loop in mechanism.loops:
        if not isinstance(loop, Loop) or loop.kind not in KINDS:
            raise InputError(
                f"{mechanism.name}: {loop.name!r} is of kind {loop.kind!r}, for which Pinocchio has no contact model; "
                f"it has {', '.join(KINDS)} (two points)"
            )
        kind = pin.ContactType.CONTACT_6D if loop.kind == "frame" else pin.ContactType.CONTACT_3D
        shifts = [np.zeros(3)] + [0.1 * unit(loop.axis)] * (loop.name in tilted)
        for k, shift in enumerate(shifts):
            made = pin.RigidConstraintModel(kind, mechanism.model, *_ends(mechanism.model, loop, shift), pin.LOCAL)
            made.name = loop.name if k == 0 else f"{loop.name}, second point"
            found.append(made)
    return found


def _ends(model, loop, shift):
    """(joint, place) of both anchors, or of points at `shift` from them."""
    moved, found = pin.SE3(np.eye(3), shift), []
    for name, place in ((loop.frame1, loop.placement1), (loop.frame2, loop.placement2)):
        frame = frame_of(model, name, f"loop {loop.name!r}")
        found += [frame.parentJoint, frame.placement * place * moved]
    return found


class PinocchioModel(NamedTuple):
    """A mechanism as Pinocchio has it.

    Attributes
    ----------
    model : pin.Model
        The tree; a copy.
    constraints : list of pin.RigidConstraintModel
        The loops, for ``pin.constraintDynamics``.
    motors : tuple of str
        Names of motorised joints.
    """

    model: pin.Model
    constraints: list
    motors: tuple[str, ...]


def to_pinocchio(mechanism, q0=None) -> PinocchioModel:
    """See :meth:`Mechanism.to_pinocchio`."""
    contact_models(mechanism)  # what it does not have is reported before assembly
    models = contact_models(mechanism, tilted_hinges(mechanism, assemble(mechanism, q0).q))
    return PinocchioModel(mechanism.model.copy(), models, tuple(mechanism.actuated))


def tilted_hinges(mechanism, q, t=0.0) -> tuple[str, ...]:
    """The hinges whose rows across the axis are needed at a closed configuration; in planar loops they are not."""
    solver = LoopSolver(mechanism, t)
    labels = [solver.loop_rows.labels[row] for row in solver.kept(q)]
    hinges = [loop.name for loop in mechanism.anchored_loops if loop.kind == "hinge"]
    return tuple(name for name in hinges if any(of == name and row.startswith("tilt") for of, row in labels))


class RigidDynamics:
    """`pin.constraintDynamics` of a mechanism, with Baumgarte's correction."""

    def __init__(self, mechanism, tilted=()):
        self.model, self.data = mechanism.model, workspace(mechanism.model)
        self.models, self.datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for model in contact_models(mechanism, tilted):
            self.models.append(model)
            self.datas.append(model.createData())
        self._settings = pin.ProximalSettings(*PROXIMAL)
        pin.initConstraintDynamics(self.model, self.data, self.models, self.datas)

    def correct(self, frequency) -> None:
        """Correct gaps as a critically damped spring of this frequency, rad/s, does."""
        for model in self.models:
            parameters = model.m_baumgarte_parameters
            parameters.Kp, parameters.Kd = frequency**2, 2.0 * frequency
            model.setBaumgarteCorrectorParameters(parameters)

    def acceleration(self, q, v, tau) -> np.ndarray:
        """The acceleration, shape (nv,)."""
        return pin.constraintDynamics(self.model, self.data, q, v, tau, self.models, self.datas, self._settings)

    def loads(self, q, v, tau) -> np.ndarray:
        """Jᵀλ of the loops, shape (nv,): what the equations of motion need beside the other forces."""
        a = np.array(self.acceleration(q, v, tau))
        return pin.rnea(self.model, self.data, q, v, a) - tau
