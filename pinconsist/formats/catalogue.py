"""Scenes by name: those in ``models/``, families of any size such as ``chain_16``, and robots of a pip package.

Families move in the x-z plane, with gravity along -z. A rod is slender and uniform, with 1 m and 1 kg, and extends
along +x of its link frame (a crank of the four-bars along +z, so that it is upright at zero). A positive angle about +y
turns +z to +x and +x to -z.
"""

import os
import re
from math import pi, sin
from pathlib import Path
from typing import NamedTuple

from ..errors import CONTROLS, FormatError, InputError, MissingExtraError
from ..mechanism.checks import near
from ..mechanism.loops import GROUND, Loop
from .loopfile import LoopFile, find_loop_file
from .loopfile import read as read_loop_file

READERS = {".urdf": "urdf", ".sdf": "sdf", ".world": "sdf", ".xml": "mjcf", ".mjcf": "mjcf", ".xacro": "xacro"}
READERS |= {".body": "choreonoid", ".wrl": "choreonoid"}
READERS |= dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "usd") | {".wbt": "webots", ".proto": "webots"}
READERS |= dict.fromkeys((".yaml", ".yml"), "ambf")
"""Suffix → the module whose ``read`` reads such files; imported when needed."""
ROOTS = {"robot": "urdf", "sdf": "sdf", "gazebo": "sdf", "mujoco": "mjcf"}
"""Root element → the reader of an XML file, whatever its suffix is."""
_XML = ("urdf", "sdf", "mjcf")
_KEYS = {b"bodies": "ambf", b"directives": "directives", b"links": "choreonoid"}
"""Key of a YAML file → the reader."""
_KEY = re.compile(rb"(?m)^[\"']?(" + b"|".join(_KEYS) + rb")[\"']?\s*:")
_HEAD = 100_000  # bytes of a file in which its root element is searched for
_ROOT = re.compile(rb"(?s)<!--.*?-->|<\?.*?\?>|<!.*?>|<([A-Za-z_][\w.:-]*)([^>]*)")
ROBOTS = ("cassie", "cassie_reduced", "cassie_simple", "cassie_v2", "cassie_wo_gearbox_spring")
"""Files of the pip package example-robot-data."""
_PACKAGE, _SHARE = "example-robot-data", "cmeel.prefix/share"

_OTHERS = {
    ".html": "; a page is opened in a browser, and the run in it is kept by --out run.npz (sol.save)",
    ".erb": "; this is a program that writes a file: run it, erb FILE > robot.sdf",
    ".em": "; this is a program that writes a file: run it, empy FILE > robot.sdf",
    ".rsdf": "; this is a program that writes a file: run it, erb FILE > robot.sdf",
    ".j2": "; this is a program that writes a file: run it, jinja2 FILE > robot.urdf",
    ".npz": "; this is a saved run, not a scene: plot and replay read it, and Solution.load",
    ".lua": "; an RBDL model is a program, which is not run: write its bodies as URDF, and its loops in a loop file",
    ".osim": "; an OpenSim model is converted to MJCF by its users' converters (myoconverter, pyosim2mjc)",
    ".skel": "; DART reads this kind, and writes none that is read here: write its bodies as URDF or SDF",
    ".slx": "; Simscape's smimport and exporters write URDF: export the tree, and give the loops in a loop file",
    ".srdf": "; this belongs to a URDF: load that file",
    ".step": "; this is a shape without joints: an exporter of the CAD program writes URDF or SDF",
    ".bin": "; a compiled model of MuJoCo: mujoco.mj_saveLastXML writes its XML",
    ".mjb": "; a compiled model of MuJoCo: mujoco.mj_saveLastXML writes its XML",
}
"""What a user may do with files of other kinds."""

LARGEST_FAMILY = 2000  # links: its dense matrices, with several times as many rows, must fit into memory
RADIUS = 0.02  # m, of a rod
SPAN = 0.6  # distance between the ends of a chain, divided by its length
BLUE, ORANGE, DARK, STEEL = "0.16 0.44 0.72 1", "0.93 0.52 0.14 1", "0.20 0.22 0.25 1", "0.55 0.58 0.62 1"
PIN = f'<geometry><cylinder radius="{1.5 * RADIUS}" length="{4 * RADIUS}"/></geometry>'


class Source(NamedTuple):
    """The source of a scene: a file, or a URDF text with the content of its loop file."""

    path: Path
    name: str
    content: bytes | None = None
    loop_file: LoopFile = LoopFile()
    package_dirs: tuple = ()


def reader_of(path: Path, content: bytes | None = None) -> str:
    """The module that reads a file: by its suffix, or for XML by its root element."""
    reader = READERS[path.suffix.lower()]
    if reader not in (*_XML, "ambf"):
        return reader
    head = content
    if head is None:
        try:
            with path.open("rb") as file:
                head = file.read(_HEAD)
        except (OSError, ValueError):  # the reader reports it
            return reader
    if reader == "ambf":
        return _reader_of_yaml(path, head)
    root = next((match for match in _ROOT.finditer(head[:_HEAD]) if match[1]), None)
    found = ROOTS.get(root[1].decode(), reader) if root else reader
    if found in ("urdf", "sdf") and content is None and re.search(rb"<xacro:|\$\((find|arg|eval) ", head):
        return "xacro"
    return found


def _reader_of_yaml(path, head) -> str:
    """The module that reads a YAML file, by its keys; FormatError for those that are no scenes."""
    found = _KEY.search(head)
    if found is None:
        raise FormatError(
            "a YAML file is a scene if it has bodies of AMBF, directives of Drake, or links of Choreonoid. A loop file "
            f"is read with its robot: load('robot.urdf', loops={path.name!r}), --loops {path.name}", path=path
        )  # fmt: skip
    return _KEYS[found[1]]


def models() -> dict[str, str]:
    """The built-in models.

    Returns
    -------
    dict[str, str]
        Name → one line of description; ``<n>`` in a name stands for a number.

    Raises
    ------
    FormatError
        A damaged installation: the loop file of a model cannot be read.
    """
    files = {path.stem: read_loop_file(find_loop_file(path)).description for path in _built_in().values()}
    return files | {f"{name}_<n>": description for name, (description, _, _) in FAMILIES.items()}


def is_built_in(source) -> bool:
    """Whether `source` is the name of a scene known to :func:`pinconsist.load`, and not a path."""
    return isinstance(source, str) and (source in _built_in() or source in ROBOTS or _family(source) is not None)


def find(source: str | os.PathLike) -> Source:
    """The source for a name, a file or a folder; raises the errors of :func:`pinconsist.load`."""
    built_in, path = _built_in(), Path(source)
    if isinstance(source, str):
        if family := _family(source):
            build, n = family
            parts, record = build(n)
            text = "\n".join((f'<robot name="{source}">', *parts, "</robot>"))
            return Source(Path(f"{source}.urdf"), source, text.encode(), record)
        if source in ROBOTS:
            robot, share = robot_file(source)
            return Source(robot, source, package_dirs=(share,))
        if source in built_in:
            return Source(built_in[source], source)
    if os.path.isdir(path):
        path = _in_folder(path)
    elif path.suffix.lower() not in READERS:
        if isinstance(source, str) and not path.suffix and len(path.parts) == 1 and not os.path.exists(path):
            names = (*built_in, *(f"{name}_<n>" for name in FAMILIES))
            meant = [each for suffix in READERS if os.path.isfile(each := f"{source}{suffix}")]
            alike = f"; there is {meant[0]}" if meant else near(source, (*names, *ROBOTS))
            reason = f"there is neither a built-in model nor a file {source!r}{alike}"
            raise InputError(f"{reason}. Built-in models: {', '.join(names)}")
        supported = (
            "URDF (.urdf, with a loop file .yaml next to it or passed as loops=), SDF (.sdf, .world), MJCF (.xml), "
            "xacro (.xacro), USD (.usd, .usda, .usdc, .usdz), Webots (.wbt, .proto), "
            "Choreonoid (.body), OpenHRP (.wrl), AMBF (.yaml) and directives of Drake (.dmd.yaml)"
        )
        kind = path.suffix or "without suffix"
        supported += _OTHERS.get(kind.lower(), "")
        raise FormatError(f"files of type {kind!r} cannot be read; supported are {supported}", path=path)
    name = path.stem.removesuffix(".urdf").removesuffix(".sdf")
    if name in ("robot", "model"):
        name = path.resolve().parent.name
    return Source(path, CONTROLS.sub("?", name))


def _in_folder(folder: Path) -> Path:
    """The file of a robot's folder: its only .urdf, in the folder or in ``urdf/``, else its ``model.sdf``."""
    found = sorted(folder.glob("*.urdf")) or sorted(folder.glob("urdf/*.urdf"))
    if not found and (folder / "model.sdf").is_file():
        found = [folder / "model.sdf"]
    if len(found) != 1:
        names = ": " + ", ".join(each.name for each in found) if found else ""
        raise FormatError(f"the folder must contain one .urdf file, it has {len(found)}{names}", path=folder)
    return found[0]


def robot_file(name: str) -> tuple[Path, Path]:
    """The file of a robot of `ROBOTS` and the folder of its meshes; MissingExtraError if they are not installed."""
    from importlib.metadata import PackageNotFoundError, distribution  # rarely needed, and slow to import

    try:
        share = Path(str(distribution(_PACKAGE).locate_file(_SHARE)))
    except PackageNotFoundError:
        reason = f"the files of {name!r} come with the pip package {_PACKAGE}, which is not installed"
        raise MissingExtraError(f"{reason}: pip install 'pinconsist[robots]'") from None
    path = share / _PACKAGE / "robots" / "cassie_description" / "robots" / f"{name}.sdf"
    if not path.is_file():
        raise MissingExtraError(f"the pip package {_PACKAGE} is installed, but does not contain {path}; version 6 does")
    return path, share


def _built_in():
    package = Path(__file__).resolve().parents[1]
    folder = package / "models" if (package / "models").is_dir() else package.parent / "models"  # wheel, checkout
    return {path.stem: path for path in sorted(folder.glob("*.urdf"))}


def _family(name: str):
    """(build, n) of a name such as ``chain_16``, or None; InputError if the family has no member of this size."""
    match = re.fullmatch(rf"({'|'.join(FAMILIES)})_(\d+)", name, re.ASCII)
    if not match:
        return None
    _, least, build = FAMILIES[match[1]]
    n = int(match[2]) if len(match[2]) < 10 else LARGEST_FAMILY + 1
    if not least <= n <= LARGEST_FAMILY:
        raise InputError(f"{match[1]}_<n> needs a number from {least} to {LARGEST_FAMILY}, got {match[2]}")
    return build, n


def _chain(n):
    """Rods in series, the last one pinned to the ground; they hang in an arc of a circle."""
    from scipy.optimize import brentq

    def excess(turn):  # of the span of n chords of length 1 with this angle between neighbours
        return sin(n * turn / 2) / sin(turn / 2) - SPAN * n

    turn = brentq(excess, 1e-9, 2 * pi / n, xtol=1e-15)
    parts = [_ground([(0.0, 0.0), (SPAN * n, 0.0)])]
    guess, last = {}, ("ground", 0.0, 0.0)
    for i in range(n):
        parts += [_rod(f"rod{i}", (BLUE, ORANGE)[i % 2]), _hinge(f"joint{i}", *last, f"rod{i}")]
        guess[f"joint{i}"] = -turn if i else turn * (n - 1) / 2
        last = (f"rod{i}", 1.0, 0.0)
    return parts, LoopFile((_pinned("end", last[0], GROUND, xyz2=(SPAN * n, 0.0, 0.0)),), guess=guess)


def _n_four_bar(n):
    """Upright cranks side by side, with horizontal couplers between their ends."""
    parts = [_ground([(float(i), 0.0) for i in range(n + 1)])]
    parts += [_rod("crank0_bar", BLUE, upright=True), _hinge("crank0", "ground", 0.0, 0.0, "crank0_bar")]
    end, loops = ("crank0_bar", 0.0, 1.0), []
    for i in range(n):
        parts += [_rod(f"coupler{i}_bar", ORANGE), _hinge(f"coupler{i}", *end, f"coupler{i}_bar")]
        end = (f"coupler{i}_bar", 1.0, 0.0)
    for i in range(1, n + 1):
        crank = f"crank{i}_bar"
        parts += [_rod(crank, BLUE, upright=True), _hinge(f"crank{i}", "ground", float(i), 0.0, crank)]
        loops.append(_pinned(f"B{i}", f"coupler{i - 1}_bar", crank, xyz2=(0.0, 0.0, 1.0)))
    return parts, LoopFile(tuple(loops))


FAMILIES = {  # name → description, smallest n, function of n that returns links and joints, and the loop file
    "chain": (f"chain of n rods of 1 m, n ≥ 2, pinned at both ends, {SPAN:g} n m apart", 2, _chain),
    "n_four_bar": ("n four-bars side by side, n ≥ 1, that pass through singular configurations", 1, _n_four_bar),
}


def _ground(pivots):
    shape = f'<geometry><box size="{6 * RADIUS} {6 * RADIUS} {3 * RADIUS}"/></geometry>'
    visuals = "".join(_visual(f"{x!r} 0 {z - 1.5 * RADIUS!r}", "0 0 0", shape, STEEL) for x, z in pivots)
    return f'<link name="ground">{visuals}</link>'


def _rod(name, color, upright=False):
    """A rod, with moments of inertia m l²/12 about its transverse axes and m r²/2 about its own."""
    along, across = RADIUS**2 / 2, 1 / 12
    (ixx, izz), middle = ((across, along), "0 0 0.5") if upright else ((along, across), "0.5 0 0")
    size = f"{2 * RADIUS} {RADIUS} 1" if upright else f"1 {RADIUS} {2 * RADIUS}"
    bar = _visual(middle, "0 0 0", f'<geometry><box size="{size}"/></geometry>', color)
    return (
        f'<link name="{name}"><inertial><origin xyz="{middle}"/><mass value="1"/>'
        f'<inertia ixx="{ixx!r}" ixy="0" ixz="0" iyy="{across!r}" iyz="0" izz="{izz!r}"/></inertial>'
        f"{bar}{_visual('0 0 0', f'{pi / 2!r} 0 0', PIN, DARK)}</link>"
    )


def _visual(xyz, rpy, shape, color):
    material = f'<material name="{color}"><color rgba="{color}"/></material>'
    return f'<visual><origin xyz="{xyz}" rpy="{rpy}"/>{shape}{material}</visual>'


def _hinge(name, parent, x, z, child):
    return (
        f'<joint name="{name}" type="continuous"><origin xyz="{x!r} 0 {z!r}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 1 0"/></joint>'
    )


def _pinned(name, rod, frame2, xyz2):
    return Loop(name, "hinge", rod, frame2, xyz1=(1.0, 0.0, 0.0), xyz2=xyz2, axis=(0.0, 1.0, 0.0))
