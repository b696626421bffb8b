// Newton's matrix of the stages by the eigenvalues of A⁻¹, for systems with many degrees of freedom.
//
// With M, D, K and the null space of one stage for all, and A⁻¹ = T Λ T⁻¹, the equations of the stages come apart:
//
//     (λ² M + h λ D + h² K) w = r,    y = (T ⊗ 1) w,    r = (T⁻¹ ⊗ 1) (right-hand sides),
//
// for one real λ, if s is odd, and (s - 1)/2 of the conjugate pairs: n³ (1 + 8 (s - 1)/2) multiplications for (s n)³. The
// residuals are those of each stage, so the solution is the same; Newton contracts by what the stages differ.
//
// References
// ----------
// E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.8.
#pragma once

#include "stages.hpp"

namespace pinconsist {

class StageBlocks {
public:
  static constexpr int LEAST = 32; // degrees of freedom above which they cost less than the whole matrix

  void use(const RadauTable &table, int n) {
    table_ = &table;
    n_ = n;
    factors_.clear();
    for (Eigen::Index m = 0; m < table.eigenvalues.cols(); ++m) factors_.emplace_back(is_real(m) ? n : 2 * n);
  }

  // From M, D and K (n × n) of one stage; false if a block is singular.
  bool factorise(double h, const Mat &M, const Mat &D, const Mat &K) {
    for (Eigen::Index m = 0; m < table_->eigenvalues.cols(); ++m) {
      const double a = table_->eigenvalues(0, m), b = table_->eigenvalues(1, m);
      const int size = factors_[m].size();
      Eigen::Map<Mat> block(factors_[m].numbers(), size, size);
      block.topLeftCorner(n_, n_) = (a * a - b * b) * M + (h * a) * D + (h * h) * K;
      if (!is_real(m)) {
        block.bottomLeftCorner(n_, n_) = (2.0 * a * b) * M + (h * b) * D;
        block.topRightCorner(n_, n_) = -block.bottomLeftCorner(n_, n_);
        block.bottomRightCorner(n_, n_) = block.topLeftCorner(n_, n_);
      }
      if (!factors_[m].factorise_numbers()) return false;
    }
    return true;
  }

  // In place: n unknowns of each stage, one stage after another or, if not `by_stage`, one unknown after another.
  void solve(double *unknowns, bool by_stage) {
    const int s = table_->s;
    if (by_stage) right_ = Eigen::Map<Mat>(unknowns, n_, s);
    else right_ = Eigen::Map<Mat>(unknowns, s, n_).transpose();
    solve_right();
    if (by_stage) Eigen::Map<Mat>(unknowns, n_, s) = y_;
    else Eigen::Map<Mat>(unknowns, s, n_) = y_.transpose();
  }

private:
  void solve_right() {
    y_.setZero(n_, table_->s);
    const Mat &to = table_->to_eigenvectors, &from = table_->eigenvectors; // real parts, then imaginary ones
    for (Eigen::Index m = 0; m < table_->eigenvalues.cols(); ++m) {
      w_.resize(factors_[m].size());
      w_.head(n_) = right_ * to.row(2 * m).transpose();
      if (!is_real(m)) w_.tail(n_) = right_ * to.row(2 * m + 1).transpose();
      factors_[m].substitute(w_.data(), 1);
      if (is_real(m)) {
        y_ += w_ * from.col(2 * m).transpose();
      } else { // and the conjugate one
        y_ += 2.0 * w_.head(n_) * from.col(2 * m).transpose();
        y_ -= 2.0 * w_.tail(n_) * from.col(2 * m + 1).transpose();
      }
    }
  }

  bool is_real(Eigen::Index m) const { return table_->eigenvalues(1, m) == 0.0; }

  const RadauTable *table_ = nullptr;
  int n_ = 0;
  std::vector<LU> factors_;
  Mat right_, y_;
  Vec w_;
};

} // namespace pinconsist
