"""Index-3 BDF for closed-chain mechanisms on Pinocchio, with multipliers that are right from the first step on."""

import logging as _logging

from .dae.consistency import consistent_initial_velocity
from .dae.events import Event
from .dae.problem import HessenbergProblem
from .errors import (
    AssemblyError,
    FormatError,
    InputError,
    MissingExtraError,
    PinconsistError,
    SingularSystemError,
    UserFunctionError,
)
from .formats.catalogue import load, models
from .mechanism.assembly import Assembly, assemble
from .mechanism.drive import Drive
from .mechanism.forces import ConstantTorque, JointDamping, JointFriction, Torque
from .mechanism.loops import Loop
from .mechanism.mechanism import Mechanism
from .mechanism.springs import SpringDamper
from .simulate import integrate, simulate
from .solution import Solution
from .study.compare import compare
from .study.reference import reference_problem, reference_solution
from .view.meshcat import export_html, replay

__version__ = "0.1.0"

_logging.getLogger(__name__).addHandler(_logging.NullHandler())  # silent unless the application listens

__all__ = [
    "Assembly",
    "AssemblyError",
    "ConstantTorque",
    "Drive",
    "Event",
    "FormatError",
    "HessenbergProblem",
    "InputError",
    "JointDamping",
    "JointFriction",
    "Loop",
    "Mechanism",
    "MissingExtraError",
    "PinconsistError",
    "SingularSystemError",
    "Solution",
    "SpringDamper",
    "Torque",
    "UserFunctionError",
    "assemble",
    "compare",
    "consistent_initial_velocity",
    "export_html",
    "integrate",
    "load",
    "models",
    "reference_problem",
    "reference_solution",
    "replay",
    "simulate",
]
