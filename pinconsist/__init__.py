"""Index-3 BDF for closed-chain mechanisms on Pinocchio, with multipliers that are right from the first step on.

The public names below are loaded when they are first used, so that importing the package costs little.
"""

import logging as _logging
from importlib import import_module as _import_module

__version__ = "0.1.0"

_WHERE = {
    "analysis.equilibrium": ("Equilibrium", "equilibrium"),
    "analysis.inverse_dynamics": ("InverseDynamics", "inverse_dynamics"),
    "analysis.linearize": ("Linearization", "linearize"),
    "analysis.modes": ("Modes",),
    "certificate": ("Certificate",),
    "dae.events": ("Event",),
    "dae.hessenberg": ("HessenbergProblem",),
    "errors": (
        "AssemblyError",
        "EquilibriumError",
        "FormatError",
        "InputError",
        "MissingExtraError",
        "PinconsistError",
        "SavingError",
        "SingularSystemError",
        "UserFunctionError",
    ),
    "formats.catalogue": ("models",),
    "formats.load": ("load",),
    "formats.write": ("write",),
    "mechanism.assembly": ("Assembly", "assemble"),
    "mechanism.custom": ("Constraint",),
    "mechanism.energy": ("Energy",),
    "mechanism.forces": (
        "JointDamping",
        "JointFriction",
        "JointSpring",
        "JointTorque",
        "Servo",
        "SpringDamper",
        "Torque",
        "Wrench",
    ),
    "mechanism.joint_constraints": ("Coupling", "Drive"),
    "mechanism.loops": ("Loop",),
    "mechanism.mechanism": ("Mechanism",),
    "mechanism.motion": ("Motion",),
    "mechanism.reactions": ("Reaction",),
    "runs": ("Rerun", "record", "rerun", "resume"),
    "simulation": ("consistent_initial_velocity", "integrate", "simulate"),
    "solution": ("Solution",),
    "comparison": ("compare",),
    "reference": ("reference_problem", "reference_solution"),
    "sweeps": ("Outcome", "sweep"),
    "view.page": ("export_html", "replay"),
    "view.plots": (
        "plot_comparison",
        "plot_drift",
        "plot_energy",
        "plot_multipliers",
        "plot_phase",
        "plot_solution",
        "plot_steps",
        "plot_trajectory",
        "plot_work_precision",
    ),
}
_MODULE_OF = {name: module for module, names in _WHERE.items() for name in names}
__all__ = sorted(_MODULE_OF)

_logging.getLogger(__name__).addHandler(_logging.NullHandler())  # silent unless the application listens


def __getattr__(name: str):
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(_import_module(f".{_MODULE_OF[name]}", __name__), name)
    return value


def __dir__():
    return [*globals(), *__all__]
