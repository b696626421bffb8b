// mechanism/system.py: M v' + nle = τ + Jᵀλ, Φ = 0.
#pragma once

#include "contacts.hpp"
#include "forces.hpp"
#include "kkt.hpp"
#include "lie.hpp"

namespace pinconsist {

inline double sinc(double x) { return x == 0.0 ? 1.0 : std::sin(x) / x; }

// mechanism/lie.py
inline double turn(double cos, double sin, double c, double s) { return std::atan2(cos * s - sin * c, cos * c + sin * s); }

struct Continuous {
  int q, v;

  void difference(const Vec &p0, const Vec &p1, Vec &xi) const { xi[v] = turn(p0[q], p0[q + 1], p1[q], p1[q + 1]); }
};

struct Planar {
  int q, v;

  void integrate(const Vec &p, const Vec &xi, Vec &out) const {
    const double x = xi[v], y = xi[v + 1], w = xi[v + 2], half = 0.5 * w, cos = p[q + 2], sin = p[q + 3];
    const double s = sinc(w), k = std::sin(half) * sinc(half), dx = s * x - k * y, dy = k * x + s * y;
    const double c1 = cos * std::cos(w) - sin * std::sin(w), s1 = sin * std::cos(w) + cos * std::sin(w);
    const double length = std::hypot(c1, s1);
    out.segment<4>(q) << p[q] + cos * dx - sin * dy, p[q + 1] + sin * dx + cos * dy, c1 / length, s1 / length;
  }
  void difference(const Vec &p0, const Vec &p1, Vec &xi) const {
    const double cos = p0[q + 2], sin = p0[q + 3], c = p1[q + 2], s = p1[q + 3];
    const double dx = p1[q] - p0[q], dy = p1[q + 1] - p0[q + 1], x = cos * dx + sin * dy, y = cos * dy - sin * dx;
    const double half = 0.5 * turn(cos, sin, c, s), scale = std::cos(half) / sinc(half);
    xi.segment<3>(v) << scale * x + half * y, scale * y - half * x, 2.0 * half;
  }
};

class MechanismSystem : public System {
public:
  explicit MechanismSystem(std::shared_ptr<Data> workspace)
      : workspace_(std::move(workspace)), model_(*workspace_->model), data_(*workspace_), axes_(model_), group_(model_) {
    npos = model_.nq;
    nx = nv = model_.nv;
    vector_like = npos == nv;
    for (int i = 1; i < model_.njoints; ++i) {
      const int of_v = model_.nvs[i];
      if (of_v > 1 && model_.nqs[i] != of_v) curved.push_back({model_.idx_vs[i], of_v});
    }
    for (const auto &[kind, q, v] : model_.simple_joints) {
      if (kind == "unbounded") continuous_.push_back({q, v});
      if (kind == "planar") planar_.push_back({q, v});
    }
    f = tau_ = Vec::Zero(nv);
    constant_ = damping_ = Vec::Zero(nv);
    size_rows();
  }

  const Model &model() const { return model_; }
  Data &data() { return data_; }
  const TurningAxes &axes() const { return axes_; }

  // Several parts may add up in the same rows; a `fresh` part starts new rows.
  void add_rows(std::unique_ptr<Rows> rows, bool fresh = true) {
    const int at = fresh ? nc : nc - rows->size();
    nc = at + rows->size();
    calls_python_ |= rows->calls_python();
    difference_step = std::min(difference_step, rows->difference_step());
    slides_ |= rows->slides();
    reacts_ |= rows->reacts();
    rows_.push_back({std::move(rows), at});
    lane_tree_.reset();
    size_rows();
  }
  // Replace the rows that were added last, one a part, by combinations of them.
  void combine(const Mat &combination) {
    std::vector<std::unique_ptr<Rows>> parts;
    const auto first = rows_.end() - combination.cols();
    nc = first->second;
    for (auto part = first; part != rows_.end(); ++part) parts.push_back(std::move(part->first));
    rows_.erase(first, rows_.end());
    add_rows(std::make_unique<CombinedRows>(std::move(parts), combination));
  }
  void add_force(std::unique_ptr<Force> force) {
    calls_python_ |= force->calls_python();
    forces_on_bodies_ |= force->on_bodies();
    force->narrow(widths);
    sharp |= force->sharp();
    sharp_on_bodies_ |= force->sharp() && force->on_bodies();
    forces_.push_back(std::move(force));
    lane_tree_.reset();
  }
  // What numbers.hpp changes in place.
  int number_of_rows() const { return static_cast<int>(rows_.size()); }
  int number_of_forces() const { return static_cast<int>(forces_.size()); }
  bool place_rows(int part, int body, const Vector3d &x) { return rows_.at(part).first->place(body, x); }
  double *number(int force, const std::string &name) { return forces_.at(force)->number(name); } // null if it has none
  Vec &damping() { return damping_; }
  // After changes of these, or of bodies of the tree.
  void renew_lanes() {
    if (!lane_tree_) return;
    lane_tree_.reset();
    in_lanes(); // in the same place
  }

  void add_constant(const Vec &torque) { constant_ += torque; }
  void add_damping(const Vec &coefficients) { damping_ += coefficients; }
  bool calls_python() const override { return calls_python_; }

  const Mat &G_transposed() const override { return slides_ ? Gt_ : W; }
  bool reacts() const override { return reacts_; }
  bool react(const Vec &lam, const Vec &v) override {
    const Mat before = Gt_;
    for (const auto &part : rows_) part.first->react(lam);
    turn_forces(v);
    return largest(Mat(Gt_ - before)) > REACTED * largest(Gt_);
  }
  void step_ended(const Vec &v) override {
    for (const auto &part : rows_) part.first->step_ended(v);
  }

  // Contacts that slide do so in the direction of this velocity.
  void aim(double t, const Vec &p, const Vec &v) {
    if (!slides_) return;
    evaluate_rows(t, p);
    for (const auto &part : rows_) part.first->aim(v);
  }

  void integrate(const Vec &p, const Vec &xi, Vec &out) const override {
    out.resize(npos);
    if (vector_like) {
      out = p + xi;
      return;
    }
    library::integrate(model_, p, xi, out);
    for (const auto &joint : planar_) joint.integrate(p, xi, out);
  }

  void difference(const Vec &p0, const Vec &p1, Vec &xi) const override {
    if (vector_like) {
      xi = p1 - p0;
      return;
    }
    library::difference(model_, p0, p1, xi);
    for (const auto &joint : continuous_) joint.difference(p0, p1, xi);
    for (const auto &joint : planar_) joint.difference(p0, p1, xi);
  }

  // The positions of several charts' centres and coordinates, one a row.
  Table chart_points(const Table &bases, const Table &xi) const {
    Table points(bases.rows(), npos);
    Vec point;
    for (Eigen::Index i = 0; i < points.rows(); ++i) {
      integrate(bases.row(i).transpose(), xi.row(i).transpose(), point);
      points.row(i) = point.transpose();
    }
    return points;
  }

  void chart_rate(const Vec &xi, const Vec &rate, Vec &out) const override { group_.chart_rate(xi, rate, out); }
  void bracket(const Vec &x, Mat &ad) const override { group_.bracket(x, ad); }
  void chart_matrix(const Vec &xi, Mat &T) const override {
    Mat ad;
    group_.bracket(xi, ad);
    T.setIdentity(nx, nx);
    for (auto [first, n] : curved) {
      if (n == 6) T.block<6, 6>(first, first) = chart_block<Eigen::Matrix<double, 6, 6>>(ad.block<6, 6>(first, first));
      else if (n == 3) T.block<3, 3>(first, first) = chart_block<Matrix3d>(ad.block<3, 3>(first, first));
      else T.block(first, first, n, n) = chart_block<Mat>(ad.block(first, first, n, n));
    }
  }

  void position(double, const Vec &base, const Vec &psi_x, double c, const Vec &v, Vec &p, Vec &xi) const override {
    xi = psi_x + c * v;
    if (vector_like) p = xi;
    else integrate(base, xi, p);
  }

  void evaluate(double t, const Vec &p, const Vec &v, const Vec &a) override {
    if (reacts_) take_reactions(t, p, v);
    f = library::rnea(model_, data_, p, v, a);
    if (!nobody_needs_jacobians()) {
      find_jacobians();
      fill_rows(t, p);
    }
    if (slides_) turn_forces(v);
    add_the_rest(t, p, v);
  }

  void constraint(double t, const Vec &p, const Vec &v) override {
    evaluate_rows(t, p);
    if (slides_) turn_forces(v);
    hidden_residual(t, p, v);
  }

  void evaluate_bias(double t, const Vec &p, const Vec &v, bool known, Vec &bias) override {
    if (nobody_needs_jacobians()) {
      f = library::rnea(model_, data_, p, v, Vec::Zero(nv));
    } else {
      if (!known) evaluate_rows(t, p);
      if (slides_) turn_forces(v);
      if (!by_jacobians()) f = library::rnea(model_, data_, p, v, Vec::Zero(nv)); // does not change the joint Jacobians
      move_bodies(v);
      if (by_jacobians()) weigh_bodies();
    }
    subtract_forces(t, p, v);
    find_bias(t, p, v, bias);
  }

  // The part of f that is weights and inertial forces, after `evaluate_bias`.
  Vec inertial_forces(const Vec &v) const { return f + constant_ - damping_.cwiseProduct(v) + tau_; }

  void linearize(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &, double c, Eigen::Ref<Mat> A,
                 bool fresh) override {
    if (fresh) {
      differentiate_forces(t, p, v, a, by_v_, by_q_);
      A = data_.M.selfadjointView<Eigen::Upper>();
    } else {
      mass_matrix(t, p, v, A);
    }
    A += c * (by_v_ + c * by_q_);
  }

  void evaluate_parts(double t, const Vec &p, const Vec &v, const Vec &a, Mat &M, Mat &D, Mat &K) override {
    if (reacts_) take_reactions(t, p, v);
    differentiate_forces(t, p, v, a, D, K);
    f = data_.tau;
    fill_rows(t, p);
    if (slides_) turn_forces(v);
    add_the_rest(t, p, v);
    if (slides_) add_turning(v, D);
    M = data_.M.selfadjointView<Eigen::Upper>();
  }

  // By composite bodies in world axes, with results of `constraint` that the library's `crba` would compute again.
  void mass_matrix(double, const Vec &p, const Vec &, Eigen::Ref<Mat> M) override {
    if (nobody_needs_jacobians()) library::joint_jacobians(model_, data_, p);
    M.setZero();
    auto &composite = data_.oYcrb;
    for (int i = 1; i < model_.njoints; ++i) composite[i] = data_.oMi[i].act(model_.inertias[i]);
    for (int i = model_.njoints - 1; i > 0; --i) {
      for (int column = model_.idx_vs[i]; column < model_.idx_vs[i] + model_.nvs[i]; ++column) {
        const Six momentum = (composite[i] * pinocchio::Motion(data_.J.col(column))).toVector();
        for (int row = column; row >= 0; row = data_.parents_fromRow[row])
          M(row, column) = M(column, row) = momentum.dot(data_.J.col(row));
      }
      if (const auto parent = model_.parents[i]) composite[parent] += composite[i];
    }
    M.diagonal() += model_.armature;
  }

  // Φ of several configurations, one a row.
  Table gaps(const Vec &times, const Table &configurations) {
    Table gaps(times.size(), nc);
    for (Eigen::Index i = 0; i < times.size(); ++i) {
      evaluate_rows(times[i], configurations.row(i).transpose());
      gaps.row(i) = phi.transpose();
    }
    return gaps;
  }

  // Replaces the `steady` ones in each row of `multipliers` by those of smallest norm with the same joint forces Jᵀλ.
  Table complete(double t, const Table &configurations, Table multipliers, const std::vector<int> &steady); // in module.cpp

  // Joint torques of all forces.
  Vec torque(double t, const Vec &p, const Vec &v) {
    evaluate_rows(t, p);
    f.setZero();
    add_the_rest(t, p, v);
    return -f;
  }

  // ∂τ/∂q and ∂τ/∂v of all forces.
  std::pair<Mat, Mat> torque_derivatives(double t, const Vec &p, const Vec &v) {
    if (forces_on_bodies_) {
      library::joint_jacobians(model_, data_, p);
      axes_.move(data_, p, v, Vec::Zero(nv));
    }
    Mat by_q = Mat::Zero(nv, nv), by_v = damping_.asDiagonal();
    for (const auto &force : forces_) force->linearize(data_, t, p, v, by_v, by_q);
    return {-by_q, -by_v};
  }

  // What forces exert on bodies.
  std::vector<Load> loads(double t, const Vec &p, const Vec &v) {
    if (forces_on_bodies_) library::joint_jacobians(model_, data_, p);
    std::vector<Load> loads;
    for (const auto &force : forces_) force->add_loads(data_, t, v, loads);
    return loads;
  }

  // Of the first force: see Force.
  Vector3d along(double t, const Vec &p, const Vec &v) {
    if (forces_on_bodies_) library::joint_jacobians(model_, data_, p);
    return forces_.at(0)->along(data_, t, p, v);
  }
  // Energy of springs and its rate.
  std::pair<double, double> stored(const Vec &p, const Vec &v) {
    if (forces_on_bodies_) library::joint_jacobians(model_, data_, p);
    std::pair<double, double> all{0.0, 0.0};
    for (const auto &force : forces_) {
      const auto [energy, rate] = force->stored(data_, p, v);
      all.first += energy;
      all.second += rate;
    }
    return all;
  }
  bool limited(double t, const Vec &p, const Vec &v) const { return forces_.at(0)->limited(t, p, v); }

  void sharp_force(double t, const Vec &p, const Vec &v, Vec &tau) override {
    if (sharp_on_bodies_) library::joint_jacobians(model_, data_, p);
    tau.setZero(nv);
    for (const auto &force : forces_)
      if (force->sharp()) force->add_torque(data_, t, p, v, tau);
  }

  // Power of all forces without what springs store, and the energy of springs, at the poses and Jacobians of another
  // system of this model.
  std::pair<double, double> power(const Data &data, double t, const Vec &p, const Vec &v) {
    std::pair<double, double> found{(constant_ - damping_.cwiseProduct(v)).dot(v), 0.0};
    for (const auto &force : forces_) {
      tau_.setZero();
      force->add_torque(data, t, p, v, tau_);
      const auto [energy, rate] = force->stored(data, p, v);
      found.first += tau_.dot(v) + rate;
      found.second += energy;
    }
    return found;
  }

  // Add force and moment about x that the rows with these multipliers exert on the second body, in world axes.
  void add_wrench(const Vec &lam, const Vector3d &x, Vector3d &force, Vector3d &moment) const {
    for (const auto &[rows, at] : rows_) rows->add_wrench(data_, lam.segment(at, rows->size()), x, force, moment);
  }

  // ∂(Jᵀλ)/∂q by forward differences; needed only if Newton is slow.
  void subtract_force_gradient(double t, const Vec &p, const Vec &v, const Vec &lam, double c,
                               Eigen::Ref<Mat> A) override {
    const Mat kept_W = W, kept_Gt = Gt_;
    const Vec kept_phi = phi;
    evaluate_rows(t, p);
    if (slides_) turn_forces(v);
    const Vec at = G_transposed().transpose() * lam;
    const double step = 1e-7;
    Vec unit = Vec::Zero(nx);
    Mat gradient(nv, nv);
    for (int i = 0; i < nv; ++i) {
      unit[i] = step;
      Vec there(npos);
      integrate(p, unit, there);
      evaluate_rows(t, there);
      if (slides_) turn_forces(v);
      gradient.col(i) = (G_transposed().transpose() * lam - at) / step;
      unit[i] = 0.0;
    }
    A -= c * c * gradient;
    W = kept_W;
    Gt_ = kept_Gt;
    phi = kept_phi;
  }

  bool row_gradients(double t, const Vec &p, const Vec &v, const Vec &lam, Mat &F, Mat &H) override {
    if (!axes_.empty()) return false;
    return std::all_of(rows_.begin(), rows_.end(), [&](const auto &part) {
      return part.first->add_gradients(data_, p, v, lam, part.second, F, H);
    });
  }

  const lanes::Tree *in_lanes() override {
    if (calls_python_ || slides_ || !axes_.empty()) return nullptr;
    if (!lane_tree_) {
      lane_tree_ = LaneTree::of(model_, nc, damping_, constant_);
      if (!lane_tree_) return nullptr;
      other_rows_.clear();
      for (const auto &[rows, at] : rows_)
        if (!rows->add_to(*lane_tree_, at)) other_rows_.push_back({rows.get(), at});
      other_forces_.clear();
      others_on_bodies_ = !other_rows_.empty();
      for (const auto &force : forces_) {
        if (force->add_to(*lane_tree_)) continue;
        other_forces_.push_back(force.get());
        others_on_bodies_ |= force->on_bodies();
      }
    }
    return &lane_tree_->settle();
  }

  void evaluate_lanes(const Vec &times, StateLanes &states, bool derivatives) override {
    lanes::Fields &fields = states.fields;
    states.kernel().evaluate(states.tree(), fields, derivatives);
    const int last = states.states() - 1;
    const bool others = !other_rows_.empty() || !other_forces_.empty(), on_bodies = others_on_bodies_;
    for (int i = 0; i <= last && others; ++i) {
      if (on_bodies) show_bodies(states, i);
      add_others(times[i], states, i, derivatives);
    }
    show(states, last);
    if (derivatives && !on_bodies) show_bodies(states, last);
    if (derivatives && !other_forces_.empty()) fields.filled = true;
  }

  void take(const StateLanes &states, int i) override {
    show(states, i);
    show_bodies(states, i);
  }

protected:
  // Takes over f, Φ, J of a state.
  void show(const StateLanes &states, int i) {
    const lanes::Fields &fields = states.fields;
    states.get(fields.f, nv, i, f.data());
    states.get(fields.phi, nc, i, phi.data());
    for (int row = 0; row < nc; ++row)
      for (int k = 0; k < nv; ++k) W(row, k) = states.at(fields.J, static_cast<long>(nc) * nv, row * nv + k, i);
  }

  // Takes over poses and Jacobians of the joints.
  void show_bodies(const StateLanes &states, int i) {
    const lanes::Fields &fields = states.fields;
    const Vector3d origin(fields.origin[0], fields.origin[1], fields.origin[2]);
    Eigen::Matrix<double, 12, 1> pose;
    for (int joint = 1; joint < model_.njoints; ++joint) {
      double *first = &states.at(fields.poses, 12 * (model_.njoints - 1), 12 * (joint - 1), i);
      for (int k = 0; k < 12; ++k) pose[k] = first[k * states.kernel().width];
      const Eigen::Map<const Matrix3d> R(pose.data());
      data_.oMi[joint] = SE3(Matrix3d(R * lane_tree_->aligned(joint).transpose()), Vector3d(pose.tail<3>() + origin));
    }
    for (int k = 0; k < nv; ++k) {
      double *first = &states.at(fields.twists, 6 * nv, 6 * k, i);
      for (int c = 0; c < 6; ++c) data_.J(c, k) = first[c * states.kernel().width];
      data_.J.col(k).head<3>() += origin.cross(Vector3d(data_.J.col(k).tail<3>()));
    }
  }

  // Rows and forces that are evaluated state by state.
  void add_others(double t, StateLanes &states, int i, bool derivatives) {
    lanes::Fields &fields = states.fields;
    p_.resize(npos);
    v_.resize(nv);
    states.get(fields.q, npos, i, p_.data());
    states.get(fields.v, nv, i, v_.data());
    if (!other_rows_.empty()) {
      other_phi_.setZero(nc);
      other_J_.setZero(nc, nv);
      for (const auto &[rows, at] : other_rows_) rows->evaluate(data_, t, p_, at, other_phi_, other_J_);
      states.add(fields.phi, nc, i, other_phi_.data());
      other_rows_transposed_ = other_J_.transpose();
      states.add(fields.J, static_cast<long>(nc) * nv, i, other_rows_transposed_.data());
    }
    if (other_forces_.empty()) return;
    tau_.setZero();
    for (const auto *force : other_forces_) force->add_torque(data_, t, p_, v_, tau_);
    states.add(fields.f, nv, i, tau_.data(), -1.0);
    if (!derivatives) return;
    other_D_.setZero(nv, nv);
    other_K_.setZero(nv, nv);
    for (const auto *force : other_forces_) force->linearize(data_, t, p_, v_, other_D_, other_K_);
    states.add(fields.D, i, other_D_);
    states.add(fields.K, i, other_K_);
  }

  // Poses and Jacobians of the joints, after rnea, which computes poses only relative to the parents.
  void find_jacobians() {
    for (int i = 1; i < model_.njoints; ++i)
      data_.oMi[i] = model_.parents[i] ? data_.oMi[model_.parents[i]] * data_.liMi[i] : data_.liMi[i];
    library::joint_jacobians(model_, data_);
  }

  void subtract_forces(double t, const Vec &p, const Vec &v) {
    f -= constant_;
    f.array() += damping_.array() * v.array();
    if (forces_.empty()) return;
    tau_.setZero();
    for (const auto &force : forces_) force->add_torque(data_, t, p, v, tau_);
    f -= tau_;
  }

  const std::shared_ptr<Data> workspace_;
  const Model &model_;
  Data &data_;
  TurningAxes axes_;
  std::vector<std::unique_ptr<Force>> forces_;
  Vec constant_, damping_, tau_;

private:
  void find_bias(double t, const Vec &p, const Vec &v, Vec &bias) const {
    bias.setZero(nc);
    for (const auto &[rows, at] : rows_) rows->add_bias(data_, t, p, v, at, bias);
  }

  // Whether the motion of bodies follows from Jacobians.
  bool by_jacobians() const { return axes_.empty(); }

  // Velocities and accelerations of the bodies, in world axes.
  void move_bodies(const Vec &v) {
    using pinocchio::Motion;
    data_.ov[0].setZero();
    data_.oa[0].setZero();
    for (int i = 1; i < model_.njoints; ++i) {
      if (!by_jacobians()) { // rnea has computed accelerations minus gravity
        data_.a[i] = data_.a_gf[i] + data_.oMi[i].actInv(model_.gravity);
        data_.ov[i] = data_.oMi[i].act(data_.v[i]);
        data_.oa[i] = data_.oMi[i].act(data_.a[i]);
        continue;
      }
      const Motion own(joint_twist(model_, data_, i, v));
      data_.ov[i] = data_.ov[model_.parents[i]] + own;
      data_.oa[i] = data_.oa[model_.parents[i]] + data_.ov[i].cross(own);
    }
  }

  // f of weights and of these motions.
  void weigh_bodies() {
    for (int i = 1; i < model_.njoints; ++i) {
      const auto &inertia = model_.inertias[i];
      const auto falling = data_.oa[i] - model_.gravity;
      const Matrix3d &R = data_.oMi[i].rotation();
      const Vector3d centre = data_.oMi[i].act(inertia.lever()), w = data_.ov[i].angular(), spin = R.transpose() * w;
      const Vector3d rate = R.transpose() * falling.angular(), moved = data_.ov[i].linear() + w.cross(centre);
      const Vector3d force = inertia.mass() * (falling.linear() + falling.angular().cross(centre) + w.cross(moved));
      const Vector3d moment = R * (inertia.inertia() * rate + spin.cross(inertia.inertia() * spin));
      data_.of[i] = pinocchio::Force(force, centre.cross(force) + moment);
    }
    for (int i = model_.njoints - 1; i > 0; --i) {
      const Six force = data_.of[i].toVector();
      for (int k = model_.idx_vs[i]; k < model_.idx_vs[i] + model_.nvs[i]; ++k) f[k] = force.dot(data_.J.col(k));
      if (const auto parent = model_.parents[i]) data_.of[parent] += data_.of[i];
    }
  }

  // D and K of all forces; M, τ, poses and Jacobians of the joints are known after it.
  void differentiate_forces(double t, const Vec &p, const Vec &v, const Vec &a, Mat &D, Mat &K) {
    library::differentiate_rnea(model_, data_, p, v, a);
    D = data_.dtau_dv;
    K = data_.dtau_dq;
    if (!axes_.empty()) {
      axes_.move(data_, p, v, a);
      axes_.complete(data_, D, K);
    }
    D.diagonal() += damping_;
    for (const auto &force : forces_) force->linearize(data_, t, p, v, D, K);
  }

  void hidden_residual(double t, const Vec &p, const Vec &v) {
    if (nv < SMALL_PRODUCT) rho = W.lazyProduct(v);
    else rho.noalias() = W * v;
    for (const auto &[rows, at] : rows_) rows->add_rate(t, p, at, rho);
  }

  // Adds the other forces to the inertial ones f, and computes ρ; rows have been evaluated.
  void add_the_rest(double t, const Vec &p, const Vec &v) {
    hidden_residual(t, p, v);
    subtract_forces(t, p, v);
  }

  // The directions of the forces of contacts that slide.
  void turn_forces(const Vec &v) {
    Gt_ = W;
    for (const auto &[rows, at] : rows_) rows->add_friction(v, at, Gt_);
  }

  // The λ that balance f.
  Vec balancing() const { return (Gt_ * Gt_.transpose()).ldlt().solve(Gt_ * f); }

  // Let G be that of the multipliers of the accelerations that follow from the state. With those of stages, which have less
  // order, the equations would not be linear in λ, and a step would lose an order.
  void take_reactions(double t, const Vec &p, const Vec &v) {
    KKT kkt(nv, nc);
    Vec bias;
    evaluate_bias(t, p, v, false, bias);
    mass_matrix(t, p, v, kkt.A());
    Mat all(nv + nc, 1);
    for (int turn = 0; turn < REACTIONS; ++turn) {
      all << -f, -bias;
      if (!kkt.solve_new(W, Gt_, 1.0, all) || !react(all.col(0).tail(nc), v)) return;
    }
  }

  // The derivative of these directions.
  void add_turning(const Vec &v, Mat &D) {
    const Vec lam = balancing();
    for (const auto &[rows, at] : rows_) rows->add_turning(v, lam, at, D);
  }

  bool nobody_needs_jacobians() const { return rows_.empty() && !forces_on_bodies_; }

  void evaluate_rows(double t, const Vec &p) {
    if (nobody_needs_jacobians()) return;
    library::joint_jacobians(model_, data_, p);
    fill_rows(t, p);
  }

  void fill_rows(double t, const Vec &p) {
    phi.setZero();
    W.setZero();
    for (const auto &[rows, at] : rows_) rows->evaluate(data_, t, p, at, phi, W);
  }

  LieGroup group_;
  std::vector<Continuous> continuous_;
  std::vector<Planar> planar_;
  bool calls_python_ = false, forces_on_bodies_ = false, sharp_on_bodies_ = false, slides_ = false, reacts_ = false;
  Mat Gt_; // of contacts that slide
  std::vector<std::pair<std::unique_ptr<Rows>, int>> rows_;
  Mat by_v_, by_q_; // of all forces; kept for later steps
  std::optional<LaneTree> lane_tree_;
  std::vector<std::pair<const Rows *, int>> other_rows_; // evaluated state by state
  std::vector<const Force *> other_forces_;
  bool others_on_bodies_ = false;
  Vec p_, v_, other_phi_;
  Mat other_J_, other_rows_transposed_, other_D_, other_K_;
};

} // namespace pinconsist
