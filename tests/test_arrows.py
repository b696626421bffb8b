"""The shape of the package: arrows between its parts point one way, and a few habits hold everywhere."""

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1] / "pinconsist"
FILES = {path.relative_to(ROOT).as_posix(): path for path in sorted(ROOT.rglob("*.py"))}

# Which room may import which. Mechanism knows of the engine only the form of its systems and the laws of contacts.
MAY_IMPORT = {
    "__init__": set(),  # the public names, loaded when they are used; for the command line alone
    "errors": set(),
    "files": {"errors"},
    "engine": {"errors"},
    "mechanism": {"engine", "errors"},
    "analysis": {"mechanism", "engine", "files", "errors"},
    "formats": {"mechanism", "files", "errors"},
    "view": {"mechanism", "files", "errors"},
    "run": {"engine", "mechanism", "formats", "view", "files", "errors"},
    "gradients": {"run", "engine", "mechanism", "errors"},
    "paper": {"run", "view", "engine", "mechanism", "errors"},
    "judging": {"run", "engine", "formats", "view", "mechanism", "files", "errors"},
    "cli": {"__init__", "paper", "judging", "run", "view", "formats", "mechanism", "files", "errors"},
}
ENGINE_SEEN_BY = {"mechanism": {"problem", "arguments", "complementarity", "pivots", "systems"}}  # systems: rows
OPTIONAL = {
    "pxr",
    "meshcat",
    "matplotlib",
    "pandas",
    "casadi",
    "rich",
    "typer",
    "yaml",
    "defusedxml",
    "coal",
}
TOP_LEVEL_ALLOWED = {  # parsers: catalogue.py and scene.py import these files only where they are used
    "formats/loopfile.py": {"yaml"},
    "formats/write.py": {"yaml"},
    "view/visuals.py": {"defusedxml"},
}


@functools.cache
def tree_of(name):
    return ast.parse(FILES[name].read_text(encoding="utf-8"))


def part_of(name):
    return name.split("/")[0].removesuffix(".py")


def imports(name, tree=None):
    """(absolute dotted module, node) of every import, also those inside functions; imported names count."""
    package = ["pinconsist", *name.split("/")[:-1]]
    for node in ast.walk(tree or tree_of(name)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module, node
            yield from ((f"{module}.{alias.name}", node) for alias in node.names)


def inner(name):
    """Parts and modules of the package that a file imports, as tuples ("engine", "kkt")."""
    for module, node in imports(name):
        first, *rest = module.split(".")
        if module == "pinconsist" and isinstance(node, ast.Import):
            yield ("__init__",)  # the whole package: an arrow to everything
        known = rest and any(f"{'/'.join(rest[:n])}{end}" in FILES for n in (1, 2) for end in (".py", "/__init__.py"))
        if first == "pinconsist" and known:
            yield tuple(rest)


def at_import(tree):
    """The statements that run when a module is imported: everything outside functions and TYPE_CHECKING."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        yield node


def test_every_file_is_in_a_known_part():
    assert {part_of(name) for name in FILES} == set(MAY_IMPORT)


@pytest.mark.parametrize("name", [name for name in FILES if name != "__init__.py"])
def test_arrows_point_one_way(name):
    part = part_of(name)
    wrong = {rest[0] for rest in inner(name) if rest[0] not in {part, *MAY_IMPORT[part]}}
    assert not wrong, f"{name} imports {', '.join(sorted(wrong))}"
    if part in ENGINE_SEEN_BY:
        seen = {rest[1] for rest in inner(name) if rest[0] == "engine" and len(rest) > 1}
        assert seen <= ENGINE_SEEN_BY[part], f"{name} imports engine.{seen}"


def test_the_parts_form_no_cycle():
    order, waiting = [], dict(MAY_IMPORT)
    while waiting:
        ready = [part for part, needs in waiting.items() if needs <= set(order)]
        assert ready, f"a cycle among {set(waiting)}"
        order += ready
        waiting = {part: needs for part, needs in waiting.items() if part not in ready}


def reached(arrows):
    """Part → all parts that its arrows lead to, also by way of others."""
    found = {part: set(direct) for part, direct in arrows.items()}
    for middle in found:
        for parts in found.values():
            if middle in parts:
                parts |= found[middle]
    return found


def test_the_graph_on_the_page_on_the_architecture_has_these_arrows():
    page = (ROOT.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    graph = re.sub(r'\[".*?"\]', "", re.search(r"```mermaid\ngraph TD\n(.*?)```", page, flags=re.DOTALL)[1])
    drawn = {part: set() for part in MAY_IMPORT}
    for line in graph.splitlines():
        start, ends = line.split("-->")
        drawn[start.strip()] |= {end.strip() for end in ends.split("&")}
    assert reached(drawn) == {part: parts - {"__init__"} for part, parts in reached(MAY_IMPORT).items()}


CYCLES: dict[str, set[str]] = {}  # modules of a part that still import each other


def module_of(parts):
    """The file that a name is imported from: ("engine", "tree", "X") is of engine/tree.py, a package alone of none."""
    if "/".join((*parts, "__init__.py")) in FILES:
        return None
    ends = [
        end
        for n in range(len(parts), 0, -1)
        for end in ("/".join(parts[:n]) + ".py", "/".join((*parts[:n], "__init__.py")))
    ]
    return next((end for end in ends if end in FILES), None)


def cyclic(needs):
    """The modules that import themselves by way of others."""
    return {name for name, found in reached(needs).items() if name in found}


@pytest.mark.parametrize("part", sorted({part_of(name) for name in FILES if "/" in name}))
def test_the_modules_inside_a_part_form_no_cycle(part):
    """Imports inside functions count, too."""
    files = [name for name in FILES if part_of(name) == part]
    needs = {name: {module_of(rest) for rest in inner(name)} & set(files) - {name} for name in files}
    assert cyclic(needs) == CYCLES.get(part, set())


@pytest.mark.parametrize("name", [name for name in FILES if part_of(name) == "engine"])
def test_the_method_knows_numpy_and_scipy_only(name):
    foreign = {module.split(".")[0] for module, _ in imports(name)} - sys.stdlib_module_names
    foreign -= {"numpy", "scipy", "pinconsist"}
    assert not foreign, f"{name} imports {foreign}"


def test_only_one_file_names_pinocchios_constraints():
    """Of contacts, in rigid.py; loops have rows of their own."""
    named = {}
    for name in FILES:
        tree = tree_of(name)
        found = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute) and "Constraint" in node.attr}
        found |= {alias for module, _ in imports(name) if (alias := module.split(".")[-1]) and "Constraint" in alias}
        found -= {"Constraint", "ConstraintRows", "JointConstraint"}  # records of this package, and their rows
        if found:
            named[name] = found
    assert set(named) <= {"mechanism/rigid.py"}, named


@pytest.mark.parametrize("name", [name for name in FILES if part_of(name) != "cli"])
def test_optional_packages_are_imported_where_they_are_used(name):
    top = {
        module.split(".")[0] for node in at_import(tree_of(name)) for module, _ in imports(name, ast.Module([node], []))
    }
    assert top & OPTIONAL <= TOP_LEVEL_ALLOWED.get(name, set())


def test_importing_the_package_brings_no_optional_package():
    """In a fresh interpreter, whatever the source looks like."""
    ours = OPTIONAL - {"coal"}  # Pinocchio itself brings coal
    code = f"import sys, pinconsist; print(*sorted(set(sys.modules) & {ours!r}))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT.parent, check=True)
    assert run.stdout.split() == [] and run.stderr == ""


def test_the_command_line_starts_without_numpy():
    """Help is quick then, and a sweep can still say how many threads numpy is to use."""
    code = "import sys, pinconsist.cli.app; print(*{'numpy', 'pinocchio'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT.parent, check=True)
    assert run.stdout.split() == []


@pytest.mark.parametrize("name", FILES)
def test_habits(name):
    tree, text = tree_of(name), FILES[name].read_text(encoding="utf-8")
    asserts = [node.lineno for node in ast.walk(tree) if isinstance(node, ast.Assert)]
    assert not asserts, f"{name}: assert in lines {asserts}"
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    if part_of(name) != "cli":
        prints = [node.lineno for node in calls if node.func.id in ("print", "input")]
        assert not prints, f"{name}: print or input in lines {prints}"
    bare = [node.lineno for node in ast.walk(tree) if isinstance(node, ast.ExceptHandler) and node.type is None]
    assert not bare, f"{name}: bare except in lines {bare}"
    if text.strip() and not name.endswith("__main__.py"):
        assert ast.get_docstring(tree), f"{name} does not say what it is for"


def test_tests_import_no_tests():
    """What they share stands in tests/helpers."""
    tests = {path: path.stem for path in Path(__file__).parent.rglob("test_*.py")}
    helpers = list(Path(__file__).parent.rglob("helpers/*.py"))
    for path in [*tests, *helpers]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                names.append(node.module)
            taken = {name.rpartition(".")[2] for name in names} & set(tests.values())
            assert not taken, f"{path.name} imports {taken}"
