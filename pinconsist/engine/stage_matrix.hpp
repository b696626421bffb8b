// Newton's matrix in the null space of the constraints, stage by stage.
#pragma once

#include "charts.hpp"
#include "kkt.hpp"
#include "stage_blocks.hpp"
#include "stages.hpp"
#include "state_lanes.hpp"

#include <tuple>

namespace pinconsist {

class StageMatrix {
  // The effect of dP on dV and dW of a joint in a chart, stage by stage.
  struct Chart {
    int first, size;
    Mat h_dV, h2_dW; // a column for each stage, of the blocks for dP of all stages
    std::vector<Mat> T;
    auto dV(int i, int j) const { return Eigen::Map<const Mat>(&h_dV(j * size * size, i), size, size); }
    auto dW(int i, int j) const { return Eigen::Map<const Mat>(&h2_dW(j * size * size, i), size, size); }
  };

  // M, D and K at a time.
  struct Known {
    double t = 0.0;
    Mat M, D, K;
  };
  static constexpr double NEAREST = 0.1, FARTHEST = 2.0; // how long ago the middle of the last step may be, in steps

public:
  double gap = 0.0; // of the loops that are not closed, at the stages evaluated last

  // What later steps depend on, of a system in lanes.
  struct Memory {
    Mat F_before;
    StateLanes::Choice choice;
    std::vector<std::vector<int>> orders;
    // Of a matrix that is kept.
    bool kept = false, rows_bend = false, in_blocks = false, filled = false;
    std::vector<double> derivatives;
    LU lu{0};
    StageBlocks blocks;
    std::vector<Chart> charts;
  };

  StageMatrix(System &system, const Stages &stages, const Switches &switches)
      : system_(system), stages_(stages), few_(switches.few_derivatives), may_lanes_(switches.lanes), with_rows_(switches.row_derivatives), lu_(0),
        dependent_(system.nc), columns_(system.nc, system.nc), lam_(system.nc) {
    Lapack::prepare(static_cast<int>(MOST_STAGES) * (system.nv - system.nc));
  }

  void use(int s) {
    const int nv = system_.nv, nc = system_.nc, nd = nv - nc;
    f_.resize(nv, s);
    for (auto *all : {&MY_, &DY_, &KY_, &row_}) all->resize(nv, nd);
    closing_.resize(nv, s);
    left_over_.resize(nv, 1);
    for (auto *all : {&Z_, &Y_}) all->assign(s, Mat::Zero(nv, nd));
    for (auto *all : {&M_, &D_, &K_}) all->assign(s, Mat::Zero(nv, nv));
    ad_.resize(s);
    charts_.clear();
    for (auto [first, size] : system_.curved) charts_.push_back({first, size, {}, {}, std::vector<Mat>(s)});
    for (auto *all : {&right_, &left_}) all->assign(s, Elimination(nc, nv));
    tree_ = may_lanes_ ? system_.in_lanes() : nullptr;
    if (tree_) states_.use(*tree_, s);
    times_.resize(s);
    may_part_ = nd > StageBlocks::LEAST && charts_.empty() && symmetric();
    in_blocks_ = false;
    if (may_part_) blocks_.use(*stages_.table, nd);
    lu_ = LU(may_part_ ? 0 : s * nd); // later if it is needed
    matrix_.resize(0, 0);
    y_.resize(s * nd);
  }

  // Forget earlier steps.
  void forget() {
    begun_ = false;
    middle_ = {};
    F_before_.resize(0, 0);
  }

  // The next step begins where this one ends.
  void accepted() {
    if (!tree_) {
      end_before_ = known(stages_.size() - 1);
      std::swap(middle_before_, middle_);
      if (rows_bend_) end_before_.K += F_;
      begun_ = true;
    }
    if (rows_bend_) F_before_ = F_;
    else F_before_.resize(0, 0);
  }

  // Residuals and null spaces, and derivatives if `fresh`; false if constraints lose their rank. The derivative of the
  // constraint forces is part of them where it is known, or if Newton is slow.
  bool evaluate(bool fresh, bool slow, long &derivatives) {
    const int s = stages_.size();
    gap = 0.0;
    if (tree_) return evaluate_lanes(fresh, slow, derivatives);
    for (int i = 0; i < s; ++i) {
      const double t = stages_.time(i);
      p_ = stages_.P.col(i);
      v_ = stages_.V.col(i);
      w_ = stages_.W.col(i);
      const bool with_derivatives = fresh && has_derivatives(i);
      derivatives += with_derivatives;
      if (with_derivatives) system_.evaluate_parts(t, p_, v_, w_, M_[i], D_[i], K_[i]);
      else system_.evaluate(t, p_, v_, w_);
      f_.col(i) = system_.f;
      // Loops closed to rounding are not closed further: if rows are nearly dependent, the position would move far.
      const double open = largest(system_.phi);
      if (open <= GAP_LEFT * (1.0 + largest(p_))) system_.phi.setZero();
      else gap = std::max(gap, open);
      const Mat &W = system_.velocity_jacobian(t, p_, v_);
      if (may_part_ && i && fresh) right_[i].follow(right_[0]);
      if (!right_[i].reduce(W, system_.phi, fresh, Z_[i], closing_.col(i))) return false;
      if (!symmetric()) {
        spare_.resize(system_.nv);
        if (!left_[i].reduce(system_.G_transposed(), system_.phi, fresh, Y_[i], spare_)) return false;
      }
      if (fresh && i == s - 1) rows_bend_ = differentiate_rows(slow, (symmetric() ? right_ : left_).back().order().data());
    }
    return true;
  }

  // After a step; `keeps` the matrix. Between `recall` and this, the memory of a matrix that was not renewed is the same.
  void remember(Memory &to, bool keeps) {
    to.F_before = F_before_;
    states_.remember(to.choice);
    to.orders.resize(right_.size() + left_.size());
    auto order = to.orders.begin();
    for (const auto *all : {&right_, &left_})
      for (const auto &each : *all) *order++ = each.order();
    to.kept = keeps && side_by_side_;
    if (!to.kept || !std::exchange(renewed_, false)) return;
    to.rows_bend = rows_bend_;
    to.in_blocks = in_blocks_;
    to.filled = states_.fields.filled;
    states_.remember_derivatives(to.derivatives);
    to.lu = lu_;
    to.blocks = blocks_;
    to.charts = charts_;
  }

  // Go on as after `remember`, with as many stages; an empty memory is that of a new matrix.
  void recall(const Memory &from) {
    F_before_ = from.F_before;
    states_.recall(from.choice);
    size_t order = 0;
    for (auto *all : {&right_, &left_})
      for (auto &each : *all) {
        each.follow(order < from.orders.size() ? from.orders[order] : std::vector<int>());
        ++order;
      }
    renewed_ = false;
    side_by_side_ = from.kept;
    if (!from.kept) return;
    rows_bend_ = from.rows_bend;
    if (rows_bend_) F_ = F_before_; // of the step in which it was factorised
    in_blocks_ = from.in_blocks;
    states_.recall_derivatives(from.derivatives);
    states_.fields.filled = from.filled;
    unpack(stages_.size() - 1);
    lu_ = from.lu;
    blocks_ = from.blocks;
    charts_ = from.charts;
    pack_charts();
  }

  // Whether later steps may be solved with the matrix that was factorised last.
  bool may_be_kept() const { return side_by_side_; }

  // With the last derivatives; false if it is singular.
  bool factorise() {
    if (side_by_side_) return factorise_lanes();
    interpolate();
    turn_charts();
    const int s = stages_.table->s, nv = system_.nv, nd = nv - system_.nc;
    const Mat &b = stages_.table->inverse, &b2 = stages_.table->inverse2;
    const double h = stages_.h, *MY = MY_.data(), *DY = DY_.data();
    const Mat &at_start = F_before_.size() ? F_before_ : F_;
    double *row = row_.data();
    if (!nd) return true;
    in_blocks_ = may_part_ && same_columns();
    if (in_blocks_) {
      const int middle = (s - 1) / 2;
      if (rows_bend_) K_[middle] -= at_start + stages_.table->c[middle] * (F_ - at_start);
      return factorise_blocks(middle);
    }
    make_room();
    for (int i = 0; i < s; ++i) {
      across(M_[i], left(i), MY_.data(), nv);
      across(D_[i], left(i), DY_.data(), nv);
      if (rows_bend_) K_[i] -= at_start + stages_.table->c[i] * (F_ - at_start);
      across(K_[i], left(i), KY_.data(), nv);
      for (int j = 0; j < s; ++j) {
        const double of_M = b2(i, j), of_D = h * b(i, j);
        for (int k = 0; k < nv * nd; ++k) row[k] = of_M * MY[k] + of_D * DY[k];
        for (const auto &chart : charts_)
          row_.middleRows(chart.first, chart.size) =
              chart.dW(i, j).transpose() * MY_.middleRows(chart.first, chart.size) +
              h * (chart.dV(i, j).transpose() * DY_.middleRows(chart.first, chart.size));
        if (i == j) row_ += h * h * KY_;
        across(row_, Z_[j], &matrix_(i * nd, j * nd), s * nd);
      }
    }
    return lu_.factorise(matrix_);
  }

  // dP and dV with the residuals and null spaces evaluated last.
  void solve(Mat &dP, Mat &dV) {
    const int s = stages_.size(), nv = system_.nv, nd = nv - system_.nc;
    const double h = stages_.h;
    if (side_by_side_) {
      solve_lanes(dP, dV);
      return;
    }
    dP = closing_;
    if (nd) {
      along(closing_, along_, 1.0 / h);
      combine(along_, stages_.table->inverse, twice_, 1.0 / h);
      for (int i = 0; i < s; ++i) {
        const double *M = M_[i].data(), *D = D_[i].data(), *K = K_[i].data();
        const double *dW = &twice_(0, i), *dV = &along_(0, i), *shift = &closing_(0, i);
        for (int r = 0; r < nv; ++r) {
          double sum = f_(r, i);
          for (int c = 0; c < nv; ++c) sum += M[r + c * nv] * dW[c] + D[r + c * nv] * dV[c] + K[r + c * nv] * shift[c];
          left_over_(r) = -h * h * sum;
        }
        across(left(i), left_over_, &y_[i * nd], nd);
      }
      substitute();
      for (int i = 0; i < s; ++i)
        for (int k = 0; k < nd; ++k) dP.col(i) += y_[i * nd + k] * Z_[i].col(k);
    }
    along(dP, dV, 1.0 / h);
  }

  // The part of dP that closes the loops, and the velocities of the rest.
  const Mat &closing() const { return closing_; }
  void free_velocities(const Mat &dP, Mat &dV) { along(dP - closing_, dV, 1.0 / stages_.h); }

  // M, D and K at the last stage.
  std::tuple<const Mat &, const Mat &, const Mat &> at_end() const { return {M_.back(), D_.back(), K_.back()}; }

private:
  // The same for all stages at once.
  bool evaluate_lanes(bool fresh, bool slow, long &derivatives) {
    const int s = stages_.size(), nv = system_.nv, nc = system_.nc;
    lanes::Fields &fields = states_.fields;
    for (int i = 0; i < s; ++i) {
      times_[i] = stages_.time(i);
      states_.set(i, &stages_.P(0, i), &stages_.V(0, i), &stages_.W(0, i));
    }
    system_.evaluate_lanes(times_, states_, fresh);
    if (fresh) derivatives += s;
    for (int i = 0; i < s; ++i) {
      spare_.resize(nc);
      states_.get(fields.phi, nc, i, spare_.data());
      const double open = largest(spare_);
      if (open <= GAP_LEFT * (1.0 + largest(stages_.P.col(i)))) states_.add(fields.phi, nc, i, spare_.data(), -1.0);
      else gap = std::max(gap, open);
    }
    if (fresh) side_by_side_ = states_.kernel().reduce(fields, states_.reduction, true);
    else if (side_by_side_ && !states_.kernel().reduce(fields, states_.reduction, false)) return false;
    if (!side_by_side_ && !separate(fresh)) return false;
    if (!fresh) return true;
    p_ = stages_.P.col(s - 1);
    v_ = stages_.V.col(s - 1);
    const int *order = side_by_side_ ? states_.reduction.order : right_.back().order().data();
    rows_bend_ = differentiate_rows(slow, order);
    return true;
  }

  // The stages one by one, where charts or different dependent velocities require it; false if constraints lose their rank.
  bool separate(bool fresh) {
    const int nv = system_.nv, nc = system_.nc;
    const lanes::Fields &fields = states_.fields;
    Mat transposed(nv, nc), J(nc, nv);
    Vec phi(nc);
    for (int i = 0; i < stages_.size(); ++i) {
      states_.get(fields.f, nv, i, &f_(0, i));
      states_.get(fields.phi, nc, i, phi.data());
      states_.get(fields.J, static_cast<long>(nc) * nv, i, transposed.data());
      J = transposed.transpose();
      if (!right_[i].reduce(J, phi, fresh, Z_[i], closing_.col(i))) return false;
      if (fresh) unpack(i);
    }
    return true;
  }

  void unpack(int i) {
    states_.get(states_.fields.M, i, M_[i]);
    states_.get(states_.fields.D, i, D_[i]);
    states_.get(states_.fields.K, i, K_[i]);
  }

  bool factorise_lanes() {
    renewed_ = true;
    const RadauTable &table = *stages_.table;
    const lanes::Kernel &kernel = states_.kernel();
    const Mat &at_start = F_before_.size() ? F_before_ : F_;
    if (rows_bend_) kernel.bend(states_.fields, system_.nv, table.s, table.c.data(), at_start.data(), F_.data());
    unpack(table.s - 1);
    turn_charts();
    if (system_.nv == system_.nc) return true;
    pack_charts();
    in_blocks_ = may_part_;
    if (in_blocks_) {
      const int middle = (table.s - 1) / 2;
      unpack(middle);
      null_space_in_lanes(middle);
      return factorise_blocks(middle);
    }
    make_room();
    kernel.assemble(states_.fields, states_.reduction, step(), lu_.numbers());
    return lu_.factorise_numbers();
  }

  // By M, D and K of a stage in its null space.
  bool factorise_blocks(int i) {
    const int nd = static_cast<int>(Z_[i].cols());
    for (auto [all, of] : {std::pair{&M_, 0}, {&D_, 1}, {&K_, 2}}) {
      parts_[of].resize(nd, nd);
      MY_.noalias() = (*all)[i] * Z_[i];
      parts_[of].noalias() = Z_[i].transpose() * MY_;
    }
    return blocks_.factorise(stages_.h, parts_[0], parts_[1], parts_[2]);
  }

  void substitute() {
    if (in_blocks_) blocks_.solve(y_.data(), !side_by_side_);
    else lu_.substitute(y_.data(), 1);
  }

  // For the whole matrix.
  void make_room() {
    const int size = stages_.size() * (system_.nv - system_.nc);
    if (lu_.size() != size) lu_ = LU(size);
    if (!side_by_side_) matrix_.resize(size, size);
  }

  // Whether all stages have the same dependent velocities.
  bool same_columns() const {
    return std::all_of(right_.begin(), right_.end(), [&](const auto &each) { return each.order() == right_[0].order(); });
  }

  // Z of a stage with the dependent velocities of all.
  void null_space_in_lanes(int i) {
    const int nv = system_.nv, nc = system_.nc;
    const int *order = states_.reduction.order;
    Mat transposed(nv, nc), rest(nc, nv - nc);
    states_.get(states_.fields.J, static_cast<long>(nc) * nv, i, transposed.data());
    for (int k = 0; k < nc; ++k) columns_.col(k) = transposed.row(order[k]).transpose();
    for (int k = nc; k < nv; ++k) rest.col(k - nc) = transposed.row(order[k]).transpose();
    if (nc && dependent_.factorise(columns_)) dependent_.substitute(rest.data(), nv - nc);
    Z_[i].setZero();
    for (int k = 0; k < nc; ++k) Z_[i].row(order[k]) = -rest.row(k);
    for (int k = nc; k < nv; ++k) Z_[i](order[k], k - nc) = 1.0;
  }

  lanes::Step step() const {
    const RadauTable &table = *stages_.table;
    return {table.s, stages_.h, table.inverse.data(), table.inverse2.data(), lane_charts_.data(), static_cast<int>(lane_charts_.size())};
  }

  void pack_charts() {
    const int s = stages_.size(), width = states_.kernel().width, packs = states_.fields.packs;
    lane_charts_.clear();
    chart_numbers_.resize(charts_.size());
    for (size_t at = 0; at < charts_.size(); ++at) {
      const Chart &chart = charts_[at];
      const long items = chart.size * chart.size, all = items * s * packs * width;
      auto &numbers = chart_numbers_[at];
      numbers.assign(2 * all + width, 0.0);
      double *first = numbers.data();
      while (reinterpret_cast<std::uintptr_t>(first) % (8 * width)) ++first;
      for (int i = 0; i < s; ++i)
        for (int j = 0; j < s; ++j) {
          const double *dV = &chart.h_dV(j * items, i), *dW = &chart.h2_dW(j * items, i);
          for (long k = 0; k < items; ++k) {
            const long to = (((i / width) * s + j) * items + k) * width + i % width;
            first[to] = dV[k];
            first[all + to] = dW[k];
          }
        }
      lane_charts_.push_back({chart.first, chart.size, first, first + all});
    }
  }

  void solve_lanes(Mat &dP, Mat &dV) {
    const RadauTable &table = *stages_.table;
    const lanes::Kernel &kernel = states_.kernel();
    const int nv = system_.nv;
    dP.resize(nv, table.s);
    if (nv > system_.nc) {
      kernel.right_side(states_.fields, states_.reduction, step(), y_.data());
      substitute();
    }
    kernel.increments(states_.fields, states_.reduction, table.s, y_.data(), dP.data(), closing_.data());
    along(dP, dV, 1.0 / stages_.h);
  }

  // Whether derivatives are evaluated at stage `i`: in the middle, at the end and, if the last step has none, near the start.
  bool has_derivatives(int i) const {
    const int last = stages_.size() - 1;
    return tree_ || !few_ || last < 3 || i == last / 2 || i == last || (i == 0 && !begun_);
  }

  // F = ∂(G λ)/∂p at the last stage, with the λ that balance the dependent velocities; false if it is left out.
  bool differentiate_rows(bool slow, const int *order) {
    const int nv = system_.nv, nc = system_.nc;
    if (!nc || nc == nv || !(with_rows_ || slow)) return false;
    for (int k = 0; k < nc; ++k) {
      columns_.row(k) = system_.G_transposed().col(order[k]).transpose();
      lam_[k] = system_.f[order[k]];
    }
    if (!dependent_.factorise(columns_)) return false;
    dependent_.substitute(lam_.data(), 1);
    F_.setZero(nv, system_.nx);
    const double t = stages_.time(stages_.size() - 1);
    with_rows_ = with_rows_ && system_.row_gradients(t, p_, v_, lam_, F_, none_); // whether they are known does not change
    if (with_rows_) return true;
    F_.setZero(nv, nv);
    if (slow) system_.subtract_force_gradient(t, p_, v_, lam_, 1.0, F_);
    F_ = -F_;
    return slow;
  }

  // M, D and K of the other stages, from polynomials in t through those of stages, the start and, if it is known, the
  // middle of the last step.
  void interpolate() {
    const int s = stages_.table->s, middle = (s - 1) / 2;
    if (tree_ || !few_ || s < 4) return;
    middle_ = known(middle);
    const double ago = begun_ && middle_before_.M.size() ? (stages_.t - middle_before_.t) / stages_.h : 0.0;
    const bool four = ago > NEAREST && ago < FARTHEST;
    const auto &c = stages_.table->c; // parts of the step, as times may be rounded
    const double x[] = {begun_ ? 0.0 : c[0], c[middle], c[s - 1], -ago};
    for (int i = 0; i < s; ++i) {
      if (has_derivatives(i)) continue;
      double l[] = {1.0, 1.0, 1.0, 1.0};
      for (int m = 0; m < 3 + four; ++m)
        for (int n = 0; n < 3 + four; ++n)
          if (n != m) l[m] *= (c[i] - x[n]) / (x[m] - x[n]);
      const auto blend = [&](std::vector<Mat> &all, Mat Known::*part) {
        all[i] = l[0] * (begun_ ? end_before_.*part : all[0]) + l[1] * all[middle] + l[2] * all[s - 1];
        if (four) all[i] += l[3] * (middle_before_.*part);
      };
      blend(M_, &Known::M);
      blend(D_, &Known::D);
      blend(K_, &Known::K);
    }
  }

  Known known(int i) const { return {stages_.time(i), M_[i], D_[i], K_[i]}; }

  bool symmetric() const { return &system_.G_transposed() == &system_.W; }
  const Mat &left(int i) const { return symmetric() ? Z_[i] : Y_[i]; }

  // h dV_i = T_i⁻¹ (Σ_j b_ij T_j dP_j - T'_i dP_i) + h [v_i, dP_i] for the joints that need it, with T' = b (T - 1).
  void turn_charts() {
    if (charts_.empty()) return;
    find_chart_matrices();
    for (int i = 0; i < stages_.size(); ++i) {
      p_ = stages_.P.col(i);
      v_ = stages_.V.col(i);
      system_.bracket(system_.rate(stages_.time(i), p_, v_), ad_[i]);
    }
    for (auto &chart : charts_) {
      if (chart.size == 3) turn<3>(chart);
      else if (chart.size == 6) turn<6>(chart);
      else turn<Eigen::Dynamic>(chart);
    }
  }

  template <int n> void turn(Chart &chart) {
    using Block = Eigen::Matrix<double, n, n>;
    const int s = stages_.size(), size = chart.size;
    const Mat &b = stages_.table->inverse;
    chart.h_dV.resize(s * size * size, s);
    for (int i = 0; i < s; ++i) {
      const Block back = Block(chart.T[i]).inverse();
      Block change = Block::Zero(size, size);
      for (int j = 0; j < s; ++j) {
        const Eigen::Map<const Block> T(chart.T[j].data(), size, size);
        Eigen::Map<Block>(&chart.h_dV(j * size * size, i), size, size).noalias() = b(i, j) * (back * T);
        change += b(i, j) * (T - Block::Identity(size, size));
      }
      Eigen::Map<Block>(&chart.h_dV(i * size * size, i), size, size) +=
          stages_.h * ad_[i].block(chart.first, chart.first, size, size) - back * change;
    }
    combine(chart.h_dV, b, chart.h2_dW);
  }

  // T of each joint and stage.
  void find_chart_matrices() {
    const int s = stages_.size(), nx = system_.nx;
    if (!tree_) {
      for (int i = 0; i < s; ++i) {
        xi_ = stages_.xi.col(i);
        system_.chart_matrix(xi_, T_);
        for (auto &chart : charts_) chart.T[i] = T_.block(chart.first, chart.first, chart.size, chart.size);
      }
      return;
    }
    int most = 0;
    for (const auto &chart : charts_) most = std::max(most, chart.size);
    for (int k = 0; k < most; ++k) { // their columns
      units_.setZero(nx, s);
      for (const auto &chart : charts_)
        if (k < chart.size) units_.row(chart.first + k).setOnes();
      turned_.resize(nx, s);
      states_.kernel().chart_rates(*tree_, s, stages_.xi.data(), units_.data(), bernoulli().data(), static_cast<int>(bernoulli().size()),
                                   turned_.data());
      for (auto &chart : charts_)
        for (int i = 0; i < s && k < chart.size; ++i) {
          chart.T[i].resize(chart.size, chart.size);
          chart.T[i].col(k) = turned_.col(i).segment(chart.first, chart.size);
        }
    }
  }

  // dV of dP, times h and a scale.
  void along(const Mat &dP, Mat &out, double scale) {
    combine(dP, stages_.table->inverse, out, scale);
    for (const auto &chart : charts_)
      for (int i = 0; i < stages_.table->s; ++i) {
        auto rates = out.col(i).segment(chart.first, chart.size);
        rates.setZero();
        for (int j = 0; j < stages_.table->s; ++j)
          rates += scale * (chart.dV(i, j) * dP.col(j).segment(chart.first, chart.size));
      }
  }

  System &system_;
  const Stages &stages_;
  bool few_, may_lanes_, with_rows_, rows_bend_ = false, begun_ = false; // begun_: M, D and K are known at the start of the step
  LU lu_, dependent_;
  StageBlocks blocks_;
  bool may_part_ = false, in_blocks_ = false; // the stages come apart; in the matrix factorised last
  Mat parts_[3];
  Mat columns_, F_, F_before_, none_, f_, closing_, along_, twice_, MY_, DY_, KY_, row_, left_over_, matrix_, T_, units_, turned_;
  Known middle_, middle_before_, end_before_;
  std::vector<Mat> Z_, Y_, M_, D_, K_, ad_;
  std::vector<Chart> charts_;
  std::vector<Elimination> right_, left_;
  const lanes::Tree *tree_ = nullptr; // null if states are evaluated one by one
  StateLanes states_;
  std::vector<lanes::Chart> lane_charts_;
  std::vector<std::vector<double>> chart_numbers_; // of them
  bool side_by_side_ = false; // all stages have the same dependent velocities
  bool renewed_ = false;      // factorised since `recall`
  Vec times_;
  Vec lam_, p_, v_, w_, xi_, y_, spare_;
};

} // namespace pinconsist
