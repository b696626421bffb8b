"""MuJoCo's model of an MJCF file compared with ours: kinematics, mass matrix, bias and passive forces, equalities."""

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin

from pinconsist.mechanism.rows import LoopRows
from pinconsist.mechanism.system import MechanismSystem

FREE, BALL = (int(kind) for kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL))
OFF = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_LIMIT
    | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    | mujoco.mjtDisableBit.mjDSBL_ACTUATION
)


class Peer:
    """A model in MuJoCo that accepts our configurations and velocities."""

    def __init__(self, path):
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.disableflags |= OFF
        self.data = mujoco.MjData(self.model)

    def names(self, kind, count):
        return [mujoco.mj_id2name(self.model, kind, i) for i in range(count)]

    @property
    def joints(self):
        return self.names(mujoco.mjtObj.mjOBJ_JOINT, self.model.njnt)

    def qpos(self, q):
        """Our configuration in MuJoCo's order of quaternions."""
        q = np.array(q)
        for kind, start in zip(self.model.jnt_type, self.model.jnt_qposadr, strict=True):
            if kind in (FREE, BALL):
                end = start + (7 if kind == FREE else 4)
                q[end - 4 : end] = np.roll(q[end - 4 : end], 1)
        return q

    def move(self, q, v):
        """Set one of our states; return (T, Ṫ v) with MuJoCo's velocity T v: free joints translate in world axes."""
        model, data = self.model, self.data
        data.qpos[:] = self.qpos(q)
        T, rate = np.eye(model.nv), np.zeros(model.nv)
        for kind, start, dof in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True):
            if kind == FREE:
                R = pin.Quaternion(np.array(q[start + 3 : start + 7])).toRotationMatrix()
                T[dof : dof + 3, dof : dof + 3] = R
                rate[dof : dof + 3] = R @ np.cross(v[dof + 3 : dof + 6], v[dof : dof + 3])
        data.qvel[:] = T @ v
        mujoco.mj_forward(model, data)
        return T, rate

    def mass(self):
        M = np.zeros((self.model.nv, self.model.nv))
        for row, unit in zip(M, np.eye(self.model.nv), strict=True):
            mujoco.mj_mulM(self.model, self.data, row, unit)
        return M

    def residuals(self, equality):
        """The rows of an equality constraint."""
        data = self.data
        mine = [i for i in range(data.nefc) if data.efc_type[i] == 0 and data.efc_id[i] == equality]
        return np.array(data.efc_pos)[mine]


def random_state(mech, rng):
    model = mech.model
    q = pin.integrate(model, mech.guess, rng.uniform(-1, 1, model.nv))
    return q, rng.normal(size=model.nv)


def differences(mech, path, rng, states=3, passive=True):
    """Largest differences over random states, each relative to the size of the quantity."""
    peer, model = Peer(path), mech.model
    assert (peer.model.nq, peer.model.nv, peer.model.njnt) == (model.nq, model.nv, len(mech.joints))
    for ours, theirs in zip(mech.joints, peer.joints, strict=True):
        assert theirs in (ours, None), (ours, theirs)
    found = dict.fromkeys(("frames", "mass", "bias", "passive", "equality"), 0.0)
    data = model.createData()
    system = MechanismSystem(_frictionless(mech), mech.guess) if passive else None
    for _ in range(states):
        q, v = random_state(mech, rng)
        T, rate = peer.move(q, v)

        def note(key, ours, theirs, scale=0.0):
            size = max(np.abs(theirs).max(initial=0.0), scale, 1e-12)
            found[key] = max(found[key], np.abs(ours - theirs).max(initial=0.0) / size)

        pin.framesForwardKinematics(model, data, q)
        for ours, theirs in _frames(mech, peer):
            note("frames", data.oMf[ours].homogeneous[:3], theirs, 1.0)
        M = peer.mass()
        note("mass", pin.crba(model, data, q), T.T @ M @ T)
        note("bias", pin.nle(model, data, q, v), T.T @ (peer.data.qfrc_bias + M @ rate), np.abs(M).max())
        if passive:
            note("passive", system.torque(0.0, q, v), T.T @ peer.data.qfrc_passive, np.abs(M).max())
        active = [i for i in range(peer.model.neq) if peer.data.eq_active[i]]
        phi = _rows(mech, q)
        assert len(active) == len(phi)
        for index, (kind, ours) in zip(active, phi, strict=True):
            note("equality", *_comparable(kind, ours, peer.residuals(index), peer.model.eq_data[index, 10]), 1.0)
    return found


def _frictionless(mech):
    """Without dry friction, which is a constraint in MuJoCo."""
    model = mech.model.copy()
    model.lowerDryFrictionLimit[:] = model.upperDryFrictionLimit[:] = 0.0
    return replace(mech, model=model)


def _frames(mech, peer):
    """(our frame, the pose MuJoCo gives it) of all named bodies and sites."""
    model, data = peer.model, peer.data
    ours = [frame.name for frame in mech.model.frames]
    for kind, count, pos, mat in (
        (mujoco.mjtObj.mjOBJ_BODY, model.nbody, data.xpos, data.xmat),
        (mujoco.mjtObj.mjOBJ_SITE, model.nsite, data.site_xpos, data.site_xmat),
    ):
        what = "body" if kind == mujoco.mjtObj.mjOBJ_BODY else "site"
        for i, name in enumerate(peer.names(kind, count)):
            clash = f"{name}_{what}"
            frame = clash if clash in ours else name
            if frame in ours:
                yield ours.index(frame), np.column_stack((mat[i].reshape(3, 3), pos[i]))


def _rows(mech, q):
    rows = LoopRows(mech.model, mech.loops)
    phi = rows.at(q)[0]
    return [(loop.kind, phi[rows.slices[loop.name]]) for loop in mech.loops]


def _comparable(kind, ours, theirs, torquescale):
    """Residuals in terms common to both: a distance, an angle, a joint's error."""
    if kind == "point":
        return np.linalg.norm(ours), np.linalg.norm(theirs[:3])
    if kind == "frame":
        angle = 2 * np.arcsin(min(1.0, np.linalg.norm(theirs[3:]) / torquescale))
        return np.array([np.linalg.norm(ours[:3]), np.linalg.norm(ours[3:])]), np.array(
            [np.linalg.norm(theirs[:3]), angle]
        )
    return np.abs(ours), np.abs(theirs)
