"""Mechanism → URDF and loop file."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from ..errors import FormatError, InputError
from ..files import written_whole
from ..mechanism.constraints.loops import LoopRows
from ..mechanism.mechanism import Mechanism
from . import urdf_scene
from .records_writing import force_entries, loop_entries
from .urdf_writing import urdf_text

_STANDARD_GRAVITY = (0.0, 0.0, -9.81)
_SAME = 1e-9


def write(mechanism: Mechanism, path) -> Path:
    """Write a mechanism as a URDF file and the loop file that belongs to it, ``<stem>.urdf`` and ``<stem>.yaml``.

    Both are written whole or not at all, over what was there, after having been read back and compared: the tree in
    the order of its joints, inertias, joint types, damping, friction and rotor inertia (armature), limits of hinges and
    sliders, gravity, loops, couplings and drives, forces, guess, motorised joints, duration, and the shapes of URDF
    scenes. Mesh files stay where they are: files elsewhere are found again by ``load(..., package_dirs=...)``. Frames
    keep their names and places; those of joints that had none, and the links of joints without a body frame, come in
    addition.

    Parameters
    ----------
    mechanism : Mechanism
    path : path-like
        The URDF file, ``.urdf`` is added where it is missing; its stem becomes the name.

    Returns
    -------
    Path
        The URDF file.

    Raises
    ------
    InputError
        What a file cannot hold, by name: functions of your own, joints of a kind without a word; or a folder that is
        not there.
    """
    if not isinstance(mechanism, Mechanism):
        raise InputError(f"write needs a Mechanism, got {type(mechanism).__name__}")
    if not isinstance(path, (str, os.PathLike)):
        raise InputError(f"write needs the path of a file, got {path!r}")
    path = Path(path)
    path = path if path.suffix == ".urdf" else path.with_name(path.name + ".urdf")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    urdf, scene = _content(mechanism, path.stem)
    try:
        back = _read_back(urdf, scene, path.stem)
        if back.joints != mechanism.joints:
            scene["joint_order"] = list(mechanism.joints)
            back = _read_back(urdf, scene, path.stem)
    except FormatError as error:
        raise InputError(f"{mechanism.name} cannot be written as a URDF that reads back: {error.reason}") from error
    _require_same(mechanism, back)
    with written_whole(path) as robot, written_whole(path.with_suffix(".yaml")) as loops:
        robot.write(urdf.encode())
        loops.write(_yaml(scene))
    return path


def _content(mechanism, name):
    """The URDF text, and the loop file as plain data."""
    model = mechanism.model
    urdf, joints = urdf_text(mechanism, name)
    scene = {}
    gravity = tuple(model.gravity.linear.tolist())
    if gravity != _STANDARD_GRAVITY:
        scene["gravity"] = list(gravity)
    if np.any(model.gravity.angular):
        raise InputError(f"{mechanism.name}: gravity has an angular part, which a file cannot hold")
    guess = {}
    for i in range(1, model.njoints):
        share = mechanism.guess[model.idx_qs[i] : model.idx_qs[i] + model.nqs[i]].tolist()
        guess[model.names[i]] = share[0] if len(share) == 1 else share
    for key, value in (
        ("joints", joints),
        ("loops", loop_entries(mechanism)),
        ("forces", force_entries(mechanism)),
        ("guess", guess),
        ("actuated", list(mechanism.actuated)),
    ):
        if value:
            scene[key] = value
    if mechanism.duration != Mechanism.duration:
        scene["duration"] = mechanism.duration
    return urdf, scene


def _yaml(scene) -> bytes:
    return yaml.safe_dump(scene, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120).encode()


def _read_back(urdf, scene, name):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.urdf"
        path.write_text(urdf, encoding="utf-8")
        path.with_suffix(".yaml").write_bytes(_yaml(scene))
        return urdf_scene.load(path, name, loops=None, closure=None, free_flyer=False, package_dirs=())


def _require_same(mechanism, back):
    """Raise InputError where the equations of motion read back are others: a last line of defence."""
    rng = np.random.default_rng(0)
    if (back.joints, back.nq, back.nv, back.nc) == (mechanism.joints, mechanism.nq, mechanism.nv, mechanism.nc):
        q = pin.integrate(mechanism.model, mechanism.guess, rng.uniform(-0.5, 0.5, mechanism.nv))
        v = rng.uniform(-1, 1, mechanism.nv)
        pairs = zip(_equations(mechanism, q, v), _equations(back, q, v), strict=True)
        if all(
            np.allclose(one, other, rtol=_SAME, atol=_SAME * (1 + np.abs(one).max(initial=0))) for one, other in pairs
        ):
            return
    raise InputError(
        f"{mechanism.name} cannot be written as URDF: what was read back is another mechanism. Please report this"
    )


def _equations(mechanism, q, v):
    """M, nle, Φ and J."""
    model, data = mechanism.model, mechanism.model.createData()
    M = np.triu(pin.crba(model, data, q))
    bias = pin.rnea(model, data, q, v, np.zeros(model.nv))
    pin.computeJointJacobians(model, data, q)
    return M, np.array(bias), *LoopRows(model, mechanism.loops).evaluate(data, q)
