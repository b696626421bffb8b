// What Python sees of gradients.
#include "bindings.hpp"
#include "gradient.hpp"
#include "stage_follow.hpp"

#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

namespace pinconsist {
namespace {

using namespace nb::literals;
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

// What parameters are, for a class that holds them.
template <class Holder, class Class, class Of> void bind_parameters(Class &bound, const Of &of) {
  bound.def("use_parameters", [of](Holder &h, int number) { of(h).use(number); })
      .def("add_term", [of](Holder &h, int column, double weight, System &system) { of(h).add_term(column, weight, system); }, nb::keep_alive<1, 4>())
      .def("use_known", [of](Holder &h, System &rates) { of(h).known = &dynamic_cast<Known &>(rates); }, nb::keep_alive<1, 2>());
}

void bind_table_gradients(nb::module_ &m) {
  nb::class_<Derivatives> derivatives(m, "Derivatives");
  bind_parameters<Derivatives>(derivatives, [](Derivatives &d) -> Parameters & { return d.step.parameters; });
  derivatives
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("forward",
           [](Derivatives &f, System &system, Array<const double, 1> t, Array<const double, 1> h, Array<const int64_t, 1> k,
              Array<const double, 2> base, Array<const double, 3> Z, std::vector<int> changed, Array<const double, 3> changes,
              Array<double, 4> tables) {
             const Leg leg = leg_of(t, h, k, base, Z, std::move(changed), changes);
             return beside(system.calls_python() || f.step.parameters.calls_python(), [&] { return f.forward(leg, tables.data()); });
           })
      .def("backward",
           [](Derivatives &f, System &system, Array<const double, 1> t, Array<const double, 1> h, Array<const int64_t, 1> k,
              Array<const double, 2> base, Array<const double, 3> Z, std::vector<int> changed, Array<const double, 3> changes,
              Array<double, 3> seeds, Array<double, 1> rates) {
             const Leg leg = leg_of(t, h, k, base, Z, std::move(changed), changes);
             return beside(system.calls_python() || f.step.parameters.calls_python(), [&] { return f.backward(leg, seeds.data(), rates.data()); });
           });
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
  nb::class_<StageDerivatives> derivatives(m, "StageDerivatives");
  bind_parameters<StageDerivatives>(derivatives, [](StageDerivatives &d) -> Parameters & { return d.parameters; });
  derivatives
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("again",
           [](StageDerivatives &d, System &system, StageColumns steps, Array<double, 1> W, Array<double, 2> p, Array<double, 2> v) {
             return beside(system.calls_python(), [&] { return d.again(stage_steps(steps), W.data(), p.data(), v.data()); });
           })
      .def("forward",
           [](StageDerivatives &d, System &system, StageColumns steps, Array<const double, 3> S, Array<double, 3> ends) {
             return beside(system.calls_python() || d.parameters.calls_python(), [&] { return d.forward(stage_steps(steps), S.data(), ends.data()); });
           })
      .def("backward",
           [](StageDerivatives &d, System &system, StageColumns steps, Array<const double, 2> given, Array<double, 2> bars,
              Array<double, 1> rates) {
             return beside(system.calls_python() || d.parameters.calls_python(),
                           [&] { return d.backward(stage_steps(steps), given.data(), bars.data(), rates.data()); });
           })
      .def("multipliers",
           [](StageDerivatives &d, System &system, Array<const double, 1> t, Array<const double, 2> p, Array<const double, 2> v,
              Array<const double, 3> s, Array<double, 2> lam, Array<double, 3> of_lam) {
             return beside(system.calls_python() || d.parameters.calls_python(), [&] {
               return d.multipliers(static_cast<int>(t.shape(0)), t.data(), p.data(), v.data(), s.data(), lam.data(), of_lam.data());
             });
           })
      .def("linear", // a, λ and their derivatives; None where the equations are singular
           [](StageDerivatives &d, double t, const Vec &p, const Vec &v) -> nb::object {
             const auto *of = d.at(t, p, v);
             return of ? nb::object(nb::make_tuple(of->acceleration(), of->lam, of->linear())) : nb::none();
           })
      .def("multipliers_back",
           [](StageDerivatives &d, System &system, Array<const double, 1> t, Array<const double, 2> p, Array<const double, 2> v,
              Array<const double, 2> lam, Array<double, 2> bars, Array<double, 1> rates) {
             return beside(system.calls_python() || d.parameters.calls_python(), [&] {
               return d.multipliers_back(static_cast<int>(t.shape(0)), t.data(), p.data(), v.data(), lam.data(), bars.data(), rates.data());
             });
           });
}

} // namespace

void bind_gradients(nb::module_ &m) {
  bind_table_gradients(m);
  bind_stage_gradients(m);
}

} // namespace pinconsist
