// States of a mechanism side by side, for lanes.hpp: its tree in plain numbers, and the arrays.
#pragma once

#include "lanes.hpp"
#include "tree.hpp"

#include <algorithm>
#include <map>
#include <optional>

namespace pinconsist {

// The tree of a model whose joints lanes.cpp knows.
class LaneTree {
public:
  lanes::Tree tree{};

  // Nothing for other joints, or too many of them.
  static std::optional<LaneTree> of(const Model &model, int nc, const Vec &damping, const Vec &constant) {
    LaneTree made;
    if (model.nv > lanes::LARGEST_TREE || model.nv < 1) return {};
    for (const auto &branch : model.branches)
      if (!made.add(model, branch)) return {};
    lanes::Tree &tree = made.tree;
    tree.bodies = static_cast<int>(made.bodies_.size());
    tree.nv = model.nv;
    tree.nq = model.nq;
    tree.nc = nc;
    made.before_ = made.inner(model);
    tree.armature = model.armature.data();
    tree.damping = damping.data();
    tree.constant = constant.data();
    for (int i = 0; i < 3; ++i) tree.gravity[i] = model.gravity.linear()[i];
    return made;
  }

  // Rows between points: `axes` are those of body 1's anchor in its joint's axes, one a row; `length` 0 for components.
  void add_rows(int at, int joint1, const SE3 &place1, int joint2, const SE3 &place2, const Eigen::Matrix<double, Eigen::Dynamic, 3> &axes,
                double length, const std::vector<std::pair<int, double>> &columns) {
    lanes::PointRows rows{};
    rows.at = at;
    rows.n = static_cast<int>(axes.rows());
    rows.length = length;
    rows.body1 = joint1 - 1;
    rows.body2 = joint2 - 1;
    write(in_body(joint1) * place1.translation(), rows.place1);
    write(in_body(joint2) * place2.translation(), rows.place2);
    for (int i = 0; i < rows.n; ++i)
      write(in_body(joint1) * Eigen::Vector3d(place1.rotation() * axes.row(i).transpose()), rows.axes + 3 * i);
    rows.moving = static_cast<int>(columns.size());
    keep(columns);
    rows_.emplace_back(rows, columns_.size() - 1);
  }

  void add_spring(int joint1, const Eigen::Vector3d &x1, int joint2, const Eigen::Vector3d &x2, double stiffness, double length,
                  double damping, double shortest, const std::vector<std::pair<int, double>> &columns, const std::vector<int> &joints) {
    lanes::Spring spring{joint1 - 1, joint2 - 1, {}, {}, stiffness, length, damping, shortest, nullptr, nullptr, nullptr, 0};
    write(in_body(joint1) * x1, spring.place1);
    write(in_body(joint2) * x2, spring.place2);
    spring.moving = static_cast<int>(columns.size());
    keep(columns);
    joints_.push_back(joints);
    springs_.emplace_back(spring, columns_.size() - 1);
  }

  // To be called when the object no longer moves.
  const lanes::Tree &settle() {
    all_rows_.clear();
    all_springs_.clear();
    for (auto [rows, of] : rows_) {
      rows.columns = columns_[of].data();
      rows.signs = signs_[of].data();
      all_rows_.push_back(rows);
    }
    for (auto [spring, of] : springs_) {
      spring.columns = columns_[of].data();
      spring.signs = signs_[of].data();
      spring.joints = joints_[all_springs_.size()].data();
      all_springs_.push_back(spring);
    }
    tree.body = bodies_.data();
    tree.before = before_.data();
    tree.rows = all_rows_.data();
    tree.kinds_of_rows = static_cast<int>(all_rows_.size());
    tree.springs = all_springs_.data();
    tree.number_of_springs = static_cast<int>(all_springs_.size());
    return tree;
  }

  // From the axes in lanes to those of the joint.
  const Eigen::Matrix3d &aligned(int joint) const { return aligned_[joint - 1]; }

private:
  void keep(const std::vector<std::pair<int, double>> &columns) {
    columns_.emplace_back();
    signs_.emplace_back();
    for (const auto &[index, sign] : columns) {
      columns_.back().push_back(index);
      signs_.back().push_back(sign);
    }
  }

  static void write(const Eigen::Vector3d &x, double *to) {
    for (int i = 0; i < 3; ++i) to[i] = x[i];
  }

  Eigen::Matrix3d in_body(int joint) const { return joint ? Eigen::Matrix3d(aligned(joint).transpose()) : Eigen::Matrix3d::Identity(); }

  bool add(const Model &model, const Branch &branch) {
    static const std::map<std::string, lanes::Kind> kinds{
        {"revolute", lanes::REVOLUTE}, {"unbounded", lanes::UNBOUNDED},   {"prismatic", lanes::PRISMATIC},
        {"helical", lanes::HELICAL},   {"free flyer", lanes::FREE_FLYER}, {"planar", lanes::PLANAR},
        {"spherical", lanes::SPHERICAL}, {"translation", lanes::TRANSLATION}};
    const auto kind = kinds.find(branch.joint.kind);
    if (kind == kinds.end()) return false;
    const int joint = static_cast<int>(bodies_.size()) + 1;
    lanes::Body body{};
    body.kind = kind->second;
    body.parent = branch.parent - 1;
    body.q = model.idx_qs[joint];
    body.v = model.idx_vs[joint];
    body.nv = model.nvs[joint];
    const auto &numbers = branch.joint.numbers;
    const bool axial = body.kind <= lanes::HELICAL;
    const Eigen::Matrix3d C = axial ? along(Eigen::Vector3d(numbers.at(0), numbers.at(1), numbers.at(2)).normalized())
                                    : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
    if (body.kind == lanes::HELICAL) body.pitch = numbers.at(3);
    const Eigen::Matrix3d to_parent = in_body(branch.parent);
    const Eigen::Matrix3d R = to_parent * branch.placement.topLeftCorner<3, 3>() * C;
    body.turned = R != Eigen::Matrix3d::Identity();
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) body.rotation[3 * i + j] = R(i, j);
    write(to_parent * branch.placement.topRightCorner<3, 1>(), body.place);
    body.mass = branch.mass;
    write(C.transpose() * branch.centre, body.centre);
    const Eigen::Matrix3d I = C.transpose() * branch.inertia * C;
    const double six[] = {I(0, 0), I(1, 0), I(1, 1), I(2, 0), I(2, 1), I(2, 2)};
    std::copy(six, six + 6, body.inertia);
    const bool floats = body.kind == lanes::FREE_FLYER || body.kind == lanes::PLANAR || body.kind == lanes::TRANSLATION;
    if (bodies_.empty()) tree.floating = -1;
    if (floats && body.parent < 0 && tree.floating < 0) tree.floating = joint - 1;
    bodies_.push_back(body);
    aligned_.push_back(C);
    return true;
  }

  // A rotation that takes z to an axis; exact for those of coordinates.
  static Eigen::Matrix3d along(const Eigen::Vector3d &axis) {
    int least = 0;
    axis.cwiseAbs().maxCoeff(&least);
    least = (least + 1) % 3;
    Eigen::Matrix3d C;
    C.col(2) = axis;
    C.col(0) = (Eigen::Vector3d::Unit(least) - axis[least] * axis).normalized();
    C.col(1) = axis.cross(C.col(0));
    return C;
  }

  static std::vector<int> inner(const Model &model) {
    std::vector<int> before(model.nv, -1);
    for (int i = 1; i < model.njoints; ++i) {
      const int parent = model.parents[i];
      int last = parent ? model.idx_vs[parent] + model.nvs[parent] - 1 : -1;
      for (int k = model.idx_vs[i]; k < model.idx_vs[i] + model.nvs[i]; ++k) {
        before[k] = last;
        last = k;
      }
    }
    return before;
  }

  std::vector<lanes::Body> bodies_;
  std::vector<Eigen::Matrix3d> aligned_;
  std::vector<int> before_;
  std::vector<std::pair<lanes::PointRows, size_t>> rows_; // with the place of their columns
  std::vector<std::pair<lanes::Spring, size_t>> springs_;
  std::vector<lanes::PointRows> all_rows_;
  std::vector<lanes::Spring> all_springs_;
  std::vector<std::vector<int>> columns_, joints_;
  std::vector<std::vector<double>> signs_;
};

// Arrays for a number of states, which the instruction set in use evaluates.
class StateLanes {
public:
  lanes::Fields fields{};
  lanes::Reduction reduction{};

  void use(const lanes::Tree &tree, int states) {
    kernel_ = &lanes::kernel();
    tree_ = &tree;
    states_ = states;
    width_ = kernel_->width;
    const long nv = tree.nv, nc = tree.nc;
    fields = {};
    fields.packs = (states + width_ - 1) / width_;
    const long lanes = fields.packs * width_;
    long size = 0;
    std::vector<std::pair<double **, long>> parts{
        {&fields.q, tree.nq}, {&fields.v, nv}, {&fields.a, nv}, {&fields.f, nv}, {&fields.phi, nc}, {&fields.J, nc * nv},
        {&fields.M, nv * nv}, {&fields.D, nv * nv}, {&fields.K, nv * nv}, {&fields.twists, 6 * nv},
        {&fields.poses, 12 * tree.bodies}, {&reduction.E, nc * (nv + 1)}};
    for (const auto &[at, items] : parts) size += items * lanes;
    const long all = size + kernel_->work(tree) + width_;
    memory_.assign(all, 0.0);
    double *next = memory_.data();
    while (reinterpret_cast<std::uintptr_t>(next) % (8 * width_)) ++next;
    for (const auto &[at, items] : parts) {
      *at = next;
      next += items * lanes;
    }
    fields.work = next;
    order_.assign(nv, 0);
    rows_.assign(nc, 0);
    filled_.assign(nc * (nv + 1), 0);
    reduction.nv = tree.nv;
    reduction.nc = tree.nc;
    reduction.order = order_.data();
    reduction.rows = rows_.data();
    reduction.filled = filled_.data();
    reduction.chosen = false;
  }

  StateLanes() = default;
  StateLanes(const StateLanes &) = delete;

  // The dependent velocities chosen last, and the rows that determine them.
  struct Choice {
    std::vector<int> order, rows;
    std::vector<unsigned char> filled;
    bool chosen = false;
  };
  void remember(Choice &to) const {
    to.order = order_;
    to.rows = rows_;
    to.filled = filled_;
    to.chosen = reduction.chosen;
  }
  void recall(const Choice &from) {
    reduction.chosen = from.chosen;
    if (!from.chosen) return;
    std::copy(from.order.begin(), from.order.end(), order_.begin());
    std::copy(from.rows.begin(), from.rows.end(), rows_.begin());
    std::copy(from.filled.begin(), from.filled.end(), filled_.begin());
  }
  // M, D and K of all states, without those that stand for places without one.
  void remember_derivatives(std::vector<double> &to) const {
    const long items = static_cast<long>(tree_->nv) * tree_->nv;
    to.resize(3 * items * states_);
    double *next = to.data();
    for (const double *of : {fields.M, fields.D, fields.K})
      for (int first = 0; first < states_; first += width_)
        for (long k = 0; k < items; ++k) {
          const double *from = of + ((first / width_) * items + k) * width_;
          for (int i = 0; i < std::min(width_, states_ - first); ++i) *next++ = from[i];
        }
  }
  void recall_derivatives(const std::vector<double> &from) {
    const long items = static_cast<long>(tree_->nv) * tree_->nv;
    const double *next = from.data();
    for (double *of : {fields.M, fields.D, fields.K})
      for (int first = 0; first < states_; first += width_) {
        const int last = std::min(width_, states_ - first) - 1;
        for (long k = 0; k < items; ++k, next += last + 1) {
          double *to = of + ((first / width_) * items + k) * width_;
          for (int i = 0; i < width_; ++i) to[i] = next[std::min(i, last)];
        }
      }
  }

  const lanes::Kernel &kernel() const { return *kernel_; }
  const lanes::Tree &tree() const { return *tree_; }
  int states() const { return states_; }

  // A number of a state in an array with so many numbers for each.
  double &at(double *array, long items, long item, int state) const {
    return array[((state / width_) * items + item) * width_ + state % width_];
  }

  // Places without a state get the last one.
  void set(int state, const double *q, const double *v, const double *a) {
    const auto put = [&](double *to, long items, const double *from) {
      double *first = &at(to, items, 0, state);
      for (long k = 0; k < items; ++k) first[k * width_] = from[k];
    };
    const int end = state == states_ - 1 ? fields.packs * width_ : state + 1;
    for (; state < end; ++state) {
      put(fields.q, tree_->nq, q);
      put(fields.v, tree_->nv, v);
      put(fields.a, tree_->nv, a);
    }
  }

  void get(const double *array, long items, int state, double *to) const {
    const double *first = array + (state / width_) * items * width_ + state % width_;
    for (long k = 0; k < items; ++k) to[k] = first[k * width_];
  }
  // Add to the numbers of a state, and where there is none, to those that stand for it.
  void add(double *array, long items, int state, const double *what, double scale = 1.0) {
    const int end = state == states_ - 1 ? fields.packs * width_ : state + 1;
    for (; state < end; ++state) {
      double *first = &at(array, items, 0, state);
      for (long k = 0; k < items; ++k) first[k * width_] += scale * what[k];
    }
  }
  // The same of a square matrix, which is mostly zero.
  void add(double *array, int state, const Mat &what) {
    const int end = state == states_ - 1 ? fields.packs * width_ : state + 1, n = static_cast<int>(what.rows());
    for (int column = 0; column < n; ++column)
      for (int row = 0; row < n; ++row)
        if (what(row, column) != 0.0)
          for (int i = state; i < end; ++i) at(array, static_cast<long>(n) * n, static_cast<long>(row) * n + column, i) += what(row, column);
  }
  void get(const double *array, int state, Mat &matrix) const {
    const int n = static_cast<int>(matrix.rows());
    const double *first = array + (state / width_) * static_cast<long>(n) * n * width_ + state % width_;
    for (int row = 0; row < n; ++row)
      for (int column = 0; column < n; ++column, first += width_) matrix(row, column) = *first;
  }

private:
  const lanes::Kernel *kernel_ = nullptr;
  const lanes::Tree *tree_ = nullptr;
  int states_ = 0, width_ = 1;
  std::vector<double> memory_;
  std::vector<int> order_, rows_;
  std::vector<unsigned char> filled_;
};

} // namespace pinconsist
