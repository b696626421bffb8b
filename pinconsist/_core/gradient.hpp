// gradients/linear.py and gradients/forward.py: derivatives propagated along the accepted steps of a run.
#pragma once

#include "bdf.hpp"
#include "kkt.hpp"
#include "parameters.hpp"
#include "row_gradients.hpp"

namespace pinconsist {

// Recorded steps from one start to the next; Python's arrays, an entry for each step, the history first.
struct Leg {
  int steps;
  const double *t, *h, *base, *Z; // (1+n), (1+n), (1+n, npos), (1+n, ROWS, nx+nv+nc)
  const int64_t *k;
  std::vector<int> changed; // the steps with `changes`, (ROWS, ROWS) each, ascending
  const double *changes;
};

// The linear equations of one accepted step.
class LinearStep {
public:
  Parameters parameters;
  double c = 1.0;
  // E only if joints are curved; W of the constraints.
  Mat M, B, H, E, W, WE;

  explicit LinearStep(System &system) : system_(system), kkt_(system.nv, system.nc, false), rows_(system) {}

  // The state (t, p, v, a, λ) at step `i` of a leg.
  void visit(const Leg &leg, int i) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc, k = static_cast<int>(leg.k[i]);
    const Eigen::Map<const Table> Z(leg.Z + static_cast<long>(i) * bdf::ROWS * (nx + nv + nc), bdf::ROWS, nx + nv + nc);
    const double h = leg.h[i];
    t_ = leg.t[i];
    c = h / bdf::alpha(k);
    const Vec y = Z.row(0).transpose();
    p_ = y.head(nx);
    if (!system_.vector_like) system_.integrate(Eigen::Map<const Vec>(leg.base + static_cast<long>(i) * system_.npos, system_.npos), y.head(nx), p_);
    v_ = y.segment(nx, nv);
    lam_ = y.tail(nc);
    a_.setZero(nv);
    for (int j = 1; j <= k; ++j) a_ += Z.row(j).segment(nx, nv).transpose() / (j * h);
  }

  // At step `i` of a leg; false if the matrix is singular.
  bool set(const Leg &leg, int i) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc;
    visit(leg, i);
    system_.evaluate_parts(t_, p_, v_, a_, M, f_v_, B);
    W = WE = system_.W;
    Gt_ = system_.G_transposed();
    rows_.find(t_, p_, v_, lam_, F_, H);
    B = c * (B - F_);
    if (!system_.curved.empty()) {
      system_.bracket(v_, E);
      E = Mat::Identity(nx, nx) + 0.5 * c * E;
      for (auto [first, n] : system_.curved) {
        const Mat own = E.block(first, first, n, n).inverse();
        E.block(first, first, n, n) = own;
        B.middleCols(first, n) *= own;
        WE.middleCols(first, n) *= own;
      }
    }
    kkt_.A() = M + c * f_v_ + c * B;
    rhs_.setZero(nv + nc, 0);
    return kkt_.solve_new(WE, Gt_, c, rhs_, 0);
  }

  // s from the derivatives of ψ, a column (ξ, v, λ) for each parameter; the part of λ is not read.
  void forward(const Mat &psi, Mat &s) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc, P = static_cast<int>(psi.cols());
    r_.setZero(nv, P);
    phi_.setZero(nc, P);
    rho_.setZero(nc, P);
    parameters.add_columns(t_, p_, v_, a_, lam_, r_, phi_, rho_);
    const auto x = psi.topRows(nx);
    rhs_.resize(nv + nc, P);
    rhs_.topRows(nv) = -c * r_ - B * x + M * psi.middleRows(nx, nv);
    rhs_.bottomRows(nc) = -(phi_ + WE * x) / c;
    kkt_.solve(rhs_, c, P);
    s.resize(nx + nv + nc, P);
    s.bottomRows(nv + nc) = rhs_;
    moved_ = x + c * rhs_.topRows(nv);
    if (E.size()) moved_ = (E * moved_).eval();
    s.topRows(nx) = moved_;
    rhs_.bottomRows(nc) = rho_ + H * moved_ + W * rhs_.topRows(nv);
    rhs_.topRows(nv).setZero();
    kkt_.solve(rhs_, c, P);
    s.bottomRows(nv + nc) -= rhs_;
  }

  // The transpose of `forward`, of one column: y becomes the derivative by ψ, its last part zero; adds to `rates`, (P).
  void backward(Vec &y, Eigen::Ref<Vec> rates) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc;
    Vec x = y.head(nx), rest = -y.tail(nv + nc);
    kkt_.solve_transposed(rest);
    const Vec hidden = rest.tail(nc);
    x += H.transpose() * rest.tail(nc);
    const Vec moved = E.size() ? Vec(E.transpose() * x) : x;
    y.segment(nx, nv) += W.transpose() * rest.tail(nc) + c * moved;
    rest = y.tail(nv + nc);
    kkt_.solve_transposed(rest);
    parameters.contract(t_, p_, v_, a_, lam_, -c * rest.head(nv), -rest.tail(nc) / c, hidden, rates);
    y.head(nx) = moved - B.transpose() * rest.head(nv) - WE.transpose() * rest.tail(nc) / c;
    y.segment(nx, nv) = M.transpose() * rest.head(nv);
    y.tail(nc).setZero();
  }

private:
  System &system_;
  KKT kkt_;
  RowGradients rows_;
  double t_ = 0.0;
  Vec p_, v_, a_, lam_;
  Mat F_, f_v_, Gt_, r_, phi_, rho_, rhs_, moved_;
};

// The recursion over a leg: tables S, (ROWS, P (nx+nv+nc)) each, row by row.
class Derivatives {
public:
  explicit Derivatives(System &system) : step(system), system_(system) {}

  LinearStep step;

  // Fill the tables (1+n) from the first; returns the number of the singular step, or -1.
  int forward(const Leg &leg, double *tables) {
    const int P = step.parameters.size(), ny = system_.nx + system_.nv + system_.nc;
    const long size = static_cast<long>(bdf::ROWS) * P * ny;
    Table S = Eigen::Map<const Table>(tables, bdf::ROWS, P * ny);
    Vec predicted, psi;
    Mat s;
    for (int i = 1, change = 0; i <= leg.steps; ++i) {
      const bool changed = change < static_cast<int>(leg.changed.size()) && leg.changed[change] == i - 1;
      const double *changes = changed ? leg.changes + static_cast<long>(change++) * bdf::ROWS * bdf::ROWS : nullptr;
      if (changes) S = (Eigen::Map<const Table>(changes, bdf::ROWS, bdf::ROWS) * S).eval();
      const int k = static_cast<int>(leg.k[i]);
      if (!system_.curved.empty()) recenter(leg, i, changes, S, k + 2, P);
      bdf::extrapolate(k, S, predicted, psi);
      if (!step.set(leg, i)) return i - 1;
      step.forward(Eigen::Map<const Mat>(psi.data(), ny, P), s);
      bdf::advance(k, Eigen::Map<const Vec>(s.data(), s.size()) - predicted, S);
      Eigen::Map<Table>(tables + i * size, bdf::ROWS, P * ny) = S;
    }
    return -1;
  }

  // The transpose: `seeds`, (1+n, ROWS, nx+nv+nc), are the derivatives of a number by each table; the first becomes that by
  // the table of the history, with all that follows from it. `rates`, (P), becomes that by the parameters.
  int backward(const Leg &leg, double *seeds, double *rates) {
    const int ny = system_.nx + system_.nv + system_.nc;
    Eigen::Map<Vec> total(rates, step.parameters.size());
    total.setZero();
    const long size = static_cast<long>(bdf::ROWS) * ny;
    Vec y;
    for (int i = leg.steps, change = static_cast<int>(leg.changed.size()); i > 0; --i) {
      const bool changed = change > 0 && leg.changed[change - 1] == i - 1;
      const double *changes = changed ? leg.changes + static_cast<long>(--change) * bdf::ROWS * bdf::ROWS : nullptr;
      const int k = static_cast<int>(leg.k[i]);
      Table B = Eigen::Map<const Table>(seeds + i * size, bdf::ROWS, ny);
      for (int j = 0; j <= k; ++j) B.row(j + 1) += B.row(j); // the transpose of bdf::advance
      const Eigen::RowVectorXd newest = B.row(k + 2);
      y = (B.row(k + 1) + newest).transpose();
      B.row(k + 1) = -newest;
      B.row(k + 2).setZero();
      const Eigen::RowVectorXd predicted = -y.transpose();
      if (!step.set(leg, i)) return i - 1;
      step.backward(y, total);
      for (int j = 0; j <= k; ++j) B.row(j) += predicted + (1.0 - bdf::gamma(j) / bdf::alpha(k)) * y.transpose();
      if (!system_.curved.empty()) recenter(leg, i, changes, B, k + 2, 1, true);
      if (changes) B = (Eigen::Map<const Table>(changes, bdf::ROWS, bdf::ROWS).transpose() * B).eval();
      Eigen::Map<Table>(seeds + (i - 1) * size, bdf::ROWS, ny) += B;
    }
    return -1;
  }

private:
  // Carry S from the chart of the step before to that of step `i`, or the transpose.
  void recenter(const Leg &leg, int i, const double *changes, Table &S, int rows, int P, bool back = false) {
    const int nx = system_.nx, ny = nx + system_.nv + system_.nc;
    Table Z = Eigen::Map<const Table>(leg.Z + static_cast<long>(i - 1) * bdf::ROWS * ny, bdf::ROWS, ny).leftCols(nx);
    if (changes) Z = (Eigen::Map<const Table>(changes, bdf::ROWS, bdf::ROWS) * Z).eval();
    const Vec base = Eigen::Map<const Vec>(leg.base + static_cast<long>(i - 1) * system_.npos, system_.npos);
    const Vec centre = Eigen::Map<const Vec>(leg.base + static_cast<long>(i) * system_.npos, system_.npos);
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

  System &system_;
};

} // namespace pinconsist
