// Null spaces of constraints, and products of small matrices.
#pragma once

#include "kkt.hpp"
#include "system.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace pinconsist {

// out = scale x weightsᵀ: combinations of a few columns.
inline void combine(const Mat &x, const Mat &weights, Mat &out, double scale = 1.0) {
  const int n = static_cast<int>(x.rows()), columns = static_cast<int>(x.cols()), rows = static_cast<int>(weights.rows());
  out.resize(n, rows);
  lanes::kernel().combine(x.data(), n, columns, weights.data(), rows, scale, out.data());
}

// C = A B; the columns of C may be some rows of a larger matrix.
inline void product(const Mat &A, Eigen::Ref<const Mat> B, Eigen::Ref<Mat> C) {
  const int n = static_cast<int>(A.rows()), k = static_cast<int>(A.cols()), m = static_cast<int>(B.cols());
  lanes::kernel().product(A.data(), n, k, B.data(), static_cast<int>(B.outerStride()), m, C.data(), static_cast<int>(C.outerStride()));
}

// aᵀ b, with its columns `apart` numbers from one another.
inline void across(const Mat &a, const Mat &b, double *out, Eigen::Index apart) {
  const Eigen::Index n = a.rows();
  if (n >= SMALL_PRODUCT) {
    Eigen::Map<Mat, 0, Eigen::OuterStride<>>(out, a.cols(), b.cols(), Eigen::OuterStride<>(apart)).noalias() = a.transpose() * b;
    return;
  }
  for (Eigen::Index j = 0; j < b.cols(); ++j)
    for (Eigen::Index i = 0; i < a.cols(); ++i) {
      const double *x = a.data() + i * n, *y = b.data() + j * n;
      double sum = 0.0;
      for (Eigen::Index k = 0; k < n; ++k) sum += x[k] * y[k];
      out[j * apart + i] = sum;
    }
}

// Slope of the dependent velocities by the others above which others are chosen.
inline constexpr double STEEPEST = 10.0;

// J x = -φ by complete pivoting: all solutions are x = Z y + closing.
class Elimination {
public:
  Elimination(int nc, int nv) : nc_(nc), nv_(nv), E_(nv + 1, nc) {}

  // With `choose`, other dependent columns may be chosen than last time. False if J loses its rank.
  template <class Phi> bool reduce(const Mat &J, const Phi &phi, bool choose, Mat &Z, Eigen::Ref<Vec> closing) {
    const bool kept = static_cast<int>(order_.size()) == nv_;
    if (!(kept && echelon(J, phi, false) && (!choose || steep() <= STEEPEST)) && !(choose && echelon(J, phi, true)))
      return false;
    for (int k = 0; k < nc_; ++k) {
      for (int j = nc_; j < nv_; ++j) Z(order_[k], j - nc_) = -E_(j, k);
      closing[order_[k]] = -E_(nv_, k);
    }
    for (int j = nc_; j < nv_; ++j) {
      Z.row(order_[j]).setZero();
      Z(order_[j], j - nc_) = 1.0;
      closing[order_[j]] = 0.0;
    }
    return true;
  }

  // The dependent columns, then the others.
  const std::vector<int> &order() const { return order_; }
  // Try those of another one first.
  void follow(const Elimination &other) { order_ = other.order_; }
  // The same of its columns; empty: all are chosen anew.
  void follow(const std::vector<int> &order) { order_ = order; }

private:
  double steep() const {
    double most = 0.0;
    for (int k = 0; k < nc_; ++k)
      for (int j = nc_; j < nv_; ++j) most = std::max(most, std::abs(E_(j, k)));
    return most;
  }

  // The reduced row echelon form, with row pivots, or with complete pivots that choose the columns.
  template <class Phi> bool echelon(const Mat &J, const Phi &phi, bool choose) {
    if (choose) {
      order_.resize(nv_);
      for (int j = 0; j < nv_; ++j) order_[j] = j;
    }
    for (int i = 0; i < nc_; ++i) {
      for (int j = 0; j < nv_; ++j) E_(j, i) = J(i, order_[j]);
      E_(nv_, i) = phi[i];
    }
    const double least = EPS * largest(J);
    for (int k = 0; k < nc_; ++k) {
      int row = k, column = k;
      double most = -1.0;
      for (int i = k; i < nc_; ++i)
        for (int j = k; j < (choose ? nv_ : k + 1); ++j)
          if (std::abs(E_(j, i)) > most) most = std::abs(E_(j, i)), row = i, column = j;
      if (!(most > least)) return false;
      if (column != k) {
        std::swap(order_[k], order_[column]);
        for (int i = 0; i < nc_; ++i) std::swap(E_(k, i), E_(column, i));
      }
      double *pivot = &E_(0, k);
      if (row != k) std::swap_ranges(pivot + k, pivot + nv_ + 1, &E_(k, row));
      const double inverse = 1.0 / pivot[k];
      for (int j = k + 1; j <= nv_; ++j) pivot[j] *= inverse;
      for (int i = 0; i < nc_; ++i) {
        double *other = &E_(0, i);
        const double factor = other[k];
        if (i == k || factor == 0.0) continue;
        for (int j = k + 1; j <= nv_; ++j) other[j] -= factor * pivot[j];
      }
    }
    return true;
  }

  int nc_, nv_;
  Mat E_; // a row of J and its φ are adjacent
  std::vector<int> order_;
};

// The null space of J and a right inverse, with the dependent velocities of another one where they suit.
class NullSpace {
public:
  Mat Z, N; // J Z = 0 with unit rows of the free velocities, J N = 1 with zero rows

  NullSpace(int nc, int nv) : nc_(nc), nv_(nv), lu_(nc), columns_(nc, nc), rest_(nc, nv - nc), spare_(nv) {
    Z.setZero(nv, nv - nc);
  }

  // False if rows depend on each other.
  bool set(const Mat &J, const NullSpace *like = nullptr) {
    if (!nc_) {
      Z.setIdentity();
      return true;
    }
    if (like) order_ = like->order_;
    if (!order_.empty() && solved(J) && largest(rest_) <= STEEPEST) return true;
    Elimination fresh(nc_, nv_); // complete pivots
    if (!fresh.reduce(J, Vec::Zero(nc_), true, Z, spare_)) return false;
    order_ = fresh.order();
    return solved(J);
  }

  void find_right_inverse() {
    N.setZero(nv_, nc_);
    columns_.setIdentity();
    lu_.substitute(columns_.data(), nc_);
    for (int k = 0; k < nc_; ++k) N.row(order_[k]) = columns_.row(k);
  }

  // λ with the dependent entries of Jᵀ λ = f.
  void multipliers(const Vec &f, Eigen::Ref<Vec> lam) const {
    for (int k = 0; k < nc_; ++k) lam[k] = f[order_[k]];
    if (nc_) lu_.substitute_transposed(lam.data());
  }

private:
  bool solved(const Mat &J) {
    for (int k = 0; k < nc_; ++k) columns_.col(k) = J.col(order_[k]);
    for (int k = nc_; k < nv_; ++k) rest_.col(k - nc_) = J.col(order_[k]);
    if (!lu_.factorise(columns_)) return false;
    lu_.substitute(rest_.data(), nv_ - nc_);
    Z.setZero();
    for (int k = 0; k < nc_; ++k) Z.row(order_[k]) = -rest_.row(k);
    for (int k = nc_; k < nv_; ++k) Z(order_[k], k - nc_) = 1.0;
    return true;
  }

  int nc_, nv_;
  LU lu_;
  Mat columns_, rest_;
  Vec spare_;
  std::vector<int> order_; // dependent velocities, then free ones
};

} // namespace pinconsist
