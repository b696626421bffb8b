// Halves of M⁻¹: Featherstone, Rigid Body Dynamics Algorithms (2008).
#pragma once

#include "rigid_bodies.hpp"

namespace pinconsist {

constexpr double HARDLY = 1e-8; // relative to the inertia with the outer joints locked

// M = Lᵀ L, where L(k, i) is zero unless i leads to k: section 6.5.
class TreeFactors {
public:
  explicit TreeFactors(const Data &data) : before_(data.parents_fromRow) {}

  // The number of velocities on the path to `k`, including `k`.
  int depth(int k) const { return k < 0 ? 0 : 1 + depth(before_[k]); }

  // Overwrites M(i, k) with L(k, i); false if a velocity moves almost nothing.
  bool factorise(Mat &M) {
    bool regular = true;
    whole_ = M.diagonal();
    for (int k = static_cast<int>(M.cols()); k-- > 0;) {
      double *row = &M(0, k);
      regular &= row[k] > HARDLY * whole_[k];
      row[k] = std::sqrt(row[k]);
      for (int i = before_[k]; i >= 0; i = before_[i]) row[i] /= row[k];
      for (int i = before_[k]; i >= 0; i = before_[i])
        for (int j = i; j >= 0; j = before_[j]) M(j, i) -= row[i] * row[j];
    }
    return regular;
  }

  // Replaces each row x of X by L⁻ᵀ x: the product of two such rows is xᵀ M⁻¹ y.
  void solve_half(const Mat &L, Mat &X) const {
    const auto n = X.rows();
    for (int k = static_cast<int>(X.cols()); k-- > 0;) {
      double *x = &X(0, k);
      for (int r = 0; r < n; ++r) x[r] /= L(k, k);
      for (int i = before_[k]; i >= 0; i = before_[i]) {
        double *other = &X(0, i);
        for (int r = 0; r < n; ++r) other[r] -= L(i, k) * x[r];
      }
    }
  }

private:
  const std::vector<int> before_;
  Vec whole_;
};

// The same in O(n) for each right-hand side: section 7.3, in world axes, about a point of the mechanism: about a distant
// point, inertias would be differences of large numbers.
class ArticulatedBodies {
public:
  explicit ArticulatedBodies(const Model &model)
      : model_(model), bodies_(model.njoints), axes_(6, model.nv), U_(6, model.nv), forces_(model.njoints), root_(model.nv) {}

  // False if a velocity moves almost nothing. Poses and joint Jacobians must have been computed.
  bool factorise(const Data &data) {
    const Vector3d centre = data.oMi.back().translation();
    for (int i = 0; i < model_.njoints; ++i) {
      const SE3 pose(data.oMi[i].rotation(), data.oMi[i].translation() - centre);
      bodies_[i].inertia = pose.act(model_.inertias[i]).matrix();
      bodies_[i].rigid = bodies_[i].inertia;
    }
    for (int k = 0; k < model_.nv; ++k) axes_.col(k) << moved(data, k, centre), spin(data, k);
    bool regular = true;
    for (int i = model_.njoints - 1; i > 0; --i) {
      auto &[inertia, rigid] = bodies_[i];
      for (int k = model_.idx_vs[i] + model_.nvs[i]; k-- > model_.idx_vs[i];) {
        const auto axis = axes_.col(k);
        U_.col(k).noalias() = inertia * axis;
        const double pivot = axis.dot(U_.col(k)) + model_.armature[k];
        regular &= pivot > HARDLY * (axis.dot(rigid * axis) + model_.armature[k]);
        root_[k] = std::sqrt(pivot);
        U_.col(k) /= root_[k];
        inertia.noalias() -= U_.col(k) * U_.col(k).transpose();
      }
      bodies_[model_.parents[i]].inertia += inertia;
      bodies_[model_.parents[i]].rigid += rigid;
    }
    return regular;
  }

  // Like TreeFactors::solve_half.
  void solve_half(Mat &X) {
    for (auto &force : forces_) force.setZero(X.rows(), 6);
    for (int i = model_.njoints - 1; i > 0; --i) {
      auto &force = forces_[i];
      for (int k = model_.idx_vs[i] + model_.nvs[i]; k-- > model_.idx_vs[i];) {
        X.col(k) = (X.col(k) - force.lazyProduct(axes_.col(k))) / root_[k];
        force += X.col(k).lazyProduct(U_.col(k).transpose());
      }
      forces_[model_.parents[i]] += force;
    }
  }

private:
  struct Body {
    Eigen::Matrix<double, 6, 6> inertia, rigid; // with the outer joints free, and locked
  };

  const Model &model_;
  std::vector<Body> bodies_;
  Eigen::Matrix<double, 6, Eigen::Dynamic> axes_, U_;
  std::vector<Eigen::Matrix<double, Eigen::Dynamic, 6>> forces_;
  Vec root_;
};

} // namespace pinconsist
