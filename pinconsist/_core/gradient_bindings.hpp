// What Python sees of gradients.
#pragma once

#include "gradient.hpp"
#include "radau_bindings.hpp"

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

bool calls_python(const System &system, const LinearStep &step) {
  bool any = system.calls_python();
  for (const auto &terms : step.parameters)
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
             return beside(calls_python(system, f.step), [&] { return f.forward(leg, tables.data()); });
           })
      .def("backward",
           [](Derivatives &f, System &system, Array<const double, 1> t, Array<const double, 1> h, Array<const int64_t, 1> k,
              Array<const double, 2> base, Array<const double, 3> Z, std::vector<int> changed, Array<const double, 3> changes,
              Array<double, 3> seeds, Array<double, 2> weights) {
             const Leg leg = leg_of(t, h, k, base, Z, std::move(changed), changes);
             return beside(system.calls_python(), [&] { return f.backward(leg, seeds.data(), weights.data()); });
           })
      .def("weigh",
           [](Derivatives &f, System &system, Array<const double, 1> t, Array<const double, 1> h, Array<const int64_t, 1> k,
              Array<const double, 2> base, Array<const double, 3> Z, std::vector<int> changed, Array<const double, 3> changes,
              System &other, Array<const double, 2> weights) {
             const Leg leg = leg_of(t, h, k, base, Z, std::move(changed), changes);
             return beside(system.calls_python() || other.calls_python(), [&] { return f.weigh(leg, other, weights.data()); });
           });
}

} // namespace
} // namespace pinconsist
