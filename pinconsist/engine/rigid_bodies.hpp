// Points and axes of bodies, and the velocities that move them.
#pragma once

#include "curve.hpp"
#include "tree.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

namespace pinconsist {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Six = Eigen::Matrix<double, 6, 1>; // a twist (linear, angular) or wrench (force, moment) about the origin, world axes

// Velocity columns that move a joint's body, ascending, each with the joint that it belongs to.
struct Column {
  int index, joint;
};

inline std::vector<Column> columns_of(const Model &model, int joint) {
  std::vector<Column> columns;
  for (auto support : model.supports[joint])
    for (int i = 0; i < model.nvs[support]; ++i)
      columns.push_back({model.idx_vs[support] + i, static_cast<int>(support)});
  return columns;
}

// Columns that move exactly one of two bodies, with the sign of that body in "body 2 against body 1".
struct Signed : Column {
  double sign;
};

inline std::vector<Signed> columns_between(const Model &model, int joint1, int joint2) {
  std::vector<Signed> between;
  const auto first = columns_of(model, joint1), second = columns_of(model, joint2);
  const auto holds = [](const std::vector<Column> &columns, int index) {
    return std::any_of(columns.begin(), columns.end(), [=](const Column &c) { return c.index == index; });
  };
  for (const auto &column : first)
    if (!holds(second, column.index)) between.push_back({column, -1.0});
  for (const auto &column : second)
    if (!holds(first, column.index)) between.push_back({column, 1.0});
  return between;
}

// Velocity of the point x of a moving body, and its spin, for each unit of a joint velocity; in world axes.
inline Vector3d moved(const Data &data, int column, const Vector3d &x) {
  const auto twist = data.J.col(column);
  return twist.head<3>() + twist.tail<3>().cross(x);
}

inline Vector3d moved(const Six &twist, const Vector3d &x) { return twist.head<3>() + twist.tail<3>().cross(x); }

inline Vector3d spin(const Data &data, int column) { return data.J.col(column).tail<3>(); }

inline SE3 placed(const Data &data, int joint, const SE3 &placement) {
  return joint ? data.oMi[joint] * placement : placement;
}

// The world position of its origin.
inline Vector3d origin(const Data &data, int joint, const SE3 &placement) {
  return joint ? Vector3d(data.oMi[joint].act(placement.translation())) : placement.translation();
}

// Axes in the world.
inline Matrix3d axes(const Data &data, int joint, const SE3 &placement) {
  return joint ? Matrix3d(data.oMi[joint].rotation() * placement.rotation()) : placement.rotation();
}

// A point of a body, moving: classical acceleration a; the body's spin w and angular acceleration b; in world axes.
struct Moving {
  Vector3d x, v, w, a, b;

  Moving(const Data &data, int joint, const SE3 &placement)
      : x(origin(data, joint, placement)), w(data.ov[joint].angular()), b(data.oa[joint].angular()) {
    v = data.ov[joint].linear() + w.cross(x);
    a = data.oa[joint].linear() + b.cross(x) + w.cross(v);
  }
};

// Acceleration of point 2 as body 1 sees it, in world axes.
inline Vector3d seen_acceleration(const Moving &m1, const Moving &m2) {
  const Vector3d r = m2.x - m1.x, rd = m2.v - m1.v;
  return m2.a - m1.a - m1.b.cross(r) + m1.w.cross(m1.w.cross(r) - 2.0 * rd);
}

// mechanism/joint_constraints.py: Coordinate
struct Coordinate {
  int column, q;
  bool wraps;

  double value(const Vec &p) const { return wraps ? std::atan2(p[q + 1], p[q]) : p[q]; }
};

inline double nearest(double gap, double period) { return period > 0.0 ? std::remainder(gap, period) : gap; }

} // namespace pinconsist
