// What Python sees of gradients.
#pragma once

#include "gradient.hpp"
#include "radau_bindings.hpp"
#include "rates.hpp"
#include "stage_follow.hpp"

#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/tuple.h>

namespace pinconsist {
namespace {

template <class T, int N> using Array = nb::ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

// The arrays of a leg; they must outlive it.
Leg leg_of(const Array<const double, 1> &t, const Array<const double, 1> &h, const Array<const int64_t, 1> &k,
           const Array<const double, 2> &base, const Array<const double, 3> &Z, std::vector<int> changed,
           const Array<const double, 3> &changes) {
  const auto n = static_cast<int>(t.shape(0));
  return {n - 1, t.data(), h.data(), base.data(), Z.data(), k.data(), std::move(changed), changes.data()};
}

// Others run meanwhile if they can.
template <class Work> auto beside(bool calls_python, const Work &work) {
  if (calls_python) return work();
  nb::gil_scoped_release release;
  return work();
}

bool calls_python(const System &system, const std::vector<LinearStep::Terms> &parameters) {
  bool any = system.calls_python();
  for (const auto &terms : parameters)
    for (auto [weight, other] : terms) any = any || other->calls_python();
  return any;
}

void bind_gradients(nb::module_ &m) {
  nb::class_<Derivatives>(m, "Derivatives")
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("add_parameter", [](Derivatives &f) { f.step.parameters.emplace_back(); })
      .def("add_term", [](Derivatives &f, double weight, System &system) { f.step.parameters.back().emplace_back(weight, &system); },
           nb::keep_alive<1, 3>())
      .def("forward",
           [](Derivatives &f, System &system, Array<const double, 1> t, Array<const double, 1> h, Array<const int64_t, 1> k,
              Array<const double, 2> base, Array<const double, 3> Z, std::vector<int> changed, Array<const double, 3> changes,
              Array<double, 4> tables) {
             const Leg leg = leg_of(t, h, k, base, Z, std::move(changed), changes);
             return beside(calls_python(system, f.step.parameters), [&] { return f.forward(leg, tables.data()); });
           })
      .def("backward",
           [](Derivatives &f, System &system, Array<const double, 1> t, Array<const double, 1> h, Array<const int64_t, 1> k,
              Array<const double, 2> base, Array<const double, 3> Z, std::vector<int> changed, Array<const double, 3> changes,
              Array<double, 3> seeds, Array<double, 1> rates) {
             const Leg leg = leg_of(t, h, k, base, Z, std::move(changed), changes);
             return beside(calls_python(system, f.step.parameters), [&] { return f.backward(leg, seeds.data(), rates.data()); });
           });
  nb::class_<Rates::Place>(m, "Place").def(nb::init<>());
  nb::class_<Rates, MechanismSystem>(m, "Rates")
      .def(nb::init<nb::object, nb::object, int, std::shared_ptr<Rates::Place>>())
      .def("add_inertia", &Rates::add_inertia)
      .def("add_gravity", &Rates::add_gravity);
}

// What Python hands over of steps of Radau IIA.
using StageColumns = std::tuple<Array<const double, 1>, Array<const double, 1>, Array<const double, 1>, Array<const double, 2>,
                                Array<const double, 2>, Array<const double, 2>, Array<const double, 2>,
                                Array<const int64_t, 1>, Array<const int64_t, 1>, Array<const double, 1>>;

StageSteps stage_steps(const StageColumns &columns) {
  const auto &[t_old, t, h, p0, v0, p, v, s, begins, W] = columns;
  return {static_cast<int>(t.shape(0)), t_old.data(), t.data(), h.data(), p0.data(), v0.data(), p.data(), v.data(),
          s.data(), begins.data(), W.data()};
}

void bind_stage_gradients(nb::module_ &m) {
  nb::class_<StageDerivatives>(m, "StageDerivatives")
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("add_parameter", [](StageDerivatives &d) { d.parameters.emplace_back(); })
      .def("add_term", [](StageDerivatives &d, double weight, System &system) { d.parameters.back().emplace_back(weight, &system); },
           nb::keep_alive<1, 3>())
      .def("again",
           [](StageDerivatives &d, System &system, StageColumns steps, Array<double, 1> W, Array<double, 2> p, Array<double, 2> v) {
             return beside(system.calls_python(), [&] { return d.again(stage_steps(steps), W.data(), p.data(), v.data()); });
           })
      .def("forward",
           [](StageDerivatives &d, System &system, StageColumns steps, Array<const double, 3> S, Array<double, 3> ends) {
             return beside(calls_python(system, d.parameters), [&] { return d.forward(stage_steps(steps), S.data(), ends.data()); });
           })
      .def("backward",
           [](StageDerivatives &d, System &system, StageColumns steps, Array<const double, 2> given, Array<double, 2> bars,
              Array<double, 1> rates) {
             return beside(calls_python(system, d.parameters),
                           [&] { return d.backward(stage_steps(steps), given.data(), bars.data(), rates.data()); });
           })
      .def("multipliers",
           [](StageDerivatives &d, System &system, Array<const double, 1> t, Array<const double, 2> p, Array<const double, 2> v,
              Array<const double, 3> s, Array<double, 2> lam, Array<double, 3> of_lam) {
             return beside(calls_python(system, d.parameters), [&] {
               return d.multipliers(static_cast<int>(t.shape(0)), t.data(), p.data(), v.data(), s.data(), lam.data(), of_lam.data());
             });
           })
      .def("multipliers_back",
           [](StageDerivatives &d, System &system, Array<const double, 1> t, Array<const double, 2> p, Array<const double, 2> v,
              Array<const double, 2> lam, Array<double, 2> bars, Array<double, 1> rates) {
             return beside(calls_python(system, d.parameters), [&] {
               return d.multipliers_back(static_cast<int>(t.shape(0)), t.data(), p.data(), v.data(), lam.data(), bars.data(), rates.data());
             });
           });
}

} // namespace
} // namespace pinconsist
