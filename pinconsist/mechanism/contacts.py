"""Contacts: stops of joints, ropes, struts, points on planes, stiction.

Each record has one or two *elements*. An element has a gap g ≥ 0 with a force that may only push, or tangential rows
with a force that friction limits, or both:

==============================  ====================================  =============================================
record                          gap                                   force
==============================  ====================================  =============================================
:class:`Stop`                   from the joint to its stop            0 ≤ λ ⊥ g ≥ 0, N·m or N
:class:`Rope`, :class:`Strut`   (L² - d²) / 2L, (d² - L²) / 2L        the same, N
:class:`Contact`                height of the point over the plane    the same, and \\|λ_t\\| ≤ μ λ_n
:class:`DryFriction`            none                                  \\|λ\\| ≤ limit, N·m or N
:class:`PinFriction`            none                                  \\|λ\\| ≤ μ r \\|R\\|, N·m, R the load of the pin
==============================  ====================================  =============================================

A run is divided into modes, in each of which every element is open, closed, sticking or sliding, see
``pinconsist.run.modes``. In a mode the rows of closed and sticking elements are ordinary constraints.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import pi
from sys import float_info
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import frame_of, name, near, number, put, put_checked, triple
from .joint_constraints import Coordinate
from .lie import integrate
from .loops import GROUND, Loop, across, unit
from .names import velocity_units

PLACES = 5  # random configurations at which tangents are compared
VANISHES = 1e-9  # relative motion along a tangent, relative to the largest, that counts as none


class ContactRecord(ABC):
    """The base of the records of this module."""

    name: str
    kind: ClassVar[str]
    has_gap: ClassVar[bool] = True

    @abstractmethod
    def elements(self, model, loops=()) -> list[Element]:
        """The elements on a `model` with `loops`; raises InputError for unknown joints, frames and loops."""


def _restitution(record, who):
    put_checked(record, who, number, "restitution", least=0.0)
    if record.restitution > 1.0:
        raise InputError(f"{who}: restitution must be from 0 to 1, got {record.restitution:g}")


def _friction(value, who, what="friction") -> tuple[float, float]:
    """The static and the kinetic value of a number or a pair."""
    pair = (value, value) if np.ndim(value) == 0 else value
    if isinstance(pair, str | dict) or len(pair) != 2:
        raise InputError(f"{who}: {what} must be a number, or a static and a kinetic one, got {value!r}")
    static, kinetic = (number(each, f"{who}: {what}", least=0.0) for each in pair)
    if kinetic > static:
        raise InputError(f"{who}: the kinetic {what} must not be above the static one, got {static:g} and {kinetic:g}")
    return static, kinetic


def _named(own, by_default: str, who: str) -> str:
    return by_default if isinstance(own, str) and not own else name(own, f"{who}: name")


@dataclass(frozen=True)
class Stop(ContactRecord):
    """The stops of a joint, which it can hit, rest on and leave.

    Parameters
    ----------
    joint : str
        A joint of one degree of freedom.
    lower, upper : float, optional
        Positions of the stops, rad or m. Default: the limits of the joint in its file; if only one is given, there is
        no other. An unbounded revolute joint needs both, between -π and π.
    restitution : float
        Speed after an impact relative to that before, from 0 to 1.
    name : str
        By default that of the joint.

    Raises
    ------
    InputError
        Numbers that cannot be used; on a model, an unknown joint or one without limits or with several degrees of
        freedom.
    """

    joint: str
    lower: float | None = None
    upper: float | None = None
    restitution: float = 0.0
    name: str = ""

    kind: ClassVar[str] = "stop"

    def __post_init__(self):
        put_checked(self, "stop", name, "joint")
        put(self, name=_named(self.name, self.joint, "stop"))
        who = f"stop {self.name!r}"
        for limit in ("lower", "upper"):
            if getattr(self, limit) is not None:
                put_checked(self, who, number, limit)
        if None not in (self.lower, self.upper) and not self.lower < self.upper:
            raise InputError(f"{who}: lower must be below upper, got {self.lower:g} and {self.upper:g}")
        _restitution(self, who)

    def elements(self, model, loops=()) -> list[Element]:
        who = f"stop {self.name!r}"
        joint = Coordinate(model, self.joint, who, "stopped")
        lower, upper = self.lower, self.upper
        if lower is None and upper is None:
            lower, upper = limits_of(model, self.joint)
            if lower is None and upper is None:
                raise InputError(f"{who}: joint {self.joint!r} has no limits in its file; pass lower= or upper=")
        if joint.period and (lower is None or upper is None or not (-pi < lower and upper < pi)):
            raise InputError(f"{who}: joint {self.joint!r} is unbounded: specify both stops, between -pi and pi")
        sides = {"lower": (1.0, lower), "upper": (-1.0, upper)}
        return [LimitElement(self, side, joint, *of) for side, of in sides.items() if of[1] is not None]


def limits_of(model, joint) -> tuple[float | None, float | None]:
    """The limits of a joint of one degree of freedom in its file; None where there is none."""
    i = model.getJointId(joint)
    if model.nqs[i] != 1:
        return None, None
    low, high = (float(of[model.idx_qs[i]]) for of in (model.lowerPositionLimit, model.upperPositionLimit))
    if not low < high:
        return None, None
    return (low if abs(low) < float_info.max else None), (high if abs(high) < float_info.max else None)


@dataclass(frozen=True)
class _Between(ContactRecord):
    """What :class:`Rope` and :class:`Strut` have in common."""

    name: str
    frame1: str
    frame2: str = GROUND
    length: float = 0.0
    xyz1: tuple[float, float, float] = (0.0, 0.0, 0.0)
    xyz2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    restitution: float = 0.0

    def __post_init__(self):
        who = f"{self.kind} {self.name!r}"
        put_checked(self, who, name, "name", "frame1", "frame2")
        put_checked(self, who, triple, "xyz1", "xyz2")
        put_checked(self, who, number, "length", above=0.0)
        _restitution(self, who)

    def elements(self, model, loops=()) -> list[Element]:
        who = f"{self.kind} {self.name!r}"
        return [DistanceElement(self, _ends(model, who, (self.frame1, self.xyz1), (self.frame2, self.xyz2)))]


@dataclass(frozen=True)
class Rope(_Between):
    """A massless rope between two points: their distance is at most its length, and it can only pull.

    Parameters
    ----------
    name, frame1, frame2 : str
        Its name, and frames of the model; ``"universe"`` is the ground.
    length : float
        m.
    xyz1, xyz2 : tuple of 3 float
        The points in their frames, m.
    restitution : float
        Of the impact when it becomes taut, from 0 to 1.

    Raises
    ------
    InputError
        Numbers that cannot be used; on a model, unknown frames, or two on one body.
    """

    kind: ClassVar[str] = "rope"


@dataclass(frozen=True)
class Strut(_Between):
    """A massless strut between two points: their distance is at least its length, and it can only push.

    It also models contact between two spheres: ``length`` is then the sum of their radii.

    Parameters
    ----------
    name, frame1, frame2 : str
        Its name, and frames of the model; ``"universe"`` is the ground.
    length : float
        m.
    xyz1, xyz2 : tuple of 3 float
        The points in their frames, m.
    restitution : float
        Of the impact when the distance is reached, from 0 to 1.

    Raises
    ------
    InputError
        Numbers that cannot be used; on a model, unknown frames, or two on one body.
    """

    kind: ClassVar[str] = "strut"


@dataclass(frozen=True)
class Contact(ContactRecord):
    """A point or a sphere of a body above a plane of the world or of another body.

    Parameters
    ----------
    name, frame : str
        Its name, and a frame of the body.
    xyz : tuple of 3 float
        The point, or the centre of the sphere, in that frame, m.
    radius : float
        Radius of the sphere, m; 0 for a point. Spheres slide without friction.
    normal : tuple of 3 float
        The normal of the plane, towards the body, of any length, in the axes of `on`.
    offset : float
        Offset of the plane along the normal, m.
    on : str
        The frame that carries the plane; the world by default.
    friction : float or (float, float)
        Coulomb's friction coefficient; or the static and the kinetic one.
    restitution : float
        Speed of the gap after an impact relative to that before, from 0 to 1.

    Raises
    ------
    InputError
        Numbers that cannot be used, friction of a sphere; on a model, unknown frames, or two on one body.
    """

    name: str
    frame: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 0.0
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    offset: float = 0.0
    on: str = GROUND
    friction: float | tuple[float, ...] = 0.0
    restitution: float = 0.0

    kind: ClassVar[str] = "contact"

    def __post_init__(self):
        who = f"contact {self.name!r}"
        put_checked(self, who, name, "name", "frame", "on")
        put_checked(self, who, triple, "xyz", "normal")
        put_checked(self, who, number, "offset")
        put_checked(self, who, number, "radius", least=0.0)
        if not 1e-100 < np.linalg.norm(self.normal) < 1e100:
            raise InputError(f"{who}: the normal is the zero vector, or too large: {self.normal}")
        put(self, friction=_friction(self.friction, who))
        if self.radius and self.friction[0]:
            raise InputError(
                f"{who}: a sphere with friction may roll, which is not supported yet: leave out the friction, or take "
                "points (radius=0), such as the corners of a foot"
            )
        _restitution(self, who)

    def elements(self, model, loops=()) -> list[Element]:
        return [PlaneElement(self, model)]


@dataclass(frozen=True)
class DryFriction(ContactRecord):
    """Exact dry friction of a joint: it sticks as long as the load is below the static friction.

    Parameters
    ----------
    joint : str
        A joint of one degree of freedom.
    friction : float or (float, float)
        The maximum torque or force, N·m or N; or the static and the kinetic value.
    name : str
        By default that of the joint with ``" friction"``.

    Raises
    ------
    InputError
        Numbers that cannot be used; on a model, an unknown joint or one with several degrees of freedom.
    """

    joint: str
    friction: float | tuple[float, ...] = 0.0
    name: str = ""

    kind: ClassVar[str] = "dry-friction"
    has_gap: ClassVar[bool] = False

    def __post_init__(self):
        put_checked(self, "dry friction", name, "joint")
        put(self, name=_named(self.name, f"{self.joint} friction", "dry friction"))
        put(self, friction=_friction(self.friction, f"dry friction {self.name!r}"))

    def elements(self, model, loops=()) -> list[Element]:
        return [JointFrictionElement(self, Coordinate(model, self.joint, f"dry friction {self.name!r}", "held"))]


@dataclass(frozen=True)
class PinFriction(ContactRecord):
    """Dry friction in the pin of a loop: its torque is at most μ r times the load of the pin across its axis.

    Parameters
    ----------
    loop : str
        A loop of kind ``"hinge"``, whose forces must be unique.
    radius : float
        Radius of the pin, m.
    friction : float or (float, float)
        Coulomb's friction coefficient; or the static and the kinetic one.
    name : str
        By default that of the loop with ``" friction"``.

    Raises
    ------
    InputError
        Numbers that cannot be used; on a mechanism, an unknown loop or one of another kind; in a run, loops that are
        overdetermined.
    """

    loop: str
    radius: float = 0.0
    friction: float | tuple[float, ...] = 0.0
    name: str = ""

    kind: ClassVar[str] = "pin-friction"
    has_gap: ClassVar[bool] = False

    def __post_init__(self):
        put_checked(self, "pin friction", name, "loop")
        put(self, name=_named(self.name, f"{self.loop} friction", "pin friction"))
        who = f"pin friction {self.name!r}"
        put_checked(self, who, number, "radius", above=0.0)
        put(self, friction=_friction(self.friction, who))

    def elements(self, model, loops=()) -> list[Element]:
        who = f"pin friction {self.name!r}"
        loop = next((each for each in loops if each.name == self.loop), None)
        if loop is None:
            raise InputError(f"{who}: no loop {self.loop!r}{near(self.loop, [each.name for each in loops])}")
        if not isinstance(loop, Loop) or loop.kind != "hinge":
            kind = loop.kind if isinstance(loop, Loop) else type(loop).__name__.lower()
            raise InputError(f"{who}: loop {self.loop!r} is a {kind}, and a pin is a loop of kind 'hinge'")
        return [PinElement(self, model, loop)]


CONTACTS: dict[str, type] = {each.kind: each for each in (Stop, Rope, Strut, Contact, DryFriction, PinFriction)}
"""Kinds in loop files → records."""


class Element(ABC):
    """One gap, one friction, or both, on a model.

    Attributes
    ----------
    record, side : ContactRecord, str
        Its record, and ``"lower"`` or ``"upper"`` of a stop.
    pushes : bool
        Whether it has a gap, whose row comes first.
    tangents : int
        The number of tangential rows, 0, 1 or 2.
    restitution, static, kinetic : float
        Of impacts; friction coefficients or, without a gap, forces.
    labels : tuple of str
        Names of its rows.
    of_joint, of_loop : bool
        Whether its rows are a joint's coordinate, and whether its friction depends on the forces of a loop.
    """

    pushes, of_joint, of_loop = True, False, False
    column: int  # of a joint's coordinate
    tangents, static, kinetic = 0, 0.0, 0.0
    labels: tuple[str, ...] = ("n",)

    def __init__(self, record, side=""):
        self.record, self.side = record, side
        self.restitution = getattr(record, "restitution", 0.0)

    def unit(self, model) -> str:
        """The unit of its positions."""
        return velocity_units(model)[self.column] if self.of_joint else "m"

    @property
    def name(self) -> str:
        return f"{self.record.name} {self.side}".rstrip()

    @property
    def size(self) -> int:
        """The number of its rows."""
        return self.pushes + self.tangents

    @abstractmethod
    def add(self, compiled, rows=None, at=None) -> None:
        """Add all its rows to a compiled system, or those with these indices; tangential ones from `at` on, (k,)."""

    def force(self, lam, x1, x2, turn1):
        """The force on body 2, (n, 3), in world axes; `turn1` are the axes of joint 1, (n, 3, 3)."""
        return np.zeros((len(lam), 3))

    def moment(self, lam, turn1):
        """The moment on body 2, (n, 3), in world axes."""
        return np.zeros((len(lam), 3))


class Hinge(NamedTuple):
    """The multipliers of a loop of kind hinge in a system with nv velocities: their places, and R = U λ."""

    nv: int
    places: tuple[int, ...] = ()
    U: np.ndarray = np.zeros((2, 0))

    def load(self, lam):
        """|R|, N, of λ or a stack of them; 1 where a torque does not depend on a load."""
        if not self.places:
            return np.ones(lam.shape[:-1])
        return np.linalg.norm(lam[..., list(self.places)] @ self.U.T, axis=-1)


class LimitElement(Element):
    """One stop of a joint."""

    of_joint = True

    def __init__(self, record, side, joint, sign, limit):
        super().__init__(record, side)
        self._numbers = joint.place, sign, limit, 0.0
        self.labels = (side,)
        self.column, self.sign, self.limit = joint.column, sign, limit

    def add(self, compiled, rows=None, at=None):
        compiled.add_limit(*self._numbers)


class JointFrictionElement(Element):
    """Dry friction of a joint."""

    pushes, of_joint, tangents, labels = False, True, 1, ("friction",)

    def __init__(self, record, joint):
        super().__init__(record)
        self._joint, self.column = joint, joint.column
        self.static, self.kinetic = record.friction

    def add(self, compiled, rows=None, at=None):
        compiled.add_limit(self._joint.place, 1.0, 0.0 if at is None else float(at[0]), self._joint.period or 0.0)

    def hinge(self, system) -> Hinge:
        """The forces that its friction depends on: none."""
        return Hinge(system.nv)

    def slide(self, compiled, sense, hinge):
        """Add its friction while it slides in one sense, -1 or 1."""
        torque = np.zeros(hinge.nv)
        torque[self.column] = -self.kinetic * sense
        compiled.add_constant(torque)


class PinElement(Element):
    """Friction of the pin of a loop; `static` and `kinetic` are μ r, m, its position is the angle about the axis."""

    pushes, of_loop, tangents, labels = False, True, 1, ("friction",)

    def __init__(self, record, model, loop):
        super().__init__(record)
        who = f"pin friction {record.name!r}"
        e = unit(loop.axis)
        self._turn = np.column_stack((*across(e), e))
        ends = []
        for frame, place in (loop.frame1, loop.placement1), (loop.frame2, loop.placement2):
            found = frame_of(model, frame, who)
            ends += [found.parentJoint, (found.placement * place * pin.SE3(self._turn, np.zeros(3))).homogeneous]
        self.ends = tuple(ends)
        self.static, self.kinetic = (record.radius * each for each in record.friction)

    def unit(self, model) -> str:
        return "rad"

    def hinge(self, system) -> Hinge:
        """The multipliers of its loop in a system of the mechanism; InputError if they are not unique."""
        if not system.dropped_are_zero:
            raise InputError(
                f"pin friction {self.name!r}: the loops are overdetermined, so that the load of the pin of loop "
                f"{self.record.loop!r} is not unique; take kinds of loops with fewer rows, such as 'point'"
            )
        first = system.rows.slices[self.record.loop].start
        places = [k for k, row in enumerate(system.kept) if 0 <= row - first < 3]
        return Hinge(system.nv, tuple(places), self._turn.T[:2, [int(system.kept[k]) - first for k in places]])

    def add(self, compiled, rows=None, at=None):
        compiled.add_pin(*self.ends, 0.0 if at is None else float(at[0]))

    def slide(self, compiled, sense, hinge):
        compiled.add_turning_pin(*self.ends, list(hinge.places), hinge.U, self.kinetic * sense)

    def moment(self, lam, turn1):
        return lam * (turn1 @ self.ends[1][:3, 2])


class DistanceElement(Element):
    """A rope or a strut between two points."""

    def __init__(self, record, ends):
        super().__init__(record)
        self.ends = ends
        self.sign = -1.0 if record.kind == "rope" else 1.0  # of the force on body 2 along the line

    def add(self, compiled, rows=None, at=None):
        add = compiled.add_rope if self.record.kind == "rope" else compiled.add_distance
        add(*self.ends, self.record.length)

    def force(self, lam, x1, x2, turn1):
        return self.sign * lam * (x2 - x1) / self.record.length


class PlaneElement(Element):
    """A point or a sphere above a plane, with as many tangents as its body can move along."""

    def __init__(self, record, model):
        super().__init__(record)
        who = f"contact {record.name!r}"
        self.joint1, place1, self.joint2, self.place2 = _ends(
            model, who, (record.on, (0.0, 0.0, 0.0)), (record.frame, record.xyz)
        )
        normal = np.array(record.normal) / np.linalg.norm(record.normal)
        turn = _axes(normal)
        shift = (record.offset + record.radius) * normal
        self.place1 = place1 @ pin.SE3(turn, shift).homogeneous  # z is the gap
        self.static, self.kinetic = record.friction
        ways = _tangents(model, self) if self.static else np.zeros((0, 2))
        self.tangents = len(ways)
        self.labels = ("n", "t1", "t2")[: 1 + len(ways)]
        self.matrix = np.vstack(([0.0, 0.0, 1.0], np.pad(ways, ((0, 0), (0, 1)))))

    def add(self, compiled, rows=None, at=None):
        place1 = self.place1
        if at is not None:
            place1 = place1 @ pin.SE3(np.eye(3), self.matrix[1:].T @ np.asarray(at)).homogeneous
        matrix = self.matrix if rows is None else self.matrix[list(rows)]
        compiled.add_anchored(self.joint1, place1, self.joint2, self.place2, matrix, True)

    def add_sliding(self, compiled, direction, still):
        compiled.add_sliding(*self.ends, self.matrix, self.kinetic, np.array(direction), still)

    @property
    def ends(self):
        return self.joint1, self.place1, self.joint2, self.place2

    def force(self, lam, x1, x2, turn1):
        return np.einsum("nij,nj->ni", turn1 @ self.place1[:3, :3], lam @ self.matrix)


def _ends(model, who, first, second):
    """(joint1, placement1, joint2, placement2) of points in frames."""
    ends, joints = [], []
    for frame, xyz in (first, second):
        found = frame_of(model, frame, who)
        ends += [found.parentJoint, (found.placement * pin.SE3(np.eye(3), np.array(xyz))).homogeneous]
        joints.append(found.parentJoint)
    if joints[0] == joints[1]:
        raise InputError(f"{who}: the frames {first[0]!r} and {second[0]!r} are on the same body")
    return tuple(ends)


def _axes(normal):
    """Axes with this z axis, nearest to those of the frame."""
    x = np.eye(3)[np.argmin(np.abs(normal) > 0.9)] if abs(normal[0]) > 0.9 else np.eye(3)[0]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(normal, x), normal))


def _tangents(model, element):
    """The directions in the plane along which the point can move against it, (k, 2)."""
    data, rng, square = model.createData(), np.random.default_rng(0), np.zeros((2, 2))
    for _ in range(PLACES):
        q = integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
        pin.computeJointJacobians(model, data, q)
        plane, point = (data.oMi[joint] * pin.SE3(place) for joint, place in (element.ends[:2], element.ends[2:]))
        moves = _moves(model, data, element.joint2, point) - _moves(model, data, element.joint1, point)
        J = (plane.rotation.T @ moves)[:2]
        square += J @ J.T
    sizes, ways = np.linalg.eigh(square)
    return ways.T[sizes > VANISHES * max(sizes[-1], 1e-30)][::-1]


def _moves(model, data, joint, point):
    """The velocity of the point of a body where `point` is, (3, nv), in the world."""
    if joint == 0:
        return np.zeros((3, model.nv))
    J = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, model.nv)
    return J[:3] - pin.skew(point.translation) @ J[3:]


def checked_contacts(model, contacts, loops) -> tuple[Any, ...]:
    """The contacts of a mechanism, after checks; InputError for other objects, and names that are not unique."""
    contacts = (contacts,) if isinstance(contacts, ContactRecord) else contacts
    if isinstance(contacts, str) or not hasattr(contacts, "__iter__"):
        raise InputError(f"contacts= needs a sequence, got {contacts!r}")
    contacts = tuple(contacts)
    if not all(isinstance(each, ContactRecord) for each in contacts):
        raise InputError(
            f"contacts= needs Stop, Rope, Strut, Contact, DryFriction and PinFriction objects, got {contacts!r}"
        )
    names = [each.name for each in (*contacts, *loops)]
    if twice := [each.name for each in contacts if names.count(each.name) > 1]:
        raise InputError(f"two contacts or loops are named {min(twice)!r}; reports need unique names: give a name=")
    elements_of(model, contacts, loops)
    return contacts


def elements_of(model, contacts, loops) -> list[Element]:
    """The elements of contacts on a model with loops."""
    return [element for record in contacts for element in record.elements(model, loops)]


def contact_units(mechanism, name) -> tuple[str, str]:
    """The units of the gap and of the force of a contact, by the name of its record or of a stop."""
    for element in mechanism.contact_elements:
        if name in (element.name, element.record.name):
            gap = element.unit(mechanism.model)
            return gap, {"rad": "N·m", "m": "N"}[gap]
    raise KeyError(name)
