// Python bindings of BDF and Radau IIA: steppers that make batches of steps.
#include "ensemble.hpp"
#include "stepper.hpp"

#include <nanobind/stl/string.h>
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
          on("row_derivatives"), on("kept_matrix")};
}

// Run something without the GIL, unless it calls Python.
template <class Run> void released(bool calls_python, const Run &run) {
  if (calls_python) return run();
  nb::gil_scoped_release release;
  run();
}

// The same; returns the Python exception, if any.
template <class Run> nb::object attempted(bool calls_python, const Run &run) {
  try {
    released(calls_python, run);
  } catch (nb::python_error &raised) {
    return nb::borrow(raised.value());
  } catch (const std::exception &raised) {
    return nb::module_::import_("builtins").attr("RuntimeError")(raised.what());
  }
  return nb::none();
}

// The polynomials of steps, for Python.
nb::object in_python(TableCurve &curve) {
  const size_t n = curve.t.size();
  return nb::make_tuple(array(curve.t, {n}), array(curve.h, {n}), array(curve.degrees, {n}), array_of(std::move(curve.bases)),
                        array_of(std::move(curve.tables)));
}
nb::object in_python(Collocations &curve) { return nb::cast(StageCurve{std::move(curve)}); }

// Of a step: its start, size and stages; p and v there; the accelerations of its stages; p and v at its end.
nb::tuple in_python(const Collocation &step) {
  const auto &shape = step.shape;
  return nb::make_tuple(shape.t, shape.h, shape.table->s, array(step.p0), array(step.v0), array(Table(shape.W.transpose())),
                        array(step.p1), array(step.v1));
}

// What was made: number of steps; rows t, p, v, λ and orders; starts and ends of polynomials, and these, or None.
template <class Curve> nb::object in_python(Made<Curve> &made, const System &system) {
  const size_t n = made.t.size(), npos = system.npos, nv = system.nv, nc = system.nc, curves = made.ends.size();
  const nb::object rows = nb::make_tuple(array(made.t, {n}), array(made.p, {n, npos}), array(made.v, {n, nv}), array(made.lam, {n, nc}));
  nb::object curve = nb::none();
  if (curves) curve = nb::make_tuple(array(made.starts, {curves}), array(made.ends, {curves}), in_python(made.curve));
  return nb::make_tuple(made.steps, rows, array(made.order, {n}), curve);
}

nb::object in_python(const Located &at) { return nb::make_tuple(at.t, array(at.p), array(at.v), array(at.lam)); }

// Events at one time, the state there, and whether they end the run; None if there are none.
nb::object in_python(const std::optional<Hit> &hit) {
  if (!hit) return nb::none();
  nb::list events;
  for (size_t i : hit->events) events.append(i);
  return nb::make_tuple(events, in_python(hit->at), hit->ends);
}

// Members of both steppers.
template <class Curve, class Stepper> void bind_run(nb::class_<Stepper> &bound) {
  bound.def_ro("t", &Stepper::t)
      .def_ro("h", &Stepper::h)
      .def_prop_ro("p", [](const Stepper &s) { return array(s.p); })
      .def_prop_ro("velocity", [](const Stepper &s) { return array(Vec(s.velocity())); })
      .def_prop_ro("multipliers", [](const Stepper &s) { return array(Vec(s.multipliers())); })
      .def_rw("turns", &Stepper::turns)
      .def_rw("first", &Stepper::first)
      .def_rw("step", &Stepper::step)
      .def_rw("moving", &Stepper::moving)
      .def_rw("waits", &Stepper::waits)
      .def_ro("to_come", &Stepper::to_come)
      .def_ro("singular_at", &Stepper::singular_at)
      .def_prop_ro("reached", [](const Stepper &s) { return nb::make_tuple(s.reached, s.reached_by, s.reached_order); })
      .def_prop_ro("hit", [](const Stepper &s) { return in_python(s.hit); })
      .def_prop_ro("sizes", [](const Stepper &s) { return array(s.control.sizes); })
      .def("place", &Stepper::begin_at)
      .def("resume_here", &Stepper::resume_here)
      .def("take_over", &Stepper::template take_over<Stepper>, "before"_a)
      .def("ask_rows", &Stepper::ask_rows, "times"_a, "exact"_a)
      .def("watch_rows", &Stepper::watch_rows, "rows"_a.none(), "every"_a, nb::keep_alive<1, 2>())
      .def("work", // since the last call
           [](Stepper &s) {
             const auto taken = [](long &count) { return std::exchange(count, 0); };
             return nb::make_tuple(taken(s.newton.nfev), taken(s.newton.njev), taken(s.newton.nlu),
                                   taken(s.control.rejected_by_error), taken(s.control.rejected_by_newton));
           })
      .def_prop_ro("culprit", [](const Stepper &s) { return nb::make_tuple(s.newton.culprit_t, array(s.newton.culprit_p), array(s.newton.culprit_v)); })
      .def("advance", // why it returns, what has failed, the Python exception if any
           [](Stepper &s, const System &system, double t_end, long most, bool jumped, bool with_curve, Events *events, nb::object sees, nb::object forces) {
             Reason reason = Reason::failed;
             const Asked asked{with_curve, events, sees, forces};
             const nb::object error = attempted(system.calls_python() || !sees.is_none(), [&] { reason = s.run(t_end, most, asked, jumped); });
             return nb::make_tuple(name_of(reason), name_of(s.failure), error);
           }, "system"_a, "t_end"_a, "most"_a, "jumped"_a, "with_curve"_a, "events"_a.none(), "sees"_a.none(), "forces"_a.none())
      .def("reach", // the same: (t, p, v) if t_end is reached, else None
           [](Stepper &s, const System &system, double t_end, long most, bool jumped, Events *events, nb::object forces) -> nb::object {
             const nb::object none = nb::none();
             released(system.calls_python(), [&] { s.run(t_end, most, {false, events, none, forces}, jumped); });
             if (s.t != t_end || s.hit) return nb::none();
             return nb::make_tuple(t_end, array(s.p), array(s.velocity()));
           }, "system"_a, "t_end"_a, "most"_a, "jumped"_a, "events"_a.none(), "forces"_a.none())
      .def("read", // what was made since the last call
           [](Stepper &s, const System &system) {
             Made<Curve> made = std::exchange(s.output, {});
             return in_python(made, system);
           });
}

void bind_events(nb::module_ &m) {
  nb::class_<ContactWatch>(m, "ContactWatch")
      .def(nb::init<MechanismSystem &>(), "rows"_a, nb::keep_alive<1, 2>())
      .def("add_gap", &ContactWatch::add_gap, "row"_a, "level"_a)
      .def("add_push", &ContactWatch::add_push, "place"_a)
      .def("add_cone", &ContactWatch::add_cone, "places"_a, "U"_a, "beside"_a, "friction"_a)
      .def("add_laws", &ContactWatch::add_laws, "laws"_a, "forces"_a, "agree"_a)
      .def("add_speed", &ContactWatch::add_speed, "row"_a, "direction"_a, "still"_a);
  nb::class_<KeptRows>(m, "KeptRows")
      .def(nb::init<MechanismSystem &, std::vector<int>, const Vec &, double>(), "all"_a, "kept"_a, "scales"_a, "t"_a, nb::keep_alive<1, 2>())
      .def("poor", &KeptRows::poor, "p"_a);
  nb::class_<Events>(m, "Events")
      .def(nb::init<const nb::list &, nb::handle, nb::handle, std::vector<int>, int>(), "events"_a, "interrupted"_a, "finish"_a.none(), "places"_a, "number"_a)
      .def("enter_mode", &Events::enter_mode, "contacts"_a)
      .def("restart", &Events::restart)
      .def("restart_after", &Events::restart_after)
      .def("has_changed", &Events::has_changed, "i"_a, "change"_a)
      .def("keep_of_multipliers", &Events::keep_of_multipliers)
      .def("passed",
           [](Events &events, const std::vector<size_t> &fired, double t, const Vec &p, const Vec &v, const Vec &lam) {
             return in_python(events.passed(fired, {t, p, v, lam}));
           })
      .def_prop_ro("found", // (t, p, v) of the occurrences of each event
           [](const Events &events) {
             nb::list all;
             for (const auto &each : events.found) {
               nb::list rows;
               for (const auto &row : each) rows.append(nb::make_tuple(row.t, array(row.p), array(row.v)));
               all.append(rows);
             }
             return all;
           });
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
      .def_prop_ro("history", // the states t, p, v, λ of a start
           [](const Stepper &s) {
             nb::list states;
             for (const Located &state : s.history()) states.append(in_python(state));
             return states;
           })
      .def("trial", // p and v of an uncorrected step, and why it failed
           [](Stepper &s) {
             Vec p, v;
             const Failure failure = s.trial(p, v);
             return nb::make_tuple(array(p), array(v), name_of(failure));
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
      .def("fix_stages", [](RadauStepper &s, int stages) { s.control.use(stages); })
      .def("steps_since", // the arguments of StageSteps, or None
           [](const RadauStepper &s, double from) -> nb::object {
             const auto steps = s.steps_since(from);
             const int n = static_cast<int>(steps.size()), nv = static_cast<int>(s.v.size());
             if (!n) return nb::none();
             Vec t_old(n), t(n), h(n);
             Table p0(n, s.p.size()), v0(n, nv), p(n, s.p.size()), v(n, nv);
             std::vector<std::int64_t> stages;
             std::vector<double> W;
             for (int i = 0; i < n; ++i) {
               const auto &step = *steps[i];
               const bool last = i + 1 == n;
               t_old[i] = step.t;
               t[i] = last ? s.t : steps[i + 1]->t;
               h[i] = step.h;
               p0.row(i) = step.p;
               v0.row(i) = step.v;
               p.row(i) = last ? s.p : steps[i + 1]->p;
               v.row(i) = last ? s.v : steps[i + 1]->v;
               stages.push_back(step.table->s);
               put(W, step.W);
             }
             return nb::make_tuple(array(t_old), array(t), array(h), p0, v0, p, v,
                                   Eigen::VectorX<std::int64_t>(Eigen::Map<Eigen::VectorX<std::int64_t>>(stages.data(), n)),
                                   Vec(Eigen::Map<Vec>(W.data(), static_cast<Eigen::Index>(W.size()))));
           })
      .def("control_error", [](RadauStepper &s, const Vec &rtol, const Vec &atol, const Vec &sizes, int stages, double max_step) {
        s.control.set(rtol, atol, stages);
        s.control.sizes = sizes;
        s.control.max_step = max_step;
      });

  stepper.def("renew", [](RadauStepper &s) { RadauMemory(s.control).recall(s); }); // as if it were new, but for its tolerances

  nb::class_<Ensemble>(m, "Ensemble")
      .def(nb::init<int, const System &, int>(), "runs"_a, "system"_a, "commands"_a)
      .def("add_worker", &Ensemble::add_worker, "run"_a, "system"_a, "numbers"_a, "tables"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(),
           nb::keep_alive<1, 4>())
      .def("begin", &Ensemble::begin, "runs"_a, "t"_a, "p"_a, "v"_a)
      .def("change", &Ensemble::change, "runs"_a, "numbers"_a, "opens"_a)
      .def("off", &Ensemble::off, "runs"_a, "t"_a, "p"_a, "v"_a)
      .def("advance", &Ensemble::advance, "runs"_a, "held"_a, "dt"_a)
      .def("multipliers", [](Ensemble &e) { return array(e.multipliers()); })
      .def_prop_ro("states", [](const Ensemble &e) { return nb::make_tuple(array(e.t), array(e.p), array(e.v)); })
      .def_rw("numbers", &Ensemble::numbers);

  nb::class_<StageCurve>(m, "StageCurve")
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
  bind_events(m);
  bind_bdf(m);
  bind_radau(m);
}

} // namespace pinconsist
