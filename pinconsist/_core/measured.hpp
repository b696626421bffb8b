// What certificates, energies and reactions are made of, at all rows of a solution: times, and states one a row.
#pragma once

#include "index1.hpp"

#include <pinocchio/algorithm/kinematics.hpp>

#include <array>

namespace pinconsist {

// Φ, the hidden residual, and Jᵀλ.
inline std::array<Table, 3> residuals(MechanismSystem &system, const Vec &t, const Table &p, const Table &v, const Table &lam) {
  std::array<Table, 3> all{Table(t.size(), system.nc), Table(t.size(), system.nc), Table(t.size(), system.nv)};
  for (Eigen::Index i = 0; i < t.size(); ++i) {
    system.constraint(t[i], p.row(i).transpose(), v.row(i).transpose());
    all[0].row(i) = system.phi.transpose();
    all[1].row(i) = system.rho.transpose();
    all[2].row(i).noalias() = lam.row(i) * system.W;
  }
  return all;
}

// Weight and kinetic energy, rotors included, of bodies that stand and move as forward kinematics have left them.
inline double potential_energy(const Model &model, const Data &data) {
  double energy = 0.0;
  for (int joint = 1; joint < model.njoints; ++joint) {
    const auto &inertia = model.inertias[joint];
    energy -= inertia.mass() * model.gravity.linear().dot(data.oMi[joint].act(inertia.lever()));
  }
  return energy;
}

inline double kinetic_energy(const Model &model, const Data &data, const Vec &v) {
  double twice = model.armature.cwiseProduct(v).dot(v);
  for (int joint = 1; joint < model.njoints; ++joint) twice += model.inertias[joint].vtiv(data.v[joint]);
  return 0.5 * twice;
}

struct Certified {
  Table phi, rho, forces, exact; // Φ, the hidden residual, Jᵀλ, and that of the differential equation
  Table energies;                // kinetic, potential
  double acting = 0.0;           // largest weight or inertial force of velocities, or these with all other forces
  Eigen::Index failed = -1;      // first row at which the equations are singular or not finite
};

// `all` has the rows that `kept` has and those that it has not, on the same workspace.
inline Certified certified(MechanismSystem &kept, MechanismSystem &all, const Vec &t, const Table &p, const Table &v,
                           const Table &lam) {
  const Eigen::Index n = t.size();
  Certified result{Table(n, all.nc), Table(n, all.nc), Table(n, all.nv), Table(n, all.nv), Table(n, 2)};
  Projection projection(kept);
  const Model &model = kept.model();
  Data &data = kept.data();
  const Vec zero = Vec::Zero(model.nv);
  Vec q, rate, a, exact;
  for (Eigen::Index i = 0; i < n; ++i) {
    q = p.row(i).transpose();
    rate = v.row(i).transpose();
    const bool regular = projection.acceleration(t[i], q, rate, a, exact);
    if (!regular || !a.allFinite() || !exact.allFinite()) {
      result.failed = i;
      break;
    }
    result.exact.row(i).noalias() = exact.transpose() * kept.W;
    result.acting = std::max({result.acting, largest(data.tau), largest(kept.f)});
    if (kept.nc) {
      all.constraint_there(t[i], q, rate);
    } else {
      pinocchio::forwardKinematics(model, data, q, rate, zero);
      all.constraint(t[i], q, rate);
    }
    result.phi.row(i) = all.phi.transpose();
    result.rho.row(i) = all.rho.transpose();
    result.forces.row(i).noalias() = lam.row(i) * all.W;
    result.energies.row(i) << kinetic_energy(model, data, rate), potential_energy(model, data);
  }
  return result;
}

// Kinetic and potential energy.
inline Table energies(MechanismSystem &system, const Table &p, const Table &v) {
  const Model &model = system.model();
  Data &data = system.data();
  Table energies(p.rows(), 2);
  Vec q, rate;
  const Vec still = Vec::Zero(model.nv);
  for (Eigen::Index i = 0; i < p.rows(); ++i) {
    q = p.row(i).transpose();
    rate = v.row(i).transpose();
    pinocchio::forwardKinematics(model, data, q, rate, still);
    energies.row(i) << kinetic_energy(model, data, rate), potential_energy(model, data);
  }
  return energies;
}

// Joint torques of all forces.
inline Table torques(MechanismSystem &system, const Vec &t, const Table &p, const Table &v) {
  Table torques(t.size(), system.nv);
  for (Eigen::Index i = 0; i < t.size(); ++i)
    torques.row(i) = system.torque(t[i], p.row(i).transpose(), v.row(i).transpose()).transpose();
  return torques;
}

// Elastic energy of all springs.
inline Vec stored(MechanismSystem &system, const Table &p) {
  Vec stored(p.rows());
  for (Eigen::Index i = 0; i < p.rows(); ++i) stored[i] = system.stored(p.row(i).transpose());
  return stored;
}

// Force on the second body at its anchor, and moment about it, of all rows: in world axes, or those of the first anchor.
inline Table wrenches(MechanismSystem &system, const Vec &t, const Table &p, const Table &lam, int joint1, const SE3 &place1,
                      int joint2, const SE3 &place2, bool in_world) {
  Table wrenches(t.size(), 6);
  const Vec still = Vec::Zero(system.nv);
  for (Eigen::Index i = 0; i < t.size(); ++i) {
    system.constraint(t[i], p.row(i).transpose(), still);
    const SE3 anchor1 = placed(system.data(), joint1, place1), anchor2 = placed(system.data(), joint2, place2);
    Vector3d force = Vector3d::Zero(), moment = Vector3d::Zero();
    system.add_wrench(lam.row(i).transpose(), anchor2.translation(), force, moment);
    const Matrix3d turn = in_world ? Matrix3d::Identity() : Matrix3d(anchor1.rotation().transpose());
    wrenches.row(i) << (turn * force).transpose(), (turn * moment).transpose();
  }
  return wrenches;
}

} // namespace pinconsist
