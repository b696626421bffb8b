// run/known.py: the known derivatives of f by many parameters.
#pragma once

#include "linear.hpp"
#include "mechanism.hpp"

#include <map>

namespace pinconsist {

// For parameters of bodies, gravity and forces, a column each. Forces added before `close` are those of one parameter.
class Rates : public MechanismSystem, public Known {
public:
  using MechanismSystem::MechanismSystem;

  bool calls_python() const override { return MechanismSystem::calls_python(); }

  // `numbers`: rates of the mass, mass times its centre, and inertia about the joint (xx, xy, yy, xz, yz, zz).
  void add_inertia(int column, double weight, int joint, const Vec &numbers) {
    Body body{column, joint, weight * numbers[0], weight * numbers.segment<3>(1), Matrix3d::Zero()};
    body.inertia << numbers[4], numbers[5], numbers[7], numbers[5], numbers[6], numbers[8], numbers[7], numbers[8], numbers[9];
    body.inertia *= weight;
    bodies_.push_back(body);
  }
  void add_gravity(int column, double weight, const Vector3d &rate) { gravities_.push_back({column, weight * rate}); }
  // Uses the forces added last, with a weight, as one side of the difference for a key; a table has many columns, one for
  // each node.
  void close(int key, double weight) {
    pulls_[key].sides.push_back({weight, std::move(forces_), constant_, damping_});
    forces_.clear();
    constant_.setZero();
    damping_.setZero();
  }
  void set_times(int key, std::vector<double> times) { pulls_[key].times = std::move(times); }
  void set_held(int key, std::shared_ptr<HeldTable> table) { pulls_[key].held = std::move(table); }
  void act(int key, const std::vector<int> &nodes, const std::vector<int> &columns) {
    auto &all = pulls_[key].columns;
    for (size_t i = 0; i < nodes.size(); ++i) {
      all.resize(std::max<size_t>(all.size(), nodes[i] + 1), -1);
      all[nodes[i]] = columns[i];
    }
  }

  void add_columns(double t, const Vec &p, const Vec &v, const Vec &a, Eigen::Ref<Mat> r) override {
    visit(
        t, p, v, a,
        [&](int column, int body, const pinocchio::Force &force) {
          const auto there = data_.oMi[body].act(force).toVector();
          for (int j = body; j > 0; j = model_.parents[j]) {
            const int first = model_.idx_vs[j], n = model_.nvs[j];
            r.col(column).segment(first, n) += data_.J.middleCols(first, n).transpose() * there;
          }
        },
        [&](int column, double weight) { r.col(column) -= weight * pull_; });
  }
  void contract(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &w, Eigen::Ref<Vec> rates) override {
    bool moves = false;
    const auto move = [&] { // the bodies at joint velocities w
      moves = true;
      twists_.assign(model_.njoints, pinocchio::Motion::Zero());
      for (int j = 1; j < model_.njoints; ++j) {
        const int first = model_.idx_vs[j], n = model_.nvs[j];
        const Eigen::Matrix<double, 6, 1> own = data_.J.middleCols(first, n) * w.segment(first, n);
        twists_[j] = twists_[model_.parents[j]] + pinocchio::Motion(own);
      }
      for (int j = 1; j < model_.njoints; ++j) twists_[j] = data_.oMi[j].actInv(twists_[j]);
    };
    visit(
        t, p, v, a,
        [&](int column, int body, const pinocchio::Force &force) {
          if (!moves) move();
          rates[column] += twists_[body].dot(force);
        },
        [&](int column, double weight) { rates[column] -= weight * pull_.dot(w); });
  }

private:
  struct Body {
    int column, joint;
    double mass;
    Vector3d moment;
    Matrix3d inertia;

    pinocchio::Force momentum(const pinocchio::Motion &m) const {
      return pinocchio::Force(mass * m.linear() + m.angular().cross(moment), moment.cross(m.linear()) + inertia * m.angular());
    }
  };
  struct Side {
    double weight;
    std::vector<std::unique_ptr<Force>> forces;
    Vec constant, damping;
  };
  struct Pull {
    std::vector<Side> sides;
    std::vector<double> times;       // of a table whose values are interpolated
    std::shared_ptr<HeldTable> held; // or of one whose torques are held
    std::vector<int> columns;        // of the nodes, or -1
  };
  // The parts of two nodes in a force at a time, or -1 where there is none.
  struct Share {
    int node, before;
    double part; // of the first, the rest is that of the node before
  };

  static Share share(const Pull &pull, double t) {
    if (pull.held) {
      const auto &since = pull.held->since;
      const int n = static_cast<int>(pull.held->reached(t)), size = static_cast<int>(since.size());
      if (!pull.held->linear || !n || n == size) return {n - 1, -1, 1.0};
      return {n, n - 1, (pull.held->sign * t - since[n - 1]) / (since[n] - since[n - 1])};
    }
    const auto &times = pull.times;
    const int n = static_cast<int>(times.size()), i = static_cast<int>(std::upper_bound(times.begin(), times.end(), t) - times.begin());
    if (!i || i == n) return {std::max(0, i - 1), -1, 1.0};
    return {i, i - 1, (t - times[i - 1]) / (times[i] - times[i - 1])};
  }

  // Forces on bodies, in their axes, and the torques `pull_` with weights, of the columns.
  template <class OnBody, class OnJoints>
  void visit(double t, const Vec &p, const Vec &v, const Vec &a, const OnBody &on_body, const OnJoints &on_joints) {
    if (on_bodies()) {
      library::rnea(model_, data_, p, v, a);
      find_jacobians();
    }
    for (const auto &body : bodies_) {
      const auto &moving = data_.v[body.joint];
      on_body(body.column, body.joint, body.momentum(data_.a_gf[body.joint]) + moving.cross(body.momentum(moving)));
    }
    for (const auto &[column, rate] : gravities_)
      for (int j = 1; j < model_.njoints; ++j) {
        const pinocchio::Motion falling(data_.oMi[j].rotation().transpose() * -rate, Vector3d::Zero());
        on_body(column, j, model_.inertias[j] * falling);
      }
    for (const auto &[key, pull] : pulls_) {
      const auto [node, last, part] = share(pull, t);
      const auto &columns = pull.columns; // C++17 lambdas do not capture `pull`
      const auto column = [&](int i) { return i >= 0 && i < static_cast<int>(columns.size()) ? columns[i] : -1; };
      const int here = column(node), before = column(last);
      if (here < 0 && before < 0) continue;
      pull_.setZero(nv);
      for (const auto &side : pull.sides) {
        tau_ = side.constant - side.damping.cwiseProduct(v);
        for (const auto &force : side.forces) force->add_torque(data_, t, p, v, tau_);
        pull_ += side.weight * tau_;
      }
      if (here >= 0) on_joints(here, part);
      if (before >= 0) on_joints(before, 1.0 - part);
    }
  }

  // Whether poses are needed: constant torques and dampers of joints need none.
  bool on_bodies() const {
    const auto acts = [](const Side &side) { return !side.forces.empty(); };
    const auto any = [&](const auto &each) { return std::any_of(each.second.sides.begin(), each.second.sides.end(), acts); };
    return !bodies_.empty() || !gravities_.empty() || std::any_of(pulls_.begin(), pulls_.end(), any);
  }

  std::vector<Body> bodies_;
  std::vector<std::pair<int, Vector3d>> gravities_;
  std::map<int, Pull> pulls_;
  std::vector<pinocchio::Motion> twists_;
  Vec pull_;
};

} // namespace pinconsist
