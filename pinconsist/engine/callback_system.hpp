// Systems that are implemented in Python.
#pragma once

#include "charts.hpp"

namespace pinconsist {

// An Index3System implemented in Python, called back.
class CallbackSystem : public System {
public:
  explicit CallbackSystem(nb::object system) : system_(std::move(system)) {
    npos = number("npos");
    nx = number("nx");
    nv = number("nv");
    nc = number("nc");
    vector_like = nb::cast<bool>(system_.attr("vector_like"));
    sharp = nb::cast<bool>(system_.attr("sharp"));
    rate_is_velocity = keeps_derivatives = false;
    if (!vector_like) curved = {{0, nx}};
    f = Vec::Zero(nv);
    size_rows();
    Gt_ = Mat::Zero(nc, nv);
  }

  bool calls_python() const override { return true; }
  const Mat &G_transposed() const override { return Gt_; }

  void integrate(const Vec &p, const Vec &xi, Vec &out) const override {
    if (vector_like) out = p + xi;
    else out = vector(ask(system_, "integrate", p, xi), npos, "integrate");
  }
  void difference(const Vec &p0, const Vec &p1, Vec &xi) const override {
    if (vector_like) xi = p1 - p0;
    else xi = vector(ask(system_, "difference", p0, p1), nx, "difference");
  }
  Vec rate(double t, const Vec &p, const Vec &v) const override {
    return vector(ask(system_, "rate", t, p, v), nx, "rate");
  }
  void chart_rate(const Vec &xi, const Vec &rate, Vec &out) const override {
    out = rate;
    if (vector_like) return;
    Mat T;
    chart_matrix(xi, T);
    out = T * rate;
  }
  void chart_matrix(const Vec &xi, Mat &T) const override {
    Mat ad;
    bracket(xi, ad);
    T = chart_block(ad);
  }
  void bracket(const Vec &x, Mat &ad) const override { ad = matrix(ask(system_, "bracket", x), nx, nx, "bracket"); }
  void position(double t, const Vec &base, const Vec &psi_x, double c, const Vec &v, Vec &p, Vec &xi) const override {
    const nb::object both = ask(system_, "position", t, base, psi_x, c, v);
    p = vector(both[0], npos, "position");
    xi = vector(both[1], nx, "position");
  }
  void evaluate(double t, const Vec &p, const Vec &v, const Vec &a) override {
    const nb::object all = ask(system_, "evaluate", t, p, v, a);
    f = vector(all[0], nv, "evaluate");
    phi = vector(all[1], nc, "evaluate");
    Gt_ = matrix(all[2], nv, nc, "evaluate").transpose();
    rho = vector(all[3], nc, "evaluate");
  }
  void constraint(double t, const Vec &p, const Vec &v) override {
    const nb::object both = ask(system_, "constraint", t, p, rate(t, p, v));
    phi = vector(both[0], nc, "constraint");
    rho = vector(both[1], nc, "constraint");
  }
  void evaluate_bias(double t, const Vec &p, const Vec &v, bool, Vec &bias) override {
    evaluate(t, p, v, Vec::Zero(nv));
    bias = vector(ask(system_, "acceleration_bias", t, p, v), nc, "acceleration_bias");
  }
  const Mat &velocity_jacobian(double t, const Vec &p, const Vec &v) override {
    W = matrix(ask(system_, "velocity_jacobian", t, p, v, Mat(Gt_.transpose())), nc, nv, "velocity_jacobian");
    return W;
  }
  void linearize(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, double c, Eigen::Ref<Mat> A,
                 bool) override {
    nb::object filled = nb::module_::import_("numpy").attr("empty")(nb::make_tuple(nv, nv));
    W = matrix(ask(system_, "linearize", t, p, v, a, lam, c, filled), nc, nv, "linearize");
    A = matrix(filled, nv, nv, "linearize");
  }
  void evaluate_parts(double t, const Vec &p, const Vec &v, const Vec &a, Mat &M, Mat &D, Mat &K) override {
    evaluate(t, p, v, a);
    const nb::object all = ask(system_, "matrices", t, p, v, a);
    M = matrix(all[0], nv, nv, "matrices");
    D = matrix(all[1], nv, nv, "matrices");
    K = matrix(all[2], nv, nv, "matrices");
  }
  void mass_matrix(double t, const Vec &p, const Vec &v, Eigen::Ref<Mat> M) override {
    const Vec kept_phi = phi, kept_rho = rho, zero = Vec::Zero(nv);
    evaluate(t, p, v, zero);
    linearize(t, p, v, zero, Vec::Zero(nc), 0.0, M, true);
    phi = kept_phi;
    rho = kept_rho;
  }
  void subtract_force_gradient(double t, const Vec &p, const Vec &v, const Vec &lam, double c,
                               Eigen::Ref<Mat> A) override {
    const nb::object gradient = ask(system_, "force_gradient", t, p, v, lam);
    if (nb::hasattr(gradient, "shape") && nb::cast<int>(gradient.attr("ndim")) == 2)
      A -= c * c * matrix(gradient, nv, nv, "force_gradient");
  }
  void sharp_force(double t, const Vec &p, const Vec &v, Vec &tau) override {
    tau = vector(ask(system_, "sharp_force", t, p, v), nv, "sharp_force");
  }
  void position_scale(const Vec &p, Eigen::Ref<Vec> scale) const override {
    scale = vector(ask(system_, "position_scale", p), nx, "position_scale");
  }

private:
  int number(const char *name) const { return nb::cast<int>(system_.attr(name)); }

  static Vec vector(const nb::object &x, Eigen::Index size, const char *method) {
    Vec result = nb::cast<Vec>(x);
    if (result.size() != size) throw nb::value_error(method);
    return result;
  }
  static Mat matrix(const nb::object &x, Eigen::Index rows, Eigen::Index columns, const char *method) {
    Mat result = nb::cast<Mat>(x);
    if (result.rows() != rows || result.cols() != columns) throw nb::value_error(method);
    return result;
  }

  nb::object system_;
  Mat Gt_;
};

} // namespace pinconsist
