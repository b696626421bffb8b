// What Python sees of Radau IIA, and what the bindings of both steppers share.
#pragma once

#include "radau_stepper.hpp"

#include <nanobind/ndarray.h>

namespace pinconsist {
namespace {

using namespace nb::literals;

// A numpy array that owns the numbers.
template <class T> nb::object array(std::vector<T> &&numbers, std::initializer_list<size_t> shape) {
  auto *kept = new std::vector<T>(std::move(numbers));
  nb::capsule owner(kept, [](void *p) noexcept { delete static_cast<std::vector<T> *>(p); });
  return nb::cast(nb::ndarray<nb::numpy, T>(kept->data(), shape.size(), shape.begin(), owner));
}

Switches switches_of(nb::object switches) {
  const auto on = [&](const char *name) { return nb::cast<bool>(switches.attr(name)); };
  return {on("iteration_forecast"), on("loop_forecast"), on("jacobian_reuse"), on("few_constraints"), on("kept_weights"),
          on("few_derivatives"), on("kept_derivatives")};
}

// Make steps until something ends them; returns its name and an exception of Python's. Others run meanwhile if they can.
template <class Run> std::pair<const char *, nb::object> attempted(const System &system, const Run &run) {
  Failure failure = Failure::none;
  nb::object error = nb::none();
  try {
    if (system.calls_python()) {
      failure = run();
    } else {
      nb::gil_scoped_release release;
      failure = run();
    }
  } catch (nb::python_error &raised) {
    error = nb::borrow(raised.value());
  } catch (const std::exception &raised) {
    error = nb::module_::import_("builtins").attr("RuntimeError")(raised.what());
  }
  return {name_of(failure), error};
}

// What both steppers have.
template <class Stepper> void bind_run(nb::class_<Stepper> &bound) {
  bound.def_ro("t", &Stepper::t)
      .def_rw("h", &Stepper::h)
      .def_prop_ro("p", [](const Stepper &s) { return s.p; })
      .def_rw("turns", &Stepper::turns)
      .def_prop_ro("sizes", [](const Stepper &s) { return s.control.sizes; })
      .def("fix_step",
           [](Stepper &s, double start, long taken, long steps) {
             s.start = start;
             s.taken = taken;
             s.steps = steps;
           })
      .def("work", // since it was asked last
           [](Stepper &s) {
             const auto taken = [](long &count) { return std::exchange(count, 0); };
             return nb::make_tuple(taken(s.newton.nfev), taken(s.newton.njev), taken(s.newton.nlu),
                                   taken(s.control.rejected_by_error), taken(s.control.rejected_by_newton));
           })
      .def_prop_ro("culprit", [](const Stepper &s) { return nb::make_tuple(s.newton.culprit_t, s.newton.culprit_p, s.newton.culprit_v); })
      .def("run", // a batch: why it ended, an exception of Python's, its rows, and the numbers of its polynomials
           [](Stepper &s, const System &system, double t_end, long most, bool with_curve) {
             StepBatch out;
             const auto [failure, error] = attempted(system, [&] { return s.run(t_end, most, with_curve, out); });
             const size_t n = out.steps, npos = system.npos, nv = system.nv, nc = system.nc;
             const size_t curve = out.curve.size(), rates = out.rates.size();
             return nb::make_tuple(failure, error, array(std::move(out.t), {n}), array(std::move(out.p), {n, npos}),
                                   array(std::move(out.v), {n, nv}), array(std::move(out.lam), {n, nc}),
                                   array(std::move(out.h), {n}), array(std::move(out.order), {n}),
                                   array(std::move(out.curve), {curve}), array(std::move(out.rates), {rates}));
           });
}

void bind_radau(nb::module_ &m) {
  nb::class_<RadauStepper> stepper(m, "RadauStepper");
  bind_run(stepper);
  stepper.def("__init__", [](RadauStepper *self, System &system, nb::object switches) {
             new (self) RadauStepper(system, switches_of(switches));
           }, "system"_a, "switches"_a, nb::keep_alive<1, 2>())
      .def_prop_ro("s", [](const RadauStepper &s) { return s.control.s; })
      .def_prop_ro("v", [](const RadauStepper &s) { return s.v; })
      .def_prop_ro("a", [](const RadauStepper &s) { return s.a; })
      .def_prop_ro("lam", [](const RadauStepper &s) { return s.lam; })
      .def("retake", // None where it fails
           [](RadauStepper &s, int stages, double t, double h, const Mat &W, const Vec &p0, const Vec &v0, double t_end) -> nb::object {
             Vec p, v, lam;
             const Shape shape{&s.tables.at(stages), t, h, W.transpose()};
             if (!s.retake(shape, p0, v0, t_end, p, v, lam)) return nb::none();
             return nb::make_tuple(p, v, lam);
           })
      .def("first_step", &RadauStepper::first_step)
      .def("jump", &RadauStepper::jump)
      .def("add_table",
           [](RadauStepper &stepper, const Vec &c, const Mat &A, const Mat &inverse, const Mat &inverse2, const Mat &modes) {
             const int s = static_cast<int>(c.size());
             stepper.tables[s] = {s, c, A, inverse, inverse2, modes, (modes.row(s - 1) * inverse2).norm()};
           })
      .def("add_tolerances",
           [](RadauStepper &stepper, int s, const Vec &rtol, const Vec &atol, double newton_factor) {
             stepper.control.of_stages[s] = {rtol, atol, newton_factor};
           })
      .def("begin",
           [](RadauStepper &s, double t, int stages, const Vec &p, const Vec &v, const Vec &a, const Vec &lam) {
             s.t = t;
             if (stages != s.control.s) s.control.use(stages);
             s.p = p;
             s.v = v;
             s.a = a;
             s.lam = lam;
             s.begin_anew();
           })
      .def("control_error",
           [](RadauStepper &s, const Vec &sizes, double max_step, bool chooses, bool worth_most) {
             s.control.sizes = sizes;
             s.control.max_step = max_step;
             s.control.chooses = chooses;
             s.control.worth_most = worth_most;
           });

  nb::class_<Sampler>(m, "Sampler")
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("sample", // None where the equations are singular
           [](Sampler &sampler, const Mat &A, const Mat &modes, double t, double h, const Mat &W, const Mat &U, const Vec &p0,
              const Vec &v0, const Vec &p1, const Vec &v1, int nc, const Vec &times) -> nb::object {
             RadauTable table;
             table.s = static_cast<int>(A.rows());
             table.A = A;
             table.modes = modes;
             const Shape step{nullptr, t, h, W.transpose()};
             Table p(times.size(), p0.size()), v(times.size(), v0.size()), lam(times.size(), nc);
             if (!sampler.sample(table, step, U.transpose(), p0, v0, p1, v1, times, p, v, lam)) return nb::none();
             return nb::make_tuple(p, v, lam);
           });
}

} // namespace
} // namespace pinconsist
