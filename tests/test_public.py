"""The public names and their parameters, listed once more so that they change only on purpose; and how they load."""

import ast
import inspect
import re
import subprocess
import sys
from functools import cached_property
from pathlib import Path

import pytest
from helpers.signatures import PARAMETERS

import pinconsist as pc

ERRORS = """
AssemblyError EquilibriumError FormatError InputError MissingExtraError PinconsistError SavingError SingularSystemError
UserFunctionError
""".split()
METHODS = {  # of classes, with their parameters; None: an attribute that is computed
    "Actuation": {
        "positions": "q",
        "closure": "positions q",
        "message": None,
        "condition": "q",
        "jacobian": "q",
        "jacobian_rate": "q v",
        "derivatives": "parameters q",
        "velocity": "q v",
        "acceleration": "q v a",
        "limits": "q",
        "mass_matrix": "q",
        "bias": "q v | t",
        "gravity": "q",
        "forward": "q v torques | t",
        "torques": "q v a | forces t",
        "frame": "frame",
        "table": "positions file",
        "to_c": "file",
    },
    "Actuator": {"arms": None, "label": None, "bind": "model"},
    "Assembly": {"largest_gap": None, "redundant": None},
    "Curve": {"rate": "t", "acceleration": "t", "break_points": None},
    "Certificate": {"concerns": None, "not_judged": None, "ok": None, "verdict": None},
    "Energy": {"balance_error": None, "exchanged": None, "work_error": None},
    "Equilibrium": {
        "stable": None,
        "derivatives": "parameters theta",
        "reaction": "loop | axes compliance",
        "joint_force": "joint | axes compliance",
    },
    "GlobalError": {"amplified": None},
    "HeldTorque": {"label": None, "bind": "model"},
    "Impact": {"bind": "mechanism"},
    "InverseDynamics": {
        "derivatives": "parameters theta",
        "reaction": "loop | axes compliance",
        "joint_force": "joint | axes compliance",
    },
    "JointDamping": {"label": None, "bind": "model"},
    "JointFriction": {"label": None, "bind": "model"},
    "JointSpring": {"label": None, "bind": "model", "plain": None},
    "JointTorque": {"label": None, "bind": "model"},
    "Judgement": {"of": "tool", "to_csv": "file", "to_html": "file | run speed"},
    "Linearization": {"A": None, "derivatives": "parameters theta", "modes": ""},
    "Loop": {"rows": None, "placement1": None, "placement2": None},
    "Mechanism": {
        "nq": None,
        "nv": None,
        "nc": None,
        "joints": None,
        "anchored_loops": None,
        "row_labels": None,
        "columns": "joint",
        "joint_index": "joint",
        "configuration": "values base",
        "velocity": "values",
        "q": "values **joints",
        "with_loops": "*loops",
        "add_loops": "*loops",
        "with_forces": "*forces",
        "add_forces": "*forces",
        "with_contacts": "*contacts",
        "add_contacts": "*contacts",
        "contact_elements": None,
        "with_control": "control",
        "with_gravity": "gravity",
        "with_armature": "armature",
        "with_parameters": "values",
        "lock": "joints q",
        "lock_spins": "q0",
        "reduced": "q0",
        "reanchored": "q0",
        "corrected": "precision",
        "to_pinocchio": "q0",
    },
    "ElementForce": {"peak": "of"},
    "JointForce": {"peak": "of"},
    "Reaction": {"peak": "of"},
    "Modes": {"frequencies": None, "hertz": None, "damping_ratios": None},
    "Motion": {"numbers": None, "rate": "t", "acceleration": "t"},
    "Outcome": {"success": None},
    "Piecewise": {"label": None, "bind": "model"},
    "Sampled": {"label": None, "bind": "model"},
    "Sensitivities": {"at": "t", "of": "function"},
    "SerialEquivalent": {"to_yaml": "file", "to_mjcf": "file"},
    "StepLinearization": {
        "A": None,
        "B": None,
        "lam_x": None,
        "lam_u": None,
        "coordinates": None,
        "A_reduced": None,
        "B_reduced": None,
        "frame": "frame",
    },
    "Servo": {"label": None, "bind": "model"},
    "Simulation": {
        "reset": "q0 v0 t0",
        "set_parameters": "values",
        "linearized": "dt | inputs",
        "copy": "",
        "step": "dt control",
        "state": None,
        "mechanism": None,
        "lam": None,
        "events": None,
        "solution": "",
    },
    "Simulations": {
        "mechanism": None,
        "state": None,
        "lam": None,
        "step": "dt control",
        "reset": "which q0 v0 t0",
        "set_parameters": "values which",
    },
    "Solution": {
        "modes": None,
        "impacts": None,
        "contact": "name mechanism",
        "y": None,
        "check": "mechanism error",
        "error": None,
        "mechanism": None,
        "at": "t mechanism",
        "energy": "mechanism",
        "evaluate": "quantity mechanism",
        "plot": "*pictures | file mechanism",
        "series": "quantity mechanism",
        "reaction": "loop mechanism | axes compliance",
        "contact_forces": "mechanism | axes",
        "play": "viewer mechanism | speed fps",
        "joint_force": "joint mechanism | axes compliance",
        "force": "name mechanism",
        "position": "joint mechanism",
        "velocity": "joint mechanism",
        "acceleration": "joint mechanism",
        "frame": "frame mechanism",
        "torque": "name mechanism",
        "power": "name mechanism",
        "to_dataframe": "mechanism | forces",
        "to_csv": "file mechanism | forces",
        "export_html": "file mechanism **options",
        "render": "file mechanism | speed traces forces at",
        "summary": "",
        "save": "file",
        "load": "file",
    },
    "SpringDamper": {"label": None, "bind": "model"},
    "Bushing": {"label": None, "bind": "model"},
    "Torque": {"label": None, "torque": "t q v", "derivatives": "t q v"},
    "Wrench": {"label": None, "bind": "model"},
}


def parameters(function):
    """Names of the parameters, those after a bar by name only."""
    words = []
    for one in inspect.signature(function).parameters.values():
        if one.name.startswith("_") or one.name == "self":
            continue
        if one.kind is one.KEYWORD_ONLY and "|" not in words:
            words.append("|")
        words.append({one.VAR_POSITIONAL: "*", one.VAR_KEYWORD: "**"}.get(one.kind, "") + one.name)
    return " ".join(words)


def test_public_names():
    assert pc.__all__ == sorted([*PARAMETERS, *ERRORS])
    for name in pc.__all__:
        assert getattr(pc, name).__doc__, name
        assert name in dir(pc)
    assert all(issubclass(getattr(pc, name), pc.PinconsistError) for name in ERRORS)


@pytest.mark.parametrize("name", PARAMETERS)
def test_parameters(name):
    assert parameters(getattr(pc, name)) == PARAMETERS[name]


PAPER = {  # pinconsist.paper
    "Comparison": "name order runs",
    "FixedStepRun": "t p v lam",
    "Reference": "t q v lam",
    "ReferenceProblem": "name system t0 p0 v0 exact",
    "Run": "h order loop of unit t exact consistent every_step true from_exact q lam v_given v_consistent",
    "compare": "subject steps | order count q0 v0",
    "plot_comparison": "rows file",
    "consistent_initial_velocity": "system t0 p0 v0 step",
    "reference_problem": "name",
    "reference_solution": "system t0 p0 v0 times | rtol atol",
    "solve": "system t_span p0 v0 step | order consistency",
}


def test_names_of_the_paper():
    assert {name: parameters(getattr(pc.paper, name)) for name in pc.paper.__all__} == PAPER
    assert "paper" in dir(pc)


def methods(kind):
    """Public methods of a class, with their functions, and attributes that are computed."""
    bases = [base for base in reversed(kind.__mro__) if base.__module__.startswith("pinconsist")]
    for name, member in {name: member for base in bases for name, member in vars(base).items()}.items():
        computed = isinstance(member, property | cached_property)
        if not name.startswith("_") and (callable(member) or computed or isinstance(member, classmethod)):
            function = getattr(member, "fget", None) or getattr(member, "func", None) or getattr(kind, name)
            yield name, function, computed


@pytest.mark.parametrize("name", METHODS)
def test_methods(name):
    found = {m: None if computed else parameters(f) for m, f, computed in methods(getattr(pc, name))}
    assert found == METHODS[name]


@pytest.mark.parametrize("name", sorted({*PARAMETERS} - {"HessenbergProblem"}))  # its methods are the method's to call
def test_type_checkers_know_what_is_returned(name):
    """Else ``mypy --strict`` refuses the call in a user's script."""
    public = getattr(pc, name)
    functions = [f for _, f, _ in methods(public)] if isinstance(public, type) else [public]
    for function in functions:
        assert function.__annotations__.get("return"), function


def documented():
    """Everything public: what it is, and the function behind it (None of a class and of what is computed)."""
    for name in pc.__all__:
        public = getattr(pc, name)
        is_class = isinstance(public, type)
        yield pytest.param(public, None if is_class else public, id=name)
        for member, function, computed in methods(public) if is_class else ():
            yield pytest.param(getattr(public, member), None if computed else function, id=f"{name}.{member}")


def told(doc):
    """What a docstring speaks of as code: the entries of its lists of parameters and attributes, words in backticks."""
    entries = re.findall(r"^(?:Parameters|Attributes)\n-+\n(.*?)(?=\n\n\w+\n-+$|\Z)", doc, re.MULTILINE | re.DOTALL)
    heads = [line.split(" : ")[0] for entry in entries for line in entry.splitlines() if line[:1].strip()]
    return {word for part in (*heads, *re.findall(r"`+([^`]+)`+", doc)) for word in re.findall(r"\w+", part)}


SAYS_WHAT = re.compile(r"(The|A|An|What|Where|Whether|How)\b|\W|\w\b|\w+ .*\band return (its|the) ")
"""As in "The index …", "(Φ, ρ), …", "U at …", "Write … and return its path"."""


@pytest.mark.parametrize(("public", "function"), list(documented()))
def test_docstrings_are_complete(public, function):
    """Each says what it is, names each parameter, and what a function returns: under Returns or from its start on."""
    doc, is_class = inspect.getdoc(public) or "", isinstance(public, type)
    assert doc and not (is_class and doc.startswith(f"{public.__name__}(")), "none, or only that of a dataclass"
    if function is not None or (is_class and "__init__" in vars(public)):  # an error may have that of Exception
        missing = set(re.findall(r"\w+", parameters(public))) - told(doc)
        assert not missing, f"parameters that its docstring does not name: {missing}"
    if function is not None and function.__annotations__.get("return", "not said") not in (None, "None"):
        assert "\nReturns\n---" in doc or SAYS_WHAT.match(doc), "it does not say what it returns"


def test_type_checkers_see_the_names_that_are_loaded_when_they_are_used():
    stub = ast.parse(Path(pc.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    seen = {(node.module, each.asname) for node in stub.body if isinstance(node, ast.ImportFrom) for each in node.names}
    assert seen == {(module, name) for name, module in pc._MODULE_OF.items()} | {(None, "paper")}
    assert Path(pc.__file__).with_name("py.typed").is_file()


def test_importing_loads_no_scipy_and_no_viewer():
    heavy = ("scipy", "pinocchio", "yaml", "typer", "matplotlib", "meshcat")
    code = f"import sys, pinconsist; print([m for m in {heavy} if m in sys.modules])"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "[]"


def test_the_function_simulate_is_not_hidden_by_a_module():
    code = "import pinconsist.run.simulation, pinconsist as pc; print(callable(pc.simulate), callable(pc.integrate))"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "True True"


def test_importing_costs_little():
    """Beside Pinocchio (and numpy with it) only a few modules of Python's own library come with the package."""
    code = "import sys, pinocchio; before = set(sys.modules); import pinconsist; print(*set(sys.modules) - before)"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    own = {name for name in printed if name.startswith("pinconsist")}
    assert own == {"pinconsist", "pinconsist.engine", "pinconsist.errors"} and len(printed) < 24
    assert all(name.split(".")[0] in sys.stdlib_module_names for name in set(printed) - own)
