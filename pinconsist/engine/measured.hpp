// The data of certificates, energies and reactions, at all rows of a solution: times, and one state per row.
#pragma once

#include "articulated.hpp"
#include "kkt.hpp"
#include "mechanism.hpp"

#include <array>
#include <future>

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

// Kinetic energy, rotors included, potential energy, and the sum of the largest sizes its terms may have, at the last
// poses and Jacobians of the joints.
inline Eigen::RowVector3d body_energies(const Model &model, Data &data, const Vec &v) {
  double twice = model.armature.cwiseProduct(v).dot(v), height = 0.0, reach = 0.0;
  data.ov[0].setZero();
  for (int i = 1; i < model.njoints; ++i) {
    const auto &inertia = model.inertias[i];
    data.ov[i] = data.ov[model.parents[i]] + pinocchio::Motion(joint_twist(model, data, i, v));
    const Vector3d centre = data.oMi[i].act(inertia.lever()), w = data.ov[i].angular();
    const Vector3d moved = data.ov[i].linear() + w.cross(centre), spin = data.oMi[i].rotation().transpose() * w;
    twice += inertia.mass() * moved.squaredNorm() + spin.dot(inertia.inertia() * spin);
    height -= inertia.mass() * model.gravity.linear().dot(centre);
    reach += inertia.mass() * centre.norm();
  }
  return {0.5 * twice, height, reach * model.gravity.linear().norm()};
}

// Each force in a system of its own.
using Forces = std::vector<MechanismSystem *>;

// The result of `body_energies`, then power and elastic energy of each force, at the last poses and Jacobians of the joints.
inline void measure_energies(MechanismSystem &system, const Forces &forces, double t, const Vec &p, const Vec &v,
                             Eigen::Ref<Eigen::RowVectorXd> energies) {
  energies.head<3>() = body_energies(system.model(), system.data(), v);
  for (size_t k = 0; k < forces.size(); ++k) {
    const auto [power, stored] = forces[k]->power(system.data(), t, p, v);
    energies[2 * k + 3] = power;
    energies[2 * k + 4] = stored;
  }
}

inline Eigen::Index width_of(const Forces &forces) { return static_cast<Eigen::Index>(2 * forces.size() + 3); }

struct Certified {
  Table phi, rho, forces, exact; // Φ, the hidden residual, Jᵀλ, and that of the differential equation
  Table energies;                // see measure_energies
  double acting = 0.0;           // largest weight or velocity-dependent inertial force, or their sum with all other forces
  bool complete = true;          // false if the equations are singular or not finite at any row
};

// Jᵀλ of the differential equation, by rows that are independent.
class ExactForces {
public:
  ExactForces(MechanismSystem &system, const std::vector<int> &kept)
      : system_(system), kept_(kept), nc_(static_cast<int>(kept.size())), bodies_(system.model()), tree_(system.data()),
        kkt_(system.nv, nc_), M_(system.nv, system.nv), W_(nc_, system.nv), X_(nc_ + 1, system.nv), S_(nc_ + 1, nc_), lam_(nc_) {
    double products = 0.0;
    for (int i = 0; i < system.nv; ++i) products += std::pow(tree_.depth(i), 2);
    by_bodies_ = products > DEEP * system.nv;
  }

  // Call after `constraint`; false if the equations are singular. f is known afterwards.
  bool find(double t, const Vec &p, const Vec &v, Eigen::Ref<Eigen::RowVectorXd> forces) {
    system_.evaluate_bias(t, p, v, true, bias_);
    forces.setZero();
    if (!nc_) return true;
    for (int k = 0; k < nc_; ++k) W_.row(k) = system_.W.row(kept_[k]);
    const bool found = by_products(t, p, v) || by_matrix(t, p, v);
    if (found) forces = lam_.transpose().lazyProduct(W_);
    return found;
  }

private:
  // J M⁻¹ Jᵀ λ = J M⁻¹ f − J̇ v; false for massless bodies, and near singular positions, where LU keeps more digits.
  bool by_products(double t, const Vec &p, const Vec &v) {
    X_ << W_, system_.f.transpose();
    if (by_bodies_) {
      if (!bodies_.factorise(system_.data())) return false;
      bodies_.solve_half(X_);
    } else {
      system_.mass_matrix(t, p, v, M_);
      if (!tree_.factorise(M_)) return false;
      tree_.solve_half(M_, X_);
    }
    S_.setZero();
    for (int k = 0; k < system_.nv; ++k)
      for (int j = 0; j < nc_; ++j)
        if (X_(j, k) != 0.0)
          for (int i = j; i <= nc_; ++i) S_(i, j) += X_(j, k) * X_(i, k);
    for (int j = 0; j < nc_; ++j) S_(nc_, j) -= bias_[kept_[j]];
    double least = INF, most = 0.0;
    for (int j = 0; j < nc_; ++j) { // L Lᵀ, and L⁻¹ times the right-hand side, which is the last row
      const double pivot = std::sqrt(S_(j, j));
      least = std::min(least, pivot);
      most = std::max(most, pivot);
      for (int i = j; i <= nc_; ++i) S_(i, j) /= pivot;
      for (int k = j + 1; k < nc_; ++k)
        for (int i = k; i <= nc_; ++i) S_(i, k) -= S_(k, j) * S_(i, j);
    }
    if (!(least > ALMOST_SINGULAR * most)) return false;
    for (int j = nc_; j-- > 0;) {
      lam_[j] = S_(nc_, j);
      for (int i = j + 1; i < nc_; ++i) lam_[j] -= S_(i, j) * lam_[i];
      lam_[j] /= S_(j, j);
    }
    return lam_.allFinite();
  }

  bool by_matrix(double t, const Vec &p, const Vec &v) {
    system_.mass_matrix(t, p, v, kkt_.A());
    rhs_.resize(system_.nv + nc_, 1);
    rhs_ << -system_.f, -bias_(kept_);
    if (!kkt_.solve_new(W_, W_, 1.0, rhs_)) return false;
    lam_ = rhs_.col(0).tail(nc_);
    return lam_.allFinite();
  }

  static constexpr double ALMOST_SINGULAR = 1e-4; // the Schur complement has its square
  static constexpr double DEEP = 700.0;           // products for each velocity, above which M⁻¹ in O(n) is cheaper

  MechanismSystem &system_;
  const std::vector<int> kept_;
  const int nc_;
  ArticulatedBodies bodies_;
  TreeFactors tree_;
  KKT kkt_;
  Mat M_, W_, X_, S_, rhs_;
  Vec lam_, bias_;
  bool by_bodies_;
};

// Divides the rows of a solution between equal systems, one per thread; `kept` are the independent constraint rows.
inline Certified certified(const std::vector<std::pair<MechanismSystem *, Forces>> &systems, const std::vector<int> &kept,
                           const Vec &t, const Table &p, const Table &v, const Table &lam) {
  const auto n = t.size(), parts = static_cast<Eigen::Index>(systems.size());
  const auto &[first, its_forces] = systems.front();
  Certified result{Table(n, first->nc), Table(n, first->nc), Table(n, first->nv), Table(n, first->nv), Table(n, width_of(its_forces))};
  const auto part = [&](Eigen::Index k) {
    const auto &[system, forces] = systems[k];
    ExactForces exact(*system, kept);
    Vec q, rate;
    double acting = 0.0;
    for (Eigen::Index i = n * k / parts; i < n * (k + 1) / parts; ++i) {
      q = p.row(i).transpose();
      rate = v.row(i).transpose();
      system->constraint(t[i], q, rate);
      if (!exact.find(t[i], q, rate, result.exact.row(i))) return INF;
      acting = std::max({acting, largest(system->inertial_forces(rate)), largest(system->f)});
      if (!system->nc) library::joint_jacobians(system->model(), system->data(), q);
      result.phi.row(i) = system->phi.transpose();
      result.rho.row(i) = system->rho.transpose();
      result.forces.row(i) = lam.row(i).lazyProduct(system->W);
      measure_energies(*system, forces, t[i], q, rate, result.energies.row(i));
    }
    return acting;
  };
  std::vector<std::future<double>> others;
  for (Eigen::Index k = 1; k < parts; ++k) others.push_back(std::async(std::launch::async, part, k));
  result.acting = part(0);
  for (auto &other : others) result.acting = std::max(result.acting, other.get());
  result.complete = result.acting < INF;
  return result;
}

inline Table energies(MechanismSystem &system, const Vec &t, const Table &p, const Table &v, const Forces &forces) {
  Table energies(p.rows(), width_of(forces));
  Vec q, rate;
  for (Eigen::Index i = 0; i < p.rows(); ++i) {
    q = p.row(i).transpose();
    rate = v.row(i).transpose();
    library::joint_jacobians(system.model(), system.data(), q);
    measure_energies(system, forces, t[i], q, rate, energies.row(i));
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
