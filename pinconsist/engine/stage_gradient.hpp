// Derivatives of the steps of Radau IIA; the formulas are in linear.hpp.
#pragma once

#include "charts.hpp"
#include "index1.hpp"
#include "kkt.hpp"
#include "linear.hpp"
#include "stages.hpp"

#include <Eigen/QR>

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
      : parameters_(parameters), system_(system), stages_(system), rows_(system), end_(system), lu_(0),
        zero_(Vec::Zero(system.nv)) {}

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
  void forward(const Mat &start, Mat &end) {
    const int nv = system_.nv, nc = system_.nc, nd = nv - nc, s = stages_.size(), P = static_cast<int>(start.cols());
    const auto s_p = start.topRows(nv), s_v = start.bottomRows(nv);
    find_rates(nv, nc, s);
    const int n = nv + 2 * nc; // rates of a point
    Mat carried(s * nv, P), closing(s * nv, P), y(s * nd, P);
    for (int i = 0; i < s; ++i) {
      carried.middleRows(i * nv, nv) = s_p;
      for (const auto &chart : charts_)
        carried.middleRows(i * nv + chart.first, chart.size) = chart.Ad[i] * s_p.middleRows(chart.first, chart.size);
      closing.middleRows(i * nv, nv).noalias() = -N_[i] * rates_.middleRows(i * n + nv, nc);
    }
    if (nd) {
      y.noalias() = by_p_ * (carried - closing) + by_v_ * s_v;
      for (int i = 0; i < s; ++i)
        y.middleRows(i * nd, nd) -= Z_[i].transpose() * rates_.middleRows(i * n, nv) + stiff_[i] * closing.middleRows(i * nv, nv);
      lu_.substitute(y.data(), P);
    }
    carried = closing - carried; // dP minus the carried part
    for (int i = 0; i < s && nd; ++i) carried.middleRows(i * nv, nv) += Z_[i] * y.middleRows(i * nd, nd);
    Mat dP = closing.bottomRows(nv), dV = X_ * carried, rhs = Mat::Zero(nv + nc, P);
    if (nd) dP += Z_[s - 1] * y.bottomRows(nd);
    rhs.bottomRows(nc) = end_rates_.middleRows(nv, nc) + end_.J * dP;
    end_.solve(rhs);
    dP -= rhs.topRows(nv);
    rhs.topRows(nv) = end_.M * dV - end_rates_.topRows(nv) - q_ * dP;
    rhs.bottomRows(nc) = -end_rates_.bottomRows(nc) - H_ * dP;
    end_.solve(rhs);
    end.resize(2 * nv, P);
    end << dP, rhs.topRows(nv);
  }

  // The transpose, of one column; adds to `rates`, (P).
  void backward(const Vec &end, Vec &start, Eigen::Ref<Vec> rates) {
    const int nv = system_.nv, nc = system_.nc, nd = nv - nc, s = stages_.size();
    Vec both = Vec::Zero(nv + nc), of_p = Vec::Zero(nv + nc);
    both.head(nv) = end.tail(nv);
    end_.solve_transposed(both);
    const auto up = both.head(nv), low = both.tail(nc);
    of_p.head(nv) = end.head(nv) - q_.transpose() * up - H_.transpose() * low;
    const Vec s_p = of_p.head(nv);
    end_.solve_transposed(of_p);
    const Vec phi = -of_p.tail(nc), of_v = X_.transpose() * (end_.M * up);
    Vec dP = of_v, y(s * nd);
    dP.tail(nv) += s_p + end_.J.transpose() * phi;
    Vec weights = Vec::Zero(nv + 2 * nc);
    weights.head(nv) = -up;
    contract(gap_, Vec::Zero(nc), weights, rates);
    weights << up, phi, -low;
    contract(zero_, -nu_, weights, rates);
    weights.setZero();
    Vec carried = -of_v;
    start.setZero(2 * nv);
    if (nd) {
      for (int i = 0; i < s; ++i) y.segment(i * nd, nd) = Z_[i].transpose() * dP.segment(i * nv, nv);
      lu_.substitute_transposed(y.data());
      const Vec back = by_p_.transpose() * y;
      carried += back;
      dP -= back;
      start.tail(nv) = by_v_.transpose() * y;
    }
    for (int i = 0; i < s; ++i) {
      auto closing = dP.segment(i * nv, nv);
      if (nd) {
        const auto part = y.segment(i * nd, nd);
        closing -= stiff_[i].transpose() * part;
        weights.head(nv) = -Z_[i] * part;
      }
      weights.segment(nv, nc) = -N_[i].transpose() * closing;
      see(i);
      parameters_.contract(at_, stage_p_, stage_v_, stage_w_, residuals_with(L_.col(i)), weights, rates);
      Vec own = carried.segment(i * nv, nv);
      for (const auto &chart : charts_)
        own.segment(chart.first, chart.size) = chart.Ad[i].transpose() * carried.segment(i * nv + chart.first, chart.size);
      start.head(nv) += own;
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

  bool set_stages() {
    const int s = stages_.size(), nv = system_.nv, nc = system_.nc, nd = nv - nc;
    const Mat b = stages_.table->inverse / stages_.h, b2 = stages_.table->inverse2 / (stages_.h * stages_.h);
    for (auto *all : {&Z_, &N_, &stiff_}) all->resize(s);
    L_.resize(nc, s);
    by_p_.resize(s * nd, s * nv);
    by_v_.resize(s * nd, nv);
    Mat M, D, K, F, YM, YD;
    for (int i = 0; i < s; ++i) {
      see(i);
      system_.evaluate_parts(at_, stage_p_, stage_v_, stage_w_, M, D, K);
      if (!split(system_.G_transposed(), Z_[i], N_[i])) return false;
      L_.col(i) = N_[i].transpose() * system_.f;
      rows_.find(at_, stage_p_, stage_v_, L_.col(i), F, unused_);
      YM = Z_[i].transpose() * M;
      YD = Z_[i].transpose() * D;
      stiff_[i] = Z_[i].transpose() * (K - F);
      by_v_.middleRows(i * nd, nd) = b.row(i).sum() * YM;
      for (int j = 0; j < s; ++j) {
        auto block = by_p_.block(i * nd, j * nv, nd, nv);
        block = b2(i, j) * YM + b(i, j) * YD;
        for (const auto &c : charts_)
          block.middleCols(c.first, c.size) =
              YM.middleCols(c.first, c.size) * c.dW.block(i * c.size, j * c.size, c.size, c.size) +
              YD.middleCols(c.first, c.size) * c.X.block(i * c.size, j * c.size, c.size, c.size);
      }
    }
    if (!nd) return true;
    matrix_.resize(s * nd, s * nd);
    for (int i = 0; i < s; ++i)
      for (int j = 0; j < s; ++j)
        matrix_.block(i * nd, j * nd, nd, nd).noalias() =
            (by_p_.block(i * nd, j * nv, nd, nv) + (i == j ? stiff_[i] : Mat::Zero(nd, nv))) * Z_[j];
    if (lu_.size() != s * nd) lu_ = LU(s * nd);
    return lu_.factorise(matrix_);
  }

  bool set_end() {
    const int nv = system_.nv, nc = system_.nc;
    Mat M, D, K, F, x = Mat::Zero(nv + nc, 1);
    system_.evaluate_parts(t_, p_, v_, gap_, M, D, K);
    if (!end_.set(t_, p_, v_, zero_)) return false;
    x.bottomRows(nc) = end_.J * gap_;
    end_.solve(x);
    nu_ = x.bottomRows(nc);
    rows_.find(t_, p_, v_, nu_, F, H_);
    q_ = K - end_.K - F;
    return true;
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

  // Rates of the stages, and of the end, with q instead of r.
  void find_rates(int nv, int nc, int s) {
    const int P = parameters_.size(), n = nv + 2 * nc;
    rates_.setZero(s * n, P);
    for (int i = 0; i < s; ++i) {
      see(i);
      parameters_.add_columns(at_, stage_p_, stage_v_, stage_w_, residuals_with(L_.col(i)), rates_.middleRows(i * n, n));
    }
    Mat moved = Mat::Zero(n, P);
    parameters_.add_columns(t_, p_, v_, gap_, residuals_with(Vec::Zero(nc)), moved);
    end_rates_.setZero(n, P);
    parameters_.add_columns(t_, p_, v_, zero_, residuals_with(-nu_), end_rates_);
    end_rates_.topRows(nv) = moved.topRows(nv) - end_rates_.topRows(nv);
  }

  // Z spans the null space of J, and J N = 1; false if rows depend on each other.
  static bool split(const Mat &J, Mat &Z, Mat &N) {
    const Eigen::Index nc = J.rows(), nv = J.cols();
    if (!nc) {
      Z.setIdentity(nv, nv);
      N.resize(nv, 0);
      return true;
    }
    const Eigen::HouseholderQR<Mat> qr(J.transpose());
    const Mat Q = qr.householderQ() * Mat::Identity(nv, nv);
    Z = Q.rightCols(nv - nc);
    const Mat R = qr.matrixQR().topRows(nc).triangularView<Eigen::Upper>();
    if (!(R.diagonal().cwiseAbs().minCoeff() > 0.0)) return false;
    N = R.triangularView<Eigen::Upper>().solve(Q.leftCols(nc).transpose()).transpose();
    return true;
  }

  const Parameters &parameters_;
  System &system_;
  Stages stages_;
  RowGradients rows_;
  StatePoint end_;
  LU lu_;
  double t_ = 0.0, at_ = 0.0;
  Vec p_, v_, gap_, zero_, nu_, stage_p_, stage_v_, stage_w_, xi_;
  Mat X_, L_, by_p_, by_v_, matrix_, q_, H_, unused_, rates_, end_rates_;
  std::vector<Mat> Z_, N_, stiff_;
  std::vector<Chart> charts_;
};

} // namespace pinconsist
