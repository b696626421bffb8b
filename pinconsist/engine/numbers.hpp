// Numbers of a compiled mechanism that are changed in place: of bodies, anchors, forces, and damping of joints.
#pragma once

#include "mechanism.hpp"

namespace pinconsist {

// They are side by side in `values`; each `add` returns the place of the first of its numbers, or -1 if there are none. What
// the system has afterwards depends on the values alone, not on earlier ones.
class Numbers {
public:
  Numbers(Model &tree, MechanismSystem &system) : tree_(tree), system_(system) {}

  const Vec &values() const { return values_; }

  // Of the body at a joint: mass, centre of mass, inertia about it (3 × 3).
  int add_body(int joint) {
    const Branch &branch = tree_.branches.at(joint - 1);
    Vec now(13);
    now << branch.mass, branch.centre, Eigen::Map<const Eigen::Matrix<double, 9, 1>>(branch.inertia.data());
    return add({BODY, joint, 0, nullptr}, now);
  }
  // The point of body 1 or 2 of a part of the rows, in the axes of its joint.
  int add_place(int part, int body, const Vector3d &now) {
    return system_.place_rows(part, body, now) ? add({POINT, part, body, nullptr}, now) : -1;
  }
  // Numbers that others are computed from.
  int add_note(const Vec &now) { return add({NOTE, 0, 0, nullptr}, now); }
  int add_number(int force, const std::string &name) {
    double *number = system_.number(force, name);
    return number ? add({NUMBER, 0, 0, number}, Vec::Constant(1, *number)) : -1;
  }
  // Of all velocities.
  int add_damping() { return add({DAMPING, 0, 0, nullptr}, system_.damping()); }

  void set(const Vec &values) {
    bool changed = false;
    for (const auto &each : all_) {
      const auto wanted = values.segment(each.first, each.size);
      auto now = values_.segment(each.first, each.size);
      if (!std::memcmp(wanted.data(), now.data(), each.size * sizeof(double))) continue;
      now = wanted;
      changed = true;
      apply(each);
    }
    if (changed) system_.renew_lanes();
  }

private:
  enum Kind { BODY, POINT, NOTE, NUMBER, DAMPING };
  struct Part {
    Kind kind;
    int index, body;
    double *number;
    Eigen::Index first = 0, size = 0;
  };

  int add(Part part, const Vec &now) {
    part.first = values_.size();
    part.size = now.size();
    values_.conservativeResize(part.first + part.size);
    values_.tail(part.size) = now;
    all_.push_back(part);
    return static_cast<int>(part.first);
  }

  void apply(const Part &part) {
    const double *now = values_.data() + part.first;
    if (part.kind == BODY) tree_.set_body(part.index, now[0], Vector3d(now + 1), Matrix3d(now + 4));
    else if (part.kind == POINT) system_.place_rows(part.index, part.body, Vector3d(now));
    else if (part.kind == NUMBER) *part.number = now[0];
    else if (part.kind == DAMPING) system_.damping() = values_.segment(part.first, part.size);
  }

  Model &tree_;
  MechanismSystem &system_;
  Vec values_;
  std::vector<Part> all_;
};

} // namespace pinconsist
