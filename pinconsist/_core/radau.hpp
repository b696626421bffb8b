// dae/radau.py: the stage equations of Radau IIA, by Newton in the null space of the constraints.
#pragma once

#include "newton.hpp"

namespace pinconsist {

// What dae/radau.py computes of the formula with s stages.
struct RadauTable {
  int s = 0;
  Vec c;
  Mat A, inverse, inverse2, modes; // modes: to the coefficients of Legendre polynomials
  double leading = 0.0;            // how far rounding of stage positions reaches the highest coefficient, times h²
};

// out = x weightsᵀ: combinations of a few columns.
inline void combine(const Mat &x, const Mat &weights, Mat &out) {
  const Eigen::Index n = x.rows(), s = weights.rows();
  out.resize(n, s);
  for (Eigen::Index i = 0; i < s; ++i) {
    double *sum = out.data() + i * n;
    for (Eigen::Index j = 0; j < s; ++j) {
      const double weight = weights(i, j), *column = x.data() + j * n;
      if (j == 0)
        for (Eigen::Index k = 0; k < n; ++k) sum[k] = weight * column[k];
      else
        for (Eigen::Index k = 0; k < n; ++k) sum[k] += weight * column[k];
    }
  }
}

constexpr int SMALL_PRODUCT = 10; // below which products need no temporaries

// out = a b
template <class A, class B, class Out> void multiply(const A &a, const B &b, Out &&out) {
  if (a.cols() < SMALL_PRODUCT) out = a.lazyProduct(b);
  else out.noalias() = a * b;
}

// J x = -φ by complete pivoting: all solutions are x = Z y + closing.
class Elimination {
public:
  void resize(int nc, int nv) {
    nc_ = nc;
    nv_ = nv;
    E_.resize(nv + 1, nc);
  }

  // With `choose` other dependent columns may be chosen than last time. False where J loses its rank.
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

private:
  static constexpr double STEEPEST = 10.0; // of the dependent columns by the others, from which others are chosen

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

  int nc_ = 0, nv_ = 0;
  Mat E_; // a row of J and its φ lie together
  std::vector<int> order_;
};

// The stages of one step, a column for each, and Newton's iteration on them.
class StageNewton {
public:
  long nfev = 0, njev = 0, nlu = 0;
  // Where a step found something that is not finite.
  double culprit_t = 0.0;
  Vec culprit_p, culprit_v;
  // Start and size of the step; accelerations, velocities, positions p ⊕ ξ.
  const RadauTable *table = nullptr;
  double t = 0.0, h = 0.0;
  Vec p, v;
  Mat W, V, xi, P;
  double rate = 0.0; // contraction of the iteration, 0 if one was enough
  int iterations = 0;

  StageNewton(System &system, const Switches &switches)
      : system_(system), interpolate_(switches.few_derivatives), eager_(switches.iteration_forecast) {}

  // Rates of ξ.
  const Mat &rates() const { return system_.rate_is_velocity && system_.curved.empty() ? V : U_; }

  // M near the end of the step, where it is known.
  const Mat *mass_at_end() const { return interpolate_ && symmetric() ? &M_.back() : nullptr; }

  double time(int i) const { return t + h * table->c[i]; }

  // Another number of stages.
  void use(const RadauTable &formula) {
    table = &formula;
    const int s = formula.s, nv = system_.nv, nc = system_.nc, nd = nv - nc;
    for (Mat *matrix : {&W, &V, &f_, &closing_, &dP_, &dV_, &along_, &twice_}) matrix->setZero(nv, s);
    xi.setZero(system_.nx, s);
    P.resize(system_.npos, s);
    for (auto *all : {&Z_, &Y_}) all->assign(s, Mat::Zero(nv, nd));
    for (auto *all : {&M_, &D_, &K_, &T_, &T_inverse_}) all->assign(s, Mat::Zero(nv, nv));
    for (auto *all : {&right_, &left_}) {
      all->resize(s);
      for (auto &one : *all) one.resize(nc, nv);
    }
    lu_ = LU(s * nd);
    matrix_.resize(s * nd, s * nd);
    y_.resize(s * nd);
    where_.clear();
    for (int i : {s > 5 ? 1 : 0, (s - 1) / 2 + (s > 5 ? 0 : 0), s - 1}) where_.push_back(i);
    theta_ = 0.0;
  }

  void forget() { theta_ = 0.0; }

  // Iterate from the accelerations W to the solution. `weight` are reciprocal tolerances of [ξ | v].
  Failure solve(const Vec &weight, double tol) {
    const int s = table->s;
    const double floor = 20.0 * EPS * s * s / std::abs(h);
    double last = 0.0;
    bool fresh = true;
    rate = 0.0;
    xi.setZero();
    if (!move()) return fail();
    for (iterations = 1; iterations <= MAX_STAGE_ITERATIONS; ++iterations) {
      fresh = iterations == 1 || rate > FRESH_RATE;
      if (!evaluate(fresh)) return Failure::singular;
      if (fresh) {
        njev += s;
        ++nlu;
        if (!factorise()) return Failure::singular;
      }
      solve_increments();
      const double size = size_of(weight);
      if (!std::isfinite(size)) return fail();
      if (iterations > 1) rate = size / last;
      const double to_come = iterations == 1 ? size : rate < 1.0 ? size * rate / (1.0 - rate) : INF;
      const double before = largest(V);
      combine(dV_, table->inverse, along_);
      W += along_ / h;
      if (!move()) return fail();
      const double reach = 1.0 + largest(P.col(s - 1)), step = largest(dV_);
      if (iterations > 1) theta_ = std::max(rate, 0.3 * theta_);
      const bool eager = eager_ && iterations == 1 && theta_ > 0.0 && theta_ < 1.0 && size < EAGER &&
                         theta_ * size < (1.0 - theta_) * tol;
      if (std::min(size, to_come) <= tol || eager || step <= floor * reach) return Failure::none;
      const double noise = rate > STAGNANT ? STAGNATED : LAST;
      if (iterations > 1 && step <= noise * (before + largest(v) + step) && largest(dP_) <= 1e4 * EPS * reach)
        return Failure::none;
      if (iterations > 2 && rate > 2.0) return Failure::diverged;
      last = size;
    }
    return Failure::not_converged;
  }

private:
  static constexpr double EAGER = 30.0;

  Failure fail() {
    culprit_t = t + h;
    culprit_p = p;
    culprit_v = v;
    return Failure::not_finite;
  }

  // Velocities and positions of the accelerations W; rates that depend on positions by substitution.
  bool move() {
    const int s = table->s;
    combine(W, table->A, V);
    V = (h * V).colwise() + v;
    if (system_.rate_is_velocity && system_.curved.empty()) {
      combine(V, table->A, xi);
      xi *= h;
      place();
      return xi.allFinite();
    }
    U_.resize(system_.nx, s);
    for (int sweep = 0; sweep < MAX_SWEEPS; ++sweep) {
      place();
      for (int i = 0; i < s; ++i) {
        p_ = P.col(i);
        v_ = V.col(i);
        U_.col(i) = system_.chart_rate(p, p_, system_.rate(time(i), p_, v_));
      }
      before_ = xi;
      combine(U_, table->A, xi);
      xi *= h;
      if (!(largest(xi - before_) > 4.0 * EPS * (1.0 + largest(xi)))) break;
    }
    place();
    return xi.allFinite();
  }

  void place() {
    if (system_.vector_like) {
      P = xi.colwise() + p;
      return;
    }
    for (int i = 0; i < table->s; ++i) {
      xi_ = xi.col(i);
      system_.integrate(p, xi_, p_);
      P.col(i) = p_;
    }
  }

  // Residuals and null spaces of all stages, with derivatives where wanted; false where constraints lose their rank.
  bool evaluate(bool fresh) {
    const int s = table->s;
    const bool few = interpolate_ && s > 3;
    nfev += s;
    for (int i = 0; i < s; ++i) {
      p_ = P.col(i);
      v_ = V.col(i);
      w_ = W.col(i);
      const bool here = fresh && (!few || std::find(where_.begin(), where_.end(), i) != where_.end());
      if (here) system_.evaluate_parts(time(i), p_, v_, w_, M_[i], D_[i], K_[i]);
      else system_.evaluate(time(i), p_, v_, w_);
      f_.col(i) = system_.f;
      const Mat &J = system_.velocity_jacobian(time(i), p_, v_);
      if (!right_[i].reduce(J, system_.phi, fresh, Z_[i], closing_.col(i))) return false;
      if (!symmetric()) {
        spare_.resize(system_.nv);
        if (!left_[i].reduce(system_.G_transposed(), system_.phi, fresh, Y_[i], spare_)) return false;
      }
      if (fresh && !system_.curved.empty()) {
        system_.chart_matrix(p, p_, T_[i]);
        T_inverse_[i].setIdentity();
        for (auto [first, size] : system_.curved)
          T_inverse_[i].block(first, first, size, size) = T_[i].block(first, first, size, size).inverse();
      }
    }
    if (fresh && few) interpolate();
    return true;
  }

  // M, D and K of the other stages by the parabola through three.
  void interpolate() {
    const Vec &c = table->c;
    for (int i = 0; i < table->s; ++i) {
      if (std::find(where_.begin(), where_.end(), i) != where_.end()) continue;
      double l[3];
      for (int m = 0; m < 3; ++m) {
        l[m] = 1.0;
        for (int n = 0; n < 3; ++n)
          if (n != m) l[m] *= (c[i] - c[where_[n]]) / (c[where_[m]] - c[where_[n]]);
      }
      for (auto *all : {&M_, &D_, &K_})
        (*all)[i] = l[0] * (*all)[where_[0]] + l[1] * (*all)[where_[1]] + l[2] * (*all)[where_[2]];
    }
  }

  bool symmetric() const { return &system_.G_transposed() == &system_.W; }
  const Mat &left(int i) const { return symmetric() ? Z_[i] : Y_[i]; }

  bool factorise() {
    const int s = table->s, nd = system_.nv - system_.nc;
    const Mat &b = table->inverse, &b2 = table->inverse2;
    if (!nd) return true;
    YM_.resize(nd, system_.nv);
    YD_.resize(nd, system_.nv);
    YK_.resize(nd, nd);
    for (int i = 0; i < s; ++i) {
      multiply(left(i).transpose(), M_[i], YM_);
      multiply(left(i).transpose(), D_[i], YD_);
      YD_ *= h;
      for (int j = 0; j < s; ++j) {
        row_ = b2(i, j) * YM_ + b(i, j) * YD_;
        if (!system_.curved.empty()) turn(i, j);
        multiply(row_, Z_[j], YK_);
        matrix_.block(i * nd, j * nd, nd, nd) = YK_;
      }
      multiply(left(i).transpose(), K_[i], row_);
      multiply(row_, Z_[i], YK_);
      matrix_.block(i * nd, i * nd, nd, nd) += h * h * YK_;
    }
    return lu_.factorise(matrix_);
  }

  // In a chart dV is T_i⁻¹ b_ij T_j dP, and dW is b times it.
  void turn(int i, int j) {
    const Mat &b = table->inverse;
    for (auto [first, size] : system_.curved) {
      Mat part = Mat::Zero(YM_.rows(), size);
      for (int k = 0; k < table->s; ++k)
        part += b(i, k) * b(k, j) * YM_.middleCols(first, size) * T_inverse_[k].block(first, first, size, size);
      part += b(i, j) * YD_.middleCols(first, size) * T_inverse_[i].block(first, first, size, size);
      row_.middleCols(first, size) = part * T_[j].block(first, first, size, size);
    }
  }

  // out_i = T_i⁻¹ Σ_j b_ij T_j x_j: h dV of dP.
  void along(const Mat &x, Mat &out) {
    if (system_.curved.empty()) {
      combine(x, table->inverse, out);
      return;
    }
    turned_ = x;
    for (int i = 0; i < table->s; ++i)
      for (auto [first, size] : system_.curved)
        turned_.col(i).segment(first, size) = T_[i].block(first, first, size, size) * x.col(i).segment(first, size);
    combine(turned_, table->inverse, out);
    for (int i = 0; i < table->s; ++i)
      for (auto [first, size] : system_.curved)
        out.col(i).segment(first, size) =
            (T_inverse_[i].block(first, first, size, size) * out.col(i).segment(first, size)).eval();
  }

  // dP and dV with the constraint directions of this iteration.
  void solve_increments() {
    const int s = table->s, nd = system_.nv - system_.nc;
    dP_ = closing_;
    if (nd) {
      along(closing_, along_);
      combine(along_, table->inverse, twice_);
      for (int i = 0; i < s; ++i) {
        w_ = h * h * f_.col(i);
        w_ += M_[i].lazyProduct(twice_.col(i));
        w_ += h * D_[i].lazyProduct(along_.col(i));
        w_ += h * h * K_[i].lazyProduct(closing_.col(i));
        y_.segment(i * nd, nd) = -left(i).transpose().lazyProduct(w_);
      }
      lu_.substitute(y_.data(), 1);
      for (int i = 0; i < s; ++i) dP_.col(i) += Z_[i].lazyProduct(y_.segment(i * nd, nd));
    }
    along(dP_, dV_);
    dV_ /= h;
  }

  // Root mean square over the stages of the weighted increments.
  double size_of(const Vec &weight) const {
    const int nx = system_.nx, nv = system_.nv;
    double sum = 0.0;
    const double most = nx == nv || !nx ? 0.0 : weight.head(nx).maxCoeff();
    for (int i = 0; i < table->s; ++i) {
      sum += dV_.col(i).cwiseProduct(weight.tail(nv)).squaredNorm();
      sum += nx == nv ? dP_.col(i).cwiseProduct(weight.head(nx)).squaredNorm() : most * most * dP_.col(i).squaredNorm();
    }
    return std::sqrt(sum / std::max(1, table->s * nv));
  }

  System &system_;
  bool interpolate_, eager_;
  LU lu_{0};
  Mat f_, closing_, dP_, dV_, along_, twice_, turned_, U_, before_, YM_, YD_, YK_, row_, matrix_;
  std::vector<Mat> Z_, Y_, M_, D_, K_, T_, T_inverse_;
  std::vector<Elimination> right_, left_;
  std::vector<int> where_; // stages with derivatives of their own
  Vec p_, v_, w_, xi_, y_, spare_;
  double theta_ = 0.0;
};

} // namespace pinconsist
