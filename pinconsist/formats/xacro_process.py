"""The process in which xacro expands a file: ``python -I xacro_process.py`` with a JSON request on its input.

Xacro evaluates Python expressions of the file. Therefore it runs in a process of its own, which may open files in the
given folders only, has neither network nor children, no environment, and limits of time and memory. Python's audit
events are the gate; attributes with a leading underscore, and names with two, which could reach around it, are refused
before.
"""

import ast
import json
import os
import re
import sys
from functools import partial

SECONDS, BYTES = 20, 1_000_000_000
REFUSED = (
    "socket.",
    "subprocess.",
    "os.",
    "shutil.",
    "ctypes.",
    "ftplib.",
    "urllib.",
    "http.",
    "smtplib.",
    "pty.",
    "mmap.",
)
ALLOWED = ("os.listdir", "os.scandir", "os.fspath", "os.walk")
CHANGES = "wax+"


def main():
    request = json.loads(sys.stdin.read())
    import xacro

    answer: dict = {"opened": []}
    _restrict_reading(xacro, request)
    missing = _restrict_expressions(xacro, request["packages"])
    gate = _gate(request["folders"], answer)
    _limit()
    os.environ.clear()
    sys.addaudithook(gate)
    try:
        document = xacro.process_file(request["path"], mappings=request["args"])
        answer["text"] = document.toxml()
    except RecursionError:
        answer["error"] = "macros include themselves"
    except Exception as error:
        answer["error"] = " ".join(str(each) for each in _chain(error))
        answer["kind"] = type(error).__name__
    answer["missing"] = sorted(missing)
    sys.stdout.write(json.dumps(answer))


def _restrict_reading(xacro, request) -> None:
    """Let xacro read documents without entities, without the elements to ignore, also from the given folders."""
    import defusedxml.minidom as defused

    minidom = xacro.xml.dom.minidom
    minidom.parse = partial(defused.parse, forbid_dtd=True)  # no document types, no entities
    minidom.parseString = partial(defused.parseString, forbid_dtd=True)
    parse, located = xacro.parse, xacro.abs_filename_spec
    ignore, folders = set(request["ignore"]), request["folders"]

    def parsed(*given):
        document = parse(*given)
        for element in list(document.getElementsByTagName("*")) if ignore else ():
            if _names(element) & ignore and element.parentNode is not None:
                element.parentNode.removeChild(element)
        return document

    def found(name):
        """The file beside the one that includes it, else in one of the folders, in which some programs run xacro."""
        places = [located(name), *(os.path.join(folder, name) for folder in folders)]
        return next((place for place in places if os.path.isfile(place)), places[0])

    xacro.parse, xacro.abs_filename_spec = parsed, found


def _restrict_expressions(xacro, packages) -> set[str]:
    """Let xacro evaluate harmless expressions only, and find the `packages`; the set will have those that it lacks."""
    import xacro.substitution_args as substitution

    missing: set[str] = set()
    evaluate, safe_eval = substitution._eval, xacro.safe_eval

    def find(package):
        if package not in packages:
            missing.add(package)
            return f"/package not found/{package}"
        return packages[package]

    def in_eval(text, context):
        _check_expression(text, xacro.XacroException)
        return evaluate(text, context)

    def in_braces(expression, *more):
        _check_expression(expression, xacro.XacroException)
        return safe_eval(expression, *more)

    substitution._eval_find, substitution._eval, xacro.safe_eval = find, in_eval, in_braces
    substitution._eval_dict["find"] = find
    return missing


def _check_expression(expression, refusal) -> None:
    """Raise a `refusal` of an expression that may reach around the gate, or whose number may fill the memory."""
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        name, attribute = (str(getattr(node, key, "")) for key in ("id", "attr"))
        hidden = name.startswith("__") or attribute.startswith("_")  # a property may be called _speed
        if hidden or {name, attribute} & {"format", "format_map", "gi_frame"}:
            raise refusal(f"the name in {expression.strip()!r} is refused for safety")
        if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Pow, ast.LShift)):
            right = getattr(node.right, "value", 0)
            if isinstance(right, (int, float)) and abs(right) > 1000:
                raise refusal(f"the exponent in {expression.strip()!r} is too large")


def _gate(folders, answer):
    """A hook for audit events: files of the folders and of Python's library may be read, nothing else may happen."""
    roots = [os.path.realpath(folder) + os.sep for folder in folders]
    library = [os.path.realpath(folder) + os.sep for folder in sys.path if folder]

    def opens(path, mode):
        if isinstance(path, int):
            return
        real = os.path.realpath(os.fsdecode(path))
        if any(letter in (mode or "r") for letter in CHANGES):
            raise PermissionError(13, "refused", os.fsdecode(path))
        if any(real.startswith(root) for root in roots):
            answer["opened"].append(real)
        elif not any(real.startswith(folder) for folder in library):  # modules, imported late
            answer.setdefault("outside", real)
            raise PermissionError(13, "outside", os.fsdecode(path))

    def gate(event, arguments):
        if event == "open":
            opens(*arguments[:2])
        elif event.startswith(REFUSED) and event not in ALLOWED:
            raise PermissionError(13, "refused", event)

    return gate


def _names(element) -> set[str]:
    """The names by which an include or a call of a macro can be left out."""
    if element.tagName != "xacro:include":
        return {element.tagName} if element.tagName.startswith("xacro:") else set()
    file = element.getAttribute("filename")
    return {os.path.basename(file), *re.findall(r"\$\(find\s+([\w.-]+)\s*\)", file)}


def _chain(error):
    found, inner = [error], getattr(error, "exc", None)
    return found if inner is None or str(inner) in str(error) else [*found, inner]


def _limit():
    try:
        import resource
    except ImportError:  # Windows
        return
    for what, most in ((resource.RLIMIT_CPU, SECONDS), (resource.RLIMIT_AS, BYTES)):
        given = resource.getrlimit(what)[1]  # that of the calling process, which cannot be raised
        most = most if given == resource.RLIM_INFINITY else min(most, given)
        resource.setrlimit(what, (most, most))


if __name__ == "__main__":
    main()
