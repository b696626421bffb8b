"""The public names, listed once more so that they change only on purpose; and that they are loaded lazily."""

import subprocess
import sys

import pinconsist as pc

NAMES = """
Assembly AssemblyError Certificate Constraint Coupling Drive Energy Equilibrium EquilibriumError Event FormatError
HessenbergProblem InputError InverseDynamics JointDamping JointFriction JointSpring JointTorque Linearization Loop
Mechanism MissingExtraError Modes Motion Outcome PinconsistError Reaction Rerun SavingError Servo SingularSystemError Solution SpringDamper
Torque UserFunctionError Wrench assemble compare consistent_initial_velocity equilibrium export_html integrate
inverse_dynamics linearize load models plot_comparison plot_drift plot_energy plot_multipliers plot_phase
plot_solution plot_steps plot_trajectory plot_work_precision reference_problem reference_solution replay
record rerun resume simulate sweep write
""".split()


def test_public_names():
    assert sorted(pc.__all__) == sorted(NAMES)
    for name in NAMES:
        assert getattr(pc, name).__doc__, name
        assert name in dir(pc)


def test_importing_loads_no_scipy_and_no_viewer():
    heavy = ("scipy", "pinocchio", "yaml", "typer", "matplotlib", "meshcat")
    code = f"import sys, pinconsist; print([m for m in {heavy} if m in sys.modules])"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "[]"


def test_the_function_simulate_is_not_hidden_by_a_module():
    code = "import pinconsist.simulation, pinconsist as pc; print(callable(pc.simulate), callable(pc.integrate))"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "True True"
