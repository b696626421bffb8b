// Joints whose axes depend on their own position: universal, spherical by angles, ellipsoid, most composites.
#pragma once

#include "rigid_bodies.hpp"

namespace pinconsist {

// The terms that Pinocchio's derivatives of rnea leave out: it takes the motion subspace S of each joint as constant in
// the axes of the moved body. With a velocity S(q) v of the joint and its rate S a + c(q, v), these terms follow from the
// derivatives of S, S v and S a + c by the position q of the joint, and of c by v. The former are differences of sixth
// order, with errors near 1e-13 as S consists of trigonometric functions; c is quadratic in v.
class TurningAxes {
public:
  explicit TurningAxes(const Model &model) : model_(model), joint_of_(model.nv, -1), moved_(model.nq), way_(model.nv) {
    const Vec neutral = library::neutral(model);
    const Vec still = Vec::Zero(model.nv);
    for (int i = 1; i < model.njoints; ++i) {
      if (model.nvs[i] < 2) continue;
      Joint joint{i, model.idx_vs[i], model.nvs[i], LoneJoint(model, i)};
      Matrix6x first;
      bool turns = false;
      for (int place = 0; place < 3; ++place) {
        way_ = (Vec::LinSpaced(model.nv, 1.0, model.nv).array() * 2.3 + 7.0 * place).sin();
        library::integrate(model_, neutral, way_, moved_);
        joint.alone.move(moved_, still);
        if (place) turns |= (joint.alone.S - first).cwiseAbs().maxCoeff() > CONSTANT;
        else first = joint.alone.S;
      }
      if (!turns) continue;
      for (int k = 0; k < joint.n; ++k) joint_of_[joint.column + k] = static_cast<int>(joints_.size());
      joints_.push_back(joint);
    }
  }

  bool empty() const { return joints_.empty(); }

  // Evaluates the derivatives at a state whose poses are in `data`.
  void move(const Data &data, const Vec &q, const Vec &v, const Vec &a) {
    for (auto &joint : joints_) differentiate(joint, data, q, v, a);
  }

  // ∂J_row/∂q_column in the axes of the moved body, which J_column × J_row does not contain; in world axes.
  Six change(int row, int column) const {
    const int of = joint_of_[column];
    if (of < 0 || joint_of_[row] != of) return Six::Zero();
    const Joint &joint = joints_[of];
    return joint.S.col((column - joint.column) * joint.n + row - joint.column);
  }

  // Completes the derivatives of rnea, after pinocchio::computeRNEADerivatives and `move` with the same q, v, a.
  void complete(const Data &data, Mat &by_v, Mat &by_q) const {
    for (const auto &joint : joints_) {
      const auto both = data.ov[joint.index] + data.ov[model_.parents[joint.index]];
      Matrix6x rates = joint.rates;
      for (int j = 0; j < joint.n; ++j)
        rates.col(j) += both.cross(pinocchio::Motion(Six(joint.speeds.col(j)))).toVector();
      for (const auto body : model_.subtrees[joint.index])
        for (int k = 0; k < model_.nvs[body]; ++k) add(data, body, model_.idx_vs[body] + k, joint, rates, by_v, by_q);
      for (int row = data.parents_fromRow[joint.column]; row >= 0; row = data.parents_fromRow[row])
        add(data, joint.index, row, joint, rates, by_v, by_q);
      const Six force = data.of[joint.index].toVector();
      for (int j = 0; j < joint.n; ++j)
        for (int k = 0; k < joint.n; ++k)
          by_q(joint.column + k, joint.column + j) += joint.S.col(j * joint.n + k).dot(force);
    }
  }

private:
  static constexpr double STEP = 5e-3;      // rad or m, as SMOOTH of mechanism/axes.py
  static constexpr double CONSTANT = 1e-10; // change of S that is rounding

  struct Joint {
    int index, column, n;
    LoneJoint alone;
    // In world axes: ∂S/∂q_j for one j after another, ∂(S v)/∂q, ∂(S a + c)/∂q, ∂c/∂v.
    Matrix6x S{}, speeds{}, rates{}, by_v{};
  };

  void differentiate(Joint &joint, const Data &data, const Vec &q, const Vec &v, const Vec &a) {
    const int n = joint.n;
    const auto own_v = v.segment(joint.column, n), own_a = a.segment(joint.column, n);
    joint.S.setZero(6, n * n);
    joint.speeds.setZero(6, n);
    joint.rates.setZero(6, n);
    joint.by_v.setZero(6, n);
    way_.setZero();
    for (int j = 0; j < n; ++j) {
      for (const auto &[place, weight] : {std::pair(1, 45.0), std::pair(2, -9.0), std::pair(3, 1.0)})
        for (const double side : {1.0, -1.0}) {
          way_[joint.column + j] = side * place * STEP;
          library::integrate(model_, q, way_, moved_);
          joint.alone.move(moved_, v);
          const double share = side * weight / (60.0 * STEP);
          joint.S.middleCols(j * n, n) += share * joint.alone.S;
          joint.rates.col(j) += share * (joint.alone.S * own_a + joint.alone.c);
        }
      way_[joint.column + j] = 0.0;
      joint.speeds.col(j) = joint.S.middleCols(j * n, n) * own_v;
    }
    const double step = 1.0 + largest(own_v);
    Vec speed = v;
    for (int j = 0; j < n; ++j)
      for (const double side : {1.0, -1.0}) {
        speed[joint.column + j] = own_v[j] + side * step;
        joint.alone.move(q, speed);
        joint.by_v.col(j) += (0.5 * side / step) * joint.alone.c;
        speed[joint.column + j] = own_v[j];
      }
    for (Matrix6x *part : {&joint.S, &joint.speeds, &joint.rates, &joint.by_v})
      *part = (data.oMi[joint.index].toActionMatrix() * *part).eval();
  }

  // The forces of the bodies from `body` on, in direction `row`.
  static void add(const Data &data, int body, int row, const Joint &joint, const Matrix6x &rates, Mat &by_v, Mat &by_q) {
    const Six axis = data.J.col(row);
    const Six inertia = (data.oYcrb[body] * pinocchio::Motion(axis)).toVector();
    const Eigen::Matrix<double, 1, 6> varying = axis.transpose() * data.doYcrb[body];
    by_q.block(row, joint.column, 1, joint.n) += inertia.transpose() * rates + varying * joint.speeds;
    by_v.block(row, joint.column, 1, joint.n) += inertia.transpose() * joint.by_v;
  }

  const Model &model_;
  std::vector<Joint> joints_;
  std::vector<int> joint_of_; // of a velocity column: its place in joints_, or -1
  Vec moved_, way_;
};

} // namespace pinconsist
