// The same as KeptRows in mechanism/rows.py: Φ and J of the kept rows, near closed configurations.
#pragma once

#include "rigid_bodies.hpp"

namespace pinconsist {

struct Rows {
  virtual ~Rows() = default;
  // Fill Φ and J from row `at` on; J is zero there. Joint Jacobians have been computed at p.
  virtual void evaluate(const Data &data, double t, const Vec &p, int at, Vec &phi, Mat &J) const = 0;
  // Add Φ_t from row `at` on.
  virtual void add_rate(double, const Vec &, int, Vec &) const {}
  // Write J̇ v and the like from row `at` on (add, where parts add up); forward kinematics have been computed.
  virtual void add_bias(const Data &data, double t, const Vec &p, const Vec &v, int at, Vec &bias) const = 0;
  // Add force and moment about x on the second body, of rows between two anchors, in world axes.
  virtual void add_wrench(const Data &, const Vec &, const Vector3d &, Vector3d &, Vector3d &) const {}
  virtual int size() const = 0;
  virtual bool calls_python() const { return false; }
};

// Fixed combinations of the rows of Pinocchio's constraints between two anchors: (3) position of anchor 2 seen from
// anchor 1, or (6) both parts of the logarithm of its pose.
class AnchoredRows : public Rows {
public:
  AnchoredRows(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2, const Mat &matrix)
      : joint1_(joint1), joint2_(joint2), place1_(place1), place2_(place2), matrix_(matrix),
        columns_(columns_between(model, joint1, joint2)) {}

  void evaluate(const Data &data, double, const Vec &, int at, Vec &phi, Mat &J) const override {
    const SE3 anchor1 = placed(data, joint1_, place1_), anchor2 = placed(data, joint2_, place2_);
    const Vector3d &x1 = anchor1.translation(), &x2 = anchor2.translation();
    const int n = size();
    if (matrix_.cols() == 3) {
      const Eigen::Matrix<double, Eigen::Dynamic, 3, 0, 6, 3> seen = matrix_ * anchor1.rotation().transpose();
      phi.segment(at, n).noalias() += seen * (x2 - x1);
      for (const auto &column : columns_)
        J.col(column.index).segment(at, n).noalias() += seen * (column.sign * moved(data, column.index, x2));
      return;
    }
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
    bias.segment(at, size()) += matrix_.leftCols<3>() * seen_acceleration(m1, m2);
    if (matrix_.cols() == 6)
      bias.segment(at, size()) += matrix_.rightCols<3>() * (m1.R.transpose() * (m2.b - m1.b - m1.w.cross(m2.w)));
  }

  void add_wrench(const Data &data, const Vec &lam, const Vector3d &x, Vector3d &force, Vector3d &moment) const override {
    const SE3 anchor1 = placed(data, joint1_, place1_);
    const Vec seen = matrix_.transpose() * lam;
    const bool pose = matrix_.cols() == 6;
    const Vector3d push = anchor1.rotation() * seen.head<3>();
    const Vector3d at = pose ? anchor1.translation() : placed(data, joint2_, place2_).translation();
    force += push;
    moment += (at - x).cross(push);
    if (pose) moment += anchor1.rotation() * seen.tail<3>();
  }

  int size() const override { return static_cast<int>(matrix_.rows()); }

private:
  int joint1_, joint2_;
  SE3 place1_, place2_;
  Mat matrix_;
  std::vector<Signed> columns_;
};

// (|d|² − L²) / (2 L)
class DistanceRow : public Rows {
public:
  DistanceRow(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2, double length)
      : joint1_(joint1), joint2_(joint2), place1_(place1), place2_(place2), length_(length),
        columns_(columns_between(model, joint1, joint2)) {}

  void evaluate(const Data &data, double, const Vec &, int at, Vec &phi, Mat &J) const override {
    const Vector3d x2 = placed(data, joint2_, place2_).translation();
    const Vector3d d = x2 - placed(data, joint1_, place1_).translation();
    phi[at] = (d.squaredNorm() - length_ * length_) / (2.0 * length_);
    for (const auto &column : columns_)
      J(at, column.index) = column.sign * d.dot(moved(data, column.index, x2)) / length_;
  }

  void add_bias(const Data &data, double, const Vec &, const Vec &, int at, Vec &bias) const override {
    const Moving m1(data, joint1_, place1_), m2(data, joint2_, place2_);
    const Vector3d r = m2.x - m1.x, rate = m2.v - m1.v;
    bias[at] += (rate - m1.w.cross(r)).squaredNorm() / length_;
    bias[at] += (m1.R.transpose() * r).dot(seen_acceleration(m1, m2)) / length_;
  }

  void add_wrench(const Data &data, const Vec &lam, const Vector3d &, Vector3d &force, Vector3d &) const override {
    force += lam[0] / length_ * (placed(data, joint2_, place2_).translation() - placed(data, joint1_, place1_).translation());
  }

  int size() const override { return 1; }

private:
  int joint1_, joint2_;
  SE3 place1_, place2_;
  double length_;
  std::vector<Signed> columns_;
};

// q_joint − curve(t)
class DriveRow : public Rows {
public:
  DriveRow(Coordinate joint, double period, Motion curve) : joint_(joint), period_(period), curve_(curve) {}

  void evaluate(const Data &, double t, const Vec &p, int at, Vec &phi, Mat &J) const override {
    phi[at] = nearest(joint_.value(p) - curve_(t), period_);
    J(at, joint_.column) = 1.0;
  }
  void add_rate(double t, const Vec &, int at, Vec &rate) const override { rate[at] -= curve_.rate(t); }
  void add_bias(const Data &, double t, const Vec &, const Vec &, int at, Vec &bias) const override {
    bias[at] -= curve_.acceleration(t);
  }
  int size() const override { return 1; }

private:
  Coordinate joint_;
  double period_;
  Motion curve_;
};

// q_joint − Σ law[i] q_otherⁱ
class CouplingRow : public Rows {
public:
  CouplingRow(Coordinate joint, Coordinate other, double period, Vec law)
      : joint_(joint), other_(other), period_(period), law_(std::move(law)) {}

  void evaluate(const Data &, double, const Vec &p, int at, Vec &phi, Mat &J) const override {
    const double x = other_.value(p);
    double value = 0.0, slope = 0.0;
    for (Eigen::Index i = law_.size(); i-- > 0;) {
      slope = slope * x + value;
      value = value * x + law_[i];
    }
    phi[at] = nearest(joint_.value(p) - value, period_);
    J(at, joint_.column) = 1.0;
    J(at, other_.column) = -slope;
  }
  void add_bias(const Data &, double, const Vec &p, const Vec &v, int at, Vec &bias) const override {
    const double x = other_.value(p), rate = v[other_.column];
    double bend = 0.0;
    for (Eigen::Index i = law_.size(); i-- > 2;) bend = bend * x + static_cast<double>(i * (i - 1)) * law_[i];
    bias[at] -= bend * rate * rate;
  }
  int size() const override { return 1; }

private:
  Coordinate joint_, other_;
  double period_;
  Vec law_;
};

// Rows that only Python knows: its own closure is asked, with fresh arrays.
class PythonRows : public Rows {
public:
  PythonRows(nb::object closure, nb::object data, std::vector<int> local, bool moving)
      : closure_(std::move(closure)), data_(std::move(data)), local_(std::move(local)), moving_(moving) {}

  void evaluate(const Data &, double t, const Vec &p, int at, Vec &phi, Mat &J) const override {
    const auto both = nb::cast<std::pair<Vec, Mat>>(ask(closure_, "evaluate", data_, p, t));
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
    const auto all = nb::cast<Vec>(ask(closure_, "acceleration_bias", data_, t, p, v));
    if (all.size() <= local_.back()) throw nb::value_error("a bias of another size");
    for (size_t i = 0; i < local_.size(); ++i) bias[at + i] += all[local_[i]];
  }
  int size() const override { return static_cast<int>(local_.size()); }
  bool calls_python() const override { return true; }

private:
  nb::object closure_, data_;
  std::vector<int> local_;
  bool moving_;
};

} // namespace pinconsist
