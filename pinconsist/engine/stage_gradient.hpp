// Derivatives of the steps of Radau IIA; the formulas are in linear.hpp.
#pragma once

#include "charts.hpp"
#include "index1.hpp"
#include "kkt.hpp"
#include "linear.hpp"
#include "null_space.hpp"
#include "stages.hpp"
#include "state_lanes.hpp"

#include <map>

namespace pinconsist {

using Integers = Eigen::VectorX<std::int64_t>;

// Recorded steps, a row for each; W one after another, (s, nv) each.
struct StageSteps {
  Vec t_old, t, h;
  Table p0, v0, p, v;
  Integers s;
  Vec W;

  int size() const { return static_cast<int>(t.size()); }
  // Sets the start of a step and its accelerations, which begin at W.
  void place(int i, const double *of, Stages &stages) const {
    stages.t = t_old[i];
    stages.h = h[i];
    stages.p = p0.row(i);
    stages.v = v0.row(i);
    stages.W = Eigen::Map<const Mat>(of, v0.cols(), s[i]);
  }
};

// [[M, -G], [J, 0]] at a state, for the end of a step and for multipliers.
class StatePoint {
public:
  explicit StatePoint(System &system) : system_(system), kkt_(system.nv, system.nc), rhs_(system.nv + system.nc, 0) {}

  Mat J, M, D, K;

  bool set(double t, const Vec &p, const Vec &v, const Vec &a) {
    system_.evaluate_parts(t, p, v, a, M, D, K);
    J = system_.W;
    kkt_.A() = M;
    return kkt_.solve_new(J, system_.G_transposed(), 1.0, rhs_);
  }
  void solve(Mat &x) const { kkt_.solve(x, 1.0); }
  void solve_transposed(Vec &x) const { kkt_.solve_transposed(x); }

private:
  System &system_;
  KKT kkt_;
  Mat rhs_;
};

// The end of a step, and the effect of parameters on it.
class StageMotion {
public:
  StageMotion(System &system, const Parameters &parameters)
      : parameters_(parameters), system_(system), stages_(system), rows_(system), end_(system.nc, system.nv), lu_(0),
        inertia_(system.nv - system.nc), zero_(Vec::Zero(system.nv)) {}

  // Evaluates step `i`, with accelerations that begin at W; false if it is singular.
  bool set(const StageSteps &steps, int i, const double *W) {
    const int s = static_cast<int>(steps.s[i]);
    stages_.use(RadauTable::of.at(s));
    steps.place(i, W, stages_);
    stages_.move();
    t_ = steps.t[i];
    p_ = steps.p.row(i);
    v_ = steps.v.row(i);
    gap_ = v_ - stages_.V.col(s - 1);
    carry();
    return set_stages() && set_end();
  }

  // [s_p | s_v] at the end, a column for each parameter.
  void forward(Eigen::Ref<const Mat> start, Eigen::Ref<Mat> end) {
    const int nv = system_.nv, nc = system_.nc, nd = nv - nc, s = stages_.size();
    find_rates();
    y_.resize(s * nd, start.cols());
    of_start_.resize(nv, start.cols());
    product(by_start_, start, y_);
    dP_.setZero(nv, start.cols());
    dV_.setZero(nv, start.cols());
    for (int c : active_) add_rates(c);
    if (nd) lu_.substitute(y_.data(), static_cast<int>(y_.cols()));
    product(end_by_y_, y_, end);
    product(end_by_p_, start.topRows(nv), of_start_);
    end.bottomRows(nv) += of_start_;
    for (int c : active_) add_end_rates(c, end);
  }

  // The transpose, of one column; adds to `rates`, (P).
  void backward(const Vec &end, Vec &start, Eigen::Ref<Vec> rates) {
    const int nv = system_.nv, nc = system_.nc, nd = nv - nc, s = stages_.size();
    const auto of_v = end.tail(nv);
    const Vec up = projector_.transpose() * of_v, low = closing_.transpose() * of_v, moved = into_.transpose() * of_v;
    const Vec of_p = end.head(nv) - by_end_.transpose() * of_v, phi = -closing_.transpose() * of_p;
    Vec weights = Vec::Zero(nv + 2 * nc), y = end_by_y_.transpose() * end;
    weights.head(nv) = -up;
    contract(gap_, Vec::Zero(nc), weights, rates);
    weights << up, phi, -low;
    contract(zero_, -nu_, weights, rates);
    if (nd) lu_.substitute_transposed(y.data());
    start = by_start_.transpose() * y;
    start.head(nv) += end_by_p_.transpose() * of_v;
    weights.setZero();
    for (int i = 0; i < s; ++i) {
      if (nd) weights.head(nv) = -spaces_[i].Z * y.segment(i * nd, nd);
      if (parameters_.move_rows()) {
        Vec closing = X_.middleCols(i * nv, nv).transpose() * moved - whole_.middleCols(i * nv, nv).transpose() * y;
        if (i == s - 1) closing += closed_.transpose() * of_p;
        weights.segment(nv, nc) = -spaces_[i].N.transpose() * closing;
      }
      see(i);
      parameters_.contract(at_, stage_p_, stage_v_, stage_w_, residuals_with(L_.col(i)), weights, rates);
    }
  }

private:
  // A joint in a chart: dV = X (dP - Ad s_p) of all stages, and b X/h.
  struct Chart {
    int first, size;
    std::vector<Mat> Ad;
    Mat X, dW;
  };

  void carry() {
    const int s = stages_.size(), nv = system_.nv;
    const Mat b = stages_.table->inverse / stages_.h;
    X_.setZero(nv, s * nv); // of the last stage
    for (int j = 0; j < s; ++j) X_.middleCols(j * nv, nv).diagonal().setConstant(b(s - 1, j));
    charts_.clear();
    if (system_.curved.empty()) return;
    std::vector<Mat> T(s), ad(s), N(s);
    for (int i = 0; i < s; ++i) {
      xi_ = stages_.xi.col(i);
      system_.chart_matrix(xi_, T[i]);
      system_.bracket(xi_, ad[i]);
      chart_rate_gradient(system_, xi_, stages_.V.col(i), N[i]);
    }
    for (auto [first, n] : system_.curved) {
      const auto part = [first = first, n = n](const Mat &matrix) { return matrix.block(first, first, n, n); };
      Chart chart{first, n, {}, Mat(s * n, s * n), Mat::Zero(s * n, s * n)};
      for (int i = 0; i < s; ++i) {
        const Mat back = part(T[i]).inverse();
        chart.Ad.push_back(Mat::Identity(n, n) - back * part(ad[i]));
        for (int j = 0; j < s; ++j) chart.X.block(i * n, j * n, n, n) = b(i, j) * (back * part(T[j]));
        chart.X.block(i * n, i * n, n, n) -= back * part(N[i]) * part(T[i]);
      }
      for (int i = 0; i < s; ++i)
        for (int k = 0; k < s; ++k) chart.dW.middleRows(i * n, n) += b(i, k) * chart.X.middleRows(k * n, n);
      for (int j = 0; j < s; ++j) X_.block(first, j * nv + first, n, n) = chart.X.block((s - 1) * n, j * n, n, n);
      charts_.push_back(std::move(chart));
    }
  }

  // The equations of the stages: `whole_` dP - `by_start_` [s_p | s_v] + Zᵀ r_θ = 0 of all stages, with dP = Z y.
  bool set_stages() {
    const int s = stages_.size(), nv = system_.nv, nc = system_.nc, nd = nv - nc;
    const Mat b = stages_.table->inverse / stages_.h, b2 = stages_.table->inverse2 / (stages_.h * stages_.h);
    while (static_cast<int>(spaces_.size()) < s) spaces_.emplace_back(nc, nv);
    L_.resize(nc, s);
    for (Mat *each : {&MZ_, &DZ_, &KZ_}) each->resize(nv, nd);
    whole_.resize(s * nd, s * nv);
    by_start_.setZero(s * nd, 2 * nv);
    StateLanes *lanes = evaluate_stages();
    for (int i = 0; i < s; ++i) {
      see(i);
      if (lanes) {
        system_.take(*lanes, i);
        unpack(*lanes, i);
      } else {
        system_.evaluate_parts(at_, stage_p_, stage_v_, stage_w_, M_, D_, K_);
        for (Mat *each : {&D_, &K_}) each->transposeInPlace();
      }
      NullSpace &space = spaces_[i];
      if (!space.set(system_.G_transposed(), i ? &spaces_[0] : nullptr)) return false;
      if (parameters_.move_rows()) space.find_right_inverse();
      space.multipliers(system_.f, L_.col(i));
      lam_ = L_.col(i);
      rows_.find_forces(at_, stage_p_, stage_v_, lam_, F_);
      K_ -= F_.transpose();
      product(M_, space.Z, MZ_);
      product(D_, space.Z, DZ_);
      product(K_, space.Z, KZ_);
      add_stage(i, b, b2);
    }
    if (!nd) return true;
    matrix_.resize(s * nd, s * nd);
    for (int j = 0; j < s; ++j) product_of_columns(j);
    if (lu_.size() != s * nd) lu_ = LU(s * nd);
    return lu_.factorise(matrix_);
  }

  // Rows of a stage, whose matrices times Z are transposed.
  void add_stage(int i, const Mat &b, const Mat &b2) {
    const int s = stages_.size(), nv = system_.nv, nd = nv - system_.nc;
    const double *MZ = MZ_.data(), *DZ = DZ_.data(), *KZ = KZ_.data();
    for (int j = 0; j < s; ++j) {
      const double of_M = b2(i, j), of_D = b(i, j);
      for (int c = 0; c < nv; ++c)
        for (int k = 0; k < nd; ++k) whole_(i * nd + k, j * nv + c) = of_M * MZ[c + k * nv] + of_D * DZ[c + k * nv];
      auto block = whole_.block(i * nd, j * nv, nd, nv);
      for (const auto &c : charts_)
        block.middleCols(c.first, c.size) =
            MZ_.middleRows(c.first, c.size).transpose() * c.dW.block(i * c.size, j * c.size, c.size, c.size) +
            DZ_.middleRows(c.first, c.size).transpose() * c.X.block(i * c.size, j * c.size, c.size, c.size);
      auto carried = by_start_.block(i * nd, 0, nd, nv);
      carried += block;
      for (const auto &c : charts_) {
        carried.middleCols(c.first, c.size) -= block.middleCols(c.first, c.size);
        carried.middleCols(c.first, c.size) += block.middleCols(c.first, c.size) * c.Ad[j];
      }
      if (i != j) continue;
      for (int c = 0; c < nv; ++c)
        for (int k = 0; k < nd; ++k) block(k, c) += KZ[c + k * nv];
    }
    by_start_.block(i * nd, nv, nd, nv) = b.row(i).sum() * MZ_.transpose();
  }

  void product_of_columns(int j) {
    const int rows = static_cast<int>(whole_.rows()), nv = system_.nv, nd = nv - system_.nc;
    lanes::kernel().product(&whole_(0, j * nv), rows, nv, spaces_[j].Z.data(), nv, nd, &matrix_(0, j * nd), rows);
  }

  // All states at once, or null where they are evaluated one by one.
  StateLanes *evaluate_stages() {
    const lanes::Tree *tree = system_.in_lanes();
    const int s = stages_.size();
    if (!tree) return nullptr;
    StateLanes &states = in_lanes(*tree, s);
    times_.resize(s);
    for (int i = 0; i < s; ++i) {
      times_[i] = stages_.time(i);
      states.set(i, &stages_.P(0, i), &stages_.V(0, i), &stages_.W(0, i));
    }
    system_.evaluate_lanes(times_, states, true);
    return &states;
  }

  StateLanes &in_lanes(const lanes::Tree &tree, int number) {
    StateLanes &states = lanes_[number];
    if (states.states() != number || &states.tree() != &tree || &states.kernel() != &lanes::kernel()) states.use(tree, number);
    return states;
  }

  // M, and the transposes of D and K.
  void unpack(const StateLanes &states, int i) {
    const int nv = system_.nv;
    for (auto [to, from] : {std::pair{&M_, states.fields.M}, {&D_, states.fields.D}, {&K_, states.fields.K}}) {
      to->resize(nv, nv);
      states.get(from, static_cast<long>(nv) * nv, i, to->data()); // row by row
    }
  }

  // The end by y and by the start: position `closed_` Z y, velocity `into_` dV - `by_end_` times that of the position.
  bool set_end() {
    const int nv = system_.nv, nc = system_.nc, nd = nv - nc, s = stages_.size();
    evaluate_end();
    if (!end_.set(J_)) return false;
    end_.find_right_inverse();
    Mat U = end_.Z.transpose(), reduced(nd, nd);
    product(M_, end_.Z, MZ_);
    reduced.noalias() = end_.Z.transpose() * MZ_;
    if (inertia_.size() && !inertia_.factorise(reduced)) return false;
    if (nd) inertia_.substitute(U.data(), nv);
    for (Mat *each : {&projector_, &into_, &closed_, &by_end_, &turned_, &end_by_p_}) each->resize(nv, nv);
    product(end_.Z, U, projector_);
    product(projector_, M_, into_);
    closing_.resize(nv, nc);
    product(into_, end_.N, closing_);
    closing_ = end_.N - closing_;
    product(closing_, J_, turned_);
    closed_ = Mat::Identity(nv, nv) - turned_;
    find_forces_at_end();
    product(projector_, q_, by_end_);
    product(closing_, H_, turned_);
    by_end_ += turned_;
    product(into_, velocity_by_start(), end_by_p_);
    end_by_y_.setZero(2 * nv, s * nd);
    turned_.resize(nv, s * nd);
    product(into_, velocity_by_y(), turned_);
    end_by_y_.bottomRows(nv) = turned_;
    product(closed_, spaces_[s - 1].Z, MZ_);
    product(by_end_, MZ_, KZ_);
    end_by_y_.topRightCorner(nv, nd) = MZ_;
    end_by_y_.bottomRightCorner(nv, nd) -= KZ_;
    return true;
  }

  // dV of the last stage by y, and by s_p.
  const Mat &velocity_by_y() {
    const int s = stages_.size(), nv = system_.nv, nd = nv - system_.nc;
    of_y_.resize(nv, s * nd);
    for (int j = 0; j < s; ++j) {
      const Mat &Z = spaces_[j].Z;
      of_y_.middleCols(j * nd, nd) = stages_.table->inverse(s - 1, j) / stages_.h * Z;
      for (const auto &c : charts_)
        of_y_.block(c.first, j * nd, c.size, nd) = X_.block(c.first, j * nv + c.first, c.size, c.size) * Z.middleRows(c.first, c.size);
    }
    return of_y_;
  }
  const Mat &velocity_by_start() {
    const int s = stages_.size(), nv = system_.nv;
    of_start_.setZero(nv, nv);
    of_start_.diagonal().setConstant(-stages_.table->inverse.row(s - 1).sum() / stages_.h);
    for (const auto &c : charts_) {
      auto own = of_start_.block(c.first, c.first, c.size, c.size);
      own.setZero();
      for (int j = 0; j < s; ++j) own -= X_.block(c.first, j * nv + c.first, c.size, c.size) * c.Ad[j];
    }
    return of_start_;
  }

  // M, J, and the difference of K that the accelerations `gap_` make, at the end.
  void evaluate_end() {
    if (const lanes::Tree *tree = system_.in_lanes()) {
      StateLanes &states = in_lanes(*tree, 2);
      states.set(0, p_.data(), v_.data(), gap_.data());
      states.set(1, p_.data(), v_.data(), zero_.data());
      times_.setConstant(2, t_);
      system_.evaluate_lanes(times_, states, true);
      unpack(states, 0);
      q_ = K_.transpose();
      unpack(states, 1);
      q_ -= K_.transpose();
      system_.take(states, 1);
    } else {
      system_.evaluate_parts(t_, p_, v_, gap_, M_, D_, q_);
      system_.evaluate_parts(t_, p_, v_, zero_, M_, D_, K_);
      q_ -= K_;
    }
    J_ = system_.W;
  }

  // ν, and with it q and H, at the end.
  void find_forces_at_end() {
    const Vec x = closing_ * (J_ * gap_), pushed = M_ * x;
    nu_.resize(system_.nc);
    end_.multipliers(pushed, nu_);
    rows_.find(t_, p_, v_, nu_, F_, H_);
    q_ -= F_;
  }

  void see(int i) {
    at_ = stages_.time(i);
    stage_p_ = stages_.P.col(i);
    stage_v_ = stages_.V.col(i);
    stage_w_ = stages_.W.col(i);
  }

  void contract(const Vec &a, const Vec &lam, const Vec &weights, Eigen::Ref<Vec> rates) {
    parameters_.contract(t_, p_, v_, a, residuals_with(lam), weights, rates);
  }

  // Rates of the stages, and of the end, with q instead of r; `active_` are the columns that are not zero.
  void find_rates() {
    const int nv = system_.nv, nc = system_.nc, s = stages_.size(), P = parameters_.size(), n = nv + 2 * nc;
    rates_.setZero(s * n, P);
    end_rates_.setZero(n, P);
    for (int i = 0; i < s; ++i) {
      see(i);
      parameters_.add_columns(at_, stage_p_, stage_v_, stage_w_, residuals_with(L_.col(i)), rates_.middleRows(i * n, n));
    }
    Mat moved = Mat::Zero(n, P);
    parameters_.add_columns(t_, p_, v_, gap_, residuals_with(Vec::Zero(nc)), moved);
    parameters_.add_columns(t_, p_, v_, zero_, residuals_with(-nu_), end_rates_);
    end_rates_.topRows(nv) = moved.topRows(nv) - end_rates_.topRows(nv);
    active_.clear();
    for (int c = 0; c < P; ++c)
      if (!rates_.col(c).isZero(0.0) || !end_rates_.col(c).isZero(0.0)) active_.push_back(c);
  }

  // The effect of a parameter on the stages, and what it moves to close them.
  void add_rates(int c) {
    const int nv = system_.nv, nc = system_.nc, nd = nv - nc, s = stages_.size(), n = nv + 2 * nc;
    for (int i = 0; i < s && nd; ++i)
      y_.col(c).segment(i * nd, nd).noalias() -= spaces_[i].Z.transpose() * rates_.col(c).segment(i * n, nv);
    if (!parameters_.move_rows()) return;
    for (int i = 0; i < s; ++i) {
      const Vec closing = -spaces_[i].N * rates_.col(c).segment(i * n + nv, nc);
      y_.col(c).noalias() -= whole_.middleCols(i * nv, nv) * closing;
      dV_.col(c).noalias() += X_.middleCols(i * nv, nv) * closing;
      if (i == s - 1) dP_.col(c) = closing;
    }
  }

  void add_end_rates(int c, Eigen::Ref<Mat> end) const {
    const int nv = system_.nv, nc = system_.nc;
    const auto rates = end_rates_.col(c);
    const Vec moved = closed_ * dP_.col(c) - closing_ * rates.segment(nv, nc);
    end.col(c).head(nv) += moved;
    end.col(c).tail(nv) += into_ * dV_.col(c) - by_end_ * moved - projector_ * rates.head(nv) - closing_ * rates.tail(nc);
  }

  const Parameters &parameters_;
  System &system_;
  Stages stages_;
  RowGradients rows_;
  std::vector<NullSpace> spaces_; // of the stages
  NullSpace end_;
  LU lu_, inertia_; // of the stages; of the free velocities at the end
  std::map<int, StateLanes> lanes_; // by the number of states
  double t_ = 0.0, at_ = 0.0;
  Vec p_, v_, gap_, zero_, nu_, lam_, stage_p_, stage_v_, stage_w_, xi_, times_;
  Mat M_, D_, K_, F_, MZ_, DZ_, KZ_; // of a stage; D and K transposed
  Mat X_, L_, whole_, by_start_, matrix_;
  // At the end: x = `closing_` b + `projector_` a solves M x - G ν = a, J x = b; `into_` = `projector_` M.
  Mat J_, q_, H_, projector_, closing_, into_, closed_, by_end_, end_by_y_, end_by_p_;
  Mat of_y_, of_start_, turned_, y_, dP_, dV_, rates_, end_rates_;
  std::vector<int> active_;
  std::vector<Chart> charts_;
};

} // namespace pinconsist
