// Python bindings of BDF and Radau IIA: steppers that make batches of steps.
#include "radau_stepper.hpp"
#include "stepper.hpp"

#include <nanobind/stl/vector.h>

namespace pinconsist {
namespace {

using namespace nb::literals;

struct StageCurve {
  Collocations steps;
};

Switches switches_of(nb::object switches) {
  const auto on = [&](const char *name) { return nb::cast<bool>(switches.attr(name)); };
  return {on("iteration_forecast"), on("jacobian_reuse"), on("kept_derivatives"), on("few_derivatives"), on("lanes"),
          on("row_derivatives")};
}

// Run something; releases the GIL unless Python is called.
template <class Run> Failure released(bool calls_python, const Run &run) {
  if (calls_python) return run();
  nb::gil_scoped_release release;
  return run();
}

// Make steps until something ends them; returns its name and the Python exception, if any.
template <class Run> std::pair<const char *, nb::object> attempted(bool calls_python, const Run &run) {
  Failure failure = Failure::none;
  nb::object error = nb::none();
  try {
    failure = released(calls_python, run);
  } catch (nb::python_error &raised) {
    error = nb::borrow(raised.value());
  } catch (const std::exception &raised) {
    error = nb::module_::import_("builtins").attr("RuntimeError")(raised.what());
  }
  return {name_of(failure), error};
}

// The polynomials of a batch, for Python; None if there are none.
nb::object in_python(TableCurve &curve) {
  if (curve.tables.empty()) return nb::none();
  return nb::make_tuple(array_of(std::move(curve.bases)), array_of(std::move(curve.tables)));
}
nb::object in_python(Collocations &curve) { return curve.empty() ? nb::none() : nb::cast(StageCurve{std::move(curve)}); }

// Of a step: its start, size and stages; p and v there; the accelerations of its stages; p and v at its end.
nb::tuple in_python(const Collocation &step) {
  const auto &shape = step.shape;
  return nb::make_tuple(shape.t, shape.h, shape.table->s, array(step.p0), array(step.v0), array(Table(shape.W.transpose())),
                        array(step.p1), array(step.v1));
}

// A batch: why it ended, the Python exception if any, its rows, its polynomials, and where forces jumped.
template <class Curve> nb::object in_python(const char *failure, nb::object error, StepBatch<Curve> &made, const System &system) {
  const size_t n = made.steps, npos = system.npos, nv = system.nv, nc = system.nc, jumped = made.jumps.size();
  const nb::object jumps = jumped ? nb::make_tuple(array(made.jumps, {jumped}), array(made.lam_after, {jumped, nc}))
                                  : nb::make_tuple(nb::tuple(), nb::tuple());
  return nb::make_tuple(failure, error, array(made.t, {n}), array(made.p, {n, npos}), array(made.v, {n, nv}), array(made.lam, {n, nc}),
                        array(made.h, {n}), array(made.order, {n}), in_python(made.curve), jumps);
}

// Members of both steppers.
template <class Curve, class Stepper> void bind_run(nb::class_<Stepper> &bound) {
  bound.def_ro("t", &Stepper::t)
      .def_ro("h", &Stepper::h)
      .def_prop_ro("p", [](const Stepper &s) { return array(s.p); })
      .def_prop_ro("velocity", [](const Stepper &s) { return array(Vec(s.velocity())); })
      .def_prop_ro("multipliers", [](const Stepper &s) { return array(Vec(s.multipliers())); })
      .def_rw("turns", &Stepper::turns)
      .def("stand", &Stepper::stand)
      .def_rw("first", &Stepper::first)
      .def_rw("step", &Stepper::step)
      .def_prop_ro("sizes", [](const Stepper &s) { return array(s.control.sizes); })
      .def("locate", // the time of an event, and p, v, λ there; None where the equations are singular
           [](Stepper &s, Signs &signs, size_t i, double limit) -> nb::object {
             const auto found = s.locate(signs, i, limit);
             if (!found) return nb::none();
             return nb::make_tuple(found->t, nb::make_tuple(array(found->p), array(found->v), array(found->lam)));
           }, "signs"_a, "i"_a, "limit"_a = NOT_A_NUMBER)
      .def("watched", [](Stepper &s, Signs &signs) { return name_of(s.watched(signs)); })
      .def("work", // since the last call
           [](Stepper &s) {
             const auto taken = [](long &count) { return std::exchange(count, 0); };
             return nb::make_tuple(taken(s.newton.nfev), taken(s.newton.njev), taken(s.newton.nlu),
                                   taken(s.control.rejected_by_error), taken(s.control.rejected_by_newton));
           })
      .def_prop_ro("culprit", [](const Stepper &s) { return nb::make_tuple(s.newton.culprit_t, array(s.newton.culprit_p), array(s.newton.culprit_v)); })
      .def("run",
           [](Stepper &s, const System &system, double t_end, long most, bool with_curve, Signs *signs, nb::object sees, nb::object forces) {
             StepBatch<Curve> out;
             const auto [failure, error] = attempted(system.calls_python() || !sees.is_none(), [&] { return s.run(t_end, most, with_curve, signs, sees, forces, out); });
             return in_python(failure, error, out, system);
           }, "system"_a, "t_end"_a, "most"_a, "with_curve"_a, "signs"_a.none(), "sees"_a.none(), "forces"_a.none())
      .def("reach", // (t, p, v); None if the steps end before t_end, or if Python has no use for them
           [](Stepper &s, const System &system, double t_end, long most, bool jumped, nb::object forces) -> nb::object {
             released(system.calls_python(), [&] { return s.reach(t_end, most, jumped, forces); });
             if (s.t != t_end) return nb::none();
             return nb::make_tuple(t_end, array(s.p), array(s.velocity()));
           }, "system"_a, "t_end"_a, "most"_a, "jumped"_a, "forces"_a.none())
      .def("unread", // the batch of all steps of `reach` since the last call
           [](Stepper &s, const System &system) {
             StepBatch<Curve> made = std::exchange(s.unread, {});
             return in_python("", nb::none(), made, system);
           });
}

void bind_signs(nb::module_ &m) {
  nb::class_<ContactWatch>(m, "ContactWatch")
      .def(nb::init<MechanismSystem &>(), "rows"_a, nb::keep_alive<1, 2>())
      .def("add_gap", &ContactWatch::add_gap, "row"_a, "level"_a)
      .def("add_push", &ContactWatch::add_push, "place"_a)
      .def("add_cone", &ContactWatch::add_cone, "place"_a, "beside"_a, "friction"_a)
      .def("add_speed", &ContactWatch::add_speed, "row"_a, "direction"_a, "level"_a);
  nb::class_<Signs>(m, "Signs")
      .def(nb::init<const nb::tuple &, bool, nb::handle, nb::handle, std::vector<int>, int, ContactWatch *>(), "events"_a, "with_multipliers"_a,
           "interrupted"_a, "finish"_a.none(), "places"_a, "number"_a, "contacts"_a.none(), nb::keep_alive<1, 8>())
      .def_ro("begin", &Signs::begin)
      .def_ro("end", &Signs::end)
      .def_ro("before", &Signs::before)
      .def_ro("values", &Signs::values)
      .def_rw("changed", &Signs::changed)
      .def("restart", &Signs::restart)
      .def("leaves", &Signs::leaves)
      .def("look", &Signs::look)
      .def("value", &Signs::value);
}

void bind_bdf(nb::module_ &m) {
  nb::class_<Stepper> stepper(m, "Stepper");
  bind_run<TableCurve>(stepper);
  stepper
      .def(
          "__init__",
          [](Stepper *self, System &system, bool correct, nb::object switches) {
            new (self) Stepper(system, correct, switches_of(switches));
          },
          "system"_a, "correct"_a, "switches"_a, nb::keep_alive<1, 2>())
      .def_ro("k", &Stepper::k)
      .def_ro("t_old", &Stepper::t_old)
      .def_ro("used_h", &Stepper::used_h)
      .def_ro("points", &Stepper::points)
      .def_prop_ro("base", [](const Stepper &s) { return array(s.base); })
      .def_prop_ro("Z", [](const Stepper &s) { return array(s.Z); })
      .def("begin", // why it failed, and t, p, v, λ of the states of the history
           [](Stepper &s, const System &system, double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, double t_end) {
             History past;
             const Failure failure = released(system.calls_python(), [&] { return s.begin(t, p, v, a, lam, t_end, past); });
             nb::list states;
             for (size_t i = 0; i < past.t.size(); ++i)
               states.append(nb::make_tuple(past.t[i], array(past.p[i]), array(past.v[i]), array(past.lam[i])));
             return nb::make_tuple(name_of(failure), states);
           })
      .def("trial", // p and v of an uncorrected step, and why it failed
           [](Stepper &s) {
             Vec p, v;
             const Failure failure = s.trial(p, v);
             return nb::make_tuple(array(p), array(v), name_of(failure));
           })
      .def("inside", // p, v, λ at a time of the last step, or of the history
           [](const Stepper &s, double t) {
             const Located here = s.inside(t);
             return nb::make_tuple(array(here.p), array(here.v), array(here.lam));
           })
      .def("take_velocities", &Stepper::take_velocities)
      .def("fix_order", [](Stepper &s, int order) { s.control.max_order = order; })
      .def("control_error", [](Stepper &s, const Vec &rtol, const Vec &atol, const Vec &sizes, int max_order, double rounding,
                               double max_step, bool noise) {
        s.control.set(rtol, atol, max_order, rounding);
        s.control.sizes = sizes;
        s.control.max_step = max_step;
        s.control.noise = noise;
      });
}

void bind_radau(nb::module_ &m) {
  nb::class_<RadauStepper> stepper(m, "RadauStepper");
  bind_run<Collocations>(stepper);
  stepper.def("__init__", [](RadauStepper *self, System &system, nb::object switches) {
             new (self) RadauStepper(system, switches_of(switches));
           }, "system"_a, "switches"_a, nb::keep_alive<1, 2>())
      .def_prop_ro("k", [](const RadauStepper &s) { return 2 * s.control.s - 1; })
      .def("jump", [](RadauStepper &s) { return s.jump() == Failure::none; })
      .def("divide", &RadauStepper::divide, "t_end"_a, "least"_a = 1)
      .def("begin",
           [](RadauStepper &s, const System &system, double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, double t_end) {
             released(system.calls_python(), [&] {
               s.begin_anew(t, p, v, a, lam, t_end);
               return Failure::none;
             });
           })
      .def("fix_stages", [](RadauStepper &s, int stages) { s.control.use(stages); })
      .def("control_error", [](RadauStepper &s, const Vec &rtol, const Vec &atol, const Vec &sizes, int stages, double max_step) {
        s.control.set(rtol, atol, stages);
        s.control.sizes = sizes;
        s.control.max_step = max_step;
      });

  nb::class_<StageCurve>(m, "StageCurve")
      .def("first", [](const StageCurve &curve, size_t n) { return StageCurve{{curve.steps.begin(), curve.steps.begin() + n}}; })
      .def("joined",
           [](const StageCurve &curve, const std::vector<const StageCurve *> &others) {
             StageCurve all = curve;
             for (const StageCurve *other : others) all.steps.insert(all.steps.end(), other->steps.begin(), other->steps.end());
             return all;
           })
      .def("step", [](const StageCurve &curve, size_t i) { return in_python(*curve.steps.at(i)); });

  nb::class_<Sampler>(m, "Sampler")
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("rows", // at times of the steps with these indices; the index of the first time at which the equations are singular
           [](Sampler &sampler, const StageCurve &curve, const Eigen::VectorX<std::int64_t> &steps, const Vec &times) -> nb::object {
             const System &of = sampler.system();
             Table p(times.size(), of.npos), v(times.size(), of.nv), lam(times.size(), of.nc);
             for (Eigen::Index i = 0; i < times.size(); ++i) {
               if (!sampler.sample(curve.steps.at(steps[i]), times[i])) return nb::int_(i);
               p.row(i) = sampler.p.transpose();
               v.row(i) = sampler.v.transpose();
               lam.row(i) = sampler.lam.transpose();
             }
             return nb::make_tuple(array(p), array(v), array(lam));
           });
}

} // namespace

void bind_steppers(nb::module_ &m) {
  bind_signs(m);
  bind_bdf(m);
  bind_radau(m);
}

} // namespace pinconsist
