// gradients/known.py: what a parameter of bodies, of gravity or of one force changes in f, as a system without rows.
#pragma once

#include "mechanism.hpp"

namespace pinconsist {

class Rates : public MechanismSystem {
public:
  // Where the workspace that several share has been evaluated last.
  struct Place {
    Vec p, v, a;
  };

  Rates(nb::object model, nb::object data, int rows, std::shared_ptr<Place> place)
      : MechanismSystem(std::move(model), std::move(data)), place_(std::move(place)) {
    nc = rows;
    size_rows();
  }

  // Rates of mass, mass times its centre, and inertia about the joint (xx, xy, yy, xz, yz, zz).
  void add_inertia(int joint, const Vec &numbers) {
    joint_ = joint;
    mass_ = numbers[0];
    moment_ = numbers.segment<3>(1);
    inertia_ << numbers[4], numbers[5], numbers[7], numbers[5], numbers[6], numbers[8], numbers[7], numbers[8], numbers[9];
  }
  void add_gravity(const Vector3d &rate) { gravity_ = rate; }

  void evaluate(double t, const Vec &p, const Vec &v, const Vec &a) override {
    see(p, v, a);
    f.setZero();
    if (joint_) {
      const auto &moving = data_.v[joint_];
      push(joint_, momentum(data_.a_gf[joint_]) + moving.cross(momentum(moving)));
    }
    if (gravity_.squaredNorm() > 0.0)
      for (int j = 1; j < model_.njoints; ++j) {
        const pinocchio::Motion falling(data_.oMi[j].rotation().transpose() * -gravity_, Vector3d::Zero());
        push(j, model_.inertias[j] * falling);
      }
    subtract_forces(t, p, v);
  }

private:
  void see(const Vec &p, const Vec &v, const Vec &a) {
    if (place_->p.size() && place_->p == p && place_->v == v && place_->a == a) return;
    f = pinocchio::rnea(model_, data_, p, v, a);
    find_jacobians();
    *place_ = {p, v, a};
  }

  // The rates of inertia times a motion.
  pinocchio::Force momentum(const pinocchio::Motion &m) const {
    return pinocchio::Force(mass_ * m.linear() + m.angular().cross(moment_), moment_.cross(m.linear()) + inertia_ * m.angular());
  }

  // Add what a force on a body, in its axes, is at the joints.
  void push(int body, const pinocchio::Force &force) {
    const pinocchio::Force there = data_.oMi[body].act(force);
    for (int j = body; j > 0; j = model_.parents[j]) {
      const auto &joint = model_.joints[j];
      f.segment(joint.idx_v(), joint.nv()) += data_.J.middleCols(joint.idx_v(), joint.nv()).transpose() * there.toVector();
    }
  }

  std::shared_ptr<Place> place_;
  int joint_ = 0;
  double mass_ = 0.0;
  Vector3d moment_ = Vector3d::Zero(), gravity_ = Vector3d::Zero();
  Matrix3d inertia_ = Matrix3d::Zero();
};

} // namespace pinconsist
