// What a system must provide (engine/problem.py), and systems that provide it in Python.
#pragma once

#include "lanes.hpp"
#include "tuning.hpp"

#include <Eigen/Dense>
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstring>
#include <type_traits>
#include <utility>
#include <vector>

namespace pinconsist {

namespace nb = nanobind;
using Vec = Eigen::VectorXd;
using Mat = Eigen::MatrixXd;
using Table = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr int SMALL_PRODUCT = 10; // factors below which plain loops are faster than Eigen's products

template <class Derived> double largest(const Eigen::MatrixBase<Derived> &x) {
  return x.size() ? x.cwiseAbs().maxCoeff() : 0.0;
}

// A numpy array with these numbers, row by row; nanobind's conversions take several times as long.
template <class Number> nb::object array(const Number *numbers, std::initializer_list<size_t> shape) {
  static const nb::handle empty = nb::object(nb::module_::import_("numpy").attr("empty")).release();
  const char *type = std::is_same_v<Number, double> ? "d" : "i";
  nb::object made = shape.size() == 1 ? empty(*shape.begin(), type) : empty(nb::make_tuple(*shape.begin(), shape.begin()[1]), type);
  Py_buffer view;
  if (PyObject_GetBuffer(made.ptr(), &view, PyBUF_WRITABLE)) throw nb::python_error();
  std::memcpy(view.buf, numbers, view.len);
  PyBuffer_Release(&view);
  return made;
}
template <class Number> nb::object array(const std::vector<Number> &x, std::initializer_list<size_t> shape) {
  return array(x.data(), shape);
}
inline nb::object array(const Vec &x) { return array(x.data(), {static_cast<size_t>(x.size())}); }
inline nb::object array(const Table &x) {
  return array(x.data(), {static_cast<size_t>(x.rows()), static_cast<size_t>(x.cols())});
}

// The same for many numbers, without a copy.
inline nb::object array_of(std::vector<double> &&numbers) {
  auto *kept = new std::vector<double>(std::move(numbers));
  const nb::capsule owner(kept, [](void *p) noexcept { delete static_cast<std::vector<double> *>(p); });
  return nb::cast(nb::ndarray<nb::numpy, double>(kept->data(), {kept->size()}, owner));
}

inline nb::object argument(const Vec &x) { return array(x); }
template <class Other> const Other &argument(const Other &x) { return x; }

// Call a method in Python.
template <class... Arguments> nb::object ask(const nb::object &object, const char *method, const Arguments &...arguments) {
  return object.attr(method)(argument(arguments)...);
}

class StateLanes;

class System {
public:
  int npos = 0, nx = 0, nv = 0, nc = 0;
  bool vector_like = true;
  bool rate_is_velocity = true, keeps_derivatives = true;
  double difference_step = INF; // of the difference quotients used for W
  Vec widths;                   // of narrow ranges about zero velocity over which forces change quickly; empty if there are none
  bool sharp = false;           // whether there are forces that may bend or jump within a step
  // Joints for which dξ/dt in a chart differs from the rate: first tangent coordinate, and their number.
  std::vector<std::pair<int, int>> curved;
  // Results of `evaluate` and `constraint`: f = M a + f0, Φ and the hidden residual ρ; and W of `linearize`, which for
  // rigid bodies is J and already known after `constraint`.
  Vec f, phi, rho;
  Mat W;

  System() = default;
  System(const System &) = delete;
  virtual ~System() = default;

  virtual bool calls_python() const = 0;
  // Gᵀ at the point evaluated last.
  virtual const Mat &G_transposed() const { return W; }
  // Whether G depends on the multipliers; it takes these, at the point evaluated last. False if it does not change any more.
  virtual bool reacts() const { return false; }
  virtual bool react(const Vec &, const Vec &) { return false; }
  // A step has been accepted, with this velocity at its end.
  virtual void step_ended(const Vec &) {}
  virtual void integrate(const Vec &p, const Vec &xi, Vec &out) const = 0;
  virtual void difference(const Vec &p0, const Vec &p1, Vec &xi) const = 0;
  virtual Vec rate(double, const Vec &, const Vec &v) const { return v; }
  // dξ/dt = T rate; T itself, and the bracket [x, ·], see engine/charts.py.
  virtual void chart_rate(const Vec &, const Vec &rate, Vec &out) const { out = rate; }
  virtual void chart_matrix(const Vec &, Mat &T) const { T.setIdentity(nx, nx); }
  virtual void bracket(const Vec &, Mat &ad) const { ad.setZero(nx, nx); }
  virtual void position(double t, const Vec &base, const Vec &psi_x, double c, const Vec &v, Vec &p, Vec &xi) const = 0;
  virtual void evaluate(double t, const Vec &p, const Vec &v, const Vec &a) = 0;
  virtual void constraint(double t, const Vec &p, const Vec &v) = 0;
  // f and W without accelerations, and γ with dρ/dt = W v' + γ; `known` if `constraint` was called last, at this p.
  virtual void evaluate_bias(double t, const Vec &p, const Vec &v, bool known, Vec &bias) = 0;
  // W at the point evaluated last.
  virtual const Mat &velocity_jacobian(double, const Vec &, const Vec &) { return W; }
  // A = M + c ∂f/∂v + c² ∂f/∂p at the point evaluated last, with derivatives of the last `fresh` call where they are kept.
  virtual void linearize(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, double c, Eigen::Ref<Mat> A,
                         bool fresh = true) = 0;
  // As `evaluate`, with M, D = ∂f/∂v and K = ∂f/∂p; for Radau IIA.
  virtual void evaluate_parts(double t, const Vec &p, const Vec &v, const Vec &a, Mat &M, Mat &D, Mat &K) = 0;
  // M at the point at which the constraint was evaluated last; afterwards, W and G are those of this point.
  virtual void mass_matrix(double t, const Vec &p, const Vec &v, Eigen::Ref<Mat> M) = 0;
  // A -= c² ∂(G λ)/∂ξ
  virtual void subtract_force_gradient(double t, const Vec &p, const Vec &v, const Vec &lam, double c,
                                       Eigen::Ref<Mat> A) = 0;
  // F = ∂(G λ)/∂ξ and H = ∂ρ/∂ξ at the point evaluated last, passed as zeros, the second perhaps empty; false if not known.
  virtual bool row_gradients(double, const Vec &, const Vec &, const Vec &, Mat &, Mat &) { return false; }
  // The forces that may bend or jump within a step.
  virtual void sharp_force(double, const Vec &, const Vec &, Vec &tau) { tau.setZero(nv); }
  // Sizes of the position coordinates.
  virtual void position_scale(const Vec &p, Eigen::Ref<Vec> scale) const {
    if (vector_like) scale = p.cwiseAbs();
    else scale.setOnes();
  }
  // ∂U/∂v times a change of velocities, see engine/index1.py.
  Vec moved_by(double t, const Vec &p, const Vec &v, const Vec &change) const {
    if (rate_is_velocity) return change;
    const double small = 1e-4 * (1.0 + largest(v)) / std::max(largest(change), 1e-300);
    return (rate(t, p, v) - rate(t, p, v - small * change)) / small;
  }

  // The tree of rigid bodies whose states may be evaluated at once; null if there is none.
  virtual const lanes::Tree *in_lanes() { return nullptr; }
  // As `evaluate`, or `evaluate_parts` with `derivatives`, of states at these times; afterwards the last of them is that
  // evaluated last, except for ρ.
  virtual void evaluate_lanes(const Vec &, StateLanes &, bool) {}
  // Let another of these states, evaluated with derivatives, be that evaluated last, except for ρ.
  virtual void take(const StateLanes &, int) {}

protected:
  void size_rows() {
    phi = rho = Vec::Zero(nc);
    W = Mat::Zero(nc, nv);
  }
};

} // namespace pinconsist
