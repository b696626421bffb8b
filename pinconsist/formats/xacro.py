"""Xacro files: the pip package ``xacro`` expands them (``pip install 'pinconsist[xacro]'``), in a process of its own.

The result is read as what it is, URDF or SDF. ``$(find NAME)`` is the folder of the ROS package NAME: one that holds
the file, that lies beside such a package, or one of ``package_dirs``. Includes are read from these packages, and
from the folder of the file. Arguments of the file come from ``load(..., args={...})``. ``ignore`` leaves out includes,
by the name of their package or file, and calls of macros, ``xacro:NAME``.
"""

import hashlib
import json
import re
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from ..errors import FormatError, MissingExtraError
from .packages import packages_of
from .reading import RobotFile, asking_for, note_read, parsed, read_bytes, short_repr

_OF_XACRO = set("macro include property arg if unless insert_block call element attribute".split())
_MACRO = re.compile(r'<xacro:macro\s[^>]*?name="(?:xacro:)?([\w.-]+)"')
SECONDS = 60  # in which the process must end


def read(path: Path, name: str, folders, *, args=None, ignore=(), **options) -> RobotFile:
    """Read a xacro file; `args` are its arguments, name → value."""
    content = expanded(path, args or {}, [Path(folder) for folder in folders], ignore)
    document = parsed(content)
    root = document.tag.rpartition("}")[2]
    if root not in ("robot", "sdf"):
        raise FormatError(f"it expands to <{root}>, which is neither <robot> nor <sdf>")
    if root == "robot" and document.find("link") is None:
        raise FormatError(_without_links(path))
    if root == "sdf":
        options.pop("joint_types", None)
    options |= {"content": content, "ignore": ignore}
    return import_module(f".{'urdf' if root == 'robot' else 'sdf'}", __package__).read(path, name, folders, **options)


def expanded(path: Path, args: dict, folders, ignore=()) -> bytes:
    """The text to which a xacro file expands; FormatError with xacro's message."""
    read_bytes(path)
    if find_spec("xacro") is None:
        need = "xacro files are expanded by the pip package xacro; install it with: pip install 'pinconsist[xacro]'"
        raise MissingExtraError(need)
    packages = packages_of(path, folders)
    allowed = [path.parent.resolve(), *folders, *(packages[name] for name in _named(path, packages))]
    request = {
        "path": str(path.resolve()),
        "args": {key: _argument(value) for key, value in args.items()},
        "folders": [str(folder) for folder in allowed],
        "ignore": list(ignore),
        "packages": {key: str(folder) for key, folder in packages.items()},
    }
    script = Path(__file__).with_name("xacro_process.py")
    try:
        command, given = [sys.executable, "-I", str(script)], json.dumps(request).encode()
        run = subprocess.run(command, input=given, capture_output=True, timeout=SECONDS)
        answer = json.loads(run.stdout)
    except subprocess.TimeoutExpired:
        raise FormatError(f"xacro did not finish within {SECONDS} s") from None
    except ValueError:
        reason = (run.stderr.decode(errors="replace").strip().splitlines() or ["it used too much time or memory"])[-1]
        raise FormatError(f"xacro did not finish: {reason[:200]}") from None
    for file in map(Path, answer["opened"]):
        if file.is_file():  # it may have asked for one that is not there
            note_read(file, hashlib.sha256(file.read_bytes()).hexdigest())
    if "error" in answer:
        raise FormatError(_reason(answer, path.resolve().parent))
    return answer["text"].encode()


def _without_links(path) -> str:
    """The message about a file that expands to no link: it is a part, of others that call its macros or include it."""
    content = read_bytes(path)
    macros = [each.decode(errors="replace") for each in re.findall(rb'<xacro:macro\s+name="([^"]*)"', content)]
    what = f"macros ({', '.join(macros[:4])}{', …' if len(macros) > 4 else ''})" if macros else "parts of a robot"
    beside = [each.name for each in sorted(path.parent.glob("*.xacro")) if each != path]
    users = [each for each in beside if path.name.encode() in (path.parent / each).read_bytes()]
    load = f"; load {' or '.join(users[:3])}, which includes it" if users else "; load the file that includes it"
    return f"there is no link: it has only {what}{load}"


def _named(path, packages) -> list[str]:
    """The packages of which the file or its neighbours are, or that ``$(find …)`` in the file names."""
    text = path.read_bytes().decode(errors="replace")
    named = set(re.findall(r"\$\(find\s+([\w.-]+)\s*\)", text))
    return [name for name, folder in packages.items() if name in named or (folder / "package.xml").is_file()]


def _argument(value) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _without_macro(answer, first) -> list[str]:
    """A macro that is unknown, and the others that the files call and do not have."""
    texts = [Path(file).read_bytes().decode(errors="replace") for file in answer["opened"] if Path(file).is_file()]
    called = {each for text in texts for each in re.findall(r"<xacro:([\w.-]+)", text)}
    own = {each for text in texts for each in _MACRO.findall(text)}
    return [first, *(f"xacro:{each}" for each in sorted(called - own - _OF_XACRO) if f"xacro:{each}" != first)]


def _reason(answer, folder) -> str:
    error, missing = answer["error"], answer["missing"]
    if answer.get("kind") == "DTDForbidden":
        return "document types and entities are refused for safety (DTDForbidden)"
    if missing and "package not found" in error:
        return (
            f"$(find {missing[0]}) names a ROS package that does not hold the file and is not beside it; pass its "
            f'folder: package_dirs=["…/{missing[0]}"]; or ignore=[{missing[0]!r}] leaves out what is included from it'
        )
    if unknown := re.search(r"unknown macro name: (xacro:[\w.-]+)", error):
        return f"xacro: {error[:400]}; ignore={_without_macro(answer, unknown[1])} leaves out its calls"
    refused = answer.get("kind") == "PermissionError" or "outside" in error
    if refused and answer.get("outside"):
        found = answer["outside"]
        what = f"it includes {Path(found).name}, outside of the folder of the scene and its packages"
        return f"{what}; {asking_for(found, folder)}"
    if refused:
        return f"xacro: {error[:300]}: files outside of the folder of the scene and its packages are not read"
    if answer.get("kind") == "UndefinedArgument" or "Undefined substitution argument" in error:
        wanted = error.rpartition(" ")[2].strip("'\"")  # $(arg 'name') is looked up with its quotes
        return f"its argument {short_repr(wanted)} has no default; pass it: args={{{wanted!r}: …}}"
    return f"xacro: {error[:400]}"
