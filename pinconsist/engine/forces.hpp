// The laws of forces: joint torques τ, their derivatives, and what they exert on bodies.
#pragma once

#include "axes.hpp"
#include "state_lanes.hpp"

#include <algorithm>
#include <memory>
#include <nanobind/stl/pair.h>
#include <vector>

namespace pinconsist {

// Force and moment at a point of a joint's body, in world axes.
struct Load {
  int joint;
  Vector3d x, f, m;
};

struct Force {
  virtual ~Force() = default;
  // If a force is `on_bodies`, joint Jacobians must have been computed at q.
  virtual void add_torque(const Data &data, double t, const Vec &q, const Vec &v, Vec &tau) const = 0;
  // D -= ∂τ/∂v, K -= ∂τ/∂q
  virtual void linearize(const Data &, double, const Vec &, const Vec &, Mat &, Mat &) const {}
  // Add it to those that are evaluated in lanes; false if it cannot be.
  virtual bool add_to(LaneTree &) const { return false; }
  // Elastic energy and its rate, of springs.
  virtual std::pair<double, double> stored(const Data &, const Vec &, const Vec &) const { return {0.0, 0.0}; }
  // What it exerts on each body, if it acts on points of bodies.
  virtual void add_loads(const Data &, double, const Vec &, std::vector<Load> &) const {}
  // Force, length and speed, if it has a length.
  virtual Vector3d along(const Data &, double, const Vec &, const Vec &) const { return Vector3d::Zero(); }
  // Whether its command or force is cut at a limit.
  virtual bool limited(double, const Vec &, const Vec &) const { return false; }
  virtual bool on_bodies() const { return false; }
  virtual bool calls_python() const { return false; }
  // Fill in narrow ranges about zero velocity over which it changes quickly.
  virtual void narrow(Vec &) const {}
  // Whether it may bend or jump within a step; then it uses t, q and v only.
  virtual bool sharp() const { return false; }
  // A number by its name in the record; null where it cannot be changed.
  virtual double *number(const std::string &) { return nullptr; }
};

// τ = -f tanh(v / width)
class SmoothFriction : public Force {
public:
  SmoothFriction(Vec coefficients, double width) : coefficients_(std::move(coefficients)), width_(width) {}

  void add_torque(const Data &, double, const Vec &, const Vec &v, Vec &tau) const override {
    for (Eigen::Index i = 0; i < v.size(); ++i) tau[i] -= coefficients_[i] * std::tanh(v[i] / width_);
  }
  void linearize(const Data &, double, const Vec &, const Vec &v, Mat &D, Mat &) const override {
    for (Eigen::Index i = 0; i < v.size(); ++i) {
      const double sech = 1.0 / std::cosh(std::min(std::abs(v[i]) / width_, 300.0));
      D(i, i) += coefficients_[i] * sech * sech / width_;
    }
  }
  void narrow(Vec &widths) const override {
    if (!widths.size()) widths.setConstant(coefficients_.size(), INF);
    for (Eigen::Index i = 0; i < widths.size(); ++i)
      if (coefficients_[i] > 0.0) widths[i] = std::min(widths[i], width_);
  }
  bool sharp() const override { return true; }

private:
  Vec coefficients_;
  double width_;
};

// τ = k (target(t) - θ) + d (target'(t) - θ')
class Servo : public Force {
public:
  Servo(Coordinate joint, double period, Curve target, double stiffness, double damping)
      : joint_(joint), period_(period), target_(std::move(target)), stiffness_(stiffness), damping_(damping) {}

  void add_torque(const Data &, double t, const Vec &q, const Vec &v, Vec &tau) const override {
    tau[joint_.column] += stiffness_ * beyond(t, q);
    if (damping_ != 0.0) tau[joint_.column] += damping_ * (target_.rate(t) - v[joint_.column]);
  }
  void linearize(const Data &, double, const Vec &, const Vec &, Mat &D, Mat &K) const override {
    D(joint_.column, joint_.column) += damping_;
    K(joint_.column, joint_.column) += stiffness_;
  }
  double *number(const std::string &name) override {
    return name == "stiffness" ? &stiffness_ : name == "damping" ? &damping_ : nullptr;
  }
  bool calls_python() const override { return target_.calls_python(); }
  bool sharp() const override { return calls_python(); }

protected:
  double beyond(double t, const Vec &q) const { return nearest(target_(t) - joint_.value(q), period_); }

  Coordinate joint_;
  double period_;
  Curve target_;
  double stiffness_, damping_;
};

// A servo at rest, which stores energy.
class JointSpring : public Servo {
public:
  JointSpring(Coordinate joint, double period, double rest, double stiffness, double damping)
      : Servo(joint, period, Motion{rest}, stiffness, damping) {}

  std::pair<double, double> stored(const Data &, const Vec &q, const Vec &v) const override {
    const double load = -stiffness_ * beyond(0.0, q);
    return {-0.5 * load * beyond(0.0, q), load * v[joint_.column]};
  }
};

class TorqueCurve : public Force {
public:
  TorqueCurve(int column, Curve curve) : column_(column), curve_(std::move(curve)) {}

  void add_torque(const Data &, double t, const Vec &, const Vec &, Vec &tau) const override { tau[column_] += curve_(t); }
  bool calls_python() const override { return curve_.calls_python(); }
  bool sharp() const override { return calls_python(); }

private:
  int column_;
  Curve curve_;
};

// Torques of a joint with several velocities, by a function in Python.
class TimeTorque : public Force {
public:
  TimeTorque(int column, int size, nb::object function) : column_(column), size_(size), function_(std::move(function)) {}

  void add_torque(const Data &, double t, const Vec &, const Vec &, Vec &tau) const override {
    const auto torque = nb::cast<Vec>(function_(t));
    if (torque.size() != size_) throw nb::value_error("a torque of another size");
    tau.segment(column_, size_) += torque;
  }
  bool calls_python() const override { return true; }
  bool sharp() const override { return true; }

private:
  int column_, size_;
  nb::object function_;
};

// Torques that are held from one time to the next, in the direction of the run, or interpolated linearly; see
// mechanism/forces/held.py.
struct HeldTable {
  static constexpr double BEHIND = 2.5e-14; // relative to a time or 1 s: a later time is behind; see mechanism/forces/held.py
  double sign = 1.0;
  bool linear = false;
  std::vector<double> since; // times sign
  std::vector<Vec> torques;
  size_t entered = 0; // number of entries in use
  // On the steps of a run that is over, all are in use, each behind its time; the first `begun` from the start of the run.
  bool on_steps = false;
  size_t begun = 0;

  void clear(double new_sign) {
    sign = new_sign;
    since.clear();
    torques.clear();
    entered = 0;
    on_steps = false;
  }
  void hold(double t, const Vec &torque) {
    since.push_back(sign * t);
    torques.push_back(torque);
    entered = since.size();
  }
  // The torque held at a time; null before the first entry.
  const Vec *at(double t) const {
    const size_t i = reached(t);
    return i ? &torques[i - 1] : nullptr;
  }
  // False before the first entry.
  bool add(double t, Vec &tau) const {
    const size_t i = reached(t);
    if (!i) return false;
    tau += torques[i - 1];
    if (linear && i < since.size())
      tau += (sign * t - since[i - 1]) / (since[i] - since[i - 1]) * (torques[i] - torques[i - 1]);
    return true;
  }

  // The number of entries in use up to a time.
  size_t reached(double t) const {
    if (on_steps) {
      const double before = sign * t - BEHIND * std::max(1.0, std::abs(t));
      return std::max<size_t>(begun, std::upper_bound(since.begin(), since.end(), before) - since.begin());
    }
    if (!entered || sign * t >= since[entered - 1]) return entered;
    return std::upper_bound(since.begin(), since.begin() + entered, sign * t) - since.begin();
  }
};

class HeldTorque : public Force {
public:
  explicit HeldTorque(std::shared_ptr<HeldTable> table) : table_(std::move(table)) {}

  void add_torque(const Data &, double t, const Vec &, const Vec &, Vec &tau) const override { table_->add(t, tau); }

private:
  std::shared_ptr<HeldTable> table_;
};

// τ = arms f, f = gain·(1, l, l') u + bias·(1, l, l'), l = arms·θ; command u and force f are cut at their limits
class Actuator : public Force {
public:
  struct Law {
    Vector3d gain, bias;
    std::pair<double, double> control, force;
  };
  // The command: a held value, else a linearly interpolated table, else a curve.
  struct Command {
    Curve curve;
    std::vector<double> times, values;
    std::shared_ptr<HeldTable> held;

    double operator()(double t) const {
      if (const Vec *entry = held ? held->at(t) : nullptr) return (*entry)[0];
      if (times.empty()) return curve(t);
      const size_t i = std::upper_bound(times.begin(), times.end(), t) - times.begin();
      if (i == 0 || i == times.size()) return i ? values.back() : values.front();
      return values[i - 1] + (values[i] - values[i - 1]) / (times[i] - times[i - 1]) * (t - times[i - 1]);
    }
  };

  Actuator(std::vector<Coordinate> joints, Vec arms, Law law, Command command)
      : joints_(std::move(joints)), arms_(std::move(arms)), law_(std::move(law)), command_(std::move(command)) {}

  void add_torque(const Data &, double t, const Vec &q, const Vec &v, Vec &tau) const override {
    const double force = cut(evaluate(t, q, v).first);
    for (size_t i = 0; i < joints_.size(); ++i) tau[joints_[i].column] += arms_[i] * force;
  }
  void linearize(const Data &, double t, const Vec &q, const Vec &v, Mat &D, Mat &K) const override {
    const auto [force, numbers] = evaluate(t, q, v);
    if (!(law_.force.first <= force && force <= law_.force.second)) return;
    for (size_t i = 0; i < joints_.size(); ++i)
      for (size_t j = 0; j < joints_.size(); ++j) {
        K(joints_[i].column, joints_[j].column) -= arms_[i] * arms_[j] * numbers[1];
        D(joints_[i].column, joints_[j].column) -= arms_[i] * arms_[j] * numbers[2];
      }
  }
  Vector3d along(const Data &, double t, const Vec &q, const Vec &v) const override {
    const auto [length, speed] = move(q, v);
    return {cut(evaluate(t, q, v).first), length, speed};
  }
  bool limited(double t, const Vec &q, const Vec &v) const override {
    const double command = command_(t), force = evaluate(t, q, v).first;
    return command != std::clamp(command, law_.control.first, law_.control.second) || force != cut(force);
  }
  bool calls_python() const override { return command_.curve.calls_python(); }
  bool sharp() const override { return true; }

private:
  double cut(double force) const { return std::clamp(force, law_.force.first, law_.force.second); }

  // Its length and speed.
  std::pair<double, double> move(const Vec &q, const Vec &v) const {
    double length = 0.0, speed = 0.0;
    for (size_t i = 0; i < joints_.size(); ++i) {
      length += arms_[i] * joints_[i].value(q);
      speed += arms_[i] * v[joints_[i].column];
    }
    return {length, speed};
  }

  // The force before it is cut: its constant, and its coefficients of l and l'.
  std::pair<double, Vector3d> evaluate(double t, const Vec &q, const Vec &v) const {
    const auto [length, speed] = move(q, v);
    const Vector3d numbers = law_.gain * std::clamp(command_(t), law_.control.first, law_.control.second) + law_.bias;
    return {numbers[0] + length * numbers[1] + speed * numbers[2], numbers};
  }

  std::vector<Coordinate> joints_;
  Vec arms_;
  Law law_;
  Command command_;
};

// Tension k (l - l0) + d dl/dt along the line between two points. Joints that carry both points change nothing.
class SpringDamper : public Force {
public:
  SpringDamper(const Model &model, const TurningAxes &axes, int joint1, const Vector3d &x1, int joint2, const Vector3d &x2, double stiffness,
               double length, double damping, double shortest)
      : axes_(axes), joint1_(joint1), joint2_(joint2), place1_(Matrix3d::Identity(), x1), place2_(Matrix3d::Identity(), x2),
        stiffness_(stiffness), length_(length), damping_(damping), shortest_(shortest),
        columns_(columns_between(model, joint1, joint2)), moves_(3, columns_.size()), spins_(3, columns_.size()),
        along_(columns_.size()), bend_(columns_.size(), columns_.size()) {}

  void add_torque(const Data &data, double, const Vec &, const Vec &v, Vec &tau) const override {
    const double tension = line(data, v);
    for (size_t i = 0; i < columns_.size(); ++i) tau[columns_[i].index] -= tension * along_[i];
  }

  void linearize(const Data &data, double, const Vec &, const Vec &v, Mat &D, Mat &K) const override {
    const double tension = line(data, v);
    const int n = static_cast<int>(columns_.size());
    for (int i = 0; i < n; ++i) // ∂²l/∂q²
      for (int j = 0; j < n; ++j) {
        bend_(i, j) = (moves_.col(i).dot(moves_.col(j)) - along_[i] * along_[j]) / l_;
        if (columns_[i].sign != columns_[j].sign) continue;
        const int before = columns_[j].joint <= columns_[i].joint ? j : i, after = before == j ? i : j;
        bend_(i, j) += u_.dot(spins_.col(before).cross(moves_.col(after)));
        if (columns_[i].joint == columns_[j].joint && !axes_.empty())
          bend_(i, j) += columns_[i].sign * u_.dot(moved(axes_.change(columns_[i].index, columns_[j].index), end(columns_[i].sign)));
      }
    for (int j = 0; j < n; ++j) {
      double turning = 0.0;
      for (int i = 0; i < n; ++i) turning += v[columns_[i].index] * bend_(i, j);
      for (int i = 0; i < n; ++i) {
        const double by_q = stiffness_ * along_[i] * along_[j] + tension * bend_(i, j) + damping_ * along_[i] * turning;
        D(columns_[i].index, columns_[j].index) += damping_ * along_[i] * along_[j];
        K(columns_[i].index, columns_[j].index) += by_q;
      }
    }
  }

  bool add_to(LaneTree &tree) const override {
    std::vector<std::pair<int, double>> columns;
    std::vector<int> joints;
    for (const auto &column : columns_) {
      columns.emplace_back(column.index, column.sign);
      joints.push_back(column.joint);
    }
    tree.add_spring(joint1_, place1_.translation(), joint2_, place2_.translation(), stiffness_, length_, damping_, shortest_, columns, joints);
    return true;
  }

  std::pair<double, double> stored(const Data &data, const Vec &, const Vec &v) const override {
    line(data, v);
    const double load = stiffness_ * (l_ - length_);
    return {0.5 * load * (l_ - length_), load * speed_};
  }
  void add_loads(const Data &data, double, const Vec &v, std::vector<Load> &loads) const override {
    const Vector3d pull = line(data, v) * u_;
    loads.push_back({joint1_, x1_, pull, Vector3d::Zero()});
    loads.push_back({joint2_, x2_, -pull, Vector3d::Zero()});
  }
  Vector3d along(const Data &data, double, const Vec &, const Vec &v) const override {
    const double tension = line(data, v);
    return {tension, l_, speed_};
  }
  bool on_bodies() const override { return true; }
  double *number(const std::string &name) override {
    return name == "stiffness" ? &stiffness_ : name == "damping" ? &damping_ : name == "length" ? &length_ : nullptr;
  }

private:
  // Fills length, speed, direction, columns of the relative velocity; returns the tension.
  double line(const Data &data, const Vec &v) const {
    x1_ = origin(data, joint1_, place1_);
    x2_ = origin(data, joint2_, place2_);
    const Vector3d r = x2_ - x1_;
    l_ = std::sqrt(r.squaredNorm() + shortest_ * shortest_);
    u_ = r / l_;
    speed_ = 0.0;
    for (size_t i = 0; i < columns_.size(); ++i) {
      const auto &column = columns_[i];
      moves_.col(i) = column.sign * moved(data, column.index, end(column.sign));
      spins_.col(i) = spin(data, column.index);
      along_[i] = u_.dot(moves_.col(i));
      speed_ += along_[i] * v[column.index];
    }
    return stiffness_ * (l_ - length_) + damping_ * speed_;
  }

  const Vector3d &end(double sign) const { return sign > 0 ? x2_ : x1_; }

  const TurningAxes &axes_;
  int joint1_, joint2_;
  SE3 place1_, place2_;
  double stiffness_, length_, damping_, shortest_;
  std::vector<Signed> columns_;
  mutable Eigen::Matrix3Xd moves_, spins_;
  mutable Vec along_;
  mutable Mat bend_;
  mutable Vector3d u_, x1_, x2_;
  mutable double l_ = 0.0, speed_ = 0.0;
};

// A force and moment at a frame of a body, in world axes or (local) in those of the frame.
class Wrench : public Force {
public:
  Wrench(const Model &model, const TurningAxes &axes, int joint, const SE3 &frame, VectorCurve force, VectorCurve moment, bool local)
      : axes_(axes), joint_(joint), frame_(frame), force_(std::move(force)), moment_(std::move(moment)), local_(local),
        columns_(columns_of(model, joint)) {}

  void add_torque(const Data &data, double t, const Vec &, const Vec &, Vec &tau) const override {
    const auto [joint, x, f, m] = in_world(data, t);
    for (const auto &column : columns_)
      tau[column.index] += f.dot(moved(data, column.index, x)) + m.dot(spin(data, column.index));
  }

  void linearize(const Data &data, double t, const Vec &, const Vec &, Mat &, Mat &K) const override {
    const auto [joint, x, f, m] = in_world(data, t);
    for (const auto &row : columns_)
      for (const auto &column : columns_) { // ∂τ_row/∂q_column
        const Vector3d turn = spin(data, column.index), spun = spin(data, row.index);
        double change = 0.0;
        if (column.joint > row.joint) {
          change = f.dot(spun.cross(moved(data, column.index, x)));
          if (local_) change += moved(data, row.index, x).dot(turn.cross(f)) + spun.dot(turn.cross(m));
        } else if (!local_) {
          change = f.dot(turn.cross(moved(data, row.index, x))) + m.dot(turn.cross(spun));
        }
        if (column.joint == row.joint && !axes_.empty()) {
          const Six bent = axes_.change(row.index, column.index);
          change += f.dot(moved(bent, x)) + m.dot(bent.tail<3>());
        }
        K(row.index, column.index) -= change;
      }
  }
  void add_loads(const Data &data, double t, const Vec &, std::vector<Load> &loads) const override {
    loads.push_back(in_world(data, t));
  }
  bool on_bodies() const override { return true; }
  bool calls_python() const override { return force_.calls_python() || moment_.calls_python(); }
  bool sharp() const override { return calls_python(); }

private:
  Load in_world(const Data &data, double t) const {
    const SE3 pose = placed(data, joint_, frame_);
    const Matrix3d turn = local_ ? Matrix3d(pose.rotation()) : Matrix3d::Identity();
    return {joint_, pose.translation(), turn * force_(t), turn * moment_(t)};
  }

  const TurningAxes &axes_;
  int joint_;
  SE3 frame_;
  VectorCurve force_, moment_;
  bool local_;
  std::vector<Column> columns_;
};

// A law that is implemented in Python, called with new arrays.
class PythonForce : public Force {
public:
  explicit PythonForce(nb::object law)
      : law_(std::move(law)), smooth_(nb::cast<bool>(law_.attr("smooth"))), stores_(nb::cast<bool>(law_.attr("stores"))) {}

  void add_torque(const Data &, double t, const Vec &q, const Vec &v, Vec &tau) const override {
    const auto torque = nb::cast<Vec>(ask(law_, "torque", t, q, v));
    if (torque.size() != tau.size()) throw nb::value_error("a torque of another size");
    tau += torque;
  }
  void linearize(const Data &, double t, const Vec &q, const Vec &v, Mat &D, Mat &K) const override {
    const auto parts = nb::cast<std::pair<nb::object, nb::object>>(ask(law_, "derivatives", t, q, v));
    subtract(parts.second, D);
    subtract(parts.first, K);
  }
  std::pair<double, double> stored(const Data &, const Vec &q, const Vec &v) const override {
    if (!stores_) return {0.0, 0.0};
    return nb::cast<std::pair<double, double>>(ask(law_, "stored", q, v));
  }
  bool calls_python() const override { return true; }
  bool sharp() const override { return !smooth_; }

private:
  static void subtract(const nb::object &matrix, Mat &A) {
    if (matrix.is_none()) return;
    const auto part = nb::cast<Mat>(matrix);
    if (part.rows() != A.rows() || part.cols() != A.cols()) throw nb::value_error("derivatives of another size");
    A -= part;
  }

  nb::object law_;
  bool smooth_, stores_;
};

} // namespace pinconsist
