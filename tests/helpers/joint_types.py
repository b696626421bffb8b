"""Trees and closed chains with every type of joint that Pinocchio has, except mimic joints, which are refused."""

import numpy as np
import pinocchio as pin

import pinconsist as pc
from pinconsist.mechanism.lie import integrate

AXIS = np.array([0.48, -0.6, 0.64])
TILTED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.4, 0.5), np.array([0.1, 0.2, -0.15]))


def composite(*joints):
    whole = pin.JointModelComposite(joints[0])
    for joint in joints[1:]:
        whole.addJoint(joint, TILTED)
    return whole


def unbounded(axis):
    """Its constructor in Python takes no axis; that of a URDF file is a joint of a model."""
    link = '<link name="{}"/>'
    turn = '<joint name="turn" type="continuous"><parent link="a"/><child link="b"/><axis xyz="{} {} {}"/></joint>'
    text = f'<robot name="turn">{link.format("a")}{link.format("b")}{turn.format(*axis)}</robot>'
    return pin.buildModelFromXML(text).joints[1]


JOINTS = {
    **{f"R{axis}": getattr(pin, f"JointModelR{axis}")() for axis in "XYZ"},
    **{f"RUB{axis}": getattr(pin, f"JointModelRUB{axis}")() for axis in "XYZ"},
    **{f"P{axis}": getattr(pin, f"JointModelP{axis}")() for axis in "XYZ"},
    **{f"H{axis}": getattr(pin, f"JointModelH{axis}")(0.3) for axis in "XYZ"},
    "revolute": pin.JointModelRevoluteUnaligned(AXIS),
    "unbounded revolute": unbounded(AXIS),
    "prismatic": pin.JointModelPrismaticUnaligned(AXIS),
    "helical": pin.JointModelHelicalUnaligned(AXIS, -0.2),
    "free-flyer": pin.JointModelFreeFlyer(),
    "planar": pin.JointModelPlanar(),
    "spherical": pin.JointModelSpherical(),
    "spherical by angles": pin.JointModelSphericalZYX(),
    "translation": pin.JointModelTranslation(),
    "universal": pin.JointModelUniversal(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])),
    "universal, unaligned": pin.JointModelUniversal(AXIS, np.array([0.8, 0.0, -0.6])),
    "ellipsoid": pin.JointModelEllipsoid(0.3, 0.2, 0.4),
    "composite": composite(pin.JointModelRX(), pin.JointModelPY(), pin.JointModelRevoluteUnaligned(AXIS)),
    "composite of slides": composite(pin.JointModelPX(), pin.JointModelPrismaticUnaligned(AXIS)),
    "composite with a ball": composite(pin.JointModelRZ(), pin.JointModelSpherical(), pin.JointModelPX()),
    "composite with a plane": composite(pin.JointModelRX(), pin.JointModelPlanar(), pin.JointModelRUBY()),
    "composite of composites": composite(
        composite(pin.JointModelRX(), pin.JointModelRZ()),
        pin.JointModelUniversal(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    ),
}


def of_pinocchio() -> set[str]:
    """The names of all types."""
    return {name for name in dir(pin) if name.startswith("JointModel")} - {"JointModel"}


def body(rng) -> pin.Inertia:
    turn = pin.exp3(rng.normal(size=3))
    return pin.Inertia(
        rng.uniform(0.5, 2.0), rng.uniform(-0.2, 0.2, 3), turn @ np.diag(rng.uniform(0.1, 0.2, 3)) @ turn.T
    )


def chain(kind, seed=0, loops=True) -> pc.Mechanism:
    """Arm, joint of this type, a second arm, and a branch; with springs, a wrench, and a loop from tip to branch."""
    rng, model = np.random.default_rng(seed), pin.Model()
    model.gravity.linear = np.array([0.7, 0.4, -9.0])

    def add(parent, joint, name):
        place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.4, 0.4, 3))
        at = model.addJoint(parent, joint, place, name)
        model.appendBodyToJoint(at, body(rng), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name}_body", at, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        return at

    arm = add(0, pin.JointModelRevoluteUnaligned(AXIS), "arm")
    add(add(arm, JOINTS[kind], "joint"), pin.JointModelRY(), "tip")
    branch = add(arm, pin.JointModelRZ(), "branch")
    add(branch, pin.JointModelRX(), "end")
    forces = (
        pc.SpringDamper("tip_body", "universe", 30.0, 0.3, 2.0, (0.1, -0.2, 0.3), (0.2, 0.4, 0.9)),
        pc.SpringDamper("joint_body", "end_body", 20.0, 0.4, 1.5, (0.3, 0.1, -0.1), (-0.2, 0.1, 0.2)),
        pc.Wrench("tip_body", (3.0, -2.0, 1.0), (0.4, 0.6, -0.3), "world", (0.1, 0.2, 0.3)),
        pc.Wrench("joint_body", (-1.0, 2.0, 4.0), (0.2, -0.5, 0.3), "local", (0.3, -0.1, 0.2)),
    )
    mech = pc.Mechanism(model, forces=forces, name=f"chain with {kind}")
    if not loops:
        return mech
    tip, end = np.array([0.1, 0.3, 0.2]), np.array([-0.2, 0.1, 0.3])
    poses = model.createData()
    pin.framesForwardKinematics(model, poses, mech.guess)
    ends = [poses.oMf[model.getFrameId(f"{name}_body")].act(xyz) for name, xyz in (("tip", tip), ("end", end))]
    length = float(np.linalg.norm(ends[0] - ends[1]))
    return mech.with_loops(pc.Loop("rod", "distance", "tip_body", "end_body", xyz1=tip, xyz2=end, length=length))


def state(mech, seed=0):
    """A closed state away from special positions."""
    rng = np.random.default_rng(seed)
    guess = integrate(mech.model, mech.guess, rng.uniform(-0.6, 0.6, mech.nv))
    found = pc.assemble(mech, guess, rng.normal(size=mech.nv))
    return found.q, found.v
