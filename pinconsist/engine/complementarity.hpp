// engine/complementarity.py: which contacts push, which part, which stick, and by how much.
#pragma once

#include "tuning.hpp"

#include <Eigen/Dense>

#include <limits>
#include <optional>
#include <utility>
#include <vector>

namespace pinconsist {

using Vec = Eigen::VectorXd;
using Mat = Eigen::MatrixXd;

// A push at an index; or a grip at `size` indices from `at` on, with a limit, or `friction` times the push at `of`.
struct Law {
  int at, size;
  bool pushes;
  double limit, friction;
  int of;
};

// z with u = A z + b that fulfil the laws, and what is left of them, relative to b.
class Complementarity {
public:
  Vec z;
  double left = 0.0;

  Complementarity(const Mat &A, const Vec &b, std::vector<Law> laws) : laws_(std::move(laws)) {
    const auto n = b.size();
    z = Vec::Zero(n);
    const double size = n ? b.cwiseAbs().maxCoeff() : 0.0;
    if (size == 0.0) return;
    scale(A, b);
    Vec best = z;
    left = std::numeric_limits<double>::infinity();
    const auto take = [&](const Vec &from) {
      const auto [found, residual] = newton(from);
      if (residual < left) {
        left = residual;
        best = found;
      }
      return left <= ENOUGH_LEFT;
    };
    Vec swept = sweep(z, static_cast<int>(SWEEPS));
    bool solved = take(swept);
    if (!solved) {
      if (const auto found = by_pivots()) solved = take(*found) || left <= WELL_LEFT;
    }
    for (int round = 0; !solved && round < static_cast<int>(ROUNDS); ++round) {
      swept = sweep(swept, static_cast<int>(SWEEPS) << (round + 2));
      solved = take(swept);
    }
    z = best.cwiseProduct(scale_) * size_;
  }

private:
  static double in_disc(double length, double radius) { return length <= radius ? 1.0 : radius / length; }

  // Unknowns with a diagonal of about 1, and b of at most 1; a disc stays a disc.
  void scale(const Mat &A, const Vec &b) {
    const auto n = b.size();
    const Vec diagonal = A.diagonal();
    const double bar = NO_RESPONSE * diagonal.cwiseAbs().maxCoeff();
    scale_ = Vec::Ones(n);
    for (Eigen::Index i = 0; i < n; ++i)
      if (diagonal[i] > bar) scale_[i] = 1.0 / std::sqrt(diagonal[i]);
    for (const Law &law : laws_)
      if (!law.pushes && law.size) scale_.segment(law.at, law.size).setConstant(scale_.segment(law.at, law.size).minCoeff());
    b_ = b.cwiseProduct(scale_);
    size_ = b_.cwiseAbs().maxCoeff();
    b_ /= size_;
    A_ = scale_.asDiagonal() * A * scale_.asDiagonal();
    rho_ = Vec::Ones(n);
    for (Law &law : laws_) {
      if (!law.pushes) {
        law.limit /= scale_[law.at] * size_;
        if (law.of >= 0) law.friction *= scale_[law.of] / scale_[law.at];
      }
      const double own = law.pushes ? A_(law.at, law.at) : A_.block(law.at, law.at, law.size, law.size).cwiseAbs().rowwise().sum().maxCoeff();
      rho_.segment(law.at, law.size).setConstant(std::min(1.0 / std::max(own, NO_RESPONSE), LONGEST_RHO));
    }
  }

  double radius(const Law &law, const Vec &z) const { return law.of >= 0 ? law.friction * std::max(z[law.of], 0.0) : law.limit; }

  // Projected Gauss-Seidel.
  Vec sweep(Vec z, int sweeps) const {
    Vec before;
    for (int k = 0; k < sweeps; ++k) {
      before = z;
      for (const Law &law : laws_) {
        auto own = z.segment(law.at, law.size);
        const Vec y = own - rho_[law.at] * (A_.middleRows(law.at, law.size) * z + b_.segment(law.at, law.size));
        if (law.pushes) own = y.cwiseMax(0.0);
        else own = in_disc(y.norm(), radius(law, z)) * y;
      }
      if (!(z.cwiseAbs().maxCoeff() < DIVERGED)) return before;
      if ((z - before).cwiseAbs().maxCoeff() <= 1e-15 * (1.0 + z.cwiseAbs().maxCoeff())) break;
    }
    return z;
  }

  // Semismooth Newton on z − projection(z − ρ u); with the largest residual that is left.
  std::pair<Vec, double> newton(Vec z) const {
    Vec F, F1;
    Mat J, J1;
    natural(z, F, J);
    double left = F.cwiseAbs().maxCoeff();
    for (int k = 0; k < static_cast<int>(NEWTON_TURNS) && left > 0.1 * ENOUGH_LEFT && J.allFinite(); ++k) {
      Eigen::CompleteOrthogonalDecomposition<Mat> factors;
      factors.setThreshold(1e-12);
      factors.compute(J);
      const Vec step = factors.solve(-F);
      bool better = false;
      for (double part = 1.0; part > 1e-4 && !better; part *= 0.5) {
        const Vec trial = z + part * step;
        natural(trial, F1, J1);
        better = F1.cwiseAbs().maxCoeff() < (1.0 - 1e-4 * part) * left;
        if (better) z = trial;
      }
      if (!better) break;
      F.swap(F1);
      J.swap(J1);
      left = F.cwiseAbs().maxCoeff();
    }
    return {z, left};
  }

  void natural(const Vec &z, Vec &F, Mat &J) const {
    const auto n = z.size();
    const Vec y = z - rho_.cwiseProduct(A_ * z + b_);
    const Mat dy = Mat::Identity(n, n) - rho_.asDiagonal() * A_;
    F = z;
    J = Mat::Identity(n, n);
    for (const Law &law : laws_) {
      const int i = law.at, k = law.size;
      if (law.pushes) {
        if (y[i] > 0.0) {
          F[i] -= y[i];
          J.row(i) -= dy.row(i);
        }
        continue;
      }
      const bool presses = law.of >= 0 && y[law.of] > 0.0;
      const double limit = law.of < 0 ? law.limit : presses ? law.friction * y[law.of] : 0.0, length = y.segment(i, k).norm();
      if (length <= limit) {
        F.segment(i, k) -= y.segment(i, k);
        J.middleRows(i, k) -= dy.middleRows(i, k);
      } else if (length > 0.0) {
        const Vec way = y.segment(i, k) / length;
        F.segment(i, k) -= limit * way;
        if (presses) J.middleRows(i, k) -= law.friction * way * dy.row(law.of);
        const Mat across = (Mat::Identity(k, k) - way * way.transpose()) * (limit / length);
        J.middleRows(i, k) -= across * dy.middleRows(i, k);
      }
    }
  }

  // Lemke's method for the linear problem with forces of grips along a few directions; nothing if it finds no solution.
  std::optional<Vec> by_pivots() const {
    std::vector<Vec> forces; // the unknowns that act, as columns of z
    std::vector<int> grips, first; // of forces along directions: their law; where the directions of each law begin
    const auto n = b_.size();
    for (const Law &law : laws_)
      if (law.pushes) forces.push_back(Vec::Unit(n, law.at));
    const int pushes = static_cast<int>(forces.size());
    std::vector<const Law *> gripping;
    for (const Law &law : laws_) {
      if (law.pushes) continue;
      const int ways = law.size == 1 ? 2 : static_cast<int>(DIRECTIONS);
      first.push_back(static_cast<int>(forces.size()));
      for (int k = 0; k < ways; ++k) {
        Vec way = Vec::Zero(n);
        const double angle = 2.0 * M_PI * k / ways;
        way[law.at] = law.size == 1 ? 1.0 - 2.0 * k : std::cos(angle);
        if (law.size == 2) way[law.at + 1] = std::sin(angle);
        forces.push_back(way);
      }
      gripping.push_back(&law);
    }
    first.push_back(static_cast<int>(forces.size()));
    const int acting = static_cast<int>(forces.size()), g = static_cast<int>(gripping.size()), size = acting + g;
    Mat D(n, acting);
    for (int k = 0; k < acting; ++k) D.col(k) = forces[k];
    Mat M = Mat::Zero(size, size);
    Vec q = Vec::Zero(size);
    M.topLeftCorner(acting, acting) = D.transpose() * A_ * D;
    q.head(acting) = D.transpose() * b_;
    for (int j = 0; j < g; ++j) {
      const Law &law = *gripping[j];
      const int begin = first[j], end = first[j + 1];
      M.block(begin, acting + j, end - begin, 1).setOnes();
      M.block(acting + j, begin, 1, end - begin).setConstant(-1.0);
      if (law.of < 0) q[acting + j] = law.limit;
      for (int k = 0; k < pushes; ++k)
        if (law.of >= 0 && forces[k][law.of] == 1.0) M(acting + j, k) = law.friction;
    }
    Vec x;
    if (!lemke(M, q, x)) return {};
    return Vec(D * x.head(acting));
  }

  // x ≥ 0 with M x + q ≥ 0 and xᵀ(M x + q) = 0, by complementary pivots with lexicographic ratios.
  static bool lemke(const Mat &M, const Vec &q, Vec &x) {
    const int n = static_cast<int>(q.size()), extra = 2 * n;
    x = Vec::Zero(n);
    if (q.minCoeff() >= 0.0) return true;
    Mat T(n, 2 * n + 2); // w, x, the artificial unknown, right-hand side
    T << Mat::Identity(n, n), -M, Vec::Constant(n, -1.0), q;
    std::vector<int> basis(n);
    for (int i = 0; i < n; ++i) basis[i] = i;
    int row, entering = extra;
    q.minCoeff(&row);
    for (int turn = 0; turn < static_cast<int>(PIVOTS) * n; ++turn) {
      T.row(row) /= T(row, entering);
      for (int i = 0; i < n; ++i)
        if (i != row && T(i, entering) != 0.0) T.row(i) -= T(i, entering) * T.row(row);
      const int leaving = std::exchange(basis[row], entering);
      if (leaving == extra) {
        for (int i = 0; i < n; ++i)
          if (basis[i] >= n && basis[i] < extra) x[basis[i] - n] = T(i, extra + 1);
        return true;
      }
      entering = leaving < n ? leaving + n : leaving - n;
      row = -1;
      for (int i = 0; i < n; ++i)
        if (T(i, entering) > PIVOT && (row < 0 || before(T, i, row, entering, basis[i] == extra, basis[row] == extra))) row = i;
      if (row < 0) return false;
    }
    return false;
  }

  static bool before(const Mat &T, int i, int j, int entering, bool i_ends, bool j_ends) {
    const auto n = T.rows();
    const double a = T(i, 2 * n + 1) / T(i, entering), b = T(j, 2 * n + 1) / T(j, entering);
    if (std::abs(a - b) > 1e-14 * (1.0 + std::abs(a))) return a < b;
    if (i_ends != j_ends) return i_ends;
    for (Eigen::Index k = 0; k < n; ++k) {
      const double x = T(i, k) / T(i, entering), y = T(j, k) / T(j, entering);
      if (std::abs(x - y) > 1e-14 * (1.0 + std::abs(x))) return x < y;
    }
    return false;
  }

  std::vector<Law> laws_;
  Mat A_;
  Vec b_, scale_, rho_;
  double size_ = 1.0;
};

// z and what is left of the laws. With `shared`, unknowns that depend on each other have those forces, of many, that equal small
// compliances give: by a proximal point method, which takes the compliances off again.
struct ComplementaritySolution {
  Vec z;
  double left;
};

inline ComplementaritySolution solution(const Mat &A, const Vec &b, const std::vector<Law> &laws, bool shared) {
  if (!shared) {
    const Complementarity found(A, b, laws);
    return {found.z, found.left};
  }
  constexpr double SHARES = 1e-6;  // compliance of what shares a load, relative to their own responses
  constexpr double SETTLED = 1e-12; // relative change of z at which they are found
  constexpr int TURNS = 6;
  Vec compliance = Vec::Zero(b.size());
  for (const Law &law : laws)
    compliance.segment(law.at, law.size).setConstant(SHARES * std::max(A.diagonal().cwiseAbs().maxCoeff(), 1e-300));
  const Mat stiff = A + Mat(compliance.asDiagonal());
  ComplementaritySolution now{Vec::Zero(b.size()), 0.0};
  for (int turn = 0; turn < TURNS && b.size(); ++turn) {
    const Vec last = now.z;
    const Complementarity found(stiff, b - compliance.cwiseProduct(last), laws);
    const double yields = compliance.cwiseProduct(found.z - last).cwiseAbs().maxCoeff() / std::max(b.cwiseAbs().maxCoeff(), 1e-300);
    now = {found.z, std::max(found.left, yields)};
    if ((now.z - last).cwiseAbs().maxCoeff() <= SETTLED * now.z.cwiseAbs().maxCoeff()) break;
  }
  return now;
}

} // namespace pinconsist
