// The rows of loops: Φ, J and their rates; see mechanism/loops.py.
//
// Rows along fixed directions, of distances, drives and couplings are exact, also while a loop is open, as those of
// turns and tilts are (TurnRows, TiltRows: assembly). Steps stay near closed configurations; there, rows that turn are
// constant combinations of the position of a point, or of the logarithm of a pose (AnchoredRows), with the same zeros
// and, in closed loops, the same J.
#pragma once

#include "rigid_bodies.hpp"
#include "state_lanes.hpp"

namespace pinconsist {

struct Rows {
  virtual ~Rows() = default;
  // Fill Φ and J from row `at` on; J is zero there. Joint Jacobians have been computed at p.
  virtual void evaluate(const Data &data, double t, const Vec &p, int at, Vec &phi, Mat &J) const = 0;
  // Add Φ_t from row `at` on.
  virtual void add_rate(double, const Vec &, int, Vec &) const {}
  // Write γ, the rate of J v + Φ_t without accelerations, from row `at` on (or add it, if parts add up); forward kinematics
  // have been computed.
  virtual void add_bias(const Data &data, double t, const Vec &p, const Vec &v, int at, Vec &bias) const = 0;
  // Add force and moment about x on the second body, of rows between two anchors, in world axes.
  virtual void add_wrench(const Data &, const Vec &, const Vector3d &, Vector3d &, Vector3d &) const {}
  // Add F = ∂(Jᵀλ)/∂q and, unless H is empty, H = ∂(J v)/∂q from row `at` on, with the J in use; false if not known.
  virtual bool add_gradients(const Data &, const Vec &, const Vec &, const Vec &, int, Mat &, Mat &) const { return false; }
  // Add the rows to those that are evaluated in lanes; false if they cannot be.
  virtual bool add_to(LaneTree &, int) const { return false; }
  virtual int size() const = 0;
  virtual bool calls_python() const { return false; }
  virtual double difference_step() const { return INF; }
  // Rows whose force has another direction than W, see SlidingRow: what is added to Gᵀ at `at`, and to ∂f/∂v.
  virtual bool slides() const { return false; }
  virtual void add_friction(const Vec &, int, Mat &) const {}
  virtual void add_turning(const Vec &, const Vec &, int, Mat &) const {}
  virtual void step_ended(const Vec &) {}
  // Whether that direction depends on all multipliers, and takes these.
  virtual bool reacts() const { return false; }
  virtual void react(const Vec &) {}
  // Moves the point of body 1 or 2 between which the rows are, in the axes of its joint; false if there is none.
  virtual bool place(int, const Vector3d &) { return false; }
  // The direction is that of this velocity, of rows evaluated last.
  virtual void aim(const Vec &) {}
};

// Of a joint with these velocities, its body relative to the parent.
inline Six joint_twist(const Model &model, const Data &data, int joint, const Vec &v) {
  Six twist = Six::Zero();
  for (int k = model.idx_vs[joint]; k < model.idx_vs[joint] + model.nvs[joint]; ++k) twist += v[k] * data.J.col(k);
  return twist;
}

// Of a force at x and a moment, or of their rates for constant x.
inline Six wrench_of(const Vector3d &x, const Vector3d &force, const Vector3d &moment = Vector3d::Zero()) {
  Six wrench;
  wrench << force, x.cross(force) + moment;
  return wrench;
}

// The common part of rows between two bodies: a wrench on body 2 and its reaction on body 1, which changes by change(k)
// if coordinate k moves; take(k, rate) receives the change of Σ ± J v.
template <class Change, class Take>
void differentiate(const Data &data, const std::vector<Signed> &columns, const Vec &v, const Six &wrench, const Change &change,
                   const Take &take, Mat &F, bool rates) {
  for (const auto &k : columns) {
    const Six J = data.J.col(k.index), moving = change(k);
    const auto line = J.head<3>(), turn = J.tail<3>();
    Six outer, twist = Six::Zero(), rate;
    outer << turn.cross(wrench.head<3>()), line.cross(wrench.head<3>()) + turn.cross(wrench.tail<3>());
    outer = moving - outer;
    for (const auto &c : columns) {
      const bool carried = c.sign == k.sign && k.joint <= c.joint;
      F(c.index, k.index) += c.sign * data.J.col(c.index).dot(carried ? outer : moving);
      if (carried && rates) twist += v[c.index] * data.J.col(c.index);
    }
    if (!rates) continue;
    rate << turn.cross(twist.head<3>()) + line.cross(twist.tail<3>()), turn.cross(twist.tail<3>());
    take(k, k.sign * rate);
  }
}

// Σ ± J v
inline Six relative_twist(const Data &data, const std::vector<Signed> &columns, const Vec &v) {
  Six twist = Six::Zero();
  for (const auto &c : columns) twist += c.sign * v[c.index] * data.J.col(c.index);
  return twist;
}

inline Vector3d at_point(const Six &twist, const Vector3d &x) { return twist.head<3>() + twist.tail<3>().cross(x); }

class BetweenAnchors : public Rows {
protected:
  BetweenAnchors(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2)
      : joint1_(joint1), joint2_(joint2), place1_(place1), place2_(place2), columns_(columns_between(model, joint1, joint2)) {}

  bool place(int body, const Vector3d &x) override {
    (body == 1 ? place1_ : place2_).translation() = x;
    return true;
  }
  std::vector<std::pair<int, double>> signed_columns() const {
    std::vector<std::pair<int, double>> all;
    for (const auto &column : columns_) all.emplace_back(column.index, column.sign);
    return all;
  }

  int joint1_, joint2_;
  SE3 place1_, place2_;
  std::vector<Signed> columns_;
};

// Fixed combinations of the rows of Pinocchio's constraints between two anchors: (3) position of anchor 2 seen from
// anchor 1, or (6) both parts of the logarithm of its pose.
class AnchoredRows : public BetweenAnchors {
public:
  AnchoredRows(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2, const Mat &matrix)
      : BetweenAnchors(model, joint1, place1, joint2, place2), matrix_(matrix) {}

  void evaluate(const Data &data, double, const Vec &, int at, Vec &phi, Mat &J) const override {
    const SE3 anchor1 = placed(data, joint1_, place1_);
    const Vector3d &x1 = anchor1.translation();
    const int n = size();
    if (matrix_.cols() == 3) {
      const Vector3d x2 = origin(data, joint2_, place2_), gap = x2 - x1;
      for (int i = 0; i < n; ++i) {
        const Vector3d seen = anchor1.rotation() * matrix_.row(i).transpose(), turn = x2.cross(seen);
        phi[at + i] += seen.dot(gap);
        for (const auto &column : columns_) {
          const auto twist = data.J.col(column.index);
          J(at + i, column.index) += column.sign * (seen.dot(twist.head<3>()) + turn.dot(twist.tail<3>()));
        }
      }
      return;
    }
    const SE3 anchor2 = placed(data, joint2_, place2_);
    Eigen::Matrix<double, 6, 6> seen = Eigen::Matrix<double, 6, 6>::Zero();
    seen.topLeftCorner<3, 3>() = seen.bottomRightCorner<3, 3>() = anchor1.rotation().transpose();
    const Eigen::Matrix<double, Eigen::Dynamic, 6, 0, 6, 6> rows = matrix_ * seen;
    phi.segment(at, n).noalias() += matrix_ * pinocchio::log6(anchor1.actInv(anchor2)).toVector();
    for (const auto &column : columns_) {
      Eigen::Matrix<double, 6, 1> twist;
      twist << moved(data, column.index, x1), spin(data, column.index);
      J.col(column.index).segment(at, n).noalias() += rows * (column.sign * twist);
    }
  }

  void add_bias(const Data &data, double, const Vec &, const Vec &, int at, Vec &bias) const override {
    const Moving m1(data, joint1_, place1_), m2(data, joint2_, place2_);
    const Matrix3d to1 = axes(data, joint1_, place1_).transpose();
    const Vector3d seen = to1 * seen_acceleration(m1, m2);
    for (int i = 0; i < size(); ++i) bias[at + i] += matrix_.row(i).head<3>().dot(seen);
    if (matrix_.cols() == 6)
      bias.segment(at, size()) += matrix_.rightCols<3>() * (to1 * (m2.b - m1.b - m1.w.cross(m2.w)));
  }

  bool add_gradients(const Data &data, const Vec &, const Vec &v, const Vec &lam, int at, Mat &F, Mat &H) const override {
    const SE3 anchor1 = placed(data, joint1_, place1_);
    const bool pose = matrix_.cols() == 6;
    const Vector3d x = pose ? anchor1.translation() : origin(data, joint2_, place2_);
    const Matrix3d R = anchor1.rotation();
    const Seen seen = matrix_.transpose().lazyProduct(lam.segment(at, size()));
    const Vector3d f = R * seen.head<3>(), m = pose ? Vector3d(R * seen.tail<3>()) : Vector3d(Vector3d::Zero());
    const Six relative = H.size() ? relative_twist(data, columns_, v) : Six(Six::Zero());
    const Vector3d rate = at_point(relative, x), spin_rate = relative.tail<3>();
    const auto shift = [&](const Signed &k) { return (k.sign > 0.0) != pose ? moved(data, k.index, x) : Vector3d(Vector3d::Zero()); };
    const auto turned = [&](const Signed &k) { return k.sign < 0.0 ? spin(data, k.index) : Vector3d(Vector3d::Zero()); };
    differentiate(
        data, columns_, v, wrench_of(x, f, m),
        [&](const Signed &k) {
          const Vector3d turn = turned(k);
          return wrench_of(x, turn.cross(f), shift(k).cross(f) + turn.cross(m));
        },
        [&](const Signed &k, const Six &change) {
          const Vector3d turn = turned(k);
          const Vector3d own = at_point(change, x) + spin_rate.cross(shift(k)) - turn.cross(rate);
          H.col(k.index).segment(at, size()) += matrix_.leftCols<3>() * (R.transpose() * own);
          if (!pose) return;
          const Vector3d spun = change.tail<3>() - turn.cross(spin_rate);
          H.col(k.index).segment(at, size()) += matrix_.rightCols<3>() * (R.transpose() * spun);
        },
        F, H.size());
    return true;
  }

  void add_wrench(const Data &data, const Vec &lam, const Vector3d &x, Vector3d &force, Vector3d &moment) const override {
    const SE3 anchor1 = placed(data, joint1_, place1_);
    const Seen seen = matrix_.transpose().lazyProduct(lam);
    const bool pose = matrix_.cols() == 6;
    const Vector3d push = anchor1.rotation() * seen.head<3>();
    const Vector3d at = pose ? anchor1.translation() : origin(data, joint2_, place2_);
    force += push;
    moment += (at - x).cross(push);
    if (pose) moment += anchor1.rotation() * seen.tail<3>();
  }

  bool add_to(LaneTree &tree, int at) const override {
    if (matrix_.cols() != 3) return false; // the logarithm of a pose
    for (int i = 0; i < size(); i += 3) { // at most three at a time; those of other parts are zero
      const Mat some = matrix_.middleRows(i, std::min(3, size() - i));
      if (some.isZero(0.0)) continue;
      tree.add_rows(at + i, joint1_, place1_, joint2_, place2_, some, 0.0, signed_columns());
    }
    return true;
  }

  int size() const override { return static_cast<int>(matrix_.rows()); }

private:
  using Seen = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 6, 1>; // of anchor 1
  Mat matrix_;
};

// Rows of the rotation of anchor 2 relative to anchor 1, valid also while the loop is open. They are not stepped on.
class RotationRows : public BetweenAnchors {
protected:
  using BetweenAnchors::BetweenAnchors;

  Matrix3d relative(const Data &data) const {
    return axes(data, joint1_, place1_).transpose() * axes(data, joint2_, place2_);
  }
  // J = G angular, with the derivatives of the rotation of body 2 relative to body 1, in the axes of anchor 1.
  template <class Gradient> void fill(const Data &data, const Gradient &gradient, int at, Mat &J) const {
    const Matrix3d to1 = axes(data, joint1_, place1_).transpose();
    for (const auto &column : columns_)
      J.col(column.index).segment(at, gradient.rows()) = gradient * (to1 * (column.sign * spin(data, column.index)));
  }
  // The spin of body 2 as seen from body 1, and its rate, in the axes of anchor 1.
  std::pair<Vector3d, Vector3d> spinning(const Data &data) const {
    const Moving m1(data, joint1_, place1_), m2(data, joint2_, place2_);
    const Matrix3d to1 = axes(data, joint1_, place1_).transpose();
    return {to1 * (m2.w - m1.w), to1 * (m2.b - m1.b - m1.w.cross(m2.w))};
  }
};

// log R
class TurnRows : public RotationRows {
public:
  TurnRows(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2)
      : RotationRows(model, joint1, place1, joint2, place2) {}

  void evaluate(const Data &data, double, const Vec &, int at, Vec &phi, Mat &J) const override {
    const Matrix3d R = relative(data);
    Matrix3d slope;
    pinocchio::Jlog3(R, slope);
    phi.segment<3>(at) = pinocchio::log3(R);
    fill(data, Matrix3d(slope * R.transpose()), at, J);
  }
  void add_bias(const Data &data, double, const Vec &, const Vec &, int at, Vec &bias) const override { // of closed loops
    bias.segment<3>(at) += spinning(data).second;
  }
  int size() const override { return 3; }
};

// The chord between the axis a = R e of body 2 and e, 2 sin(angle/2), about two directions normal to e.
//
// The chord grows monotonically up to the antiparallel axis, which is therefore not a false solution. Its direction is
// undetermined there; within TURNED of it, Φ and J are those at TURNED.
class TiltRows : public RotationRows {
public:
  static constexpr double TURNED = 1e-6; // rad

  TiltRows(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2, const Vector3d &axis,
           const Mat &directions)
      : RotationRows(model, joint1, place1, joint2, place2), e_(axis), w_(directions) {}

  void evaluate(const Data &data, double, const Vec &, int at, Vec &phi, Mat &J) const override {
    const Vector3d a = relative(data) * e_;
    Eigen::Vector2d tilt = w_ * a;
    double z = 1.0 + e_.dot(a);
    if (z < 0.5) { // no cancellation: |tilt|² = (1 + e·a)(1 − e·a)
      const double size = tilt.norm();
      if (size < TURNED) tilt = size > 0.0 ? Eigen::Vector2d(TURNED / size * tilt) : Eigen::Vector2d(TURNED, 0.0);
      z = tilt.squaredNorm() / (1.0 - e_.dot(a));
    }
    const double s = std::sqrt(2.0 / z);
    const Directions gradient = s * (w_ - tilt * e_.transpose() / (2.0 * z));
    phi.segment<2>(at) = s * tilt;
    fill(data, Directions(-gradient * pinocchio::skew(a)), at, J);
  }
  void add_bias(const Data &data, double, const Vec &, const Vec &, int at, Vec &bias) const override { // of closed loops
    const auto [spin, rate] = spinning(data);
    const Vector3d a = relative(data) * e_;
    bias.segment<2>(at) += w_ * (spin.cross(spin.cross(a)) + rate.cross(a));
  }
  int size() const override { return 2; }

private:
  using Directions = Eigen::Matrix<double, 2, 3>;
  Vector3d e_;
  Directions w_;
};

// (|d|² − L²) / (2 L)
class DistanceRow : public BetweenAnchors {
public:
  DistanceRow(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2, double length)
      : BetweenAnchors(model, joint1, place1, joint2, place2), length_(length) {}

  void evaluate(const Data &data, double, const Vec &, int at, Vec &phi, Mat &J) const override {
    const Vector3d x2 = origin(data, joint2_, place2_), d = x2 - origin(data, joint1_, place1_);
    phi[at] = (d.squaredNorm() - length_ * length_) / (2.0 * length_);
    for (const auto &column : columns_)
      J(at, column.index) = column.sign * d.dot(moved(data, column.index, x2)) / length_;
  }

  void add_bias(const Data &data, double, const Vec &, const Vec &, int at, Vec &bias) const override {
    const Moving m1(data, joint1_, place1_), m2(data, joint2_, place2_);
    const Vector3d r = m2.x - m1.x, rate = m2.v - m1.v;
    bias[at] += (rate - m1.w.cross(r)).squaredNorm() / length_;
    bias[at] += r.dot(seen_acceleration(m1, m2)) / length_;
  }

  bool add_gradients(const Data &data, const Vec &, const Vec &v, const Vec &lam, int at, Mat &F, Mat &H) const override {
    const Vector3d x1 = origin(data, joint1_, place1_), x = origin(data, joint2_, place2_);
    const Vector3d d = x - x1, f = lam[at] / length_ * d;
    const Six relative = H.size() ? relative_twist(data, columns_, v) : Six(Six::Zero());
    const Vector3d rate = at_point(relative, x);
    const auto shift = [&](const Signed &k) { return k.sign > 0.0 ? moved(data, k.index, x) : Vector3d(Vector3d::Zero()); };
    const auto stretch = [&](const Signed &k) { return Vector3d(k.sign * moved(data, k.index, k.sign > 0.0 ? x : x1)); };
    differentiate(
        data, columns_, v, wrench_of(x, f),
        [&](const Signed &k) { return wrench_of(x, lam[at] / length_ * stretch(k), shift(k).cross(f)); },
        [&](const Signed &k, const Six &change) {
          const Vector3d own = at_point(change, x) + relative.tail<3>().cross(shift(k));
          H(at, k.index) += (stretch(k).dot(rate) + d.dot(own)) / length_;
        },
        F, H.size());
    return true;
  }

  void add_wrench(const Data &data, const Vec &lam, const Vector3d &, Vector3d &force, Vector3d &) const override {
    force += lam[0] / length_ * (origin(data, joint2_, place2_) - origin(data, joint1_, place1_));
  }

  bool add_to(LaneTree &tree, int at) const override {
    tree.add_rows(at, joint1_, place1_, joint2_, place2_, Eigen::Matrix<double, 1, 3>::Zero(), length_, signed_columns());
    return true;
  }

  int size() const override { return 1; }

private:
  double length_;
};

// q_joint − curve(t)
class DriveRow : public Rows {
public:
  DriveRow(Coordinate joint, double period, Curve curve) : joint_(joint), period_(period), curve_(std::move(curve)) {}

  void evaluate(const Data &, double t, const Vec &p, int at, Vec &phi, Mat &J) const override {
    phi[at] = nearest(joint_.value(p) - curve_(t), period_);
    J(at, joint_.column) = 1.0;
  }
  void add_rate(double t, const Vec &, int at, Vec &rate) const override { rate[at] -= curve_.rate(t); }
  void add_bias(const Data &, double t, const Vec &, const Vec &, int at, Vec &bias) const override {
    bias[at] -= curve_.acceleration(t);
  }
  bool add_gradients(const Data &, const Vec &, const Vec &, const Vec &, int, Mat &, Mat &) const override { return true; }
  int size() const override { return 1; }
  bool calls_python() const override { return curve_.calls_python(); }

private:
  Coordinate joint_;
  double period_;
  Curve curve_;
};

// Σ share · q of some joints
struct Sum {
  std::vector<Coordinate> joints;
  std::vector<double> shares;

  double value(const Vec &p) const {
    double sum = 0.0;
    for (size_t i = 0; i < joints.size(); ++i) sum += shares[i] * joints[i].value(p);
    return sum;
  }
  double speed(const Vec &v) const {
    double sum = 0.0;
    for (size_t i = 0; i < joints.size(); ++i) sum += shares[i] * v[joints[i].column];
    return sum;
  }
  void add(double slope, int row, Mat &J) const {
    for (size_t i = 0; i < joints.size(); ++i) J(row, joints[i].column) += slope * shares[i];
  }
};

// q_joint − Σ law[i] q_otherⁱ, where each q is a sum of joints
class CouplingRow : public Rows {
public:
  CouplingRow(Sum joint, Sum other, double period, Vec law)
      : joint_(std::move(joint)), other_(std::move(other)), period_(period), law_(std::move(law)) {}

  void evaluate(const Data &, double, const Vec &p, int at, Vec &phi, Mat &J) const override {
    const double x = other_.value(p);
    double value = 0.0, slope = 0.0;
    for (Eigen::Index i = law_.size(); i-- > 0;) {
      slope = slope * x + value;
      value = value * x + law_[i];
    }
    phi[at] = nearest(joint_.value(p) - value, period_);
    joint_.add(1.0, at, J);
    other_.add(-slope, at, J);
  }
  void add_bias(const Data &, double, const Vec &p, const Vec &v, int at, Vec &bias) const override {
    const double rate = other_.speed(v);
    bias[at] -= bend(p) * rate * rate;
  }
  bool add_gradients(const Data &, const Vec &p, const Vec &v, const Vec &lam, int at, Mat &F, Mat &H) const override {
    const double bent = bend(p);
    for (size_t i = 0; i < other_.joints.size(); ++i) other_.add(-lam[at] * bent * other_.shares[i], other_.joints[i].column, F);
    if (H.size()) other_.add(-bent * other_.speed(v), at, H);
    return true;
  }
  int size() const override { return 1; }

private:
  double bend(const Vec &p) const {
    const double x = other_.value(p);
    double bend = 0.0;
    for (Eigen::Index i = law_.size(); i-- > 2;) bend = bend * x + static_cast<double>(i * (i - 1)) * law_[i];
    return bend;
  }

  Sum joint_, other_;
  double period_;
  Vec law_;
};

// Rows that are implemented in Python: the function is called with new arrays.
class PythonRows : public Rows {
public:
  PythonRows(nb::object closure, std::vector<int> local, bool moving, double difference_step)
      : closure_(std::move(closure)), local_(std::move(local)), moving_(moving), difference_step_(difference_step) {}

  void evaluate(const Data &, double t, const Vec &p, int at, Vec &phi, Mat &J) const override {
    const auto both = nb::cast<std::pair<Vec, Mat>>(ask(closure_, "evaluate", p, t));
    if (both.first.size() <= local_.back() || both.second.rows() <= local_.back() || both.second.cols() != J.cols())
      throw nb::value_error("rows of another size");
    for (size_t i = 0; i < local_.size(); ++i) {
      phi[at + i] = both.first[local_[i]];
      J.row(at + i) = both.second.row(local_[i]);
    }
  }
  void add_rate(double t, const Vec &p, int at, Vec &rate) const override {
    if (!moving_) return;
    const auto all = nb::cast<Vec>(ask(closure_, "rate", t, p));
    if (all.size() <= local_.back()) throw nb::value_error("rates of another size");
    for (size_t i = 0; i < local_.size(); ++i) rate[at + i] += all[local_[i]];
  }
  void add_bias(const Data &, double t, const Vec &p, const Vec &v, int at, Vec &bias) const override {
    const auto all = nb::cast<Vec>(ask(closure_, "acceleration_bias", t, p, v));
    if (all.size() <= local_.back()) throw nb::value_error("a bias of another size");
    for (size_t i = 0; i < local_.size(); ++i) bias[at + i] += all[local_[i]];
  }
  int size() const override { return static_cast<int>(local_.size()); }
  bool calls_python() const override { return true; }
  double difference_step() const override { return difference_step_; }

private:
  nb::object closure_;
  std::vector<int> local_;
  bool moving_;
  double difference_step_;
};

} // namespace pinconsist
