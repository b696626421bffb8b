// The block matrix [[A, -c G], [W, 0]]: workspace, factors, solutions.
#pragma once

#include "lanes.hpp"

#include <Eigen/Dense>

#include <cmath>
#include <utility>
#include <vector>

namespace pinconsist {

// SciPy's LAPACK, which `load` lets Python pass when it is first needed; it is faster for LARGE or more unknowns. Its solve wakes the threads of OpenBLAS
// even for a microsecond's work, and is used only for SLOW solutions.
struct Lapack {
  using Factorise = void (*)(int *, int *, double *, int *, int *, int *);
  using Solve = void (*)(char *, int *, int *, double *, int *, int *, double *, int *, int *);
  static inline Factorise factorise = nullptr;
  static inline Solve solve = nullptr;
  static inline void (*load)() = nullptr;
  // To be called where matrices of this size will be factorised: the import takes too long in the middle of a run.
  static void prepare(int unknowns) {
    if (unknowns >= LARGE && !factorise) load();
  }
  static constexpr int LARGE = 45, SLOW = 100000; // unknowns; squared, times right-hand sides
};

// Factors of a square matrix, with row pivots.
class LU {
public:
  explicit LU(int n) : n_(n), lu_(n, n), inverses_(n), pivots_(n) { Lapack::prepare(n); }

  int size() const { return n_; }

  // False if the matrix is singular.
  bool factorise(const Eigen::MatrixXd &matrix) {
    lu_ = matrix;
    return factorise_numbers();
  }

  // The same of a matrix that was written to `numbers`, column by column.
  double *numbers() { return lu_.data(); }
  bool factorise_numbers() {
    if (n_ >= Lapack::LARGE) {
      int n = n_, info = 0;
      Lapack::factorise(&n, &n, lu_.data(), &n, pivots_.data(), &info);
      if (info == 0) inverses_ = lu_.diagonal().cwiseInverse();
      return info == 0;
    }
    return lanes::kernel().factorise(lu_.data(), n_, pivots_.data(), inverses_.data());
  }

  // The logarithm of the determinant's size, and whether it is negative.
  std::pair<double, bool> determinant() const {
    double size = 0.0;
    bool odd = false;
    for (int k = 0; k < n_; ++k) {
      size += std::log(std::abs(lu_(k, k)));
      odd ^= (lu_(k, k) < 0.0) ^ (pivots_[k] != k + 1);
    }
    return {size, odd};
  }

  void substitute(double *x, int columns) const {
    if (n_ < Lapack::LARGE || static_cast<double>(n_) * n_ * columns < Lapack::SLOW) {
      lanes::kernel().substitute(lu_.data(), n_, pivots_.data(), inverses_.data(), x, columns);
    } else {
      char plain = 'N';
      int n = n_, info = 0;
      Lapack::solve(&plain, &n, &columns, const_cast<double *>(lu_.data()), &n, const_cast<int *>(pivots_.data()), x, &n,
                    &info);
    }
  }

  // x = A⁻ᵀ x
  void substitute_transposed(double *x) const {
    for (int k = 0; k < n_; ++k) {
      for (int i = 0; i < k; ++i) x[k] -= lu_(i, k) * x[i];
      x[k] /= lu_(k, k);
    }
    for (int k = n_; k-- > 0;)
      for (int i = k + 1; i < n_; ++i) x[k] -= lu_(i, k) * x[i];
    for (int k = n_; k-- > 0;) std::swap(x[k], x[pivots_[k] - 1]);
  }

private:
  int n_;
  Eigen::MatrixXd lu_;
  Eigen::VectorXd inverses_; // of its diagonal: divisions are slow
  std::vector<int> pivots_;
};

class KKT {
public:
  KKT(int nv, int nc) : nv_(nv), n_(nv + nc), K_(Eigen::MatrixXd::Zero(n_, n_)), lu_(n_) {}

  Eigen::Ref<Eigen::MatrixXd> A() { return K_.topLeftCorner(nv_, nv_); }

  // Fill in c G and W, factorise and solve in place; false if the matrix is singular.
  bool solve_new(const Eigen::MatrixXd &W, const Eigen::MatrixXd &Gt, double c, Eigen::MatrixXd &rhs) {
    const int nc = n_ - nv_;
    K_.topRightCorner(nv_, nc) = -c * Gt.transpose();
    K_.bottomLeftCorner(nc, nv_) = W;
    c_ = c;
    if (!lu_.factorise(K_)) return false;
    solve(rhs, c);
    return true;
  }

  // x = K⁻¹ x with the last factors. If c differs from theirs, the unknowns that K multiplies with c G are scaled.
  void solve(Eigen::MatrixXd &x, double c) const {
    lu_.substitute(x.data(), static_cast<int>(x.cols()));
    if (c != c_) x.bottomRows(n_ - nv_) *= c_ / c;
  }

  // x = K⁻ᵀ x with the last factors and their c.
  void solve_transposed(Eigen::VectorXd &x) const { lu_.substitute_transposed(x.data()); }

private:
  int nv_, n_;
  Eigen::MatrixXd K_;
  LU lu_;
  double c_ = 1.0;
};

} // namespace pinconsist
