"""Numbers of a file that are hardly meant: inertias that no body has, limits in the wrong order, degrees, other units.

A file with such numbers is simulated as it is, since none of them is impossible to simulate. A warning names each of
them.
"""

from collections.abc import Iterable, Iterator
from math import inf, radians, sqrt
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ..errors import FormatError, warn
from ..mechanism.assembly import FULL_TURN

NEGATIVE = 1e-9  # a moment of inertia, relative to the largest, below minus which it is not rounded
POINT = 1e-12  # m²: bodies of a radius of gyration of 1 µm are points
TWO_DIGITS = 1e-2  # relative: numbers in files may have as few as two digits
UNBODILY = 10.0  # lengths of the longest body that a body must reach from its centre of mass to have its inertia
MACHINE = 10.0  # m: typical bodies that are larger are rare, …
LIGHT = 0.3  # kg/m: … and still heavier than this. Lengths in mm make a body of 1 kg and 0.3 m one of 0.003 kg/m
CONSISTENT = 1000.0  # m/s²: with such a gravity, all lengths are meant in mm
MOST_SHOWN = 3

_DIAGONAL = ("ixx", "iyy", "izz")


def moving_inertias(
    what: str, inertias: dict[str, pin.Inertia], model: pin.Model
) -> Iterator[tuple[str, np.ndarray, pin.Inertia]]:
    """What :func:`warn_of_inertias` needs of the bodies that move in a model; `inertias` are those by name."""
    for name, inertia in inertias.items():
        joint = model.frames[model.getFrameId(name)].parentJoint if model.existFrame(name) else 0
        if joint:
            yield f"{what} {name!r}", inertia.inertia, model.inertias[joint]


def warn_of_inertias(path, bodies: Iterable[tuple[str, np.ndarray, pin.Inertia]]) -> None:
    """Warn of inertias (3, 3), kg·m², about the centre of mass that no body has.

    The density of a body is not negative anywhere, therefore no principal moment exceeds the sum of the others.
    `bodies` are (element, inertia, that of all links that are rigidly attached), and what is small against the latter
    has no effect. FormatError if a principal inertia of these is negative.
    """
    found = []
    for element, inertia, whole in bodies:
        moments, of_whole = np.linalg.eigvalsh(inertia), np.linalg.eigvalsh(whole.inertia)
        size = max(np.abs(of_whole).max(), POINT * whole.mass)
        if moments[0] < 0.0 and -of_whole[0] > max(NEGATIVE * size, POINT * whole.mass):
            raise FormatError(f"a principal inertia is negative: {moments[0]:.3g} kg m²", element=element)
        if moments[2] - moments[0] - moments[1] > TWO_DIGITS * size:
            found.append(f"{element}: no body has this inertia: {_excess(inertia, moments)}. Check its axes and units")
    _warn_of(path, found)


def warn_of_limits(path, joints: Iterable[tuple[str, float, float]]) -> None:
    """Warn of limits that exclude every position; `joints` are (element, lower, upper)."""
    found = [
        f"{element}: its lower limit {lower:g} is above its upper limit {upper:g}, so its limits are not watched. "
        f'Exchange them (lower="{upper:g}" upper="{lower:g}"), or leave them out'
        for element, lower, upper in joints
        if lower > upper
    ]
    _warn_of(path, found)


def warn_of_degrees(path, angles: Iterable[tuple[str, Iterable[float]]]) -> None:
    """Warn of roll, pitch and yaw, or a guess, that are degrees; `angles` are (element, values)."""
    found = []
    for element, values in angles:
        largest = max(values, key=abs, default=0.0)
        if FULL_TURN < abs(largest) < inf:
            degrees = f"write {radians(largest):.6g} for {largest:g} degrees"
            found.append(f"{element} has an angle of {largest:g} rad, more than a full turn; {degrees}")
    _warn_of(path, found)


def warn_of_units(path, model: pin.Model) -> None:
    """Warn of lengths in millimetres, and of inertias whose radius of gyration is far beyond the mechanism."""
    sizes, masses = _sizes(model), np.array([inertia.mass for inertia in model.inertias])
    sized = np.flatnonzero((sizes > 0.0) & (masses > 0.0))
    if not sized.size:
        return
    typical, weight = float(np.median(sizes[sized])), float(masses[sized].sum() / sizes[sized].sum())
    if typical > MACHINE and weight < LIGHT and np.linalg.norm(model.gravity.linear) < CONSISTENT:
        warn(
            f"{path}: a typical body is {typical:.3g} m long, with {weight:.2g} kg per metre: are the lengths in "
            f"millimetres? They are read as metres; write {typical / 1000:.3g} for {typical:.3g}, and inertias in kg·m²"
        )
        return
    found = []
    for joint in range(1, model.njoints):
        if not masses[joint] > 0.0:
            continue
        reach = sqrt(np.linalg.eigvalsh(model.inertias[joint].inertia)[2].clip(0.0) / masses[joint])
        if reach > UNBODILY * sizes.max():
            found.append(
                f"the body at joint {model.names[joint]!r}: {masses[joint]:.3g} kg with this inertia reach at least "
                f"{reach:.3g} m from their centre, but the longest body has {sizes.max():.2g} m: is its inertia in "
                "kg·mm² (factor 1e-6) or g·mm² (1e-9)? It is read as kg·m²"
            )
    _warn_of(path, found)


def inertias_of(robot: Element, model: pin.Model) -> Iterator[tuple[str, np.ndarray, pin.Inertia]]:
    """What :func:`warn_of_inertias` needs of the links of a checked ``<robot>`` that move in its model."""
    for link in robot.findall("link"):
        node = link.find("inertial/inertia")
        joint = model.frames[model.getFrameId(link.get("name"), pin.FrameType.BODY)].parentJoint
        if node is not None and joint:
            xx, xy, xz, yy, yz, zz = (float(node.get(key, "0")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
            inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            yield f"link {link.get('name')!r}: inertial", inertia, model.inertias[joint]


def angles_of(robot: Element) -> Iterator[tuple[str, tuple[float, ...]]]:
    """(element, roll, pitch and yaw) of the placements of joints and inertias of a checked ``<robot>``."""
    for holder in (*robot.findall("joint"), *robot.findall("link")):
        for origin in (holder.find("origin"), holder.find("inertial/origin")):
            if origin is not None:
                yield f"{holder.tag} {holder.get('name')!r}: origin", tuple(map(float, origin.get("rpy", "0").split()))


def limits_of(robot: Element) -> Iterator[tuple[str, float, float]]:
    """(element, lower, upper) of the joints of a checked ``<robot>``."""
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        if limit is not None:
            yield f"joint {joint.get('name')!r}: limit", float(limit.get("lower")), float(limit.get("upper"))


def _excess(inertia, moments) -> str:
    """The largest moment of inertia, and the sum of the others."""
    which, others = "its largest principal moment", "the sum of the others"
    if not np.any(inertia - np.diag(np.diagonal(inertia))):
        largest = int(np.argmax(np.diagonal(inertia)))
        which, others = _DIAGONAL[largest], " + ".join(_DIAGONAL[i] for i in range(3) if i != largest)
    return f"{which} = {moments[2]:.4g} kg·m² is above {others} = {moments[0] + moments[1]:.4g}"


def _sizes(model) -> np.ndarray:
    """The largest distance of a centre of mass, a joint or a frame on each body from its joint, m; 0 for the ground."""
    sizes = np.array([float(np.linalg.norm(inertia.lever)) for inertia in model.inertias])
    for joint in range(1, model.njoints):
        parent = model.parents[joint]
        sizes[parent] = max(sizes[parent], float(np.linalg.norm(model.jointPlacements[joint].translation)))
    for frame in model.frames:
        sizes[frame.parentJoint] = max(sizes[frame.parentJoint], float(np.linalg.norm(frame.placement.translation)))
    sizes[0] = 0.0
    return sizes


def _warn_of(path, found) -> None:
    if found:
        more = f" (and {len(found) - MOST_SHOWN} more)" * (len(found) > MOST_SHOWN)
        warn(f"{path}{': ' if path else ''}{'; '.join(found[:MOST_SHOWN])}{more}")
