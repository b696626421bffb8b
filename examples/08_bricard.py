"""Bricard's mechanism: six hinges. By counting constraints it could not move, but one of them is always redundant."""

import pinocchio as pin

import pinconsist as pc


def run():
    """Two seconds from rest."""
    mech = pc.load("bricard")
    return mech, pc.simulate(mech, (0.0, 2.0), rtol=1e-8, atol=1e-8)


def main() -> float:
    """Return the height of the corner P3 after two seconds, m."""
    mech, sol = run()
    found = pc.assemble(mech)
    print(f"{found.rows} rows of rank {found.rank}, mobility {found.mobility}")
    for row, others in found.redundant.items():
        print(f"redundant: {row}, {f'a combination of {list(others)}' if others else 'which is zero'}")
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, sol.q[-1])
    return float(data.oMf[mech.model.getFrameId("P3")].translation[2])


if __name__ == "__main__":
    print(f"{main():.6f} m")
