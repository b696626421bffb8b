"""What is drawn: the rows of a solution, the mechanism they belong to, and a name for each column."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ...mechanism.constraints.loops import LoopRows

SYMBOLS = {"q": "q", "v": "v", "lam": "λ"}


class Subject:
    """A solution to draw.

    Parameters
    ----------
    sol : object
        With ``t``, shape (n,), and ``q``, ``v``, ``lam`` of n rows each.
    mech : Mechanism, optional
        Default: the one that the solution was made of, if it still knows it.

    Raises
    ------
    InputError
        Sizes that do not fit, or no rows.
    """

    def __init__(self, sol, mech=None):
        self.sol = sol
        self.mech = mech if mech is not None else getattr(getattr(sol, "system", None), "mechanism", None)
        self.t = np.asarray(sol.t, float)
        if not self.t.size:
            raise InputError("the solution has no rows to draw")
        self.q, self.v, self.lam = (self._rows(name) for name in SYMBOLS)
        self.labels = self._labels()

    def need_mechanism(self, of_what: str):
        """The mechanism, or an error that says how to give it."""
        if self.mech is None:
            raise InputError(
                f"a picture of the {of_what} needs the mechanism: give it as mech=. A solution read from a file does "
                "not hold it, a general problem has none"
            )
        return self.mech

    @cached_property
    def residuals(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Loops, and of each the largest |Φ| and |J v + Φ_t| of each row, shapes (n, loops)."""
        system = getattr(self.sol, "system", None)
        if self.mech is None and system is not None:
            return self._residuals_of(system)
        mech = self.need_mechanism("constraint drift")
        model, data = mech.model, mech.model.createData()
        rows, gaps, rates = LoopRows(model, mech.loops), [], []
        for t, q, v in zip(self.t, self.q, self.v, strict=True):
            pin.computeJointJacobians(model, data, q)
            phi, J = rows.evaluate(data, q, t)
            gaps.append(np.abs(phi))
            rates.append(np.abs(J @ v + rows.time_rate(t, q)))
        parts = [(slice(None), part) for part in rows.slices.values()]
        by_loop = [[np.asarray(each)[part].max(axis=1) for part in parts] for each in (gaps, rates)]
        shape = (len(parts), self.t.size)
        drift, rate = (np.reshape(each, shape).T for each in by_loop)
        return list(rows.slices), drift, rate

    def _residuals_of(self, system):
        """The same for each row of a general problem."""
        gaps, rates, a = [], [], np.zeros(self.v.shape[1])
        for t, p, v in zip(self.t, self.q, self.v, strict=True):
            gaps.append(np.abs(system.evaluate(t, p, v, a)[1]))
            rates.append(np.abs(system.constraint(t, p, system.rate(t, p, v))[1]))
        return [f"row {k + 1}" for k in range(system.nc)], np.array(gaps), np.array(rates)

    def _rows(self, name):
        values = np.asarray(getattr(self.sol, name), float)
        if values.ndim != 2 or len(values) != self.t.size:
            raise InputError(f"a figure needs {name} of shape ({self.t.size}, columns), got {values.shape}")
        return values

    def _labels(self) -> dict[str, list[str]]:
        parts = {"q": self.q, "v": self.v, "lam": self.lam}
        labels = {name: [f"{SYMBOLS[name]}{k + 1}" for k in range(part.shape[1])] for name, part in parts.items()}
        if self.mech is None:
            return labels
        rows = [f"{loop} {row}" for loop, row in self.mech.row_labels]
        named = {
            "q": _joint_labels(self.mech.joints, list(self.mech.model.nqs)[1:]),
            "v": _joint_labels(self.mech.joints, list(self.mech.model.nvs)[1:]),
            "lam": rows if len(rows) == len(labels["lam"]) else labels["lam"],  # redundant rows may have been left out
        }
        for name, names in named.items():
            if len(names) != len(labels[name]):
                raise InputError(
                    f"{self.mech.name!r} has {len(names)} columns of {name}, the solution {len(labels[name])}"
                )
        return named


def _joint_labels(joints, sizes) -> list[str]:
    return [f"{name}[{k}]" if size > 1 else name for name, size in zip(joints, sizes, strict=True) for k in range(size)]
