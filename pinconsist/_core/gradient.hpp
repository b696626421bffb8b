// Derivatives propagated along the accepted steps of BDF; the formulas are in linear.hpp.
#pragma once

#include "bdf.hpp"
#include "kkt.hpp"
#include "linear.hpp"

namespace pinconsist {

using Integers = Eigen::VectorX<std::int64_t>;

// Recorded steps from one start to the next, a row for each, the history first.
struct Leg {
  Vec t, h;
  Integers k;
  Table base, Z;    // of Z (ROWS, nx+nv+nc) each
  Integers changes; // index of the change before the step in `changed`, (ROWS, ROWS) each; -1 without a change
  Table changed;

  int steps() const { return static_cast<int>(t.size()) - 1; }
  Eigen::Map<const Table> table(int i) const { return {Z.row(i).data(), bdf::ROWS, Z.cols() / bdf::ROWS}; }
  bool has_changes(int i) const { return changes[i] >= 0; }
  Eigen::Map<const Table> changes_before(int i) const { return {changed.row(changes[i]).data(), bdf::ROWS, bdf::ROWS}; }
};

// The linear equations of one accepted step.
class LinearStep {
public:
  LinearStep(System &system, const Parameters &parameters)
      : parameters_(parameters), system_(system), kkt_(system.nv, system.nc, false), rows_(system) {}

  // At step `i` of a leg; false if the matrix is singular.
  bool set(const Leg &leg, int i) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc, k = static_cast<int>(leg.k[i]);
    const auto Z = leg.table(i);
    t_ = leg.t[i];
    c_ = leg.h[i] / bdf::alpha(k);
    const Vec y = Z.row(0).transpose();
    p_ = y.head(nx);
    if (!system_.vector_like) system_.integrate(leg.base.row(i).transpose(), y.head(nx), p_);
    v_ = y.segment(nx, nv);
    lam_ = y.tail(nc);
    a_.setZero(nv);
    for (int j = 1; j <= k; ++j) a_ += Z.row(j).segment(nx, nv).transpose() / (j * leg.h[i]);
    system_.evaluate_parts(t_, p_, v_, a_, M_, f_v_, B_);
    W_ = WE_ = system_.W;
    Gt_ = system_.G_transposed();
    rows_.find(t_, p_, v_, lam_, F_, H_);
    B_ = c_ * (B_ - F_);
    if (!system_.curved.empty()) {
      system_.bracket(v_, E_);
      E_ = Mat::Identity(nx, nx) + 0.5 * c_ * E_;
      for (auto [first, n] : system_.curved) {
        const Mat own = E_.block(first, first, n, n).inverse();
        E_.block(first, first, n, n) = own;
        B_.middleCols(first, n) *= own;
        WE_.middleCols(first, n) *= own;
      }
    }
    kkt_.A() = M_ + c_ * f_v_ + c_ * B_;
    rhs_.setZero(nv + nc, 0);
    return kkt_.solve_new(WE_, Gt_, c_, rhs_, 0);
  }

  // s from the derivatives of ψ, a column (ξ, v, λ) for each parameter; the part of λ is not read.
  void forward(const Mat &psi, Mat &s) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc, P = static_cast<int>(psi.cols());
    rates_.setZero(nv + 2 * nc, P);
    parameters_.add_columns(t_, p_, v_, a_, residuals_with(lam_), rates_);
    const auto x = psi.topRows(nx);
    rhs_.resize(nv + nc, P);
    rhs_.topRows(nv) = -c_ * rates_.topRows(nv) - B_ * x + M_ * psi.middleRows(nx, nv);
    rhs_.bottomRows(nc) = -(rates_.middleRows(nv, nc) + WE_ * x) / c_;
    kkt_.solve(rhs_, c_, P);
    s.resize(nx + nv + nc, P);
    s.bottomRows(nv + nc) = rhs_;
    moved_ = x + c_ * rhs_.topRows(nv);
    if (E_.size()) moved_ = (E_ * moved_).eval();
    s.topRows(nx) = moved_;
    rhs_.bottomRows(nc) = rates_.bottomRows(nc) + H_ * moved_ + W_ * rhs_.topRows(nv);
    rhs_.topRows(nv).setZero();
    kkt_.solve(rhs_, c_, P);
    s.bottomRows(nv + nc) -= rhs_;
  }

  // The transpose of `forward` for one column; y becomes the derivative by ψ, with zeros for λ; adds to `rates`, (P).
  void backward(Vec &y, Eigen::Ref<Vec> rates) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc;
    Vec x = y.head(nx), rest = -y.tail(nv + nc), weights(nv + 2 * nc);
    kkt_.solve_transposed(rest);
    weights.tail(nc) = rest.tail(nc);
    x += H_.transpose() * rest.tail(nc);
    const Vec moved = E_.size() ? Vec(E_.transpose() * x) : x;
    y.segment(nx, nv) += W_.transpose() * rest.tail(nc) + c_ * moved;
    rest = y.tail(nv + nc);
    kkt_.solve_transposed(rest);
    weights.head(nv + nc) << -c_ * rest.head(nv), -rest.tail(nc) / c_;
    parameters_.contract(t_, p_, v_, a_, residuals_with(lam_), weights, rates);
    y.head(nx) = moved - B_.transpose() * rest.head(nv) - WE_.transpose() * rest.tail(nc) / c_;
    y.segment(nx, nv) = M_.transpose() * rest.head(nv);
    y.tail(nc).setZero();
  }

private:
  const Parameters &parameters_;
  System &system_;
  KKT kkt_;
  RowGradients rows_;
  double t_ = 0.0, c_ = 1.0;
  Vec p_, v_, a_, lam_;
  Mat M_, B_, H_, E_, W_, WE_; // E only if joints are curved; W of the constraints
  Mat F_, f_v_, Gt_, rates_, rhs_, moved_;
};

// The recursion over a leg: tables S, (ROWS, P (nx+nv+nc)) each, row by row. Both directions return the index of the
// singular step, or -1.
class Derivatives : public Way {
public:
  explicit Derivatives(System &system) : Way(system), step_(system, parameters) {}

  // Fill the tables (1+n), starting from the first.
  int forward(const Leg &leg, Eigen::Map<Table> tables) {
    const int P = parameters.size(), ny = system_.nx + system_.nv + system_.nc;
    Table S = Eigen::Map<const Table>(tables.data(), bdf::ROWS, P * ny);
    Vec predicted, psi;
    Mat s;
    for (int i = 1; i <= leg.steps(); ++i) {
      const int k = static_cast<int>(leg.k[i]);
      if (leg.has_changes(i)) S = (leg.changes_before(i) * S).eval();
      if (!system_.curved.empty()) recenter(leg, i, S, k + 2, P);
      bdf::extrapolate(k, S, predicted, psi);
      if (!step_.set(leg, i)) return i - 1;
      step_.forward(Eigen::Map<const Mat>(psi.data(), ny, P), s);
      bdf::advance(k, Eigen::Map<const Vec>(s.data(), s.size()) - predicted, S);
      Eigen::Map<Table>(tables.row(i).data(), bdf::ROWS, P * ny) = S;
    }
    return -1;
  }

  // The transpose: `seeds`, (ROWS, nx+nv+nc) each, are the partial derivatives of a result by each table; the first becomes
  // the total derivative by the table of the history, and `rates`, (P), that by the parameters.
  int backward(const Leg &leg, Eigen::Map<Table> seeds, Eigen::Map<Vec> rates) {
    rates.setZero();
    const auto seed = [&](int i) { return Eigen::Map<Table>(seeds.row(i).data(), bdf::ROWS, seeds.cols() / bdf::ROWS); };
    Vec y;
    for (int i = leg.steps(); i > 0; --i) {
      const int k = static_cast<int>(leg.k[i]);
      Table B = seed(i);
      for (int j = 0; j <= k; ++j) B.row(j + 1) += B.row(j); // the transpose of bdf::advance
      const Eigen::RowVectorXd newest = B.row(k + 2);
      y = (B.row(k + 1) + newest).transpose();
      B.row(k + 1) = -newest;
      B.row(k + 2).setZero();
      const Eigen::RowVectorXd predicted = -y.transpose();
      if (!step_.set(leg, i)) return i - 1;
      step_.backward(y, rates);
      for (int j = 0; j <= k; ++j) B.row(j) += predicted + (1.0 - bdf::gamma(j) / bdf::alpha(k)) * y.transpose();
      if (!system_.curved.empty()) recenter(leg, i, B, k + 2, 1, true);
      if (leg.has_changes(i)) B = (leg.changes_before(i).transpose() * B).eval();
      seed(i - 1) += B;
    }
    return -1;
  }

private:
  // Transform S from the chart of the previous step to that of step `i`, or apply the transpose.
  void recenter(const Leg &leg, int i, Table &S, int rows, int P, bool back = false) {
    const int nx = system_.nx, ny = nx + system_.nv + system_.nc;
    Table Z = leg.table(i - 1).leftCols(nx);
    if (leg.has_changes(i)) Z = (leg.changes_before(i) * Z).eval();
    const Vec base = leg.base.row(i - 1), centre = leg.base.row(i);
    const Mat D = bdf::differences(rows - 1), way = back ? Mat(D.transpose()) : D;
    const Table past = D * Z.topRows(rows);
    Table carried = way * S.topRows(rows);
    Vec there(system_.npos), xi(nx);
    Mat T, T_new;
    for (int j = 0; j < rows; ++j) {
      system_.integrate(base, past.row(j).transpose(), there);
      system_.difference(centre, there, xi);
      system_.chart_matrix(past.row(j).transpose(), T);
      system_.chart_matrix(xi, T_new);
      for (auto [first, size] : system_.curved) {
        Mat block = T_new.block(first, first, size, size) * T.block(first, first, size, size).inverse();
        if (back) block.transposeInPlace();
        for (int q = 0; q < P; ++q) {
          auto part = carried.row(j).segment(q * ny + first, size);
          part = (block * part.transpose()).transpose().eval();
        }
      }
    }
    for (auto [first, size] : system_.curved)
      for (int q = 0; q < P; ++q)
        S.block(0, q * ny + first, rows, size) = way * carried.middleCols(q * ny + first, size);
  }

  LinearStep step_;
};

} // namespace pinconsist
